//! Position hold: position -> velocity -> acceleration -> attitude and collective thrust, with the
//! firmware's nominal numbers.

use vehicle::frame::{Euler, Ned, wrap_angle};

use super::parameters::{Key, Parameters};

/// Gains from position error to velocity for north, east and down, 1/s.
const POSITION_P: [f64; 3] = [0.95, 0.95, 1.0];
/// Gains from velocity error to acceleration for north, east and down, 1/s.
const VELOCITY_P: [f64; 3] = [2.4, 2.4, 4.0];
/// Gains from integrated velocity error to acceleration, 1/s^2. They compensate wind and a wrong
/// hover thrust.
const VELOCITY_I: [f64; 3] = [0.6, 0.6, 2.0];
/// Bound on the integral's acceleration, as a fraction of gravity.
const INTEGRAL_MAX: f64 = 0.8;
/// Smallest collective output in the air, which preserves authority over the attitude.
const THRUST_MIN: f64 = 0.08;
/// Largest collective output that position control commands; the rest is for the attitude.
const THRUST_MAX: f64 = 0.92;

/// Position, velocity and heading to track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionTarget {
    /// Position on each axis, m; on an axis with `None`, only the velocity is tracked.
    pub position: [Option<f64>; 3],
    /// Velocity, m/s; the feed-forward on axes with a position.
    pub velocity: Ned,
    /// Heading, rad.
    pub yaw: f64,
}

impl PositionTarget {
    /// Holds `position` and the heading `yaw`.
    pub fn hold(position: Ned, yaw: f64) -> Self {
        Self { position: position.to_array().map(Some), velocity: Ned::zero(), yaw }
    }
}

/// Attitude and collective thrust, the output of the position controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TiltAndThrust {
    /// Desired attitude.
    pub attitude: Euler,
    /// Collective thrust, 0..1 of the rotors' sum.
    pub thrust: f64,
}

/// The cascade with its only state, the integral of the velocity error.
#[derive(Clone, Debug)]
pub struct PositionController {
    gravity: f64,
    integral: [f64; 3],
}

impl PositionController {
    /// Creates a controller with a zero integral; `gravity` is in m/s^2.
    pub fn new(gravity: f64) -> Self {
        Self { gravity, integral: [0.0; 3] }
    }

    /// Resets the integral.
    pub fn reset(&mut self) {
        self.integral = [0.0; 3];
    }

    /// Runs one tick, `dt` s after the previous one.
    pub fn update(
        &mut self,
        target: &PositionTarget,
        position: Ned,
        velocity: Ned,
        parameters: &Parameters,
        dt: f64,
    ) -> TiltAndThrust {
        let desired_velocity = self.desired_velocity(target, position, parameters);
        let error = (desired_velocity - velocity).to_array();
        let limit = INTEGRAL_MAX * self.gravity;
        let desired: [f64; 3] = std::array::from_fn(|axis| {
            self.integral[axis] =
                (self.integral[axis] + VELOCITY_I[axis] * error[axis] * dt).clamp(-limit, limit);
            VELOCITY_P[axis] * error[axis] + self.integral[axis]
        });
        self.tilt_and_thrust(desired, target.yaw, parameters)
    }

    fn desired_velocity(
        &self,
        target: &PositionTarget,
        position: Ned,
        parameters: &Parameters,
    ) -> Ned {
        let here = position.to_array();
        let forward = target.velocity.to_array();
        let [north, east, down]: [f64; 3] = std::array::from_fn(|axis| {
            let from_position =
                target.position[axis].map_or(0.0, |there| POSITION_P[axis] * (there - here[axis]));
            from_position + forward[axis]
        });
        let limit = parameters.get(Key::MpcXyVelMax);
        let scale = (limit / north.hypot(east).max(limit)).min(1.0);
        let (up, dn) = (parameters.get(Key::MpcZVelMaxUp), parameters.get(Key::MpcZVelMaxDn));
        Ned::new(north * scale, east * scale, down.clamp(-up, dn))
    }

    /// The attitude whose -z axis points along the specific force `a - g`, and the matching thrust.
    /// If the tilt limit is active, the vertical component has precedence.
    fn tilt_and_thrust(
        &self,
        [north, east, down]: [f64; 3],
        yaw: f64,
        parameters: &Parameters,
    ) -> TiltAndThrust {
        let up = (self.gravity - down).max(0.1 * self.gravity);
        let tilt_max = parameters.get(Key::MpcTiltMaxAir).to_radians();
        let horizontal = north.hypot(east);
        let scale = (up * tilt_max.tan() / horizontal.max(1e-9)).min(1.0);
        let (sin, cos) = yaw.sin_cos();
        let (forward, right) =
            ((north * cos + east * sin) * scale, (east * cos - north * sin) * scale);
        // z-y-x: pitch tilts the force in the plane of the heading, then roll tilts it sideways.
        let pitch = (-forward).atan2(up);
        let roll = right.atan2(forward.hypot(up));
        let force = forward.hypot(up).hypot(right);
        let hover = parameters.get(Key::MpcThrHover);
        TiltAndThrust {
            attitude: Euler::new(roll, pitch, wrap_angle(yaw)),
            thrust: (hover * force / self.gravity).clamp(THRUST_MIN, THRUST_MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing::parameters;
    use proptest::prelude::*;
    use vehicle::frame::Frd;

    #[test]
    fn controller_hovers_level_at_the_target() {
        let parameters = parameters();
        let mut controller = PositionController::new(9.81);
        let here = Ned::new(1.0, 2.0, -3.0);
        let target = PositionTarget::hold(here, 0.7);
        let out = controller.update(&target, here, Ned::zero(), &parameters, 0.004);
        assert!(out.attitude.roll.abs() < 1e-12 && out.attitude.pitch.abs() < 1e-12);
        assert!((out.thrust - parameters.get(Key::MpcThrHover)).abs() < 1e-6);
    }

    proptest! {
        /// At any heading, the force tilts towards the target and the tilt stays within its limit.
        #[test]
        fn force_points_towards_the_target(north in -9.0..9.0f64, east in -9.0..9.0f64, yaw in -3.1..3.1f64) {
            prop_assume!(north.hypot(east) > 0.1);
            let parameters = parameters();
            let mut controller = PositionController::new(9.81);
            let target = PositionTarget::hold(Ned::new(north, east, 0.0), yaw);
            let out = controller.update(&target, Ned::zero(), Ned::zero(), &parameters, 0.004);
            let attitude = out.attitude.attitude();
            let force = attitude.to_world(Frd::new(0.0, 0.0, -1.0));
            let cross = force.north() * east - force.east() * north;
            prop_assert!(cross.abs() < 1e-9);
            prop_assert!(force.north() * north + force.east() * east > 0.0);
            prop_assert!(attitude.tilt() <= 35f64.to_radians() + 1e-9);
        }
    }
}
