//! From flights to an answer.

use sitl::effects::{EffectId, EffectSet};
use sitl::vehicle::VehicleError;

use super::answer::Answer;
use super::arrival::Delay;
use super::assembly::Assembly;
use super::case::{Case, Settings};
use super::evidence::{Evidence, Explained, ForceLeft, Found, Gaps, Turning};
use super::explanation::Explanation;
use super::fit::fit;
use super::gap::{Errors, Metric};
use super::hypothesis::Catalogue;
use super::layout::Place;
use super::learner::Learner;
use super::leftover::unmodelled_force;
use super::linearised::Linearised;
use super::map::samples;
use super::names::parameter_name;
use super::next_flight::OpenQuestions;
use super::noise::{ReportNoise, increments_of_white, report_noise};
use super::observed::Observed;
use super::onboard::OnboardLaw;
use super::open_loop::Simulator;
use super::parts::Parts;
use super::preparation::PreparedFlight;
use super::residuals::{Evaluator, RATE};
use super::scale::scale;
use super::search::Search;
use super::spectrum::{BANDS, mean_square_share};
use super::turbulence::gusts;
use super::twins::{TwinFits, Twins, screened};
use super::untestable::{is_flat, voltage_range};
use super::verdict::{Decision, decide};

/// Twins of the best explanation, which tell what its fit is off by itself.
const TWINS_OF_BEST: u32 = 16;
/// Explanations whose predictions are made.
const PREDICTED: usize = 8;
/// The body's turning is looked at up to here, Hz.
const TURNING_MAX_HZ: f64 = 6.0;

/// An answer and what follows from it.
#[derive(Debug)]
pub struct Diagnosis {
    /// The answer.
    pub answer: Answer,
    /// What it rests on.
    pub evidence: Evidence,
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

/// Diagnoses; `progress` hears each stage.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose(
    case: &Case<'_>,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let evaluator = Evaluator::new(case.vehicle).observing(case.fitted);
    let is_led = |flight: &PreparedFlight| flight.channels.setpoint;
    let leg = case.fitted.iter().chain(case.held_out).all(is_led);
    let onboard = evaluator.onboard().filter(|_| leg);
    let arrival = onboard.and_then(|law| Delay::of(case.fitted, law));
    // A report of an output says when it was in force to within half a period of the reports.
    let rates = case.fitted.iter().map(|flight| flight.outputs.rate());
    let held = 0.5 / rates.fold(f64::INFINITY, f64::min);
    let at_scale = |scale: f64| {
        let catalogue = Catalogue::at_scale(case.vehicle, leg, scale)
            .without(case.without)
            .with_outputs_held(held);
        match &arrival {
            Some(delay) => catalogue.with_delay(delay),
            None => catalogue,
        }
    };
    let parts = Parts::of(case);
    progress("how good the vehicle file is");
    let first = at_scale(1.0);
    first.candidate(&first.references())?;
    let (turning, unused) = turning(&parts.fitted, &evaluator, &first, leg)?;
    let (scale, scales) = {
        let fitted = Observed::without(&parts.fitted, &evaluator, &first, &unused);
        let choosing = Observed::without(&parts.choosing, &evaluator, &first, &unused);
        let search =
            Search { fitted: &fitted, choosing: &choosing, catalogue: &first, chance: Vec::new() };
        let (_, about) = search.file().ok_or(DiagnoseError::Nothing)?;
        scale(&search, &about, at_scale)
    };
    let catalogue = at_scale(scale);
    let look = |flights| Observed::without(flights, &evaluator, &catalogue, &unused);
    let stage = Stage {
        case,
        settings,
        evaluator: &evaluator,
        catalogue: &catalogue,
        onboard,
        arrival,
        fitted: look(&parts.fitted),
        choosing: look(&parts.choosing),
        all: look(case.fitted),
        reported: look(case.held_out),
        metric: metric(leg, &turning),
    };
    let found = stage.found(progress)?;
    progress("how far");
    let evidence = stage.evidence(&found, (turning, scale, scales))?;
    let decision = decide(&evidence);
    stage.diagnosis(found, evidence, decision, progress)
}

/// What predictions are compared by.
fn metric(leg: bool, turning: &[Turning; 3]) -> Metric {
    match leg {
        true => Metric::Mean,
        false if turning.iter().all(|axis| axis.is_usable) => Metric::Guided,
        false => Metric::Forces,
    }
}

/// How well moments predict the body's turning about each axis, and the channels of the axes that
/// they do not.
///
/// Moments are computed from motor outputs. Outputs that are logged more slowly than the loop runs
/// alias; units, unmodelled torques and the feedback's own answer to them stand in others. What
/// then remains of a fit looks like an inertia or a torque constant that is far off: least squares
/// shrink a regressor that is mostly error. An axis whose turning the best explanation leaves more
/// of than it explains, beyond the gyro's noise, is not used.
fn turning(
    flights: &[PreparedFlight],
    evaluator: &Evaluator,
    catalogue: &Catalogue,
    leg: bool,
) -> Result<([Turning; 3], Vec<usize>), DiagnoseError> {
    let observed = Observed::new(flights, evaluator, catalogue);
    let usable = Turning { is_usable: true, ..Turning::default() };
    let search = Search { fitted: &observed, choosing: &observed, catalogue, chance: Vec::new() };
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    let least = search.least_power(&about).unwrap_or_else(|| file.fit.power.clone());
    let layouts = flights.iter().zip(&observed.layouts);
    let measured = layouts.map(|(flight, layout)| evaluator.turning(flight, layout)).collect();
    let measured = observed.power_of(&measured);
    let noise = report_noise(flights, &file.fit.power, observed.counts());
    let rate = flights.iter().map(|flight| flight.body_rate.rate()).sum::<f64>()
        / flights.len().max(1) as f64;
    let of_axis = |axis: usize| {
        let mut found = usable;
        for band in (0..BANDS.len()).filter(|band| BANDS[*band] <= TURNING_MAX_HZ) {
            let place = Place::index_of(RATE + axis, band);
            let count = observed.counts()[place];
            if count < 1.0 {
                continue;
            }
            let share = mean_square_share(band);
            found.measured += measured[place] / count * share;
            found.left += least[place].min(file.fit.power[place]) / count * share;
            found.noise += increments_of_white(noise.body_rate, rate, band) * share;
        }
        let left = (found.left - found.noise).max(0.0);
        found.is_usable =
            leg || left <= 0.5 * (found.measured - found.noise).max(0.0) || left < found.noise;
        found
    };
    let turning = [0, 1, 2].map(of_axis);
    let unused = (0..3).filter(|axis| !turning[*axis].is_usable).map(|axis| RATE + axis);
    Ok((turning, unused.collect()))
}

/// What was found: explanations, and what tells chance from them.
struct FoundAll {
    file: Explanation,
    explanations: Vec<Explanation>,
    noise: ReportNoise,
    twins: Option<Twins>,
}

/// One diagnosis.
pub(super) struct Stage<'a> {
    pub case: &'a Case<'a>,
    pub settings: &'a Settings,
    pub evaluator: &'a Evaluator,
    pub catalogue: &'a Catalogue,
    /// The law that made outputs of setpoints, where both were logged.
    pub onboard: Option<&'a OnboardLaw>,
    /// The setpoints' delay as read off the outputs.
    pub arrival: Option<Delay>,
    /// Flights for fitting, for choosing, and both.
    pub fitted: Observed<'a>,
    pub choosing: Observed<'a>,
    pub all: Observed<'a>,
    pub reported: Observed<'a>,
    pub metric: Metric,
}

impl Stage<'_> {
    /// Whether the leg from setpoints to outputs is looked at.
    pub fn leg(&self) -> bool {
        self.onboard.is_some()
    }

    pub fn simulator(&self, effects: &EffectSet) -> Result<Simulator, VehicleError> {
        let simulator = Simulator::new(self.case.vehicle, effects, self.leg())?;
        Ok(simulator.compared_by(self.metric))
    }

    /// The vehicle by some of an explanation's numbers: those of the effects `which`, and with
    /// `file` those of the vehicle file.
    pub fn simulator_of(
        &self,
        explanation: &Explanation,
        which: &[EffectId],
        file: bool,
    ) -> Result<Simulator, VehicleError> {
        let values = &explanation.fit.values;
        let own = self.effects_of(explanation);
        let (vehicle, all) = self.catalogue.vehicle_of(values);
        let mut effects = EffectSet::new();
        for (id, slots) in all.iter() {
            let is_in = if own.contains(&id) { which.contains(&id) } else { file };
            if is_in {
                // It was accepted before.
                let _ = effects.insert(id, *slots);
            }
        }
        let simulator = self.simulator(&effects)?;
        if file { simulator.flying(&vehicle, &effects) } else { Ok(simulator) }
    }

    /// The effects of an explanation.
    pub fn effects_of(&self, explanation: &Explanation) -> Vec<EffectId> {
        let hypotheses = explanation.fit.hypotheses.iter();
        hypotheses.map(|h| self.catalogue.hypotheses[*h].effect).collect()
    }

    /// Chance, and every explanation that is worth a fit.
    fn found(&self, progress: &dyn Fn(&str)) -> Result<FoundAll, DiagnoseError> {
        let mut search = Search {
            fitted: &self.fitted,
            choosing: &self.choosing,
            catalogue: self.catalogue,
            chance: Vec::new(),
        };
        progress("what the vehicle file's numbers explain");
        let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
        let counts = self.fitted.counts();
        let noise = report_noise(self.fitted.flights, &file.fit.power, counts);
        let mut twins = None;
        if self.settings.twins > 0 {
            progress("twins without an effect");
            let found = self.chance(&search, &file, &about, &noise)?;
            search.chance.clone_from(&found.chance);
            twins = Some(found);
        }
        progress("which effect");
        let explanations = search.explanations(&file, &about);
        Ok(FoundAll { file, explanations, noise, twins })
    }

    /// What chance gives the hypotheses.
    fn chance(
        &self,
        search: &Search<'_>,
        file: &Explanation,
        about: &Linearised,
        noise: &ReportNoise,
    ) -> Result<Twins, DiagnoseError> {
        let draws = (self.settings.twins, self.settings.seed);
        let Some(law) = self.onboard else {
            let twins = TwinFits::of_noise(&self.fitted, &file.fit.power, draws);
            let about = about.resting_at(self.catalogue.expected());
            return Ok(screened(search, file, &about, &twins, self.settings.seed));
        };
        let twins = TwinFits::of_null(&self.fitted, about, law, noise, draws)?;
        Ok(screened(search, file, about, &twins, self.settings.seed))
    }

    /// An explanation with the vehicle file's numbers as other flights have them, within their
    /// tolerances: a trim, the balance of the torques and the level of the thrust differ from
    /// flight to flight. `about`: derivatives on those flights.
    fn adapted(
        &self,
        explanation: &Explanation,
        observed: &Observed<'_>,
        about: Option<&Linearised>,
    ) -> Explanation {
        let mut adapted = explanation.clone();
        let values = &explanation.fit.values;
        let active = explanation.fit.active(self.catalogue);
        let pinned = self.catalogue.with_pinned(&active, values);
        let solution = about.zip(observed.residuals(values)).and_then(|(about, base)| {
            let about = about.about(observed, &base).resting_at(values.clone());
            about.solve(&pinned, observed.counts(), &[])
        });
        if let Some(solution) = solution {
            adapted.fit.values = solution.values;
        }
        adapted
    }

    /// The gaps with parts of an explanation, on some flights.
    fn gaps(
        &self,
        explanation: &Explanation,
        flights: &[PreparedFlight],
        floor: &Errors,
    ) -> Result<Option<Gaps>, VehicleError> {
        let which = self.effects_of(explanation);
        let gap = |which: &[EffectId], file: bool| -> Result<Option<f64>, VehicleError> {
            let errors = self.simulator_of(explanation, which, file)?.errors(flights);
            Ok(errors.map(|errors| errors.over(floor, self.metric)))
        };
        let [effects, file, both] = [gap(&which, false)?, gap(&[], true)?, gap(&which, true)?];
        let gaps = effects.zip(file).zip(both);
        Ok(gaps.map(|((effects, file), both)| Gaps { effects, file, both }))
    }

    /// An explanation in plain numbers.
    fn explained(&self, explanation: &Explanation, twins: Option<&Twins>) -> Explained {
        let fit = &explanation.fit;
        let hypotheses = fit.hypotheses.iter().map(|h| &self.catalogue.hypotheses[*h]);
        let numbers = hypotheses.clone().flat_map(|hypothesis| {
            hypothesis.numbers.iter().map(|index| {
                let number = &self.catalogue.numbers[*index];
                let [low, high] = number.bounds;
                let value = fit.values[*index];
                let near = 1e-3 * number.magnitude;
                let off = (value - number.reference).abs() > near;
                Found {
                    effect: hypothesis.effect.name().to_owned(),
                    name: parameter_name(number.target),
                    value,
                    deviation: fit.deviation[*index],
                    reference: number.reference,
                    unremarkable: number.unremarkable,
                    magnitude: number.magnitude,
                    is_at_bound: off && (value - low < near || high - value < near),
                }
            })
        });
        let active = fit.active(self.catalogue);
        let strain = self.catalogue.nuisances().filter(|number| !active.contains(number));
        let strain = strain.map(|index| {
            let number = &self.catalogue.numbers[index];
            (fit.values[index] - number.expected).abs() / number.tolerance
        });
        let chance =
            |h: &usize| twins.and_then(|twins| twins.asked.get(*h)).map_or(0.0, |a| a / Z99);
        Explained {
            effects: hypotheses.map(|h| h.effect.name().to_owned()).collect(),
            numbers: numbers.collect(),
            blocks: explanation.blocks.clone(),
            chance: fit.hypotheses.iter().map(chance).fold(0.0, f64::hypot),
            choosing: None,
            reported: None,
            strain: strain.fold(0.0, f64::max),
        }
    }

    /// Everything that a verdict rests on.
    fn evidence(
        &self,
        found: &FoundAll,
        (turning, scale, scales): ([Turning; 3], f64, Vec<[f64; 2]>),
    ) -> Result<Evidence, DiagnoseError> {
        let best = found.best();
        let [choosing, reported] = [self.choosing.flights, self.case.held_out];
        let everything = self.simulator_of(best, &self.effects_of(best), true)?;
        let floor = |flights| everything.floor(flights, &found.noise, self.settings.seed);
        let floors = [choosing, reported].map(floor);
        let shipped = self.simulator(&EffectSet::new())?;
        let over = |simulator: &Simulator, which: usize| {
            let errors = simulator.errors([choosing, reported][which])?;
            Some(errors.over(&floors[which]?.errors, self.metric))
        };
        let numbers: Vec<usize> = (0..self.catalogue.numbers.len()).collect();
        let looks = [&self.choosing, &self.reported];
        let about = looks.map(|look| Linearised::new(look, &found.file.fit.values, &numbers));
        let gaps = |one: &Explanation, which: usize| match &floors[which] {
            Some(floor) => {
                let adapted = self.adapted(one, looks[which], about[which].as_ref());
                self.gaps(&adapted, [choosing, reported][which], &floor.errors)
            }
            None => Ok(None),
        };
        let mut explanations = Vec::new();
        for one in std::iter::once(&found.file).chain(&found.explanations) {
            let mut explained = self.explained(one, found.twins.as_ref());
            explained.choosing = gaps(one, 0)?;
            explanations.push(explained);
        }
        let shipped_gaps = [over(&shipped, 0), over(&shipped, 1)];
        let chosen_s: f64 = choosing.iter().map(PreparedFlight::seconds).sum();
        let mut evidence = Evidence {
            loop_known: self.leg(),
            metric: self.metric.name().to_owned(),
            scale,
            scales,
            turning,
            fitted_blocks: self.fitted.flights.iter().map(|flight| flight.blocks.len()).sum(),
            chosen_s,
            explanations,
            shipped: shipped_gaps,
            scatter: floors[1].map_or(0.0, |floor| floor.scatter),
            learned: None,
            voltage_differs: voltages_differ(self.case.fitted),
            force: None,
            gusts_m_s: None,
        };
        // Only what may be chosen is predicted on the flights reported on.
        let scores = evidence.scores();
        let mut ranks: Vec<usize> = (1..scores.len()).collect();
        ranks.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]).then(a.cmp(b)));
        ranks.truncate(PREDICTED);
        // A verdict may rest on a part of what is chosen.
        let is_part = |rank: &usize| {
            let own = &found.explanations[rank - 1].fit.hypotheses;
            let has_all = |of: &usize| {
                let whole = &found.explanations[of - 1].fit.hypotheses;
                own.iter().all(|hypothesis| whole.contains(hypothesis))
            };
            ranks.iter().any(has_all)
        };
        for rank in std::iter::once(0).chain((1..scores.len()).filter(is_part)) {
            let one = if rank == 0 { &found.file } else { &found.explanations[rank - 1] };
            evidence.explanations[rank].reported = gaps(one, 1)?;
        }
        let learner = self.learner(best);
        let learned =
            learner.and_then(|learner| over(&everything.clone().with_learner(learner), 1));
        let (force, gusts_m_s) = self.force(found)?;
        evidence.learned = learned;
        (evidence.force, evidence.gusts_m_s) = (force, gusts_m_s);
        Ok(evidence)
    }

    /// What a flexible learner finds beyond an explanation.
    fn learner(&self, explanation: &Explanation) -> Option<Learner> {
        let candidate = self.catalogue.candidate(&explanation.fit.values).ok()?;
        let allocation = self.case.vehicle.allocation().ok()?;
        Learner::of(&self.all, self.evaluator, &candidate, &allocation)
    }

    /// Force that the best explanation leaves, and the gusts that it looks like.
    fn force(&self, found: &FoundAll) -> Result<(Option<ForceLeft>, Option<f64>), DiagnoseError> {
        let left = |explanation: &Explanation| {
            let candidate = self.catalogue.candidate(&explanation.fit.values).ok()?;
            unmodelled_force(&self.all, self.evaluator, &candidate)
        };
        let best = found.best();
        let Some((before, after)) = left(&found.file).zip(left(best)) else {
            return Ok((None, None));
        };
        let unit = (6.0_f64.sqrt() * found.noise.velocity / FORCE_TIME_S)
            .max(FORCE_MIN_WEIGHTS * self.case.vehicle.gravity);
        let candidate = self.catalogue.candidate(&best.fit.values)?;
        let samples = samples(&self.all, self.evaluator, &candidate);
        let effects = self.catalogue.effects(&best.fit.values, Some(&self.effects_of(best)));
        let gusts = gusts(self.case.vehicle, &effects, &after, &samples);
        let may_be = !self.case.without.contains(&EffectId::Gusts);
        let force = ForceLeft {
            before: before.rms(),
            after: after.rms(),
            significance: after.significance().max(after.slow_significance),
            size: after.rms() / unit,
        };
        Ok((Some(force), gusts.filter(|_| may_be).map(|slots| slots[0])))
    }

    /// The best explanation fitted again to all flights but those reported on, without what its
    /// fit is off by itself.
    fn refitted(&self, explanation: &Explanation, noise: &ReportNoise) -> Option<Explanation> {
        let numbers: Vec<usize> = (0..self.catalogue.numbers.len()).collect();
        let values = &explanation.fit.values;
        let about = Linearised::new(&self.all, values, &numbers)?;
        let hypotheses = &explanation.fit.hypotheses;
        let refit = fit(&self.all, &about, hypotheses, &[Vec::new()])?;
        let mut again = Explanation { fit: refit, ..explanation.clone() };
        let count = TWINS_OF_BEST.min(self.settings.twins);
        let law = self.onboard.filter(|_| count > 0 && !hypotheses.is_empty());
        if let Some(law) = law
            && let Some(about) = Linearised::new(&self.all, &again.fit.values, &numbers)
        {
            let active = again.fit.active(self.catalogue);
            let draws = (count, self.settings.seed);
            if let Ok(twins) = TwinFits::of_effects(&self.all, &about, &active, law, noise, draws) {
                for number in active {
                    let [low, high] = self.catalogue.numbers[number].bounds;
                    let value = &mut again.fit.values[number];
                    *value = (*value - twins.bias[number]).clamp(low, high);
                    // Twins are of one draw of the file's numbers; what their tolerances leave open
                    // is in the fit's own deviation.
                    let own = again.fit.deviation[number];
                    again.fit.deviation[number] = twins.error(number).max(own);
                }
            }
        }
        self.take_up_delay(&mut again);
        Some(again)
    }

    /// A command_delay that was chosen is as the outputs say, where they do.
    fn take_up_delay(&self, best: &mut Explanation) {
        let number = self.catalogue.number_of(EffectId::CommandDelay, 0);
        let chosen = number.filter(|n| best.fit.active(self.catalogue).contains(n));
        if let Some((number, delay)) = chosen.zip(self.arrival) {
            best.fit.values[number] = delay.mean;
            best.fit.deviation[number] = delay.deviation;
        }
    }

    /// The answer.
    fn diagnosis(
        &self,
        found: FoundAll,
        evidence: Evidence,
        decision: Decision,
        progress: &dyn Fn(&str),
    ) -> Result<Diagnosis, DiagnoseError> {
        progress("the numbers of what was found");
        let chosen = match decision.explanation {
            0 => found.file.clone(),
            rank => found.explanations[rank - 1].clone(),
        };
        let best = self.refitted(&chosen, &found.noise).unwrap_or(chosen);
        let assembly = Assembly {
            stage: self,
            found: &found.explanations,
            file: &found.file,
            best: &best,
            noise: &found.noise,
            twins: found.twins.clone(),
            evidence: &evidence,
            decision: &decision,
        };
        progress("flown again");
        let (answer, effects) = assembly.answer()?;
        let open = OpenQuestions::of(self.catalogue, &found.explanations, &answer);
        Ok(Diagnosis {
            answer,
            evidence,
            effects,
            open,
            setpoint_leg: self.leg(),
            noise: found.noise,
        })
    }
}

/// Whether the pack's voltage goes far enough, within flights or from one to the next, for sag to
/// be told from another level of the thrust.
fn voltages_differ(flights: &[PreparedFlight]) -> bool {
    let all = flights.iter().flat_map(|flight| flight.voltage.values().iter().map(|[v]| *v));
    flights.iter().all(|flight| flight.channels.voltage) && !is_flat(voltage_range(all))
}

/// Time over which a force is compared with the velocity's noise, s.
const FORCE_TIME_S: f64 = 0.5;
/// A smaller force matters to nobody, in units of the weight.
const FORCE_MIN_WEIGHTS: f64 = 0.01;
/// Quantile of the normal distribution for one in a hundred.
const Z99: f64 = 2.326;

impl FoundAll {
    /// The explanation with the most evidence.
    fn best(&self) -> &Explanation {
        match self.explanations.first() {
            Some(best) if best.score() > self.file.score() => best,
            _ => &self.file,
        }
    }
}
