//! The stages of a diagnosis, from flights to an answer.

use std::sync::atomic::{AtomicBool, Ordering};

use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::answer::Answer;
use crate::diagnose::answer::assembly::Assembly;
use crate::diagnose::answer::open_questions::open_questions;
use crate::diagnose::context::{DiagnosisContext, Preliminaries};
use crate::diagnose::discovery::Discovered;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::data_split::DataSplit;
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::likelihood::fit::fit;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::{ReportNoise, report_noise};
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::next_flight::OpenQuestions;
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::explanations::Explanations;
use crate::diagnose::search::rotation_prediction::RotationPrediction;
use crate::diagnose::search::rotation_prediction::rotation_predictions;
use crate::diagnose::search::scale::scale;
use crate::diagnose::search::twins::{Draws, TwinFits, Twins, screened};
use crate::diagnose::simulate::metric::Metric;
use crate::diagnose::verdict::evidence::Evidence;
use crate::diagnose::verdict::{Decision, decide};

/// Twins of the best explanation, from which the bias of its fit is estimated.
const TWINS_OF_BEST: u32 = 16;

/// An answer and the data behind it.
#[derive(Debug)]
pub struct Diagnosis {
    /// The answer.
    pub answer: Answer,
    /// The evidence that the verdict rests on.
    pub evidence: Evidence,
    /// The named effects with the values of the true vehicle; where a law is named, the law and the
    /// effects that act beside it.
    pub effects: EffectSet,
    /// What the next flight should resolve.
    pub open: OpenQuestions,
    /// Whether the leg from setpoints to outputs was compared.
    pub setpoint_leg: bool,
    /// Noise of the reported state, per axis.
    pub noise: ReportNoise,
}

/// Diagnoses, and calls `progress` with the name of each stage as it begins.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose(
    input: &DiagnosisInput<'_>,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Diagnosis, DiagnoseError> {
    let stages = Stages { progress, stop: input.stop };
    let preliminaries = Preliminaries::of(input);
    let Preliminaries { evaluator, is_loop_known, measured_delay, .. } = &preliminaries;
    let (is_loop_known, onboard) = (*is_loop_known, preliminaries.onboard());
    let at_scale = |scale: f64| preliminaries.catalogue(input, scale);
    let split = DataSplit::of(input);
    stages.begin("assessing the vehicle file")?;
    let first = at_scale(1.0);
    first.candidate(&first.references())?;
    let observed =
        |flights, unused: &[usize]| Observed::without(flights, evaluator, &first, unused);
    let fitted = observed(&split.fitted, &[]);
    let search = Search::without_chance(&fitted, &first);
    let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
    let (turning, unused) = rotation_predictions(&search, &file, &about, is_loop_known);
    let (scale, scales) = if unused.is_empty() {
        scale(&search, &about, at_scale)
    } else {
        let fitted = observed(&split.fitted, &unused);
        let search = Search::without_chance(&fitted, &first);
        let (_, about) = search.file().ok_or(DiagnoseError::Nothing)?;
        scale(&search, &about, at_scale)
    };
    let catalogue = at_scale(scale);
    let observed = |flights| Observed::without(flights, evaluator, &catalogue, &unused);
    let context = DiagnosisContext {
        input,
        settings,
        evaluator,
        catalogue: &catalogue,
        onboard,
        measured_delay: *measured_delay,
        fitted: observed(&split.fitted),
        choosing: observed(&split.choosing),
        all: observed(input.fitted),
        reported: observed(input.held_out),
        metric: metric(is_loop_known, &turning),
        axes: turning.map(|axis| axis.is_usable),
    };
    let found = context.explanations(&stages)?;
    stages.begin("measuring the gap")?;
    let evidence = context.evidence(&found, turning, scale, scales)?;
    let decision = decide(&evidence);
    let discovered = match settings.discover {
        true => {
            stages.begin("searching for a law")?;
            context.discover(&found, &evidence, &decision)?
        }
        false => None,
    };
    let mut diagnosis = context.diagnosis(found, evidence, decision, &stages)?;
    if let Some(Discovered { answer, effects }) = discovered {
        if answer.named {
            diagnosis.effects = effects;
        }
        diagnosis.answer.add_law(answer);
    }
    Ok(diagnosis)
}

/// The stages of a diagnosis, as they begin.
struct Stages<'a> {
    /// Called with the name of each stage.
    progress: &'a dyn Fn(&str),
    stop: &'a AtomicBool,
}

impl Stages<'_> {
    /// Begins a stage, unless the caller has stopped the diagnosis.
    fn begin(&self, stage: &str) -> Result<(), DiagnoseError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(DiagnoseError::Stopped);
        }
        (self.progress)(stage);
        Ok(())
    }
}

/// The metric of the predictions. Without a known on-board loop it depends on whether moments are
/// usable about every axis.
fn metric(is_loop_known: bool, turning: &[RotationPrediction; 3]) -> Metric {
    match is_loop_known {
        true => Metric::Mean,
        false if turning.iter().any(|axis| axis.is_usable) => Metric::Guided,
        false => Metric::Forces,
    }
}

impl DiagnosisContext<'_> {
    /// Fits every explanation that is worth a fit, and measures what chance gives each hypothesis.
    fn explanations(&self, stages: &Stages<'_>) -> Result<Explanations, DiagnoseError> {
        let mut search = Search {
            fitted: &self.fitted,
            choosing: &self.choosing,
            catalogue: self.catalogue,
            chance: Vec::new(),
        };
        stages.begin("fitting the vehicle file's numbers")?;
        let (file, about) = search.file().ok_or(DiagnoseError::Nothing)?;
        let counts = self.fitted.counts();
        let noise = report_noise(self.fitted.flights, &file.fit.power, counts);
        let mut twins = None;
        if self.settings.twins > 0 {
            stages.begin("simulating twins without an effect")?;
            let found = self.chance(&search, &file, &about, &noise)?;
            search.chance.clone_from(&found.chance);
            twins = Some(found);
        }
        stages.begin("searching for effects")?;
        let sets = search.explanations(&file, &about);
        let mut found = Explanations { file, sets, noise, twins };
        // The response to an effect is not noise: take the smaller residual of the file alone and
        // of the best explanation.
        let power = found.file.fit.power.iter().zip(&found.best().fit.power);
        let power: Vec<f64> = power.map(|(file, best)| file.min(*best)).collect();
        found.noise = report_noise(self.fitted.flights, &power, counts);
        Ok(found)
    }

    /// Evidence that chance gives each hypothesis, measured with twins.
    fn chance(
        &self,
        search: &Search<'_>,
        file: &Explanation,
        about: &Linearised,
        noise: &ReportNoise,
    ) -> Result<Twins, DiagnoseError> {
        let draws = Draws { count: self.settings.twins, seed: self.settings.seed };
        let Some(law) = self.onboard else {
            let twins = TwinFits::of_noise(&self.fitted, &file.fit.power, draws);
            let about = about.moved_to(self.catalogue.expected());
            return Ok(screened(search, file, &about, &twins, self.settings.seed));
        };
        let twins = TwinFits::of_null(&self.fitted, about, law, noise, draws)?;
        if self.fitted.is_stopped() {
            return Err(DiagnoseError::Stopped);
        }
        Ok(screened(search, file, about, &twins, self.settings.seed))
    }

    /// The best explanation, fitted again to all flights except the held-out ones, with the bias of
    /// its fit removed.
    fn refitted(&self, explanation: &Explanation, noise: &ReportNoise) -> Option<Explanation> {
        let mut numbers = explanation.fit.active(self.catalogue);
        numbers.extend(self.catalogue.nuisances());
        numbers.sort_unstable();
        numbers.dedup();
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
            let draws = Draws { count, seed: self.settings.seed };
            if let Ok(twins) = TwinFits::of_effects(&self.all, &about, &active, law, noise, draws) {
                for number in active {
                    let [low, high] = self.catalogue.numbers[number].bounds;
                    let value = &mut again.fit.values[number];
                    *value = (*value - twins.bias[number]).clamp(low, high);
                    // Twins share one draw of the file's numbers. The fit's own deviation covers
                    // their tolerances.
                    let own = again.fit.deviation[number];
                    again.fit.deviation[number] = twins.error(number).max(own);
                }
            }
        }
        self.use_measured_delay(&mut again);
        Some(again)
    }

    /// Replaces a chosen `command_delay` with the delay measured from the outputs, where there is
    /// one.
    fn use_measured_delay(&self, best: &mut Explanation) {
        let number = self.catalogue.number_of(EffectId::CommandDelay, 0);
        let chosen = number.filter(|n| best.fit.active(self.catalogue).contains(n));
        if let Some((number, delay)) = chosen.zip(self.measured_delay) {
            best.fit.values[number] = delay.mean;
            best.fit.deviation[number] = delay.deviation;
        }
    }

    /// Assembles the answer.
    fn diagnosis(
        &self,
        found: Explanations,
        evidence: Evidence,
        decision: Decision,
        stages: &Stages<'_>,
    ) -> Result<Diagnosis, DiagnoseError> {
        stages.begin("refining the numbers found")?;
        let chosen = match decision.explanation {
            0 => found.file.clone(),
            rank => found.sets[rank - 1].clone(),
        };
        let best = self.refitted(&chosen, &found.noise).unwrap_or(chosen);
        let assembly = Assembly {
            context: self,
            found: &found,
            best: &best,
            evidence: &evidence,
            decision: &decision,
        };
        stages.begin("flying again in simulation")?;
        let (answer, effects) = assembly.answer()?;
        let open = open_questions(self.catalogue, &found.sets, &answer);
        Ok(Diagnosis {
            answer,
            evidence,
            effects,
            open,
            setpoint_leg: self.is_loop_known(),
            noise: found.noise,
        })
    }
}
