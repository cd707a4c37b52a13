//! The reference of a desired trajectory with its own acceleration fed forward.

use sitl::frame::{Euler, wrap_angle};

use super::desire::Weight;
use super::reference::{FeedForward, ReferenceSource};
use super::trajectory::Trajectory;
use crate::setpoint::{Reference, Setpoint};

/// Half of the time over which the attitude's slope is taken, s.
const SLOPE_S: f64 = 0.02;

/// Position and velocity as desired, and attitude, body rate and thrust that make the desired
/// acceleration of a vehicle without drag: a quadrotor is differentially flat (Mellinger and Kumar
/// 2011). The input is that of as much later as it takes to act. No model is needed for it beyond
/// weight and delay.
#[derive(Clone, Debug)]
pub struct FlatReference {
    trajectory: Trajectory,
    weight: Weight,
    attitude_delay_s: f64,
    thrust_delay_s: f64,
}

impl FlatReference {
    /// Along `trajectory`.
    pub fn new(trajectory: Trajectory, feed_forward: &FeedForward) -> Self {
        let FeedForward { mass_kg, gravity, tilt_max_rad, attitude_delay_s, thrust_delay_s } =
            *feed_forward;
        let weight = Weight { mass_kg, gravity, tilt_max_rad };
        Self { trajectory, weight, attitude_delay_s, thrust_delay_s }
    }

    /// The input that makes the acceleration and the turn of `t`.
    fn input(&self, t: f64) -> Setpoint {
        let at = |t: f64| self.weight.carry(&self.trajectory.sample(t));
        let (thrust_n, attitude) = at(t);
        let ((_, before), (_, after)) = (at(t - SLOPE_S), at(t + SLOPE_S));
        let slope = |before: f64, after: f64| (after - before) / (2.0 * SLOPE_S);
        let body_rate = attitude.body_rate([
            slope(before.roll, after.roll),
            slope(before.pitch, after.pitch),
            slope(before.yaw, after.yaw),
        ]);
        let attitude = Euler::new(attitude.roll, attitude.pitch, wrap_angle(attitude.yaw));
        Setpoint { thrust_n, attitude, body_rate }
    }
}

impl ReferenceSource for FlatReference {
    fn duration(&self) -> f64 {
        self.trajectory.duration()
    }

    fn sample(&self, t: f64) -> Reference {
        let point = self.trajectory.sample(t);
        let Setpoint { attitude, body_rate, .. } = self.input(t);
        Reference {
            position: point.position,
            velocity: point.velocity,
            attitude,
            body_rate,
            feedforward: Setpoint {
                thrust_n: self.input(t + self.thrust_delay_s).thrust_n,
                ..self.input(t + self.attitude_delay_s)
            },
        }
    }
}
