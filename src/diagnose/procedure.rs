//! From flights to an answer.

use std::collections::BTreeMap;

use sitl::effects::{EffectId, EffectSet};
use sitl::vehicle::{VehicleError, VehicleParams};

use super::answer::{
    Answer, EffectAnswer, FlightAnswer, Gap, HypothesisAnswer, Verdict, parameters,
};
use super::gap::{ReportNoise, Simulator};
use super::hypothesis::Catalogue;
use super::leftover::{UnmodelledForce, unmodelled_force};
use super::map::{map, samples};
use super::naming::{as_good, named_effects, not_testable};
use super::noise::report_noise;
use super::observed::Observed;
use super::preparation::PreparedFlight;
use super::residuals::{Evaluator, VELOCITY};
use super::selection::{Scored, Selection, Selector, Thresholds};
use super::spectrum::{BANDS, CELL_S};
use super::turbulence::gusts;
use super::twins::twins;
use super::words::finding;

/// Least gain of evidence that is asked of an effect, whatever the twins say: posterior odds of
/// twenty thousand to one, for a model that is never quite right, nats.
const EVIDENCE_MIN: f64 = 10.0;
/// What changes the level of the thrust: only the pack's voltage tells them apart.
const THRUST_LEVEL: [EffectId; 3] =
    [EffectId::BatterySag, EffectId::ThrustCurve, EffectId::ThrustScale];

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
    /// Effects that are not to be considered.
    pub without: &'a [EffectId],
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
    let catalogue = Catalogue::new(case.vehicle, leg).without(case.without);
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

    let left = unmodelled
        .as_ref()
        .filter(|[_, after]| is_of_practical_size(after, &noise, case.vehicle.gravity));
    let gusts_considered = !case.without.contains(&EffectId::Gusts);
    let turbulence = left.filter(|_| gusts_considered).and_then(|[_, after]| {
        let candidate = catalogue.candidate(&selection.best.fit.values).ok()?;
        gusts(case.vehicle, &effects, after, &samples(&fitted, &evaluator, &candidate))
    });
    let explained = explained(&selection, fitted.counts());
    let found = !named.is_empty();
    let verdict = match left {
        _ if turbulence.is_some() => Verdict::Effect,
        Some([_, after]) if !found || after.total() > LEFT_MAX * (after.total() + explained) => {
            Verdict::Unknown
        }
        _ if found => Verdict::Effect,
        _ => Verdict::None,
    };
    let mut effects = effects;
    let (effects_answer, ambiguous_with) = if verdict == Verdict::Effect {
        let (mut answers, mut ambiguous) = named_effects(&catalogue, &selection);
        if let Some(slots) = turbulence {
            let _ = effects.insert(EffectId::Gusts, slots);
            let parameters = parameters(&effects, EffectId::Gusts);
            let intervals = BTreeMap::new();
            let (id, probability) = (EffectId::Gusts.name(), GUSTS_PROBABILITY);
            answers.push(EffectAnswer { id, probability, parameters, intervals });
        }
        let voltage = case.fitted.iter().all(|flight| flight.channels.voltage);
        if !voltage && named.iter().any(|effect| THRUST_LEVEL.contains(effect)) {
            let others = THRUST_LEVEL.iter().filter(|effect| !named.contains(effect));
            let others = others.filter(|effect| catalogue.considers(**effect));
            ambiguous.extend(others.map(|effect| effect.name()));
        }
        ambiguous.extend(as_good(&catalogue, &selection));
        ambiguous.sort_unstable();
        ambiguous.dedup();
        (answers, ambiguous)
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
/// Probability of gusts where what is left looks like turbulence: other forces may.
const GUSTS_PROBABILITY: f64 = 0.8;
/// Share of the unmodelled power that a set of effects may leave and still be the explanation.
const LEFT_MAX: f64 = 0.3;

/// Whether an unmodelled force is more than noise and large enough to matter: within half a second
/// it moves the velocity by more than the reports of start and end are uncertain.
fn is_of_practical_size(force: &UnmodelledForce, noise: &ReportNoise, gravity: f64) -> bool {
    let least = (6.0_f64.sqrt() * noise.velocity / FORCE_TIME_S).max(FORCE_MIN_WEIGHTS * gravity);
    force.rms() > least && force.significance() > FORCE_SIGNIFICANCE
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
