//! The evidence: what each explanation makes of the flights, in plain numbers.
//!
//! [`decide`](crate::diagnose::verdict::decide) reads nothing else, so that any decision can be taken again
//! from a file.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::effects::ParameterValue;

use crate::diagnose::catalogue::hypothesis::TOLERANCES_MAX;
use crate::diagnose::search::turning::Turning;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::simulate::metric::{Metric, PARTS_MAX};

/// Share of what the file's numbers close of a squared gap that effects by themselves may add to it:
/// the true ones of a file that is off do, for what is off may cancel.
const MADE_UP: f64 = 0.5;

/// Everything that a verdict rests on.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Evidence {
    /// Whether the on-board loop is known, so that setpoints drive the predictions.
    pub loop_known: bool,
    /// The metric of every gap here.
    pub metric: String,
    /// Scale of the tolerances that the vehicle file does not state, and the log evidence of each
    /// scale that was tried, nats.
    pub scale: f64,
    /// See [`scale`](Self::scale).
    pub scales: Vec<[f64; 2]>,
    /// How well moments predict the body's turning about front, right and down.
    pub turning: [Turning; 3],
    /// Blocks of the flights for fitting: the first of each explanation's.
    pub fitted_blocks: usize,
    /// Length of the flights for choosing that is predicted, s.
    pub chosen_s: f64,
    /// The explanations that were fitted: first the vehicle file within its tolerances, then sets
    /// of effects, the best first.
    pub explanations: Vec<Explained>,
    /// The numbers of the vehicle file that the file alone moves to explain the flights for fitting,
    /// the furthest off first.
    #[serde(default)]
    pub file_numbers: Vec<FileNumber>,
    /// The gap as shipped, on the flights for choosing and on those reported on, in units of what
    /// noise alone leaves.
    pub shipped: [Option<f64>; 2],
    /// By how much noise alone scatters the latter.
    pub scatter: f64,
    /// The gap on the flights reported on with the best explanation and what a flexible learner
    /// finds beyond it.
    pub learned: Option<f64>,
    /// Share of the force and of the moment left by the best explanation that a flexible learner
    /// predicts on what it did not learn from; 0 where none could learn.
    pub structure: [f64; 2],
    /// Whether the pack's voltage varies enough to tell a sag from another level of the thrust.
    pub voltage_differs: bool,
    /// Whether motor outputs or rotor speeds are logged: without them a moment is known by the
    /// on-board loop alone, and its scale, the loop's gain and the inertia act alike.
    #[serde(default = "logged")]
    pub outputs_logged: bool,
    /// Force that nothing explains, where velocity and accelerometer agree on it.
    pub force: Option<ForceLeft>,
    /// Standard deviation of gusts that would bring it about, where it looks like turbulence, m/s.
    pub gusts_m_s: Option<f64>,
}

/// What evidence that was stored before the field meant.
fn logged() -> bool {
    true
}

impl Evidence {
    /// Log odds of each explanation over the vehicle file within its tolerances, nats: the
    /// evidence of the flights for fitting, and how much better it predicts those for choosing.
    ///
    /// Predictions are scored as normal errors of unknown size, three a second (one an axis):
    /// `3 s / 2 ln(v_file / v)` of the squared gaps v.
    pub fn scores(&self) -> Vec<f64> {
        let Some(file) = self.explanations.first() else { return Vec::new() };
        let fitted = |explained: &Explained| -> f64 {
            explained.blocks.iter().take(self.fitted_blocks).sum()
        };
        let base = fitted(file);
        let of_one = |explained: &Explained| {
            let predicted = file.choosing_square().zip(explained.choosing_square());
            let own = fitted(explained) - base;
            own + match predicted {
                Some((file, after)) => 1.5 * self.chosen_s * (file / after).ln(),
                None => explained.score() - file.score() - own,
            }
        };
        self.explanations.iter().map(of_one).collect()
    }

    /// Whether an explanation's effects make predictions worse on the flights for choosing (0) or
    /// those reported on (1), by the gaps there with the file's numbers and with its own.
    pub fn is_worse(&self, [file, own]: [Option<Gaps>; 2], flights: usize) -> bool {
        let all = self.shipped[flights].zip(file).zip(own);
        all.is_some_and(|((shipped, file), own)| own.is_worse(shipped, file))
    }

    /// Whether an explanation is ruled out: the number that it is surest of lies at the end of its range,
    /// or its effects worsen the predictions of the flights for choosing.
    pub fn is_implausible(&self, explained: &Explained) -> bool {
        let file = self.explanations.first().and_then(|file| file.choosing);
        explained.is_at_bound() || self.is_worse([file, explained.choosing], 0)
    }

    /// The squared gap that noise leaves on the flights reported on, where the best explanation
    /// leaves `after`.
    ///
    /// With a known on-board loop, noise is what simulated sensors leave (1), and what no flexible
    /// learner finds a way to predict either, unless two sensors agree on a force. Without, the
    /// sensors' noise is a part of it only: the attitude's slow error pushes every prediction.
    pub fn noise(&self, after: f64, is_forced: bool) -> f64 {
        let learned = self.learned.map(|learned| learned.powi(2));
        match (self.loop_known, learned) {
            (true, _) if is_forced => 1.0,
            (true, None) => 1.0,
            (_, Some(learned)) => after.min(learned).max(1.0),
            (false, None) => after.max(1.0),
        }
    }
}

/// A set of effects as it fared.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Explained {
    /// Ids of its effects; empty for the vehicle file within its tolerances.
    pub effects: Vec<String>,
    /// Its fitted numbers.
    pub numbers: Vec<Found>,
    /// All parameters of its effects, by effect and name.
    #[schemars(
        with = "BTreeMap<String, BTreeMap<String, crate::diagnose::verdict::parameter::Parameter>>"
    )]
    pub parameters: BTreeMap<String, BTreeMap<String, ParameterValue>>,
    /// Log density of each block, nats.
    pub blocks: Vec<f64>,
    /// Standard deviation of the evidence that chance gives its effects, nats.
    pub chance: f64,
    /// The gap on the flights for choosing.
    pub choosing: Option<Gaps>,
    /// The same on the flights reported on.
    pub reported: Option<Gaps>,
}

impl Explained {
    /// The squared gap on the flights for choosing, 1 at least: the file's numbers need not be off.
    pub fn choosing_square(&self) -> Option<f64> {
        self.choosing.map(Gaps::square)
    }

    /// Whether the number that is furthest from the file's, in its errors, lies at the end of what
    /// occurs.
    pub fn is_at_bound(&self) -> bool {
        let off = |number: &&Found| {
            (number.value - number.reference).abs() / number.deviation.max(f64::MIN_POSITIVE)
        };
        let furthest = self.numbers.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
        furthest.is_some_and(|number| number.is_at_bound)
    }

    /// Whether an effect is of practical size: a number of it is further off the file's than the
    /// file's errors bring about, more than three tolerances, and than its own error. What is not is the
    /// file's.
    pub fn is_practical(&self, effect: &str) -> bool {
        let mut own = self.numbers.iter().filter(|number| number.effect == effect);
        own.any(|number| {
            let least = (TOLERANCES_MAX * number.unremarkable).max(number.deviation);
            (number.value - number.reference).abs() > least
        })
    }

    /// The squared gap on the flights reported on, 1 at least.
    pub fn reported_square(&self) -> Option<f64> {
        self.reported.map(Gaps::square)
    }

    /// Log evidence of all flights but those reported on, nats.
    pub fn score(&self) -> f64 {
        self.blocks.iter().sum()
    }
}

/// The gap with parts of an explanation, in units of what noise alone leaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Gaps {
    /// With its effects alone.
    pub effects: f64,
    /// With its numbers of the vehicle file alone.
    pub file: f64,
    /// With both.
    pub both: f64,
    /// The same of each part of the metric: the gap is their mean.
    #[serde(default)]
    pub parts: [f64; PARTS_MAX],
}

impl Gaps {
    /// Of the errors with the effects alone, the file's numbers alone, and both.
    pub(in crate::diagnose) fn over(
        [effects, file, both]: [Errors; 3],
        floor: &Errors,
        metric: Metric,
    ) -> Self {
        let [effects, file, gap] = [effects, file, both].map(|errors| errors.over(floor, metric));
        Self { effects, file, both: gap, parts: both.parts_over(floor, metric) }
    }

    /// Whether the effects by themselves make a gap of `shipped` worse, by more than the vehicle
    /// file's numbers, which are off too, could make up for: `file` are the gaps with those alone.
    pub fn is_worse(self, shipped: f64, file: Gaps) -> bool {
        let shipped = shipped * shipped;
        let off = (shipped - file.file.powi(2)).max(0.0);
        self.effects.powi(2) - shipped > MADE_UP * off
    }

    /// The smaller squared gap with the effects, 1 at least.
    fn square(self) -> f64 {
        self.both.min(self.effects).powi(2).max(1.0)
    }
}

/// A number of an effect.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Found {
    /// The effect.
    pub effect: String,
    /// Its number.
    pub name: String,
    /// As fitted, with its standard deviation.
    pub value: f64,
    /// See [`value`](Self::value).
    pub deviation: f64,
    /// As the vehicle file has it.
    pub reference: f64,
    /// Standard deviation of what the vehicle file's errors bring about of it.
    pub unremarkable: f64,
    /// A typical magnitude where its effect occurs.
    pub magnitude: f64,
    /// Whether the fit holds it at the end of its range.
    pub is_at_bound: bool,
}

/// A number of the vehicle file within its tolerance.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FileNumber {
    /// Its name.
    pub name: String,
    /// As fitted.
    pub value: f64,
    /// As the file has it, or the logs say directly.
    pub expected: f64,
    /// By how many tolerances these differ.
    pub tolerances: f64,
}

/// Force per mass that nothing explains.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ForceLeft {
    /// Root mean square that the best explanation leaves, m/s^2.
    pub rms: f64,
    /// Standard errors by which it stands out.
    pub significance: f64,
    /// In units of what moves a prediction by more than the reports are uncertain.
    pub size: f64,
}

impl ForceLeft {
    /// Standard errors by which a force must stand out.
    const SIGNIFICANT: f64 = 5.0;

    /// Whether it is more than chance, and matters.
    pub fn is_practical(self) -> bool {
        self.significance > Self::SIGNIFICANT && self.size > 1.0
    }
}
