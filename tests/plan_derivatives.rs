//! The derivatives of the steps against finite differences.

use crate::planning;
use downwash::model::Model;
use downwash::model::features::Features;
use downwash::plan::discretisation::{CommandedDynamics, Dynamics, WrenchDynamics};
use downwash::plan::problem::STATES;
use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

const PERIOD: f64 = 0.01;
/// Steps of the finite differences, scaled to the variables.
const STEP: f64 = 1e-6;
/// How far from zero positions, velocities, angles and rates are drawn.
const STATE_SIZE: [f64; STATES] = [3.0, 3.0, 3.0, 2.0, 2.0, 2.0, 0.6, 0.6, 3.0, 4.0, 4.0, 4.0];

fn state() -> impl Strategy<Value = [f64; STATES]> {
    prop::array::uniform12(-1.0_f64..1.0)
        .prop_map(|share| std::array::from_fn(|i| share[i] * STATE_SIZE[i]))
}

/// Compares columns of A and B, one step of each input in `size`, with differences of the step.
/// Skips points with a kink between the differences.
fn check<const INPUTS: usize>(
    dynamics: &impl Dynamics<INPUTS>,
    state: [f64; STATES],
    input: [f64; INPUTS],
    size: [f64; INPUTS],
) -> Result<(), TestCaseError> {
    let linear = dynamics.linearize(&state, &input);
    let here = dynamics.step(&state, &input);
    for (linear, direct) in linear.next.iter().zip(here) {
        prop_assert!((linear - direct).abs() < 1e-12);
    }
    let column =
        |derivative: &dyn Fn(usize) -> f64, step: f64, moved: &dyn Fn(f64) -> [f64; STATES]| {
            let (above, below) = (moved(step), moved(-step));
            for row in 0..STATES {
                let (ahead, behind) =
                    ((above[row] - here[row]) / step, (here[row] - below[row]) / step);
                let scale = 1.0 + ahead.abs();
                // A kink puts the mean of the two off by half of their difference.
                prop_assume!((ahead - behind).abs() < 1e-5 * scale);
                let slope = 0.5 * (ahead + behind);
                prop_assert!(
                    (slope - derivative(row)).abs() < 1e-5 * scale,
                    "row {row}: {slope} by differences, {}",
                    derivative(row)
                );
            }
            Ok(())
        };
    for i in 0..STATES {
        let moved = |step: f64| {
            let mut state = state;
            state[i] += step;
            dynamics.step(&state, &input)
        };
        column(&|row| linear.state[row][i], STEP * STATE_SIZE[i], &moved)?;
    }
    for i in 0..INPUTS {
        let moved = |step: f64| {
            let mut input = input;
            input[i] += step;
            dynamics.step(&state, &input)
        };
        column(&|row| linear.input[row][i], STEP * size[i], &moved)?;
    }
    Ok(())
}

fn models(seed: u64) -> [Box<dyn Model>; 3] {
    [
        Box::new(planning::physics()),
        Box::new(planning::hybrid(Features::World, seed)),
        Box::new(planning::hybrid(Features::Heading, seed)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { max_global_rejects: 10_000, ..ProptestConfig::with_cases(64) })]

    #[test]
    fn wrench_step_derivatives_match_finite_differences(
        state in state(),
        thrust in 0.0_f64..0.5,
        moments in prop::array::uniform3(-2e-4_f64..2e-4),
        seed in 0_u64..100,
    ) {
        let [mx, my, mz] = moments;
        for model in models(seed) {
            let dynamics = WrenchDynamics::new(model.as_ref(), PERIOD);
            check(&dynamics, state, [thrust, mx, my, mz], [0.3, 2e-4, 2e-4, 2e-4])?;
        }
    }

    #[test]
    fn commanded_step_derivatives_match_finite_differences(
        state in state(),
        thrust in 0.0_f64..0.5,
        command in prop::array::uniform6(-1.0_f64..1.0),
        seed in 0_u64..100,
    ) {
        let [roll, pitch, yaw, p, q, r] = command;
        let input = [thrust, 0.6 * roll, 0.6 * pitch, 3.0 * yaw, 4.0 * p, 4.0 * q, 4.0 * r];
        for model in models(seed) {
            let dynamics =
                CommandedDynamics::new(model.as_ref(), planning::attitude_pd(), PERIOD);
            check(&dynamics, state, input, [0.3, 0.3, 0.3, 0.3, 3.0, 3.0, 3.0])?;
        }
    }
}
