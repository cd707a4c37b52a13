//! The reference of a desired trajectory, with its own acceleration fed forward.

use vehicle::frame::{Euler, Frd, Ned, wrap_angle};

use super::desire::{Push, Weight};
use super::reference::{FeedForward, ReferenceSource};
use super::trajectory::{DesiredPoint, Trajectory};
use crate::setpoint::{Expected, Reference, Setpoint};

/// Half of the interval for the attitude's derivative, s.
const SLOPE_S: f64 = 0.02;

/// Position and velocity as desired, and the attitude, body rate and thrust that produce the
/// desired acceleration against the known drag. A quadrotor is differentially flat (Mellinger and
/// Kumar 2011), also with drag linear in the velocity (Faessler, Franchi, Scaramuzza 2018). The
/// input leads by its delay. The reference needs no model beyond weight, drag and delay.
#[derive(Clone, Debug)]
pub struct FlatReference {
    trajectory: Trajectory,
    weight: Weight,
    drag_kg_s: [f64; 2],
    attitude_delay_s: f64,
    thrust_delay_s: f64,
}

impl FlatReference {
    /// Follows `trajectory`.
    pub fn new(trajectory: Trajectory, feed_forward: &FeedForward) -> Self {
        let FeedForward {
            mass_kg,
            gravity,
            drag_kg_s,
            tilt_max_rad,
            attitude_delay_s,
            thrust_delay_s,
        } = *feed_forward;
        let weight = Weight { mass_kg, gravity, push: Push::default(), tilt_max_rad };
        Self { trajectory, weight, drag_kg_s, attitude_delay_s, thrust_delay_s }
    }

    /// Acceleration from drag at a point flown in `attitude`, m/s^2.
    fn drag(&self, point: &DesiredPoint, attitude: Euler) -> Ned {
        let [across, along] = self.drag_kg_s.map(|drag| -drag / self.weight.mass_kg);
        let attitude = attitude.attitude();
        let flow: Frd = attitude.to_body(point.velocity);
        attitude.to_world(flow.scale_by([across, across, along]))
    }

    /// Thrust and attitude that produce the acceleration at `t`, and the drag that they compensate.
    /// Drag turns with the attitude, by so little that two iterations suffice.
    fn carry(&self, t: f64) -> (f64, Euler, Ned) {
        let point = self.trajectory.sample(t);
        let mut drag = Ned::zero();
        let against = |drag: Ned| {
            let acceleration = point.acceleration - drag;
            self.weight.carry(&DesiredPoint { acceleration, ..point })
        };
        for _ in 0..2 {
            drag = self.drag(&point, against(drag).1);
        }
        let (thrust_n, attitude) = against(drag);
        (thrust_n, attitude, drag)
    }

    /// The input that produces the acceleration and the rotation at `t`.
    fn input(&self, t: f64) -> Setpoint {
        let (thrust_n, attitude, _) = self.carry(t);
        let ((_, before, _), (_, after, _)) = (self.carry(t - SLOPE_S), self.carry(t + SLOPE_S));
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

    fn expected(&self, t: f64) -> Option<Expected> {
        let (_, _, acceleration) = self.carry(t);
        Some(Expected { acceleration, ..Expected::default() })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn flat_input_yields_the_acceleration_against_drag() {
        let text = "family = 'figure-8'\naltitude_m = 1.0\nduration_s = 10.0\nlength_m = 4.0\n\
                    width_m = 2.0\nclimb_m = 0.5\nperiod_s = 5.0";
        let trajectory = Trajectory::parse(text, Path::new("test.toml")).expect("a trajectory");
        let (mass_kg, gravity, drag_kg_s) = (1.2, 9.81, [0.9, 0.4]);
        let feed_forward = FeedForward {
            mass_kg,
            gravity,
            drag_kg_s,
            tilt_max_rad: 0.8,
            attitude_delay_s: 0.0,
            thrust_delay_s: 0.0,
        };
        let reference = FlatReference::new(trajectory.clone(), &feed_forward);
        for tenth in 10..90 {
            let t = f64::from(tenth) * 0.1;
            let Setpoint { thrust_n, attitude, .. } = reference.sample(t).feedforward;
            let point = trajectory.sample(t);
            let flow = attitude.attitude().to_body(point.velocity);
            let [xy, z] = drag_kg_s;
            let force = Frd::new(0.0, 0.0, -thrust_n) - flow.scale_by([xy, xy, z]);
            let made =
                attitude.attitude().to_world(force) * (1.0 / mass_kg) + Ned::new(0.0, 0.0, gravity);
            let missed = (made - point.acceleration).norm();
            assert!(missed < 0.05, "{missed} m/s^2 at {t} s");
            let expected = reference.expected(t).expect("drag is known").acceleration;
            let drag = attitude.attitude().to_world(flow.scale_by([-xy, -xy, -z]));
            assert!((expected - drag * (1.0 / mass_kg)).norm() < 0.05, "{expected:?} at {t} s");
        }
    }
}
