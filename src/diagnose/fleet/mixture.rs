//! Numbers over a fleet: the type's values and each vehicle's deviations.
//!
//! For a set of effects, the numbers x of a vehicle are in one of three states. They follow the
//! *type*: normal about its values `theta`, with a spread `tau` between builds. They follow the
//! *file*, within its tolerances. Or the vehicle has its *own* effect of the catalogue, whose
//! numbers are anywhere (a normal slab of one magnitude). Given x, each vehicle's flights have a
//! normal likelihood, so each state integrates in closed form. Expectation maximisation finds theta
//! and tau, and Laplace's approximation adds theta's prior and spread.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::fleet::survey::{Survey, Surveyed};
use crate::diagnose::verdict::posterior::PRICE;

/// A vehicle's log likelihood of numbers x: `constant + linear x - x precision x / 2`.
#[derive(Clone, Debug)]
pub struct Quadratic {
    constant: f64,
    linear: DVector<f64>,
    precision: DMatrix<f64>,
}

/// A normal distribution of independent numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Normal {
    /// Means.
    pub mean: Vec<f64>,
    /// Standard deviations.
    pub deviation: Vec<f64>,
}

/// The posterior of numbers under a normal prior.
struct Posterior {
    /// Log of the likelihood integrated over the prior.
    evidence: f64,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Quadratic {
    /// The likelihood of a set that was fitted under a prior of one magnitude; `None` if the set's
    /// covariance is not a positive definite matrix over its numbers.
    pub fn of(set: &Surveyed) -> Option<Self> {
        let n = set.mean.len();
        // The set may come from a file.
        if set.covariance.len() != n * n {
            return None;
        }
        let covariance = DMatrix::from_row_slice(n, n, &set.covariance);
        let factor = covariance.cholesky()?;
        let inverse = factor.inverse();
        let mean = DVector::from_column_slice(&set.mean);
        let linear = &inverse * &mean;
        let determinant: f64 = (0..n).map(|i| 2.0 * factor.l_dirty()[(i, i)].ln()).sum();
        let constant = set.evidence - 0.5 * determinant - 0.5 * mean.dot(&linear);
        Some(Self { constant, linear, precision: inverse - DMatrix::identity(n, n) })
    }

    /// The posterior under a normal prior of the same numbers.
    fn under(&self, prior: &Normal) -> Option<Posterior> {
        let weights = prior.deviation.iter().map(|d| d.powi(-2));
        let weights = DVector::from_iterator(prior.deviation.len(), weights);
        let middle = DVector::from_column_slice(&prior.mean);
        let pulled = weights.component_mul(&middle);
        let factor = (&self.precision + DMatrix::from_diagonal(&weights)).cholesky()?;
        let right = &self.linear + &pulled;
        let mean = factor.solve(&right);
        let l = factor.l_dirty();
        let determinant: f64 = (0..weights.len()).map(|i| 2.0 * l[(i, i)].ln()).sum();
        let evidence = self.constant - 0.5 * middle.dot(&pulled)
            + 0.5 * weights.iter().map(|w| w.ln()).sum::<f64>()
            - 0.5 * determinant
            + 0.5 * right.dot(&mean);
        Some(Posterior { evidence, mean, covariance: factor.inverse() })
    }
}

/// A vehicle of a fleet with a set of effects.
#[derive(Clone, Debug)]
pub struct Member {
    /// Likelihood of the set's numbers; `None` if its logs cannot show them.
    pub set: Option<Quadratic>,
    /// Log evidence without the set's newest effect.
    pub file: f64,
    /// Log evidence with an effect of its own beside the base.
    pub own: f64,
}

/// Log evidence of a vehicle with the `base` alone, and with an effect of its own beside it.
pub fn alone(survey: &Survey, base: &Normal) -> [f64; 2] {
    let n = base.mean.len();
    let under = |set: &Surveyed| {
        let more = set.mean.len().checked_sub(n)?;
        let slab = Normal {
            mean: base.mean.iter().copied().chain(vec![0.0; more]).collect(),
            deviation: base.deviation.iter().copied().chain(vec![1.0; more]).collect(),
        };
        Some(Quadratic::of(set)?.under(&slab)?.evidence)
    };
    let file = (n > 0).then(|| under(&survey.base)).flatten().unwrap_or(survey.base.evidence);
    let own: Vec<f64> = survey.beside.iter().filter_map(under).map(|e| e - PRICE).collect();
    [file, log_sum(own.iter().copied())]
}

/// Prior knowledge of a number, in magnitudes.
#[derive(Clone, Debug)]
pub struct Width {
    /// The file's tolerance.
    pub tolerance: f64,
    /// Whether it is a number of the base rather than of the newest effect.
    pub is_base: bool,
}

/// A set of effects, fitted over the fleet.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// The type's values and the spread between builds, in magnitudes.
    pub of_type: Normal,
    /// Standard errors of the type's values.
    pub error: Vec<f64>,
    /// Share of the vehicles that follow the type, among those without effects of their own.
    pub share: f64,
    /// Log evidence of each vehicle, including its share of the integral over the type's values.
    pub blocks: Vec<f64>,
    /// Probability that each vehicle follows the type, follows the file, and has its own effect.
    pub states: Vec<[f64; 3]>,
    /// Probability that the type has the newest effect, rather than a group of vehicles.
    pub type_probability: f64,
}

/// Rounds of expectation maximisation.
const ROUNDS: usize = 25;
/// Most vehicles whose values are start values.
const STARTS: usize = 6;
/// Limits of the spread between builds: at least this in magnitudes, at least this share of the
/// value, and at most this multiple of the expected spread.
const SPREAD_MIN: f64 = 0.01;
const SPREAD_SHARE: f64 = 0.05;
const SPREAD_RATIO_MAX: f64 = 3.0;
/// Weight of the expected spread, in vehicles.
const SPREAD_WEIGHT: f64 = 4.0;
/// About one vehicle in this many lacks an effect of its type.
const ALL_BUT_ONE_IN: f64 = 50.0;

/// The logarithm of the sum of exponentials.
fn log_sum(terms: impl Iterator<Item = f64> + Clone) -> f64 {
    let top = terms.clone().fold(f64::NEG_INFINITY, f64::max);
    if top == f64::NEG_INFINITY {
        return top;
    }
    top + terms.map(|term| (term - top).exp()).sum::<f64>().ln()
}

/// Log evidence of a vehicle that follows the type, follows the file, and has its own effect; and
/// the posterior of its numbers under the type.
struct StateEvidence {
    states: [f64; 3],
    posterior: Option<Posterior>,
}

fn state_evidence(member: &Member, of_type: &Normal) -> StateEvidence {
    let posterior = member.set.as_ref().and_then(|set| set.under(of_type));
    // A vehicle whose logs cannot show the effect is neutral.
    let as_type = posterior.as_ref().map_or(member.file, |posterior| posterior.evidence);
    StateEvidence { states: [as_type, member.file, member.own], posterior }
}

/// Probability of each state at the share of vehicles that follow the type, and the log evidence of
/// all states together.
fn state_probabilities(states: &[f64; 3], share: f64) -> ([f64; 3], f64) {
    let [of_type, of_file, own] = *states;
    let terms = [of_type + share.ln(), of_file + (1.0 - share).ln(), own];
    let sum = log_sum(terms.iter().copied());
    (terms.map(|term| (term - sum).exp()), sum)
}

/// The expected spread between builds, given the type's values.
fn expected_spread(widths: &[Width], mean: &[f64]) -> Vec<f64> {
    let of_one = |(width, mean): (&Width, &f64)| {
        width.tolerance.max(SPREAD_SHARE * mean.abs()).max(SPREAD_MIN)
    };
    widths.iter().zip(mean).map(of_one).collect()
}

/// The fleet's values of a set of effects, from the start with the most evidence.
pub fn fit(members: &[Member], widths: &[Width], starts: &[Vec<f64>]) -> Option<Fitted> {
    let step = starts.len().div_ceil(STARTS).max(1);
    let fitted = starts.iter().step_by(step).filter_map(|start| maximise(members, widths, start));
    let score = |fitted: &Fitted| fitted.blocks.iter().sum::<f64>();
    fitted.max_by(|a, b| score(a).total_cmp(&score(b)))
}

/// Expectation maximisation from the type's values `start`, in magnitudes.
fn maximise(members: &[Member], widths: &[Width], start: &[f64]) -> Option<Fitted> {
    let base = widths.iter().filter(|width| width.is_base).count();
    let n = widths.len();
    // Without a newest effect, every vehicle follows the type.
    let has_newest = base < n;
    let mut of_type = Normal { mean: start.to_vec(), deviation: expected_spread(widths, start) };
    let mut share = 0.5;
    let mut information = DMatrix::identity(n, n);
    for _ in 0..ROUNDS {
        let mut right = DVector::zeros(n);
        information = DMatrix::identity(n, n);
        let (mut spread, mut count) = (vec![0.0; n], 0.0);
        let mut counts = [0.0; 2];
        let weights: Vec<f64> = of_type.deviation.iter().map(|d| d.powi(-2)).collect();
        let inverse = DMatrix::from_diagonal(&DVector::from_column_slice(&weights));
        for member in members {
            let evidence = state_evidence(member, &of_type);
            let (odds, _) = state_probabilities(&evidence.states, share);
            counts[0] += odds[0];
            counts[1] += odds[1];
            let Some((posterior, set)) = evidence.posterior.zip(member.set.as_ref()) else {
                continue;
            };
            let gain = &inverse * &posterior.covariance;
            information += (&inverse - &gain * &inverse) * odds[0];
            right += &gain * &set.linear * odds[0];
            count += odds[0];
            for (i, sum) in spread.iter_mut().enumerate() {
                let off = posterior.mean[i] - of_type.mean[i];
                *sum += odds[0] * (off * off + posterior.covariance[(i, i)]);
            }
        }
        let mean = information.clone().cholesky()?.solve(&right);
        let expected = expected_spread(widths, mean.as_slice());
        of_type.deviation = spread
            .iter()
            .zip(&expected)
            .map(|(sum, expected)| {
                let square = (sum + SPREAD_WEIGHT * expected * expected) / (count + SPREAD_WEIGHT);
                square.sqrt().clamp(0.3 * expected, SPREAD_RATIO_MAX * expected)
            })
            .collect();
        of_type.mean = mean.as_slice().to_vec();
        if has_newest {
            share = (counts[0] + 0.5) / (counts[0] + counts[1] + 1.0);
        }
    }
    let covariance = information.cholesky()?.inverse();
    let determinant = covariance.clone().determinant().max(f64::MIN_POSITIVE).ln();
    // The type's values, integrated over a prior of one magnitude.
    let square: f64 = of_type.mean.iter().map(|mean| mean * mean).sum();
    let integral = 0.5 * determinant - 0.5 * square;
    let evidence: Vec<[f64; 3]> =
        members.iter().map(|member| state_evidence(member, &of_type).states).collect();
    let share = if has_newest { share } else { 0.5 };
    let (states, mut blocks): (Vec<[f64; 3]>, Vec<f64>) =
        evidence.iter().map(|states| state_probabilities(states, share)).unzip();
    let each = integral / members.len().max(1) as f64;
    blocks.iter_mut().for_each(|block| *block += each);
    let type_probability = if has_newest { type_probability(&evidence) } else { 1.0 };
    let error = (0..n).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
    Some(Fitted { of_type, error, share, blocks, states, type_probability })
}

/// Points of the integral over the share.
const SHARES: usize = 200;

/// Probability that nearly all vehicles have the effect, rather than any share of them.
fn type_probability(evidence: &[[f64; 3]]) -> f64 {
    let at = |k: usize| (k as f64 + 0.5) / SHARES as f64;
    let of_share =
        |k: usize| evidence.iter().map(|states| state_probabilities(states, at(k)).1).sum::<f64>();
    let likelihood: Vec<f64> = (0..SHARES).map(of_share).collect();
    let by =
        |prior: &dyn Fn(f64) -> f64| log_sum((0..SHARES).map(|k| likelihood[k] + prior(at(k))));
    let nearly_all = by(&|share| ALL_BUT_ONE_IN.ln() + (ALL_BUT_ONE_IN - 1.0) * share.ln());
    let any = by(&|_| 0.0);
    1.0 / (1.0 + (any - nearly_all).exp())
}

/// Log evidence of a vehicle with nothing beyond the base, or with an effect of its own.
pub fn without([file, own]: [f64; 2]) -> f64 {
    log_sum([file, own].into_iter())
}

/// A vehicle's own estimates of a set's numbers, in magnitudes: means and standard deviations.
pub fn values_of(set: &Surveyed) -> Vec<[f64; 2]> {
    let n = set.mean.len();
    let deviation = |i: usize| set.covariance.get(i * (n + 1)).map_or(0.0, |v| v.max(0.0).sqrt());
    set.mean.iter().enumerate().map(|(i, mean)| [*mean, deviation(i)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vehicle whose flights determine a single number to within `error`, in magnitudes.
    fn vehicle(value: f64, error: f64) -> Survey {
        let precision = error.powi(-2) + 1.0;
        let mean = value * error.powi(-2) / precision;
        // For the likelihood exp(-((x - value) / error)^2 / 2).
        let evidence =
            -0.5 * value * value / (error * error + 1.0) - 0.5 * (1.0 + error.powi(-2)).ln();
        let base = Surveyed {
            keys: Vec::new(),
            numbers: Vec::new(),
            evidence: -0.5 * (value / error).powi(2),
            mean: Vec::new(),
            covariance: Vec::new(),
        };
        let set = Surveyed {
            keys: vec!["wear".to_owned()],
            numbers: Vec::new(),
            evidence,
            mean: vec![mean],
            covariance: vec![1.0 / precision],
        };
        Survey {
            base,
            beside: vec![set],
            chance: Vec::new(),
            file: Vec::new(),
            seconds: 60.0,
            voltage_differs: true,
            outputs_logged: true,
        }
    }

    fn fitted(values: &[f64]) -> (Fitted, f64) {
        let none = Normal { mean: Vec::new(), deviation: Vec::new() };
        let member = |value: &f64| {
            let survey = vehicle(*value, 0.02);
            let [file, own] = alone(&survey, &none);
            Member { set: Quadratic::of(&survey.beside[0]), file, own }
        };
        let members: Vec<Member> = values.iter().map(member).collect();
        let widths = [Width { tolerance: 0.02, is_base: false }];
        let starts: Vec<Vec<f64>> = values.iter().map(|value| vec![*value]).collect();
        let fitted = fit(&members, &widths, &starts).expect("a fit");
        let nothing: f64 = members.iter().map(|m| without([m.file, m.own])).sum();
        let gain = fitted.blocks.iter().sum::<f64>() - nothing;
        (fitted, gain)
    }

    #[test]
    fn closed_form_evidence_matches_the_integral() {
        let survey = vehicle(0.4, 0.1);
        let set = Quadratic::of(&survey.beside[0]).expect("a likelihood");
        let prior = Normal { mean: vec![0.3], deviation: vec![0.2] };
        let closed = set.under(&prior).expect("a posterior").evidence;
        let step = 1e-3;
        let sum: f64 = (-3000..3000)
            .map(|k| f64::from(k) * step)
            .map(|x: f64| {
                let z = (x - 0.3) / 0.2;
                let density = (-0.5 * z * z).exp() / (0.2 * std::f64::consts::TAU.sqrt());
                (-0.5 * ((x - 0.4) / 0.1).powi(2)).exp() * density * step
            })
            .sum();
        assert!((closed - sum.ln()).abs() < 1e-6, "{closed} {}", sum.ln());
    }

    #[test]
    fn shared_deviation_is_distinguished_from_an_individual_one() {
        let mut values: Vec<f64> = (0..12).map(|k| 0.5 + 0.01 * f64::from(k % 3)).collect();
        values.push(-0.8);
        let (fleet, gain) = fitted(&values);
        assert!(gain > 20.0 && (fleet.of_type.mean[0] - 0.51).abs() < 0.02, "{fleet:?}");
        assert!(
            fleet.type_probability > 0.8 && fleet.states[12][2] > 0.9 && fleet.states[0][0] > 0.9
        );
    }

    #[test]
    fn one_damaged_vehicle_is_not_a_type_deviation() {
        let mut values = vec![0.0; 12];
        values.push(0.8);
        assert!(fitted(&values).1 < PRICE);
    }

    #[test]
    fn deviation_of_half_the_fleet_is_a_group() {
        let values: Vec<f64> = (0..20).map(|k| if k % 2 == 0 { 0.5 } else { 0.0 }).collect();
        let (fleet, gain) = fitted(&values);
        assert!(gain > PRICE && fleet.type_probability < 0.1, "{fleet:?}");
        assert!((fleet.share - 0.5).abs() < 0.1);
    }

    #[test]
    fn two_equal_vehicles_do_not_establish_a_type_deviation() {
        let (two, _) = fitted(&[0.5, 0.5]);
        assert!((0.5..0.8).contains(&two.type_probability), "{}", two.type_probability);
        let (ten, _) = fitted(&[0.5; 10]);
        assert!(ten.type_probability > 0.85, "{}", ten.type_probability);
    }
}
