//! Which limits cut the setpoints along a trajectory.

use schemars::JsonSchema;
use serde::Serialize;

use crate::control::Saturation;

/// A limit that cuts more than this share of a flight's setpoints is no exception.
const OFTEN: f64 = 0.2;

/// Ticks along a trajectory, and those in which a limit cut the setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize)]
pub struct LimitedTicks {
    /// Ticks along the trajectory.
    pub ticks: u64,
    /// The distance that feedback answers was cut.
    pub position_error: u64,
    /// Collective thrust was.
    pub thrust: u64,
    /// Tilt was.
    pub tilt: u64,
    /// The distance of the desired from the present yaw was.
    pub yaw_error: u64,
    /// A body rate was.
    pub body_rate: u64,
}

impl LimitedTicks {
    /// Of ticks by their [`Saturation::bits`].
    pub(super) fn count(ticks: impl Iterator<Item = u32>) -> Self {
        let mut counted = Self::default();
        for bits in ticks {
            let met = Saturation::from_bits(bits);
            counted.ticks += 1;
            counted.position_error += u64::from(met.position_error);
            counted.thrust += u64::from(met.thrust);
            counted.tilt += u64::from(met.tilt);
            counted.yaw_error += u64::from(met.yaw_error);
            counted.body_rate += u64::from(met.body_rate);
        }
        counted
    }

    /// What a limit that was met often tells; `None` where none was.
    pub fn often(&self) -> Option<String> {
        let limits = [
            ("tilt", self.tilt),
            ("thrust", self.thrust),
            ("body rate", self.body_rate),
            ("yaw error", self.yaw_error),
            ("position error", self.position_error),
        ];
        let share = |cut: u64| cut as f64 / self.ticks.max(1) as f64;
        let met: Vec<String> = limits
            .iter()
            .filter(|(_, cut)| share(*cut) > OFTEN)
            .map(|(limit, cut)| format!("the {limit} limit cut {:.0} %", 100.0 * share(*cut)))
            .collect();
        (!met.is_empty()).then(|| {
            format!(
                "{} of the setpoints along the trajectory: feedback swings from limit to limit \
                 where the vehicle file does not describe this vehicle (its mass, inertia, thrust \
                 or attitude loop), or the trajectory demands more, in a wind above all, than \
                 [offboard.limits] allow",
                met.join(", ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_frequently_hit_limits_are_named() {
        let tilt = Saturation { tilt: true, ..Saturation::default() }.bits();
        let thrust = Saturation { thrust: true, ..Saturation::default() }.bits();
        let ticks = (0..100).map(|k| if k % 4 == 0 { tilt } else { 0 });
        let counted = LimitedTicks::count(ticks.chain([thrust]));
        assert_eq!((counted.ticks, counted.tilt, counted.thrust), (101, 25, 1));
        let words = counted.often().expect("often");
        assert!(
            words.contains("the tilt limit cut 25 %") && !words.contains("thrust limit"),
            "{words}"
        );
        assert_eq!(LimitedTicks::count([thrust, 0, 0, 0, 0, 0].into_iter()).often(), None);
    }
}
