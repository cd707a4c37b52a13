//! The equipment for flying a script, and the outcome of the flight.

use vehicle::VehicleParams;

use super::coverage::Coverage;
use super::judge::{Bounds, Ending, Violation};
use crate::station::StationSettings;

/// Everything besides the script that a flight needs.
pub struct Kit {
    /// The station's settings.
    pub settings: StationSettings,
    /// The vehicle's parameters.
    pub params: VehicleParams,
    /// The promised bounds of its setpoints.
    pub bounds: Bounds,
    /// Points on the trajectory, from its origin: north, east, down, m.
    pub path: Vec<[f64; 3]>,
}

/// The outcome of a flight.
#[derive(Clone, Debug)]
pub struct Flown {
    /// The station's own account of the end.
    pub end: String,
    /// Who controlled the vehicle at the end; `None` where there was no end.
    pub ending: Option<Ending>,
    /// The broken rules.
    pub violations: Vec<Violation>,
    /// Number of setpoints that left.
    pub setpoints: u64,
    /// Length of the flight in simulated time, s.
    pub simulated_s: f64,
    /// Which faults acted in which states of the flight.
    pub coverage: Coverage,
    /// Checksum of every byte in both directions.
    pub digest: u32,
}
