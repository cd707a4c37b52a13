//! A primal-dual interior-point method for the subproblem, stage by stage.
//!
//! The norm is approximated to second order, so the subproblem is a quadratic program whose Newton
//! system is that of a linear-quadratic regulator. A Riccati recursion solves it in one backward
//! and one forward sweep, and the work grows only linearly with the horizon (Rao, Wright and
//! Rawlings 1998, "Application of interior-point methods to model predictive control"). Predictor
//! and corrector are Mehrotra's (1992).
//!
//! Where no bound is active, one such sweep without bounds is the solution. The solver tries it
//! first if the last subproblem's solution was clear of its bounds: this is common near the end of
//! a search, and for a plan that continues its predecessor.

// Matrix algebra reads best with explicit indices.
#![allow(clippy::needless_range_loop)]

use super::problem::{STATES, StateVector};
use super::slack::{Pair, SoftRow};
use super::stage_algebra::{
    Matrix, NotPositive, add_scaled, cholesky, dot, product, solve_rows, solve_vector,
    times_vector, transposed_product, transposed_times,
};
use super::subproblem::{
    DynamicsForm, QuadraticNorm, Solution, Stage, Subproblem, SubproblemError, SubproblemSolver,
};

/// Iterations after which the solver gives up.
const ITERATIONS_MAX: usize = 60;
/// Largest fraction of the way to the nearest bound that a step may take.
const TO_BOUNDARY: f64 = 0.995;
/// Least distance between the bounds of an input.
const LEAST_ROOM: f64 = 1e-9;
/// Fraction of the way to a bound below which the bound counts as inactive: an interior point ends
/// short of it.
const CLEAR: f64 = 0.9;
/// Least curvature of each scaled input.
const LEAST_INPUT_CURVATURE: f64 = 1e-9;

/// The solver with its workspace.
#[derive(Clone, Debug, Default)]
pub struct InteriorPoint<const INPUTS: usize> {
    work: Vec<Work<INPUTS>>,
    /// Whether a bound was active in the last solution.
    is_bound: bool,
}

#[derive(Clone, Debug)]
struct Work<const INPUTS: usize> {
    /// Quadratic model of the cost at the end of the period.
    cost: QuadraticNorm,
    rows: Vec<SoftRow>,
    /// Current point.
    state: StateVector,
    input: [f64; INPUTS],
    lower: [Pair; INPUTS],
    upper: [Pair; INPUTS],
    lower_target: [f64; INPUTS],
    upper_target: [f64; INPUTS],
    /// Newton's point.
    next_state: StateVector,
    next_input: [f64; INPUTS],
    /// Factorisation: gain K, Cholesky factor of `R + B' P B`, and `P c`.
    gain: Matrix<INPUTS, STATES>,
    factor: Matrix<INPUTS, INPUTS>,
    pushed_offset: StateVector,
    /// Feed-forward k.
    constant: [f64; INPUTS],
}

impl<const INPUTS: usize> Default for Work<INPUTS> {
    fn default() -> Self {
        Self {
            cost: QuadraticNorm::default(),
            rows: Vec::new(),
            state: [0.0; STATES],
            input: [0.0; INPUTS],
            lower: [Pair::default(); INPUTS],
            upper: [Pair::default(); INPUTS],
            lower_target: [0.0; INPUTS],
            upper_target: [0.0; INPUTS],
            next_state: [0.0; STATES],
            next_input: [0.0; INPUTS],
            gain: [[0.0; STATES]; INPUTS],
            factor: [[0.0; INPUTS]; INPUTS],
            pushed_offset: [0.0; STATES],
            constant: [0.0; INPUTS],
        }
    }
}

impl<const INPUTS: usize> SubproblemSolver<INPUTS> for InteriorPoint<INPUTS> {
    fn dynamics(&self, _penalty: f64, _trust: f64) -> DynamicsForm {
        DynamicsForm::Equations
    }

    fn solve(
        &mut self,
        problem: &Subproblem<INPUTS>,
        solution: &mut Solution<INPUTS>,
    ) -> Result<(), SubproblemError> {
        if problem.dynamics != DynamicsForm::Equations {
            return Err(SubproblemError::Form);
        }
        self.work.resize_with(problem.stages.len(), Work::default);
        let tried = if self.is_bound { 0 } else { 1 };
        solution.iterations = if tried > 0 && without_bounds(&mut self.work, problem) {
            tried
        } else {
            tried + iterate(&mut self.work, problem)?
        };
        let mut stages = self.work.iter().zip(&problem.stages);
        self.is_bound = !stages.all(|(work, stage)| work.is_clear(stage));
        solution.states.clear();
        solution.inputs.clear();
        solution.gains.clear();
        for work in &self.work {
            solution.states.push(work.state);
            solution.inputs.push(work.input);
            solution.gains.push(work.gain);
        }
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        if self.work.iter().all(|work| finite(&work.state) && finite(&work.input)) {
            Ok(())
        } else {
            Err(SubproblemError::NotFinite)
        }
    }
}

/// Solves the problem as if it had no bounds; false if the solution violates one.
fn without_bounds<const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> bool {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the check above found both instruction sets.
        return unsafe { without_bounds_avx2(work, problem) };
    }
    without_bounds_with::<false, INPUTS>(work, problem)
}

/// [`without_bounds`] for machines with AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn without_bounds_avx2<const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> bool {
    without_bounds_with::<true, INPUTS>(work, problem)
}

#[inline(always)]
fn without_bounds_with<const FUSED: bool, const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> bool {
    let stages = &problem.stages;
    work.iter_mut().zip(stages).for_each(|(work, stage)| work.free(stage, problem));
    if factorise::<FUSED, INPUTS>(work, stages).is_err() {
        return false;
    }
    solve::<FUSED, INPUTS>(work, stages);
    work.iter_mut().zip(stages).all(|(work, stage)| {
        (work.state, work.input) = (work.next_state, work.next_input);
        let mut inputs = work.input.iter().zip(stage.lower.iter().zip(&stage.upper));
        inputs.all(|(w, (lower, upper))| (*lower..=*upper).contains(w))
            && stage.rows.iter().all(|row| row.excess + dot(&row.gradient, &work.state) <= 0.0)
    })
}

/// Solves the problem in `work`; returns the number of iterations.
fn iterate<const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> Result<usize, SubproblemError> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the check above found both instruction sets.
        return unsafe { iterate_avx2(work, problem) };
    }
    iterate_with::<false, INPUTS>(work, problem)
}

/// [`iterate`] for machines with AVX2 and FMA, which the package's build does not assume.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn iterate_avx2<const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> Result<usize, SubproblemError> {
    iterate_with::<true, INPUTS>(work, problem)
}

#[inline(always)]
fn iterate_with<const FUSED: bool, const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    problem: &Subproblem<INPUTS>,
) -> Result<usize, SubproblemError> {
    let mut pairs = 0;
    for (work, stage) in work.iter_mut().zip(&problem.stages) {
        work.start(stage, problem);
        pairs += 2 * (INPUTS + work.rows.len());
    }
    let pairs = pairs as f64;
    // The dynamics hold from the first full step on; a shorter step leaves a fraction of the
    // defect.
    let mut open = 1.0;
    for iteration in 1..=ITERATIONS_MAX {
        let gap: f64 = work.iter().map(|work| work.gap(0.0)).sum();
        if !gap.is_finite() {
            return Err(SubproblemError::NotFinite);
        }
        if gap <= problem.tolerance && open < 1e-9 {
            return Ok(iteration - 1);
        }
        // Predictor: targets complementarity 0.
        work.iter_mut().for_each(Work::aim_at_zero);
        factorise::<FUSED, INPUTS>(work, &problem.stages)?;
        solve::<FUSED, INPUTS>(work, &problem.stages);
        let share = reach(work).min(1.0);
        let ahead: f64 = work.iter().map(|work| work.gap(share)).sum();
        let centring = (ahead / gap).powi(3).min(1.0);
        // Corrector.
        let centre = centring * gap / pairs;
        work.iter_mut().for_each(|work| work.aim_at(centre));
        solve::<FUSED, INPUTS>(work, &problem.stages);
        let share = (TO_BOUNDARY * reach(work)).min(1.0);
        work.iter_mut().for_each(|work| work.advance(share));
        open *= 1.0 - share;
    }
    Err(SubproblemError::Solver("its iteration limit".to_owned()))
}

#[inline(always)]
fn reach<const INPUTS: usize>(work: &[Work<INPUTS>]) -> f64 {
    work.iter().map(Work::reach).fold(f64::INFINITY, f64::min)
}

impl<const INPUTS: usize> Work<INPUTS> {
    /// Removes the bounds.
    #[inline(always)]
    fn free(&mut self, stage: &Stage<INPUTS>, problem: &Subproblem<INPUTS>) {
        self.cost = QuadraticNorm::new(&stage.error, &problem.state_weight, problem.knee);
        (self.state, self.input) = ([0.0; STATES], [0.0; INPUTS]);
        // A slack whose multiplier is 0 exerts no force.
        let idle = Pair { slack: 1.0, ..Pair::default() };
        (self.lower, self.upper) = ([idle; INPUTS], [idle; INPUTS]);
        (self.lower_target, self.upper_target) = ([0.0; INPUTS], [0.0; INPUTS]);
        self.rows.clear();
    }

    /// Whether the point is clear of the bounds: within [`CLEAR`] of the way to each.
    fn is_clear(&self, stage: &Stage<INPUTS>) -> bool {
        let mut inputs = self.input.iter().zip(stage.lower.iter().zip(&stage.upper));
        inputs.all(|(w, (lower, upper))| ((CLEAR * lower)..=(CLEAR * upper)).contains(w))
            && stage.rows.iter().all(|row| row.excess + dot(&row.gradient, &self.state) < 0.0)
    }

    /// Puts the point inside the bounds.
    #[inline(always)]
    fn start(&mut self, stage: &Stage<INPUTS>, problem: &Subproblem<INPUTS>) {
        self.cost = QuadraticNorm::new(&stage.error, &problem.state_weight, problem.knee);
        self.state = [0.0; STATES];
        for i in 0..INPUTS {
            // A fixed input gets negligible room to move.
            let lower = stage.lower[i];
            let upper = stage.upper[i].max(lower + LEAST_ROOM);
            // The deviation nearest to 0 that leaves a tenth of the range to each bound.
            let inset = 0.1 * (upper - lower);
            self.input[i] = 0.0_f64.max(lower + inset).min(upper - inset);
            self.lower[i] = Pair::new(self.input[i] - lower);
            self.upper[i] = Pair::new(upper - self.input[i]);
        }
        self.rows.clear();
        self.rows.extend(stage.rows.iter().map(|row| {
            let overrun = row.excess.max(0.0) + 0.1;
            let half = 0.5 * problem.row_penalty;
            let pair = |slack| Pair { slack, multiplier: half, ..Pair::default() };
            SoftRow {
                row: *row,
                room: pair(overrun - row.excess),
                overrun: pair(overrun),
                room_target: 0.0,
                overrun_target: 0.0,
            }
        }));
    }

    /// Sum of the complementarities after a fraction of the direction.
    #[inline(always)]
    fn gap(&self, share: f64) -> f64 {
        let mut sum = 0.0;
        for i in 0..INPUTS {
            sum += self.lower[i].after(share) + self.upper[i].after(share);
        }
        for row in &self.rows {
            sum += row.room.after(share) + row.overrun.after(share);
        }
        sum
    }

    /// Largest fraction of the direction that keeps every pair above 0.
    #[inline(always)]
    fn reach(&self) -> f64 {
        let mut share = f64::INFINITY;
        for i in 0..INPUTS {
            share = share.min(self.lower[i].reach()).min(self.upper[i].reach());
        }
        for row in &self.rows {
            share = share.min(row.room.reach()).min(row.overrun.reach());
        }
        share
    }

    #[inline(always)]
    fn aim_at_zero(&mut self) {
        self.lower_target = [0.0; INPUTS];
        self.upper_target = [0.0; INPUTS];
        for row in &mut self.rows {
            (row.room_target, row.overrun_target) = (0.0, 0.0);
        }
    }

    #[inline(always)]
    fn aim_at(&mut self, centre: f64) {
        for i in 0..INPUTS {
            self.lower_target[i] = self.lower[i].corrected(centre);
            self.upper_target[i] = self.upper[i].corrected(centre);
        }
        for row in &mut self.rows {
            row.room_target = row.room.corrected(centre);
            row.overrun_target = row.overrun.corrected(centre);
        }
    }

    /// Gradient of the Newton system with respect to the input, at `w = 0`.
    #[inline(always)]
    fn input_gradient(&self, stage: &Stage<INPUTS>) -> [f64; INPUTS] {
        let mut gradient = stage.input_gradient;
        for i in 0..INPUTS {
            let (lower, upper) = (&self.lower[i], &self.upper[i]);
            gradient[i] += upper.aim(self.upper_target[i])
                - lower.aim(self.lower_target[i])
                - (lower.ratio() + upper.ratio()) * self.input[i];
        }
        gradient
    }

    /// Curvature of the Newton system with respect to the input.
    #[inline(always)]
    fn input_curvature(&self, stage: &Stage<INPUTS>, i: usize) -> f64 {
        stage.input_curvature
            + LEAST_INPUT_CURVATURE
            + self.lower[i].ratio()
            + self.upper[i].ratio()
    }

    /// Gradient of the Newton system with respect to the state, at `d = 0`.
    #[inline(always)]
    fn state_gradient(&self) -> StateVector {
        let mut gradient = self.cost.gradient;
        for row in &self.rows {
            let force = row.force() - row.curvature() * dot(&row.row.gradient, &self.state);
            for (sum, slope) in gradient.iter_mut().zip(&row.row.gradient) {
                *sum += force * slope;
            }
        }
        gradient
    }

    /// Adds the curvature of the Newton system with respect to the state.
    #[inline(always)]
    fn add_state_curvature<const FUSED: bool>(&self, sums: &mut Matrix<STATES, STATES>) {
        let QuadraticNorm { diagonal, ray, .. } = &self.cost;
        for i in 0..STATES {
            add_scaled::<FUSED, STATES>(&mut sums[i], -ray[i], ray);
            sums[i][i] += diagonal[i];
        }
        for row in &self.rows {
            let curvature = row.curvature();
            for (sums, slope) in sums.iter_mut().zip(&row.row.gradient) {
                if *slope != 0.0 {
                    add_scaled::<FUSED, STATES>(sums, curvature * slope, &row.row.gradient);
                }
            }
        }
    }

    /// Converts the Newton point to the direction of every pair.
    #[inline(always)]
    fn point(&mut self) {
        for i in 0..INPUTS {
            let step = self.next_input[i] - self.input[i];
            self.lower[i].point(step, self.lower_target[i]);
            self.upper[i].point(-step, self.upper_target[i]);
        }
        for row in &mut self.rows {
            let slope = &row.row.gradient;
            row.point(dot(slope, &self.next_state) - dot(slope, &self.state));
        }
    }

    #[inline(always)]
    fn advance(&mut self, share: f64) {
        for i in 0..STATES {
            self.state[i] += share * (self.next_state[i] - self.state[i]);
        }
        for i in 0..INPUTS {
            self.input[i] += share * (self.next_input[i] - self.input[i]);
            self.lower[i].advance(share);
            self.upper[i].advance(share);
        }
        for row in &mut self.rows {
            row.room.advance(share);
            row.overrun.advance(share);
        }
    }
}

/// The backward sweep: gains and factors of every stage.
#[inline(always)]
fn factorise<const FUSED: bool, const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    stages: &[Stage<INPUTS>],
) -> Result<(), SubproblemError> {
    let mut value = [[0.0; STATES]; STATES];
    for (work, stage) in work.iter_mut().zip(stages).rev() {
        // P at the end of the period, from the stages after it.
        work.add_state_curvature::<FUSED>(&mut value);
        let (a, b) = (&stage.step.state, &stage.step.input);
        work.pushed_offset = times_vector::<FUSED, STATES, STATES>(&value, &stage.step.next);
        let value_a = product::<FUSED, STATES, STATES, STATES>(&value, a);
        // P is symmetric: B' P = (P B)'.
        let value_b = product::<FUSED, STATES, STATES, INPUTS>(&value, b);
        let mut factor = transposed_product::<FUSED, STATES, INPUTS, INPUTS>(b, &value_b);
        for (i, row) in factor.iter_mut().enumerate() {
            row[i] += work.input_curvature(stage, i);
        }
        let cross = transposed_product::<FUSED, STATES, INPUTS, STATES>(b, &value_a);
        cholesky(&mut factor).map_err(|NotPositive| SubproblemError::NotFinite)?;
        let mut gain = cross.map(|row| row.map(|entry| -entry));
        solve_rows::<FUSED, INPUTS, STATES>(&factor, &mut gain);
        value = transposed_product::<FUSED, STATES, STATES, STATES>(a, &value_a);
        for (cross, gain) in cross.iter().zip(&gain) {
            for (value, cross) in value.iter_mut().zip(cross) {
                add_scaled::<FUSED, STATES>(value, *cross, gain);
            }
        }
        // Rounding must not make P asymmetric over a thousand stages.
        for i in 0..STATES {
            for j in 0..i {
                let mean = 0.5 * (value[i][j] + value[j][i]);
                (value[i][j], value[j][i]) = (mean, mean);
            }
        }
        work.gain = gain;
        work.factor = factor;
    }
    Ok(())
}

/// The Newton point for the current targets, from the factorisation.
#[inline(always)]
fn solve<const FUSED: bool, const INPUTS: usize>(
    work: &mut [Work<INPUTS>],
    stages: &[Stage<INPUTS>],
) {
    let mut costate = [0.0; STATES];
    for (work, stage) in work.iter_mut().zip(stages).rev() {
        let mut pushed = work.state_gradient();
        for i in 0..STATES {
            pushed[i] += work.pushed_offset[i] + costate[i];
        }
        let mut slope = work.input_gradient(stage);
        transposed_times::<FUSED, STATES, INPUTS>(&stage.step.input, &pushed, &mut slope);
        costate = [0.0; STATES];
        transposed_times::<FUSED, STATES, STATES>(&stage.step.state, &pushed, &mut costate);
        transposed_times::<FUSED, INPUTS, STATES>(&work.gain, &slope, &mut costate);
        work.constant = slope.map(|slope| -slope);
        solve_vector(&work.factor, &mut work.constant);
    }
    let mut state = [0.0; STATES];
    for (work, stage) in work.iter_mut().zip(stages) {
        let fed_back = times_vector::<FUSED, INPUTS, STATES>(&work.gain, &state);
        for i in 0..INPUTS {
            work.next_input[i] = work.constant[i] + fed_back[i];
        }
        let by_state = times_vector::<FUSED, STATES, STATES>(&stage.step.state, &state);
        let by_input = times_vector::<FUSED, STATES, INPUTS>(&stage.step.input, &work.next_input);
        for i in 0..STATES {
            state[i] = by_state[i] + by_input[i] + stage.step.next[i];
        }
        work.next_state = state;
        work.point();
    }
}
