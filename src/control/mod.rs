//! State feedback: the near-hover model, its LQR, and the limits of what is asked of the vehicle.

mod actuation;
mod attitude_loop;
mod controller;
mod disturbance;
mod hover_model;
mod limits;
mod lqr;
mod output_feedback;
mod riccati;

pub use actuation::Actuation;
pub use attitude_loop::{AttitudeError, AttitudeLoop};
pub use controller::Controller;
pub use disturbance::{DisturbanceObserver, OffsetFreeSettings, Shift, Use};
pub use hover_model::{HoverModel, HoverVehicle};
pub use limits::{Limits, Saturation};
pub use lqr::{DesignError, Lqr, LqrSettings};
pub use riccati::{RiccatiError, RiccatiSolution, solve_dare};
