//! The desired states of a trajectory: those of a vehicle without drag that follows it.

use vehicle::frame::{Euler, Heading, Ned};

use super::planned::CommandedInput;
use super::problem::{ANGLE, RATE, StateVector, YAW};
use super::trajectory::{DesiredPoint, Trajectory};

/// Desired states, and the inputs that hold them without drag.
#[derive(Clone, Debug, PartialEq)]
pub struct Desire {
    /// `s_d,0 .. s_d,N`.
    pub states: Vec<StateVector>,
    /// `u_hat_0 .. u_hat_{N-1}`.
    pub inputs: Vec<CommandedInput>,
}

/// The vehicle's weight, and its tilt limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// kg
    pub mass_kg: f64,
    /// m/s^2
    pub gravity: f64,
    /// Largest angle of the thrust axis to the vertical, rad.
    pub tilt_max_rad: f64,
}

impl Desire {
    /// Samples the trajectory every `period_s` from `from_s` on, for `periods` periods.
    ///
    /// A quadrotor is differentially flat: thrust carries the weight and produces the acceleration,
    /// `(u1/m) R e3 = g e3 - a`, which with the yaw determines the attitude (Mellinger and Kumar
    /// 2011). The body rates lead from one attitude to the next.
    pub fn new(
        trajectory: &Trajectory,
        from_s: f64,
        period_s: f64,
        periods: usize,
        weight: &Weight,
    ) -> Self {
        let points = (0..periods + 1).map(|n| trajectory.sample(from_s + n as f64 * period_s));
        Self::along(points, period_s, weight)
    }

    /// The same from given points, at least two.
    pub(super) fn along(
        points: impl ExactSizeIterator<Item = DesiredPoint>,
        period_s: f64,
        weight: &Weight,
    ) -> Self {
        let periods = points.len() - 1;
        let mut thrusts = Vec::with_capacity(periods + 1);
        let mut states: Vec<StateVector> = points
            .map(|point| {
                let (thrust, attitude) = weight.carry(&point);
                thrusts.push(thrust);
                let ([n, e, d], [vn, ve, vd]) =
                    (point.position.to_array(), point.velocity.to_array());
                let Euler { roll, pitch, yaw } = attitude;
                [n, e, d, vn, ve, vd, roll, pitch, yaw, 0.0, 0.0, 0.0]
            })
            .collect();
        for n in 0..periods {
            let next = states[n + 1];
            let state = &mut states[n];
            let rates: [f64; 3] =
                std::array::from_fn(|i| (next[ANGLE + i] - state[ANGLE + i]) / period_s);
            let attitude = Euler::new(state[ANGLE], state[ANGLE + 1], state[YAW]);
            state[RATE..].copy_from_slice(&attitude.body_rate(rates).to_array());
        }
        let before = states[periods - 1];
        states[periods][RATE..].copy_from_slice(&before[RATE..]);
        let inputs = states[..periods]
            .iter()
            .zip(&thrusts)
            .map(|(state, thrust)| {
                let [.., roll, pitch, yaw, p, q, r] = *state;
                [*thrust, roll, pitch, yaw, p, q, r]
            })
            .collect();
        Self { states, inputs }
    }
}

impl Weight {
    /// Thrust (N) and attitude that produce a point's acceleration.
    pub(crate) fn carry(&self, point: &DesiredPoint) -> (f64, Euler<f64>) {
        let carried = Ned::new(0.0, 0.0, self.gravity) - point.acceleration;
        let [ahead, right, down] = Heading::new(point.yaw).to_level(carried);
        // Beyond the largest tilt, the direction is kept and the tilt cut.
        let across = ahead.hypot(right);
        let most = self.tilt_max_rad.tan() * down.max(0.1 * self.gravity);
        let cut = if across > most { most / across } else { 1.0 };
        let (ahead, right, down) = (cut * ahead, cut * right, down.max(0.1 * self.gravity));
        let length = (ahead * ahead + right * right + down * down).sqrt();
        let roll = (-right / length).clamp(-1.0, 1.0).asin();
        let pitch = ahead.atan2(down);
        (self.mass_kg * length, Euler::new(roll, pitch, point.yaw))
    }
}
