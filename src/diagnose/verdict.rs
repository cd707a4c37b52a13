//! The decision: turns the evidence into a verdict.
//!
//! Each explanation has a posterior mass. The verdict rests on the one with the most mass, without
//! effects that change no prediction. It is `effect` where those effects close a substantial share
//! of the gap that the vehicle file's numbers leave open within their tolerances, or most of the
//! residual of an equation that feedback hides from the predictions. Otherwise it is `none` where those numbers close the gap or only noise remains, and else `unknown`.

pub(super) mod assessment;
pub mod attribution;
pub mod calibration;
pub mod evidence;
mod leading;
pub mod parameter;
pub(super) mod posterior;
pub mod untestable;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectId;

use crate::diagnose::residual_analysis::turbulence::EXPLAINED_MAX;
use crate::diagnose::verdict::calibration::{Calibration, SIGNS};
use crate::diagnose::verdict::evidence::{EQUATION_SHARE_MIN, Evidence, ForceLeft, HELD_OUT};
use crate::diagnose::verdict::leading::Leading;
use crate::diagnose::verdict::posterior::{HEALTHY_GAP, OPEN_GAP, PREDICTION_SHARE_MIN, Posterior};

/// The verdict in three words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Effects of the catalogue explain the gap.
    Effect,
    /// Nothing stands out beyond noise and tolerances.
    None,
    /// No effect of the catalogue explains the gap.
    Unknown,
}

impl Verdict {
    /// The verdict as a lower-case word, as in the JSON answer.
    pub fn name(self) -> &'static str {
        match self {
            Self::Effect => "effect",
            Self::None => "none",
            Self::Unknown => "unknown",
        }
    }
}

/// Least probability at which an effect is named.
pub(super) const NAMED: f64 = 0.5;

/// Why a gap counts as unexplained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unexplained {
    /// No explanation closes the larger part of the gap.
    Remainder,
    /// Two sensors agree on a force that nothing explains.
    Force,
    /// They agree on a force that follows from the vehicle's motion like a slung load's pull.
    SlungLoad,
    /// The nearest effects are less likely than not to be the cause.
    Doubt,
}

/// The result of weighing the evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// The verdict.
    pub verdict: Verdict,
    /// Why the verdict is unknown, where it is.
    pub because: Option<Unexplained>,
    /// Index of the explanation that the verdict rests on.
    pub explanation: usize,
    /// Effects with their probabilities, the most probable first. Only the verdict `effect` has any
    /// of a half or more.
    pub effects: Vec<(String, f64)>,
    /// Effects that would explain the flights as well as the named ones.
    pub ambiguous_with: Vec<String>,
    /// Whether a part of the gap stays open with the named effects: the equation is not the
    /// catalogue's.
    pub is_inexact: bool,
    /// Posterior mass of each explanation.
    pub masses: Vec<f64>,
    /// Signs that the cause is outside the catalogue: the constant 1, and the share of the closable
    /// squared gap that the explanation leaves open.
    pub signs: [f64; SIGNS],
    /// Probability that the cause is outside the catalogue.
    pub outside: f64,
    /// The gap from noise on the held-out flights, in units of the floor of simulated sensors:
    /// above 1 where a flexible learner cannot predict the rest.
    pub noise: f64,
}

/// Share of the open squared gap that all effects together must close to be substantial.
const SUBSTANTIAL_SHARE: f64 = 0.2;
/// Probability of gusts where a force looks like turbulence, since other forces look like it too.
const GUST_PROBABILITY: f64 = 0.7;
/// Share of the closable gap above which the remainder shows that an equation is inexact.
const INEXACT_SHARE: f64 = 0.1;

/// The verdict on the evidence, with the calibration that is compiled in.
pub fn decide(evidence: &Evidence) -> Decision {
    decide_with(evidence, Calibration::shipped())
}

/// The verdict on the evidence with another calibration.
pub fn decide_with(evidence: &Evidence, calibration: &Calibration) -> Decision {
    let posterior = Posterior::new(evidence, calibration);
    let best = posterior.best();
    let decision = Decision {
        verdict: Verdict::None,
        because: None,
        explanation: best,
        effects: Vec::new(),
        ambiguous_with: Vec::new(),
        is_inexact: false,
        masses: posterior.masses.clone(),
        signs: [1.0, 0.0],
        outside: calibration.discrepancy(&[1.0, 0.0]),
        noise: 1.0,
    };
    let Some(explained) = evidence.explanations.get(best) else { return decision };
    let leading = Leading::new(evidence, &posterior, best, explained);
    match posterior.reported(0).zip(evidence.shipped[1]) {
        Some((file, shipped)) => by_predictions(&leading, calibration, file, shipped, decision),
        None => by_equations(&leading, decision),
    }
}

/// The largest probability of effects that are sorted by it.
fn surest(effects: &[(String, f64)]) -> f64 {
    effects.first().map_or(0.0, |(_, probability)| *probability)
}

/// Without predictions, the equations alone decide.
fn by_equations(leading: &Leading<'_>, mut decision: Decision) -> Decision {
    decision.effects = leading.probabilities(decision.outside);
    let is_file_unlikely = leading.posterior.masses.first().is_some_and(|file| *file < NAMED);
    if surest(&decision.effects) >= NAMED {
        decision.verdict = Verdict::Effect;
        decision.ambiguous_with = leading.rivals();
    } else if !leading.is_within_tolerances() && is_file_unlikely {
        decision.verdict = Verdict::Unknown;
        decision.because = Some(Unexplained::Doubt);
    }
    decision
}

/// The decision from predictions of the held-out flights. `file` is the squared gap that the
/// file's numbers leave, `shipped` the gap as shipped.
fn by_predictions(
    leading: &Leading<'_>,
    calibration: &Calibration,
    file: f64,
    shipped: f64,
    mut decision: Decision,
) -> Decision {
    let Leading { evidence, posterior, explained, .. } = leading;
    let after = posterior.reported(leading.index).unwrap_or(file);
    // The file explains whatever is within its tolerances.
    let file = if leading.is_within_tolerances() { file.min(after) } else { file };
    let is_forced = evidence.force.is_some_and(ForceLeft::is_practical);
    let noise = evidence.noise(after, is_forced);
    if evidence.learned.is_some() {
        decision.noise = noise.sqrt();
    }
    let closable = (file - noise).max(f64::MIN_POSITIVE);
    let closed = file - after;
    // A share of the open gap, and more than noise scatters the gap by.
    let is_closed = closed > SUBSTANTIAL_SHARE * (file - 1.0).max(f64::MIN_POSITIVE)
        && closed > 0.1 + 4.0 * evidence.scatter;
    let by_equation = evidence
        .explanations
        .first()
        .map_or(0.0, |file| evidence.equation_share(explained, file, HELD_OUT));
    let is_by_equation = !is_closed && by_equation > EQUATION_SHARE_MIN;
    let remainder = if is_by_equation {
        1.0 - by_equation
    } else {
        ((after - noise) / closable).clamp(0.0, 1.0)
    };
    decision.signs = [1.0, remainder];
    decision.outside = calibration.discrepancy(&decision.signs);
    let is_worse = evidence.is_worse(explained, HELD_OUT);
    let is_substantial = is_closed || is_by_equation;
    if !leading.practical.is_empty() && is_substantial && !is_worse {
        decision.effects = leading.probabilities(decision.outside);
        if surest(&decision.effects) >= NAMED || remainder < 0.5 {
            decision.verdict = Verdict::Effect;
            decision.is_inexact = remainder > INEXACT_SHARE;
            decision.ambiguous_with = leading.rivals();
        } else {
            decision.verdict = Verdict::Unknown;
            decision.because = Some(Unexplained::Doubt);
        }
        return decision;
    }
    // No effect explains the gap: a force may, or the gap stays open.
    decision.explanation = 0;
    let open = (OPEN_GAP + 4.0 * evidence.scatter).powi(2);
    let is_open = shipped.powi(2) > open;
    // However much the file's numbers close, a gap of twice the noise is open. So is one beyond a
    // healthy vehicle's noise, where a learner predicts a part of the force or the moment.
    let is_learned = evidence.structure.iter().any(|share| *share > PREDICTION_SHARE_MIN);
    let noise_gap_max = if is_learned { HEALTHY_GAP } else { 2.0 };
    let is_large = file - noise > SUBSTANTIAL_SHARE * (shipped.powi(2) - noise)
        || file > noise_gap_max.powi(2) * noise;
    let is_left = file > noise * open && is_large;
    // No learner predicts turbulence.
    let is_gusty = evidence.gusts_m_s.is_some() && evidence.structure[0] < EXPLAINED_MAX;
    if is_forced && is_open && is_gusty {
        decision.verdict = Verdict::Effect;
        decision.effects = vec![(EffectId::Gusts.name().to_owned(), GUST_PROBABILITY)];
    } else if is_forced && is_open {
        decision.verdict = Verdict::Unknown;
        let is_load = evidence.slung_load > EXPLAINED_MAX;
        decision.because = Some(if is_load { Unexplained::SlungLoad } else { Unexplained::Force });
    } else if is_open && is_left {
        decision.verdict = Verdict::Unknown;
        decision.because = Some(Unexplained::Remainder);
    }
    decision
}

#[cfg(test)]
mod tests;
