//! Plans from a desired trajectory and a model.

mod settings;

use std::sync::Arc;

use vehicle::AttitudePd;
use vehicle::frame::{Euler, Ned};

pub use self::settings::{KeepOutSetting, PlanSettings, RecedingSettings, SolverChoice};

use super::conic::Conic;
use super::desire::{Desire, Push, Weight};
use super::detour::bend;
use super::discretisation::CommandedDynamics;
use super::interior_point::InteriorPoint;
use super::iterate::Iterate;
use super::keep_out::KeepOut;
use super::planned::PlannedBody;
use super::problem::{
    InputBounds, InputPreference, Problem, STATES, StateLimits, StateVector, YAW,
};
use super::scp::{Outcome, Record, ScpSettings, search};
use super::subproblem::SubproblemSolver;
use super::trajectory::{DesiredPoint, Trajectory};
use crate::control::Limits;
use crate::model::Model;

/// Why no plan can be searched for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlannerError {
    /// A setting is out of range.
    #[error("[plan] {field}: expected {expected}, found {found}")]
    Setting {
        /// The field.
        field: &'static str,
        /// The accepted range.
        expected: &'static str,
        /// The value found.
        found: f64,
    },
    /// The trajectory has a desired state that is not finite.
    #[error("trajectory {trajectory}: the desired state at {at_s:.2} s is not finite")]
    NotFinite {
        /// The trajectory.
        trajectory: String,
        /// Time of the first such state, s.
        at_s: f64,
    },
    /// The trajectory is too long to plan in one search.
    #[error(
        "trajectory {trajectory}: expected at most {limit_s:.0} s to plan, found {found_s:.0} s; \
         {cure}plan it in parts or with a lower [plan] rate_hz, or fly it without a plan, or with \
         `downwash fly --replan`, which plans ahead in flight"
    )]
    TooLong {
        /// The trajectory.
        trajectory: String,
        /// The greatest length that can be planned, s.
        limit_s: f64,
        /// Its length, s.
        found_s: f64,
        /// How to make it possible, or empty.
        cure: String,
    },
}

/// The vehicle that plans are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedVehicle {
    /// Its effective parameters.
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
    /// As in [`RecedingSettings`]; 0 for plans made before the flight.
    knee: f64,
    change_weight: f64,
    damping: f64,
    /// Margin to regions and position bounds at each state, m.
    margin_m: Vec<f64>,
}

/// Initial trust region of a plan that continues another.
const NEAR: f64 = 0.1;
/// Trust region with damped steps: wide enough that only the inputs' own bounds act.
const TRUST_FREE: f64 = 1e2;

/// Most periods of a plan: the bound that holds for any time limit, and the absolute one.
const PERIODS_MAX: [f64; 2] = [10_000.0, 60_000.0];
/// Periods of a plan per second of the time limit, between these two bounds: a subproblem takes a
/// tenth of a millisecond per period, and a plan takes at least eight subproblems.
const PERIODS_IN_A_SECOND: f64 = 1250.0;
/// How far the planned and the commanded yaw may leave the range of the desired yaw, rad.
const YAW_ROOM: f64 = 1.0;

impl Planner {
    /// Checks the settings and builds a planner.
    ///
    /// # Errors
    /// [`PlannerError::Setting`].
    pub fn new(
        model: Arc<dyn Model>,
        vehicle: PlannedVehicle,
        settings: PlanSettings,
    ) -> Result<Self, PlannerError> {
        settings.check()?;
        let margin_m = Vec::new();
        Ok(Self { model, vehicle, settings, knee: 0.0, change_weight: 0.0, damping: 0.0, margin_m })
    }

    /// The same planner with the knee of these settings, if they are cautious.
    #[must_use]
    pub fn cautious(mut self, receding: &RecedingSettings) -> Self {
        self.knee = receding.caution().map_or(0.0, |(knee, _)| knee);
        self
    }

    /// Sets the margin (m) to regions and to the bounds of the position, one value for each state.
    #[must_use]
    pub fn within(self, margin_m: Vec<f64>) -> Self {
        Self { margin_m, ..self }
    }

    /// The same planner for plans that continue the previous one: a small trust region, because
    /// they start near the solution, and an end when little is gained.
    pub fn replanning(mut self, receding: &RecedingSettings) -> Self {
        self.settings.subproblems_max = receding.subproblems_max;
        self.settings.trust =
            if receding.damping > 0.0 { TRUST_FREE } else { self.settings.trust.min(NEAR) };
        self.settings.progress = self.settings.progress.max(1e-2);
        (self.knee, self.change_weight) = receding.caution().unwrap_or_default();
        self.damping = receding.damping;
        self
    }

    /// The same planner for the first of such plans. Where one subproblem makes a plan, the first
    /// plan has none to continue and is searched to its end.
    pub fn first_of_replanning(self, receding: &RecedingSettings) -> Self {
        if receding.damping <= 0.0 {
            return self.replanning(receding);
        }
        let subproblems_max = self.settings.subproblems_max;
        self.replanning(&RecedingSettings { subproblems_max, damping: 0.0, ..*receding })
    }

    /// `seen`, moved towards `planned` by `knee` in the weighted distance; `planned` itself within
    /// the knee.
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

    /// The model that plans go through.
    pub fn model(&self) -> &dyn Model {
        self.model.as_ref()
    }

    /// The vehicle's effective parameters.
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

    /// The desired states of a whole trajectory.
    ///
    /// # Errors
    /// The trajectory is too long, or has numbers that are not finite.
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

    /// The desired states of a part of a trajectory, held at its end.
    ///
    /// # Errors
    /// The part has numbers that are not finite.
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
        let PlannedVehicle { body, attitude_pd, limits } = &self.vehicle;
        Weight {
            mass_kg: body.mass_kg,
            gravity: body.gravity,
            push: Push::of(self.model(), body, attitude_pd),
            tilt_max_rad: limits.tilt_max_rad,
        }
    }

    /// The state of a vehicle that rests at the place and the heading of `state`.
    pub fn at_rest(&self, state: &StateVector) -> StateVector {
        let [north, east, down, .., yaw, _, _, _] = *state;
        let position = Ned::new(north, east, down);
        let (_, attitude) =
            self.weight().carry(&DesiredPoint { position, yaw, ..Default::default() });
        let Euler { roll, pitch, .. } = attitude;
        [north, east, down, 0.0, 0.0, 0.0, roll, pitch, yaw, 0.0, 0.0, 0.0]
    }

    /// The start of a search: the desired states and inputs, or, where these cross a region to
    /// avoid, those of a path around it.
    fn guess(&self, desire: &Desire, problem: &Problem<7>) -> Iterate<7> {
        let (mut states, period_s) = (desire.states.clone(), self.period_s());
        // The path avoids each region by the widest margin; the search then uses each state's.
        let widest_m = self.margin_m.iter().copied().fold(0.0, f64::max);
        let regions: Vec<KeepOut> =
            problem.keep_out.iter().map(|region| region.inflated(widest_m)).collect();
        if !bend(&mut states, period_s, &regions, &problem.limits) {
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

    /// The problem of tracking the desired states from `start`.
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
            margin_m: self.margin_m.clone(),
        }
    }

    /// The regions to avoid.
    pub(super) fn keep_out(&self) -> impl Iterator<Item = KeepOut> + '_ {
        self.settings.keep_out.iter().map(|region| KeepOut::from(*region))
    }

    fn bounds(&self, desire: &Desire) -> InputBounds<7> {
        let Limits {
            thrust_min, thrust_max, tilt_max_rad: tilt, body_rate_max_rad_s: rate, ..
        } = self.vehicle.limits;
        let full = self.vehicle.body.thrust_full_n;
        let yaws = desire.states.iter().map(|state| state[YAW]);
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

    /// Searches for the inputs that track the desired states from `start`. `guess` is the starting
    /// point, of the same length; without one, the search starts from the desired inputs and the
    /// desired states, bent around the regions to avoid.
    pub fn plan(
        &self,
        desire: &Desire,
        start: StateVector,
        guess: Option<Iterate<7>>,
        stop: &dyn Fn(&[Record]) -> bool,
    ) -> Outcome<7> {
        let mut problem = self.problem(desire, start);
        let mut guess = guess.unwrap_or_else(|| self.guess(desire, &problem));
        // A first plan has no predecessor: the few subproblems of a replan must yield flyable
        // inputs here too.
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
