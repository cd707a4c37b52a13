//! Thrust curve: T_i = thrust_max ((1 - a) s_i + a s_i^2).
//!
//! a is 0 where the thrust is linear in the output, and near 1 where the rotor speed is.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::scalar::Scalar;

/// Nonlinearity of the thrust over the rotor's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThrustCurve {
    /// Share of the quadratic term.
    pub a: f64,
}

impl Effect for ThrustCurve {
    const ID: EffectId = EffectId::ThrustCurve;
    const SPEC: Spec = Spec {
        id: "thrust_curve",
        parameters: &[Parameter::scalar("a", "-", 0.0, [-1.0, 1.0])],
        needs: &[Need::Input, Need::Motion],
        typical: |_| slots([0.4]),
        strong: |_, _, growth| growth.by[0] = 0.7,
        ..Spec::PLAIN
    };

    fn from_slots(&[a, ..]: &Slots) -> Self {
        Self { a }
    }
}

impl ThrustCurve {
    /// Thrust as a fraction of the maximum, at rotor state `s`.
    #[inline(always)]
    pub fn fraction<T: Scalar>(&self, s: T) -> T {
        s * (s * self.a + (1.0 - self.a))
    }
}
