//! A simulated quadrotor with its autopilot: physics, effects, sensors, and the MAVLink behaviour
//! of PX4 or ArduCopter. It does not depend on the daemon.
//!
//! [`autopilot::Vehicle`] is the whole vehicle, sans I/O: it takes and returns bytes, and its owner
//! advances its clock. `server` (feature `server`) runs it on sockets in real time.
//!
//! ```
//! use sitl::autopilot::{LinkKind, Peer, Vehicle};
//! use sitl::config::SitlConfig;
//! use vehicle::VehicleParams;
//! use vehicle::effects::EffectSet;
//!
//! let quad = VehicleParams::load("quad1200")?;
//! let mut vehicle = Vehicle::new(quad, EffectSet::default(), SitlConfig::default(), 1)?;
//! vehicle.connect(Peer(0), LinkKind::Datagrams);
//! vehicle.advance_to(3_000_000);
//! let mut heard = 0;
//! vehicle.take_output(|_peer, _datagram| heard += 1);
//! assert!(heard >= 3, "a HEARTBEAT each second");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

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
