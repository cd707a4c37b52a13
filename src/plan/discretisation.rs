//! Discrete steps of a planning problem from a model of the accelerations.

use vehicle::AttitudePd;
use vehicle::frame::{Euler, Frd, Ned};

use super::problem::{ANGLE, RATE, STATES, StateVector};
use crate::model::{ACCELERATIONS, Model, Point};

/// A step and its derivatives: `s+ = next + A (s - s_bar) + B (u - u_bar)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearStep<const INPUTS: usize> {
    /// `f(s_bar, u_bar)`.
    pub next: StateVector,
    /// `A = df/ds`.
    pub state: [[f64; STATES]; STATES],
    /// `B = df/du`.
    pub input: [[f64; INPUTS]; STATES],
}

/// Dynamics in discrete time.
pub trait Dynamics<const INPUTS: usize>: Sync {
    /// `f(s, u)`, the state one period later.
    fn step(&self, state: &StateVector, input: &[f64; INPUTS]) -> StateVector;

    /// The step with its exact derivatives.
    fn linearize(&self, state: &StateVector, input: &[f64; INPUTS]) -> LinearStep<INPUTS>;
}

/// Euler steps with the wrench `u = (u1, u2, u3, u4)` as the input.
#[derive(Clone, Copy)]
pub struct WrenchDynamics<'a> {
    model: &'a dyn Model,
    period_s: f64,
}

/// Euler steps of the vehicle with its attitude loop: the input is the commanded one,
/// `u_hat = (u1, zeta_des, omega_des)`, and the moments are
/// `(u2, u3, u4) = Kp (zeta_des - zeta) + Kd (omega_des - omega)` (Bansal et al. 2016, eq. 14). Yaw
/// is continuous here, so its difference is not wrapped.
#[derive(Clone, Copy)]
pub struct CommandedDynamics<'a> {
    model: &'a dyn Model,
    attitude_pd: AttitudePd,
    period_s: f64,
}

impl<'a> WrenchDynamics<'a> {
    /// Uses steps of `period_s` seconds.
    pub fn new(model: &'a dyn Model, period_s: f64) -> Self {
        Self { model, period_s }
    }
}

impl<'a> CommandedDynamics<'a> {
    /// Uses steps of `period_s` seconds of a vehicle with this attitude loop.
    pub fn new(model: &'a dyn Model, attitude_pd: AttitudePd, period_s: f64) -> Self {
        Self { model, attitude_pd, period_s }
    }
}

/// The wrench that an attitude loop makes of a commanded input at a state, N and N m. The
/// differences of angles are not wrapped.
pub(super) fn commanded_wrench(
    AttitudePd { kp, kd, .. }: &AttitudePd,
    state: &StateVector,
    [thrust, command @ ..]: &[f64; 7],
) -> [f64; 4] {
    let moment = |i: usize| {
        kp[i] * (command[i] - state[ANGLE + i]) + kd[i] * (command[3 + i] - state[RATE + i])
    };
    [*thrust, moment(0), moment(1), moment(2)]
}

impl Dynamics<4> for WrenchDynamics<'_> {
    fn step(&self, state: &StateVector, input: &[f64; 4]) -> StateVector {
        euler_step(state, &self.model.accelerations(&point(state, input)), self.period_s)
    }

    fn linearize(&self, state: &StateVector, input: &[f64; 4]) -> LinearStep<4> {
        linear_euler_step(self.model, self.period_s, state, input)
    }
}

impl Dynamics<7> for CommandedDynamics<'_> {
    fn step(&self, state: &StateVector, input: &[f64; 7]) -> StateVector {
        let wrench = commanded_wrench(&self.attitude_pd, state, input);
        euler_step(state, &self.model.accelerations(&point(state, &wrench)), self.period_s)
    }

    fn linearize(&self, state: &StateVector, input: &[f64; 7]) -> LinearStep<7> {
        let wrench = commanded_wrench(&self.attitude_pd, state, input);
        let LinearStep { next, state: mut a, input: b } =
            linear_euler_step(self.model, self.period_s, state, &wrench);
        let AttitudePd { kp, kd, .. } = &self.attitude_pd;
        let mut commanded = [[0.0; 7]; STATES];
        for ((a, b), commanded) in a.iter_mut().zip(&b).zip(&mut commanded) {
            commanded[0] = b[0];
            for i in 0..3 {
                let (by_angle, by_rate) = (b[1 + i] * kp[i], b[1 + i] * kd[i]);
                commanded[1 + i] = by_angle;
                commanded[4 + i] = by_rate;
                a[ANGLE + i] -= by_angle;
                a[RATE + i] -= by_rate;
            }
        }
        LinearStep { next, state: a, input: commanded }
    }
}

fn point(state: &StateVector, wrench: &[f64; 4]) -> Point {
    let [_, _, _, vn, ve, vd, roll, pitch, yaw, p, q, r] = *state;
    Point {
        velocity: Ned::new(vn, ve, vd),
        body_rate: Frd::new(p, q, r),
        attitude: Euler::new(roll, pitch, yaw),
        input: *wrench,
    }
}

/// The state one period later without any acceleration.
pub(super) fn coasted(state: &StateVector, period: f64) -> StateVector {
    euler_step(state, &[0.0; ACCELERATIONS], period)
}

/// `s + h (v, a, W(zeta) omega, alpha)`.
fn euler_step(
    state: &StateVector,
    [an, ae, ad, ap, aq, ar]: &[f64; ACCELERATIONS],
    period: f64,
) -> StateVector {
    let [.., roll, pitch, yaw, p, q, r] = *state;
    let [roll, pitch, yaw] = Euler::new(roll, pitch, yaw).rates(Frd::new(p, q, r));
    let rates = [state[3], state[4], state[5], *an, *ae, *ad, roll, pitch, yaw, *ap, *aq, *ar];
    std::array::from_fn(|i| state[i] + period * rates[i])
}

fn linear_euler_step(
    model: &dyn Model,
    period: f64,
    state: &StateVector,
    wrench: &[f64; 4],
) -> LinearStep<4> {
    let (accelerations, jacobian) = model.linearize(&point(state, wrench));
    let mut a = [[0.0; STATES]; STATES];
    let mut b = [[0.0; 4]; STATES];
    for axis in 0..3 {
        a[axis][3 + axis] = period;
    }
    let [.., roll, pitch, _, _, q, r] = *state;
    let ((sin_r, cos_r), (sin_p, cos_p)) = (roll.sin_cos(), pitch.sin_cos());
    let tan_p = sin_p / cos_p;
    let (across, along) = (sin_r * q + cos_r * r, cos_r * q - sin_r * r);
    let slopes = [
        [tan_p * along, across / (cos_p * cos_p), 0.0, 1.0, tan_p * sin_r, tan_p * cos_r],
        [-across, 0.0, 0.0, 0.0, cos_r, -sin_r],
        [along / cos_p, across * sin_p / (cos_p * cos_p), 0.0, 0.0, sin_r / cos_p, cos_r / cos_p],
    ];
    for (row, slopes) in a[ANGLE..RATE].iter_mut().zip(slopes) {
        for (entry, slope) in row[ANGLE..].iter_mut().zip(slopes) {
            *entry = period * slope;
        }
    }
    // Rows of v and omega; the model's columns are v, omega, zeta, u.
    for (index, slope) in jacobian.iter().enumerate() {
        let row = if index < 3 { 3 + index } else { RATE + index - 3 };
        for i in 0..3 {
            a[row][3 + i] = period * slope[i];
            a[row][RATE + i] = period * slope[3 + i];
            a[row][ANGLE + i] = period * slope[6 + i];
        }
        for i in 0..4 {
            b[row][i] = period * slope[9 + i];
        }
    }
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += 1.0;
    }
    LinearStep { next: euler_step(state, &accelerations, period), state: a, input: b }
}
