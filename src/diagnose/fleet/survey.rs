//! What one vehicle's flights say of every effect beside those that its type is taken to have: log
//! evidence, and a normal likelihood of the effects' numbers.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::diagnose::catalogue::hypothesis::{Catalogue, Hypothesis};
use crate::diagnose::catalogue::number::Target;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::case::{Case, Settings};
use crate::diagnose::inquiry::Premises;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::report_noise;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::scale::scale;
use crate::diagnose::search::turning::{Turning, turning};
use crate::diagnose::search::twins::{TwinFits, screened};
use crate::diagnose::verdict::posterior::PRICE;
use crate::diagnose::verdict::weighing::{unremarkable, voltages_differ};

/// A number of a set of effects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurveyedNumber {
    /// The effect, and for the loss of a rotor which.
    pub key: String,
    /// Its effect.
    pub effect: String,
    /// Its name within the effect.
    pub name: String,
    /// The slot of the effect that it is.
    pub slot: usize,
    /// As the vehicle file has it.
    pub reference: f64,
    /// A typical magnitude where its effect occurs.
    pub magnitude: f64,
    /// Standard deviation of what the file's errors bring about of it.
    pub unremarkable: f64,
    /// Where it may lie.
    pub bounds: [f64; 2],
    /// Whether a file without the effect has it at an end of that.
    pub absent: Option<f64>,
}

/// A set of effects with the likelihood of its numbers, in units of their magnitudes from where the
/// file has them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surveyed {
    /// Its hypotheses.
    pub keys: Vec<String>,
    /// Their numbers.
    pub numbers: Vec<SurveyedNumber>,
    /// Log evidence under a normal prior of one magnitude about the file, nats.
    pub evidence: f64,
    /// Mean of the numbers then.
    pub mean: Vec<f64>,
    /// Covariance, row by row.
    pub covariance: Vec<f64>,
}

/// A number of the vehicle file as a vehicle's flights have it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnNumber {
    /// Its name.
    pub name: String,
    /// Its distance from the file, in tolerances.
    pub tolerances: f64,
    /// As fitted.
    pub value: f64,
    /// As the file has it.
    pub expected: f64,
}

/// What a vehicle's flights say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// The effects that every set has.
    pub base: Surveyed,
    /// These with one more.
    pub beside: Vec<Surveyed>,
    /// Evidence that chance gives each hypothesis of its catalogue without any effect, nats.
    pub chance: Vec<f64>,
    /// The vehicle file's numbers with the base.
    pub file: Vec<OwnNumber>,
    /// Airborne time, s.
    pub seconds: f64,
    /// Whether the pack's voltage varies enough to tell a sag from another level of the thrust.
    pub voltage_differs: bool,
    /// Whether motor outputs or rotor speeds are logged.
    pub outputs_logged: bool,
}

/// What a survey is made with.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Scale of the tolerances that the vehicle file does not state.
    pub scale: f64,
    /// The effects that the type has, with their numbers' values.
    pub shared: Vec<(String, Vec<f64>)>,
}

/// Gains of evidence below this are worth no fit, nats: an effect costs more.
const WORTH_A_FIT: f64 = PRICE;

/// The name of a hypothesis over all vehicles: its effect, and for a rotor's loss which.
pub fn key_of(catalogue: &Catalogue, hypothesis: &Hypothesis) -> String {
    let first = hypothesis.numbers.first().map(|number| catalogue.numbers[*number].target);
    match first {
        Some(Target::RotorScale(rotor)) => format!("{} {rotor}", hypothesis.effect),
        _ => hypothesis.effect.to_string(),
    }
}

/// Log evidence of each scale of the tolerances that the vehicle file does not state.
///
/// # Errors
/// As [`survey`].
pub fn scales(case: &Case<'_>) -> Result<Vec<[f64; 2]>, DiagnoseError> {
    let premises = Premises::of(case);
    let at_scale = |scale: f64| premises.catalogue(case, scale);
    let first = at_scale(1.0);
    first.candidate(&first.references())?;
    let unused = unused(case, &premises, &first)?.1;
    let observed = Observed::without(case.fitted, &premises.evaluator, &first, &unused);
    let search = Search::without_chance(&observed, &first);
    let (_, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    Ok(scale(&search, &about, at_scale).1)
}

/// How well moments predict the turning, and the channels that are not used.
fn unused(
    case: &Case<'_>,
    premises: &Premises,
    catalogue: &Catalogue,
) -> Result<([Turning; 3], Vec<usize>), DiagnoseError> {
    if premises.leg {
        return Ok(([Turning { is_usable: true, ..Turning::default() }; 3], Vec::new()));
    }
    let observed = Observed::new(case.fitted, &premises.evaluator, catalogue);
    let search = Search::without_chance(&observed, catalogue);
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    Ok(turning(&search, (&file, &about), premises.leg))
}

/// What the flights of a case say of every effect beside those that the type has. `chance`: what an
/// earlier survey of them found it to give, which no effect of the type changes.
///
/// # Errors
/// [`DiagnoseError`].
pub fn survey(
    case: &Case<'_>,
    settings: &Settings,
    beside: &Beside,
    chance: Option<&[f64]>,
) -> Result<Survey, DiagnoseError> {
    let premises = Premises::of(case);
    let catalogue = premises.catalogue(case, beside.scale);
    catalogue.candidate(&catalogue.references())?;
    let (turning, unused) = unused(case, &premises, &catalogue)?;
    let observed = Observed::without(case.fitted, &premises.evaluator, &catalogue, &unused);
    let search = Search::without_chance(&observed, &catalogue);
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    let chance = match chance {
        Some(known) => known.to_vec(),
        None => by_chance(&search, (&file, &about), &premises, settings)?,
    };
    let look = Look { search: &search, turning: &turning, leg: premises.leg, chance: &chance };
    let told = |base: Surveyed, beside: Vec<Surveyed>, file: Vec<OwnNumber>| Survey {
        base,
        beside,
        chance: chance.clone(),
        file,
        seconds: case.fitted.iter().map(|flight| flight.seconds()).sum(),
        voltage_differs: voltages_differ(case.fitted),
        outputs_logged: case
            .fitted
            .iter()
            .all(|flight| flight.channels.outputs || flight.channels.rotor_speed),
    };
    let keyed = |key: &String| {
        (0..catalogue.hypotheses.len())
            .find(|h| key_of(&catalogue, &catalogue.hypotheses[*h]) == *key)
    };
    let mut set = Vec::new();
    let mut from = Vec::new();
    for (key, values) in &beside.shared {
        // What this vehicle's logs cannot show, it takes no part in.
        let Some(hypothesis) = keyed(key) else { continue };
        set.push(hypothesis);
        from.extend(catalogue.hypotheses[hypothesis].numbers.iter().copied().zip(values.clone()));
    }
    if set.is_empty() {
        let base = Surveyed {
            keys: Vec::new(),
            numbers: Vec::new(),
            evidence: file.fit.evidence,
            mean: Vec::new(),
            covariance: Vec::new(),
        };
        let file = own_numbers(&catalogue, &file.fit.values, &[]);
        return Ok(told(base, look.beside(&about, &[], &[]), file));
    }
    let fit = search.fitted_from(&about, &set, &from).ok_or(DiagnoseError::Nothing)?;
    let about =
        Linearised::new(&observed, &fit.values, &search.numbers()).ok_or(DiagnoseError::Nothing)?;
    let active = fit.active(&catalogue);
    let values: Vec<(usize, f64)> = active.iter().map(|n| (*n, fit.values[*n])).collect();
    let base = look.surveyed(&set, fit.evidence, &fit.values, &fit.joint);
    let base = base.ok_or(DiagnoseError::Nothing)?;
    let file = own_numbers(&catalogue, &fit.values, &active);
    Ok(told(base, look.beside(&about, &set, &values), file))
}

/// Evidence that chance gives each hypothesis, nats.
fn by_chance(
    search: &Search<'_>,
    (file, about): (&Explanation, &Linearised),
    premises: &Premises,
    settings: &Settings,
) -> Result<Vec<f64>, DiagnoseError> {
    let draws = (settings.twins, settings.seed);
    let observed = search.fitted;
    if settings.twins == 0 {
        return Ok(vec![0.0; search.catalogue.hypotheses.len()]);
    }
    let twins = match premises.onboard() {
        Some(law) => {
            let noise = report_noise(observed.flights, &file.fit.power, observed.counts());
            TwinFits::of_null(observed, about, law, &noise, draws)?
        }
        None => TwinFits::of_noise(observed, &file.fit.power, draws),
    };
    if observed.is_stopped() {
        return Err(DiagnoseError::Stopped);
    }
    Ok(match premises.onboard() {
        Some(_) => screened(search, file, about, &twins, settings.seed).chance,
        None => {
            let about = about.resting_at(search.catalogue.expected());
            screened(search, file, &about, &twins, settings.seed).chance
        }
    })
}

fn own_numbers(catalogue: &Catalogue, values: &[f64], active: &[usize]) -> Vec<OwnNumber> {
    let nuisances = catalogue.nuisances().filter(|number| !active.contains(number));
    let own = nuisances.map(|number| {
        let of = &catalogue.numbers[number];
        OwnNumber {
            name: of.target.to_string(),
            tolerances: (values[number] - of.expected) / of.tolerance,
            value: values[number],
            expected: of.expected,
        }
    });
    own.collect()
}

/// How sets are looked at.
struct Look<'a> {
    search: &'a Search<'a>,
    turning: &'a [Turning; 3],
    leg: bool,
    chance: &'a [f64],
}

impl Look<'_> {
    /// The set with every hypothesis that can join it; `from` are the values of its numbers, which
    /// `about` has derivatives at.
    fn beside(&self, about: &Linearised, set: &[usize], from: &[(usize, f64)]) -> Vec<Surveyed> {
        let Search { catalogue, fitted: observed, .. } = *self.search;
        let counts = observed.counts();
        let active = |set: &[usize]| -> Vec<usize> {
            set.iter().flat_map(|h| catalogue.hypotheses[*h].numbers.iter().copied()).collect()
        };
        let Some(base) = about.solve(catalogue, counts, &active(set)) else { return Vec::new() };
        let joined = (0..catalogue.hypotheses.len()).into_par_iter();
        let joined = joined.filter(|h| self.search.joins(*h, set)).filter_map(|h| {
            let mut joint = set.to_vec();
            joint.push(h);
            let numbers = active(&joint);
            let solution = about.solve_from(catalogue, counts, &numbers, &base.values)?;
            let of_solution =
                || self.surveyed(&joint, solution.evidence, &solution.values, &solution.joint);
            // What the linearisation may not see at all is fitted as well.
            let is_blind = catalogue.hypotheses[h].starts.len() > 1;
            if solution.evidence - base.evidence < WORTH_A_FIT && !is_blind {
                return of_solution();
            }
            match self.search.fitted_from(about, &joint, from) {
                Some(fit) => self.surveyed(&joint, fit.evidence, &fit.values, &fit.joint),
                None => of_solution(),
            }
        });
        joined.collect()
    }

    fn surveyed(
        &self,
        set: &[usize],
        evidence: f64,
        values: &[f64],
        joint: &nalgebra::DMatrix<f64>,
    ) -> Option<Surveyed> {
        let catalogue = self.search.catalogue;
        let hypotheses = set.iter().map(|h| &catalogue.hypotheses[*h]);
        let indices: Vec<usize> =
            hypotheses.clone().flat_map(|h| h.numbers.iter().copied()).collect();
        // A number without a derivative is nothing that these flights could show.
        if joint.nrows() != indices.len() {
            return None;
        }
        let numbers: Vec<SurveyedNumber> = hypotheses
            .flat_map(|hypothesis| {
                hypothesis.numbers.iter().map(|index| {
                    let number = &catalogue.numbers[*index];
                    let slot = match number.target {
                        Target::Effect(_, slot) => slot,
                        Target::RotorScale(_) => 1,
                        _ => 0,
                    };
                    SurveyedNumber {
                        key: key_of(catalogue, hypothesis),
                        effect: hypothesis.effect.to_string(),
                        name: number.target.name(),
                        slot,
                        reference: number.reference,
                        magnitude: number.magnitude,
                        unremarkable: unremarkable(number, self.turning, self.leg),
                        bounds: number.bounds,
                        absent: number.target.absent(),
                    }
                })
            })
            .collect();
        let scaled = indices.iter().zip(&numbers);
        let mean = scaled.map(|(i, n)| (values[*i] - n.reference) / n.magnitude).collect();
        let size = indices.len();
        let covariance = (0..size * size)
            .map(|at| {
                let (a, b) = (at / size, at % size);
                joint[(a, b)] / (numbers[a].magnitude * numbers[b].magnitude)
            })
            .collect();
        let chance: f64 = set.iter().filter_map(|h| self.chance.get(*h)).sum();
        Some(Surveyed {
            keys: set.iter().map(|h| key_of(catalogue, &catalogue.hypotheses[*h])).collect(),
            numbers,
            evidence: evidence - chance,
            mean,
            covariance,
        })
    }
}
