//! Battery sag: thrust and squared rotor speed are multiplied by (V / full_V)^exponent, V the
//! pack's terminal voltage.
//!
//! The exponent is 2 for a voltage-driven motor at a fixed duty cycle, 0 for a speed controller
//! that compensates.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};

/// Dependence of the thrust on the pack's voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BatterySag {
    /// Exponent of the voltage ratio.
    pub exponent: f64,
}

impl Effect for BatterySag {
    const ID: EffectId = EffectId::BatterySag;
    const SPEC: Spec = Spec {
        id: "battery_sag",
        parameters: &[Parameter::scalar("exponent", "-", 0.0, [-1.0, 6.0])],
        needs: &[Need::Input, Need::Motion, Need::Voltage],
        typical: |_| slots([1.5]),
        strong: |_, _, growth| growth.by[0] = 2.5,
        ..Spec::PLAIN
    };

    fn from_slots(&[exponent, ..]: &Slots) -> Self {
        Self { exponent }
    }
}

impl BatterySag {
    /// Factor on thrust and squared rotor speed at `voltage_ratio` = V / full_V.
    pub fn factor(&self, voltage_ratio: f64) -> f64 {
        voltage_ratio.max(0.0).powf(self.exponent)
    }
}
