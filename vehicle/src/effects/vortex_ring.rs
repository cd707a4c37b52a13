//! Vortex ring: T <- T (1 - loss_max S exp(-(V_h / v_i)^2)) with
//! S = smoothstep((v_az / v_i - onset) / (full - onset)).
//!
//! A vehicle that descends at the speed of its own wake loses thrust. v_i is the induced velocity
//! at hover, sqrt(m g / (2 rho 4 pi R^2)), with the nominal mass.

use super::{Effect, EffectId, Flow, Need, Parameter, Slots, Spec, ThrustEffect, slots};
use crate::scalar::Scalar;

/// Loss of thrust in descent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VortexRing {
    /// Largest loss as a fraction of the thrust.
    pub loss_max: f64,
    /// Ratio of descent rate to induced velocity at which the loss begins.
    pub onset_ratio: f64,
    /// Ratio of descent rate to induced velocity at which the loss is complete.
    pub full_ratio: f64,
}

impl Effect for VortexRing {
    const ID: EffectId = EffectId::VortexRing;
    const SPEC: Spec = Spec {
        id: "vortex_ring",
        parameters: &[
            Parameter::scalar("loss_max", "-", 0.0, [0.0, 1.0]),
            Parameter::scalar("onset_ratio", "-", 0.2, [-1.0, 3.0]).shape(),
            Parameter::scalar("full_ratio", "-", 0.8, [-1.0, 4.0]).shape(),
        ],
        needs: &[Need::Pose, Need::Input],
        typical: |_| slots([0.3]),
        strong: |_, _, growth| {
            growth.by[0] = 0.7;
            (growth.from[1], growth.from[2]) = (0.2, 0.8);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[loss_max, onset_ratio, full_ratio, ..]: &Slots) -> Self {
        Self { loss_max, onset_ratio, full_ratio }
    }
}

impl ThrustEffect for VortexRing {
    #[inline(always)]
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T {
        let inverse = flow.inverse_induced_velocity;
        let descent = flow.air_relative.down() * inverse + -self.onset_ratio;
        if !descent.is_above(0.0) {
            return T::from(1.0);
        }
        // An interval of zero length is a step.
        let span = self.full_ratio - self.onset_ratio;
        let x = if (-descent).is_above(-span) { descent * (1.0 / span) } else { T::from(1.0) };
        let step = x * x * (x * -2.0 + 3.0);
        let clearing = (flow.horizontal_speed2 * (-inverse * inverse)).exp();
        step * clearing * -self.loss_max + 1.0
    }
}
