//! Blade flapping: M_body += moment nr (-v_ay, v_ax, 0), F_body += -T tilt (v_ax, v_ay, 0).
//!
//! The advancing blade lifts more. The rotor disc tilts away from the oncoming air and pitches the
//! vehicle up against its motion (Hoffmann et al. 2007).

use super::{BodyEffect, Effect, EffectId, Flow, Need, Parameter, Slots, Spec, Wrench, slots};
use crate::frame::Frd;
use crate::scalar::Scalar;

/// Moment and force of the flapping rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BladeFlapping {
    /// Moment at the hover rotor speed in N m per m/s.
    pub moment_nms_m: f64,
    /// Tilt of the thrust vector in rad per m/s.
    pub tilt_rad_s_m: f64,
}

impl Effect for BladeFlapping {
    const ID: EffectId = EffectId::BladeFlapping;
    const SPEC: Spec = Spec {
        id: "blade_flapping",
        parameters: &[
            Parameter::scalar("moment_Nms_m", "N m per m/s", 0.0, [-10.0, 10.0]),
            Parameter::scalar("tilt_rad_s_m", "rad per m/s", 0.0, [-1.0, 1.0]),
        ],
        needs: &[Need::Pose, Need::Moment],
        // A tenth of the weight at a tenth of the arm per m/s.
        typical: |vehicle| slots([0.01 * vehicle.weight_n() * vehicle.arm_m(), 0.01]),
        strong: |vehicle, chance, growth| {
            let moment = 0.03 * vehicle.weight_n() * vehicle.arm_m();
            growth.by[0] = moment * chance.within([0.5, 1.0]);
            growth.by[1] = 0.03 * chance.within([0.3, 1.0]);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[moment_nms_m, tilt_rad_s_m, ..]: &Slots) -> Self {
        Self { moment_nms_m, tilt_rad_s_m }
    }
}

impl BodyEffect for BladeFlapping {
    const READS_ROTOR_SPEED: bool = true;

    #[inline(always)]
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>) {
        let (x, y) = (flow.air_relative.front(), flow.air_relative.right());
        let moment = flow.rotor_speed_ratio * self.moment_nms_m;
        let tilt = flow.thrust * -self.tilt_rad_s_m;
        wrench.moment += Frd::new(-y * moment, x * moment, T::default());
        wrench.force += Frd::new(x * tilt, y * tilt, T::default());
    }
}
