//! Control: laws that map state and reference to a setpoint, the parts that they share, and the
//! limits on setpoints.

mod actuation;
mod adaptation;
mod attitude_loop;
mod controller;
mod disturbance;
mod hover_model;
mod laws;
mod limits;
mod output_feedback;
mod riccati;
mod tilt;
mod way_back;

pub use actuation::Actuation;
pub use adaptation::{
    Adaptation, AdaptationEvent, AdaptationSettings, Distrust, ParameterChange, Parameters,
};
pub use attitude_loop::{AttitudeError, AttitudeLoop};
pub use controller::Controller;
pub use disturbance::{DisturbanceObserver, OffsetFreeSettings, Shift, Use};
pub use hover_model::{HoverModel, HoverVehicle};
pub use laws::{
    CloneLaw, Command, ControlLaw, ControlProblem, ControlSettings, DesignError, Gain, Gains,
    Geometric, LAWS, Law, LawSpec, Lqr, Reach,
};
pub use limits::{Limits, Saturation};
pub use riccati::{RiccatiError, RiccatiSolution, solve_dare};
