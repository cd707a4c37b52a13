//! downwash: an offboard controller for MAVLink quadrotors that learns, plans, tracks, and
//! diagnoses the sim-to-real gap.

#![warn(missing_docs)]

pub use log;
pub use message::{clock, parameters, setpoint};

pub mod audit;
pub mod campaign;
pub mod control;
pub mod diagnose;
pub mod exam;
pub mod guard;
pub mod learn;
pub mod link;
pub mod mocap;
pub mod model;
pub mod offboard;
pub mod onset;
pub mod plan;
pub mod report;
pub mod station;
pub mod supervisor;
pub mod telemetry;
pub mod vehicle_check;
pub mod vehicle_init;

pub mod daemon;
pub mod forward;
pub mod health;
mod http;
pub mod lap_learning;
pub mod lockstep;
mod memory;
pub mod service;
pub mod view;

pub mod cli;
pub mod command;
pub mod config;

#[cfg(test)]
mod planted;
