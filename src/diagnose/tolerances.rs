//! How well a vehicle file's numbers are known, and how large effects typically are, in a vehicle's
//! own units.

use sitl::effects::EffectId;
use sitl::vehicle::{ROTORS, VehicleParams};

/// Sizes that turn dimensionless tolerances and magnitudes into a vehicle's units.
pub(super) struct Scales {
    mass: f64,
    arm: f64,
    weight: f64,
    yaw_inertia: f64,
    drag_modelled: Option<[f64; 2]>,
    parasitic_modelled: Option<f64>,
    sag_modelled: Option<f64>,
    curve_modelled: Option<f64>,
    rotor_radius: f64,
    air_density: f64,
    rotor_speed_max: f64,
}

/// Tolerance of the thrust, of all rotors and of each, as a share: a load cell's.
pub(super) const THRUST: f64 = 0.003;
/// Tolerance of the delay from a logged output to its thrust, s: half a period of logs that are
/// written at 250 Hz.
pub(super) const OUTPUT_DELAY_S: f64 = 0.002;
/// Tolerance of the moment against the body rate: so much of kp times a tick, and so much of the
/// inertia per second.
pub(super) const DAMPING_TIME_S: f64 = 0.002;
pub(super) const DAMPING_RATE: f64 = 0.1;
/// Tolerance of an effect's value that the vehicle file models, as a share: what a careful
/// identification leaves.
const MODELLED_TOLERANCE: f64 = 0.03;

impl Scales {
    pub fn of(vehicle: &VehicleParams) -> Self {
        let arms = vehicle.rotors.map(|r| r.position_m[0].hypot(r.position_m[1]));
        let effects = &vehicle.modelled_effects;
        let value = |id, slot: usize| effects.slots(id).map(|slots| slots[slot]);
        Self {
            mass: vehicle.mass,
            arm: arms.iter().sum::<f64>() / ROTORS as f64,
            weight: vehicle.mass * vehicle.gravity,
            yaw_inertia: vehicle.inertia[2],
            // The exact linear drag is not a tolerance of rotor_drag's.
            drag_modelled: vehicle
                .linear_drag_n_per_m_s
                .is_none()
                .then(|| effects.slots(EffectId::RotorDrag).map(|s| [s[0], s[1]]))
                .flatten(),
            parasitic_modelled: value(EffectId::ParasiticDrag, 0),
            sag_modelled: value(EffectId::BatterySag, 0),
            curve_modelled: value(EffectId::ThrustCurve, 0),
            rotor_radius: vehicle.rotor_radius_m,
            air_density: vehicle.air_density,
            rotor_speed_max: vehicle.rotor_max_rpm.unwrap_or(0.0) * std::f64::consts::TAU / 60.0,
        }
    }

    /// Tolerance and magnitude of a slot that may be fitted.
    pub fn of_slot(&self, effect: EffectId, slot: usize) -> Option<[f64; 2]> {
        use EffectId::*;
        let modelled = |value: Option<f64>| value.map_or(0.0, |v| MODELLED_TOLERANCE * v.abs());
        Some(match (effect, slot) {
            (ThrustScale, 0) => [THRUST, 0.15],
            (Mass, 0) => [0.0, 0.15 * self.mass],
            (ThrustCurve, 0) => [modelled(self.curve_modelled), 0.4],
            (BatterySag, 0) => [modelled(self.sag_modelled), 1.5],
            (MotorLag, 0) => [0.001, 0.04],
            (CommandDelay, 0) => [0.0015, 0.03],
            // A time constant of drag of three seconds.
            (RotorDrag, 0) => [modelled(self.drag_modelled.map(|d| d[0])), self.mass / 3.0],
            (RotorDrag, 1) => [modelled(self.drag_modelled.map(|d| d[1])), self.mass / 6.0],
            // A tenth of the weight at 8 m/s.
            (ParasiticDrag, 0) => [
                modelled(self.parasitic_modelled),
                0.1 * self.weight / (0.5 * self.air_density * 64.0),
            ],
            (Wind, 0 | 1) => [0.03, 4.0],
            // A steady wind blows along the floor.
            (Wind, 2) => [0.03, 0.2],
            (GroundEffect, 0) => [0.0, 4.0 * self.rotor_radius],
            (TranslationalLift, 0) => [0.0, 0.005],
            // A tenth of the weight at a tenth of the arm per m/s.
            (BladeFlapping, 0) => [0.0, 0.01 * self.weight * self.arm],
            (BladeFlapping, 1) => [0.0, 0.01],
            (VortexRing, 0) => [0.0, 0.3],
            (Inertia, 0..=2) => [0.017, 0.35],
            (ComOffset, 0 | 1) => [0.001 * self.arm, 0.05 * self.arm],
            // The four rotors from rest to full speed against the yaw inertia: 30 rad/s of yaw.
            (RotorGyroscopic, 0) => [0.0, 7.5 * self.yaw_inertia / self.rotor_speed_max],
            (YawTorque, 0) => [0.01, 0.35],
            (AttitudeTrim, 0 | 1) => [0.0007, 0.03],
            (AttitudeTrim, 2) => [0.002, 0.03],
            (EstimatorLatency, 0) => [0.0007, 0.04],
            (PdGain, 0..=5) => [0.01, 0.3],
            _ => return None,
        })
    }
}
