//! The subproblem in Clarabel: the norm as a second-order cone, and the dynamics as equality
//! constraints or with the paper's l1 penalty.
//!
//! Slower than [`super::interior_point`], but exact where that one approximates the norm to second
//! order: this is the paper's form of the search, and the reference for the other's tests. The
//! matrices keep one sparsity pattern, explicit zeros included: from the second subproblem on, the
//! solver updates the values in place and reuses the symbolic factorisation.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT, ZeroConeT,
};

use super::problem::STATES;
use super::subproblem::{
    DynamicsForm, Solution, Subproblem, SubproblemError, SubproblemSolver, TRUST_SHAPE,
};

/// The solver and its last problem.
pub struct Conic {
    penalises: bool,
    problem: Option<SetUp>,
}

/// A problem of one sparsity pattern inside Clarabel.
struct SetUp {
    layout: Layout,
    solver: DefaultSolver<f64>,
    /// Position of each entry, in writing order, among the matrix's values.
    order: Vec<usize>,
}

/// Size of a stage's cone: the distance, the weighted error, the knee.
const CONE: usize = STATES + 2;

/// The layout of variables and constraints.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Layout {
    stages: usize,
    inputs: usize,
    /// State bounds per stage that the pattern has room for.
    rows: usize,
    penalised: bool,
}

impl Layout {
    /// Number of variables of a stage: inputs, states, distance, overruns, and slacks of both
    /// signs.
    fn width(&self) -> usize {
        self.inputs + STATES + 1 + self.rows + if self.penalised { 2 * STATES } else { 0 }
    }

    fn input(&self, stage: usize) -> usize {
        stage * self.width()
    }

    fn state(&self, stage: usize) -> usize {
        self.input(stage) + self.inputs
    }

    fn distance(&self, stage: usize) -> usize {
        self.state(stage) + STATES
    }

    fn overrun(&self, stage: usize) -> usize {
        self.distance(stage) + 1
    }

    fn slack(&self, stage: usize) -> usize {
        self.overrun(stage) + self.rows
    }

    fn variables(&self) -> usize {
        self.stages * self.width()
    }

    /// Number of inequalities of a stage.
    fn inequalities(&self) -> usize {
        let trust = if self.penalised { 4 * STATES } else { 0 };
        2 * self.inputs + 2 * self.rows + trust
    }

    fn constraints(&self) -> usize {
        self.stages * (STATES + self.inequalities() + CONE)
    }

    fn cones(&self) -> Vec<SupportedConeT<f64>> {
        let mut cones = vec![
            ZeroConeT(self.stages * STATES),
            NonnegativeConeT(self.stages * self.inequalities()),
        ];
        cones.extend((0..self.stages).map(|_| SecondOrderConeT(CONE)));
        cones
    }
}

/// The data of `min x'Px/2 + q'x, A x + s = b, s in cones`, P diagonal.
struct Program {
    /// Row, column and value; each position once, zeros included.
    entries: Vec<(usize, usize, f64)>,
    bounds: Vec<f64>,
    slopes: Vec<f64>,
    curvatures: Vec<f64>,
}

impl Conic {
    /// A solver with the dynamics as equality constraints.
    pub fn equations() -> Self {
        Self { penalises: false, problem: None }
    }

    /// A solver with the l1 penalty on the dynamics.
    pub fn penalised() -> Self {
        Self { penalises: true, problem: None }
    }
}

fn failed(error: impl std::fmt::Display) -> SubproblemError {
    SubproblemError::Solver(format!("Clarabel: {error}"))
}

impl<const INPUTS: usize> SubproblemSolver<INPUTS> for Conic {
    fn dynamics(&self, penalty: f64, trust: f64) -> DynamicsForm {
        if self.penalises {
            DynamicsForm::Penalised { penalty, trust }
        } else {
            DynamicsForm::Equations
        }
    }

    fn solve(
        &mut self,
        problem: &Subproblem<INPUTS>,
        solution: &mut Solution<INPUTS>,
    ) -> Result<(), SubproblemError> {
        let rows = problem.stages.iter().map(|stage| stage.rows.len()).max().unwrap_or(0);
        // Room that was needed once is kept, so the pattern stays the same.
        let rows = rows.max(self.problem.as_ref().map_or(0, |set_up| set_up.layout.rows));
        let layout = Layout {
            stages: problem.stages.len(),
            inputs: INPUTS,
            rows,
            penalised: problem.dynamics != DynamicsForm::Equations,
        };
        let program = program(problem, &layout);
        let numbers = program.entries.iter().map(|(_, _, value)| value);
        if !numbers.chain(&program.bounds).chain(&program.slopes).all(|value| value.is_finite()) {
            return Err(SubproblemError::NotFinite);
        }
        let fitting = self.problem.take().filter(|set_up| set_up.layout == layout);
        let set_up = match fitting {
            Some(set_up) => set_up.updated(&program)?,
            None => SetUp::new(layout, &program)?,
        };
        let set_up = self.problem.insert(set_up);
        set_up.solver.solve();
        let answer = &set_up.solver.solution;
        solution.iterations = answer.iterations as usize;
        match answer.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => {}
            status => return Err(failed(format_args!("{status:?}"))),
        }
        solution.gains.clear();
        solution.states.clear();
        solution.inputs.clear();
        for stage in 0..layout.stages {
            let (input, state) = (layout.input(stage), layout.state(stage));
            solution.inputs.push(std::array::from_fn(|i| answer.x[input + i]));
            solution.states.push(std::array::from_fn(|i| answer.x[state + i]));
        }
        Ok(())
    }
}

impl SetUp {
    fn new(layout: Layout, program: &Program) -> Result<Self, SubproblemError> {
        // Compressed columns need the entries by column and row: find each entry's position.
        let mut sorted: Vec<usize> = (0..program.entries.len()).collect();
        sorted.sort_unstable_by_key(|index| {
            let (row, column, _) = program.entries[*index];
            (column, row)
        });
        let mut order = vec![0; sorted.len()];
        let mut starts = vec![0; layout.variables() + 1];
        let mut rows = Vec::with_capacity(sorted.len());
        let mut values = Vec::with_capacity(sorted.len());
        for (place, index) in sorted.into_iter().enumerate() {
            let (row, column, value) = program.entries[index];
            order[index] = place;
            starts[column + 1] = place + 1;
            rows.push(row);
            values.push(value);
        }
        for column in 0..layout.variables() {
            starts[column + 1] = starts[column + 1].max(starts[column]);
        }
        let matrix = CscMatrix::new(layout.constraints(), layout.variables(), starts, rows, values);
        let variables = layout.variables();
        let curvature = CscMatrix::new(
            variables,
            variables,
            (0..=variables).collect(),
            (0..variables).collect(),
            program.curvatures.clone(),
        );
        let settings = DefaultSettings {
            verbose: false,
            presolve_enable: false,
            input_sparse_dropzeros: false,
            direct_solve_method: "qdldl".to_owned(),
            ..DefaultSettings::default()
        };
        let solver = DefaultSolver::new(
            &curvature,
            &program.slopes,
            &matrix,
            &program.bounds,
            &layout.cones(),
            settings,
        )
        .map_err(failed)?;
        Ok(Self { layout, solver, order })
    }

    fn updated(mut self, program: &Program) -> Result<Self, SubproblemError> {
        let mut values = vec![0.0; self.order.len()];
        for ((_, _, value), place) in program.entries.iter().zip(&self.order) {
            values[*place] = *value;
        }
        self.solver
            .update_data(&program.curvatures, &program.slopes, &values, &program.bounds)
            .map_err(failed)?;
        Ok(self)
    }
}

/// Writes the subproblem's data, in an order that does not depend on the values.
fn program<const INPUTS: usize>(problem: &Subproblem<INPUTS>, layout: &Layout) -> Program {
    let mut program = Program {
        entries: Vec::new(),
        bounds: vec![0.0; layout.constraints()],
        slopes: vec![0.0; layout.variables()],
        curvatures: vec![0.0; layout.variables()],
    };
    let inequalities = layout.stages * STATES;
    let cones = inequalities + layout.stages * layout.inequalities();
    let mut inequality = inequalities;
    for (n, stage) in problem.stages.iter().enumerate() {
        let (input, state) = (layout.input(n), layout.state(n));
        // d+ - A d - B w (- up + down) = c
        for i in 0..STATES {
            let row = n * STATES + i;
            program.bounds[row] = stage.step.next[i];
            program.entries.push((row, state + i, 1.0));
            for (j, b) in stage.step.input[i].iter().enumerate() {
                program.entries.push((row, input + j, -b));
            }
            if n > 0 {
                for (j, a) in stage.step.state[i].iter().enumerate() {
                    program.entries.push((row, layout.state(n - 1) + j, -a));
                }
            }
            if layout.penalised {
                program.entries.push((row, layout.slack(n) + i, -1.0));
                program.entries.push((row, layout.slack(n) + STATES + i, 1.0));
            }
        }
        let mut at_most = |terms: &[(usize, f64)], bound: f64| {
            program
                .entries
                .extend(terms.iter().map(|(column, value)| (inequality, *column, *value)));
            program.bounds[inequality] = bound;
            inequality += 1;
        };
        for i in 0..INPUTS {
            at_most(&[(input + i, 1.0)], stage.upper[i]);
            at_most(&[(input + i, -1.0)], -stage.lower[i]);
        }
        for j in 0..layout.rows {
            let overrun = layout.overrun(n) + j;
            let row = stage.rows.get(j);
            let mut terms = [(overrun, -1.0); STATES + 1];
            for (i, term) in terms[..STATES].iter_mut().enumerate() {
                *term = (state + i, row.map_or(0.0, |row| row.gradient[i]));
            }
            at_most(&terms, row.map_or(0.0, |row| -row.excess));
            at_most(&[(overrun, -1.0)], 0.0);
            program.slopes[overrun] = problem.row_penalty;
        }
        if let DynamicsForm::Penalised { penalty, trust } = problem.dynamics {
            for (i, shape) in TRUST_SHAPE.iter().enumerate() {
                let most = trust * shape;
                at_most(&[(state + i, 1.0)], most);
                at_most(&[(state + i, -1.0)], most);
                for slack in [layout.slack(n) + i, layout.slack(n) + STATES + i] {
                    at_most(&[(slack, -1.0)], 0.0);
                    program.slopes[slack] = penalty;
                }
            }
        }
        // (tau, error + W d, knee) in the cone
        let cone = cones + n * CONE;
        program.bounds[cone + 1 + STATES] = problem.knee;
        program.entries.push((cone, layout.distance(n), -1.0));
        program.slopes[layout.distance(n)] = 1.0;
        for i in 0..STATES {
            program.entries.push((cone + 1 + i, state + i, -problem.state_weight[i]));
            program.bounds[cone + 1 + i] = stage.error[i];
        }
        for i in 0..INPUTS {
            program.slopes[input + i] = stage.input_gradient[i];
            program.curvatures[input + i] = stage.input_curvature;
        }
    }
    program
}
