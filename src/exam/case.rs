//! A case: a vehicle file, and flights of a vehicle that differs from it in a known way.

use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

use super::key::KeyEntry;
use crate::diagnose::likelihood::noise::ReportNoise;

/// A case with its flown logs.
#[derive(Clone, Debug)]
pub struct Case {
    /// The vehicle file as shipped.
    pub nominal: VehicleParams,
    /// The file with the vehicle's numbers, lacking only the effects.
    pub known: VehicleParams,
    /// Contents of the logs.
    pub logs: Vec<Vec<u8>>,
    /// The vehicle's effects of the catalogue.
    pub truth: EffectSet,
    /// Noise of the reported state.
    pub noise: ReportNoise,
    /// The right answer.
    pub key: KeyEntry,
}
