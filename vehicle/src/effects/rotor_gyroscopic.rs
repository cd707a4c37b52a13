//! Rotor gyroscopic: M_body += -omega x h - dh/dt with the rotors' angular momentum
//! h = -J sum(spin_i w_i) along z body, w_i = rotor_max_rpm 2 pi / 60 n_i.
//!
//! The effect needs rotor_max_rpm in the vehicle file.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::params::VehicleParams;

/// Angular momentum of the rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorGyroscopic {
    /// Moment of inertia of one rotor about its axis in kg m^2.
    pub rotor_inertia_kgm2: f64,
}

impl Effect for RotorGyroscopic {
    const ID: EffectId = EffectId::RotorGyroscopic;
    const SPEC: Spec = Spec {
        id: "rotor_gyroscopic",
        parameters: &[Parameter::scalar("rotor_inertia_kgm2", "kg m^2", 0.0, [0.0, 0.1])],
        needs: &[Need::Moment, Need::FastOutputs],
        // Four such rotors, spun from rest to full speed, turn the yaw inertia at 30 rad/s.
        typical: |vehicle| slots([7.5 * vehicle.inertia[2] / rotor_speed_max(vehicle)]),
        strong: |vehicle, _, growth| {
            growth.by[0] = 30.0 * vehicle.inertia[2] / rotor_speed_max(vehicle);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[rotor_inertia_kgm2, ..]: &Slots) -> Self {
        Self { rotor_inertia_kgm2 }
    }
}

/// Speed of the rotors at full output, rad/s; 10 000 rpm where the file has none.
fn rotor_speed_max(vehicle: &VehicleParams) -> f64 {
    vehicle.rotor_max_rpm.unwrap_or(1e4) * std::f64::consts::TAU / 60.0
}
