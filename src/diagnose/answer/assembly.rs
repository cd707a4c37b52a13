//! Assembles the answer from the explanations and the decision.

use std::collections::BTreeMap;

use vehicle::effects::{EffectId, EffectSet, Slots};

use crate::diagnose::answer::finding::finding;
use crate::diagnose::answer::{
    Answer, EffectAnswer, ExplanationAnswer, Finding, FlightAnswer, FullVerdict, Gap, NotTestable,
};
use crate::diagnose::context::DiagnosisContext;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::fit::interval;
use crate::diagnose::residual_analysis::map::{ResidualMap, depends_on, map, samples};
use crate::diagnose::residual_analysis::unmodelled_force::{UnmodelledForce, unmodelled_force};
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::explanations::Explanations;
use crate::diagnose::simulate::gap::{Errors, Floor, Window, weighted_errors};
use crate::diagnose::simulate::open_loop::Simulator;
use crate::diagnose::simulate::reflight::reflight;
use crate::diagnose::verdict::Decision;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::attribution::{Share, shares};
use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::evidence::Evidence;
use crate::diagnose::verdict::parameter::parameters;

/// Least excess over the floor that counts as a gap, as a share of the floor.
const GAP_MIN: f64 = 0.05;
/// Least distance, in tolerances, of a number of the file that the answer mentions.
const FILE_NUMBER_MIN: f64 = 1.0;
/// Least probability of an effect that the answer mentions.
const MENTIONED_PROBABILITY_MIN: f64 = 0.01;
/// An effect is testable if its numbers are known to this share of their typical magnitude.
const TESTABLE_SHARE_MAX: f64 = 0.5;

/// The inputs of an answer.
pub(in crate::diagnose) struct Assembly<'a> {
    pub context: &'a DiagnosisContext<'a>,
    pub found: &'a Explanations,
    /// The explanation that the verdict rests on, fitted to all flights except the held-out ones.
    pub best: &'a Explanation,
    pub evidence: &'a Evidence,
    pub decision: &'a Decision,
}

impl Assembly<'_> {
    /// The answer, and the named effects with the true vehicle's values.
    pub fn answer(self) -> Result<(Answer, EffectSet), DiagnoseError> {
        let Self { context, decision, evidence, .. } = &self;
        let named: Vec<EffectId> = context.effects_of(self.best);
        let mut effects = context.catalogue.effects(&self.best.fit.values, Some(&named));
        let not_testable = self.not_testable();
        let gap = self.gap(&effects)?;
        let flights = self.flights()?;
        let has_gusts = decision.effects.iter().any(|(id, _)| id == EffectId::Gusts.name());
        if let Some(slots) = self.gusts().filter(|_| has_gusts) {
            // `turbulence` keeps the slots within the effect's ranges.
            let _ = effects.insert(EffectId::Gusts, slots);
        }
        let (closed_loop, closed_loop_missing) =
            match reflight(context.input, &effects, &self.found.noise, context.settings) {
                Ok(closed_loop) => (Some(closed_loop), None),
                Err(reason) => (None, Some(reason.to_string())),
            };
        let (verdict, depends_on) = self.full_verdict()?;
        let best = evidence.explanations.first().map_or(0.0, |file| file.score());
        let explanations = evidence.explanations.iter().zip(&decision.masses).skip(1);
        let mut answer = Answer {
            verdict: decision.verdict,
            effects: self.effects(&effects),
            closed_loop,
            closed_loop_missing,
            ambiguous_with: ids(&decision.ambiguous_with),
            finding: Finding {
                verdict,
                sentence: String::new(),
                because: decision.because,
                depends_on,
            },
            logs: Vec::new(),
            map: self.map()?,
            not_testable,
            next_flight: None,
            unmodelled_force: self.force(),
            attribution: self.attribution(gap.as_ref(), &named)?,
            gap,
            file_scale: evidence.scale,
            file_numbers: evidence
                .file_numbers
                .iter()
                .filter(|number| number.tolerances.abs() >= FILE_NUMBER_MIN)
                .cloned()
                .collect(),
            twins: self.found.twins.clone(),
            explanations: explanations
                .map(|(explained, mass)| ExplanationAnswer {
                    effects: explained.effects.clone(),
                    evidence: explained.score() - best,
                    mass: *mass,
                    numbers: explained.numbers.iter().map(|number| number.value).collect(),
                    parameters: explained.parameters.clone(),
                })
                .collect(),
            flights,
            law: None,
        };
        answer.finding.sentence = finding(&answer);
        let effects = if answer.verdict == Verdict::Effect { effects } else { EffectSet::new() };
        Ok((answer, effects))
    }

    /// Effects with their probabilities and the numbers of the best explanation.
    fn effects(&self, set: &EffectSet) -> Vec<EffectAnswer> {
        let mentioned =
            self.decision.effects.iter().filter(|(_, p)| *p > MENTIONED_PROBABILITY_MIN);
        let answers = mentioned.filter_map(|(name, probability)| {
            let id: EffectId = name.parse().ok()?;
            Some(EffectAnswer {
                id,
                probability: *probability,
                parameters: parameters(set, id),
                intervals: self.intervals(id),
                deviations: self.deviations(id),
            })
        });
        answers.collect()
    }

    /// Gusts whose strength accounts for the residual force, with default shape.
    fn gusts(&self) -> Option<Slots> {
        let mut slots = Slots::default();
        for slot in EffectId::Gusts.spec().slots() {
            slots[slot.index] = slot.parameter.default.unwrap_or(0.0);
        }
        slots[0] = self.evidence.gusts_m_s?;
        Some(slots)
    }

    /// Indices of an effect's fitted numbers.
    fn numbers(&self, id: EffectId) -> impl Iterator<Item = &usize> {
        let catalogue = self.context.catalogue;
        let hypotheses = self.best.fit.hypotheses.iter().map(|h| &catalogue.hypotheses[*h]);
        hypotheses.filter(move |h| h.effect == id).flat_map(|h| &h.numbers)
    }

    /// Standard deviations of an effect's fitted numbers, from the fit alone.
    fn deviations(&self, id: EffectId) -> BTreeMap<String, f64> {
        let catalogue = self.context.catalogue;
        let named = |n: &usize| (catalogue.numbers[*n].target.name(), self.best.fit.deviation[*n]);
        self.numbers(id).map(named).collect()
    }

    /// 90 % intervals of an effect's fitted numbers, with the inexactness of its law.
    fn intervals(&self, id: EffectId) -> BTreeMap<String, [f64; 2]> {
        let catalogue = self.context.catalogue;
        let (fit, calibration) = (&self.best.fit, Calibration::shipped());
        let of_number = |number: &usize| {
            let (value, described) = (fit.values[*number], &catalogue.numbers[*number]);
            let off = value - described.reference;
            let deviation = calibration.deviation(fit.deviation[*number], off);
            (described.target.name(), interval(value, deviation))
        };
        self.numbers(id).map(of_number).collect()
    }

    /// The gap on the held-out flights without and with `effects`.
    fn gap(&self, effects: &EffectSet) -> Result<Option<Gap>, DiagnoseError> {
        let Self { context, best, found, .. } = self;
        let held_out = context.input.held_out;
        let with_all = |explanation: &Explanation| {
            context.simulator_of(explanation, &context.effects_of(explanation), true)
        };
        let shipped = context.simulator(&EffectSet::new())?;
        let repaired = context.simulator(effects)?;
        let floor = repaired.floor(held_out, &self.found.noise, context.settings.seed);
        let (Some(Floor { errors: floor, scatter }), Some(before), Some(mut after)) =
            (floor, shipped.errors(held_out), repaired.errors(held_out))
        else {
            return Ok(None);
        };
        let over = |errors: &Errors| errors.over(&floor, context.metric);
        let gap = |simulator: Simulator| simulator.errors(held_out).map(|errors| over(&errors));
        let both = with_all(best)?.errors(held_out);
        let with_file = !effects.is_empty()
            && over(&after) > over(&before)
            && both.is_some_and(|both| over(&both) < over(&before));
        if let Some(both) = both.filter(|_| with_file) {
            after = both;
        }
        let [b, a, f] = [before, after, floor].map(|errors| over(&errors));
        let f = f.max(self.decision.noise);
        Ok(Some(Gap {
            metric: context.metric.name(),
            before: b,
            after: a,
            with_file,
            floor: f,
            scatter,
            closure: (b - f > GAP_MIN * f).then(|| (b - a) / (b - f)),
            nuisances_only: gap(with_all(&found.file)?),
            with_nuisances: both.map(|errors| over(&errors)),
            with_learner: self.evidence.learned,
            errors: [before, after, floor],
            noise: self.found.noise,
        }))
    }

    /// Shares of the squared gap as shipped, on the held-out flights.
    fn attribution(
        &self,
        gap: Option<&Gap>,
        named: &[EffectId],
    ) -> Result<Vec<Share>, DiagnoseError> {
        let Self { context, best, .. } = self;
        let Some(gap) = gap else { return Ok(Vec::new()) };
        let held_out = context.input.held_out;
        let players = named.len() + 1;
        let windows = |set: usize| -> Result<Vec<Window>, DiagnoseError> {
            let is_in = |bit: usize| set & (1 << bit) != 0;
            let which: Vec<EffectId> =
                (0..named.len()).filter(|bit| is_in(*bit)).map(|bit| named[bit]).collect();
            let simulator = context.simulator_of(best, &which, is_in(named.len()))?;
            Ok(simulator.windows(held_out))
        };
        let all = (0..1 << players).map(windows).collect::<Result<Vec<_>, _>>()?;
        let squares = |weights: &[f64]| -> Option<Vec<f64>> {
            let over = |errors: Errors| errors.over(&gap.errors[2], context.metric).powi(2);
            let weights = || weights.iter().copied();
            all.iter().map(|windows| weighted_errors(windows, weights()).map(over)).collect()
        };
        let names: Vec<&str> =
            named.iter().map(|id| id.name()).chain(["file", "remainder", "noise"]).collect();
        let noise = gap.floor * gap.floor;
        Ok(shares(&names, all[0].len(), squares, noise).unwrap_or_default())
    }

    /// The flights, each with its gap as shipped.
    fn flights(&self) -> Result<Vec<FlightAnswer>, DiagnoseError> {
        let Self { context, found, .. } = self;
        let shipped = context.simulator(&EffectSet::new())?;
        let gap =
            |flight: &PreparedFlight| shipped.gap(flight, &found.noise, context.settings.seed);
        Ok(FlightAnswer::all(context.input, gap))
    }

    /// The location of the gap.
    fn map(&self) -> Result<ResidualMap, DiagnoseError> {
        let Self { context, best, .. } = self;
        let references = context.catalogue.references();
        let shipped = context.catalogue.candidate(&references)?;
        let explained = context.catalogue.candidate(&best.fit.values)?;
        let before = context.all.residuals(&references).ok_or(DiagnoseError::Nothing)?;
        let after = context.all.residuals(&best.fit.values).ok_or(DiagnoseError::Nothing)?;
        let [before, after] = [before, after].map(|residuals| context.all.power(&residuals));
        Ok(map(&context.all, context.evaluator, [&shipped, &explained], &before, &after))
    }

    /// Residual force with the file alone and with the best explanation.
    fn force(&self) -> Option<[UnmodelledForce; 2]> {
        let Self { context, best, found, .. } = self;
        let force = |explanation: &Explanation| {
            let candidate = context.catalogue.candidate(&explanation.fit.values).ok()?;
            unmodelled_force(&context.all, context.evaluator, &candidate)
        };
        force(&found.file).zip(force(best)).map(|(before, after)| [before, after])
    }

    /// The full verdict, and the quantities that an unexplained gap depends on.
    fn full_verdict(&self) -> Result<(FullVerdict, Vec<String>), DiagnoseError> {
        let Self { context, decision, best, .. } = self;
        Ok(match decision.verdict {
            Verdict::None => (FullVerdict::None, Vec::new()),
            Verdict::Effect if !decision.ambiguous_with.is_empty() => {
                (FullVerdict::Ambiguous, Vec::new())
            }
            Verdict::Effect if decision.is_inexact => (FullVerdict::OtherLaw, Vec::new()),
            Verdict::Effect => (FullVerdict::Named, Vec::new()),
            Verdict::Unknown => {
                let candidate = context.catalogue.candidate(&best.fit.values)?;
                let samples = samples(&context.all, context.evaluator, &candidate);
                let depends_on = depends_on(&samples);
                if depends_on.is_empty() {
                    (FullVerdict::UnobservedDisturbance, depends_on)
                } else {
                    (FullVerdict::UnknownStructured, depends_on)
                }
            }
        })
    }

    /// Effects that these logs could not have shown, with the reason.
    fn not_testable(&self) -> Vec<NotTestable> {
        let Self { context, evidence, found, .. } = self;
        let catalogue = context.catalogue;
        let axes = ["roll", "pitch", "yaw"];
        let unused: Vec<&str> = axes
            .into_iter()
            .zip(&evidence.turning)
            .filter(|(_, turning)| !turning.is_usable)
            .map(|(axis, _)| axis)
            .collect();
        let reason = |effect: EffectId| {
            if effect == EffectId::PdGain && !context.is_loop_known() {
                return Some(
                    "the setpoints or the gains of the on-board loop are unknown".to_owned(),
                );
            }
            if effect == EffectId::RotorGyroscopic && catalogue.vehicle.rotor_max_rpm.is_none() {
                return Some("the vehicle file has no rotor_max_rpm".to_owned());
            }
            let alone = found.sets.iter().filter(|explanation| {
                explanation.fit.hypotheses.len() == 1 && context.effects_of(explanation) == [effect]
            });
            let tried: Vec<&Explanation> = alone.collect();
            let is_seen = tried.iter().any(|explanation| {
                explanation.fit.active(catalogue).into_iter().any(|number| {
                    explanation.fit.deviation[number]
                        < TESTABLE_SHARE_MAX * catalogue.numbers[number].magnitude
                })
            });
            let turns = matches!(
                effect,
                EffectId::Inertia
                    | EffectId::YawTorque
                    | EffectId::ComOffset
                    | EffectId::RotorGyroscopic
                    | EffectId::BladeFlapping
            );
            if turns && !unused.is_empty() && !is_seen {
                return Some(format!(
                    "the motor outputs in these logs do not explain the rotation in {}",
                    unused.join(", ")
                ));
            }
            (!tried.is_empty() && !is_seen)
                .then(|| "the motion and the channels in these logs cannot show it".to_owned())
        };
        let all = EffectId::ALL.into_iter();
        all.filter_map(|id| Some(NotTestable { id, reason: reason(id)? })).collect()
    }
}

fn ids(names: &[String]) -> Vec<EffectId> {
    names.iter().filter_map(|name| name.parse().ok()).collect()
}
