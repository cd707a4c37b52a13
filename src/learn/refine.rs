//! Refinement of actuation, physics and net on open-loop predictions of half a second.
//!
//! Fast noise dominates one-step errors, and feedback correlates input and noise; on real flights,
//! a model that is best over 10 ms may diverge over 500. The refinement minimises the errors of
//! whole predictions (simulation-error identification; Ljung, System Identification, 1999, section
//! 7.2, with the output-error predictor).

use std::ops::Range;

use nalgebra::DVector;
use rayon::prelude::*;
use vehicle::VehicleParams;
use vehicle::rigid_body::State;

use super::commands::Onboard;
use super::dataset::ObservedFlight;
use super::evaluation::window_starts;
use super::least_squares::{huber, least_squares};
use super::physics_fit::{PARAMETERS, Parameters, WIND};
use super::prediction::{Baseline, RecordedInputs};
use crate::model::Model;
use crate::model::actuation::Actuation;
use crate::model::learned::{LinearTerm, Network, NetworkModel};
use crate::model::physics::{PhysicsModel, PhysicsParameters};

/// Horizons whose errors count, s.
const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.25, 0.5];
/// Most flights and windows: more cost time and change little.
const FLIGHTS_MAX: usize = 8;
const WINDOWS_MAX: usize = 200;
/// The physics' parameters, then delay, lag and rate of balance.
const NUMBERS: usize = PARAMETERS + 3;
/// Errors of position, velocity, attitude and rate, three each.
const ERRORS: usize = 12;
/// Slowest rate of balance that differs from no balance, 1/s.
const BALANCE_RATE_MIN: f64 = 0.05;

/// Longest delay and lag, s.
const DELAY_MAX_S: f64 = 0.1;
const LAG_MAX_S: f64 = 0.2;

/// The usable spans of a flight.
pub struct FlightSpans<'a> {
    /// The flight.
    pub flight: &'a ObservedFlight,
    /// Usable times, s.
    pub spans: Vec<Range<f64>>,
}

/// The start of a prediction, and the reported states.
struct Window {
    flight: usize,
    start: f64,
    state: State,
    reported: Vec<State>,
}

/// Predictions from a selection of windows, and the scales of their errors.
struct OpenLoops<'a> {
    flights: Vec<&'a ObservedFlight>,
    onboard: &'a Onboard,
    windows: Vec<Window>,
    /// Errors of holding the state.
    scales: [[f64; ERRORS]; HORIZONS_S.len()],
}

impl<'a> OpenLoops<'a> {
    /// `None` if there are no windows.
    fn of(
        flights: &[FlightSpans<'a>],
        onboard: &'a Onboard,
        actuation: &Actuation,
    ) -> Option<Self> {
        let stride = flights.len().div_ceil(FLIGHTS_MAX).max(1);
        let flights: Vec<_> = flights.iter().step_by(stride).collect();
        let windows = windows(&flights, onboard, actuation);
        let scales = scales(&windows);
        let flights = flights.into_iter().map(|spans| spans.flight).collect();
        (!windows.is_empty()).then_some(Self { flights, onboard, windows, scales })
    }

    fn inputs<'b>(&'b self, actuation: &'b Actuation) -> Vec<RecordedInputs<'b>> {
        let inputs = |flight: &&'a ObservedFlight| -> RecordedInputs<'b> {
            RecordedInputs::new(flight, self.onboard, actuation)
        };
        self.flights.par_iter().map(inputs).collect()
    }

    /// Prediction errors of a model, relative to those of holding the state.
    fn errors(&self, model: &dyn Model, inputs: &[RecordedInputs<'_>]) -> Vec<f64> {
        self.windows
            .par_iter()
            .flat_map_iter(|window| {
                let inputs = &inputs[window.flight];
                let predicted = inputs.predict(model, window.start, window.state, &HORIZONS_S);
                let mut errors = vec![0.0; HORIZONS_S.len() * ERRORS];
                if let Some(predicted) = predicted {
                    for (h, (a, b)) in window.reported.iter().zip(&predicted).enumerate() {
                        for (i, error) in difference(a, b).into_iter().enumerate() {
                            errors[h * ERRORS + i] = huber(error / self.scales[h][i]);
                        }
                    }
                }
                errors
            })
            .collect()
    }

    /// Weight of one prior: small enough to yield to informative errors.
    fn trust(&self) -> f64 {
        (self.windows.len() * HORIZONS_S.len() * ERRORS) as f64 * 1e-5
    }
}

/// The actuation and physics with the best open-loop predictions over the given spans, starting
/// from the one-step fit. `None` if there are no windows.
pub fn open_loop(
    flights: &[FlightSpans<'_>],
    onboard: &Onboard,
    vehicle: &VehicleParams,
    actuation: &Actuation,
    physics: &PhysicsParameters,
) -> Option<(Actuation, PhysicsParameters)> {
    let loops = OpenLoops::of(flights, onboard, actuation)?;
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

    let trust = loops.trust().sqrt();
    // The few windows do not tell a wind from a trim: the wind stays as it was fitted to all rows.
    let unpacked = |numbers: &[f64; NUMBERS]| {
        let mut numbers = *numbers;
        numbers[WIND].copy_from_slice(&start.0[WIND]);
        unpack(&numbers, actuation, vehicle)
    };
    let residuals = |numbers: &[f64; NUMBERS]| {
        let (bounded, actuation, parameters) = unpacked(numbers);
        let physics = parameters.physics(vehicle);
        let Ok(model) = PhysicsModel::new(vehicle, &physics) else { return (bounded, None) };
        let mut out = loops.errors(&model, &loops.inputs(&actuation));
        out.extend((0..PARAMETERS).map(|i| (bounded[i] - start.0[i]) / prior[i] * trust));
        (bounded, Some(DVector::from_vec(out)))
    };
    let best = least_squares(numbers, &scale, residuals);
    let (_, actuation, parameters) = unpacked(&best);
    Some((actuation, parameters.physics(vehicle)))
}

/// A linear correction of a network's accelerations in its own normalised features: for both heads
/// a constant and the slope along the corresponding velocity or body rate; for the angular head
/// also a gain and the slope along the corresponding moment; for the linear head the slope of
/// thrust along z.
#[derive(Clone, Copy)]
struct Correction([f64; CORRECTIONS]);

/// Constants, slopes along the motion, gains, slopes along the moments, and the slope along thrust.
const CORRECTIONS: usize = 6 + 6 + 3 + 3 + 1;
/// Typical size of a correction, in units of the labels' spread.
const CORRECTION: f64 = 0.2;

impl Correction {
    fn of(self, net: &NetworkModel) -> NetworkModel {
        let Self(numbers) = self;
        let (constants, rest) = numbers.split_at(6);
        let (motions, rest) = rest.split_at(6);
        let (gains, rest) = rest.split_at(3);
        let (moments, thrust) = rest.split_at(3);
        let first_input = |network: &Network, count| network.mlp.inputs - count;
        let motion = |i: usize| LinearTerm { feature: i, output: i % 3, slope: motions[i] };
        let mut linear: Vec<_> = (0..3).map(motion).collect();
        let feature = first_input(&net.linear, 1);
        linear.push(LinearTerm { feature, output: 2, slope: thrust[0] });
        let mut angular: Vec<_> = (3..6).map(motion).collect();
        let first = first_input(&net.angular, 3);
        let moment = |i: usize| LinearTerm { feature: first + i, output: i, slope: moments[i] };
        angular.extend((0..3).map(moment));
        let turned = [1.0 + gains[0], 1.0 + gains[1], 1.0 + gains[2]];
        let constant = |first: usize| std::array::from_fn(|i| constants[first + i]);
        NetworkModel {
            features: net.features,
            linear: net.linear.corrected([1.0; 3], constant(0), &linear),
            angular: net.angular.corrected(turned, constant(3), &angular),
        }
    }
}

/// The net with the linear correction that gives the best open-loop predictions over the given
/// spans: one-step errors hardly reveal a small error of a gain, a damping or a moment's mean, half
/// a second does. `None` if there are no windows.
pub fn network_open_loop(
    flights: &[FlightSpans<'_>],
    onboard: &Onboard,
    actuation: &Actuation,
    net: &NetworkModel,
) -> Option<NetworkModel> {
    let loops = OpenLoops::of(flights, onboard, actuation)?;
    let inputs = loops.inputs(actuation);
    let weight = loops.trust().sqrt() / CORRECTION;
    let best = least_squares([0.0; CORRECTIONS], &[CORRECTION; CORRECTIONS], |numbers| {
        let mut out = loops.errors(&Correction(*numbers).of(net), &inputs);
        out.extend(numbers.map(|number| number * weight));
        (*numbers, Some(DVector::from_vec(out)))
    });
    Some(Correction(best).of(net))
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

fn windows(flights: &[&FlightSpans<'_>], onboard: &Onboard, actuation: &Actuation) -> Vec<Window> {
    let mut all = Vec::new();
    for (index, FlightSpans { flight, spans }) in flights.iter().enumerate() {
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

/// The scales of the errors at each horizon: those of holding the state.
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
