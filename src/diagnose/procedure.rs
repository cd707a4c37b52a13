//! From flights to an answer.

use std::collections::BTreeMap;

use sitl::effects::{EffectId, EffectSet};
use sitl::vehicle::{VehicleError, VehicleParams};

use super::answer::{
    Answer, EffectAnswer, FlightAnswer, Gap, HypothesisAnswer, NotTestable, Verdict, parameters,
};
use super::fit::Observed;
use super::gap::{ReportNoise, Simulator};
use super::hypothesis::{Catalogue, Target};
use super::leftover::{UnmodelledForce, unmodelled_force};
use super::map::map;
use super::noise::report_noise;
use super::preparation::PreparedFlight;
use super::residuals::{Evaluator, VELOCITY};
use super::selection::{Rival, Scored, Selection, Selector, Thresholds};
use super::spectrum::{BANDS, CELL_S};
use super::twins::twins;
use super::words::finding;

/// Least gain of evidence that is asked of an effect, whatever the twins say: posterior odds of
/// twenty thousand to one, for a model that is never quite right, nats.
const EVIDENCE_MIN: f64 = 10.0;
/// Differences of scores count by this share: channels share noise that the scores take to be
/// independent.
const TEMPER: f64 = 0.25;
/// No flight makes anything more certain than this: the catalogue itself may be wrong.
const CERTAIN: f64 = 0.995;
/// Least probability of an effect that the answer mentions.
const MENTIONED: f64 = 0.01;
/// Least probability of a rival that cannot be told apart.
const AMBIGUOUS: f64 = 0.1;
/// What changes the level of the thrust: only the pack's voltage tells them apart.
const THRUST_LEVEL: [EffectId; 3] =
    [EffectId::BatterySag, EffectId::ThrustCurve, EffectId::ThrustScale];
/// Quantile of the normal distribution for 90 % intervals.
const Z90: f64 = 1.645;

/// What is to be diagnosed.
#[derive(Debug)]
pub struct Case<'a> {
    /// The simulator's vehicle.
    pub vehicle: &'a VehicleParams,
    /// Flights to fit.
    pub fitted: &'a [PreparedFlight],
    /// Flights held out.
    pub held_out: &'a [PreparedFlight],
    /// Whether these are parts of one flight.
    pub blocked: bool,
}

/// How.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Seed of every draw.
    pub seed: u64,
    /// Number of twins.
    pub twins: u32,
}

/// An answer and what follows from it.
#[derive(Debug)]
pub struct Diagnosis {
    /// The answer.
    pub answer: Answer,
    /// The named effects with the vehicle's true values.
    pub effects: EffectSet,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The vehicle is refused.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// Nothing can be fitted.
    #[error("the flights hold nothing that a model could be compared with")]
    Nothing,
}

/// Diagnoses; `progress` is told what is being done.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose(
    case: &Case<'_>,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let leg = case.fitted.iter().chain(case.held_out).all(|flight| flight.channels.setpoint);
    let catalogue = Catalogue::new(case.vehicle, leg);
    catalogue.candidate(&catalogue.references())?;
    let evaluator = Evaluator::new(case.vehicle);
    let fitted = Observed::new(case.fitted, &evaluator, &catalogue);
    let held_out = Observed::new(case.held_out, &evaluator, &catalogue);
    let mut selector = Selector {
        fitted: &fitted,
        held_out: &held_out,
        catalogue: &catalogue,
        setpoint_leg: leg,
        thresholds: Thresholds { evidence: EVIDENCE_MIN, held_out: 1.0, open_loop: [0.05, 2.5] },
        floor: None,
    };
    progress("what nuisances explain");
    let (null, about) = selector.null().ok_or(DiagnoseError::Nothing)?;
    let twins = (settings.twins > 0).then(|| {
        progress("twins without an effect");
        twins(&selector, &null, &about, settings.twins, settings.seed)
    });
    if let Some(twins) = &twins {
        selector.thresholds.evidence = twins.threshold.max(EVIDENCE_MIN);
    }
    let noise = report_noise(case.fitted, &null.fit, fitted.counts());
    selector.floor = Simulator::new(case.vehicle, &EffectSet::new(), leg)?.guided().floor(
        case.fitted,
        &noise,
        settings.seed,
    );
    progress("which effect");
    let selection = selector.select(null, &about).ok_or(DiagnoseError::Nothing)?;

    progress("where");
    let map = {
        let references = catalogue.references();
        let shipped = catalogue.candidate(&references)?;
        let residuals = fitted.residuals(&references).ok_or(DiagnoseError::Nothing)?;
        let power = fitted.power(&residuals);
        map(&fitted, &evaluator, &shipped, &power, &selection.best.fit.power)
    };

    progress("what is left over");
    let force_of = |scored: &Scored| -> Option<UnmodelledForce> {
        let candidate = catalogue.candidate(&scored.fit.values).ok()?;
        unmodelled_force(&fitted, &evaluator, &candidate)
    };
    let unmodelled = force_of(&selection.null).zip(force_of(&selection.best)).map(|(a, b)| [a, b]);

    progress("how far");
    let named: Vec<EffectId> =
        selection.best.fit.hypotheses.iter().map(|h| catalogue.hypotheses[*h].effect).collect();
    let effects = catalogue.effects(&selection.best.fit.values, Some(&named));
    let gap = gap(case, &catalogue, &selection, &fitted, &effects, leg, settings)?;

    let verdict = verdict(
        &selection,
        unmodelled.as_ref(),
        explained(&selection, fitted.counts()),
        &noise,
        case.vehicle.gravity,
    );
    let (effects_answer, ambiguous_with) = if verdict == Verdict::Effect {
        let (effects, mut ambiguous) = named_effects(&catalogue, &selection);
        let voltage = case.fitted.iter().all(|flight| flight.channels.voltage);
        if !voltage && named.iter().any(|effect| THRUST_LEVEL.contains(effect)) {
            let others = THRUST_LEVEL.iter().filter(|effect| !named.contains(effect));
            ambiguous.extend(others.map(|effect| effect.name()));
        }
        ambiguous.extend(as_good(&catalogue, &selection));
        ambiguous.sort_unstable();
        ambiguous.dedup();
        (effects, ambiguous)
    } else {
        (Vec::new(), Vec::new())
    };
    let mut answer = Answer {
        verdict,
        finding: String::new(),
        map,
        twins,
        evidence_asked: selector.thresholds.evidence,
        effects: effects_answer,
        gap,
        ambiguous_with,
        not_testable: not_testable(&catalogue, &selection, leg),
        unmodelled_force: unmodelled,
        hypotheses: selection
            .singles
            .iter()
            .map(|rival| {
                let (gain, error) = rival.scored.gain_over(&selection.null);
                let hypothesis = &catalogue.hypotheses[rival.hypothesis];
                HypothesisAnswer {
                    id: hypothesis.effect.name(),
                    evidence: rival.scored.fit.evidence - selection.null.fit.evidence,
                    held_out: [gain, error],
                    numbers: hypothesis
                        .numbers
                        .iter()
                        .map(|n| rival.scored.fit.values[*n])
                        .collect(),
                }
            })
            .collect(),
        flights: [(case.fitted, false), (case.held_out, true)]
            .into_iter()
            .flat_map(|(flights, held_out)| {
                flights.iter().map(move |flight| FlightAnswer {
                    name: flight.name.clone(),
                    held_out,
                    seconds: flight.seconds(),
                    channels: flight.channels,
                })
            })
            .collect(),
    };
    answer.finding = finding(&answer);
    let effects = if verdict == Verdict::Effect { effects } else { EffectSet::new() };
    Ok(Diagnosis { answer, effects })
}

/// Time over which an unmodelled force is compared with the velocity's noise, s.
const FORCE_TIME_S: f64 = 0.5;
/// A smaller force matters to nobody, in units of the weight.
const FORCE_MIN_WEIGHTS: f64 = 0.01;
/// Standard errors by which an unmodelled force must stand out.
const FORCE_SIGNIFICANCE: f64 = 5.0;
/// Share of the unmodelled power that a set of effects may leave and still be the explanation.
const LEFT_MAX: f64 = 0.3;

/// An effect was found if it leaves no force of practical size, or little of what there was: a
/// force is of practical size where within half a second it moves the velocity by more than the
/// reports of start and end are uncertain.
fn verdict(
    selection: &Selection,
    unmodelled: Option<&[UnmodelledForce; 2]>,
    explained: f64,
    noise: &ReportNoise,
    gravity: f64,
) -> Verdict {
    let found = !selection.best.fit.hypotheses.is_empty();
    let least = (6.0_f64.sqrt() * noise.velocity / FORCE_TIME_S).max(FORCE_MIN_WEIGHTS * gravity);
    let left = unmodelled.is_some_and(|[_, after]| {
        after.rms() > least
            && after.significance() > FORCE_SIGNIFICANCE
            && (!found || after.total() > LEFT_MAX * (after.total() + explained))
    });
    match (left, found) {
        (true, _) => Verdict::Unknown,
        (false, true) => Verdict::Effect,
        (false, false) => Verdict::None,
    }
}

/// Mean square of the acceleration that the chosen effects explain and the nuisances do not,
/// m^2/s^4.
fn explained(selection: &Selection, counts: &[f64]) -> f64 {
    let (null, best) = (selection.null.fit.noise(counts), selection.best.fit.noise(counts));
    let mut sum = 0.0;
    for axis in VELOCITY..VELOCITY + 3 {
        for band in 0..BANDS.len() {
            let place = axis * BANDS.len() + band;
            let lower = if band == 0 { 0.0 } else { BANDS[band - 1] };
            sum += (null[place] - best[place]) * 2.0 * CELL_S * (BANDS[band] - lower);
        }
    }
    sum.max(0.0)
}

fn gap(
    case: &Case<'_>,
    catalogue: &Catalogue,
    selection: &Selection,
    fitted: &Observed<'_>,
    effects: &EffectSet,
    leg: bool,
    settings: &Settings,
) -> Result<Option<Gap>, DiagnoseError> {
    let noise = report_noise(case.fitted, &selection.best.fit, fitted.counts());
    let shipped = Simulator::new(case.vehicle, &EffectSet::new(), leg)?;
    let repaired = Simulator::new(case.vehicle, effects, leg)?;
    let nuisances =
        Simulator::new(case.vehicle, &catalogue.effects(&selection.null.fit.values, None), leg)?;
    let floor = repaired.floor(case.held_out, &noise, settings.seed);
    let (Some(floor), Some(before), Some(after)) =
        (floor, shipped.errors(case.held_out), repaired.errors(case.held_out))
    else {
        return Ok(None);
    };
    let [b, a, f] = [before, after, floor].map(|errors| errors.mean_over(&floor));
    Ok(Some(Gap {
        metric: "mean",
        before: b,
        after: a,
        floor: f,
        closure: (b - f > 0.05).then(|| (b - a) / (b - f)),
        nuisances_only: nuisances.errors(case.held_out).map(|errors| errors.mean_over(&floor)),
        errors: [before, after, floor],
        noise,
    }))
}

/// The effects of the chosen set and their rivals, with probabilities, and those that cannot be
/// told apart.
fn named_effects(
    catalogue: &Catalogue,
    selection: &Selection,
) -> (Vec<EffectAnswer>, Vec<&'static str>) {
    let mut found: BTreeMap<EffectId, (f64, Scored)> = BTreeMap::new();
    // How much the set would lose without an effect.
    let mut losses: BTreeMap<&str, f64> = BTreeMap::new();
    let mut ambiguous = Vec::new();
    for (place, (without, rivals)) in selection.places.iter().enumerate() {
        let own = selection.best.fit.hypotheses[place];
        let loss = selection.best.score() - without.score();
        losses.insert(catalogue.hypotheses[own].effect.name(), loss);
        let mut options: Vec<(Option<usize>, Scored)> = vec![(None, without.clone())];
        options.extend(
            rivals
                .iter()
                .filter(|rival| rival.hypothesis != own)
                .map(|Rival { hypothesis, scored }| (Some(*hypothesis), scored.clone())),
        );
        options.push((Some(own), selection.best.clone()));
        let top = options.iter().map(|(_, s)| s.score()).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> =
            options.iter().map(|(_, s)| (TEMPER * (s.score() - top)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        for ((hypothesis, scored), weight) in options.into_iter().zip(weights) {
            let Some(hypothesis) = hypothesis else { continue };
            let effect = catalogue.hypotheses[hypothesis].effect;
            let probability = CERTAIN * weight / sum;
            let own_effect = effect == catalogue.hypotheses[own].effect;
            if probability > AMBIGUOUS && !own_effect {
                ambiguous.push(effect.name());
            }
            let entry = found.entry(effect).or_insert((0.0, scored.clone()));
            entry.0 = (entry.0 + probability).min(1.0);
            if hypothesis == own || scored.score() > entry.1.score() {
                entry.1 = scored;
            }
        }
    }
    let mut answers: Vec<EffectAnswer> = found
        .into_iter()
        .filter(|(_, (probability, _))| *probability > MENTIONED)
        .map(|(effect, (probability, scored))| {
            let set = catalogue.effects(&scored.fit.values, Some(&[effect]));
            EffectAnswer {
                id: effect.name(),
                probability,
                parameters: parameters(&set, effect),
                intervals: intervals(catalogue, &scored, effect),
            }
        })
        .collect();
    let loss = |answer: &EffectAnswer| losses.get(answer.id).copied().unwrap_or(0.0);
    answers.sort_by(|a, b| {
        let certain = |answer: &EffectAnswer| answer.probability.min(CERTAIN);
        certain(b).total_cmp(&certain(a)).then(loss(b).total_cmp(&loss(a))).then(a.id.cmp(b.id))
    });
    (answers, ambiguous)
}

/// Share of the evidence of the best single effect with which another explains as much: on real
/// flights no model is exact, and nats beyond that are of other things.
const AS_GOOD: f64 = 0.85;

/// Effects that by themselves explain about as much as the one that is named alone.
fn as_good(catalogue: &Catalogue, selection: &Selection) -> Vec<&'static str> {
    let class = |h: usize| match catalogue.hypotheses[h].effect {
        EffectId::Mass => EffectId::ThrustScale,
        effect => effect,
    };
    let evidence = |rival: &Rival| rival.scored.fit.evidence - selection.null.fit.evidence;
    let named: Vec<EffectId> = selection.best.fit.hypotheses.iter().map(|h| class(*h)).collect();
    let own = selection.singles.iter().filter(|rival| named.contains(&class(rival.hypothesis)));
    let most = own.map(evidence).fold(0.0, f64::max);
    selection
        .singles
        .iter()
        .filter(|rival| !named.contains(&class(rival.hypothesis)))
        .filter(|rival| most > 0.0 && evidence(rival) > AS_GOOD * most)
        .map(|rival| catalogue.hypotheses[rival.hypothesis].effect.name())
        .collect()
}

/// 90 % intervals of an effect's fitted numbers.
fn intervals(
    catalogue: &Catalogue,
    scored: &Scored,
    effect: EffectId,
) -> BTreeMap<String, [f64; 2]> {
    let mut intervals = BTreeMap::new();
    for hypothesis in &scored.fit.hypotheses {
        let hypothesis = &catalogue.hypotheses[*hypothesis];
        if hypothesis.effect != effect {
            continue;
        }
        for number in &hypothesis.numbers {
            let name = match catalogue.numbers[*number].target {
                Target::Effect(id, slot) => {
                    let Some(slot) = id.spec().slots().find(|s| s.index == slot) else { continue };
                    match slot.parameter.kind.slots() {
                        1 => slot.parameter.name.to_owned(),
                        _ => format!("{}[{}]", slot.parameter.name, slot.component),
                    }
                }
                Target::RotorScale(_) => "scale".to_owned(),
                Target::OutputDelay => "delay_s".to_owned(),
                Target::RotorGain(_) | Target::Damping(_) => continue,
            };
            let (value, deviation) = (scored.fit.values[*number], scored.fit.deviation[*number]);
            intervals.insert(name, [value - Z90 * deviation, value + Z90 * deviation]);
        }
    }
    intervals
}

/// Share of its prior's width that a number must be known to for its effect to be testable.
const TESTABLE: f64 = 0.5;

fn not_testable(catalogue: &Catalogue, selection: &Selection, leg: bool) -> Vec<NotTestable> {
    let mut found = Vec::new();
    for effect in EffectId::ALL {
        let reason = if effect == EffectId::PdGain && !leg {
            Some("setpoints or the on-board law's gains are not known".to_owned())
        } else if effect == EffectId::RotorGyroscopic && catalogue.vehicle.rotor_max_rpm.is_none() {
            Some("the vehicle file has no rotor_max_rpm".to_owned())
        } else {
            let tried: Vec<&Rival> = selection
                .singles
                .iter()
                .filter(|rival| catalogue.hypotheses[rival.hypothesis].effect == effect)
                .collect();
            let seen = tried.iter().any(|rival| {
                catalogue.hypotheses[rival.hypothesis].numbers.iter().any(|number| {
                    rival.scored.fit.deviation[*number]
                        < TESTABLE * catalogue.numbers[*number].magnitude
                })
            });
            (!tried.is_empty() && !seen)
                .then(|| "the motion and the channels of these logs do not show it".to_owned())
        };
        if let Some(reason) = reason {
            found.push(NotTestable { id: effect.name(), reason });
        }
    }
    found
}
