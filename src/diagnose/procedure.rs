//! From flights to an answer.

use std::collections::BTreeMap;

use sitl::effects::{EffectId, EffectSet};
use sitl::vehicle::{VehicleError, VehicleParams};

use super::answer::{
    Answer, EffectAnswer, Finding, FlightAnswer, FullVerdict, Gap, HypothesisAnswer, Verdict,
    parameters,
};
use super::arrival::Delay;
use super::gap::{ReportNoise, Simulator};
use super::hypothesis::Catalogue;
use super::judgement::{Leftover, explained, is_open, is_unexplained};
use super::leftover::{UnmodelledForce, unmodelled_force, unmodelled_moment};
use super::linearised::Linearised;
use super::map::{depends_on, map, samples};
use super::naming::{as_good, named_effects, not_testable};
use super::next_flight::{Live, live, untested};
use super::noise::report_noise;
use super::observed::Observed;
use super::preparation::PreparedFlight;
use super::reflight::reflight;
use super::residuals::Evaluator;
use super::selection::{Scored, Selection, Selector, Thresholds};
use super::turbulence::gusts;
use super::twins::{TwinFits, screened};
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
    /// Explanations that are left open, and effects that these logs cannot show: what a next flight
    /// is for.
    pub open: [Vec<Live>; 2],
    /// Whether the leg from setpoints to outputs was looked at.
    pub setpoint_leg: bool,
    /// Noise of the reports.
    pub noise: ReportNoise,
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
/// The vehicle file's numbers are taken to be as good as a careful builder makes them. Where quiet
/// sensors show that even so the simulator predicts visibly worse than it could, the flights are
/// looked at again with a file that is taken at its word.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose(
    case: &Case<'_>,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let tolerant = attempt(case, settings, 1.0, progress)?;
    let open = |diagnosis: &Diagnosis| diagnosis.answer.gap.as_ref().map(Gap::most_visible);
    let Some(left) = open(&tolerant).filter(|left| tolerant.setpoint_leg && *left > VISIBLE) else {
        return Ok(tolerant);
    };
    progress("again, with the vehicle file at its word");
    let strict = attempt(case, settings, STRICT, progress)?;
    let closes = open(&strict).is_some_and(|strictly| strictly - 1.0 < CLOSES * (left - 1.0));
    let names = strict.answer.verdict == Verdict::Effect;
    Ok(if names && closes { strict } else { tolerant })
}

/// One diagnosis, with the tolerances of the vehicle file's numbers times `tolerance`.
fn attempt(
    case: &Case<'_>,
    settings: &Settings,
    tolerance: f64,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let leg = case.fitted.iter().chain(case.held_out).all(|flight| flight.channels.setpoint);
    let mut catalogue = Catalogue::new(case.vehicle, leg).without(case.without).taken_at(tolerance);
    catalogue.candidate(&catalogue.references())?;
    let evaluator = Evaluator::new(case.vehicle).observing(case.fitted);
    let onboard = evaluator.onboard().filter(|_| leg);
    let arrival = onboard.and_then(|law| Delay::of(case.fitted, law));
    if let Some(Delay { mean, .. }) = arrival {
        catalogue = catalogue.with_delay(mean);
    }
    let fitted = Observed::new(case.fitted, &evaluator, &catalogue);
    let held_out = Observed::new(case.held_out, &evaluator, &catalogue);
    let mut selector = Selector {
        fitted: &fitted,
        held_out: &held_out,
        catalogue: &catalogue,
        setpoint_leg: leg,
        thresholds: Thresholds {
            evidence: EVIDENCE_MIN,
            chance: Vec::new(),
            held_out: 1.0,
            open_loop: [0.05, 2.5],
        },
        floor: None,
    };
    progress("what nuisances explain");
    let (null, about) = selector.null().ok_or(DiagnoseError::Nothing)?;
    let noise = report_noise(case.fitted, &null.fit.power, fitted.counts());
    let (mut twins, mut twins_of_null) = (None, None);
    if settings.twins > 0 {
        progress("twins without an effect");
        let draws = (settings.twins, settings.seed);
        let (drawn, about) = if leg {
            (TwinFits::draw(&fitted, &about, &[], &noise, leg, draws)?, about.clone())
        } else {
            let drawn = TwinFits::of_noise(&fitted, &null.fit.power, draws);
            (drawn, about.resting_at(catalogue.references()))
        };
        let screened = screened(&selector, &null, &about, &drawn, settings.seed);
        selector.thresholds.evidence = screened.threshold.max(EVIDENCE_MIN);
        selector.thresholds.chance.clone_from(&screened.chance);
        twins = Some(screened);
        twins_of_null = Some(drawn);
    }
    selector.floor = Simulator::new(case.vehicle, &EffectSet::new(), leg)?.guided().floor(
        case.fitted,
        &noise,
        settings.seed,
    );
    progress("which effect");
    let mut selection = selector.select(null, &about).ok_or(DiagnoseError::Nothing)?;

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
    let is_null = selection.best.fit.hypotheses.is_empty();
    let of_best = twins_of_null.as_ref().filter(|_| leg && !is_null);
    let of_best = of_best.and_then(|_| {
        let draws = (TWINS_OF_BEST.min(settings.twins), settings.seed);
        twins_of(&fitted, &catalogue, &selection.best, &noise, leg, draws)
    });
    if let Some(twins) = &of_best {
        correct(&mut selection.best, &catalogue, twins);
    }
    if let Some((number, delay)) = catalogue.number_of(EffectId::CommandDelay, 0).zip(arrival) {
        let best = &mut selection.best.fit;
        if best.active(&catalogue).contains(&number) {
            (best.values[number], best.deviation[number]) = (delay.mean, delay.deviation);
        }
    }
    let moment = twins_of_null.as_ref().filter(|_| leg).and_then(|of_null| {
        let before = unmodelled_moment(&fitted, &selection.null.fit.power, of_null)?;
        let of_best = of_best.as_ref().unwrap_or(of_null);
        let after = unmodelled_moment(&fitted, &selection.best.fit.power, of_best)?;
        Some([before, after])
    });
    let force = force_of(&selection.null).zip(force_of(&selection.best)).map(|(a, b)| [a, b]);
    let leftover = Leftover { force, moment };

    progress("how far");
    let named: Vec<EffectId> =
        selection.best.fit.hypotheses.iter().map(|h| catalogue.hypotheses[*h].effect).collect();
    let effects = catalogue.effects(&selection.best.fit.values, Some(&named));
    let gap = gap(case, &catalogue, &selection, &fitted, &effects, leg, settings)?;

    let (force, moment) = explained(&selection, &fitted);
    let sizes = [
        leftover.force_size(case.vehicle, &noise, force),
        leftover.moment_size(case.vehicle, &noise, moment),
    ];
    let found = !named.is_empty();
    let considered = !case.without.contains(&EffectId::Gusts);
    let turbulence =
        leftover.force.as_ref().filter(|_| considered && sizes[0].left > 1.0).and_then(
            |[_, after]| {
                let candidate = catalogue.candidate(&selection.best.fit.values).ok()?;
                gusts(case.vehicle, &effects, after, &samples(&fitted, &evaluator, &candidate))
            },
        );
    let verdict = match turbulence {
        Some(_) => Verdict::Effect,
        None if is_unexplained(sizes, found) => Verdict::Unknown,
        // Driven by outputs, an open loop strays from any cause.
        None if leg && gap.as_ref().is_some_and(|gap| is_open(gap, found)) => Verdict::Unknown,
        None if found => Verdict::Effect,
        None => Verdict::None,
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
        // The first is the answer; the others are what it cannot be told from.
        let first = answers.first().map(|answer| answer.id);
        ambiguous.retain(|id| Some(*id) != first);
        (answers, ambiguous)
    } else {
        (Vec::new(), Vec::new())
    };
    let (full, depends_on) = match verdict {
        Verdict::None => (FullVerdict::None, Vec::new()),
        Verdict::Effect if ambiguous_with.is_empty() => (FullVerdict::Named, Vec::new()),
        Verdict::Effect => (FullVerdict::Ambiguous, Vec::new()),
        Verdict::Unknown => {
            let candidate = catalogue.candidate(&selection.best.fit.values)?;
            let depends_on = depends_on(&samples(&fitted, &evaluator, &candidate));
            if depends_on.is_empty() {
                (FullVerdict::UnobservedDisturbance, depends_on)
            } else {
                (FullVerdict::UnknownStructured, depends_on)
            }
        }
    };
    progress("flown again");
    let reported = gap.as_ref().map_or(noise, |gap| gap.noise);
    let (closed_loop, closed_loop_missing) = match reflight(case, &effects, &reported, settings) {
        Ok(closed_loop) => (Some(closed_loop), None),
        Err(reason) => (None, Some(reason.to_string())),
    };
    let mut answer = Answer {
        verdict,
        finding: Finding { verdict: full, sentence: String::new(), depends_on },
        logs: Vec::new(),
        map,
        twins,
        evidence_asked: selector.thresholds.evidence,
        effects: effects_answer,
        gap,
        closed_loop,
        closed_loop_missing,
        ambiguous_with,
        not_testable: not_testable(&catalogue, &selection, leg),
        next_flight: None,
        unmodelled_force: leftover.force.clone(),
        unmodelled_moment: leftover.moment.clone(),
        hypotheses: selection
            .singles
            .iter()
            .map(|rival| {
                let (gain, error) = rival.scored.gain_over(&selection.null);
                let hypothesis = &catalogue.hypotheses[rival.hypothesis];
                HypothesisAnswer {
                    id: hypothesis.effect.name(),
                    evidence: rival.scored.evidence - selection.null.evidence,
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
    answer.finding.sentence = finding(&answer);
    let effects = if verdict == Verdict::Effect { effects } else { EffectSet::new() };
    let open = [live(&catalogue, &selection, &answer), untested(&catalogue, &answer)];
    Ok(Diagnosis { answer, effects, open, setpoint_leg: leg, noise: reported })
}

/// Probability of gusts where what is left looks like turbulence: other forces may.
const GUSTS_PROBABILITY: f64 = 0.8;
/// Share of its usual tolerances that a vehicle file taken at its word has.
const STRICT: f64 = 0.1;
/// An error of some quantity and horizon that may be more than noise, in units of the noise.
const VISIBLE: f64 = 1.15;
/// Share of a visible gap that the strict look must not leave, to be preferred.
const CLOSES: f64 = 0.6;
/// Twins of the best explanation, against which what it leaves is compared.
const TWINS_OF_BEST: u32 = 16;

/// Twins of the vehicle of a fit.
fn twins_of(
    fitted: &Observed<'_>,
    catalogue: &Catalogue,
    scored: &Scored,
    noise: &ReportNoise,
    leg: bool,
    draws: (u32, u64),
) -> Option<TwinFits> {
    let numbers: Vec<usize> = (0..catalogue.numbers.len()).collect();
    let about = Linearised::new(fitted, &scored.fit.values, &numbers)?;
    TwinFits::draw(fitted, &about, &scored.fit.active(catalogue), noise, leg, draws).ok()
}

/// Takes off a fit's effects what its twins are off by, and gives them the twins' scatter.
fn correct(scored: &mut Scored, catalogue: &Catalogue, twins: &TwinFits) {
    let bias = twins.bias(catalogue);
    for number in scored.fit.active(catalogue) {
        let [low, high] = catalogue.numbers[number].bounds;
        let value = &mut scored.fit.values[number];
        *value = (*value - bias[number]).clamp(low, high);
        scored.fit.deviation[number] = twins.deviation(number);
    }
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
    let noise = report_noise(case.fitted, &selection.best.fit.power, fitted.counts());
    let shipped = Simulator::new(case.vehicle, &EffectSet::new(), leg)?;
    let repaired = Simulator::new(case.vehicle, effects, leg)?;
    let nuisances =
        Simulator::new(case.vehicle, &catalogue.effects(&selection.null.fit.values, None), leg)?;
    let everything =
        Simulator::new(case.vehicle, &catalogue.effects(&selection.best.fit.values, None), leg)?;
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
        with_nuisances: everything.errors(case.held_out).map(|errors| errors.mean_over(&floor)),
        errors: [before, after, floor],
        noise,
    }))
}
