//! Wind: steady velocity of the air in world axes, in the direction it blows to; acts through every
//! air-relative term.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::frame::Ned;

/// Steady wind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wind {
    /// Velocity of the air, m/s.
    pub velocity: Ned,
}

impl Effect for Wind {
    const ID: EffectId = EffectId::Wind;
    const SPEC: Spec = Spec {
        id: "wind",
        parameters: &[
            Parameter::scalar("north_m_s", "m/s", 0.0, [-60.0, 60.0]),
            Parameter::scalar("east_m_s", "m/s", 0.0, [-60.0, 60.0]),
            Parameter::scalar("down_m_s", "m/s", 0.0, [-60.0, 60.0]),
        ],
        needs: &[Need::Pose, Need::Input],
        // A steady wind is mostly horizontal.
        typical: |_| slots([4.0, 4.0, 0.2]),
        strong: |_, chance, growth| {
            let [north, east] = chance.heading();
            (growth.by[0], growth.by[1]) = (8.0 * north, 8.0 * east);
        },
        judged: &[&["north_m_s", "east_m_s"]],
        ..Spec::PLAIN
    };

    fn from_slots(&[north, east, down, ..]: &Slots) -> Self {
        Self { velocity: Ned::new(north, east, down) }
    }
}
