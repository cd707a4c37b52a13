//! Rotor drag: F_body = -nr (d_xy v_ax, d_xy v_ay, d_z v_az).
//!
//! Induced drag and blade flapping, linear in the air-relative velocity and proportional to the
//! rotor speed (Faessler, Franchi, Scaramuzza 2018; Foerster 2015).

use super::{BodyEffect, Effect, EffectId, Flow, Need, Parameter, Slots, Spec, Wrench, slots};
use crate::scalar::Scalar;

/// Drag of the spinning rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorDrag {
    /// Coefficient along front and right, at the hover rotor speed, in kg/s.
    pub d_xy: f64,
    /// Coefficient along down, at the hover rotor speed, in kg/s.
    pub d_z: f64,
}

impl Effect for RotorDrag {
    const ID: EffectId = EffectId::RotorDrag;
    const SPEC: Spec = Spec {
        id: "rotor_drag",
        parameters: &[
            Parameter::scalar("d_xy", "kg/s", 0.0, [0.0, 100.0]),
            Parameter::scalar("d_z", "kg/s", 0.0, [0.0, 100.0]),
        ],
        needs: &[Need::Pose, Need::Input],
        // Drag time constants of 3 s along the discs and 6 s across them.
        typical: |vehicle| slots([vehicle.mass / 3.0, vehicle.mass / 6.0]),
        strong: |vehicle, chance, growth| {
            growth.by[0] = vehicle.mass * chance.within([0.4, 0.7]);
            growth.by[1] = growth.by[0] * chance.within([0.2, 0.6]);
        },
        judged: &[&["d_xy"]],
        ..Spec::PLAIN
    };

    fn from_slots(&[d_xy, d_z, ..]: &Slots) -> Self {
        Self { d_xy, d_z }
    }
}

impl BodyEffect for RotorDrag {
    const READS_ROTOR_SPEED: bool = true;

    #[inline(always)]
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>) {
        let xy = flow.rotor_speed_ratio * -self.d_xy;
        let z = flow.rotor_speed_ratio * -self.d_z;
        wrench.force += flow.air_relative.scale_by([xy, xy, z]);
    }
}
