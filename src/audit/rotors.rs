//! Measures the effect of each motor output on the body's rotation.

use nalgebra::{SMatrix, SVector, Vector3};
use schemars::JsonSchema;
use serde::Serialize;

use super::agreement::Estimate;
use super::rates::Rates;
use super::tier::FAST_HZ;
use super::weak::{Row, bumps, fit, integrate};
use crate::log::import::Flight;

/// Half width of a bump: at least this time, s, and this many periods of the slower stream.
const HALF: f64 = 0.1;
const HALF_PERIODS: f64 = 5.0;
/// Step of the delays from an output to the rotor's response that are tried, s, and their number on
/// either side of none.
const DELAY_STEP: f64 = 0.015;
const DELAYS: i32 = 8;
/// Distance within which a mean is subtracted, s. A payload that shifts or a rotor that weakens moves
/// the outputs for the rest of the flight without turning the vehicle.
const LOCAL_S: f64 = 1.5;
/// Least share of the angular acceleration that the outputs must explain.
const EXPLAINED_MIN: f64 = 0.4;
/// Effect of each output on the body, rad/s^2 per unit of the output.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct RotorEffects {
    /// Angular acceleration about front, right and down, for each output.
    pub turning: [[Estimate; 3]; 4],
    /// Approximate delay from an output to its effect, s.
    pub delay_s: f64,
    /// Share of the angular acceleration that the outputs explain.
    pub explained: f64,
}

/// Rotation and outputs under the same bumps, without their means within [`LOCAL_S`].
pub(super) struct Responses {
    /// Times of the bumps' middles, s.
    pub times: Vec<f64>,
    /// For each delay, ascending.
    pub delayed: Vec<DelayedResponse>,
}

/// Rotation, and the outputs that acted a fixed time before it.
pub(super) struct DelayedResponse {
    /// Time from an output to its effect, s; negative if the effect comes first.
    pub delay_s: f64,
    /// Angular acceleration about front, right and down, and the outputs, as integrals.
    pub pairs: Vec<(Vector3<f64>, SVector<f64, 4>)>,
}

impl Responses {
    /// The responses in a flight; `None` if outputs or body rates are too slow to show any.
    pub fn of(flight: &Flight) -> Option<Self> {
        let Rates { outputs_hz, body_rate_hz, .. } = Rates::of(flight);
        if outputs_hz.is_none_or(|rate| rate < FAST_HZ)
            || body_rate_hz.is_none_or(|rate| rate < FAST_HZ)
        {
            return None;
        }
        let periods = [flight.outputs.period(), flight.body_rate.period()];
        let half =
            periods.into_iter().flatten().fold(HALF, |h, period| h.max(HALF_PERIODS * period));
        let delays: Vec<f64> =
            (-DELAYS..=DELAYS).map(|step| DELAY_STEP * f64::from(step)).collect();
        let mut times = Vec::new();
        let mut delayed = vec![Vec::new(); delays.len()];
        for bump in bumps(flight.body_rate.times(), &[half]) {
            let outputs = |delay: &f64| {
                let all = integrate(&flight.outputs, bump.shifted(-delay), |_, u| {
                    Some(SVector::from(*u))
                });
                Some(all?.value)
            };
            let turning =
                integrate(&flight.body_rate, bump, |_, w| Some(Vector3::from(w.to_array())));
            let outputs: Option<Vec<SVector<f64, 4>>> = delays.iter().map(outputs).collect();
            if let Some((turning, outputs)) = turning.zip(outputs) {
                times.push(bump.centre);
                for (pairs, outputs) in delayed.iter_mut().zip(outputs) {
                    pairs.push((-turning.slope, outputs));
                }
            }
        }
        let delayed = delays.into_iter().zip(delayed).map(|(delay_s, pairs)| DelayedResponse {
            delay_s,
            pairs: without_local_means(&times, &pairs),
        });
        Some(Self { delayed: delayed.collect(), times })
    }
}

impl RotorEffects {
    /// Measures the outputs' effects, if the motion shows them.
    pub(super) fn of(responses: &Responses) -> Option<Self> {
        let all = responses.delayed.iter().filter(|response| response.delay_s >= 0.0);
        let all = all.filter_map(|response| Self::at(&responses.times, response));
        let best = all.max_by(|a, b| a.explained.total_cmp(&b.explained))?;
        (best.explained > EXPLAINED_MIN).then_some(best)
    }

    /// The effects at one delay.
    fn at(times: &[f64], DelayedResponse { delay_s, pairs }: &DelayedResponse) -> Option<Self> {
        let rows = |effects: &[f64; 12]| {
            let effects = SMatrix::<f64, 3, 4>::from_column_slice(effects);
            let row = |(time, (measured, output)): (&f64, &(Vector3<f64>, SVector<f64, 4>))| {
                let measured = *measured;
                let mut slopes = SMatrix::<f64, 3, 12>::zeros();
                for i in 0..4 {
                    for axis in 0..3 {
                        slopes[(axis, 3 * i + axis)] = output[i];
                    }
                }
                Row { time: *time, group: 0, measured, misfit: measured - effects * output, slopes }
            };
            times.iter().zip(pairs).map(row).collect()
        };
        // An effect matters if the output's changes cause rotation as large as the body's.
        let turns: f64 = pairs.iter().map(|(measured, _)| measured.norm_squared()).sum();
        let size = |output: usize| {
            let moves: f64 = pairs.iter().map(|(_, outputs)| outputs[output].powi(2)).sum();
            if moves > 0.0 { (turns / moves).sqrt() } else { 0.0 }
        };
        let fit = fit([0.0; 12], std::array::from_fn(|at| size(at / 3)), rows)?;
        let mut turning = [[Estimate { value: 0.0, half_width: 0.0 }; 3]; 4];
        for (at, estimate) in turning.as_flattened_mut().iter_mut().enumerate() {
            *estimate = Estimate::new(fit.value[at], fit.half_width(at)?);
        }
        Some(Self { turning, delay_s: *delay_s, explained: fit.explained })
    }
}

/// Angular accelerations and outputs without their means within [`LOCAL_S`].
fn without_local_means(
    times: &[f64],
    pairs: &[(Vector3<f64>, SVector<f64, 4>)],
) -> Vec<(Vector3<f64>, SVector<f64, 4>)> {
    let centred = |(time, (turning, outputs)): (&f64, &(Vector3<f64>, SVector<f64, 4>))| {
        let from = times.partition_point(|other| *other < time - LOCAL_S);
        let to = times.partition_point(|other| *other <= time + LOCAL_S);
        let near = &pairs[from..to];
        let count = near.len() as f64;
        let turning_mean = near.iter().map(|(turning, _)| turning).sum::<Vector3<f64>>() / count;
        let outputs_mean = near.iter().map(|(_, of)| of).sum::<SVector<f64, 4>>() / count;
        (turning - turning_mean, outputs - outputs_mean)
    };
    times.iter().zip(pairs).map(centred).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shift_of_the_outputs_is_local() {
        // The outputs alternate, and shift by a hundred times as much after 10 s.
        let times: Vec<f64> = (0..400).map(|k| 0.05 * f64::from(k)).collect();
        let pair = |(k, time): (usize, &f64)| {
            let swing = if k % 2 == 0 { 0.01 } else { -0.01 };
            let shift = if *time < 10.0 { 0.0 } else { 1.0 };
            (Vector3::new(swing, 0.0, 0.0), SVector::from([swing + shift, 0.0, 0.0, 0.0]))
        };
        let pairs: Vec<_> = times.iter().enumerate().map(pair).collect();
        let centred = without_local_means(&times, &pairs);
        for (time, (turning, outputs)) in times.iter().zip(&centred) {
            if (time - 10.0).abs() > 2.0 * LOCAL_S {
                assert!((outputs[0] - turning[0]).abs() < 1e-12, "{time}: {outputs}");
                assert!((outputs[0].abs() - 0.01).abs() < 1e-3, "{time}: {outputs}");
            }
        }
    }
}
