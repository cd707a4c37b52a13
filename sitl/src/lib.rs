//! A simulated quadrotor and its autopilot: physics, effects, sensors, and a vehicle that behaves
//! on the MAVLink wire as PX4 does. It knows nothing of the daemon.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod autopilot;
#[cfg(feature = "server")]
pub mod cli;
pub mod clock;
pub mod config;
mod estimate_error;
pub mod room;
#[cfg(feature = "server")]
mod room_sockets;
pub mod sensors;
#[cfg(feature = "server")]
pub mod server;
