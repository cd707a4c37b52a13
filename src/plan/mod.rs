//! Trajectories: what the vehicle is asked to do, and the reference made of it.

mod curve;
mod feasibility;
mod file;
mod model_free;
mod multisine;
mod path;
pub mod programme;
pub mod reference;
mod table;
pub mod trajectory;

pub use feasibility::{Feasibility, FlightEnvelope, InfeasibleTrajectory};
pub use file::TrajectoryError;
pub use model_free::ModelFreeReference;
pub use trajectory::{DesiredPoint, Trajectory};
