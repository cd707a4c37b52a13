//! Evidence from explanations: how each fares on the flights for choosing and on the held-out
//! flights.

use vehicle::VehicleError;
use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::catalogue::hypothesis::TOLERANCES_MAX;
use crate::diagnose::catalogue::number::{Number, Target};
use crate::diagnose::context::DiagnosisContext;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::equation_residual::{
    EquationResidual, gyro_noise, measured_rotation,
};
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::residual_analysis::learner::Learner;
use crate::diagnose::residual_analysis::map::samples;
use crate::diagnose::residual_analysis::slung_load::slung_load;
use crate::diagnose::residual_analysis::turbulence::gusts;
use crate::diagnose::residual_analysis::unmodelled_force::unmodelled_force;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::explanations::Explanations;
use crate::diagnose::search::rotation_prediction::RotationPrediction;
use crate::diagnose::search::twins::Twins;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::simulate::open_loop::Simulator;
use crate::diagnose::verdict::evidence::{
    Evidence, Explained, FileNumber, ForceLeft, Found, Gaps, MeasuredRotation,
};
use crate::diagnose::verdict::parameter::parameters;
use crate::diagnose::verdict::untestable::{is_flat, voltage_range};

/// Explanations that are predicted on the held-out flights, besides the file and parts of these.
const PREDICTED: usize = 8;
/// Time scale for comparing a force with the velocity's noise, s.
const FORCE_TIME_S: f64 = 0.5;
/// Least force that matters, in units of the weight.
const FORCE_MIN_WEIGHTS: f64 = 0.01;
/// Normal quantile at 99 %.
const Z99: f64 = 2.326;

/// Standard deviation that the vehicle file's errors give a number. Unless `is_loop_known`, no twin
/// measures the effect of errors in the logged moments; this adds them such that [`TOLERANCES_MAX`]
/// standard deviations cover them in full.
pub(in crate::diagnose) fn unremarkable(
    number: &Number,
    turning: &[RotationPrediction; 3],
    is_loop_known: bool,
) -> f64 {
    let by_moments = match number.target {
        _ if is_loop_known => 0.0,
        Target::Effect(EffectId::Inertia, axis) => turning[axis].inflation(),
        Target::Effect(EffectId::YawTorque, _) => turning[2].unexplained(),
        _ => 0.0,
    };
    number.unremarkable + by_moments / TOLERANCES_MAX
}

impl DiagnosisContext<'_> {
    /// An explanation with the vehicle file's numbers fitted to other flights within their
    /// tolerances: a trim, the balance of the torques and the level of the thrust differ from
    /// flight to flight. `about` holds derivatives on those flights.
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
            let about = about.with_residuals(observed, &base).moved_to(values.clone());
            about.solve(&pinned, observed.counts(), &[])
        });
        if let Some(solution) = solution {
            adapted.fit.values = solution.values;
        }
        adapted
    }

    /// The gaps on `flights` with the effects alone, and with the file's numbers too.
    fn gaps(
        &self,
        explanation: &Explanation,
        flights: &[PreparedFlight],
        floor: &Errors,
    ) -> Result<Option<Gaps>, VehicleError> {
        let which = self.effects_of(explanation);
        let errors = |file: bool| -> Result<Option<Errors>, VehicleError> {
            Ok(self.simulator_of(explanation, &which, file)?.errors(flights))
        };
        let all = errors(false)?.zip(errors(true)?);
        Ok(all.map(|(effects, both)| Gaps::over([effects, both], floor, self.metric)))
    }

    /// An explanation in plain numbers, before its predictions.
    fn explained(
        &self,
        explanation: &Explanation,
        twins: Option<&Twins>,
        turning: &[RotationPrediction; 3],
    ) -> Explained {
        let fit = &explanation.fit;
        let hypotheses = fit.hypotheses.iter().map(|h| &self.catalogue.hypotheses[*h]);
        let numbers = hypotheses.clone().flat_map(|hypothesis| {
            hypothesis.numbers.iter().map(|index| {
                let number = &self.catalogue.numbers[*index];
                let [low, high] = number.bounds;
                let value = fit.values[*index];
                let near = 1e-3 * number.magnitude;
                let off = (value - number.reference).abs() > near;
                // An absent effect of the file is at a bound, but that is a valid value, as is no delay.
                // No lag is not: where a rotor follows at once, the outputs were logged late.
                let is_lag = number.target == Target::Effect(EffectId::MotorLag, 0);
                let is_absent =
                    number.target.absent().is_some_and(|absent| (value - absent).abs() < near)
                        || low == 0.0 && value < near && !is_lag;
                Found {
                    effect: hypothesis.effect.name().to_owned(),
                    name: number.target.name(),
                    value,
                    deviation: fit.deviation[*index],
                    reference: number.reference,
                    unremarkable: unremarkable(number, turning, self.is_loop_known()),
                    magnitude: number.magnitude,
                    is_at_bound: off && !is_absent && (value - low < near || high - value < near),
                }
            })
        });
        let which = self.effects_of(explanation);
        let set = self.catalogue.effects(&fit.values, Some(&which));
        let parameters = which.iter().map(|id| {
            let values = parameters(&set, *id).into_iter();
            let values = values.map(|(name, value)| (name.to_owned(), (&value).into())).collect();
            (id.name().to_owned(), values)
        });
        let chance =
            |h: &usize| twins.and_then(|twins| twins.thresholds.get(*h)).map_or(0.0, |a| a / Z99);
        Explained {
            effects: hypotheses.map(|h| h.effect.name().to_owned()).collect(),
            numbers: numbers.collect(),
            parameters: parameters.collect(),
            blocks: explanation.blocks.clone(),
            chance: fit.hypotheses.iter().map(chance).fold(0.0, f64::hypot),
            ..Explained::default()
        }
    }

    /// The vehicle file's numbers as the file alone fits them, the furthest off first.
    fn file_numbers(&self, file: &Explanation) -> Vec<FileNumber> {
        let of_number = |index: usize| {
            let Number { target, expected, tolerance, .. } = self.catalogue.numbers[index];
            let value = file.fit.values[index];
            FileNumber {
                name: target.to_string(),
                value,
                expected,
                tolerances: (value - expected) / tolerance,
            }
        };
        let mut numbers: Vec<FileNumber> = self.catalogue.nuisances().map(of_number).collect();
        numbers.sort_by(|a, b| b.tolerances.abs().total_cmp(&a.tolerances.abs()));
        numbers
    }

    /// Everything that a verdict rests on. `turning` rates the moments from motor outputs; `scale`
    /// and `scales` rate the vehicle file.
    pub fn evidence(
        &self,
        found: &Explanations,
        turning: [RotationPrediction; 3],
        scale: f64,
        scales: Vec<[f64; 2]>,
    ) -> Result<Evidence, DiagnoseError> {
        let best = found.best();
        let [choosing, reported] = [self.choosing.flights, self.input.held_out];
        let everything = self.simulator_of(best, &self.effects_of(best), true)?;
        let floor = |flights| everything.floor(flights, &found.noise, self.settings.seed);
        let floors = [choosing, reported].map(floor);
        let shipped = self.simulator(&EffectSet::new())?;
        let over = |simulator: &Simulator, which: usize| {
            let errors = simulator.errors([choosing, reported][which])?;
            Some(errors.over(&floors[which]?.errors, self.metric))
        };
        let nuisances: Vec<usize> = self.catalogue.nuisances().collect();
        let data = [&self.choosing, &self.reported];
        let about =
            data.map(|observed| Linearised::new(observed, &found.file.fit.values, &nuisances));
        let gaps = |one: &Explanation, which: usize| match &floors[which] {
            Some(floor) => {
                let adapted = self.adapted(one, data[which], about[which].as_ref());
                let left = data[which].residuals(&adapted.fit.values);
                let left = left.map(|left| data[which].power_of(&left));
                let left = left.map(|power| EquationResidual::of(data[which], &power));
                Ok((self.gaps(&adapted, [choosing, reported][which], &floor.errors)?, left))
            }
            None => Ok::<_, VehicleError>((None, None)),
        };
        let rotation = data.map(|observed| MeasuredRotation {
            measured: measured_rotation(observed),
            noise: [0, 1, 2].map(|axis| gyro_noise(observed, found.noise.body_rate, axis)),
        });
        let mut explanations = Vec::new();
        for one in std::iter::once(&found.file).chain(&found.sets) {
            let mut explained = self.explained(one, found.twins.as_ref(), &turning);
            (explained.choosing, explained.equations[0]) = gaps(one, 0)?;
            explanations.push(explained);
        }
        let shipped_gaps = [over(&shipped, 0), over(&shipped, 1)];
        let chosen_s: f64 = choosing.iter().map(PreparedFlight::seconds).sum();
        let mut evidence = Evidence {
            loop_known: self.is_loop_known(),
            metric: self.metric.name().to_owned(),
            scale,
            scales,
            turning,
            fitted_blocks: self.fitted.flights.iter().map(|flight| flight.blocks.len()).sum(),
            chosen_s,
            explanations,
            file_numbers: self.file_numbers(&found.file),
            shipped: shipped_gaps,
            rotation,
            scatter: floors[1].map_or(0.0, |floor| floor.scatter),
            learned: None,
            structure: [0.0; 2],
            voltage_differs: voltages_differ(self.input.fitted),
            outputs_logged: self.input.fitted.iter().all(|flight| flight.channels.shows_rotors()),
            force: None,
            gusts_m_s: None,
            slung_load: 0.0,
        };
        // Only candidates for the verdict are predicted on the held-out flights.
        let scores = evidence.scores();
        let mut ranks: Vec<usize> = (1..scores.len()).collect();
        ranks.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]).then(a.cmp(b)));
        ranks.truncate(PREDICTED);
        // A verdict may rest on a part of a candidate.
        let is_part = |rank: &usize| {
            let own = &found.sets[rank - 1].fit.hypotheses;
            let has_all = |of: &usize| {
                let whole = &found.sets[of - 1].fit.hypotheses;
                own.iter().all(|hypothesis| whole.contains(hypothesis))
            };
            ranks.iter().any(has_all)
        };
        for rank in std::iter::once(0).chain((1..scores.len()).filter(is_part)) {
            let one = if rank == 0 { &found.file } else { &found.sets[rank - 1] };
            let explained = &mut evidence.explanations[rank];
            (explained.reported, explained.equations[1]) = gaps(one, 1)?;
        }
        let learner = self.learner(best);
        if let Some(learner) = &learner {
            evidence.structure = learner.left.map(|left| 1.0 - left);
        }
        let learned =
            learner.and_then(|learner| over(&everything.clone().with_learner(learner), 1));
        evidence.learned = learned;
        self.weigh_force(found, &mut evidence)?;
        Ok(evidence)
    }

    /// A flexible learner of the residuals of an explanation.
    fn learner(&self, explanation: &Explanation) -> Option<Learner> {
        let candidate = self.catalogue.candidate(&explanation.fit.values).ok()?;
        let allocation = self.input.vehicle.allocation().ok()?;
        Learner::of(&self.all, self.evaluator, &candidate, &allocation)
    }

    /// Adds the residual force of the best explanation, and the gusts or the load on a line that it
    /// resembles.
    fn weigh_force(
        &self,
        found: &Explanations,
        evidence: &mut Evidence,
    ) -> Result<(), DiagnoseError> {
        let best = found.best();
        let candidate = self.catalogue.candidate(&best.fit.values)?;
        let Some(after) = unmodelled_force(&self.all, self.evaluator, &candidate) else {
            return Ok(());
        };
        let unit = (6.0_f64.sqrt() * found.noise.velocity / FORCE_TIME_S)
            .max(FORCE_MIN_WEIGHTS * self.input.vehicle.gravity);
        let samples = samples(&self.all, self.evaluator, &candidate);
        let effects = self.catalogue.effects(&best.fit.values, Some(&self.effects_of(best)));
        let load = slung_load(&samples);
        let gusts = gusts(self.input.vehicle, &effects, &after, &samples, load);
        let may_be = !self.input.without.contains(&EffectId::Gusts);
        evidence.force = Some(ForceLeft {
            rms: after.rms(),
            significance: after.significance().max(after.slow_significance),
            size: after.rms() / unit,
        });
        evidence.gusts_m_s = gusts.filter(|_| may_be);
        evidence.slung_load = load;
        Ok(())
    }
}

/// Whether the pack's voltage varies enough, within or between flights, to distinguish a sag from
/// another level of the thrust.
pub(in crate::diagnose) fn voltages_differ(flights: &[PreparedFlight]) -> bool {
    let all = flights.iter().flat_map(|flight| flight.voltage.values().iter().map(|[v]| *v));
    flights.iter().all(|flight| flight.channels.voltage) && !is_flat(voltage_range(all))
}
