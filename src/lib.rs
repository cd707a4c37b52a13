//! downwash: an offboard controller for MAVLink quadrotors that learns, plans, tracks, and
//! diagnoses the sim-to-real gap.

#![warn(missing_docs)]

pub mod clock;
pub mod config;
pub mod setpoint;

pub mod control;
pub mod link;
pub mod log;
pub mod pilot;
pub mod plan;
pub mod report;
pub mod supervisor;
pub mod telemetry;
