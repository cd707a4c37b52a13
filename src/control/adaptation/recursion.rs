//! Recursive least squares of the physics' few parameters, on the predicted velocity.

use nalgebra::{SMatrix, SVector};
use vehicle::frame::Ned;

use super::surprise::Surprise;

/// Number of parameters of the specific force.
pub(in crate::control) const PARAMETERS: usize = 7;
/// Index of the relative excess of thrust over mass.
pub(in crate::control) const THRUST_SHARE: usize = 0;
/// Index of the bend of the thrust map.
pub(in crate::control) const THRUST_BEND: usize = 1;
/// Index of the drag over mass.
pub(in crate::control) const DRAG: usize = 2;
/// Indices of the push fixed in the world: wind.
pub(in crate::control) const NORTH: usize = 3;
pub(in crate::control) const EAST: usize = 4;
/// Indices of the push in axes that turn with yaw.
pub(in crate::control) const FRONT: usize = 5;
pub(in crate::control) const RIGHT: usize = 6;
/// Memory of each parameter relative to the pushes': packs sag in flight, while the bend of the
/// thrust map and the drag belong to the airframe.
const MEMORY: [f64; PARAMETERS] = [0.25, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0];
/// Axes of the velocity.
const AXES: usize = 3;
const STATES: usize = AXES + PARAMETERS;

/// Derivative of the acceleration with respect to the parameters.
pub(in crate::control) type Regressor = SMatrix<f64, AXES, PARAMETERS>;

/// Acceleration that no parameter explains, m/s^2 over the root of its bandwidth in Hz.
const UNMODELLED: f64 = 0.03;
/// Least standard deviation of a measured velocity, m/s, and the initial one.
const NOISE_MIN_M_S: f64 = 0.005;
const NOISE_FIRST_M_S: f64 = 0.03;
/// Time over which the noise is learned, s.
const NOISE_S: f64 = 5.0;
/// Innovations beyond this many standard deviations do not count for the noise.
const NOISE_CUT: f64 = 3.0;
/// Innovations that count as a change, in standard deviations of their mean.
const SURPRISE_MIN: f64 = 4.0;

/// Estimates `theta` of `dv/dt = known + Phi theta` from velocities `z = v + noise`: least squares
/// on the predicted velocity, with exponential forgetting of `theta`.
///
/// The covariance never exceeds the prior, so forgetting does not wind up without excitation. Each
/// step of `theta` stays within a trust region, and `theta` within its bounds. Innovations that
/// agree for a tenth of a second indicate a change: the prior covariance of thrust share and pushes
/// then applies again, and the next samples outweigh all earlier ones.
#[derive(Clone, Debug)]
pub(in crate::control) struct Recursion {
    prior: [f64; PARAMETERS],
    bound: [f64; PARAMETERS],
    forgetting_s: f64,
    trust_per_s: f64,
    velocity: SVector<f64, AXES>,
    theta: SVector<f64, PARAMETERS>,
    covariance: SMatrix<f64, STATES, STATES>,
    noise_variance: f64,
    surprise: [Surprise; AXES],
}

/// The outcome of one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::control) struct Learned {
    /// Innovations agreed, which indicates a change.
    pub is_change: bool,
    /// A parameter is at its bound.
    pub at_bound: bool,
}

impl Recursion {
    /// Starts at 0, with these prior standard deviations and bounds.
    pub fn new(
        prior: [f64; PARAMETERS],
        bound: [f64; PARAMETERS],
        forgetting_s: f64,
        trust_per_s: f64,
    ) -> Self {
        let mut recursion = Self {
            prior,
            bound,
            forgetting_s,
            trust_per_s,
            velocity: SVector::zeros(),
            theta: SVector::zeros(),
            covariance: SMatrix::zeros(),
            noise_variance: NOISE_FIRST_M_S.powi(2),
            surprise: [Surprise::default(); AXES],
        };
        recursion.doubt(0..PARAMETERS);
        recursion
    }

    /// The parameter estimates.
    pub fn theta(&self) -> [f64; PARAMETERS] {
        self.theta.into()
    }

    /// The velocity estimate, from prediction and measurements, m/s.
    pub fn velocity(&self) -> Ned {
        let velocity: [f64; AXES] = self.velocity.into();
        velocity.into()
    }

    /// Standard deviation of a parameter.
    pub fn deviation(&self, parameter: usize) -> f64 {
        self.covariance[(AXES + parameter, AXES + parameter)].max(0.0).sqrt()
    }

    /// Shifts a parameter without evidence: a new leading model accounts for part of it.
    pub fn shift(&mut self, parameter: usize, by: f64) {
        let bound = self.bound[parameter];
        self.theta[parameter] = (self.theta[parameter] + by).clamp(-bound, bound);
    }

    /// Restarts at this velocity, where the step from the last one is unknown.
    pub fn restart(&mut self, velocity: Ned) {
        self.velocity = velocity.to_array().into();
        self.surprise.iter_mut().for_each(Surprise::restart);
        for axis in 0..AXES {
            self.forget_velocity(axis);
        }
    }

    fn forget_velocity(&mut self, axis: usize) {
        self.covariance.row_mut(axis).fill(0.0);
        self.covariance.column_mut(axis).fill(0.0);
        self.covariance[(axis, axis)] = self.noise_variance;
    }

    /// Resets these parameters to the prior covariance.
    fn doubt(&mut self, parameters: std::ops::Range<usize>) {
        for parameter in parameters {
            let at = AXES + parameter;
            self.covariance.row_mut(at).fill(0.0);
            self.covariance.column_mut(at).fill(0.0);
            self.covariance[(at, at)] = self.prior[parameter].powi(2);
        }
    }

    /// The predicted velocity after `dt` seconds, m/s.
    pub fn foreseen(&self, regressor: &Regressor, known: Ned, dt: f64) -> Ned {
        let acceleration = SVector::from(known.to_array()) + regressor * self.theta;
        let velocity: [f64; AXES] = (self.velocity + acceleration * dt).into();
        velocity.into()
    }

    /// Updates with the velocity `measured` after `dt` seconds under `known + regressor theta`.
    pub fn learn(&mut self, regressor: &Regressor, known: Ned, measured: Ned, dt: f64) -> Learned {
        self.predict(regressor, known, dt);
        let before = self.theta;
        let mut learned = Learned::default();
        let mut is_surprised = [false; AXES];
        for (axis, seen) in measured.to_array().into_iter().enumerate() {
            let variance = self.covariance[(axis, axis)] + self.noise_variance;
            let innovation = seen - self.velocity[axis];
            let deviation = innovation / variance.sqrt();
            is_surprised[axis] = self.surprise[axis].observe(deviation, dt, SURPRISE_MIN);
            if deviation.abs() < NOISE_CUT {
                let noise = innovation * innovation - self.covariance[(axis, axis)];
                let step = (dt / NOISE_S).min(1.0) * (noise - self.noise_variance);
                self.noise_variance = (self.noise_variance + step).max(NOISE_MIN_M_S.powi(2));
            }
            let gain = self.covariance.column(axis) / variance;
            let row = self.covariance.row(axis).into_owned();
            for i in 0..AXES {
                self.velocity[i] += gain[i] * innovation;
            }
            for i in 0..PARAMETERS {
                self.theta[i] += gain[AXES + i] * innovation;
            }
            self.covariance -= gain * row;
        }
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        self.forbid_pushing_drag();
        self.trust(&before, dt);
        for (theta, bound) in self.theta.iter_mut().zip(self.bound) {
            learned.at_bound |= theta.abs() >= bound;
            *theta = theta.clamp(-bound, bound);
        }
        // A change of thrust does not affect the pushes, whereas a push changes the vertical load.
        let [north, east, down] = is_surprised;
        if north || east {
            self.doubt(NORTH..PARAMETERS);
        }
        learned.is_change = north || east || down;
        if learned.is_change {
            self.doubt(THRUST_SHARE..THRUST_BEND);
            self.surprise.iter_mut().for_each(Surprise::restart);
        }
        learned
    }

    fn predict(&mut self, regressor: &Regressor, known: Ned, dt: f64) {
        self.velocity = self.foreseen(regressor, known, dt).to_array().into();
        let mut step = SMatrix::<f64, STATES, STATES>::identity();
        step.fixed_view_mut::<AXES, PARAMETERS>(0, AXES).copy_from(&(regressor * dt));
        self.covariance = step * self.covariance * step.transpose();
        for axis in 0..AXES {
            self.covariance[(axis, axis)] += UNMODELLED * UNMODELLED * dt;
        }
        for (i, prior) in self.prior.into_iter().enumerate() {
            let at = AXES + i;
            let forget = (0.5 * dt / (MEMORY[i] * self.forgetting_s)).exp();
            let grown = self.covariance[(at, at)].max(0.0).sqrt() * forget;
            let scale = if grown > prior { forget * prior / grown } else { forget };
            self.covariance.row_mut(at).scale_mut(scale);
            self.covariance.column_mut(at).scale_mut(scale);
        }
    }

    /// Raises a negative drag to zero, and moves the other estimates to their most likely values
    /// there. While a wind speeds the vehicle up, less push with a negative drag fits as well; once
    /// the vehicle is slow again, the push would be too small by what that drag had added.
    fn forbid_pushing_drag(&mut self) {
        let variance = self.covariance[(AXES + DRAG, AXES + DRAG)].max(f64::MIN_POSITIVE);
        let below = self.theta[DRAG].min(0.0);
        let step = self.covariance.column(AXES + DRAG) * (below / variance);
        self.velocity -= step.fixed_rows::<AXES>(0);
        self.theta -= step.fixed_rows::<PARAMETERS>(AXES);
        self.theta[DRAG] = self.theta[DRAG].max(0.0);
    }

    /// Cuts a step back to the trust region.
    fn trust(&mut self, before: &SVector<f64, PARAMETERS>, dt: f64) {
        let step = self.theta - before;
        let largest =
            step.iter().zip(self.prior).map(|(step, prior)| step.abs() / prior).fold(0.0, f64::max);
        let most = self.trust_per_s * dt;
        if largest > most {
            self.theta = before + step * (most / largest);
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let numbers = self.velocity.iter().chain(self.theta.iter()).chain(self.covariance.iter());
        numbers.chain([&self.noise_variance]).all(|number| number.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.01;
    const PRIOR: [f64; PARAMETERS] = [0.3, 0.1, 0.3, 1.5, 1.5, 0.5, 0.5];

    fn recursion() -> Recursion {
        Recursion::new(PRIOR, PRIOR.map(|prior| 3.0 * prior), 4.0, 8.0)
    }

    /// Thrust that varies, a flow that turns and a heading that turns at another rate.
    fn excited(tick: usize) -> Regressor {
        let t = tick as f64 * DT;
        let mut slopes = Regressor::zeros();
        slopes[(2, 0)] = -9.81 * (1.0 + 0.3 * (1.1 * t).sin());
        slopes[(2, 1)] = slopes[(2, 0)] * 0.3 * (1.1 * t).sin();
        slopes[(0, 2)] = -2.0 * (0.9 * t).cos();
        slopes[(1, 2)] = -2.0 * (0.9 * t).sin();
        (slopes[(0, 3)], slopes[(1, 4)]) = (1.0, 1.0);
        let (sin, cos) = (0.7 * t).sin_cos();
        (slopes[(0, 5)], slopes[(1, 5)]) = (cos, sin);
        (slopes[(0, 6)], slopes[(1, 6)]) = (-sin, cos);
        slopes
    }

    /// Whether each tick detected a change, under parameters `truth` of the tick.
    fn taught(
        recursion: &mut Recursion,
        ticks: std::ops::Range<usize>,
        regressor: impl Fn(usize) -> Regressor,
        truth: impl Fn(usize) -> [f64; PARAMETERS],
    ) -> Vec<usize> {
        let mut velocity = recursion.velocity;
        let mut changes = Vec::new();
        for tick in ticks {
            let slopes = regressor(tick);
            velocity += slopes * SVector::from(truth(tick)) * DT;
            // A noise with a period of a prime number of ticks.
            let noise = 0.01 * ((tick * 7919 % 101) as f64 / 50.0 - 1.0);
            let seen: [f64; 3] = velocity.into();
            let seen = Ned::from(seen) + Ned::new(noise, -noise, noise);
            if recursion.learn(&slopes, Ned::zero(), seen, DT).is_change {
                changes.push(tick);
            }
        }
        changes
    }

    #[test]
    fn excited_parameters_are_identified() {
        let truth = [-0.2, 0.1, 0.4, 1.0, -0.5, 0.3, -0.2];
        let mut recursion = recursion();
        taught(&mut recursion, 0..3000, excited, |_| truth);
        for (found, truth) in recursion.theta().into_iter().zip(truth) {
            assert!((found - truth).abs() < 0.05, "{:?}", recursion.theta());
        }
    }

    #[test]
    fn change_is_detected_quickly_without_false_alarms() {
        let mut recursion = recursion();
        let settled = taught(&mut recursion, 0..2000, excited, |_| [0.0; PARAMETERS]);
        assert!(settled.is_empty(), "{settled:?}");
        let heavier = [-0.23, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let seen = taught(&mut recursion, 2000..2100, excited, |_| heavier);
        assert!(seen.first().is_some_and(|tick| *tick < 2015), "{seen:?}");
        assert!((recursion.theta()[0] + 0.23).abs() < 0.03, "{:?}", recursion.theta());
    }

    #[test]
    fn change_keeps_what_is_known_of_the_airframe() {
        let mut truth = [-0.2, 0.1, 0.4, 1.0, -0.5, 0.3, -0.2];
        let mut recursion = recursion();
        taught(&mut recursion, 0..3000, excited, |_| truth);
        let deviations =
            |recursion: &Recursion| [THRUST_BEND, DRAG].map(|at| recursion.deviation(at));
        let known = deviations(&recursion);
        (truth[THRUST_SHARE], truth[NORTH]) = (-0.35, 2.5);
        let seen = taught(&mut recursion, 3000..3030, excited, |_| truth);
        assert!(!seen.is_empty());
        for (after, before) in deviations(&recursion).into_iter().zip(known) {
            assert!(after < 1.5 * before, "{after} after {before}");
        }
    }

    #[test]
    fn drag_is_never_negative_and_a_wind_is_not_underestimated() {
        let mut recursion = recursion();
        // A vehicle without drag that a wind sets into motion: its flow grows with the push.
        let mut flow = 0.0;
        let mut velocity = recursion.velocity;
        for tick in 0..60 {
            let mut slopes = Regressor::zeros();
            slopes[(0, DRAG)] = -flow;
            (slopes[(0, NORTH)], slopes[(1, EAST)]) = (1.0, 1.0);
            velocity[0] += 1.2 * DT;
            flow = velocity[0];
            let noise = 0.01 * ((tick * 7919 % 101) as f64 / 50.0 - 1.0);
            let seen: [f64; 3] = velocity.into();
            let seen = Ned::from(seen) + Ned::new(noise, -noise, noise);
            recursion.learn(&slopes, Ned::zero(), seen, DT);
            assert!(recursion.theta()[DRAG] >= 0.0);
        }
        let theta = recursion.theta();
        let push = theta[NORTH] - theta[DRAG] * flow;
        assert!((push - 1.2).abs() < 0.05 && theta[NORTH] > 1.15, "{theta:?}");
    }

    #[test]
    fn covariance_never_exceeds_the_prior_without_excitation() {
        let mut recursion = recursion();
        taught(&mut recursion, 0..60_000, |_| Regressor::zeros(), |_| [0.0; PARAMETERS]);
        for (parameter, prior) in PRIOR.into_iter().enumerate() {
            assert!(recursion.deviation(parameter) <= prior * (1.0 + 1e-6));
        }
        assert!(recursion.is_finite());
    }

    #[test]
    fn steps_stay_in_trust_region_and_parameters_in_bounds() {
        let mut recursion = recursion();
        let mut before = recursion.theta();
        for tick in 0..400 {
            let seen = Ned::new(20.0 * tick as f64 * DT, 0.0, 30.0 * tick as f64 * DT);
            recursion.learn(&excited(0), Ned::zero(), seen, DT);
            let now = recursion.theta();
            for i in 0..PARAMETERS {
                assert!((now[i] - before[i]).abs() <= 8.0 * DT * PRIOR[i] * (1.0 + 1e-9));
                assert!(now[i].abs() <= 3.0 * PRIOR[i]);
            }
            before = now;
        }
        assert!(recursion.is_finite());
    }
}
