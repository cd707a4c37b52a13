//! Flight logs of any origin, read into one representation.

mod flight;

pub use flight::{AttitudeSetpoint, Clock, Flight, MotorUnit, Origin, Stream, TruthSample};
