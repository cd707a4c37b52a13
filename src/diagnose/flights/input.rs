//! The input and the settings of a diagnosis.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use vehicle::VehicleParams;
use vehicle::effects::EffectId;

use crate::diagnose::flights::preparation::PreparedFlight;

/// The input of a diagnosis.
#[derive(Debug)]
pub struct DiagnosisInput<'a> {
    /// The vehicle as shipped.
    pub vehicle: &'a VehicleParams,
    /// Flights for fitting and for choosing.
    pub fitted: &'a [PreparedFlight],
    /// Held-out flights.
    pub held_out: &'a [PreparedFlight],
    /// Whether these two are parts of one flight.
    pub blocked: bool,
    /// Effects to leave out of the catalogue, with those that act alike.
    pub without: &'a [EffectId],
    /// Set by the caller to stop the diagnosis, which then soon ends without an answer.
    pub stop: &'a Arc<AtomicBool>,
}

/// Settings of a diagnosis.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Seed of every random draw.
    pub seed: u64,
    /// Number of twins; 0 for none.
    pub twins: u32,
    /// Whether to search for a law.
    pub discover: bool,
}
