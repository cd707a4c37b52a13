//! Strain: numbers of the vehicle file that flights show to be further off than files are.
//!
//! A number is a nuisance within its tolerance, held by a prior. Where the effect that it belongs to
//! is not among the hypotheses, or another cause pulls at it, its fit ends far out, though the flights
//! know it well. Twins tell what a fit is off by itself (outputs that are logged seldom make an
//! inertia look larger): what remains is strain, and the nuisances have explained too much.

use serde::Serialize;
use sitl::effects::EffectId;

use super::fit::Fit;
use super::hypothesis::{Catalogue, Target};
use super::naming::parameter;
use super::twins::TwinFits;

/// Tolerances from which on a number is strained. Of 120 flights without an effect in an exam none
/// had a number beyond 2.
const STRAINED: f64 = 2.4;
/// The same of a number that its fit holds at its limit: it would lie further off.
const STRAINED_AT_LIMIT: f64 = 1.8;
/// A number that is known to this share of its tolerance is known well: by its fit, and by the scatter
/// of its twins.
const KNOWN: [f64; 2] = [0.15, 0.25];

/// A number that lies further off than files are.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Strain {
    /// Which number.
    pub number: String,
    /// By how many of its tolerances it is off.
    pub tolerances: f64,
}

/// Whether a fit holds a number of the on-board loop at its limit.
pub fn is_loop_held(catalogue: &Catalogue, fit: &Fit) -> bool {
    let active = fit.active(catalogue);
    let is_held = |number: usize| catalogue.limits(number, &active).contains(&fit.values[number]);
    let is_of_loop = |target| {
        matches!(
            target,
            Target::Effect(
                EffectId::PdGain | EffectId::CommandDelay | EffectId::EstimatorLatency,
                _
            )
        )
    };
    catalogue
        .nuisances()
        .any(|number| is_of_loop(catalogue.numbers[number].target) && is_held(number))
}

/// The nuisances of a fit that are strained, the most first. `twins`: of the vehicle of that fit.
pub fn strains(catalogue: &Catalogue, fit: &Fit, twins: &TwinFits) -> Vec<Strain> {
    let active = fit.active(catalogue);
    let mut strained: Vec<Strain> = catalogue
        .numbers
        .iter()
        .enumerate()
        .filter(|(index, number)| number.tolerance > 0.0 && !active.contains(index))
        .filter_map(|(index, number)| {
            let width = number.tolerance;
            let tolerances = (fit.values[index] - twins.bias[index] - number.expected) / width;
            let is_known = fit.deviation[index] < KNOWN[0] * width
                && twins.deviation(index) < KNOWN[1] * width;
            let is_held = catalogue.limits(index, &active).contains(&fit.values[index]);
            let least = if is_held { STRAINED_AT_LIMIT } else { STRAINED };
            (is_known && tolerances.abs() > least)
                .then(|| Strain { number: parameter(number.target), tolerances })
        })
        .collect();
    strained.sort_by(|a, b| b.tolerances.abs().total_cmp(&a.tolerances.abs()));
    strained
}
