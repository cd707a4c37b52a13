//! What a script is flown with, and how the flight went.

use vehicle::VehicleParams;

use super::coverage::Coverage;
use super::judge::{Bounds, Ending, Violation};
use crate::station::StationSettings;

/// What a script is flown with.
pub struct Kit {
    /// The station's settings.
    pub settings: StationSettings,
    /// The vehicle.
    pub params: VehicleParams,
    /// What was promised of its setpoints.
    pub bounds: Bounds,
    /// Where the trajectory leads, from its origin: north, east, down, m.
    pub path: Vec<[f64; 3]>,
}

/// How a flight went.
#[derive(Clone, Debug)]
pub struct Flown {
    /// The station's own word.
    pub end: String,
    /// Who had the vehicle at the end; `None` where there was none.
    pub ending: Option<Ending>,
    /// What did not hold.
    pub violations: Vec<Violation>,
    /// Setpoints that left.
    pub setpoints: u64,
    /// s
    pub simulated_s: f64,
    /// In which states of the flight which faults acted.
    pub coverage: Coverage,
    /// Of every byte in both directions.
    pub digest: u32,
}
