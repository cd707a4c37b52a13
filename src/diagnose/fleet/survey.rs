//! Surveys one vehicle's flights: for each effect beside those of its type, the log evidence and a
//! normal likelihood of the effects' numbers.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::diagnose::catalogue::hypothesis::{Catalogue, Hypothesis};
use crate::diagnose::catalogue::number::Target;
use crate::diagnose::context::Preliminaries;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::report_noise;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::rotation_prediction::{RotationPrediction, rotation_predictions};
use crate::diagnose::search::scale::scale;
use crate::diagnose::search::twins::{Draws, TwinFits, screened};
use crate::diagnose::verdict::assessment::{unremarkable, voltages_differ};
use crate::diagnose::verdict::posterior::PRICE;

/// A number of a set of effects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurveyedNumber {
    /// Key of its hypothesis: the effect's id, and the rotor for rotor_loss.
    pub key: String,
    /// Its effect's id.
    pub effect: String,
    /// Its name within the effect.
    pub name: String,
    /// Index of the slot in the effect.
    pub slot: usize,
    /// The vehicle file's value.
    pub reference: f64,
    /// Its typical magnitude where the effect occurs.
    pub magnitude: f64,
    /// Standard deviation that the file's errors give it.
    pub unremarkable: f64,
    /// Its lowest and highest value.
    pub bounds: [f64; 2],
    /// Its value without the effect, where there is a single one.
    pub absent: Option<f64>,
}

/// A set of effects with the likelihood of its numbers, in magnitudes from the file's values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surveyed {
    /// Keys of its hypotheses.
    pub keys: Vec<String>,
    /// The numbers of all its hypotheses, in order.
    pub numbers: Vec<SurveyedNumber>,
    /// Log evidence under a normal prior of one magnitude about the file, nats.
    pub evidence: f64,
    /// Mean of the numbers under that prior.
    pub mean: Vec<f64>,
    /// Covariance under that prior, row by row.
    pub covariance: Vec<f64>,
}

/// A number of the vehicle file, fitted to a vehicle's flights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnNumber {
    /// Its name, after its effect's id where it belongs to one.
    pub name: String,
    /// Its distance from the expected value, in tolerances.
    pub tolerances: f64,
    /// The fitted value.
    pub value: f64,
    /// The file's value, or the one that the logs show directly.
    pub expected: f64,
}

/// Everything about a vehicle's flights that the fleet's decision needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// The effects that every set has.
    pub base: Surveyed,
    /// The base with one more effect each.
    pub beside: Vec<Surveyed>,
    /// Evidence that chance gives each hypothesis of the vehicle's catalogue without any effect,
    /// nats.
    pub chance: Vec<f64>,
    /// The vehicle file's numbers, fitted with the base.
    pub file: Vec<OwnNumber>,
    /// Airborne time, s.
    pub seconds: f64,
    /// Whether the pack's voltage varies enough to distinguish a sag from another level of the
    /// thrust.
    pub voltage_differs: bool,
    /// Whether motor outputs or rotor speeds are logged.
    pub outputs_logged: bool,
}

/// The fleet's state that a survey builds on.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Scale of the tolerances that the vehicle file does not state.
    pub scale: f64,
    /// Keys of the type's effects, with the values of their numbers.
    pub shared: Vec<(String, Vec<f64>)>,
}

/// Least gain of evidence that justifies a fit, nats: the price of an effect.
const FIT_GAIN_MIN: f64 = PRICE;

/// The key of a hypothesis over all vehicles: the effect's id, and the rotor for rotor_loss.
pub fn key_of(catalogue: &Catalogue, hypothesis: &Hypothesis) -> String {
    let first = hypothesis.numbers.first().map(|number| catalogue.numbers[*number].target);
    match first {
        Some(Target::RotorScale(rotor)) => format!("{} {rotor}", hypothesis.effect),
        _ => hypothesis.effect.to_string(),
    }
}

/// Each scale that was tried for the tolerances that the vehicle file does not state, with its log
/// evidence.
///
/// # Errors
/// As [`survey`].
pub fn scales(input: &DiagnosisInput<'_>) -> Result<Vec<[f64; 2]>, DiagnoseError> {
    let preliminaries = Preliminaries::of(input);
    let at_scale = |scale: f64| preliminaries.catalogue(input, scale);
    let first = at_scale(1.0);
    first.candidate(&first.references())?;
    let unused = unusable_channels(input, &preliminaries, &first)?.1;
    let observed = Observed::without(input.fitted, &preliminaries.evaluator, &first, &unused);
    let search = Search::without_chance(&observed, &first);
    let (_, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    Ok(scale(&search, &about, at_scale).1)
}

/// How well moments predict the body's rotation, and the channels that are unusable.
fn unusable_channels(
    input: &DiagnosisInput<'_>,
    preliminaries: &Preliminaries,
    catalogue: &Catalogue,
) -> Result<([RotationPrediction; 3], Vec<usize>), DiagnoseError> {
    if preliminaries.is_loop_known {
        return Ok((
            [RotationPrediction { is_usable: true, ..RotationPrediction::default() }; 3],
            Vec::new(),
        ));
    }
    let observed = Observed::new(input.fitted, &preliminaries.evaluator, catalogue);
    let search = Search::without_chance(&observed, catalogue);
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    Ok(rotation_predictions(&search, &file, &about, preliminaries.is_loop_known))
}

/// Surveys the input's flights for every effect beside the type's. `chance` is the result of an
/// earlier survey, which the effects of the type do not change.
///
/// # Errors
/// [`DiagnoseError`].
pub fn survey(
    input: &DiagnosisInput<'_>,
    settings: &Settings,
    beside: &Beside,
    chance: Option<&[f64]>,
) -> Result<Survey, DiagnoseError> {
    let preliminaries = Preliminaries::of(input);
    let catalogue = preliminaries.catalogue(input, beside.scale);
    catalogue.candidate(&catalogue.references())?;
    let (turning, unused) = unusable_channels(input, &preliminaries, &catalogue)?;
    let observed = Observed::without(input.fitted, &preliminaries.evaluator, &catalogue, &unused);
    let search = Search::without_chance(&observed, &catalogue);
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    let chance = match chance {
        Some(known) => known.to_vec(),
        None => chance_evidence(&search, &file, &about, &preliminaries, settings)?,
    };
    let fits = SetFits {
        search: &search,
        turning: &turning,
        is_loop_known: preliminaries.is_loop_known,
        chance: &chance,
    };
    let survey_of = |base: Surveyed, beside: Vec<Surveyed>, file: Vec<OwnNumber>| Survey {
        base,
        beside,
        chance: chance.clone(),
        file,
        seconds: input.fitted.iter().map(|flight| flight.seconds()).sum(),
        voltage_differs: voltages_differ(input.fitted),
        outputs_logged: input.fitted.iter().all(|flight| flight.channels.shows_rotors()),
    };
    let keyed = |key: &String| {
        (0..catalogue.hypotheses.len())
            .find(|h| key_of(&catalogue, &catalogue.hypotheses[*h]) == *key)
    };
    let mut set = Vec::new();
    let mut from = Vec::new();
    for (key, values) in &beside.shared {
        // An effect that this vehicle's logs cannot show is left out.
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
        return Ok(survey_of(base, fits.beside(&about, &[], &[]), file));
    }
    let fit = search.fitted_from(&about, &set, &from).ok_or(DiagnoseError::Nothing)?;
    let about =
        Linearised::new(&observed, &fit.values, &search.numbers()).ok_or(DiagnoseError::Nothing)?;
    let active = fit.active(&catalogue);
    let values: Vec<(usize, f64)> = active.iter().map(|n| (*n, fit.values[*n])).collect();
    let base = fits.surveyed(&set, fit.evidence, &fit.values, &fit.joint);
    let base = base.ok_or(DiagnoseError::Nothing)?;
    let file = own_numbers(&catalogue, &fit.values, &active);
    Ok(survey_of(base, fits.beside(&about, &set, &values), file))
}

/// Evidence that chance gives each hypothesis, nats.
fn chance_evidence(
    search: &Search<'_>,
    file: &Explanation,
    about: &Linearised,
    preliminaries: &Preliminaries,
    settings: &Settings,
) -> Result<Vec<f64>, DiagnoseError> {
    let draws = Draws { count: settings.twins, seed: settings.seed };
    let observed = search.fitted;
    if settings.twins == 0 {
        return Ok(vec![0.0; search.catalogue.hypotheses.len()]);
    }
    let twins = match preliminaries.onboard() {
        Some(law) => {
            let noise = report_noise(observed.flights, &file.fit.power, observed.counts());
            TwinFits::of_null(observed, about, law, &noise, draws)?
        }
        None => TwinFits::of_noise(observed, &file.fit.power, draws),
    };
    if observed.is_stopped() {
        return Err(DiagnoseError::Stopped);
    }
    Ok(match preliminaries.onboard() {
        Some(_) => screened(search, file, about, &twins, settings.seed).chance,
        None => {
            let about = about.moved_to(search.catalogue.expected());
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

/// The context of the fits of sets.
struct SetFits<'a> {
    search: &'a Search<'a>,
    turning: &'a [RotationPrediction; 3],
    is_loop_known: bool,
    chance: &'a [f64],
}

impl SetFits<'_> {
    /// Surveys `set` with each hypothesis that can join it. `from` holds the values of its numbers,
    /// at which `about` has derivatives.
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
            // A hypothesis with several starts is always fitted: the linearisation may miss it.
            let is_blind = catalogue.hypotheses[h].starts.len() > 1;
            if solution.evidence - base.evidence < FIT_GAIN_MIN && !is_blind {
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
        // These flights cannot show a number without a derivative.
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
                        unremarkable: unremarkable(number, self.turning, self.is_loop_known),
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
