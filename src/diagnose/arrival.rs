//! When setpoints arrive on board: read off the outputs, each of which answers one of them.
//!
//! The mixer passes the setpoint's thrust on as the collective, so that a logged output tells which
//! setpoint was in force at its tick. How long each setpoint was under way at least, or at most, is
//! then known without a model of the vehicle. A delay keeps step with the loop and the stream: over
//! some milliseconds the same setpoints are in force, and a fit of the outputs finds any value
//! between. The few that come late tell the rest. An output that answers no setpoint of the log
//! answers one that the log lacks, where there is one: left out, the delays would be preferred that
//! let setpoints of the log rule whenever an output was logged.

use rayon::prelude::*;

use super::onboard::OnboardLaw;
use super::preparation::PreparedFlight;
use super::setpoints::send_spread;

/// A collective that agrees so well with a setpoint's thrust is of it: single precision, twice.
const AGREEMENT: f64 = 2e-6;
/// And all others must be off by so much more.
const DISTINCT: f64 = 20.0;
/// Setpoints that may be in force at a tick: those sent within this time before, s.
const AGE_MAX_S: f64 = 0.2;
/// Outputs that answer a setpoint, for a delay to be told.
const ANSWERS_MIN: usize = 200;
/// Steps of the delay, s, and the jitters that are tried with it, s.
const STEP_S: f64 = 2.5e-4;
const JITTERS_S: [f64; 6] = [1e-4, 3e-4, 6e-4, 1e-3, 2e-3, 4e-3];
/// Probability of an arrival that the model of jitter does not know.
const STRAY: f64 = 1e-3;
/// How well the clocks of ground and vehicle are tied by the least delay of the downlink, s.
const CLOCK_TIE_S: f64 = 7e-4;
/// Probability that nothing newer has arrived from which on older ones do not matter.
const NEGLIGIBLE: f64 = 1e-6;
/// Densities that are multiplied before their logarithm is taken: far from underflow.
const MULTIPLIED: usize = 64;
/// Outputs one after the other answer the same setpoint: so many count as one.
const CORRELATED: f64 = 4.0;

/// From sending a setpoint to its use, on average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    /// Mean, s.
    pub mean: f64,
    /// Its standard deviation, s.
    pub deviation: f64,
    /// The same by the log's own stamps, between whose clocks there may be an offset, s.
    pub by_stamps: f64,
}

/// A setpoint that may be in force at a tick.
struct Candidate {
    /// Since it was sent, s.
    age: f64,
    /// Standard deviation of that: 0 of those in the log, s.
    spread: f64,
    /// Whether the output may answer it.
    may_rule: bool,
}

/// What an output says: the newest setpoints at its tick, the newest first. The one in force had
/// arrived, and none of those before it here had.
struct Answer(Vec<Candidate>);

impl Delay {
    /// The delay in flights that `law` flew; `None` where too few outputs answer a setpoint.
    pub fn of(flights: &[PreparedFlight], law: &OnboardLaw) -> Option<Self> {
        let answers: Vec<Answer> = flights.iter().flat_map(|f| answers(f, law)).collect();
        Self::between(&answers)
    }

    /// The posterior mean over constant delays with exponential jitter, all as likely before.
    fn between(answers: &[Answer]) -> Option<Self> {
        if answers.len() < ANSWERS_MIN {
            return None;
        }
        let steps = (AGE_MAX_S / STEP_S) as usize;
        let options: Vec<(f64, f64)> = (0..steps * JITTERS_S.len())
            .into_par_iter()
            .map(|option| {
                let constant = (option % steps) as f64 * STEP_S;
                let jitter = JITTERS_S[option / steps];
                (constant + jitter, log_density(answers, constant, jitter) / CORRELATED)
            })
            .collect();
        let most = options.iter().map(|(_, density)| *density).fold(f64::NEG_INFINITY, f64::max);
        let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
        for (delay, density) in options {
            let weight = (density - most).exp();
            sum += weight;
            first += weight * delay;
            second += weight * delay * delay;
        }
        let mean = first / sum;
        let by_stamps = (second / sum - mean * mean).max(STEP_S.powi(2) / 12.0).sqrt();
        Some(Self { mean, deviation: by_stamps.hypot(CLOCK_TIE_S), by_stamps })
    }
}

/// Log density of all answers, for a constant delay and a mean jitter.
fn log_density(answers: &[Answer], constant: f64, jitter: f64) -> f64 {
    let of_some = |answers: &[Answer]| {
        answers.iter().map(|answer| answer.density(constant, jitter)).product::<f64>().ln()
    };
    answers.chunks(MULTIPLIED).map(of_some).sum()
}

impl Answer {
    /// Density of this answer, for a constant delay and a mean jitter; at least [`STRAY`].
    fn density(&self, constant: f64, jitter: f64) -> f64 {
        let (mut density, mut none_newer) = (STRAY, 1.0);
        for candidate in &self.0 {
            let under_way = candidate.under_way(constant, jitter);
            if candidate.may_rule {
                density += none_newer * (1.0 - under_way);
            }
            none_newer *= under_way;
            if none_newer < NEGLIGIBLE {
                break;
            }
        }
        density
    }
}

impl Candidate {
    /// Probability that it is still under way.
    fn under_way(&self, constant: f64, jitter: f64) -> f64 {
        let at = |age: f64| {
            let waited = age - constant;
            if waited > 0.0 { (-waited / jitter).exp() } else { 1.0 }
        };
        if self.spread == 0.0 {
            return at(self.age);
        }
        // Gauss and Hermite's three points.
        let far = 3.0_f64.sqrt() * self.spread;
        (at(self.age - far) + 4.0 * at(self.age) + at(self.age + far)) / 6.0
    }
}

/// What the outputs of a flight answer.
fn answers(flight: &PreparedFlight, law: &OnboardLaw) -> Vec<Answer> {
    let (sent, setpoints) = (flight.setpoint.times(), flight.setpoint.values());
    let collective_max = law.allocation().collective_max();
    let spread = send_spread(flight.setpoint.times(), &flight.inferred);
    let is_inferred = |index: &usize| flight.inferred.binary_search(index).is_ok();
    let outputs = flight.outputs.times().iter().zip(flight.outputs.values());
    outputs
        .filter(|(time, _)| flight.spans.iter().any(|span| span.contains(time)))
        // What saturates no longer tells the thrust.
        .filter(|(_, u)| u.iter().all(|u| (0.01..0.99).contains(u)))
        .filter_map(|(time, u)| {
            let tick = law.tick_of_report(*time);
            let collective = law.allocation().wrench(*u)[0] / collective_max;
            let newest = sent.partition_point(|sent| *sent <= tick).checked_sub(1)?;
            let oldest = sent.partition_point(|sent| *sent < tick - AGE_MAX_S);
            let mut off: Vec<(f64, usize)> = (oldest..=newest)
                .filter(|index| !is_inferred(index))
                .filter_map(|i| Some(((setpoints[i].thrust? - collective).abs(), i)))
                .collect();
            off.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (best, index) = *off.first()?;
            let is_distinct = off.get(1).is_none_or(|next| next.0 > DISTINCT * AGREEMENT);
            let is_of_log = best < AGREEMENT && is_distinct;
            // Neither a setpoint of the log nor one that it lacks.
            if !is_of_log
                && (best < DISTINCT * AGREEMENT || !(oldest..=newest).any(|i| is_inferred(&i)))
            {
                return None;
            }
            let candidate = |i: usize| Candidate {
                age: tick - sent[i],
                spread: if is_inferred(&i) { spread } else { 0.0 },
                may_rule: if is_of_log { i == index } else { is_inferred(&i) },
            };
            let oldest = if is_of_log { index } else { oldest };
            Some(Answer((oldest..=newest).rev().map(candidate).collect()))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers at ticks of 4 ms to setpoints every 10 ms that take `constant` and an exponential
    /// jitter of 1 ms, by quantiles instead of draws.
    fn flown(constant: f64) -> Vec<Answer> {
        let late = |k: usize| -1e-3 * (1.0 - (k * 37 % 101) as f64 / 101.0).ln();
        let arrives: Vec<f64> =
            (0..4000).map(|k| k as f64 * 0.01 + 0.0013 + constant + late(k)).collect();
        (100..3900)
            .map(|k| {
                let tick = (k as f64 * 0.01 / 0.004).floor() * 0.004;
                let newest = ((tick - 0.0013) / 0.01).floor() as usize;
                let mut index = newest;
                while arrives[index] > tick {
                    index -= 1;
                }
                let candidate = |i: usize| Candidate {
                    age: tick - (i as f64 * 0.01 + 0.0013),
                    spread: 0.0,
                    may_rule: i == index,
                };
                Answer((index..=newest).rev().map(candidate).collect())
            })
            .collect()
    }

    #[test]
    fn the_late_ones_tell_the_delay() {
        for constant in [0.003, 0.0121, 0.0305] {
            let delay = Delay::between(&flown(constant)).unwrap();
            assert!((delay.mean - constant - 0.001).abs() < 5e-4, "{constant}: {delay:?}");
            assert!(delay.deviation < 2e-3, "{delay:?}");
        }
    }

    #[test]
    fn few_answers_tell_nothing() {
        assert_eq!(Delay::between(&flown(0.003)[..100]), None);
    }
}
