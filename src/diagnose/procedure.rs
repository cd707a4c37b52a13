//! From flights to an answer.

use sitl::effects::{EffectId, EffectSet};
use sitl::vehicle::VehicleError;

use super::answer::{
    Answer, EffectAnswer, Finding, FlightAnswer, FullVerdict, Gap, HypothesisAnswer, Verdict,
};
use super::arrival::Delay;
use super::case::{Case, Settings};
use super::gap::Errors;
use super::hypothesis::Catalogue;
use super::inquiry::{Inquiry, Judgement};
use super::judgement::{Balance, Leftover, Unexplained, is_open_on_one};
use super::learner::Learner;
use super::map::ResidualMap;
use super::naming::not_testable;
use super::next_flight::OpenQuestions;
use super::noise::ReportNoise;
use super::observed::Observed;
use super::open_loop::Simulator;
use super::reflight::reflight;
use super::residuals::Evaluator;
use super::search::Search;
use super::words::finding;

/// Shares of its usual tolerances that a vehicle file taken at its word has, one look after the
/// other: where a gap stays open, even a tenth of them may have taken up what opens it.
const STRICT: [f64; 2] = [0.1, 0.01];
/// An error of some quantity and horizon that may be more than noise, in units of the noise.
const VISIBLE: f64 = 1.15;
/// Share of a visible gap that the strict look must not leave, to be preferred.
const CLOSES: f64 = 0.6;

/// An answer and what follows from it.
#[derive(Debug)]
pub struct Diagnosis {
    /// The answer.
    pub answer: Answer,
    /// The named effects with the vehicle's true values.
    pub effects: EffectSet,
    /// What a next flight is for.
    pub open: OpenQuestions,
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
/// looked at again with a file that is taken at its word. What that names is preferred where it
/// closes most of what is visible, or adds to what was named before and predicts better.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose(
    case: &Case<'_>,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let evaluator = Evaluator::new(case.vehicle).observing(case.fitted);
    let leg = case.fitted.iter().chain(case.held_out).all(|flight| flight.channels.setpoint);
    progress("what a learner can close");
    let learned = learned(case, &evaluator, leg);
    let onboard = evaluator.onboard().filter(|_| leg);
    let arrival = onboard.and_then(|law| Delay::of(case.fitted, law));
    let grounds = Grounds { case, settings, evaluator: &evaluator, leg, arrival, learned };
    let tolerant = grounds.attempt(1.0, progress)?;
    if let Some(without) = without_moments(case, &tolerant) {
        progress("again, with a plain drag");
        let case = Case { without: &without, ..*case };
        let plain = Grounds { case: &case, ..grounds }.attempt(1.0, progress)?;
        return Ok(as_drag(plain).unwrap_or(tolerant));
    }
    let open = |diagnosis: &Diagnosis| diagnosis.answer.gap.as_ref().map(Gap::most_visible);
    // Effects that were found may have closed what is open as shipped.
    let stays_open = !tolerant.answer.explains() && is_open_on_one(&tolerant.answer.flights);
    let is_visible = |left: &f64| *left > VISIBLE || stays_open;
    let Some(left) = open(&tolerant).filter(|left| tolerant.setpoint_leg && is_visible(left))
    else {
        return Ok(tolerant);
    };
    for share in STRICT {
        progress("again, with the vehicle file at its word");
        let strict = grounds.attempt(share, progress)?;
        let closes = open(&strict).is_some_and(|strictly| strictly - 1.0 < CLOSES * (left - 1.0));
        let is_preferred = strict.answer.explains() && (closes || adds(&strict, &tolerant));
        if is_preferred || says_more(&strict, &tolerant) {
            return Ok(strict);
        }
        if !is_open(&strict) {
            break;
        }
    }
    Ok(tolerant)
}

/// Whether nothing explains an open gap.
fn is_open(diagnosis: &Diagnosis) -> bool {
    let because = diagnosis.answer.finding.because;
    matches!(because, Some(Unexplained::OpenGap | Unexplained::OpenOnOne))
}

/// Whether a strict look tells what an open gap goes with where a tolerant one does not.
fn says_more(strict: &Diagnosis, tolerant: &Diagnosis) -> bool {
    is_open(tolerant) && strict.answer.finding.because == Some(Unexplained::Varies)
}

/// Whether a strict look names more than a tolerant one, and predicts better.
fn adds(strict: &Diagnosis, tolerant: &Diagnosis) -> bool {
    // What nuisances alone cannot bear may be an effect within its usual tolerance.
    let may_be_small = matches!(
        tolerant.answer.finding.because,
        None | Some(
            Unexplained::OpenGap
                | Unexplained::OpenOnOne
                | Unexplained::Misfit
                | Unexplained::Strain
        )
    );
    let keeps = |old: &EffectAnswer| strict.answer.named().any(|new| new.id == old.id);
    let after = |diagnosis: &Diagnosis| diagnosis.answer.gap.as_ref().map(|gap| gap.after);
    may_be_small && tolerant.answer.named().all(keeps) && after(strict) < after(tolerant)
}

/// Effects not to be considered, where blade flapping stands for what a plain drag of the rotors
/// may be. Flapping is such a drag and a moment. Without a known on-board law nothing says how well
/// the moments are modelled (inertias are often assumed), so that the simpler cause comes first if
/// it explains about as much.
fn without_moments(case: &Case<'_>, found: &Diagnosis) -> Option<Vec<EffectId>> {
    let flaps = found.answer.named().any(|effect| effect.id == EffectId::BladeFlapping);
    let is_drag = found.answer.ambiguous_with.contains(&EffectId::RotorDrag);
    (!found.setpoint_leg && flaps && is_drag).then(|| {
        let mut without = case.without.to_vec();
        without.push(EffectId::BladeFlapping);
        without
    })
}

/// The diagnosis without blade flapping, if it names a drag of the rotors: it cannot be told from
/// flapping then.
fn as_drag(mut plain: Diagnosis) -> Option<Diagnosis> {
    let answer = &mut plain.answer;
    let is_named = answer.named().any(|effect| effect.id == EffectId::RotorDrag);
    answer.ambiguous_with.push(EffectId::BladeFlapping);
    answer.finding.verdict = FullVerdict::Ambiguous;
    answer.finding.sentence = finding(answer);
    is_named.then_some(plain)
}

/// Errors on the flights held out of the simulator as shipped, with what a learner adds that was
/// taught what it leaves of the flights of the fit.
fn learned(case: &Case<'_>, evaluator: &Evaluator, leg: bool) -> Option<Errors> {
    let catalogue = Catalogue::new(case.vehicle, leg);
    let shipped = catalogue.candidate(&catalogue.references()).ok()?;
    let allocation = case.vehicle.allocation().ok()?;
    let fitted = Observed::new(case.fitted, evaluator, &catalogue);
    let learner = Learner::of(&fitted, evaluator, &shipped, &allocation)?;
    let simulator = Simulator::new(case.vehicle, &EffectSet::new(), leg).ok()?;
    simulator.with_learner(learner).errors(case.held_out)
}

/// What every attempt at a diagnosis looks at.
#[derive(Clone, Copy)]
struct Grounds<'a> {
    case: &'a Case<'a>,
    settings: &'a Settings,
    evaluator: &'a Evaluator,
    /// Whether the leg from setpoints to outputs is looked at.
    leg: bool,
    /// The setpoints' delay as read off the outputs.
    arrival: Option<Delay>,
    /// Errors on the flights held out with what a flexible learner adds.
    learned: Option<Errors>,
}

impl Grounds<'_> {
    /// One diagnosis, with the tolerances of the vehicle file's numbers times `tolerance`.
    fn attempt(&self, tolerance: f64, progress: &dyn Fn(&str)) -> Result<Diagnosis, DiagnoseError> {
        let Grounds { case, settings, evaluator, leg, arrival, learned } = *self;
        let mut catalogue =
            Catalogue::new(case.vehicle, leg).without(case.without).taken_at(tolerance);
        catalogue.candidate(&catalogue.references())?;
        let onboard = evaluator.onboard().filter(|_| leg);
        if let Some(delay) = &arrival {
            catalogue = catalogue.with_delay(delay);
        }
        let inquiry = Inquiry {
            case,
            settings,
            catalogue: &catalogue,
            evaluator,
            fitted: Observed::new(case.fitted, evaluator, &catalogue),
            held_out: Observed::new(case.held_out, evaluator, &catalogue),
            onboard,
            arrival,
            learned,
        };
        let search = inquiry.search(progress)?;
        progress("where");
        let map = inquiry.map(&search.selection)?;
        progress("what is left over");
        let leftover = inquiry.leftover(&search);
        let balance = inquiry.balance(&search, &leftover);
        progress("how far");
        let conclusion = inquiry.conclude(&search, &leftover, &balance)?;
        progress("flown again");
        inquiry.diagnosis(&search, (map, leftover, balance), conclusion)
    }
}

/// What follows from a search: the verdict, the effects that it rests on with their numbers, and
/// how far they close the gap.
struct Conclusion {
    judgement: Judgement,
    effects: EffectSet,
    gap: Option<Gap>,
    flights: Vec<FlightAnswer>,
}

impl Inquiry<'_> {
    /// Judges what the search chose, or what it did not choose and acts all the same.
    fn conclude(
        &self,
        search: &Search,
        leftover: &Leftover,
        balance: &Balance,
    ) -> Result<Conclusion, DiagnoseError> {
        let selection = &search.selection;
        let chosen = search.named(self.catalogue);
        let mut effects = self.catalogue.effects(&selection.best.fit.values, Some(&chosen));
        let mut gap = self.gap(selection, &effects)?;
        let flights = self.flights(search)?;
        let mut judgement = self.judge(search, &effects, leftover, balance, gap.as_ref(), &flights);
        if let Some(unchosen) = self.unchosen(search, &judgement, gap.as_ref()) {
            effects = unchosen.effects.clone();
            gap = self.gap(selection, &effects)?;
            judgement = judgement.naming(unchosen);
        }
        if let Some(slots) = judgement.turbulence {
            let _ = effects.insert(EffectId::Gusts, slots);
        }
        Ok(Conclusion { judgement, effects, gap, flights })
    }

    /// The answer to a conclusion, with where the gap lies and what is left over.
    fn diagnosis(
        &self,
        search: &Search,
        (map, leftover, balance): (ResidualMap, Leftover, Balance),
        Conclusion { judgement, effects, gap, flights }: Conclusion,
    ) -> Result<Diagnosis, DiagnoseError> {
        let Search { selection, thresholds, .. } = search;
        let untestable = not_testable(self.catalogue, selection, self.leg());
        let Judgement { verdict, because, .. } = judgement;
        let (named, ambiguous_with) = match verdict {
            Verdict::Effect => self.names(search, &effects, &untestable, &judgement),
            Verdict::None => (self.trace(search).into_iter().collect(), Vec::new()),
            Verdict::Unknown => (Vec::new(), Vec::new()),
        };
        let (full, depends_on) =
            self.full_verdict(search, &judgement, !ambiguous_with.is_empty())?;
        let noise = gap.as_ref().map_or(search.noise, |gap| gap.noise);
        let (closed_loop, closed_loop_missing) =
            match reflight(self.case, &effects, &noise, self.settings) {
                Ok(closed_loop) => (Some(closed_loop), None),
                Err(reason) => (None, Some(reason.to_string())),
            };
        let mut answer = Answer {
            verdict,
            finding: Finding { verdict: full, sentence: String::new(), because, depends_on },
            logs: Vec::new(),
            map,
            twins: search.twins.clone(),
            effects: named,
            gap,
            closed_loop,
            closed_loop_missing,
            ambiguous_with,
            not_testable: untestable,
            next_flight: None,
            unmodelled_force: leftover.force,
            unmodelled_moment: leftover.moment,
            balance,
            misfit: search.misfit.clone(),
            variation: search.constancy.variation.clone(),
            strained: search.level.iter().chain(&search.strained).cloned().collect(),
            hypotheses: HypothesisAnswer::all(self.catalogue, selection, thresholds),
            flights,
        };
        answer.finding.sentence = finding(&answer);
        let open = OpenQuestions::of(self.catalogue, selection, &answer);
        let effects = if verdict == Verdict::Effect { effects } else { EffectSet::new() };
        Ok(Diagnosis { answer, effects, open, setpoint_leg: self.leg(), noise })
    }
}
