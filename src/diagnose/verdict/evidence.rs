//! The evidence: how each explanation fares on the flights, in plain numbers.
//!
//! [`decide`](crate::diagnose::verdict::decide) reads nothing else, so any decision can be repeated
//! from a file.

use std::collections::BTreeMap;
use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::effects::ParameterValue;

use crate::diagnose::catalogue::hypothesis::TOLERANCES_MAX;
use crate::diagnose::likelihood::equation_residual::EquationResidual;
use crate::diagnose::search::rotation_prediction::RotationPrediction;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::simulate::metric::{Metric, PARTS_MAX};

/// Most that effects alone may add to a squared gap, as a share of the reduction by the file's
/// numbers. True effects may add to it where the file is off, since its errors can cancel them.
const COMPENSATED_SHARE_MAX: f64 = 0.5;

/// Share of an equation's residual that an effect must close to count by that equation.
pub(super) const EQUATION_SHARE_MIN: f64 = 2.0 / 3.0;

/// Index of the flights for choosing, and of the held-out flights, in pairs of both.
pub(super) const CHOOSING: usize = 0;
pub(super) const HELD_OUT: usize = 1;

/// Everything that a verdict rests on.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Evidence {
    /// Whether the on-board loop is known: setpoints then drive the predictions.
    pub loop_known: bool,
    /// Name of the metric of every gap here.
    pub metric: String,
    /// Scale of the tolerances that the vehicle file does not state.
    pub scale: f64,
    /// Each scale that was tried, with its log evidence, nats.
    pub scales: Vec<[f64; 2]>,
    /// How well moments predict the angular acceleration about front, right and down.
    pub turning: [RotationPrediction; 3],
    /// Number of blocks of the flights for fitting, which come first in each explanation's blocks.
    pub fitted_blocks: usize,
    /// Predicted length of the flights for choosing, s.
    pub chosen_s: f64,
    /// The fitted explanations: first the vehicle file within its tolerances, then sets of effects,
    /// the best first.
    pub explanations: Vec<Explained>,
    /// The vehicle file's numbers as the file alone explains the flights for fitting, the furthest
    /// off first.
    #[serde(default)]
    pub file_numbers: Vec<FileNumber>,
    /// The gap as shipped on the flights for choosing and on the held-out flights, in units of the
    /// floor.
    pub shipped: [Option<f64>; 2],
    /// The measured rotation on the flights for choosing and on the held-out flights.
    #[serde(default)]
    pub rotation: [MeasuredRotation; 2],
    /// Scatter that noise alone gives the gap on the held-out flights.
    pub scatter: f64,
    /// The gap on the held-out flights with the best explanation and the corrections of a flexible
    /// learner.
    pub learned: Option<f64>,
    /// Share of the residual force and moment of the best explanation that a flexible learner
    /// predicts on data it did not learn from; 0 where none could learn.
    pub structure: [f64; 2],
    /// Whether the pack's voltage varies enough to distinguish a sag from another level of the
    /// thrust.
    pub voltage_differs: bool,
    /// Whether motor outputs or rotor speeds are logged. Without them only the on-board loop
    /// determines a moment, and its scale, the loop's gain and the inertia act alike.
    #[serde(default = "logged")]
    pub outputs_logged: bool,
    /// Force that nothing explains, where velocity and accelerometer agree on it.
    pub force: Option<ForceLeft>,
    /// Standard deviation of gusts that would cause the force, where it looks like turbulence, m/s.
    pub gusts_m_s: Option<f64>,
    /// Share of that force, horizontally, that the pull of a load on a line would explain.
    #[serde(default)]
    pub slung_load: f64,
}

/// The value for stored evidence that predates the field.
fn logged() -> bool {
    true
}

impl Evidence {
    /// Log odds of each explanation against the vehicle file within its tolerances, nats: the
    /// evidence of the flights for fitting, plus the gain in predicting those for choosing.
    ///
    /// Prediction errors are normal with unknown variance, three a second (one an axis): `3 s / 2
    /// ln(v_file / v)` of the squared gaps v.
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

    /// Whether an explanation's effects make predictions worse on the flights for choosing or on the
    /// held-out ones (`flights`: `CHOOSING` or `HELD_OUT`). Not where they close an equation: other
    /// errors of the predictions, such as wrong moments, may then grow with them.
    pub fn is_worse(&self, own: &Explained, flights: usize) -> bool {
        let Some(file) = self.explanations.first() else { return false };
        let gaps = |of: &Explained| [of.choosing, of.reported][flights];
        let all = self.shipped[flights].zip(gaps(file)).zip(gaps(own));
        all.is_some_and(|((shipped, file), own)| own.is_worse(shipped, file))
            && self.equation_share(own, file, flights) <= EQUATION_SHARE_MIN
    }

    /// The largest share of an equation's residual that `more` closes and `less` leaves, at most 1;
    /// 0 where it closes none or nothing is known. The equations are those of the rotation about an
    /// axis, of the collective, and of the moments that the on-board loop commands. Predictions of
    /// the position hardly show a moment that feedback holds. `flights` is `CHOOSING` or `HELD_OUT`.
    pub fn equation_share(&self, more: &Explained, less: &Explained, flights: usize) -> f64 {
        let equations = more.equations[flights].zip(less.equations[flights]);
        let Some((more, less)) = equations else { return 0.0 };
        let rotation = self.rotation[flights].share(more.rotation, less.rotation);
        let command = |of: Range<usize>| {
            let sum = |all: [f64; 4]| all[of.clone()].iter().sum::<f64>();
            1.0 - sum(more.command) / sum(less.command)
        };
        // A share of an equation that is not used is not a number.
        [rotation, command(0..1), command(1..4)].into_iter().fold(0.0, f64::max)
    }

    /// Whether an explanation is ruled out: its most certain number is at the end of its range, or
    /// its effects worsen the predictions of the flights for choosing.
    pub fn is_implausible(&self, explained: &Explained) -> bool {
        explained.is_at_bound() || self.is_worse(explained, CHOOSING)
    }

    /// The squared gap from noise on the held-out flights, where the best explanation leaves
    /// `after`.
    ///
    /// With a known on-board loop, noise is the floor of simulated sensors (1), plus what no
    /// flexible learner can predict, unless two sensors agree on a force. Without one, sensor noise
    /// is only a part: the attitude's slow error pushes every prediction.
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

/// Measured angular acceleration about front, right and down, as mean squares in rad^2/s^4.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct MeasuredRotation {
    /// Mean square.
    pub measured: [f64; 3],
    /// The part from the gyro's noise.
    pub noise: [f64; 3],
}

/// Least share of the body's rotation about an axis that an effect must explain to count by it.
const ROTATION_SHARE_MIN: f64 = 0.01;

impl MeasuredRotation {
    /// The share of the residual beyond the gyro's noise that `more` closes and `less` leaves, about
    /// the axis where it is largest. Only axes count of which one of them explains at least half of
    /// the rotation: an explanation that shrinks wrong moments closes much of their residual and
    /// explains no rotation. 0 where `more` leaves more over all of these.
    pub fn share(&self, more: [f64; 3], less: [f64; 3]) -> f64 {
        let beyond = |of: f64, axis: usize| (of - self.noise[axis]).max(0.0);
        let (mut largest, mut total) = (0.0_f64, 0.0);
        for axis in 0..3 {
            let measured = beyond(self.measured[axis], axis);
            let [more, less] = [more, less].map(|left| beyond(left[axis], axis));
            if less > 0.0 && more.min(less) <= 0.5 * measured {
                let closed = less - more;
                total += closed;
                if closed >= ROTATION_SHARE_MIN * measured {
                    largest = largest.max(closed / less);
                }
            }
        }
        if total > 0.0 { largest } else { 0.0 }
    }
}

/// A set of effects and how it fares.
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
    /// Log density of each block, nats: the flights for fitting, then those for choosing.
    pub blocks: Vec<f64>,
    /// Standard deviation of the evidence that chance gives its effects, nats.
    pub chance: f64,
    /// The gap on the flights for choosing.
    pub choosing: Option<Gaps>,
    /// The gap on the held-out flights.
    pub reported: Option<Gaps>,
    /// What it leaves of the equations of rotation and of the on-board loop on the flights for
    /// choosing and on the held-out flights.
    #[serde(default)]
    pub equations: [Option<EquationResidual>; 2],
}

impl Explained {
    /// The squared gap on the flights for choosing, at least 1. Without the file's numbers where
    /// that is smaller: they need not be off.
    pub fn choosing_square(&self) -> Option<f64> {
        self.choosing.map(Gaps::square)
    }

    /// Whether the number that is furthest from the file's value, in its standard errors, is at the
    /// end of its range.
    pub fn is_at_bound(&self) -> bool {
        let off = |number: &&Found| {
            (number.value - number.reference).abs() / number.deviation.max(f64::MIN_POSITIVE)
        };
        let furthest = self.numbers.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
        furthest.is_some_and(|number| number.is_at_bound)
    }

    /// Whether an effect is of practical size: one of its numbers is off the file's value by more
    /// than three standard deviations of the file's errors, and by more than its own standard
    /// error. Otherwise the file accounts for it.
    pub fn is_practical(&self, effect: &str) -> bool {
        let mut own = self.numbers.iter().filter(|number| number.effect == effect);
        own.any(|number| {
            let least = (TOLERANCES_MAX * number.unremarkable).max(number.deviation);
            (number.value - number.reference).abs() > least
        })
    }

    /// The squared gap on the held-out flights, at least 1.
    pub fn reported_square(&self) -> Option<f64> {
        self.reported.map(Gaps::square)
    }

    /// Log evidence of all flights except the held-out ones, nats.
    pub fn score(&self) -> f64 {
        self.blocks.iter().sum()
    }
}

/// The gap with parts of an explanation, in units of the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Gaps {
    /// With the effects alone.
    pub effects: f64,
    /// With the vehicle file's numbers too.
    pub both: f64,
    /// The gap with both in each part of the metric; `both` is their mean.
    #[serde(default)]
    pub parts: [f64; PARTS_MAX],
}

impl Gaps {
    /// From the errors with the effects alone, and with the file's numbers too.
    pub(in crate::diagnose) fn over(
        [effects, both]: [Errors; 2],
        floor: &Errors,
        metric: Metric,
    ) -> Self {
        let [effects, gap] = [effects, both].map(|errors| errors.over(floor, metric));
        Self { effects, both: gap, parts: both.parts_over(floor, metric) }
    }

    /// Whether the effects alone worsen a gap of `shipped` by more than the vehicle file's own
    /// errors could make up for. `file` holds the gaps of the file's fit.
    pub fn is_worse(self, shipped: f64, file: Gaps) -> bool {
        let shipped = shipped * shipped;
        let off = (shipped - file.both.powi(2)).max(0.0);
        self.effects.powi(2) - shipped > COMPENSATED_SHARE_MAX * off
    }

    /// The smaller squared gap with the effects, at least 1.
    pub(in crate::diagnose) fn square(self) -> f64 {
        self.both.min(self.effects).powi(2).max(1.0)
    }
}

/// A fitted number of an effect.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Found {
    /// Id of the effect.
    pub effect: String,
    /// Name of the number.
    pub name: String,
    /// The fitted value.
    pub value: f64,
    /// Standard deviation of the fitted value.
    pub deviation: f64,
    /// The vehicle file's value.
    pub reference: f64,
    /// Standard deviation that the vehicle file's errors give it.
    pub unremarkable: f64,
    /// Its typical magnitude where the effect occurs.
    pub magnitude: f64,
    /// Whether the fit holds it at the end of its range.
    pub is_at_bound: bool,
}

/// A number of the vehicle file within its tolerance.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FileNumber {
    /// Its name, after that of its effect where it has one.
    pub name: String,
    /// The fitted value.
    pub value: f64,
    /// The file's value, or the one that the logs show directly.
    pub expected: f64,
    /// Difference of the two in tolerances, with its sign.
    pub tolerances: f64,
}

/// Force per mass that nothing explains.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ForceLeft {
    /// Root mean square of the residual force of the best explanation, m/s^2.
    pub rms: f64,
    /// Significance in standard errors.
    pub significance: f64,
    /// Size relative to the least force that shifts a prediction beyond the reports' uncertainty.
    pub size: f64,
}

impl ForceLeft {
    /// Least significance of a force, in standard errors.
    const SIGNIFICANT: f64 = 5.0;

    /// Whether the force is significant and large enough to matter.
    pub fn is_practical(self) -> bool {
        self.significance > Self::SIGNIFICANT && self.size > 1.0
    }
}
