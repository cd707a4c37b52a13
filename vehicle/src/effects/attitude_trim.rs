//! Attitude trim: reported attitude = true attitude * q(trim), in every message that carries it and
//! in the on-board loop. The IMU stays in the true body axes.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::frame::{Attitude, Euler};

/// A constant error of the reported attitude, in body axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeTrim {
    /// Roll, pitch and yaw of the error, rad.
    pub trim: Euler,
}

impl Effect for AttitudeTrim {
    const ID: EffectId = EffectId::AttitudeTrim;
    const SPEC: Spec = Spec {
        id: "attitude_trim",
        parameters: &[
            Parameter::scalar("roll_rad", "rad", 0.0, [-1.0, 1.0]),
            Parameter::scalar("pitch_rad", "rad", 0.0, [-1.0, 1.0]),
            Parameter::scalar("yaw_rad", "rad", 0.0, [-3.2, 3.2]),
        ],
        needs: &[Need::Attitude],
        typical: |_| slots([0.03; 3]),
        strong: |_, chance, growth| {
            let [roll, pitch] = chance.heading();
            (growth.by[0], growth.by[1]) = (0.06 * roll, 0.06 * pitch);
        },
        judged: &[&["roll_rad", "pitch_rad"]],
        ..Spec::PLAIN
    };

    fn from_slots(&[roll, pitch, yaw, ..]: &Slots) -> Self {
        Self { trim: Euler { roll, pitch, yaw } }
    }
}

impl AttitudeTrim {
    /// The rotation that multiplies the true attitude from the right.
    pub fn rotation(&self) -> Attitude {
        self.trim.attitude()
    }
}
