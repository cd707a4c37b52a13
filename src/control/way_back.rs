//! The path back to the reference after a change: it recovers the offset that built up until the
//! change was known.

use vehicle::frame::{Euler, Frd, Heading, Ned};

use super::hover_model::HoverVehicle;
use crate::setpoint::{Reference, Setpoint, State};

/// Duration of the path, s: the acceleration that recovers the offset after a gust is then a tenth
/// of the weight.
const DURATION_S: f64 = 1.0;
/// Beyond this offset, feedback alone returns the vehicle, m.
const OFFSET_MAX_M: f64 = 0.5;

/// A polynomial of the fifth degree from an offset of position and velocity to zero: the
/// minimum-jerk path between them. The reference follows it, with the matching tilt and thrust, so
/// feedback sees only the deviation from the path.
#[derive(Clone, Copy, Debug)]
pub(super) struct WayBack {
    from_s: f64,
    position: Ned,
    velocity: Ned,
}

impl WayBack {
    /// From the offset of `state` from `reference` at `from_s`; `None` if that is large.
    pub fn from(from_s: f64, state: &State, reference: &Reference) -> Option<Self> {
        let position = state.position - reference.position;
        let velocity = state.velocity - reference.velocity;
        let is_near = position.norm() + velocity.norm() * DURATION_S < OFFSET_MAX_M;
        is_near.then_some(Self { from_s, position, velocity })
    }

    /// Offset, its velocity, acceleration and jerk at `time_s`.
    fn at(&self, time_s: f64) -> [Ned; 4] {
        let x = ((time_s - self.from_s) / DURATION_S).clamp(0.0, 1.0);
        let (p, v) = (self.position, self.velocity * DURATION_S);
        let [p3, p4, p5] = [p * -10.0 + v * -6.0, p * 15.0 + v * 8.0, p * -6.0 + v * -3.0];
        let slope = 1.0 / DURATION_S;
        [
            p + v * x + (p3 + (p4 + p5 * x) * x) * x.powi(3),
            (v + (p3 * 3.0 + (p4 * 4.0 + p5 * (5.0 * x)) * x) * x.powi(2)) * slope,
            (p3 * 6.0 + (p4 * 12.0 + p5 * (20.0 * x)) * x) * (x * slope.powi(2)),
            (p3 * 6.0 + (p4 * 24.0 + p5 * (60.0 * x)) * x) * slope.powi(3),
        ]
    }

    /// Whether the path has ended.
    pub fn is_over(&self, time_s: f64) -> bool {
        time_s >= self.from_s + DURATION_S
    }

    /// `reference` along the path at `time_s`, for a vehicle at the heading `yaw`. Its input leads
    /// by `lead_s`, because attitude and thrust respond late.
    pub fn along(
        &self,
        time_s: f64,
        lead_s: f64,
        reference: &Reference,
        vehicle: &HoverVehicle,
        yaw: f64,
    ) -> Reference {
        let [position, velocity, acceleration, jerk] = self.at(time_s);
        let [_, _, ahead, ahead_jerk] = self.at(time_s + lead_s);
        let heading = Heading::new(yaw);
        let tilt = |a: Ned| {
            let [front, right, _] = heading.to_level(a);
            // Nose down accelerates ahead, right side down to the right.
            [right / vehicle.gravity, -front / vehicle.gravity]
        };
        let ([roll, pitch], [roll_ahead, pitch_ahead]) = (tilt(acceleration), tilt(ahead));
        let ([roll_rate, pitch_rate], [p, q]) = (tilt(jerk), tilt(ahead_jerk));
        let mut moved = *reference;
        moved.position += position;
        moved.velocity += velocity;
        moved.attitude.roll += roll;
        moved.attitude.pitch += pitch;
        moved.body_rate += Frd::new(roll_rate, pitch_rate, 0.0);
        moved.feedforward = moved.feedforward.plus(Setpoint {
            thrust_n: -vehicle.mass_kg * ahead.down(),
            attitude: Euler::new(roll_ahead, pitch_ahead, 0.0),
            body_rate: Frd::new(p, q, 0.0),
        });
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn way_back_starts_at_the_offset_and_ends_on_the_reference() {
        let state = State {
            position: Ned::new(0.1, -0.05, 0.02),
            velocity: Ned::new(0.2, 0.1, -0.1),
            ..State::default()
        };
        let way = WayBack::from(3.0, &state, &Reference::default()).expect("near");
        let [position, velocity, acceleration, _] = way.at(3.0);
        assert!((position - state.position).norm() < 1e-12);
        assert!((velocity - state.velocity).norm() < 1e-12 && acceleration.norm() < 1e-12);
        let end = way.at(4.0);
        assert!(end[..3].iter().all(|left| left.norm() < 1e-12), "{end:?}");
        assert!(way.is_over(4.0) && !way.is_over(3.9));
        // Each is the derivative of the one before.
        let h = 1e-5;
        for t in [3.1, 3.5, 3.9] {
            let (now, before, after) = (way.at(t), way.at(t - h), way.at(t + h));
            for i in 0..3 {
                let slope = (after[i] - before[i]) * (0.5 / h);
                assert!((slope - now[i + 1]).norm() < 1e-3, "{i} at {t}");
            }
        }
    }

    #[test]
    fn far_offset_is_left_to_feedback() {
        let far = State { position: Ned::new(0.6, 0.0, 0.0), ..State::default() };
        assert!(WayBack::from(0.0, &far, &Reference::default()).is_none());
    }
}
