//! Strain: numbers of the vehicle file that flights show to be further off than files are.
//!
//! A number is a nuisance within its tolerance, held by a prior. Where the effect that it belongs
//! to is not among the hypotheses, or another cause pulls at it, its fit ends far out, though the
//! flights know it well. Twins tell what a fit is off by itself (outputs that are logged seldom
//! make an inertia look larger): what remains is strain, and the nuisances have explained too much.

use serde::Serialize;
use sitl::effects::EffectId;

use super::fit::{Fit, fit};
use super::hypothesis::{Catalogue, Target};
use super::linearised::Linearised;
use super::naming::{THRUST_LEVEL, parameter};
use super::observed::Observed;
use super::selection::EVIDENCE_MIN;
use super::twins::TwinFits;

/// Tolerances from which on a number is strained: of 240 flights without an effect in two exams
/// none was.
const STRAINED: f64 = 2.4;
/// The same of a number that its fit holds at its limit: it would lie further off.
const STRAINED_AT_LIMIT: f64 = 1.8;
/// A number that is known to this share of its tolerance is known well: by its fit, and by the
/// scatter of its twins.
const KNOWN: [f64; 2] = [0.15, 0.25];

/// A number that lies further off than files are.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Strain {
    /// Which number.
    pub number: String,
    /// The effect that it belongs to, where it is one's.
    #[serde(skip)]
    pub effect: Option<EffectId>,
    /// By how many of its tolerances it is off.
    pub tolerances: f64,
}

impl Strain {
    fn of(target: Target, tolerances: f64) -> Self {
        let effect = match target {
            Target::Effect(effect, _) => Some(effect),
            _ => None,
        };
        Self { number: parameter(target), effect, tolerances }
    }
}

/// Whether a fit that looks at the numbers `active` holds another at its limit, off where it is
/// expected.
fn is_held(catalogue: &Catalogue, fit: &Fit, active: &[usize], number: usize) -> bool {
    let width = catalogue.numbers[number].tolerance;
    let value = fit.values[number];
    let is_near = |limit: f64| (value - limit).abs() < 1e-3 * width;
    let is_off = (value - catalogue.numbers[number].expected).abs() > width;
    is_off && catalogue.limits(number, active).into_iter().any(is_near)
}

/// Whether a fit holds a gain of the on-board loop or its latency at its limit. The delay's
/// tolerance is what the stamps tell, and says less.
pub fn is_loop_held(catalogue: &Catalogue, fit: &Fit) -> bool {
    let active = fit.active(catalogue);
    let is_of_loop =
        |target| matches!(target, Target::Effect(EffectId::PdGain | EffectId::EstimatorLatency, _));
    catalogue.nuisances().any(|number| {
        is_of_loop(catalogue.numbers[number].target) && is_held(catalogue, fit, &active, number)
    })
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
            let least =
                if is_held(catalogue, fit, &active, index) { STRAINED_AT_LIMIT } else { STRAINED };
            (is_known && tolerances.abs() > least).then(|| Strain::of(number.target, tolerances))
        })
        .collect();
    strained.sort_by(|a, b| b.tolerances.abs().total_cmp(&a.tolerances.abs()));
    strained
}

/// The effect that all of several strained numbers belong to.
pub fn effect_of(strained: &[Strain]) -> Option<EffectId> {
    let effect = strained.first()?.effect?;
    strained.iter().all(|strain| strain.effect == Some(effect)).then_some(effect)
}

/// The thrust's level, by the thrust or by the mass, where the chosen effects that are much like it
/// explain nothing beside it once it is as free as an effect. Thrust to mass is off on any vehicle
/// that carries something else than its file says; where it is no hypothesis itself, they would get
/// its evidence. `about`: derivatives of the nuisances.
pub fn level_in_place_of(best: &Fit, fitted: &Observed<'_>, about: &Linearised) -> Option<Strain> {
    let catalogue = fitted.catalogue;
    let is_like_it = |h: &usize| THRUST_LEVEL.contains(&catalogue.hypotheses[*h].effect);
    if catalogue.considers(EffectId::ThrustScale) || !best.hypotheses.iter().any(is_like_it) {
        return None;
    }
    let values_of = |hypotheses: &[usize]| -> Vec<(usize, f64)> {
        let numbers = hypotheses.iter().flat_map(|h| &catalogue.hypotheses[*h].numbers);
        numbers.map(|number| (*number, best.values[*number])).collect()
    };
    let rest: Vec<usize> = best.hypotheses.iter().copied().filter(|h| !is_like_it(h)).collect();
    let starts = [Vec::new(), values_of(&best.hypotheses)];
    // Thrust to mass is known as well as the thrust is, by whichever of the two it is told.
    let tolerance = catalogue.numbers[catalogue.number_of(EffectId::ThrustScale, 0)?].tolerance;
    [EffectId::ThrustScale, EffectId::Mass].into_iter().find_map(|effect| {
        let level = catalogue.number_of(effect, 0)?;
        let free = catalogue.with_free(level);
        let observed = Observed::new(fitted.flights, fitted.evaluator, &free);
        let without = fit(&observed, about, &rest, &[values_of(&rest)])?;
        let with = fit(&observed, about, &best.hypotheses, &starts)?;
        let number = catalogue.numbers[level];
        let share = (without.values[level] - number.expected) / number.reference;
        (with.evidence - without.evidence < EVIDENCE_MIN)
            .then(|| Strain::of(number.target, share / tolerance))
    })
}

#[cfg(test)]
mod tests {
    use sitl::vehicle::VehicleParams;

    use super::*;

    #[test]
    fn a_number_is_strained_where_flights_know_it_and_the_method_is_not_off_by_itself() {
        let text = include_str!("../../config/vehicles/quad1200.toml");
        let vehicle = VehicleParams::from_toml_str(text).unwrap();
        let catalogue = Catalogue::new(&vehicle, true);
        let index = catalogue.number_of(EffectId::YawTorque, 0).unwrap();
        let width = catalogue.numbers[index].tolerance;
        // Fitted so many tolerances off, known to so many, by a method that is off by so many.
        let strains = |off: f64, known: f64, bias: f64| {
            let expected = catalogue.expected();
            let with = |values: &[f64], more: f64| {
                let mut values = values.to_vec();
                values[index] += more * width;
                values
            };
            let fit = Fit {
                hypotheses: Vec::new(),
                values: with(&expected, off),
                deviation: with(&vec![0.0; expected.len()], known),
                evidence: 0.0,
                cost: 0.0,
                power: Vec::new(),
            };
            let bias = with(&vec![0.0; expected.len()], bias);
            let twins = TwinFits::alike(expected.clone(), expected, bias);
            super::strains(&catalogue, &fit, &twins)
        };
        let strained = strains(-2.8, 0.05, 0.0);
        assert_eq!(strained.len(), 1);
        assert_eq!(strained[0].number, "yaw_torque scale");
        assert_eq!(effect_of(&strained), Some(EffectId::YawTorque));
        let rotor = Strain::of(Target::RotorGain(2), 3.0);
        assert_eq!(effect_of(&[strained[0].clone(), rotor]), None);
        assert!((strained[0].tolerances + 2.8).abs() < 1e-9);
        assert!(strains(-2.8, 0.5, 0.0).is_empty());
        assert!(strains(-2.8, 0.05, -2.0).is_empty());
        // At its limit it would lie further off.
        assert_eq!(strains(3.0, 0.05, 1.0).len(), 1);
        assert!(strains(2.0, 0.05, 0.0).is_empty());
    }
}
