//! A case: the flights, their vehicle, and how to diagnose them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use vehicle::VehicleParams;
use vehicle::effects::EffectId;

use crate::diagnose::flights::preparation::PreparedFlight;

/// What is to be diagnosed.
#[derive(Debug)]
pub struct Case<'a> {
    /// The simulator's vehicle.
    pub vehicle: &'a VehicleParams,
    /// Flights to fit.
    pub fitted: &'a [PreparedFlight],
    /// Flights held out.
    pub held_out: &'a [PreparedFlight],
    /// Whether these are parts of one flight.
    pub blocked: bool,
    /// Effects that are not to be considered.
    pub without: &'a [EffectId],
    /// Set where the answer is no longer wanted: the diagnosis then ends soon, without one.
    pub stop: &'a Arc<AtomicBool>,
}

/// How.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Seed of every draw.
    pub seed: u64,
    /// Number of twins.
    pub twins: u32,
    /// Whether to search for a law.
    pub discover: bool,
}
