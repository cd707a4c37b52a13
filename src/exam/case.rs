//! A case: a vehicle file and flights of a vehicle that differs from it in a known way.

use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

use super::key::KeyEntry;
use crate::diagnose::likelihood::noise::ReportNoise;

/// A case that was flown.
#[derive(Clone, Debug)]
pub struct Case {
    /// The vehicle file.
    pub nominal: VehicleParams,
    /// The file as it would be, were the builder's numbers right and nothing lacking in it but the
    /// effects.
    pub known: VehicleParams,
    /// The logs.
    pub logs: Vec<Vec<u8>>,
    /// The effects of the catalogue that it has.
    pub truth: EffectSet,
    /// Noise of its reports.
    pub noise: ReportNoise,
    /// The right answer.
    pub key: KeyEntry,
}
