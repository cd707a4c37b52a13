//! Rotor gyroscopic: M_body += -omega x h - dh/dt with the rotors' angular momentum
//! h = -J sum(spin_i w_i) along z body, w_i = rotor_max_rpm 2 pi / 60 n_i.
//!
//! Needs the vehicle's rotor_max_rpm; without it the effect cannot act.

use super::{Effect, EffectId, Parameter, Slots, Spec};

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
    };

    fn from_slots(&[rotor_inertia_kgm2, ..]: &Slots) -> Self {
        Self { rotor_inertia_kgm2 }
    }
}
