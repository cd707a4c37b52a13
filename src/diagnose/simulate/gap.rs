//! The gap between a simulator and flights: errors of its open-loop predictions.
//!
//! From many instants a simulator predicts the reports 0.1, 0.5 and 1 s later.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::Frd;
use vehicle::rigid_body::State;

use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::simulate::metric::{Metric, PARTS_MAX};
use crate::diagnose::simulate::open_loop::{HORIZONS_S, LoopNoise, MARGIN_S, NoiseDraw, Simulator};

/// Predicted quantities with the units of their errors, which are norms.
pub const QUANTITIES: [(&str, &str); 4] =
    [("position", "m"), ("velocity", "m/s"), ("attitude", "rad"), ("body rate", "rad/s")];
/// Time between the starts of prediction windows, s.
const SPACING_S: f64 = 0.25;
/// Most prediction windows, about 100 s of flight. Windows overlap: more of them cost time and say
/// little more.
const WINDOWS_MAX: usize = 400;
/// Most of them for the gap of a single flight among others.
const FLIGHT_WINDOWS_MAX: usize = 100;

/// Errors of one window, by [`HORIZONS_S`] and [`QUANTITIES`].
pub type Window = [[f64; 4]; 3];

/// Root mean square errors over windows, by horizon and quantity, in m, m/s, rad, rad/s.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Errors(pub Window);

impl Errors {
    /// The gap: the mean over the parts of `metric` of each error divided by its noise.
    pub fn over(&self, noise: &Errors, metric: Metric) -> f64 {
        let parts = metric.parts().len();
        self.parts_over(noise, metric)[..parts].iter().sum::<f64>() / parts as f64
    }

    /// Each part of `metric` divided by its noise; 0 beyond its parts.
    pub fn parts_over(&self, noise: &Errors, metric: Metric) -> [f64; PARTS_MAX] {
        let mut over = [0.0; PARTS_MAX];
        for (over, (h, q)) in over.iter_mut().zip(metric.parts()) {
            *over = self.0[*h][*q] / noise.0[*h][*q].max(1e-12);
        }
        over
    }

    /// The gap by the metric `mean`.
    pub fn mean_over(&self, noise: &Errors) -> f64 {
        self.over(noise, Metric::Mean)
    }
}

/// The floor: prediction errors from noise alone.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    /// Root mean square errors over windows and draws of the noise.
    pub errors: Errors,
    /// Scatter about 1 of the metric `mean` over draws of the noise. Where the body turns fast, a
    /// few windows dominate it.
    pub scatter: f64,
}

/// Draws of the noise for each flight.
const FLOOR_DRAWS: u64 = 4;
/// Usual scatter, which counts as two more draws because so few estimate the scatter poorly. Half
/// of 300 nulls of an exam had more.
const USUAL_SCATTER: f64 = 0.024;
const USUAL_DRAWS: f64 = 2.0;

/// The metric `mean` in units of the floor.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
pub struct OverNoise {
    /// The gap, which is 1 for noise alone.
    pub gap: f64,
    /// Scatter of the gap from noise alone.
    pub scatter: f64,
}

impl Simulator {
    /// Root mean square errors over the windows of flights; `None` without a window.
    pub fn errors(&self, flights: &[PreparedFlight]) -> Option<Errors> {
        root_mean_square(&self.windows(flights))
    }

    /// The errors of each window of flights, in order; NaN for a window that cannot be predicted.
    pub fn windows(&self, flights: &[PreparedFlight]) -> Vec<Window> {
        self.at_most(WINDOWS_MAX, flights)
    }

    /// The errors of at most `most` windows of flights.
    fn at_most(&self, most: usize, flights: &[PreparedFlight]) -> Vec<Window> {
        windows(most, flights, |index, start| {
            let (flight, start) = (&flights[index], self.start_from(start));
            let from = reported(flight, start, self.latency());
            let predicted = self.predict(flight, start, &from, None)?;
            Some(std::array::from_fn(|h| {
                let there = reported(flight, start + HORIZONS_S[h], self.latency());
                self.distance(&there, &predicted[h])
            }))
        })
    }

    /// The floor. Predictions from noisy starts are compared with noisy reports of the same
    /// simulator from the true start, whose on-board loop flies with sensor noise, gyro bias and
    /// link jitter.
    pub fn floor(
        &self,
        flights: &[PreparedFlight],
        noise: &ReportNoise,
        seed: u64,
    ) -> Option<Floor> {
        self.floor_at_most(WINDOWS_MAX, flights, noise, seed)
    }

    fn floor_at_most(
        &self,
        most: usize,
        flights: &[PreparedFlight],
        noise: &ReportNoise,
        seed: u64,
    ) -> Option<Floor> {
        let draws: Vec<_> = (0..FLOOR_DRAWS)
            .map(|draw| {
                let seed = seed.wrapping_add(draw << 32);
                let draws: Vec<NoiseDraw<'_>> = (0_u64..)
                    .zip(flights)
                    .map(|(index, flight)| {
                        let seed = seed.wrapping_add(index << 40);
                        NoiseDraw::new(noise, flight, self.trim().inverse(), seed)
                    })
                    .collect();
                windows(most, flights, |index, start| {
                    self.noise_errors(&flights[index], start, &draws[index])
                })
            })
            .collect();
        let errors = root_mean_square(draws.iter().flatten())?;
        let of_one = draws.iter().filter_map(root_mean_square);
        let squares = of_one.map(|draw| (draw.over(&errors, self.metric()) - 1.0).powi(2));
        let sum = squares.sum::<f64>() + USUAL_DRAWS * USUAL_SCATTER.powi(2);
        let scatter = (sum / (USUAL_DRAWS + (FLOOR_DRAWS - 1) as f64)).sqrt();
        Some(Floor { errors, scatter })
    }

    /// The errors from noise alone in the window of `flight` from `start`.
    fn noise_errors(
        &self,
        flight: &PreparedFlight,
        start: f64,
        draw: &NoiseDraw<'_>,
    ) -> Option<Window> {
        let mut rng = Pcg64Mcg::seed_from_u64(draw.seed ^ start.to_bits());
        let start = self.start_from(start);
        let bias = draw.gyro_bias;
        let truth = with_added_rate(-bias, reported(flight, start, self.latency()));
        let sensed = LoopNoise::new(draw, rng.random());
        let ends = self.predict(flight, start, &truth, Some(sensed))?;
        let mut report = |time: f64, state: &State| {
            let noise = draw.noise.read_at(flight, time, self.latency());
            with_added_rate(bias, noise.applied(state, &mut rng))
        };
        let predicted = self.predict(flight, start, &report(start, &truth), None)?;
        Some(std::array::from_fn(|h| {
            self.distance(&report(start + HORIZONS_S[h], &ends[h]), &predicted[h])
        }))
    }

    /// The distance of two states by [`QUANTITIES`], with the rotation about the compared axes only.
    fn distance(&self, a: &State, b: &State) -> [f64; 4] {
        let axes = self.rotation_axes();
        let of_axes = |vector: [f64; 3]| -> f64 {
            let squares = vector.into_iter().zip(axes).filter(|(_, is_used)| *is_used);
            squares.map(|(along, _)| along * along).sum::<f64>().sqrt()
        };
        let angle = a.attitude.angle_to(b.attitude);
        let turn = a.attitude.inverse().compose(b.attitude);
        let axis = [turn.x, turn.y, turn.z];
        let norm = axis.iter().map(|along| along * along).sum::<f64>().sqrt();
        let share = if axes == [true; 3] { 1.0 } else { of_axes(axis) / norm.max(1e-300) };
        [
            (a.position - b.position).norm(),
            (a.velocity - b.velocity).norm(),
            share * angle,
            of_axes((a.body_rate - b.body_rate).to_array()),
        ]
    }

    /// The gap on one flight by the simulator's metric; `None` without a window.
    pub fn gap(
        &self,
        flight: &PreparedFlight,
        noise: &ReportNoise,
        seed: u64,
    ) -> Option<OverNoise> {
        let flight = std::slice::from_ref(flight);
        let Floor { errors: floor, scatter } =
            self.floor_at_most(FLIGHT_WINDOWS_MAX, flight, noise, seed)?;
        let errors = root_mean_square(&self.at_most(FLIGHT_WINDOWS_MAX, flight))?;
        Some(OverNoise { gap: errors.over(&floor, self.metric()), scatter })
    }
}

/// The reported state at `time`. `latency` delays all of it except the body rate.
fn reported(flight: &PreparedFlight, time: f64, latency: f64) -> State {
    State {
        position: flight.position.at(time).into(),
        velocity: flight.velocity.at(time).into(),
        attitude: flight.attitude.attitude_at(time),
        body_rate: flight.body_rate.at(time - latency).into(),
    }
}

/// `state` with `rate` added to its body rate.
fn with_added_rate(rate: Frd, state: State) -> State {
    State { body_rate: state.body_rate + rate, ..state }
}

/// Starts of the prediction windows of a flight.
fn starts(flight: &PreparedFlight) -> Vec<f64> {
    let channels = &flight.channels;
    if !(channels.velocity && channels.attitude && channels.body_rate) {
        return Vec::new();
    }
    let mut starts = Vec::new();
    for span in &flight.spans {
        let mut start = span.start + MARGIN_S;
        while start + HORIZONS_S[2] + 0.1 <= span.end {
            starts.push(start);
            start += SPACING_S;
        }
    }
    starts
}

/// Evaluates `window` for the index of each flight and each start in it, in parallel. Of more than
/// `most`, one in every few.
fn windows(
    most: usize,
    flights: &[PreparedFlight],
    window: impl Fn(usize, f64) -> Option<Window> + Sync,
) -> Vec<Window> {
    let windows: Vec<(usize, f64)> = flights
        .iter()
        .enumerate()
        .flat_map(|(index, flight)| starts(flight).into_iter().map(move |start| (index, start)))
        .collect();
    let every = windows.len().div_ceil(most).max(1);
    let windows: Vec<&(usize, f64)> = windows.iter().step_by(every).collect();
    windows
        .par_iter()
        .map(|(index, start)| window(*index, *start).unwrap_or([[f64::NAN; 4]; 3]))
        .collect()
}

/// Root mean square errors over windows with `weights`; `None` without a finite window.
pub fn weighted_errors<'a>(
    windows: impl IntoIterator<Item = &'a Window>,
    weights: impl IntoIterator<Item = f64>,
) -> Option<Errors> {
    let finite = |(e, _): &(&Window, f64)| e.iter().flatten().all(|x| x.is_finite());
    let mut sums = [[0.0; 4]; 3];
    let mut total = 0.0;
    for (window, weight) in windows.into_iter().zip(weights).filter(finite) {
        total += weight;
        for (sum, error) in sums.iter_mut().flatten().zip(window.iter().flatten()) {
            *sum += weight * error * error;
        }
    }
    (total > 0.0).then(|| Errors(sums.map(|row| row.map(|sum: f64| (sum / total).sqrt()))))
}

/// Root mean square errors over windows; `None` without a finite one.
fn root_mean_square<'a>(windows: impl IntoIterator<Item = &'a Window>) -> Option<Errors> {
    weighted_errors(windows, std::iter::repeat(1.0))
}
