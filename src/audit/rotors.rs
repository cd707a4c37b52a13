//! Finds which output drives which rotor, from its effect: an output that rolls the vehicle to the
//! left is on the right, one that pitches it up is in front, and one that yaws it right drives a
//! rotor whose drag turns the body right.

use nalgebra::{SMatrix, SVector, Vector3};
use schemars::JsonSchema;
use serde::Serialize;

use super::agreement::Estimate;
use super::rates::Rates;
use super::tier::FAST_HZ;
use super::weak::{Bump, Row, bumps, fit, integrate};
use super::{Finding, Severity};
use crate::log::import::{Flight, RotorFact};

/// Name of the check of the outputs' order.
pub(super) const MOTOR_ORDER: &str = "motor_order";

/// Half width of a bump: at least this time, s, and this many periods of the slower stream.
const HALF: f64 = 0.1;
const HALF_PERIODS: f64 = 5.0;
/// Number and step of the delays from an output to the rotor's response that are tried, s.
const DELAYS: usize = 9;
const DELAY_STEP: f64 = 0.015;
/// Distance within which a mean is subtracted, s. A payload that shifts or a rotor that weakens moves
/// the outputs for the rest of the flight without turning the vehicle.
const LOCAL_S: f64 = 1.5;
/// Least share of the angular acceleration that the outputs must explain.
const EXPLAINED_MIN: f64 = 0.4;
/// Intervals by which an effect must differ from zero to have a sign.
const CERTAIN_INTERVALS: f64 = 2.0;
/// Distance from an axis, as a share of the arm, below which a rotor has no side.
const ON_AXIS: f64 = 0.2;
/// Fewest contradictions that are not due to chance.
const CONTRADICTIONS: usize = 2;

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

/// An output whose effect contradicts a rotor at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Contradiction {
    /// Index of the output.
    pub output: usize,
    /// `roll`, `pitch` or `yaw`.
    pub axis: &'static str,
}

impl RotorEffects {
    /// Measures the outputs' effects in a flight, if its motion shows them.
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
        let bumps = bumps(flight.body_rate.times(), &[half]);
        let all = (0..DELAYS).filter_map(|step| Self::at(flight, &bumps, DELAY_STEP * step as f64));
        let best = all.max_by(|a, b| a.explained.total_cmp(&b.explained))?;
        (best.explained > EXPLAINED_MIN).then_some(best)
    }

    /// The effects for outputs that act `delay_s` later.
    fn at(flight: &Flight, bumps: &[Bump], delay_s: f64) -> Option<Self> {
        let mut pairs: Vec<(Vector3<f64>, SVector<f64, 4>)> = Vec::new();
        let mut times = Vec::new();
        for bump in bumps {
            let turning =
                integrate(&flight.body_rate, *bump, |_, w| Some(Vector3::from(w.to_array())));
            let outputs =
                integrate(&flight.outputs, bump.shifted(-delay_s), |_, u| Some(SVector::from(*u)));
            if let (Some(turning), Some(outputs)) = (turning, outputs) {
                pairs.push((-turning.slope, outputs.value));
                times.push(bump.centre);
            }
        }
        let pairs = without_local_means(&times, &pairs);
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
            times.iter().zip(&pairs).map(row).collect()
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
        Some(Self { turning, delay_s, explained: fit.explained })
    }

    /// Certain contradictions between these effects and rotors at the places `rotors`.
    pub fn contradictions(&self, rotors: &[RotorFact; 4]) -> Vec<Contradiction> {
        let arm = rotors.iter().map(|r| r.front.hypot(r.right)).fold(0.0, f64::max);
        let mut found = Vec::new();
        for (output, (turning, rotor)) in self.turning.iter().zip(rotors).enumerate() {
            let side = |place: f64| if place.abs() < ON_AXIS * arm { 0.0 } else { place };
            let expected = [-side(rotor.right), side(rotor.front), f64::from(rotor.spin)];
            for ((axis, effect), expected) in
                ["roll", "pitch", "yaw"].into_iter().zip(turning).zip(expected)
            {
                if effect.differs_from_zero(CERTAIN_INTERVALS) && effect.value * expected < 0.0 {
                    found.push(Contradiction { output, axis });
                }
            }
        }
        found
    }

    /// The fault of outputs that do not turn the vehicle as `rotors` would; `whose` says where
    /// those places come from.
    pub fn order_fault(&self, rotors: &[RotorFact; 4], whose: &str) -> Option<Finding> {
        let wrong = self.contradictions(rotors);
        let named = wrong.iter().map(|wrong| format!("{} in {}", wrong.output + 1, wrong.axis));
        let named = named.collect::<Vec<_>>().join(", ");
        (wrong.len() >= CONTRADICTIONS).then(|| Finding {
            severity: Severity::Fault,
            check: MOTOR_ORDER,
            stream: Some("outputs"),
            found: wrong.len() as f64,
            expected: 0.0,
            unit: "",
            what: format!("do not turn the vehicle as {whose} would: {named}"),
            advice: "check the order of the outputs and the direction of rotation",
        })
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
