//! The path on which a moving vehicle comes to rest.

use vehicle::frame::Ned;
use vehicle::rigid_body::State;

use super::segment::Waypoint;
use crate::clock::VehicleTime;
use crate::plan::trajectory::DesiredPoint;

/// Deceleration at the start, m/s^2: a tilt of 0.43 rad.
const DECELERATION: f64 = 4.5;
/// Deceleration of a turn at its start, rad/s^2.
const TURN_DECELERATION: f64 = 2.0;
/// Fastest turn at the start, rad/s.
const TURN_MAX_RAD_S: f64 = 2.0;
/// Fastest start of a stop, m/s, whatever velocity the vehicle reports: it ends 2 m ahead.
const SPEED_MAX_M_S: f64 = 3.67;
/// Shortest duration, s.
const DURATION_MIN_S: f64 = 0.1;

/// A level path from a motion to rest. Velocity and turn fall by `v = v0 (1 - x)^2` with `x = t /
/// T`: the deceleration is largest at the start, and the vehicle is level again when it comes to
/// rest. A law that only pulls it to a place would tilt it the most as its speed passes zero, and
/// an autopilot that then takes over flies off backwards.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stop {
    since: VehicleTime,
    from: Ned,
    velocity: Ned,
    yaw: f64,
    yaw_rate: f64,
    /// Durations of the path and of the turn, s.
    path_s: f64,
    turn_s: f64,
}

impl Stop {
    /// At rest at a place.
    pub fn standing(place: Waypoint, since: VehicleTime) -> Self {
        let Waypoint { position: from, yaw } = place;
        let (path_s, turn_s) = (DURATION_MIN_S, DURATION_MIN_S);
        Self { since, from, velocity: Ned::zero(), yaw, yaw_rate: 0.0, path_s, turn_s }
    }

    /// The stop of a vehicle that moves like `here`, whose climb ends at once.
    pub fn from_motion(here: &State, since: VehicleTime) -> Self {
        let [north, east, _] = here.velocity.to_array();
        let speed = north.hypot(east);
        let share = if speed > SPEED_MAX_M_S { SPEED_MAX_M_S / speed } else { 1.0 };
        let yaw_rate = here.body_rate.down().clamp(-TURN_MAX_RAD_S, TURN_MAX_RAD_S);
        Self {
            since,
            from: here.position,
            velocity: Ned::new(north, east, 0.0) * share,
            yaw: here.attitude.yaw(),
            yaw_rate,
            path_s: (2.0 * share * speed / DECELERATION).max(DURATION_MIN_S),
            turn_s: (2.0 * yaw_rate.abs() / TURN_DECELERATION).max(DURATION_MIN_S),
        }
    }

    /// The motion at a time; at rest from the end on.
    pub fn at(&self, now: VehicleTime) -> DesiredPoint {
        self.after(now.seconds_since(self.since))
    }

    /// Where it ends.
    pub fn end(&self) -> Ned {
        self.after(self.path_s).position
    }

    fn after(&self, t: f64) -> DesiredPoint {
        let left = |duration_s: f64| 1.0 - (t / duration_s).clamp(0.0, 1.0);
        let moved_s = |duration_s: f64| duration_s * (1.0 - left(duration_s).powi(3)) / 3.0;
        let (path, turn) = (self.path_s, self.turn_s);
        DesiredPoint {
            position: self.from + self.velocity * moved_s(path),
            velocity: self.velocity * left(path).powi(2),
            acceleration: self.velocity * (-2.0 * left(path) / path),
            yaw: self.yaw + self.yaw_rate * moved_s(turn),
            yaw_rate: self.yaw_rate * left(turn).powi(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::array::uniform3;
    use proptest::prelude::*;
    use vehicle::frame::Frd;

    use super::*;

    proptest! {
        #[test]
        fn stop_begins_with_the_motion_and_ends_level_and_near(
            velocity in uniform3(-20.0..20.0f64), turn in -6.0..6.0f64, share in 0.0..1.0f64
        ) {
            let [north, east, down] = velocity;
            let state = State {
                position: Ned::new(1.0, 2.0, -3.0),
                velocity: Ned::new(north, east, down),
                body_rate: Frd::new(0.0, 0.0, turn),
                ..State::default()
            };
            let stop = Stop::from_motion(&state, VehicleTime::default());
            let (start, end) = (stop.after(0.0), stop.after(stop.path_s.max(stop.turn_s)));
            let speed = north.hypot(east).min(SPEED_MAX_M_S);
            prop_assert!((start.velocity.norm() - speed).abs() < 1e-9);
            prop_assert!((start.yaw_rate - turn.clamp(-2.0, 2.0)).abs() < 1e-9);
            prop_assert!(end.acceleration.norm() < 1e-9 && end.velocity.norm() < 1e-9);
            prop_assert!(end.yaw_rate.abs() < 1e-9);
            prop_assert!((end.position - start.position).norm() < 2.0);
            prop_assert!((stop.end() - end.position).norm() < 1e-9);
            let t = share * stop.path_s;
            let (here, later) = (stop.after(t), stop.after(t + 1e-6));
            let velocity = (later.position - here.position) * 1e6;
            let acceleration = (later.velocity - here.velocity) * 1e6;
            prop_assert!((velocity - here.velocity).norm() < 1e-4);
            prop_assert!((acceleration - here.acceleration).norm() < 1e-3);
            prop_assert!(((later.yaw - here.yaw) * 1e6 - here.yaw_rate).abs() < 1e-4);
            prop_assert!(here.acceleration.norm() < DECELERATION + 1e-9);
        }
    }
}
