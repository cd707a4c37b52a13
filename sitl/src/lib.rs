//! A simulated quadrotor and its autopilot: physics, effects, sensors, and a vehicle that behaves
//! on the MAVLink wire as PX4 does. It knows nothing of the daemon.

#![warn(missing_docs)]

pub mod battery;
pub mod config;
mod contact;
pub mod effects;
pub mod frame;
pub mod physics;
pub mod plant;
pub mod rigid_body;
pub mod rotor;
pub mod scalar;
pub mod sensors;
pub mod vehicle;
