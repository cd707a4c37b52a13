//! Simulation by a vehicle's equations: replicas of logged flights, predictions, flights flown
//! again.

pub mod flight_simulator;
pub mod gap;
pub mod metric;
pub mod open_loop;
pub mod reflight;
pub mod replica;
