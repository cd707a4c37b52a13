//! The rigid body: its state, the Newton-Euler equations, and their integration.

use crate::frame::{Attitude, Frd, Ned};
use crate::scalar::Scalar;

/// State of the vehicle as a rigid body: position and velocity of the centre of mass in world NED,
/// attitude from body to world, and body rate. SI units, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State<T = f64>
where
    T: Scalar,
{
    /// Position in world axes, m.
    pub position: Ned<T>,
    /// Velocity in world axes, m/s.
    pub velocity: Ned<T>,
    /// Rotation from body to world.
    pub attitude: Attitude<T>,
    /// Angular velocity of the body relative to the world in body axes, rad/s.
    pub body_rate: Frd<T>,
}

impl State {
    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        let q = self.attitude;
        self.position.is_finite()
            && self.velocity.is_finite()
            && self.body_rate.is_finite()
            && [q.w, q.x, q.y, q.z].iter().all(|c| c.is_finite())
    }
}

/// Mass, inertia and gravity of a body whose axes are principal axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    mass: f64,
    inertia: [f64; 3],
    gravity: f64,
    inverse_mass: f64,
    inverse_inertia: [f64; 3],
}

impl RigidBody {
    /// A body of `mass` (kg) and principal moments of inertia (kg m^2), both positive, under
    /// `gravity` (m/s^2) towards down.
    pub fn new(mass: f64, inertia: [f64; 3], gravity: f64) -> Self {
        let inverse_inertia = inertia.map(f64::recip);
        Self { mass, inertia, gravity, inverse_mass: mass.recip(), inverse_inertia }
    }

    /// Mass in kg.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Principal moments of inertia in kg m^2.
    pub fn inertia(&self) -> [f64; 3] {
        self.inertia
    }

    /// Gravity in m/s^2.
    pub fn gravity(&self) -> f64 {
        self.gravity
    }

    /// Newton-Euler: m a = R F + m g and I alpha = M - omega x (I omega), with the force F
    /// (without gravity) and the moment M about the centre of mass in body axes.
    ///
    /// Returns the acceleration in world axes (m/s^2) and the angular acceleration in body axes
    /// (rad/s^2).
    #[inline(always)]
    pub fn accelerations<T: Scalar>(
        &self,
        state: &State<T>,
        force: Frd<T>,
        moment: Frd<T>,
    ) -> (Ned<T>, Frd<T>) {
        let [north, east, down] =
            state.attitude.to_world(force * T::from(self.inverse_mass)).to_array();
        let [p, q, r] = state.body_rate.to_array();
        let [ix, iy, iz] = self.inertia;
        let [mx, my, mz] = moment.to_array();
        let [jx, jy, jz] = self.inverse_inertia;
        (
            Ned::new(north, east, down + self.gravity),
            Frd::new(
                (mx + q * r * (iy - iz)) * jx,
                (my + r * p * (iz - ix)) * jy,
                (mz + p * q * (ix - iy)) * jz,
            ),
        )
    }
}

/// Instant within a step at which the integrator evaluates the right-hand side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// At the step's start.
    Start,
    /// At half the step; RK4 evaluates it twice.
    Middle,
    /// At the step's end.
    End,
}

impl Stage {
    /// Index 0, 1 or 2 for start, middle and end.
    #[inline(always)]
    pub fn index(self) -> usize {
        self as usize
    }
}

/// The right-hand side of the equations of motion. Closures implement it; a dedicated type can be
/// inlined at every stage, however long it is.
pub trait RightHandSide<T: Scalar> {
    /// Acceleration in world axes (m/s^2) and angular acceleration in body axes (rad/s^2).
    fn at(&mut self, state: &State<T>, stage: Stage) -> (Ned<T>, Frd<T>);
}

impl<T: Scalar, F: FnMut(&State<T>, Stage) -> (Ned<T>, Frd<T>)> RightHandSide<T> for F {
    #[inline(always)]
    fn at(&mut self, state: &State<T>, stage: Stage) -> (Ned<T>, Frd<T>) {
        self(state, stage)
    }
}

/// Time derivative of a state; `attitude` is the quaternion's derivative.
#[derive(Clone, Copy)]
struct Slope<T> {
    velocity: Ned<T>,
    acceleration: Ned<T>,
    attitude: [T; 4],
    angular_acceleration: Frd<T>,
}

impl<T: Scalar> Slope<T> {
    #[inline(always)]
    fn at(state: &State<T>, stage: Stage, right_hand_side: &mut impl RightHandSide<T>) -> Self {
        let (acceleration, angular_acceleration) = right_hand_side.at(state, stage);
        Self {
            velocity: state.velocity,
            acceleration,
            attitude: state.attitude.derivative(state.body_rate),
            angular_acceleration,
        }
    }

    /// `state + self * dt`; the quaternion is not normalised.
    #[inline(always)]
    fn carry(&self, state: &State<T>, dt: f64) -> State<T> {
        let dt = T::from(dt);
        let Attitude { w, x, y, z } = state.attitude;
        let [dw, dx, dy, dz] = self.attitude;
        State {
            position: state.position + self.velocity * dt,
            velocity: state.velocity + self.acceleration * dt,
            attitude: Attitude { w: w + dw * dt, x: x + dx * dt, y: y + dy * dt, z: z + dz * dt },
            body_rate: state.body_rate + self.angular_acceleration * dt,
        }
    }
}

/// One step of the classical fourth-order Runge-Kutta method, which normalises the quaternion at
/// its end.
///
/// `step` is the step size in s.
#[inline(always)]
pub fn rk4<T: Scalar>(
    state: &State<T>,
    step: f64,
    mut right_hand_side: impl RightHandSide<T>,
) -> State<T> {
    let f = &mut right_hand_side;
    let k1 = Slope::at(state, Stage::Start, f);
    let k2 = Slope::at(&k1.carry(state, 0.5 * step), Stage::Middle, f);
    let k3 = Slope::at(&k2.carry(state, 0.5 * step), Stage::Middle, f);
    let k4 = Slope::at(&k3.carry(state, step), Stage::End, f);
    let two = T::from(2.0);
    let sum = Slope {
        velocity: k1.velocity + (k2.velocity + k3.velocity) * two + k4.velocity,
        acceleration: k1.acceleration + (k2.acceleration + k3.acceleration) * two + k4.acceleration,
        attitude: std::array::from_fn(|i| {
            k1.attitude[i] + (k2.attitude[i] + k3.attitude[i]) * 2.0 + k4.attitude[i]
        }),
        angular_acceleration: k1.angular_acceleration
            + (k2.angular_acceleration + k3.angular_acceleration) * two
            + k4.angular_acceleration,
    };
    let mut next = sum.carry(state, step / 6.0);
    next.attitude = nearly_unit(next.attitude);
    next
}

/// One step of the second-order midpoint rule, at half the cost of [`rk4`]. It normalises the
/// quaternion too.
#[inline(always)]
pub fn midpoint<T: Scalar>(
    state: &State<T>,
    step: f64,
    mut right_hand_side: impl RightHandSide<T>,
) -> State<T> {
    let f = &mut right_hand_side;
    let start = Slope::at(state, Stage::Start, f);
    let middle = Slope::at(&start.carry(state, 0.5 * step), Stage::Middle, f);
    let mut next = middle.carry(state, step);
    next.attitude = nearly_unit(next.attitude);
    next
}

/// Normalises a quaternion of almost unit norm with one Newton step towards 1/sqrt. The remaining
/// error is of the order of the square; it needs neither root nor division.
#[inline(always)]
fn nearly_unit<T: Scalar>(q: Attitude<T>) -> Attitude<T> {
    let norm2 = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
    let off = norm2 + -1.0;
    if off.is_above(1e-5) || (-off).is_above(1e-5) {
        return q.normalized();
    }
    let inverse = norm2 * -0.5 + 1.5;
    Attitude { w: q.w * inverse, x: q.x * inverse, y: q.y * inverse, z: q.z * inverse }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Euler;

    fn tumbling() -> State {
        State {
            attitude: Euler::new(0.3, -0.2, 1.0).attitude(),
            body_rate: Frd::new(3.0, -5.0, 2.0),
            velocity: Ned::new(1.0, -2.0, 0.5),
            ..State::default()
        }
    }

    fn angular_momentum(body: &RigidBody, state: &State) -> Ned {
        state.attitude.to_world(state.body_rate.scale_by(body.inertia()))
    }

    fn rotational_energy(body: &RigidBody, state: &State) -> f64 {
        0.5 * state.body_rate.dot(state.body_rate.scale_by(body.inertia()))
    }

    #[test]
    fn free_fall_is_a_parabola() {
        let body = RigidBody::new(1.3, [0.01, 0.02, 0.03], 9.81);
        let start = State { velocity: Ned::new(2.0, -1.0, -3.0), ..State::default() };
        let mut state = start;
        for _ in 0..2000 {
            state = rk4(&state, 1e-3, |s: &State, _: Stage| {
                body.accelerations(s, Frd::zero(), Frd::zero())
            });
        }
        let fall = 0.5 * 9.81 * 4.0;
        assert!((state.position - Ned::new(4.0, -2.0, -6.0 + fall)).norm() < 1e-10);
        assert!((state.velocity - Ned::new(2.0, -1.0, -3.0 + 2.0 * 9.81)).norm() < 1e-10);
    }

    #[test]
    fn constant_spin_rotates_by_rate_times_time() {
        let body = RigidBody::new(1.0, [0.01, 0.02, 0.03], 0.0);
        let mut state = State { body_rate: Frd::new(0.0, 0.0, 2.0), ..State::default() };
        for _ in 0..1000 {
            state = rk4(&state, 1e-3, |s: &State, _: Stage| {
                body.accelerations(s, Frd::zero(), Frd::zero())
            });
        }
        assert!((state.attitude.euler().yaw - 2.0).abs() < 1e-11);
    }

    #[test]
    fn torque_free_motion_keeps_energy_and_angular_momentum() {
        let body = RigidBody::new(1.0, [0.012, 0.02, 0.03], 9.81);
        let mut state = tumbling();
        let (energy, momentum) =
            (rotational_energy(&body, &state), angular_momentum(&body, &state));
        for _ in 0..10_000 {
            state = rk4(&state, 1e-3, |s: &State, _: Stage| {
                body.accelerations(s, Frd::zero(), Frd::zero())
            });
        }
        assert!((rotational_energy(&body, &state) / energy - 1.0).abs() < 1e-9);
        assert!((angular_momentum(&body, &state) - momentum).norm() / momentum.norm() < 1e-8);
    }

    #[test]
    fn integration_error_shrinks_with_the_method_order() {
        let body = RigidBody::new(1.0, [0.012, 0.02, 0.03], 9.81);
        // A force fixed in the body that grows with its rate, and a moment that opposes the rate.
        let pushed = |s: &State, _: Stage| {
            let force = Frd::new(0.0, 0.0, -12.0) + s.body_rate * 0.1;
            body.accelerations(s, force, s.body_rate * -0.05)
        };
        type Method<'a> = &'a dyn Fn(&State, f64) -> State;
        let run = |method: Method<'_>, count: u32| {
            let step = 0.2 / f64::from(count);
            (0..count).fold(tumbling(), |state, _| method(&state, step))
        };
        let methods: [(Method<'_>, _); 2] = [
            (&|state, step| rk4(state, step, pushed), 3.7..4.4),
            (&|state, step| midpoint(state, step, pushed), 1.8..2.3),
        ];
        let exact = run(methods[0].0, 1024);
        for (method, expected) in methods {
            let error = |count| {
                let state = run(method, count);
                (state.position - exact.position).norm() + state.attitude.angle_to(exact.attitude)
            };
            let order = (error(8) / error(16)).log2();
            assert!(expected.contains(&order), "order {order}");
        }
    }

    #[test]
    fn coarse_step_keeps_the_quaternion_normalised() {
        let body = RigidBody::new(1.0, [0.01; 3], 9.81);
        let mut state = State { body_rate: Frd::new(0.0, 300.0, 0.0), ..State::default() };
        state = rk4(&state, 1e-2, |s: &State, _: Stage| {
            body.accelerations(s, Frd::zero(), Frd::zero())
        });
        let q = state.attitude;
        assert!((q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1.0).abs() < 1e-12);
    }
}
