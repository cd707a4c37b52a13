//! A diagnosis at one set of tolerances: where the gap lies, what the search leaves over, how far
//! the gap shrinks, and what is made of all that.

use std::collections::BTreeMap;

use sitl::effects::{EffectId, EffectSet, Slots};
use sitl::vehicle::VehicleError;

use super::answer::{
    EffectAnswer, FlightAnswer, FullVerdict, Gap, NAMED, NotTestable, Verdict, parameters,
};
use super::arrival::Delay;
use super::case::{Case, Settings};
use super::excitation::{part_wind_from_trim, voltages_differ};
use super::gap::{Errors, Floor};
use super::hypothesis::Catalogue;
use super::judgement::{
    Balance, Leftover, SIGNIFICANCE, Unexplained, explained, is_neighbour, is_open, is_open_on_one,
    is_propped, is_unexplained,
};
use super::leftover::{UnmodelledForce, unmodelled_force, unmodelled_moment};
use super::map::{ResidualMap, depends_on, map, samples};
use super::misfit::standing_out;
use super::naming::{
    BETTER_SHARE, THRUST_LEVEL, TILTS, UNTOLD_SHARE, answer_of, as_good, credence, named_effects,
    share, single, tilt_in_place_of,
};
use super::noise::report_noise;
use super::observed::Observed;
use super::onboard::OnboardLaw;
use super::open_loop::Simulator;
use super::preparation::PreparedFlight;
use super::procedure::DiagnoseError;
use super::residuals::Evaluator;
use super::scored::Scored;
use super::search::Search;
use super::selection::Selection;
use super::strain::is_loop_held;
use super::turbulence::gusts;
use super::twins::TwinFits;
use super::unchosen::Unchosen;

/// Beyond the floor by less, in units of it, there is no gap that could be closed.
const GAP_MIN: f64 = 0.05;
/// Probability of gusts where what is left looks like turbulence, as other forces may.
const GUSTS_PROBABILITY: f64 = 0.8;
/// Probability of an effect that was not chosen and that acts all the same: of nineteen such in
/// exams eighteen were true, but most of these had shaped the rules.
const UNCHOSEN_PROBABILITY: f64 = 0.7;
/// Probability of an effect that leaves a trace, though what it changes is below the noise of the
/// predictions. In two exams two of three such were true; below a half, for it is not named.
const TRACE_PROBABILITY: f64 = 0.45;

/// What a diagnosis looks at.
pub(super) struct Inquiry<'a> {
    pub case: &'a Case<'a>,
    pub settings: &'a Settings,
    pub catalogue: &'a Catalogue,
    pub evaluator: &'a Evaluator,
    /// The flights of the fit.
    pub fitted: Observed<'a>,
    /// The flights held out.
    pub held_out: Observed<'a>,
    /// The law that made outputs of setpoints, where both were logged.
    pub onboard: Option<&'a OnboardLaw>,
    /// The setpoints' delay as read off the outputs.
    pub arrival: Option<Delay>,
    /// Errors on the flights held out with what a flexible learner adds.
    pub learned: Option<Errors>,
}

/// What is made of what was found.
pub(super) struct Judgement {
    pub verdict: Verdict,
    /// Why it is unknown, where it is.
    pub because: Option<Unexplained>,
    /// Gusts, where what is left looks like turbulence.
    pub turbulence: Option<Slots>,
    /// What was not chosen and is named.
    pub unchosen: Option<Unchosen>,
    /// The probability that what was chosen holds the cause, as far as what it leaves tells.
    pub credence: f64,
}

impl Judgement {
    /// The judgement where `unchosen` acts.
    pub fn naming(self, unchosen: Unchosen) -> Self {
        Self { verdict: Verdict::Effect, because: None, unchosen: Some(unchosen), ..self }
    }
}

impl<'a> Inquiry<'a> {
    /// Whether the leg from setpoints to outputs is looked at.
    pub fn leg(&self) -> bool {
        self.onboard.is_some()
    }

    /// Where the gap lies.
    pub fn map(&self, selection: &Selection) -> Result<ResidualMap, DiagnoseError> {
        let references = self.catalogue.references();
        let shipped = self.catalogue.candidate(&references)?;
        let residuals = self.fitted.residuals(&references).ok_or(DiagnoseError::Nothing)?;
        let power = self.fitted.power(&residuals);
        Ok(map(&self.fitted, self.evaluator, &shipped, &power, &selection.best.fit.power))
    }

    /// Forces and moments that are left, before and after the best explanation.
    pub fn leftover(&self, search: &Search) -> Leftover {
        let Search { selection, of_null, of_best, .. } = search;
        let force = |scored: &Scored| {
            let candidate = self.catalogue.candidate(&scored.fit.values).ok()?;
            unmodelled_force(&self.fitted, self.evaluator, &candidate)
        };
        let of_null = of_null.as_ref().filter(|_| self.leg());
        let moment = |scored: &Scored, twins: &TwinFits| {
            unmodelled_moment(&self.fitted, &scored.fit.power, twins)
        };
        Leftover {
            force: force(&selection.null).zip(force(&selection.best)).map(|(a, b)| [a, b]),
            moment: of_null.and_then(|of_null| {
                let after = moment(&selection.best, of_best.as_ref().unwrap_or(of_null));
                moment(&selection.null, of_null).zip(after).map(|(a, b)| [a, b])
            }),
        }
    }

    /// What is left, and what the explanation explains, in units of what matters.
    pub fn balance(&self, search: &Search, leftover: &Leftover) -> Balance {
        let (force, moment) = explained(&search.selection, &self.fitted);
        let vehicle = self.case.vehicle;
        Balance {
            force: leftover.force_size(vehicle, &search.noise, force),
            moment: leftover.moment_size(vehicle, &search.noise, moment),
        }
    }

    pub fn simulator(&self, effects: &EffectSet) -> Result<Simulator, VehicleError> {
        Simulator::new(self.case.vehicle, effects, self.leg())
    }

    /// The gap on the flights held out without and with `effects`.
    pub fn gap(
        &self,
        selection: &Selection,
        effects: &EffectSet,
    ) -> Result<Option<Gap>, DiagnoseError> {
        let held_out = self.case.held_out;
        let noise = report_noise(self.case.fitted, &selection.best.fit.power, self.fitted.counts());
        let with_all =
            |scored: &Scored| self.simulator(&self.catalogue.effects(&scored.fit.values, None));
        let shipped = self.simulator(&EffectSet::new())?;
        let repaired = self.simulator(effects)?;
        let nuisances = with_all(&selection.null)?;
        let everything = with_all(&selection.best)?;
        let floor = repaired.floor(held_out, &noise, self.settings.seed);
        let (Some(Floor { errors: floor, scatter }), Some(before), Some(after)) =
            (floor, shipped.errors(held_out), repaired.errors(held_out))
        else {
            return Ok(None);
        };
        let mean = |simulator: &Simulator| {
            simulator.errors(held_out).map(|errors| errors.mean_over(&floor))
        };
        let [b, a, f] = [before, after, floor].map(|errors| errors.mean_over(&floor));
        Ok(Some(Gap {
            metric: "mean",
            before: b,
            after: a,
            floor: f,
            scatter,
            closure: (b - f > GAP_MIN).then(|| (b - a) / (b - f)),
            nuisances_only: mean(&nuisances),
            with_nuisances: mean(&everything),
            with_learner: self.learned.map(|errors| errors.mean_over(&floor)),
            errors: [before, after, floor],
            noise,
        }))
    }

    /// The flights, with the gap of each as shipped.
    pub fn flights(&self, search: &Search) -> Result<Vec<FlightAnswer>, VehicleError> {
        let shipped = self.simulator(&EffectSet::new())?;
        let gap = |flight: &PreparedFlight| shipped.gap(flight, &search.noise, self.settings.seed);
        Ok(FlightAnswer::all(self.case, gap))
    }

    /// The verdict on what was found.
    pub fn judge(
        &self,
        search: &Search,
        effects: &EffectSet,
        leftover: &Leftover,
        balance: &Balance,
        gap: Option<&Gap>,
        flights: &[FlightAnswer],
    ) -> Judgement {
        let found = !search.selection.best.fit.hypotheses.is_empty();
        let may_be_gusts = !self.case.without.contains(&EffectId::Gusts);
        // Driven by outputs, an open loop strays from any cause.
        let stays_open = self.leg() && gap.is_some_and(|gap| is_open(gap, found));
        let is_on_one = self.leg() && !found && is_open_on_one(flights);
        // A force that is small by itself matters where it keeps the gap open.
        let matters = |after: &UnmodelledForce| {
            let is_open = stays_open || is_on_one;
            balance.force.left > 1.0 || is_open && after.slow_significance > SIGNIFICANCE
        };
        let after = leftover.force.as_ref().map(|[_, after]| after);
        let turbulence = after.filter(|after| may_be_gusts && matters(after)).and_then(|after| {
            let candidate = self.catalogue.candidate(&search.selection.best.fit.values).ok()?;
            let samples = samples(&self.fitted, self.evaluator, &candidate);
            gusts(self.case.vehicle, effects, after, &samples)
        });
        let is_held = is_loop_held(self.catalogue, &search.selection.null.fit);
        // Turbulence keeps a gap open that nothing closes.
        let gap = gap.filter(|_| self.leg() && turbulence.is_none());
        let credence = credence(&search.misfit, gap.map(Gap::open));
        let because = if turbulence.is_some() {
            None
        } else if is_unexplained(balance, found) {
            Some(Unexplained::Leftover)
        } else if is_neighbour(&search.misfit) {
            Some(Unexplained::Neighbour)
        } else if stays_open {
            Some(Unexplained::OpenGap)
        } else if is_on_one {
            Some(Unexplained::OpenOnOne)
        } else if found && gap.is_some_and(is_propped) {
            Some(Unexplained::Propped)
        } else if found && search.constancy.variation.is_some() {
            Some(Unexplained::Varies)
        } else if found && credence < NAMED {
            Some(Unexplained::Doubt)
        } else if found {
            search.level.is_some().then_some(Unexplained::Strain)
        } else if standing_out(&search.misfit, is_held).is_some() {
            Some(Unexplained::Misfit)
        } else if !search.strained.is_empty() {
            Some(Unexplained::Strain)
        } else {
            None
        };
        let verdict = match because {
            Some(_) => Verdict::Unknown,
            None if found || turbulence.is_some() => Verdict::Effect,
            None => Verdict::None,
        };
        Judgement { verdict, because, turbulence, unchosen: None, credence }
    }

    /// The named effects, gusts among them if there is turbulence, and what they cannot be told
    /// from.
    pub fn names(
        &self,
        search: &Search,
        effects: &EffectSet,
        not_testable: &[NotTestable],
        judgement: &Judgement,
    ) -> (Vec<EffectAnswer>, Vec<EffectId>) {
        if let Some(Unchosen { effect, scored, .. }) = &judgement.unchosen {
            let named = answer_of(self.catalogue, scored, *effect, UNCHOSEN_PROBABILITY);
            return (vec![named], Vec::new());
        }
        let named = search.named(self.catalogue);
        let (mut answers, mut ambiguous) =
            named_effects(self.catalogue, &search.selection, judgement.credence);
        if judgement.turbulence.is_some() {
            answers.push(EffectAnswer {
                id: EffectId::Gusts,
                probability: GUSTS_PROBABILITY,
                parameters: parameters(effects, EffectId::Gusts),
                intervals: BTreeMap::new(),
            });
        }
        let hides_sag = |untestable: &NotTestable| untestable.id == EffectId::BatterySag;
        let shows_sag = voltages_differ(self.case.fitted) && !not_testable.iter().any(hides_sag);
        let named: Vec<EffectId> = named.into_iter().map(EffectId::class).collect();
        if !shows_sag && named.iter().any(|effect| THRUST_LEVEL.contains(effect)) {
            let others = THRUST_LEVEL.iter().filter(|effect| !named.contains(effect));
            let others = others.filter(|effect| self.catalogue.considers(**effect));
            let others: Vec<EffectId> = others.copied().collect();
            let family = (THRUST_LEVEL.as_slice(), UNTOLD_SHARE);
            share(&mut answers, self.catalogue, &search.selection, family, &others);
            ambiguous.extend(others);
        }
        let tilt = tilt_in_place_of(self.catalogue, &search.selection);
        let tilt = tilt.filter(|tilt| !ambiguous.contains(tilt));
        if let Some(tilt) = tilt.filter(|_| !part_wind_from_trim(self.case.fitted)) {
            let family = (TILTS.as_slice(), UNTOLD_SHARE);
            share(&mut answers, self.catalogue, &search.selection, family, &[tilt]);
            ambiguous.push(tilt);
        }
        let Search { selection, thresholds, .. } = search;
        let mut others = as_good(self.catalogue, selection, thresholds, self.leg());
        others.retain(|other| !ambiguous.contains(other));
        let chosen = (named.as_slice(), BETTER_SHARE);
        share(&mut answers, self.catalogue, selection, chosen, &others);
        ambiguous.extend(others);
        ambiguous.sort_unstable_by_key(|effect| effect.name());
        ambiguous.dedup();
        // Those named are the answer, the first in any case; the others are what it cannot be told
        // from.
        let is_answer = |(place, answer): (usize, &EffectAnswer)| {
            (place == 0 || answer.probability >= NAMED).then_some(answer.id)
        };
        let answer: Vec<EffectId> = answers.iter().enumerate().filter_map(is_answer).collect();
        ambiguous.retain(|id| !answer.contains(id));
        (answers, ambiguous)
    }

    /// Where nothing is named: the effect that explains the most, if it has more evidence than is
    /// asked.
    pub fn trace(&self, search: &Search) -> Option<EffectAnswer> {
        let Search { selection, thresholds, .. } = search;
        let mut kept = selection.singles.iter().filter(|r| Some(r.hypothesis) != search.dropped);
        let first = kept.next()?;
        let evidence = first.scored.evidence - selection.null.evidence;
        if evidence <= thresholds.asked_of(first.hypothesis) {
            return None;
        }
        let effect = self.catalogue.hypotheses[first.hypothesis].effect;
        single(self.catalogue, selection, effect, TRACE_PROBABILITY)
    }

    /// The full verdict, and what a gap that nothing explains goes with.
    pub fn full_verdict(
        &self,
        search: &Search,
        judgement: &Judgement,
        is_ambiguous: bool,
    ) -> Result<(FullVerdict, Vec<String>), DiagnoseError> {
        Ok(match judgement.verdict {
            Verdict::None => (FullVerdict::None, Vec::new()),
            Verdict::Effect
                if judgement.unchosen.as_ref().is_some_and(|named| named.effects.is_empty()) =>
            {
                (FullVerdict::OtherLaw, Vec::new())
            }
            Verdict::Effect if is_ambiguous => (FullVerdict::Ambiguous, Vec::new()),
            Verdict::Effect => (FullVerdict::Named, Vec::new()),
            Verdict::Unknown => {
                let candidate = self.catalogue.candidate(&search.selection.best.fit.values)?;
                let mut depends_on = depends_on(&samples(&self.fitted, self.evaluator, &candidate));
                if judgement.because == Some(Unexplained::Varies) {
                    let varies = search.constancy.variation.iter();
                    depends_on.extend(varies.map(|varies| varies.quantity.to_owned()));
                }
                if depends_on.is_empty() {
                    (FullVerdict::UnobservedDisturbance, depends_on)
                } else {
                    (FullVerdict::UnknownStructured, depends_on)
                }
            }
        })
    }
}
