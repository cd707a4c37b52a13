//! What a plan is asked for: the desired states, the bounds, and what to keep out of.

use sitl::frame::Ned;

/// Size of the state `s = (p, v, zeta, omega)`.
pub const STATES: usize = 12;
/// Where the attitude (roll, pitch, yaw) begins in a [`StateVector`].
pub(super) const ANGLE: usize = 6;
/// Where yaw is in a [`StateVector`].
pub(super) const YAW: usize = 8;
/// Where the body rate begins in a [`StateVector`].
pub(super) const RATE: usize = 9;

/// `s = (p, v, zeta, omega)`: position [m] and velocity [m/s] in world axes, roll, pitch and yaw
/// [rad, continuous], body rate [rad/s].
pub type StateVector = [f64; STATES];

/// A planning problem with `INPUTS` inputs over N periods:
///
/// minimise `sum_{n=1..N} |W (s_n - s_d,n)|_2 + weight/2 sum_n |(u_n - preferred_n) / scale|^2`
/// over the states and inputs with `s_0` given and `s_{n+1} = f(s_n, u_n)` (Bansal et al. 2016,
/// eq. 12), within the bounds.
#[derive(Clone, Debug)]
pub struct Problem<const INPUTS: usize> {
    /// Length of a period, s.
    pub period_s: f64,
    /// Where the vehicle starts.
    pub start: StateVector,
    /// `s_d,1 .. s_d,N`.
    pub desired: Vec<StateVector>,
    /// The diagonal of W.
    pub state_weight: StateVector,
    /// Bounds of each input.
    pub inputs: InputBounds<INPUTS>,
    /// What is preferred among inputs that lead to the same states.
    pub preference: Option<InputPreference<INPUTS>>,
    /// Bounds of each state.
    pub limits: StateLimits,
    /// Where the vehicle must not be.
    pub keep_out: Vec<KeepOut>,
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
    /// The input within the bounds that is nearest.
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
    /// Cost of a deviation by one scale, once.
    pub weight: f64,
    /// The preferred inputs, one a period.
    pub inputs: Vec<[f64; INPUTS]>,
}

/// Bounds of the state. A missing one does not act.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StateLimits {
    /// Angle of the thrust axis to the vertical, rad.
    pub tilt_max_rad: Option<f64>,
    /// Body rate about each axis, rad/s.
    pub body_rate_max_rad_s: Option<[f64; 3]>,
    /// Least and greatest position, m.
    pub position: Option<(Ned, Ned)>,
}

/// A region that the vehicle's position must not enter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KeepOut {
    /// A ball.
    Sphere {
        /// m
        centre: Ned,
        /// m
        radius: f64,
    },
    /// A box along the world's axes.
    Box {
        /// Corner with the least coordinates, m.
        lower: Ned,
        /// Corner with the greatest coordinates, m.
        upper: Ned,
    },
}

/// A bound `excess(s) <= 0` and how it changes with the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRow {
    /// By how much the bound is broken (m, rad, rad/s); negative inside.
    pub excess: f64,
    /// d(excess)/ds.
    pub gradient: StateVector,
}

/// A bound that is kept by more than this (in its unit) is not handed to the subproblem; the
/// step's own check sees it again.
const FAR: f64 = 2.0;

impl StateLimits {
    /// Whether a state's position is within its bounds.
    pub(super) fn allow_position(&self, state: &StateVector) -> bool {
        self.position.is_none_or(|(lower, upper)| {
            let bounds = lower.to_array().into_iter().zip(upper.to_array());
            state.iter().zip(bounds).all(|(value, (lower, upper))| (lower..=upper).contains(value))
        })
    }

    /// Calls `visit` with each bound at `state`.
    fn visit(&self, state: &StateVector, mut visit: impl FnMut(StateRow)) {
        if let Some(tilt_max) = self.tilt_max_rad {
            // cos(tilt) = cos(roll) cos(pitch); divided by sin(tilt_max) it counts in rad at the
            // bound, and is smooth where the vehicle is level.
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
        if let Some((lower, upper)) = self.position {
            for (axis, (lower, upper)) in
                lower.to_array().into_iter().zip(upper.to_array()).enumerate()
            {
                between(axis, lower, upper);
            }
        }
    }
}

impl KeepOut {
    /// Share of the way from a position on by `way` at which it is deepest in the region, or
    /// nearest to it.
    fn deepest(&self, from: [f64; 3], way: [f64; 3]) -> f64 {
        let mut best = (self.depth(from).0, 0.0);
        let mut look = |share: f64| {
            if (0.0..=1.0).contains(&share) {
                let depth = self.depth(along(from, way, share)).0;
                if depth > best.0 {
                    best = (depth, share);
                }
            }
        };
        look(1.0);
        match self {
            Self::Sphere { centre, .. } => {
                let off = std::array::from_fn(|i| from[i] - centre.to_array()[i]);
                look(-dot(&off, &way) / dot(&way, &way));
            }
            Self::Box { lower, upper } => {
                // Distances to the faces, positive inside, are linear along the way.
                let (lower, upper) = (lower.to_array(), upper.to_array());
                let faces: [[f64; 2]; 6] = std::array::from_fn(|face| match (face / 2, face % 2) {
                    (i, 0) => [from[i] - lower[i], way[i]],
                    (i, _) => [upper[i] - from[i], -way[i]],
                });
                // Inside, the least of them counts, which is greatest where two are equal.
                for (k, [a, slope]) in faces.iter().enumerate() {
                    faces[k + 1..].iter().for_each(|[b, other]| look((b - a) / (slope - other)));
                }
                // Outside, the sum of the squares of those below 0, between two crossings.
                let mut ends =
                    faces.map(
                        |[a, slope]| {
                            if slope == 0.0 { 0.0 } else { (-a / slope).clamp(0.0, 1.0) }
                        },
                    );
                ends.sort_by(f64::total_cmp);
                for (start, end) in [0.0].iter().chain(&ends).zip(ends.iter().chain(&[1.0])) {
                    let middle = 0.5 * (start + end);
                    let (mut cross, mut square) = (0.0, 0.0);
                    for [a, slope] in faces.iter().filter(|[a, slope]| a + middle * slope < 0.0) {
                        cross += a * slope;
                        square += slope * slope;
                    }
                    look((-cross / square).clamp(*start, *end));
                }
            }
        }
        best.1
    }

    /// Depth of the deepest position between `from` and `to`, negative where all are outside.
    pub(super) fn depth_between(&self, from: [f64; 3], to: [f64; 3]) -> f64 {
        let way = std::array::from_fn(|i| to[i] - from[i]);
        self.depth(along(from, way, self.deepest(from, way))).0
    }

    /// The bound of a state that goes on with its velocity for `ahead_s` seconds: between states
    /// the vehicle must not be inside either. The gradient is that of the deepest place, at its share
    /// of the way: between two faces the depth itself may have none that leads out.
    fn row(&self, state: &StateVector, ahead_s: f64) -> StateRow {
        let from = [state[0], state[1], state[2]];
        let way = [3, 4, 5].map(|i| state[i] * ahead_s);
        let share = self.deepest(from, way);
        let (excess, out) = self.depth(along(from, way, share));
        let mut gradient = [0.0; STATES];
        for (i, out) in out.into_iter().enumerate() {
            gradient[i] = out;
            gradient[3 + i] = share * ahead_s * out;
        }
        StateRow { excess, gradient }
    }

    /// Depth of a position inside the region [m], negative outside, and its gradient.
    pub(super) fn depth(&self, position: [f64; 3]) -> (f64, [f64; 3]) {
        match self {
            Self::Sphere { centre, radius } => {
                let from = std::array::from_fn(|i| position[i] - centre.to_array()[i]);
                let distance = norm(&from);
                // At the very centre every way out is as good.
                let out =
                    if distance > 0.0 { from.map(|c| c / distance) } else { [0.0, 0.0, -1.0] };
                (radius - distance, out.map(|c| -c))
            }
            Self::Box { lower, upper } => {
                let (lower, upper) = (lower.to_array(), upper.to_array());
                // Beyond each face: positive outside.
                let beyond: [(f64, f64); 3] = std::array::from_fn(|i| {
                    let (under, over) = (lower[i] - position[i], position[i] - upper[i]);
                    if under > over { (under, -1.0) } else { (over, 1.0) }
                });
                let outside: [f64; 3] = std::array::from_fn(|i| beyond[i].0.max(0.0) * beyond[i].1);
                let distance = norm(&outside);
                if distance > 0.0 {
                    return (-distance, outside.map(|c| -c / distance));
                }
                let (nearest, (face, side)) = beyond
                    .into_iter()
                    .enumerate()
                    .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
                    .unwrap_or((0, (0.0, 1.0)));
                let mut gradient = [0.0; 3];
                gradient[nearest] = -side;
                (-face, gradient)
            }
        }
    }
}

/// A share of the way from a position.
fn along(from: [f64; 3], way: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|i| from[i] + share * way[i])
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(v: &[f64; 3]) -> f64 {
    dot(v, v).sqrt()
}

impl<const INPUTS: usize> Problem<INPUTS> {
    /// N.
    pub fn horizon(&self) -> usize {
        self.desired.len()
    }

    /// Distance to the desired state at the end of period `n`, `|W (s - s_d)|`.
    pub fn distance(&self, n: usize, state: &StateVector) -> f64 {
        let desired = &self.desired[n];
        (0..STATES)
            .map(|i| (self.state_weight[i] * (state[i] - desired[i])).powi(2))
            .sum::<f64>()
            .sqrt()
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

    /// Calls `visit` with every bound of the state at the end of period `n`, and of the way on from
    /// it: steps are Euler's, so the next position follows from this state alone.
    pub(super) fn visit_bounds(
        &self,
        n: usize,
        state: &StateVector,
        mut visit: impl FnMut(StateRow),
    ) {
        self.limits.visit(state, &mut visit);
        let ahead_s = if n + 1 < self.horizon() { self.period_s } else { 0.0 };
        for region in &self.keep_out {
            visit(region.row(state, ahead_s));
        }
    }

    /// Sum of what the bounds of the state at the end of period `n` are broken by.
    pub fn excess(&self, n: usize, state: &StateVector) -> f64 {
        let mut sum = 0.0;
        self.visit_bounds(n, state, |row| sum += row.excess.max(0.0));
        sum
    }

    /// How far the position at the end of period `n`, and those on the way on from it, are where
    /// they must not be, m.
    pub(super) fn trespass(&self, n: usize, state: &StateVector) -> f64 {
        let mut most = 0.0_f64;
        self.visit_bounds(n, state, |row| {
            if row.gradient[..3].iter().any(|slope| *slope != 0.0) {
                most = most.max(row.excess);
            }
        });
        most
    }

    /// The bounds that a step from the state at the end of period `n` may meet.
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
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn problem(limits: StateLimits, keep_out: Vec<KeepOut>) -> Problem<4> {
        Problem {
            period_s: 0.1,
            start: [0.0; STATES],
            desired: vec![[0.0; STATES]],
            state_weight: [1.0; STATES],
            inputs: InputBounds { lower: [-1.0; 4], upper: [1.0; 4], scale: [1.0; 4] },
            preference: None,
            limits,
            keep_out,
        }
    }

    fn rows(problem: &Problem<4>, state: &StateVector) -> Vec<StateRow> {
        let mut rows = Vec::new();
        problem.visit_bounds(0, state, |row| rows.push(row));
        rows
    }

    fn regions() -> Vec<KeepOut> {
        vec![
            KeepOut::Sphere { centre: Ned::new(0.3, -0.2, 0.1), radius: 0.7 },
            KeepOut::Box { lower: Ned::new(-0.5, -0.4, -0.6), upper: Ned::new(0.2, 0.6, 0.3) },
        ]
    }

    #[test]
    fn depths_by_hand() {
        let [ball, block] = [regions()[0], regions()[1]];
        assert_eq!(ball.depth([0.3, -0.2, 1.8]), (0.7 - 1.7, [0.0, 0.0, -1.0]));
        // Inside, the nearest face counts; outside, the nearest corner, edge or face.
        let (depth, gradient) = block.depth([0.1, 0.0, 0.0]);
        assert!((depth - 0.1).abs() < 1e-15);
        assert_eq!(gradient, [-1.0, 0.0, 0.0]);
        let (depth, gradient) = block.depth([0.5, 1.0, 0.0]);
        assert!((depth + 0.5).abs() < 1e-12);
        assert!((gradient[0] + 0.6).abs() < 1e-12 && (gradient[1] + 0.8).abs() < 1e-12);
        // At the centre every way out is as good; there is one.
        let (depth, gradient) = ball.depth([0.3, -0.2, 0.1]);
        assert_eq!(depth, 0.7);
        assert_eq!(norm(&gradient), 1.0);
    }

    #[test]
    fn what_lies_between_two_states_is_looked_at() {
        let [ball, block] = [regions()[0], regions()[1]];
        // Along a face, or at rest on it.
        assert_eq!(block.depth_between([-0.5, 0.0, 0.0], [-0.5, 0.3, 0.0]), 0.0);
        assert_eq!(block.depth_between([-0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]), 0.0);
        // A wall of a few millimetres, far thinner than a step is long.
        let wall =
            KeepOut::Box { lower: Ned::new(0.0, -1.0, -1.0), upper: Ned::new(0.004, 1.0, 1.0) };
        let through = wall.depth_between([-0.01, 0.0, 0.0], [0.03, 0.1, 0.0]);
        assert!((through - 0.002).abs() < 1e-12, "{through}");
        assert!(wall.depth_between([-0.03, 0.0, 0.0], [-0.01, 0.1, 0.0]) < 0.0);
        let chord = ball.depth_between([-1.0, -0.2, 0.7], [1.5, -0.2, 0.7]);
        assert!((chord - 0.1).abs() < 1e-12, "{chord}");
        // A corner that is cut.
        let cut = block.depth_between([0.1, 0.7, 0.0], [0.3, 0.5, 0.0]);
        assert!(cut.abs() < 1e-9, "{cut}");
        let cut = block.depth_between([0.0, 0.7, 0.0], [0.3, 0.4, 0.0]);
        assert!((cut - 0.05).abs() < 1e-9, "{cut}");
        let mut problem = problem(StateLimits::default(), vec![wall]);
        problem.desired = vec![[0.0; STATES]; 2];
        let mut state = [0.0; STATES];
        (state[0], state[3]) = (-0.01, 0.4);
        assert!((problem.trespass(0, &state) - 0.002).abs() < 1e-12);
        // Nothing follows the last.
        assert_eq!(problem.trespass(1, &state), 0.0);
    }

    proptest! {
        #[test]
        fn no_position_between_is_deeper(
            from in prop::array::uniform3(-1.0_f64..1.0),
            to in prop::array::uniform3(-1.0_f64..1.0),
            share in 0.0_f64..1.0,
        ) {
            let way = std::array::from_fn(|i| to[i] - from[i]);
            for region in regions() {
                let here = region.depth(along(from, way, share)).0;
                let deepest = region.depth_between(from, to);
                prop_assert!(here <= deepest + 1e-12, "{here} {deepest}");
            }
        }
    }

    #[test]
    fn excess_is_what_each_bound_is_broken_by() {
        let limits = StateLimits {
            tilt_max_rad: Some(0.5),
            body_rate_max_rad_s: Some([1.0, 2.0, 3.0]),
            position: Some((Ned::new(-1.0, -1.0, -2.0), Ned::new(1.0, 1.0, 0.0))),
        };
        let problem = problem(limits, vec![]);
        assert_eq!(problem.excess(0, &[0.0; STATES]), 0.0);
        let mut state = [0.0; STATES];
        (state[1], state[2], state[RATE + 1]) = (1.25, -2.5, -2.75);
        assert!((problem.excess(0, &state) - (0.25 + 0.5 + 0.75)).abs() < 1e-12);
        state = [0.0; STATES];
        state[ANGLE + 1] = 0.501;
        assert!((problem.excess(0, &state) - 0.001).abs() < 1e-5);
    }

    /// What a state is held by: each value, and the gradient that goes with it.
    type Held<'a> = (&'a dyn Fn(&StateVector) -> f64, [f64; STATES]);

    /// Whether a gradient is that of finite differences; `None` at an edge, where there is no one
    /// gradient.
    fn is_slope((value, gradient): Held<'_>, state: &StateVector) -> Option<bool> {
        let step = 1e-6;
        let here = value(state);
        let mut fits = true;
        for (i, expected) in gradient.into_iter().enumerate() {
            let [mut above, mut below] = [*state; 2];
            above[i] += step;
            below[i] -= step;
            let (ahead, behind) = ((value(&above) - here) / step, (here - value(&below)) / step);
            if (ahead - behind).abs() > 1e-3 {
                return None;
            }
            fits &= (0.5 * (ahead + behind) - expected).abs() < 1e-4;
        }
        Some(fits)
    }

    proptest! {
        #[test]
        fn gradients_are_those_of_finite_differences(
            state in prop::array::uniform12(-1.0_f64..1.0),
        ) {
            let limits = StateLimits {
                tilt_max_rad: Some(0.6),
                body_rate_max_rad_s: Some([2.0; 3]),
                position: Some((Ned::new(-0.5, -0.5, -0.5), Ned::new(0.5, 0.5, 0.5))),
            };
            let problem = problem(limits, vec![]);
            for (index, row) in rows(&problem, &state).into_iter().enumerate() {
                let value = |state: &StateVector| rows(&problem, state)[index].excess;
                prop_assert_ne!(is_slope((&value, row.gradient), &state), Some(false));
            }
            for region in regions() {
                let way = |state: &StateVector| [3, 4, 5].map(|i| 0.1 * state[i]);
                let from = |state: &StateVector| [state[0], state[1], state[2]];
                let share = region.deepest(from(&state), way(&state));
                let value =
                    |state: &StateVector| region.depth(along(from(state), way(state), share)).0;
                let row = region.row(&state, 0.1);
                prop_assert_eq!(row.excess, value(&state));
                prop_assert_ne!(is_slope((&value, row.gradient), &state), Some(false));
            }
        }
    }
}
