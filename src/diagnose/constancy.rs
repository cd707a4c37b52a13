//! Constancy: whether the numbers of the chosen effects are the same however the vehicle flies.
//!
//! A mass is the same at any throttle, and a torque constant at any speed. What stands in for a
//! cause that the catalogue lacks fits it on average alone: its number would have to go with what
//! the true cause goes by. Each number is let change in proportion to one quantity of the flight
//! at a time (a varying coefficient; Hastie and Tibshirani 1993); evidence for that, beyond what
//! chance gives twins of the very vehicle that was found, is evidence against the effect.

use serde::Serialize;
use sitl::effects::EffectId;

use super::fit::Z90;
use super::hypothesis::{Catalogue, Hypothesis, Number};
use super::inquiry::Inquiry;
use super::law::is_constant;
use super::linearised::Linearised;
use super::map::{QUANTITIES, quantities, told};
use super::naming::{losses, mends_a_law, parameter_name};
use super::observed::{Observed, Residuals};
use super::preparation::PreparedFlight;
use super::search::FlownFit;
use super::selection::{EVIDENCE_MIN, Selection};
use super::twins::chance_and_asked;

/// Laws of the airspeed: together they bend into any, one alone holds at any speed or is not it.
const DRAGS: [EffectId; 2] = [EffectId::RotorDrag, EffectId::ParasiticDrag];
/// Place of the speed among the [`QUANTITIES`].
const SPEED: usize = 0;
/// Least share of an effect's evidence that its variation has: nothing that is modelled is exact. Of
/// the causes of an exam that were named rightly none had more than 0.04, and of stand-ins two of
/// three had 0.1 to 0.9.
const SHARE_MIN: f64 = 0.1;
/// A drag is steady if it changes with the speed by less than this share of what another power of
/// the speed, one higher or lower, would make of it.
const STEADY_MAX: f64 = 0.5;
/// A quantity whose standard deviation is a smaller share of its mean is but rounded.
const CONSTANT_WITHIN: f64 = 1e-9;
/// Between samples of the quantities that tell by how much each varies, s.
const SAMPLE_S: f64 = 0.1;

/// A number that would have to vary.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Variation {
    /// The effect.
    pub effect: EffectId,
    /// Its number.
    pub number: String,
    /// What it would go with.
    pub quantity: &'static str,
    /// By how much it would change over one standard deviation of the quantity, in the number's
    /// unit.
    pub change: f64,
    /// Evidence for it beyond chance, nats.
    pub evidence: f64,
}

/// Whether what was chosen is constant.
#[derive(Clone, Debug, Default)]
pub(super) struct Constancy {
    /// The most evident variation of a number that should be constant.
    pub variation: Option<Variation>,
    /// Whether a drag was chosen, no other drag beside it, whose coefficients are known to be the
    /// same at any speed: its law of the speed is the catalogue's, whatever else it depends on.
    pub is_steady_drag: bool,
}

impl Inquiry<'_> {
    /// Whether the chosen effects are constant. `flown`: twins of the vehicle that has them.
    pub(super) fn constancy(&self, selection: &Selection, flown: &FlownFit) -> Constancy {
        let best = &selection.best;
        let chosen = best.fit.hypotheses.iter().map(|h| &self.catalogue.hypotheses[*h]);
        let drags = chosen.clone().filter(|h| DRAGS.contains(&h.effect)).count();
        let spread = Spread::of(self.case.fitted);
        let active = best.fit.active(self.catalogue);
        let mut found = Constancy::default();
        let losses = losses(selection);
        for (place, (hypothesis, (without, _))) in chosen.zip(&selection.places).enumerate() {
            // What but mends another's law goes with what that law goes by.
            if mends_a_law(self.catalogue, &losses, place) {
                continue;
            }
            let is_drag = DRAGS.contains(&hypothesis.effect) && drags == 1;
            let quantities = match is_drag {
                true => SPEED..SPEED + 1,
                false if is_constant(hypothesis.effect) => 0..QUANTITIES.len(),
                false => continue,
            };
            let trial = Trial { hypothesis, active: &active, flown, spread: &spread };
            let least = SHARE_MIN * (best.evidence - without.evidence);
            let variations = self.variations(&trial, quantities);
            let of_all = variations.into_iter().filter(|variation| variation.evidence > least);
            let most = of_all.chain(found.variation.take());
            found.variation = most.max_by(|a, b| a.evidence.total_cmp(&b.evidence));
            found.is_steady_drag |=
                is_drag && found.variation.is_none() && self.is_steady(&trial, &best.fit.deviation);
        }
        found
    }

    /// Variations of an effect's numbers with some of the [`QUANTITIES`] that are more than chance.
    fn variations(&self, trial: &Trial<'_>, of: std::ops::Range<usize>) -> Vec<Variation> {
        let Trial { hypothesis, flown: FlownFit { about, twins }, spread, .. } = trial;
        let Some(base) = self.fitted.residuals(&about.values) else { return Vec::new() };
        let tried = hypothesis.numbers.len() * of.len();
        let mut found = Vec::new();
        // Where the sensors' noise is in a derivative, twins must have their own.
        let quiet = hypothesis.numbers.iter().filter(|number| !twins.noisy.contains(number));
        for number in quiet {
            let varying = trial.varying(&self.fitted, *number);
            let columns = varying.columns(spread);
            let of_quantities = QUANTITIES.iter().zip(columns).enumerate();
            let of_quantities = of_quantities.filter(|(index, _)| of.contains(index));
            for (_, (quantity, column)) in of_quantities.filter(|(index, _)| spread.differs(*index))
            {
                // What is too little before chance is taken off needs no twins.
                let change = varying.change(&base, &column);
                let Some(change) = change.filter(|change| change.evidence > EVIDENCE_MIN) else {
                    continue;
                };
                let of_twin = |twin| varying.change(twin, &column).map(|change| change.evidence);
                let gains = twins.residuals().filter_map(of_twin).collect();
                let (chance, asked) = chance_and_asked(gains, tried);
                if change.evidence - chance > asked {
                    found.push(Variation {
                        effect: hypothesis.effect,
                        number: parameter_name(self.catalogue.numbers[*number].target),
                        quantity,
                        change: change.mean,
                        evidence: change.evidence - chance,
                    });
                }
            }
        }
        found
    }

    /// Whether an effect's numbers, those that are off the vehicle file, are known to be the same at
    /// any speed. `deviation`: standard deviation of each number of the catalogue.
    fn is_steady(&self, trial: &Trial<'_>, deviation: &[f64]) -> bool {
        let about = &trial.flown.about;
        let Some(base) = self.fitted.residuals(&about.values) else { return false };
        let [mean, spread] = trial.spread.0[SPEED];
        let is_off = |number: &&usize| {
            let off = about.values[**number] - self.catalogue.numbers[**number].reference;
            off.abs() > Z90 * deviation[**number]
        };
        let mut off = trial.hypothesis.numbers.iter().filter(is_off).peekable();
        off.peek().is_some()
            && off.all(|number| {
                let varying = trial.varying(&self.fitted, *number);
                let column = varying.columns(trial.spread).into_iter().nth(SPEED);
                let change = column.and_then(|column| varying.change(&base, &column));
                let by_a_power = about.values[*number].abs() * spread / mean;
                change.is_some_and(|change| {
                    change.mean.abs() + Z90 * change.deviation < STEADY_MAX * by_a_power
                })
            })
    }
}

/// An effect whose numbers are let vary.
struct Trial<'a> {
    hypothesis: &'a Hypothesis,
    /// All numbers of the chosen effects.
    active: &'a [usize],
    flown: &'a FlownFit,
    spread: &'a Spread,
}

impl<'a> Trial<'a> {
    fn varying(&self, observed: &'a Observed<'a>, number: usize) -> Varying<'a> {
        let Self { active, flown, .. } = *self;
        let mut catalogue = observed.catalogue.clone();
        // Of the number's own magnitude over a standard deviation of the quantity.
        let change = Number {
            reference: 0.0,
            expected: 0.0,
            tolerance: 0.0,
            bounds: [f64::NEG_INFINITY, f64::INFINITY],
            ..catalogue.numbers[number]
        };
        catalogue.numbers.push(change);
        Varying { observed, about: &flown.about, active, number, catalogue }
    }
}

/// The problem with one number that may vary.
struct Varying<'a> {
    observed: &'a Observed<'a>,
    about: &'a Linearised,
    active: &'a [usize],
    number: usize,
    /// The catalogue with the change as a further number, the last.
    catalogue: Catalogue,
}

/// A change of a number over one standard deviation of a quantity.
struct Change {
    /// What it gains of evidence, nats.
    evidence: f64,
    /// Mean and standard deviation, in the number's unit.
    mean: f64,
    deviation: f64,
}

impl Varying<'_> {
    /// Derivatives of what is left by the change with each of the [`QUANTITIES`].
    fn columns(&self, spread: &Spread) -> Vec<Residuals> {
        let Self { observed, about, number, .. } = self;
        let scores = |flight: &PreparedFlight, time: f64| spread.scores(flight, time).to_vec();
        observed.columns_by_weight(&about.values, *number, scores).unwrap_or_default()
    }

    /// The change where `residuals` are left and `column` is their derivative by it.
    fn change(&self, residuals: &Residuals, column: &Residuals) -> Option<Change> {
        let Self { observed, about, active, catalogue, .. } = self;
        let change = catalogue.numbers.len() - 1;
        let mut values = about.values.clone();
        values.push(0.0);
        let fresh = [(change, column.clone())];
        let local = about.with(observed, &values, residuals, &about.numbers, &fresh);
        let constant = local.solve(catalogue, observed.counts(), active)?;
        let varying: Vec<usize> = active.iter().copied().chain([change]).collect();
        let varying = local.solve_from(catalogue, observed.counts(), &varying, &constant.values)?;
        Some(Change {
            evidence: varying.evidence - constant.evidence,
            mean: varying.values[change],
            deviation: varying.deviation[change],
        })
    }
}

/// Mean and standard deviation of each quantity over flights.
struct Spread([[f64; 2]; QUANTITIES.len()]);

impl Spread {
    fn of(flights: &[PreparedFlight]) -> Self {
        let times = |flight: &PreparedFlight| -> Vec<f64> {
            let spans = flight.spans.iter();
            let within = |span: &std::ops::Range<f64>| {
                let count = ((span.end - span.start) / SAMPLE_S) as usize;
                let start = span.start;
                (0..count).map(move |k| start + k as f64 * SAMPLE_S)
            };
            spans.flat_map(within).collect()
        };
        let sampled = |flight| times(flight).into_iter().map(|time| quantities(flight, time));
        let samples: Vec<[f64; QUANTITIES.len()]> = flights.iter().flat_map(sampled).collect();
        let n = samples.len().max(1) as f64;
        Self(std::array::from_fn(|i| {
            let mean = samples.iter().map(|sample| sample[i]).sum::<f64>() / n;
            let squares: f64 = samples.iter().map(|sample| (sample[i] - mean).powi(2)).sum();
            // A log that does not tell it would stand apart from the others.
            let is_told = flights.iter().all(|flight| told(flight)[i]);
            [mean, if is_told { (squares / n).sqrt() } else { 0.0 }]
        }))
    }

    /// Whether a quantity changes at all.
    fn differs(&self, quantity: usize) -> bool {
        let [mean, deviation] = self.0[quantity];
        deviation > CONSTANT_WITHIN * mean.abs()
    }

    /// The quantities at a time, in standard deviations from their means.
    fn scores(&self, flight: &PreparedFlight, time: f64) -> [f64; QUANTITIES.len()] {
        let found = quantities(flight, time);
        std::array::from_fn(|i| {
            let [mean, deviation] = self.0[i];
            if self.differs(i) { (found[i] - mean) / deviation } else { 0.0 }
        })
    }
}
