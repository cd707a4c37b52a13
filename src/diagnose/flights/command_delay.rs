//! Measures when setpoints arrive on board, from the outputs that respond to them.
//!
//! The mixer passes the setpoint's thrust on as the collective, so a logged output shows which
//! setpoint was in force at its tick. This bounds the delay of each setpoint without a model of the
//! vehicle. A delay is often synchronous with the loop and the stream: the same setpoints are in
//! force over some milliseconds of delay, and a fit of the outputs finds any value between. The few
//! late setpoints decide. An output that matches no setpoint of the log responds to one that the
//! log lacks, where there is one. Leaving it out would favour delays for which logged setpoints are
//! in force at every logged output.

use rayon::prelude::*;
use sitl::autopilot::offboard::JITTER_MEAN_S;

use crate::diagnose::flights::onboard::OnboardLaw;
use crate::diagnose::flights::preparation::PreparedFlight;

/// Largest difference between a collective and the thrust of its setpoint: single precision, twice.
const AGREEMENT: f64 = 2e-6;
/// All other setpoints must differ by this multiple of it.
const DISTINCT: f64 = 20.0;
/// Age limit of setpoints that may be in force at a tick, s.
const RESPONSE_TIME_MAX_S: f64 = 0.2;
/// Fewest outputs with a known setpoint for an estimate of the delay.
const RESPONSES_MIN: usize = 200;
/// Step of the delays that are tried, s, and the jitters that are tried with each, s.
const STEP_S: f64 = 2.5e-4;
const JITTERS_S: [f64; 6] = [1e-4, 3e-4, 6e-4, 1e-3, 2e-3, 4e-3];
/// Common shift of the setpoints that a thinned log lacks, relative to their inferred times. It
/// occurs for every other one where the controller responds to a vehicle whose loop is not
/// synchronous. Its standard deviation, and the values that are tried, s.
const SHIFT_S: f64 = 1e-3;
const SHIFTS_S: [f64; 6] = [-1.5e-3, -1e-3, -5e-4, 5e-4, 1e-3, 1.5e-3];
/// A link whose density is this far below that of the likeliest one does not count, nats.
const NEGLIGIBLE_NATS: f64 = 60.0;
/// Responses that a first search over the links uses.
const FIRST_RESPONSES: usize = 4000;
/// Probability of an arrival that contradicts the jitter model.
const OUTLIER_PROBABILITY: f64 = 1e-3;
/// Accuracy to which the downlink's least delay ties the two clocks, s.
const CLOCK_TIE_S: f64 = 7e-4;
/// Probability below which older setpoints are ignored.
const NEGLIGIBLE: f64 = 1e-6;
/// Densities that are multiplied before taking the logarithm, without underflow.
const FACTORS_PER_LOG: usize = 64;
/// Consecutive outputs respond to the same setpoint: this many count as one.
const CORRELATED: f64 = 4.0;

/// Delay from sending a setpoint to its use, on average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredDelay {
    /// Mean, s.
    pub mean: f64,
    /// Standard deviation of the mean, s.
    pub deviation: f64,
    /// As above between the log's own stamps, without the offset between the two clocks, s.
    pub by_stamps: f64,
}

/// A setpoint that may be in force at a tick.
struct PossibleSetpoint<'a> {
    /// Time since it was sent, s.
    age: f64,
    /// Possible lateness where the log lacks it: equally likely values, s.
    lateness: &'a [f64],
    /// Whether the output may respond to it.
    may_rule: bool,
}

/// The newest setpoints at the tick of an output, the newest first. The one in force has arrived;
/// those before it here have not.
struct Response<'a>(Vec<PossibleSetpoint<'a>>);

impl MeasuredDelay {
    /// The delay in flights under `law`; `None` where too few outputs show their setpoint.
    pub fn of(flights: &[PreparedFlight], law: &OnboardLaw) -> Option<Self> {
        let responses: Vec<Response<'_>> = flights.iter().flat_map(|f| responses(f, law)).collect();
        Self::between(&responses)
    }

    /// The posterior mean over constant delays with a flat prior and exponential jitter.
    fn between(responses: &[Response<'_>]) -> Option<Self> {
        let every = (responses.len() / FIRST_RESPONSES).max(1);
        (responses.len() >= RESPONSES_MIN).then(|| Self::searched(responses, every))
    }

    /// The same, where a first search over the links uses one response in `every` so many.
    fn searched(responses: &[Response<'_>], every: usize) -> Self {
        // The densities of one response in every so many.
        let weighed = |links: Vec<Link>, every: usize| -> Vec<(Link, f64)> {
            let density = |link: Link| (link, link.log_posterior(responses, every));
            links.into_par_iter().map(density).collect()
        };
        let likely = |options: &[(Link, f64)]| -> Vec<Link> {
            let least = most(options) - NEGLIGIBLE_NATS;
            options.iter().filter(|(_, density)| *density > least).map(|(link, _)| *link).collect()
        };
        let steps = (RESPONSE_TIME_MAX_S / STEP_S) as usize;
        let constants = (0..steps).map(|step| step as f64 * STEP_S);
        let link = |constant| JITTERS_S.map(|jitter| Link { constant, jitter, shift: 0.0 });
        let mut links: Vec<Link> = constants.flat_map(link).collect();
        if every > 1 {
            links = likely(&weighed(links, every));
        }
        let mut options = weighed(links, 1);
        let is_inferred = |candidate: &PossibleSetpoint<'_>| !candidate.lateness.is_empty();
        if responses.iter().any(|response| response.0.iter().any(is_inferred)) {
            let shifted = |link: Link| SHIFTS_S.map(|shift| Link { shift, ..link });
            let shifted = likely(&options).into_iter().flat_map(shifted).collect();
            options.extend(weighed(shifted, 1));
        }
        let most = most(&options);
        let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
        for (link, density) in options {
            let (weight, delay) = ((density - most).exp(), link.constant + link.jitter);
            sum += weight;
            first += weight * delay;
            second += weight * delay * delay;
        }
        let mean = first / sum;
        let by_stamps = (second / sum - mean * mean).max(STEP_S.powi(2) / 12.0).sqrt();
        Self { mean, deviation: by_stamps.hypot(CLOCK_TIE_S), by_stamps }
    }
}

/// The largest density.
fn most(options: &[(Link, f64)]) -> f64 {
    options.iter().map(|(_, density)| *density).fold(f64::NEG_INFINITY, f64::max)
}

/// The link's delay of setpoints.
#[derive(Clone, Copy, Debug)]
struct Link {
    /// Least delay, s.
    constant: f64,
    /// Mean of the exponential delay beyond it, s.
    jitter: f64,
    /// Delay of the setpoints that the log lacks, beyond their inferred times, s.
    shift: f64,
}

impl Link {
    /// Log density of one response in `every` so many, of the jitter (within a factor of two of the
    /// usual one) and of the shift, without constants.
    fn log_posterior(&self, responses: &[Response<'_>], every: usize) -> f64 {
        let of_some = |responses: &[Response<'_>]| {
            let some = responses.iter().step_by(every);
            some.map(|response| self.density(response)).product::<f64>().ln()
        };
        let log_density: f64 = responses.chunks(every * FACTORS_PER_LOG).map(of_some).sum();
        let octaves = (self.jitter / JITTER_MEAN_S).log2();
        log_density / CORRELATED - 0.5 * (octaves.powi(2) + (self.shift / SHIFT_S).powi(2))
    }

    /// Density of a response; at least [`OUTLIER_PROBABILITY`].
    fn density(&self, response: &Response<'_>) -> f64 {
        let (mut density, mut none_newer) = (OUTLIER_PROBABILITY, 1.0);
        for candidate in &response.0 {
            let under_way = self.under_way(candidate);
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

    /// Probability that a setpoint is still under way.
    fn under_way(&self, PossibleSetpoint { age, lateness, .. }: &PossibleSetpoint<'_>) -> f64 {
        let at = |age: f64| {
            let waited = age - self.constant;
            if waited > 0.0 { (-waited / self.jitter).exp() } else { 1.0 }
        };
        if lateness.is_empty() {
            return at(*age);
        }
        let sum: f64 = lateness.iter().map(|late| at(age - late - self.shift)).sum();
        sum / lateness.len() as f64
    }
}

/// The setpoints that each output of a flight may respond to.
fn responses<'a>(flight: &'a PreparedFlight, law: &OnboardLaw) -> Vec<Response<'a>> {
    let (sent, setpoints) = (flight.setpoint.times(), flight.setpoint.values());
    let collective_max = law.allocation().collective_max();
    let inferred = &flight.inferred;
    let outputs = flight.outputs.times().iter().zip(flight.outputs.values());
    outputs
        .filter(|(time, _)| flight.spans.iter().any(|span| span.contains(time)))
        // A saturated output does not show the thrust.
        .filter(|(_, u)| u.iter().all(|u| (0.01..0.99).contains(u)))
        .filter_map(|(time, u)| {
            let tick = law.tick_of_report(*time);
            let collective = law.allocation().wrench(*u)[0] / collective_max;
            let newest = sent.partition_point(|sent| *sent <= tick).checked_sub(1)?;
            let oldest = sent.partition_point(|sent| *sent < tick - RESPONSE_TIME_MAX_S);
            let mut off: Vec<(f64, usize)> = (oldest..=newest)
                .filter(|index| !inferred.has(*index))
                .filter_map(|i| Some(((setpoints[i].thrust? - collective).abs(), i)))
                .collect();
            off.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (best, index) = *off.first()?;
            let is_distinct = off.get(1).is_none_or(|next| next.0 > DISTINCT * AGREEMENT);
            let is_of_log = best < AGREEMENT && is_distinct;
            // Neither a logged setpoint nor a missing one.
            if !is_of_log
                && (best < DISTINCT * AGREEMENT || !(oldest..=newest).any(|i| inferred.has(i)))
            {
                return None;
            }
            let candidate = |i: usize| PossibleSetpoint {
                age: tick - sent[i],
                lateness: if inferred.has(i) { inferred.lateness() } else { &[] },
                may_rule: if is_of_log { i == index } else { inferred.has(i) },
            };
            let oldest = if is_of_log { index } else { oldest };
            Some(Response((oldest..=newest).rev().map(candidate).collect()))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers at ticks of 4 ms to setpoints every 10 ms. Their delay is `constant` plus an
    /// exponential jitter of 1 ms, with quantiles instead of draws.
    fn flown(constant: f64) -> Vec<Response<'static>> {
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
                let candidate = |i: usize| PossibleSetpoint {
                    age: tick - (i as f64 * 0.01 + 0.0013),
                    lateness: &[],
                    may_rule: i == index,
                };
                Response((index..=newest).rev().map(candidate).collect())
            })
            .collect()
    }

    #[test]
    fn delay_is_estimated_from_jittered_responses() {
        for constant in [0.003, 0.0121, 0.0305] {
            let delay = MeasuredDelay::between(&flown(constant)).unwrap();
            assert!((delay.mean - constant - 0.001).abs() < 5e-4, "{constant}: {delay:?}");
            assert!(delay.deviation < 2e-3, "{delay:?}");
        }
    }

    #[test]
    fn first_search_keeps_every_link_that_counts() {
        let responses = flown(0.0121);
        let whole = MeasuredDelay::searched(&responses, 1);
        let after_first = MeasuredDelay::searched(&responses, 8);
        assert!((after_first.mean - whole.mean).abs() < 1e-12, "{after_first:?} {whole:?}");
        assert!((after_first.by_stamps - whole.by_stamps).abs() < 1e-12);
    }

    #[test]
    fn few_responses_give_no_delay() {
        assert_eq!(MeasuredDelay::between(&flown(0.003)[..100]), None);
    }
}
