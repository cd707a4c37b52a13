//! From a desired trajectory and a model to a plan.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::AttitudePd;
use vehicle::frame::Ned;

use super::conic::Conic;
use super::desire::{Desire, Weight};
use super::detour::bend;
use super::discretisation::CommandedDynamics;
use super::interior_point::InteriorPoint;
use super::iterate::Iterate;
use super::keep_out::KeepOut;
use super::planned::PlannedBody;
use super::problem::{
    ANGLE, InputBounds, InputPreference, Problem, STATES, StateLimits, StateVector, YAW,
};
use super::scp::{Outcome, Record, ScpSettings, search};
use super::subproblem::SubproblemSolver;
use super::trajectory::{DesiredPoint, Trajectory};
use crate::control::{Limits, Use};
use crate::model::Model;

/// How plans are made. Weights are per m, m/s, rad and rad/s.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSettings {
    /// Planned states a second.
    pub rate_hz: f64,
    /// What solves the subproblems.
    pub solver: SolverChoice,
    /// Weights of position, velocity, attitude and body rate in the distance to the desired state.
    pub weight: [f64; 4],
    /// Weight of the inputs' distance to those that the desired trajectory would need without air.
    pub input_weight: f64,
    /// Most subproblems.
    pub subproblems_max: usize,
    /// First trust region, in units of the inputs' typical sizes.
    pub trust: f64,
    /// The search ends where four subproblems together improve the cost by less than this share.
    pub progress: f64,
    /// The search ends with what it has before it takes longer than this, s.
    pub time_limit_s: f64,
    /// Plans that are made anew in flight.
    pub receding: RecedingSettings,
    /// Regions that the vehicle keeps out of, relative to the take-off point.
    pub keep_out: Vec<KeepOutSetting>,
    /// Least and greatest north, east and down of the plan, relative to the take-off point, m.
    pub box_m: Option<[[f64; 3]; 2]>,
}

/// How plans follow one another.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecedingSettings {
    /// Time from one plan to the next, s.
    pub period_s: f64,
    /// Length of a plan, s.
    pub horizon_s: f64,
    /// From the state that a plan is made from to where its first input is sent, s: the time that
    /// planning may take.
    pub lead_s: f64,
    /// Whether plans are made as below: where the on-board loop is an autopilot's own, which a plan's
    /// model has without its integrals and filters, and which answers through rotors that lag. A
    /// plan that trusts such a model, and an estimate that wanders, gives every input that there is
    /// to be rid of the last millimetre, and the vehicle swings.
    pub cautious: Use,
    /// Distances to the desired state below this count by their square (also in plans that are made
    /// before the flight, whose inputs would jump from period to period), and a vehicle that is
    /// nearer than this to the plan before is left to feedback: the next plan goes on from there.
    /// In units of the weighted state.
    pub knee: f64,
    /// Weight of the inputs' distance to those of the plan before: what one plan alone asks for,
    /// which the next will not, is hardly flown.
    pub change_weight: f64,
    /// Most subproblems of a plan. Of the first plan as many as of one before the flight, where steps
    /// are damped.
    pub subproblems_max: usize,
    /// Cost of the square of a subproblem's step in the inputs, each over its typical size. Above 0 it
    /// keeps steps small in place of the trust region, so that one sweep solves most subproblems, and
    /// one subproblem of this kind makes a plan that goes on from one a few milliseconds older.
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
    /// For a vehicle whose on-board loop is its autopilot's own or not.
    pub fn for_loop(self, is_own_loop: bool) -> Self {
        let cautious = if self.cautious.applies(is_own_loop) { Use::On } else { Use::Off };
        Self { cautious, ..self }
    }

    /// The knee and the weight of changes as they act.
    pub(super) fn caution(&self) -> Option<(f64, f64)> {
        (self.cautious == Use::On).then_some((self.knee, self.change_weight))
    }
}

/// What solves the subproblems of a search.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum SolverChoice {
    /// The Riccati interior point.
    #[default]
    InteriorPoint,
    /// Clarabel, the dynamics as equations.
    Clarabel,
    /// Clarabel, the dynamics with an l1 penalty (Schulman et al. 2013; Bansal et al. 2016).
    Penalty,
}

/// A region to keep out of. Exactly one of the two is given.
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
    /// A box along the world's axes.
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
    /// The corners of the box to stay in, m.
    pub(super) fn room(&self) -> Option<(Ned, Ned)> {
        self.box_m.map(|[lower, upper]| (ned(lower), ned(upper)))
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

/// Why no plan can be searched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlannerError {
    /// A number of the settings is impossible.
    #[error("[plan] {field}: expected {expected}, found {found}")]
    Setting {
        /// The field.
        field: &'static str,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: f64,
    },
    /// The trajectory has numbers that are none.
    #[error("trajectory {trajectory}: the desired state at {at_s:.2} s is not finite")]
    NotFinite {
        /// The trajectory.
        trajectory: String,
        /// When.
        at_s: f64,
    },
    /// The trajectory is longer than can be planned at once.
    #[error(
        "trajectory {trajectory}: expected at most {limit_s:.0} s to plan, found {found_s:.0} s; \
         {cure}plan it in parts or with a lower [plan] rate_hz, or fly it without a plan, or with \
         `downwash fly --replan`, which plans ahead in flight"
    )]
    TooLong {
        /// The trajectory.
        trajectory: String,
        /// Longest.
        limit_s: f64,
        /// Its length.
        found_s: f64,
        /// What lets it be planned, if anything does.
        cure: String,
    },
}

/// What plans are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedVehicle {
    /// Its effective numbers.
    pub body: PlannedBody,
    /// The on-board loop.
    pub attitude_pd: AttitudePd,
    /// Bounds of the setpoint.
    pub limits: Limits,
}

/// Makes plans for one vehicle through one model.
#[derive(Clone)]
pub struct Planner {
    model: Arc<dyn Model>,
    vehicle: PlannedVehicle,
    settings: PlanSettings,
    /// As of [`RecedingSettings`]; 0 for plans that follow none.
    knee: f64,
    change_weight: f64,
    damping: f64,
}

/// First trust region of a plan that goes on from another.
const NEAR: f64 = 0.1;
/// Trust region where steps are damped: it bounds nothing that the inputs' own bounds do not.
const TRUST_FREE: f64 = 1e2;

/// Most periods of a plan: whatever time there is for the search, and with all the time.
const PERIODS_MAX: [f64; 2] = [10_000.0, 60_000.0];
/// Periods of a plan for each second of the search's time, beyond the first of these: a subproblem
/// takes a tenth of a millisecond a period, and fewer than eight of them make no plan.
const PERIODS_IN_A_SECOND: f64 = 1250.0;
/// How far the planned yaw and the commanded one may leave the range of the desired, rad.
const YAW_ROOM: f64 = 1.0;

impl Planner {
    /// A planner.
    ///
    /// # Errors
    /// [`PlannerError::Setting`].
    pub fn new(
        model: Arc<dyn Model>,
        vehicle: PlannedVehicle,
        settings: PlanSettings,
    ) -> Result<Self, PlannerError> {
        settings.check()?;
        Ok(Self { model, vehicle, settings, knee: 0.0, change_weight: 0.0, damping: 0.0 })
    }

    /// The same with the knee of these settings, where they are cautious.
    #[must_use]
    pub fn cautious(mut self, receding: &RecedingSettings) -> Self {
        self.knee = receding.caution().map_or(0.0, |(knee, _)| knee);
        self
    }

    /// The same for plans that begin as the last one goes on: a small trust region, for they are
    /// near already, and an end where little is gained.
    pub fn replanning(mut self, receding: &RecedingSettings) -> Self {
        self.settings.subproblems_max = receding.subproblems_max;
        self.settings.trust =
            if receding.damping > 0.0 { TRUST_FREE } else { self.settings.trust.min(NEAR) };
        self.settings.progress = self.settings.progress.max(1e-2);
        (self.knee, self.change_weight) = receding.caution().unwrap_or_default();
        self.damping = receding.damping;
        self
    }

    /// The same for the first of such plans. Where one subproblem makes a plan, the first, which has
    /// none to go on from, is searched to its end.
    pub fn first_of_replanning(self, receding: &RecedingSettings) -> Self {
        if receding.damping <= 0.0 {
            return self.replanning(receding);
        }
        let subproblems_max = self.settings.subproblems_max;
        self.replanning(&RecedingSettings { subproblems_max, damping: 0.0, ..*receding })
    }

    /// `seen` less what of its weighted distance to `planned` is within `knee`.
    pub(super) fn beyond(
        &self,
        planned: &StateVector,
        seen: &StateVector,
        knee: f64,
    ) -> StateVector {
        let weight = self.state_weight();
        let square: f64 = (0..STATES).map(|i| (weight[i] * (seen[i] - planned[i])).powi(2)).sum();
        let distance = square.sqrt();
        let share = if distance > knee { 1.0 - knee / distance } else { 0.0 };
        std::array::from_fn(|i| planned[i] + share * (seen[i] - planned[i]))
    }

    fn state_weight(&self) -> StateVector {
        let [position, velocity, attitude, rate] = self.settings.weight;
        let mut weights = [0.0; STATES];
        for (weights, weight) in weights.chunks_mut(3).zip([position, velocity, attitude, rate]) {
            weights.fill(weight);
        }
        weights
    }

    /// What is planned through.
    pub fn model(&self) -> &dyn Model {
        self.model.as_ref()
    }

    /// The vehicle's effective numbers.
    pub fn body(&self) -> &PlannedBody {
        &self.vehicle.body
    }

    /// The vehicle's effective weight m g, N.
    pub fn hover_thrust_n(&self) -> f64 {
        self.vehicle.body.mass_kg * self.vehicle.body.gravity
    }

    /// Time between states, s.
    pub fn period_s(&self) -> f64 {
        1.0 / self.settings.rate_hz
    }

    /// The desired states of a trajectory.
    ///
    /// # Errors
    /// A trajectory that is too long, or with numbers that are not finite.
    pub fn desire(&self, trajectory: &Trajectory) -> Result<Desire, PlannerError> {
        let [least, most] = PERIODS_MAX;
        let limit_s =
            (self.settings.time_limit_s * PERIODS_IN_A_SECOND).clamp(least, most) * self.period_s();
        let found_s = trajectory.duration();
        if found_s > limit_s {
            let needed = found_s / self.period_s();
            let cure = match needed <= most {
                true => format!(
                    "give the search {:.0} s by --time-limit or [plan] time_limit_s, or ",
                    (needed / PERIODS_IN_A_SECOND).ceil()
                ),
                false => String::new(),
            };
            let trajectory = trajectory.name().to_owned();
            return Err(PlannerError::TooLong { trajectory, limit_s, found_s, cure });
        }
        let periods = ((trajectory.duration() / self.period_s()).round() as usize).max(1);
        self.desire_from(trajectory, 0.0, periods)
    }

    /// The desired states of a part of a trajectory, which is held at its end.
    ///
    /// # Errors
    /// Numbers that are not finite.
    pub fn desire_from(
        &self,
        trajectory: &Trajectory,
        from_s: f64,
        periods: usize,
    ) -> Result<Desire, PlannerError> {
        let desire = Desire::new(trajectory, from_s, self.period_s(), periods, &self.weight());
        let bad = desire.states.iter().position(|state| !state.iter().all(|v| v.is_finite()));
        match bad {
            None => Ok(desire),
            Some(n) => Err(PlannerError::NotFinite {
                trajectory: trajectory.name().to_owned(),
                at_s: from_s + n as f64 * self.period_s(),
            }),
        }
    }

    fn weight(&self) -> Weight {
        Weight {
            mass_kg: self.vehicle.body.mass_kg,
            gravity: self.vehicle.body.gravity,
            tilt_max_rad: self.vehicle.limits.tilt_max_rad,
        }
    }

    /// Where a search begins: the desired states and inputs, or where they cross a region to keep
    /// out of, those of a path round it.
    fn guess(&self, desire: &Desire, problem: &Problem<7>) -> Iterate<7> {
        let (mut states, period_s) = (desire.states.clone(), self.period_s());
        if !bend(&mut states, period_s, &problem.keep_out, &problem.limits) {
            return Iterate { states, inputs: desire.inputs.clone() };
        }
        let velocity = |n: usize| Ned::new(states[n][3], states[n][4], states[n][5]);
        let last = states.len() - 1;
        let points = (0..states.len()).map(|n| {
            let state = &states[n];
            DesiredPoint {
                position: Ned::new(state[0], state[1], state[2]),
                velocity: velocity(n),
                acceleration: (velocity((n + 1).min(last)) - velocity(n)) * (1.0 / period_s),
                yaw: state[YAW],
                yaw_rate: 0.0, // follows from yaw
            }
        });
        let Desire { states, inputs } = Desire::along(points, period_s, &self.weight());
        Iterate { states, inputs }
    }

    /// The problem of following desired states from `start`.
    pub fn problem(&self, desire: &Desire, start: StateVector) -> Problem<7> {
        Problem {
            period_s: self.period_s(),
            start,
            desired: desire.states[1..].to_vec(),
            state_weight: self.state_weight(),
            knee: self.knee,
            inputs: self.bounds(desire),
            preference: Some(InputPreference {
                weight: self.settings.input_weight,
                inputs: desire.inputs.clone(),
            }),
            limits: StateLimits {
                tilt_max_rad: Some(self.vehicle.limits.tilt_max_rad),
                body_rate_max_rad_s: Some([self.vehicle.limits.body_rate_max_rad_s; 3]),
                position: self.settings.room(),
            },
            keep_out: self.keep_out().collect(),
        }
    }

    /// The regions to keep out of.
    pub(super) fn keep_out(&self) -> impl Iterator<Item = KeepOut> + '_ {
        self.settings.keep_out.iter().map(|region| KeepOut::from(*region))
    }

    fn bounds(&self, desire: &Desire) -> InputBounds<7> {
        let Limits {
            thrust_min, thrust_max, tilt_max_rad: tilt, body_rate_max_rad_s: rate, ..
        } = self.vehicle.limits;
        let full = self.vehicle.body.thrust_full_n;
        let yaws = desire.states.iter().map(|state| state[ANGLE + 2]);
        let (least, most) = yaws.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), yaw| {
            (least.min(yaw), most.max(yaw))
        });
        let (least, most) = (least - YAW_ROOM, most + YAW_ROOM);
        let hover = self.hover_thrust_n();
        InputBounds {
            lower: [thrust_min * full, -tilt, -tilt, least, -rate, -rate, -rate],
            upper: [thrust_max * full, tilt, tilt, most, rate, rate, rate],
            scale: [hover, ANGLE_SIZE, ANGLE_SIZE, ANGLE_SIZE, RATE_SIZE, RATE_SIZE, RATE_SIZE],
        }
    }

    /// Searches the inputs that lead along desired states from `start`. `guess` is where the
    /// search begins, of the same length; without one, the desired states, bent round the regions
    /// to keep out of, and the desired inputs.
    pub fn plan(
        &self,
        desire: &Desire,
        start: StateVector,
        guess: Option<Iterate<7>>,
        stop: &dyn Fn(&[Record]) -> bool,
    ) -> Outcome<7> {
        let mut problem = self.problem(desire, start);
        let mut guess = guess.unwrap_or_else(|| self.guess(desire, &problem));
        // A first plan has none before it: what few subproblems leave of it must be flyable too.
        if let Some(preference) = &mut problem.preference {
            preference.pull_to(&guess.inputs, self.change_weight);
        }
        let dynamics =
            CommandedDynamics::new(self.model(), self.vehicle.attitude_pd, self.period_s());
        guess.states[0] = start;
        for input in &mut guess.inputs {
            *input = problem.inputs.clamp(*input);
        }
        let mut solver: Box<dyn SubproblemSolver<7>> = match self.settings.solver {
            SolverChoice::InteriorPoint => Box::new(InteriorPoint::default()),
            SolverChoice::Clarabel => Box::new(Conic::equations()),
            SolverChoice::Penalty => Box::new(Conic::penalised()),
        };
        let settings = ScpSettings { damping: self.damping, ..self.settings.search() };
        search(&problem, &dynamics, solver.as_mut(), &settings, guess, stop)
    }
}

/// Typical sizes of the attitude and body rate setpoints, rad and rad/s.
const ANGLE_SIZE: f64 = 0.3;
const RATE_SIZE: f64 = 3.0;

fn ned([n, e, d]: [f64; 3]) -> Ned {
    Ned::new(n, e, d)
}

impl From<KeepOutSetting> for KeepOut {
    fn from(setting: KeepOutSetting) -> Self {
        match setting {
            KeepOutSetting::Sphere { centre_m, radius_m } => {
                Self::Sphere { centre: ned(centre_m), radius: radius_m }
            }
            KeepOutSetting::Box { lower_m, upper_m } => {
                Self::Box { lower: ned(lower_m), upper: ned(upper_m) }
            }
        }
    }
}

impl PlanSettings {
    fn check(&self) -> Result<(), PlannerError> {
        let within = |field, value: f64, least: f64, most: f64, expected| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(PlannerError::Setting { field, expected, found: value })
            }
        };
        within("rate_hz", self.rate_hz, 1.0, 1000.0, "1 to 1000 Hz")?;
        within("input_weight", self.input_weight, 1e-9, 1e9, "a weight above 0")?;
        within("trust", self.trust, 1e-6, 1e3, "a size above 0")?;
        within("progress", self.progress, 0.0, 1.0, "a share")?;
        let RecedingSettings {
            period_s,
            horizon_s,
            lead_s,
            cautious: _,
            knee,
            change_weight,
            subproblems_max,
            damping,
        } = self.receding;
        within("receding.period_s", period_s, 1e-3, 10.0, "1 ms to 10 s")?;
        within("receding.horizon_s", horizon_s, 0.05, 60.0, "0.05 to 60 s")?;
        within("receding.lead_s", lead_s, 0.0, 0.5 * horizon_s, "at most half the horizon")?;
        within("receding.knee", knee, 0.0, 1e3, "a distance of at least 0")?;
        within("receding.change_weight", change_weight, 0.0, 1e9, "a weight of at least 0")?;
        within("receding.damping", damping, 0.0, 1e9, "a weight of at least 0")?;
        within("receding.subproblems_max", subproblems_max as f64, 1.0, 1e4, "1 or more")?;
        within("subproblems_max", self.subproblems_max as f64, 1.0, 1e6, "1 or more")?;
        within("time_limit_s", self.time_limit_s, 0.0, 1e9, "a time of at least 0")?;
        for weight in self.weight {
            within("weight", weight, 0.0, 1e6, "weights of at least 0")?;
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
                within("box_m", upper - lower, 0.0, f64::MAX, "a greatest not below the least")?;
            }
        }
        for region in &self.keep_out {
            match region {
                KeepOutSetting::Sphere { centre_m, radius_m } => {
                    within("keep_out.sphere", *radius_m, 0.0, 1e6, "a radius of at least 0")?;
                    for c in centre_m {
                        within("keep_out.sphere", *c, -1e6, 1e6, "a position")?;
                    }
                }
                KeepOutSetting::Box { lower_m, upper_m } => {
                    for (lower, upper) in lower_m.iter().zip(upper_m) {
                        within("keep_out.box", upper - lower, 0.0, 1e6, "upper not below lower")?;
                        within("keep_out.box", *lower, -1e6, 1e6, "a position")?;
                    }
                }
            }
        }
        Ok(())
    }
}
