//! Actuation and physics by their open loop: what leads to the right state after half a second.
//!
//! One-step errors are dominated by fast noise, and feedback correlates input and noise; on real
//! flights a model that is best over 10 ms may tumble over 500. Here the errors of whole
//! predictions are made small (simulation-error identification; Ljung, System Identification,
//! 1999, section 7.2, with the output-error predictor).

use nalgebra::DVector;
use rayon::prelude::*;
use sitl::rigid_body::State;
use sitl::vehicle::VehicleParams;

use super::commands::Onboard;
use super::dataset::ObservedFlight;
use super::evaluation::window_starts;
use super::least_squares::{huber, least_squares};
use super::physics_fit::{PARAMETERS, Parameters};
use super::prediction::{Baseline, RecordedInputs};
use crate::model::actuation::Actuation;
use crate::model::physics::{PhysicsModel, PhysicsParameters};

/// Horizons whose errors count, s.
const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.25, 0.5];
/// Flights and windows that are used at most: more cost time and move little.
const FLIGHTS_MAX: usize = 8;
const WINDOWS_MAX: usize = 200;
/// Physics, then delay, lag and rate of balance.
const NUMBERS: usize = PARAMETERS + 3;
/// Errors of position, velocity, attitude and rate, three each.
const ERRORS: usize = 12;
/// Slowest balance that differs from none, 1/s.
const BALANCE_RATE_MIN: f64 = 0.05;

/// Longest delay and lag, s.
const DELAY_MAX_S: f64 = 0.1;
const LAG_MAX_S: f64 = 0.2;

/// Where predictions start, and what was reported.
struct Window {
    flight: usize,
    start: f64,
    state: State,
    reported: Vec<State>,
}

/// Actuation and physics whose open loop over the given spans is best, from those of one step.
/// `None` where there are no windows.
pub fn open_loop(
    flights: &[(&ObservedFlight, Vec<std::ops::Range<f64>>)],
    onboard: &Onboard,
    vehicle: &VehicleParams,
    actuation: &Actuation,
    physics: &PhysicsParameters,
) -> Option<(Actuation, PhysicsParameters)> {
    let stride = flights.len().div_ceil(FLIGHTS_MAX).max(1);
    let flights: Vec<_> = flights.iter().step_by(stride).collect();
    let windows = windows(&flights, onboard, actuation);
    if windows.is_empty() {
        return None;
    }
    let scales = scales(&windows);

    let start = Parameters::fitted(physics, vehicle);
    let prior = Parameters::prior(vehicle);
    let mut numbers = [0.0; NUMBERS];
    numbers[..PARAMETERS].copy_from_slice(&start.0);
    numbers[PARAMETERS..].copy_from_slice(&[
        actuation.delay_s,
        actuation.lag_s,
        actuation.balance_s.map_or(0.0, f64::recip),
    ]);
    let mut scale = [0.0; NUMBERS];
    scale[..PARAMETERS].copy_from_slice(&prior);
    // Delays act in steps of the grid: their derivative is taken over a few milliseconds.
    scale[PARAMETERS..].copy_from_slice(&[40.0, 20.0, 20.0]);

    let trust = (windows.len() * HORIZONS_S.len() * ERRORS) as f64 * 1e-5;
    let residuals = |numbers: &[f64; NUMBERS]| {
        let (bounded, actuation, parameters) = unpack(numbers, actuation, vehicle);
        let physics = parameters.physics(vehicle);
        let Ok(model) = PhysicsModel::new(vehicle, &physics) else { return (bounded, None) };
        let inputs: Vec<RecordedInputs<'_>> = flights
            .par_iter()
            .map(|(flight, _)| RecordedInputs::new(flight, onboard, &actuation))
            .collect();
        let mut out: Vec<f64> = windows
            .par_iter()
            .flat_map_iter(|window| {
                let inputs = &inputs[window.flight];
                let predicted = inputs.predict(&model, window.start, window.state, &HORIZONS_S);
                let mut errors = vec![0.0; HORIZONS_S.len() * ERRORS];
                if let Some(predicted) = predicted {
                    for (h, (a, b)) in window.reported.iter().zip(&predicted).enumerate() {
                        for (i, error) in difference(a, b).into_iter().enumerate() {
                            errors[h * ERRORS + i] = huber(error / scales[h][i]);
                        }
                    }
                }
                errors
            })
            .collect();
        out.extend((0..PARAMETERS).map(|i| (bounded[i] - start.0[i]) / prior[i] * trust.sqrt()));
        (bounded, Some(DVector::from_vec(out)))
    };
    let best = least_squares(numbers, &scale, residuals);
    let (_, actuation, parameters) = unpack(&best, actuation, vehicle);
    Some((actuation, parameters.physics(vehicle)))
}

fn unpack(
    numbers: &[f64; NUMBERS],
    actuation: &Actuation,
    vehicle: &VehicleParams,
) -> ([f64; NUMBERS], Actuation, Parameters) {
    let mut bounded = *numbers;
    let mut parameters = Parameters(std::array::from_fn(|i| numbers[i]));
    parameters.bound(vehicle);
    bounded[..PARAMETERS].copy_from_slice(&parameters.0);
    for number in &mut bounded[PARAMETERS..] {
        *number = number.max(0.0);
    }
    let [.., delay_s, lag_s, balance] = bounded;
    let (delay_s, lag_s) = (delay_s.min(DELAY_MAX_S), lag_s.min(LAG_MAX_S));
    let balance_s = (balance > BALANCE_RATE_MIN).then(|| balance.min(20.0).recip());
    (bounded, Actuation { delay_s, lag_s, balance_s, ..*actuation }, parameters)
}

fn windows(
    flights: &[&(&ObservedFlight, Vec<std::ops::Range<f64>>)],
    onboard: &Onboard,
    actuation: &Actuation,
) -> Vec<Window> {
    let mut all = Vec::new();
    for (index, (flight, spans)) in flights.iter().enumerate() {
        let inputs = RecordedInputs::new(flight, onboard, actuation);
        for start in window_starts(spans) {
            let reported: Option<Vec<State>> =
                HORIZONS_S.iter().map(|h| inputs.reported(start + h)).collect();
            if let (Some(state), Some(reported)) = (inputs.reported(start), reported) {
                all.push(Window { flight: index, start, state, reported });
            }
        }
    }
    let stride = all.len().div_ceil(WINDOWS_MAX).max(1);
    all.into_iter().step_by(stride).collect()
}

/// What the errors are measured in, at each horizon: those of holding the state.
fn scales(windows: &[Window]) -> [[f64; ERRORS]; HORIZONS_S.len()] {
    std::array::from_fn(|h| {
        let mut sums = [0.0; 4];
        for window in windows {
            let held = Baseline::Hold.predict(&window.state, HORIZONS_S[h]);
            for (i, error) in difference(&window.reported[h], &held).into_iter().enumerate() {
                sums[i / 3] += error * error;
            }
        }
        let count = 3.0 * windows.len() as f64;
        std::array::from_fn(|i| (sums[i / 3] / count).sqrt().max(1e-6))
    })
}

/// Reported minus predicted: position, velocity, rotation vector, body rate.
fn difference(a: &State, b: &State) -> [f64; ERRORS] {
    let [x, y, z] = (a.position - b.position).to_array();
    let [vx, vy, vz] = (a.velocity - b.velocity).to_array();
    let turn = b.attitude.inverse().compose(a.attitude).canonical();
    let [p, q, r] = (a.body_rate - b.body_rate).to_array();
    [x, y, z, vx, vy, vz, 2.0 * turn.x, 2.0 * turn.y, 2.0 * turn.z, p, q, r]
}
