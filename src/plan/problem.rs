//! The planning problem: the desired states, the bounds, and the regions to avoid.

use super::flight_box::FlightBox;
use super::keep_out::KeepOut;
pub(super) use super::state_vector::{ANGLE, RATE, VELOCITY, YAW};
pub use super::state_vector::{STATES, StateRow, StateVector};

/// A planning problem with `INPUTS` inputs over N periods:
///
/// minimise `sum_{n=1..N} |W (s_n - s_d,n)|_2 + weight/2 sum_n |(u_n - preferred_n) / scale|^2`
/// over the states and inputs with `s_0` given and `s_{n+1} = f(s_n, u_n)` (Bansal et al. 2016,
/// eq. 7), within the bounds. With a knee `k`, the distance `d` counts as `sqrt(d^2 + k^2) - k`,
/// which is about `d^2 / 2k` below the knee.
#[derive(Clone, Debug)]
pub struct Problem<const INPUTS: usize> {
    /// Length of a period, s.
    pub period_s: f64,
    /// The initial state `s_0`.
    pub start: StateVector,
    /// `s_d,1 .. s_d,N`.
    pub desired: Vec<StateVector>,
    /// The diagonal of W.
    pub state_weight: StateVector,
    /// The knee of the distance, in its unit; 0 for the distance itself.
    pub knee: f64,
    /// Bounds of each input.
    pub inputs: InputBounds<INPUTS>,
    /// The preferred inputs among those that lead to the same states.
    pub preference: Option<InputPreference<INPUTS>>,
    /// Bounds of each state.
    pub limits: StateLimits,
    /// Regions that the position must avoid.
    pub keep_out: Vec<KeepOut>,
    /// Margin to the regions and to the bounds of the position at each state, `s_0 .. s_N`, m;
    /// empty for none.
    pub margin_m: Vec<f64>,
}

/// Bounds and sizes of the inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputBounds<const INPUTS: usize> {
    /// Least values.
    pub lower: [f64; INPUTS],
    /// Greatest values.
    pub upper: [f64; INPUTS],
    /// Typical sizes, above 0: the solver works with inputs of order 1.
    pub scale: [f64; INPUTS],
}

impl<const INPUTS: usize> InputBounds<INPUTS> {
    /// The nearest input within the bounds.
    pub fn clamp(&self, mut input: [f64; INPUTS]) -> [f64; INPUTS] {
        for ((value, lower), upper) in input.iter_mut().zip(&self.lower).zip(&self.upper) {
            *value = value.clamp(*lower, *upper);
        }
        input
    }
}

/// A quadratic pull of the inputs.
#[derive(Clone, Debug)]
pub struct InputPreference<const INPUTS: usize> {
    /// Twice the cost of a deviation by one scale.
    pub weight: f64,
    /// The preferred inputs, one per period.
    pub inputs: Vec<[f64; INPUTS]>,
}

impl<const INPUTS: usize> InputPreference<INPUTS> {
    /// Adds a second pull, of `weight` towards `inputs`: up to a constant, the two combine into
    /// one.
    pub(super) fn pull_to(&mut self, inputs: &[[f64; INPUTS]], weight: f64) {
        let sum = self.weight + weight;
        let share = if sum > 0.0 { weight / sum } else { 0.0 };
        for (preferred, input) in self.inputs.iter_mut().zip(inputs) {
            for (preferred, input) in preferred.iter_mut().zip(input) {
                *preferred += share * (input - *preferred);
            }
        }
        self.weight = sum;
    }
}

/// Bounds of the state. A missing one is not enforced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StateLimits {
    /// Angle of the thrust axis to the vertical, rad.
    pub tilt_max_rad: Option<f64>,
    /// Body rate about each axis, rad/s.
    pub body_rate_max_rad_s: Option<[f64; 3]>,
    /// Position.
    pub position: Option<FlightBox>,
}

/// Violation of a state's bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Excess {
    /// Sum of the violations (m, rad, rad/s).
    pub sum: f64,
    /// Largest distance, m, by which the position, or the way on from it, is inside forbidden
    /// space.
    pub trespass_m: f64,
}

/// A bound with more slack than this (in its unit) is left out of the subproblem; the check of the
/// step includes it again.
const FAR: f64 = 2.0;

impl StateLimits {
    /// Whether a state's position is within its bounds.
    pub(super) fn allow_position(&self, state: &StateVector) -> bool {
        self.position.is_none_or(|bounds| {
            let mut each = state.iter().zip(bounds.ranges());
            each.all(|(value, [lower, upper])| (lower..=upper).contains(value))
        })
    }

    /// Calls `visit` with each bound at `state`; position bounds are tightened by `margin_m`.
    fn visit(&self, state: &StateVector, margin_m: f64, mut visit: impl FnMut(StateRow)) {
        if let Some(tilt_max) = self.tilt_max_rad {
            // cos(tilt) = cos(roll) cos(pitch); divided by sin(tilt_max), the bound is in rad near
            // the limit, and smooth where the vehicle is level.
            let ((sin_r, cos_r), (sin_p, cos_p)) =
                (state[ANGLE].sin_cos(), state[ANGLE + 1].sin_cos());
            let scale = 1.0 / tilt_max.sin();
            let mut gradient = [0.0; STATES];
            gradient[ANGLE] = scale * sin_r * cos_p;
            gradient[ANGLE + 1] = scale * cos_r * sin_p;
            visit(StateRow { excess: scale * (tilt_max.cos() - cos_r * cos_p), gradient });
        }
        let mut between = |index: usize, lower: f64, upper: f64| {
            let mut gradient = [0.0; STATES];
            gradient[index] = 1.0;
            visit(StateRow { excess: state[index] - upper, gradient });
            gradient[index] = -1.0;
            visit(StateRow { excess: lower - state[index], gradient });
        };
        if let Some(rates) = self.body_rate_max_rad_s {
            for (axis, rate) in rates.into_iter().enumerate() {
                between(RATE + axis, -rate, rate);
            }
        }
        if let Some(bounds) = self.position {
            for (axis, [lower, upper]) in bounds.ranges().into_iter().enumerate() {
                between(axis, lower + margin_m, upper - margin_m);
            }
        }
    }
}

impl<const INPUTS: usize> Problem<INPUTS> {
    /// The horizon N, in periods.
    pub fn horizon(&self) -> usize {
        self.desired.len()
    }

    /// The cost of the distance to the desired state at the end of period `n`, `|W (s - s_d)|`,
    /// with the knee.
    pub fn distance(&self, n: usize, state: &StateVector) -> f64 {
        let desired = &self.desired[n];
        let square: f64 =
            (0..STATES).map(|i| (self.state_weight[i] * (state[i] - desired[i])).powi(2)).sum();
        (square + self.knee * self.knee).sqrt() - self.knee
    }

    /// Cost of period `n` with its input and the state at its end.
    pub fn cost(&self, n: usize, state: &StateVector, input: &[f64; INPUTS]) -> f64 {
        let pull = self.preference.as_ref().map_or(0.0, |preference| {
            let squares = (0..INPUTS)
                .map(|i| ((input[i] - preference.inputs[n][i]) / self.inputs.scale[i]).powi(2));
            0.5 * preference.weight * squares.sum::<f64>()
        });
        self.distance(n, state) + pull
    }

    /// Calls `visit` with every bound of the state at the end of period `n`, and of the step from
    /// it: steps are Euler's, so the next position follows from this state alone.
    pub(super) fn visit_bounds(
        &self,
        n: usize,
        state: &StateVector,
        mut visit: impl FnMut(StateRow),
    ) {
        let here_m = self.margin_m.get(n + 1).copied().unwrap_or_default();
        self.limits.visit(state, here_m, &mut visit);
        let ahead_s = if n + 1 < self.horizon() { self.period_s } else { 0.0 };
        for region in &self.keep_out {
            visit(region.row(state, ahead_s, self.margin_of_step(n + 1)));
        }
    }

    /// Margin of the step from state `n` to regions, m: the larger of its two states'.
    pub(super) fn margin_of_step(&self, n: usize) -> f64 {
        let either = self.margin_m.iter().skip(n).take(2);
        either.copied().fold(0.0, f64::max)
    }

    /// By how much the state at the end of period `n` violates its bounds.
    pub(super) fn excess(&self, n: usize, state: &StateVector) -> Excess {
        let mut excess = Excess::default();
        self.visit_bounds(n, state, |row| {
            excess.sum += row.excess.max(0.0);
            if row.is_of_position() {
                excess.trespass_m = excess.trespass_m.max(row.excess);
            }
        });
        excess
    }

    /// The bounds that a step from the state at the end of period `n` may reach.
    pub(super) fn rows_near(&self, n: usize, state: &StateVector, rows: &mut Vec<StateRow>) {
        rows.clear();
        self.visit_bounds(n, state, |row| {
            if row.excess > -FAR {
                rows.push(row);
            }
        });
    }
}

#[cfg(test)]
impl StateRow {
    /// Whether the gradient matches finite differences of `excess` at `state`; `None` at an edge,
    /// where the gradient is not unique.
    pub(super) fn is_slope_of(
        &self,
        excess: impl Fn(&StateVector) -> f64,
        state: &StateVector,
    ) -> Option<bool> {
        let step = 1e-6;
        for (i, expected) in self.gradient.into_iter().enumerate() {
            let [mut above, mut below] = [*state; 2];
            above[i] += step;
            below[i] -= step;
            let [ahead, behind] =
                [excess(&above) - self.excess, self.excess - excess(&below)].map(|d| d / step);
            if (ahead - behind).abs() > 1e-3 {
                return None;
            }
            if (0.5 * (ahead + behind) - expected).abs() > 1e-4 {
                return Some(false);
            }
        }
        Some(true)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vehicle::frame::Ned;

    use super::*;

    fn problem(limits: StateLimits, keep_out: Vec<KeepOut>) -> Problem<4> {
        Problem {
            period_s: 0.1,
            start: [0.0; STATES],
            desired: vec![[0.0; STATES]],
            state_weight: [1.0; STATES],
            knee: 0.0,
            inputs: InputBounds { lower: [-1.0; 4], upper: [1.0; 4], scale: [1.0; 4] },
            preference: None,
            limits,
            keep_out,
            margin_m: Vec::new(),
        }
    }

    fn rows(problem: &Problem<4>, state: &StateVector) -> Vec<StateRow> {
        let mut rows = Vec::new();
        problem.visit_bounds(0, state, |row| rows.push(row));
        rows
    }

    #[test]
    fn step_following_a_state_is_checked() {
        // A wall a few millimetres thick, far thinner than the length of a step.
        let wall =
            KeepOut::Box { lower: Ned::new(0.0, -1.0, -1.0), upper: Ned::new(0.004, 1.0, 1.0) };
        let mut problem = problem(StateLimits::default(), vec![wall]);
        problem.desired = vec![[0.0; STATES]; 2];
        let mut state = [0.0; STATES];
        (state[0], state[3]) = (-0.01, 0.4);
        assert!((problem.excess(0, &state).trespass_m - 0.002).abs() < 1e-12);
        // No step follows the last state.
        assert_eq!(problem.excess(1, &state).trespass_m, 0.0);
    }

    #[test]
    fn excess_is_the_violation_of_each_bound() {
        let limits = StateLimits {
            tilt_max_rad: Some(0.5),
            body_rate_max_rad_s: Some([1.0, 2.0, 3.0]),
            position: Some(FlightBox {
                lower: Ned::new(-1.0, -1.0, -2.0),
                upper: Ned::new(1.0, 1.0, 0.0),
            }),
        };
        let problem = problem(limits, vec![]);
        assert_eq!(problem.excess(0, &[0.0; STATES]), Excess::default());
        let mut state = [0.0; STATES];
        (state[1], state[2], state[RATE + 1]) = (1.25, -2.5, -2.75);
        let excess = problem.excess(0, &state);
        assert!((excess.sum - (0.25 + 0.5 + 0.75)).abs() < 1e-12);
        assert_eq!(excess.trespass_m, 0.5);
        state = [0.0; STATES];
        state[ANGLE + 1] = 0.501;
        let excess = problem.excess(0, &state);
        assert!((excess.sum - 0.001).abs() < 1e-5 && excess.trespass_m == 0.0);
    }

    proptest! {
        #[test]
        fn gradients_match_finite_differences(
            state in prop::array::uniform12(-1.0_f64..1.0),
        ) {
            let limits = StateLimits {
                tilt_max_rad: Some(0.6),
                body_rate_max_rad_s: Some([2.0; 3]),
                position: Some(FlightBox {
                    lower: Ned::new(-0.5, -0.5, -0.5),
                    upper: Ned::new(0.5, 0.5, 0.5),
                }),
            };
            let problem = problem(limits, vec![]);
            for (index, row) in rows(&problem, &state).into_iter().enumerate() {
                let excess = |state: &StateVector| rows(&problem, state)[index].excess;
                prop_assert_ne!(row.is_slope_of(excess, &state), Some(false));
            }
        }
    }
}
