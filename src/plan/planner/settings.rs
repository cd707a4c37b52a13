//! The settings of plans, and their limits.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::PlannerError;
use crate::control::Use;
use crate::plan::flight_box::FlightBox;
use crate::plan::keep_out::KeepOut;
use crate::plan::scp::ScpSettings;

/// How plans are made. Weights are per m, m/s, rad and rad/s.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSettings {
    /// Planned states per second, Hz.
    pub rate_hz: f64,
    /// The solver of the subproblems.
    pub solver: SolverChoice,
    /// Weights of position, velocity, attitude and body rate in the distance to the desired state.
    pub weight: [f64; 4],
    /// Weight of the inputs' distance to those that the desired trajectory needs without drag.
    pub input_weight: f64,
    /// Largest number of subproblems.
    pub subproblems_max: usize,
    /// Initial trust region, in units of the inputs' typical sizes.
    pub trust: f64,
    /// The search ends when four subproblems together improve the cost by less than this fraction.
    pub progress: f64,
    /// Time limit of the search, s; it returns the best plan so far.
    pub time_limit_s: f64,
    /// Plans that are renewed in flight.
    pub receding: RecedingSettings,
    /// Regions that the vehicle must avoid, relative to the take-off point.
    pub keep_out: Vec<KeepOutSetting>,
    /// Least and greatest north, east and down of the plan, relative to the take-off point, m.
    pub box_m: Option<[[f64; 3]; 2]>,
}

/// Timing and caution of plans that follow one another.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecedingSettings {
    /// Time from one plan to the next, s.
    pub period_s: f64,
    /// Length of a plan, s.
    pub horizon_s: f64,
    /// Time from the state that a plan starts from until its first input is sent, s: the time
    /// available for planning.
    pub lead_s: f64,
    /// Whether `knee` and `change_weight` apply. They suit vehicles whose on-board loop is the
    /// autopilot's own: the plan's model lacks its integrators and filters, and it acts through
    /// rotors that lag. A plan that trusts such a model, and a wandering estimate, uses every
    /// available input to remove the last millimetre, and the vehicle oscillates.
    pub cautious: Use,
    /// Distances to the desired state below this are squared (also in plans made before the flight,
    /// whose inputs would otherwise jump from period to period). A vehicle nearer than this to the
    /// previous plan is left to feedback: the next plan continues the previous one. In units of the
    /// weighted state.
    pub knee: f64,
    /// Weight of the inputs' distance to those of the previous plan: it suppresses what one plan
    /// asks for and the next does not.
    pub change_weight: f64,
    /// Largest number of subproblems of a plan. With damped steps, the first plan may take as many
    /// as a plan before the flight.
    pub subproblems_max: usize,
    /// Cost of the square of a subproblem's step in the inputs, each over its typical size. Above
    /// 0, it keeps steps small in place of the trust region: one sweep solves most subproblems, and
    /// one such subproblem suffices for a plan that continues one a few milliseconds older.
    pub damping: f64,
}

impl Default for RecedingSettings {
    fn default() -> Self {
        Self {
            period_s: 0.1,
            horizon_s: 1.0,
            lead_s: 0.05,
            cautious: Use::Auto,
            knee: 0.2,
            change_weight: 1.0,
            subproblems_max: 6,
            damping: 0.0,
        }
    }
}

impl RecedingSettings {
    /// Resolves `cautious` for a vehicle whose on-board loop is (`is_own_loop`) or is not its
    /// autopilot's own.
    pub fn for_loop(self, is_own_loop: bool) -> Self {
        let cautious = if self.cautious.applies(is_own_loop) { Use::On } else { Use::Off };
        Self { cautious, ..self }
    }

    /// The knee and the weight of changes, if plans are cautious.
    pub(in crate::plan) fn caution(&self) -> Option<(f64, f64)> {
        (self.cautious == Use::On).then_some((self.knee, self.change_weight))
    }
}

/// The solver of a search's subproblems.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum SolverChoice {
    /// The Riccati interior-point method.
    #[default]
    InteriorPoint,
    /// Clarabel, with the dynamics as equality constraints.
    Clarabel,
    /// Clarabel, with the dynamics under an l1 penalty (Schulman et al. 2013; Bansal et al. 2016).
    Penalty,
}

/// A region to avoid. Give exactly one of the two.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum KeepOutSetting {
    /// A ball.
    Sphere {
        /// North, east, down, m.
        centre_m: [f64; 3],
        /// m
        radius_m: f64,
    },
    /// A box aligned with the world's axes.
    Box {
        /// Least north, east, down, m.
        lower_m: [f64; 3],
        /// Greatest north, east, down, m.
        upper_m: [f64; 3],
    },
}

impl Default for PlanSettings {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            solver: SolverChoice::default(),
            weight: [1.0, 0.5, 0.2, 0.05],
            input_weight: 1e-3,
            subproblems_max: 60,
            trust: 0.5,
            progress: 1e-3,
            time_limit_s: 8.0,
            receding: RecedingSettings::default(),
            keep_out: Vec::new(),
            box_m: None,
        }
    }
}

impl PlanSettings {
    /// The box that bounds the plan.
    pub(in crate::plan) fn room(&self) -> Option<FlightBox> {
        self.box_m.map(|[lower, upper]| FlightBox { lower: lower.into(), upper: upper.into() })
    }

    /// The settings of the search.
    pub fn search(&self) -> ScpSettings {
        ScpSettings {
            subproblems_max: self.subproblems_max,
            trust: self.trust,
            progress: self.progress,
            ..ScpSettings::default()
        }
    }
}

impl From<KeepOutSetting> for KeepOut {
    fn from(setting: KeepOutSetting) -> Self {
        match setting {
            KeepOutSetting::Sphere { centre_m, radius_m } => {
                Self::Sphere { centre: centre_m.into(), radius: radius_m }
            }
            KeepOutSetting::Box { lower_m, upper_m } => {
                Self::Box { lower: lower_m.into(), upper: upper_m.into() }
            }
        }
    }
}

impl PlanSettings {
    /// Checks that every setting is within its range.
    pub(super) fn check(&self) -> Result<(), PlannerError> {
        within("rate_hz", self.rate_hz, [1.0, 1000.0], "1 to 1000 Hz")?;
        within("input_weight", self.input_weight, [1e-9, 1e9], "a weight above 0")?;
        within("trust", self.trust, [1e-6, 1e3], "a size above 0")?;
        within("progress", self.progress, [0.0, 1.0], "a share")?;
        self.receding.check()?;
        within("subproblems_max", self.subproblems_max as f64, [1.0, 1e6], "1 or more")?;
        within("time_limit_s", self.time_limit_s, [0.0, 1e9], "a time of at least 0")?;
        for weight in self.weight {
            within("weight", weight, [0.0, 1e6], "weights of at least 0")?;
        }
        if self.weight.iter().all(|weight| *weight == 0.0) {
            return Err(PlannerError::Setting {
                field: "weight",
                expected: "a weight above 0",
                found: 0.0,
            });
        }
        if let Some([lower, upper]) = self.box_m {
            for (lower, upper) in lower.into_iter().zip(upper) {
                within("box_m", upper - lower, [0.0, f64::MAX], "upper not below lower")?;
            }
        }
        self.keep_out.iter().try_for_each(KeepOutSetting::check)
    }
}

impl RecedingSettings {
    fn check(&self) -> Result<(), PlannerError> {
        let Self {
            period_s,
            horizon_s,
            lead_s,
            cautious: _,
            knee,
            change_weight,
            subproblems_max,
            damping,
        } = *self;
        within("receding.period_s", period_s, [1e-3, 10.0], "1 ms to 10 s")?;
        within("receding.horizon_s", horizon_s, [0.05, 60.0], "0.05 to 60 s")?;
        within("receding.lead_s", lead_s, [0.0, 0.5 * horizon_s], "at most half the horizon")?;
        within("receding.knee", knee, [0.0, 1e3], "a distance of at least 0")?;
        within("receding.change_weight", change_weight, [0.0, 1e9], "a weight of at least 0")?;
        within("receding.damping", damping, [0.0, 1e9], "a weight of at least 0")?;
        within("receding.subproblems_max", subproblems_max as f64, [1.0, 1e4], "1 or more")
    }
}

impl KeepOutSetting {
    fn check(&self) -> Result<(), PlannerError> {
        match self {
            Self::Sphere { centre_m, radius_m } => {
                within("keep_out.sphere", *radius_m, [0.0, 1e6], "a radius of at least 0")?;
                for c in centre_m {
                    within("keep_out.sphere", *c, [-1e6, 1e6], "a position")?;
                }
            }
            Self::Box { lower_m, upper_m } => {
                for (lower, upper) in lower_m.iter().zip(upper_m) {
                    within("keep_out.box", upper - lower, [0.0, 1e6], "upper not below lower")?;
                    within("keep_out.box", *lower, [-1e6, 1e6], "a position")?;
                }
            }
        }
        Ok(())
    }
}

/// Checks that a setting is in a range, ends included.
fn within(
    field: &'static str,
    value: f64,
    [least, most]: [f64; 2],
    expected: &'static str,
) -> Result<(), PlannerError> {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(PlannerError::Setting { field, expected, found: value })
    }
}
