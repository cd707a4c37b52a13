//! Traps: flights on which one effect looks like another, or does not show.

use sitl::config::BatteryConfig;
use vehicle::effects::EffectId;

use super::programme::Restriction;

/// An effect with flights that mislead about it.
#[derive(Debug)]
pub struct Trap {
    /// The vehicle's effect.
    pub effect: EffectId,
    /// Effects that these flights do not distinguish, including the vehicle's; empty if they do not
    /// show the effect.
    pub candidates: &'static [EffectId],
    /// Limits of the flights' manoeuvres.
    pub restriction: Restriction,
    /// Whether the vehicle file models a drag.
    pub models_drag: bool,
    /// Whether the log has an accelerometer, which separates wind from trim at any heading.
    pub has_imu: bool,
    /// Whether the pack's voltage stays constant.
    pub steady_pack: bool,
}

/// A pack below its full voltage that neither discharges nor sags.
pub const STEADY_PACK: BatteryConfig =
    BatteryConfig { capacity_mah: Some(1e9), resistance_ohm: Some(0.0), charge: 0.6 };

const LOOKS_LIKE: Trap = Trap {
    effect: EffectId::Wind,
    candidates: &[EffectId::Wind, EffectId::AttitudeTrim],
    restriction: Restriction::OneHeadingHover,
    models_drag: true,
    has_imu: false,
    steady_pack: false,
};
const HIDES: Trap = Trap {
    effect: EffectId::GroundEffect,
    candidates: &[],
    restriction: Restriction::High,
    models_drag: false,
    has_imu: true,
    steady_pack: false,
};
const LEVEL_OF_THRUST: &[EffectId] = &[EffectId::ThrustScale, EffectId::BatterySag];

/// Every trap.
pub static TRAPS: [Trap; 7] = [
    LOOKS_LIKE,
    Trap { effect: EffectId::AttitudeTrim, ..LOOKS_LIKE },
    Trap {
        effect: EffectId::ThrustScale,
        candidates: LEVEL_OF_THRUST,
        restriction: Restriction::SteadyThrust,
        models_drag: false,
        has_imu: true,
        steady_pack: true,
    },
    Trap {
        effect: EffectId::BatterySag,
        candidates: LEVEL_OF_THRUST,
        restriction: Restriction::None,
        models_drag: false,
        has_imu: true,
        steady_pack: true,
    },
    HIDES,
    Trap { effect: EffectId::VortexRing, restriction: Restriction::OneHeadingHover, ..HIDES },
    Trap {
        effect: EffectId::TranslationalLift,
        restriction: Restriction::OneHeadingHover,
        ..HIDES
    },
];
