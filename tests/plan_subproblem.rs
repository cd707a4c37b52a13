//! The Riccati interior point against Clarabel, on random subproblems.

// Matrix algebra reads by its indices.
#![allow(clippy::needless_range_loop)]

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use downwash::plan::conic::Conic;
use downwash::plan::discretisation::LinearStep;
use downwash::plan::interior_point::InteriorPoint;
use downwash::plan::problem::{STATES, StateRow};
use downwash::plan::subproblem::{
    DynamicsForm, QuadraticNorm, Solution, Stage, Subproblem, SubproblemError, SubproblemSolver,
};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Parameters of a random subproblem.
#[derive(Clone, Copy, Debug)]
struct Kind {
    stages: usize,
    /// Size of A's eigenvalues: above 1 the states diverge.
    growth: f64,
    /// Size of the errors at each stage.
    error: f64,
    /// The distance's knee.
    knee: f64,
    /// Size of the trust region.
    trust: f64,
    /// Bounds of the state in each stage.
    rows: usize,
    /// Curvature of the cost by the inputs.
    curvature: f64,
}

fn subproblem<const INPUTS: usize>(kind: Kind, seed: u64) -> Subproblem<INPUTS> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut one = move || random.random_range(-1.0..1.0_f64);
    let stages = (0..kind.stages)
        .map(|_| {
            let mut state = [[0.0; STATES]; STATES];
            for (i, row) in state.iter_mut().enumerate() {
                for entry in row.iter_mut() {
                    *entry = 0.05 * one();
                }
                row[i] += kind.growth;
            }
            // Some inputs are already at a bound.
            let mut room = || if one() > 0.4 { 0.0 } else { kind.trust };
            let (lower, upper): ([f64; INPUTS], [f64; INPUTS]) =
                (std::array::from_fn(|_| -room()), std::array::from_fn(|_| room()));
            Stage {
                step: LinearStep {
                    next: std::array::from_fn(|_| 0.05 * one()),
                    state,
                    input: std::array::from_fn(|_| std::array::from_fn(|_| 0.3 * one())),
                },
                error: std::array::from_fn(|_| kind.error * one()),
                input_gradient: std::array::from_fn(|_| 0.1 * one()),
                input_curvature: kind.curvature,
                lower,
                upper,
                rows: (0..kind.rows)
                    .map(|_| StateRow {
                        excess: 0.2 * one() - 0.1,
                        gradient: std::array::from_fn(|_| one()),
                    })
                    .collect(),
            }
        })
        .collect();
    Subproblem {
        stages,
        state_weight: std::array::from_fn(|i| 0.5 + 0.1 * i as f64),
        knee: kind.knee,
        row_penalty: 5.0,
        dynamics: DynamicsForm::Equations,
        tolerance: 1e-9,
    }
}

/// The norm to second order, everything else unchanged.
fn quadratic_objective<const INPUTS: usize>(
    problem: &Subproblem<INPUTS>,
    states: &[[f64; STATES]],
    inputs: &[[f64; INPUTS]],
) -> f64 {
    let mut sum = 0.0;
    for ((stage, d), w) in problem.stages.iter().zip(states).zip(inputs) {
        let norm = QuadraticNorm::new(&stage.error, &problem.state_weight, problem.knee);
        let along: f64 = norm.ray.iter().zip(d).map(|(ray, d)| ray * d).sum();
        sum -= 0.5 * along * along;
        for i in 0..STATES {
            sum += d[i] * (norm.gradient[i] + 0.5 * norm.diagonal[i] * d[i]);
        }
        for i in 0..INPUTS {
            sum += w[i] * (stage.input_gradient[i] + 0.5 * stage.input_curvature * w[i]);
        }
        for row in &stage.rows {
            let slope: f64 = row.gradient.iter().zip(d).map(|(g, d)| g * d).sum();
            sum += problem.row_penalty * (row.excess + slope).max(0.0);
        }
    }
    sum
}

/// The same quadratic program in dense form, solved by Clarabel: states, inputs.
fn oracle<const INPUTS: usize>(
    problem: &Subproblem<INPUTS>,
) -> (Vec<[f64; STATES]>, Vec<[f64; INPUTS]>) {
    let rows = problem.stages[0].rows.len();
    let width = INPUTS + STATES + rows;
    let variables = problem.stages.len() * width;
    let mut hessian = DMatrix::<f64>::zeros(variables, variables);
    let mut slope = DVector::<f64>::zeros(variables);
    let mut equations: Vec<(Vec<(usize, f64)>, f64)> = Vec::new();
    let mut inequalities: Vec<(Vec<(usize, f64)>, f64)> = Vec::new();
    for (n, stage) in problem.stages.iter().enumerate() {
        let input = n * width;
        let (state, overrun) = (input + INPUTS, input + INPUTS + STATES);
        let norm = QuadraticNorm::new(&stage.error, &problem.state_weight, problem.knee);
        for i in 0..STATES {
            slope[state + i] = norm.gradient[i];
            for j in 0..STATES {
                hessian[(state + i, state + j)] = -norm.ray[i] * norm.ray[j];
            }
            hessian[(state + i, state + i)] += norm.diagonal[i];
            let mut terms = vec![(state + i, 1.0)];
            terms.extend((0..INPUTS).map(|j| (input + j, -stage.step.input[i][j])));
            if n > 0 {
                let before = state - width;
                terms.extend((0..STATES).map(|j| (before + j, -stage.step.state[i][j])));
            }
            equations.push((terms, stage.step.next[i]));
        }
        for i in 0..INPUTS {
            slope[input + i] = stage.input_gradient[i];
            hessian[(input + i, input + i)] = stage.input_curvature;
            inequalities.push((vec![(input + i, 1.0)], stage.upper[i]));
            inequalities.push((vec![(input + i, -1.0)], -stage.lower[i]));
        }
        for (j, row) in stage.rows.iter().enumerate() {
            slope[overrun + j] = problem.row_penalty;
            let mut terms = vec![(overrun + j, -1.0)];
            terms.extend((0..STATES).map(|i| (state + i, row.gradient[i])));
            inequalities.push((terms, -row.excess));
            inequalities.push((vec![(overrun + j, -1.0)], 0.0));
        }
    }
    let cones = [ZeroConeT(equations.len()), NonnegativeConeT(inequalities.len())];
    equations.append(&mut inequalities);
    let mut matrix = DMatrix::<f64>::zeros(equations.len(), variables);
    for (row, (terms, _)) in equations.iter().enumerate() {
        for (column, value) in terms {
            matrix[(row, *column)] = *value;
        }
    }
    let bounds: Vec<f64> = equations.iter().map(|(_, bound)| *bound).collect();
    let settings = DefaultSettings {
        verbose: false,
        tol_gap_abs: 1e-11,
        tol_gap_rel: 1e-11,
        tol_feas: 1e-11,
        ..DefaultSettings::default()
    };
    let sparse = |matrix: &DMatrix<f64>| -> CscMatrix<f64> {
        let rows: Vec<Vec<f64>> =
            matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
        CscMatrix::from(rows.iter())
    };
    let mut solver = DefaultSolver::new(
        &sparse(&hessian.upper_triangle()),
        slope.as_slice(),
        &sparse(&matrix),
        &bounds,
        &cones,
        settings,
    )
    .expect("a program");
    solver.solve();
    let status = solver.solution.status;
    assert!(matches!(status, SolverStatus::Solved | SolverStatus::AlmostSolved), "{status:?}");
    let x = &solver.solution.x;
    let stages = 0..problem.stages.len();
    (
        stages.clone().map(|n| std::array::from_fn(|i| x[n * width + INPUTS + i])).collect(),
        stages.map(|n| std::array::from_fn(|i| x[n * width + i])).collect(),
    )
}

fn solved<const INPUTS: usize>(problem: &Subproblem<INPUTS>) -> Solution<INPUTS> {
    let mut solution = Solution::default();
    InteriorPoint::default().solve(problem, &mut solution).expect("a solution");
    solution
}

fn kinds() -> impl Strategy<Value = Kind> {
    let kind = (
        2_usize..12,
        0.6_f64..1.3,
        0.3_f64..3.0,
        0.0_f64..0.3,
        0.01_f64..1.0,
        0_usize..3,
        0.0_f64..0.1,
    );
    kind.prop_map(|(stages, growth, error, knee, trust, rows, curvature)| Kind {
        stages,
        growth,
        error,
        knee,
        trust,
        rows,
        curvature,
    })
}

fn compare<const INPUTS: usize>(
    problem: &Subproblem<INPUTS>,
) -> Result<(), proptest::test_runner::TestCaseError> {
    let ours = solved(problem);
    let (states, inputs) = oracle(problem);
    for (stage, w) in problem.stages.iter().zip(&ours.inputs) {
        for i in 0..INPUTS {
            prop_assert!(stage.lower[i] - 2e-9 <= w[i] && w[i] <= stage.upper[i] + 2e-9);
        }
    }
    prop_assert!(problem.defect(&ours) < 1e-8, "defect {:e}", problem.defect(&ours));
    let [ours, theirs] = [
        quadratic_objective(problem, &ours.states, &ours.inputs),
        quadratic_objective(problem, &states, &inputs),
    ];
    prop_assert!((ours - theirs).abs() < 1e-6 * (1.0 + theirs.abs()), "{ours} against {theirs}");
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn interior_point_reaches_the_quadratic_optimum(kind in kinds(), seed in any::<u64>()) {
        compare(&subproblem::<4>(kind, seed))?;
        compare(&subproblem::<7>(kind, seed))?;
    }

    /// Bounds out of reach cost no iterations, and reachable ones are found.
    #[test]
    fn inactive_bounds_cost_only_one_sweep(kind in kinds(), seed in any::<u64>()) {
        let kind = Kind { growth: kind.growth.min(1.0), curvature: 0.1 + kind.curvature, ..kind };
        let mut problem = subproblem::<7>(kind, seed);
        for stage in &mut problem.stages {
            (stage.lower, stage.upper) = ([-1e6; 7], [1e6; 7]);
            stage.rows.iter_mut().for_each(|row| row.excess = -1e6);
        }
        let (mut solver, mut solution) = (InteriorPoint::default(), Solution::default());
        solver.solve(&problem, &mut solution).expect("a solution");
        prop_assert_eq!(solution.iterations, 1);
        compare(&problem)?;
        // The same solver on a problem whose bounds are tighter than that solution.
        let most = solution.inputs.iter().flatten().fold(0.0_f64, |most, w| most.max(w.abs()));
        for stage in &mut problem.stages {
            (stage.lower, stage.upper) = ([-0.5 * most; 7], [0.5 * most; 7]);
        }
        solver.solve(&problem, &mut solution).expect("a solution");
        prop_assert!(solution.iterations > 1);
        compare(&problem)?;
        let within = |w: &f64| w.abs() <= 0.5 * most + 2e-9;
        prop_assert!(solution.inputs.iter().flatten().all(within));
    }

    /// Where the step is small compared to the errors, the norm equals its second-order form.
    #[test]
    fn interior_point_agrees_with_cones_for_small_steps(kind in kinds(), seed in any::<u64>()) {
        let kind = Kind { error: 2e3, trust: 0.1 * kind.trust, rows: kind.rows.min(1), ..kind };
        let mut problem = subproblem::<4>(kind, seed);
        problem.tolerance = 1e-8;
        let ours = solved(&problem);
        let mut theirs = Solution::default();
        // With errors this large the reference solver fails now and then.
        prop_assume!(Conic::equations().solve(&problem, &mut theirs).is_ok());
        let (ours, theirs) = (problem.change(&ours), problem.change(&theirs));
        // Errors of 2e3 leave 1e-8 relative in the cones' objective.
        let scale = 2e3 * kind.stages as f64;
        prop_assert!((ours - theirs).abs() < 1e-7 * scale, "{ours} against {theirs}");
    }
}

#[test]
fn large_penalty_recovers_the_equality_solution() {
    let kind = Kind {
        stages: 8,
        growth: 1.1,
        error: 1.0,
        knee: 0.05,
        trust: 0.3,
        rows: 1,
        curvature: 0.01,
    };
    let mut problem = subproblem::<4>(kind, 5);
    let mut exact = Solution::default();
    Conic::equations().solve(&problem, &mut exact).expect("a solution");
    problem.dynamics = DynamicsForm::Penalised { penalty: 1e3, trust: 1e3 };
    let mut penalised = Solution::default();
    Conic::penalised().solve(&problem, &mut penalised).expect("a solution");
    assert!(problem.defect(&penalised) < 1e-6);
    assert!((problem.change(&exact) - problem.change(&penalised)).abs() < 1e-6);
    let refused = InteriorPoint::default().solve(&problem, &mut penalised);
    assert_eq!(refused, Err(SubproblemError::Form));
}

#[test]
fn updating_in_place_matches_a_new_setup() {
    let kind = Kind {
        stages: 6,
        growth: 1.0,
        error: 1.0,
        knee: 0.05,
        trust: 0.3,
        rows: 2,
        curvature: 0.01,
    };
    let mut kept = Conic::equations();
    for seed in 0..4 {
        let mut problem = subproblem::<4>(kind, seed);
        // Rows appear and disappear.
        for stage in problem.stages.iter_mut().skip(seed as usize) {
            stage.rows.truncate(1);
        }
        let [mut ours, mut theirs] = [Solution::default(), Solution::default()];
        kept.solve(&problem, &mut ours).expect("a solution");
        Conic::equations().solve(&problem, &mut theirs).expect("a solution");
        assert!((problem.change(&ours) - problem.change(&theirs)).abs() < 1e-6);
    }
}

#[test]
fn non_finite_numbers_are_an_error() {
    let kind = Kind {
        stages: 5,
        growth: 1.0,
        error: 1.0,
        knee: 0.05,
        trust: 0.3,
        rows: 1,
        curvature: 0.01,
    };
    for stage in [1, 4] {
        let damages: [fn(&mut Stage<4>); 4] = [
            |stage| stage.step.state[3][4] = f64::NAN,
            |stage| stage.step.next[0] = f64::INFINITY,
            |stage| stage.error[2] = f64::NAN,
            |stage| stage.step.input[5][1] = f64::NAN,
        ];
        for damage in damages {
            let mut problem = subproblem::<4>(kind, 1);
            damage(&mut problem.stages[stage]);
            let mut solution = Solution::default();
            assert!(InteriorPoint::default().solve(&problem, &mut solution).is_err());
            assert!(Conic::equations().solve(&problem, &mut solution).is_err());
        }
    }
}

#[test]
fn long_unstable_horizon_satisfies_its_dynamics() {
    let kind = Kind {
        stages: 1000,
        growth: 1.02,
        error: 1.0,
        knee: 0.0,
        trust: 0.5,
        rows: 0,
        curvature: 1e-3,
    };
    let problem = subproblem::<4>(kind, 3);
    let solution = solved(&problem);
    let size = solution.states.iter().flatten().fold(1.0, |most: f64, d| most.max(d.abs()));
    assert!(problem.defect(&solution) < 1e-9 * size * 1000.0, "{:e}", problem.defect(&solution));
}
