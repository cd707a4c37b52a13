//! Trajectories: the desired motion, and the reference derived from it, directly or planned through
//! a model.

pub mod conic;
mod curve;
pub mod desire;
mod desired_point;
mod detour;
pub mod discretisation;
mod feasibility;
mod file;
mod flat;
mod flight_box;
pub mod flyable;
pub mod interior_point;
pub mod iterate;
pub mod keep_out;
pub mod manoeuvres;
mod model_free;
mod outline;
mod path;
pub mod planned;
mod planned_tube;
pub mod planner;
pub mod problem;
pub mod programme;
pub mod receding;
pub mod reference;
pub mod scp;
mod shipped;
mod slack;
mod stage_algebra;
pub mod state_vector;
pub mod subproblem;
mod table;
mod time_limit;
pub mod time_optimal;
pub mod trajectory;
pub mod tube;

pub use feasibility::{Feasibility, FlightEnvelope, InfeasibleTrajectory};
pub use file::{TrajectoryError, TrajectoryFile};
pub use flight_box::FlightBox;
pub use model_free::ModelFreeReference;
pub use outline::outline;
pub use planned_tube::{PlannedTube, PositionSource};
pub use shipped::{SHIPPED_TRAJECTORIES, ShippedTrajectory};
pub use time_limit::TimeLimit;
pub use trajectory::{DesiredPoint, NotClosed, Trajectory};
