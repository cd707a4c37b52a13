//! A simulated quadrotor and its autopilot: physics, effects, sensors, and a vehicle that behaves
//! on the MAVLink wire as PX4 does. It knows nothing of the daemon.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod autopilot;
pub mod battery;
#[cfg(feature = "server")]
pub mod cli;
pub mod clock;
pub mod config;
mod contact;
pub mod effects;
mod estimate_error;
pub mod foreign;
pub mod frame;
pub mod physics;
pub mod plant;
pub mod rigid_body;
pub mod rotor;
pub mod scalar;
pub mod sensors;
#[cfg(feature = "server")]
pub mod server;
pub mod vehicle;
