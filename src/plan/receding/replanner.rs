//! Makes the plans of a flight, one after another, each from the vehicle's state at that time.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::board::{Board, Candidate, ON_THE_GRID, Stretch, Verdict};
use crate::plan::desire::Desire;
use crate::plan::discretisation::{CommandedDynamics, Dynamics};
use crate::plan::flyable::{NotFlyable, check_in_flight};
use crate::plan::iterate::Iterate;
use crate::plan::planned::{Answer, PlannedReference};
use crate::plan::planner::{Planner, PlannerError, RecedingSettings};
use crate::plan::problem::{StateVector, YAW};
use crate::plan::scp::Outcome;
use crate::plan::trajectory::Trajectory;

/// Plans from the vehicle's states.
pub(super) struct Replanner {
    current: ModelPlanners,
    /// The previous model, in case plans with the current one fail.
    before: Option<ModelPlanners>,
    /// Number of plans in a row that were not flyable.
    failures: u32,
    /// Number of models accepted so far.
    models: u64,
    settings: RecedingSettings,
    schedule: Schedule,
    board: Arc<Board>,
}

/// Number of failed plans in a row after which planning returns to the previous model.
const FAILURES_MAX: u32 = 3;

/// The planners of one model.
struct ModelPlanners {
    planner: Planner,
    /// Makes a plan without a predecessor.
    first: Planner,
    /// Searches until it converges.
    converged: Planner,
    answer: Answer,
    /// Number of the model, 0 for the initial one.
    model: u64,
}

impl ModelPlanners {
    fn new(candidate: Candidate, settings: &RecedingSettings, model: u64) -> Self {
        let Candidate { planner, answer } = candidate;
        Self {
            first: planner.clone().first_of_replanning(settings),
            planner: planner.clone().replanning(settings),
            converged: planner.cautious(settings),
            answer,
            model,
        }
    }
}

/// A state of the vehicle and its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// Seconds into the trajectory.
    pub t: f64,
    pub state: StateVector,
}

/// A plan to search for.
#[derive(Clone, Debug)]
struct Task {
    /// Seconds into the trajectory at which it starts.
    from_s: f64,
    desire: Desire,
    start: StateVector,
    /// The previous plan, as far as it overlaps this one.
    guess: Option<Iterate<7>>,
}

/// When the next plan is due.
#[derive(Clone, Copy, Debug, Default)]
struct Schedule {
    last_s: f64,
    next_s: f64,
}

/// Why no plan was made from a state.
#[derive(Debug, thiserror::Error)]
enum ReplanError {
    #[error(transparent)]
    Planner(#[from] PlannerError),
    #[error(transparent)]
    NotFlyable(#[from] NotFlyable),
    #[error("there is no goal")]
    NoGoal,
}

impl Replanner {
    /// A planner that follows `goal`, and is due at once.
    pub fn new(
        goal: Trajectory,
        planner: Planner,
        answer: Answer,
        settings: RecedingSettings,
    ) -> Self {
        let board = Arc::new(Board::new(goal, answer.voltage_exponent));
        let current = ModelPlanners::new(Candidate { planner, answer }, &settings, 0);
        let schedule = Schedule::default();
        Self { current, before: None, failures: 0, models: 0, settings, schedule, board }
    }

    /// The plans, for the control tick.
    pub fn board(&self) -> Arc<Board> {
        Arc::clone(&self.board)
    }

    /// Plans from a state if a plan is due.
    pub fn see(&mut self, seen: &Sighting) {
        if self.is_due(seen.t)
            && let Err(error) = self.replan(seen)
        {
            tracing::warn!("no new plan at {:.2} s: {error}", seen.t);
        }
    }

    fn is_due(&mut self, t: f64) -> bool {
        let schedule = &mut self.schedule;
        if t < schedule.last_s {
            // Time went backwards: another flight starts.
            self.board.clear();
            schedule.next_s = t;
        }
        schedule.last_s = t;
        let is_due = t >= schedule.next_s || self.board.is_offered();
        if is_due {
            schedule.next_s = t + self.settings.period_s;
        }
        is_due
    }

    /// The planning task from a state.
    fn task(&self, planners: &ModelPlanners, seen: &Sighting) -> Result<Task, ReplanError> {
        let goal = self.board.goal().ok_or(ReplanError::NoGoal)?;
        let planner = &planners.planner;
        let period = planner.period_s();
        let from_s = self.beginning(planners, seen.t);
        let periods = (self.settings.horizon_s / period).round().max(1.0) as usize;
        let desire = planner.desire_from(&goal, from_s, periods)?;

        let before = self.board.going_on(from_s, period);
        let mut start = self.foreseen(planners, seen, from_s, &desire.states[0]);
        if let Some((knee, _)) = self.settings.caution() {
            // Without a predecessor, the plan starts near the desired state.
            let planned = match &before {
                None => desire.states.first().copied(),
                Some(stretch) => stretch.state(from_s, period),
            };
            if let Some(planned) = planned {
                start = planner.beyond(&planned, &start, knee);
            }
        }
        let guess = before.map(|stretch| stretch.carried_into(&desire, from_s, period));
        Ok(Task { from_s, desire, start, guess })
    }

    /// Plans from a state, and publishes the plan if it passes the checks. An offered model is
    /// tried first.
    fn replan(&mut self, seen: &Sighting) -> Result<(), ReplanError> {
        if self.board.withdrawn.swap(false, Ordering::AcqRel)
            && let Some(before) = self.before.take()
        {
            (self.current, self.failures) = (before, 0);
        }
        let offered = self.board.offered.lock().ok().and_then(|mut offered| offered.take());
        if let Some(candidate) = offered {
            let candidate = ModelPlanners::new(*candidate, &self.settings, self.models + 1);
            match self.tried(&candidate, seen) {
                Ok(stretch) => {
                    self.models += 1;
                    self.failures = 0;
                    self.report(Verdict::Taken { model: candidate.model });
                    self.before = Some(std::mem::replace(&mut self.current, candidate));
                    self.board.publish(stretch);
                    return Ok(());
                }
                Err(error) => self.report(Verdict::Refused { reason: error.to_string() }),
            }
        }
        let task = self.task(&self.current, seen)?;
        // The first plan has no predecessor, so its search runs until it converges.
        let ModelPlanners { planner, first, .. } = &self.current;
        let planner = if task.guess.is_some() { planner } else { first };
        match self.plan(&self.current, planner, task) {
            Ok(stretch) => {
                self.failures = 0;
                self.board.publish(stretch);
                Ok(())
            }
            Err(error) => {
                self.failures += 1;
                if self.failures >= FAILURES_MAX
                    && let Some(before) = self.before.take()
                {
                    self.current = before;
                    self.failures = 0;
                    self.report(Verdict::Refused { reason: error.to_string() });
                }
                Err(error)
            }
        }
    }

    /// The first plan with an offered model. If a few subproblems from the previous plan do not
    /// give a flyable plan, searches again until it converges.
    fn tried(&self, candidate: &ModelPlanners, seen: &Sighting) -> Result<Stretch, ReplanError> {
        let task = self.task(candidate, seen)?;
        let quick = self.plan(candidate, &candidate.planner, task.clone());
        quick.or_else(|_| self.plan(candidate, &candidate.converged, task))
    }

    fn plan(
        &self,
        planners: &ModelPlanners,
        planner: &Planner,
        task: Task,
    ) -> Result<Stretch, ReplanError> {
        let Task { from_s, desire, start, guess } = task;
        let outcome = planner.plan(&desire, start, guess, &|_| false);
        check_in_flight(&outcome, planner.keep_out())?;
        let Outcome { iterate, .. } = outcome;
        let (Iterate { states, inputs }, period) = (&iterate, planner.period_s());
        let answer = &planners.answer;
        let reference = PlannedReference::of(states, inputs, period, answer, planner.body());
        let (model, delay_s) = (planners.model, answer.delay_s);
        Ok(Stretch { from_s, reference, iterate, model, delay_s })
    }

    fn report(&self, verdict: Verdict) {
        if let Ok(mut latest) = self.board.verdict.lock() {
            *latest = Some(verdict);
        }
    }

    /// Start of the plan made from a state at `t`; until then, the inputs of the last plan act. All
    /// starts are on one time grid, so that a plan shares its states with the one that it
    /// continues.
    fn beginning(&self, planners: &ModelPlanners, t: f64) -> f64 {
        let period = planners.planner.period_s();
        let grid = period / (period / self.settings.period_s).round().max(1.0);
        let lead = self.settings.lead_s + planners.answer.delay_s;
        let earliest = (t / grid - ON_THE_GRID).ceil();
        ((t + lead) / grid).round().max(earliest) * grid
    }

    /// The state at `from_s`, predicted by the model under the inputs that act until then. Yaw is
    /// unwrapped to the turn of the desired yaw.
    fn foreseen(
        &self,
        planners: &ModelPlanners,
        seen: &Sighting,
        from_s: f64,
        desired: &StateVector,
    ) -> StateVector {
        let mut state = seen.state;
        let turn = std::f64::consts::TAU;
        state[YAW] += ((desired[YAW] - state[YAW]) / turn).round() * turn;
        let period = planners.planner.period_s();
        let periods = ((from_s - seen.t) / period).max(0.0);
        let full_periods = (periods + ON_THE_GRID).floor();
        let part = (periods - full_periods) * period;
        let mut t = seen.t;
        let mut step = |length: f64| {
            let stretch = self.board.at(t + 0.5 * length)?;
            let index = ((t + 0.5 * length - stretch.from_s) / period) as usize;
            let input = stretch.iterate.inputs.get(index)?;
            let model = planners.planner.model();
            let dynamics = CommandedDynamics::new(model, planners.answer.attitude_pd, length);
            (state, t) = (dynamics.step(&state, input), t + length);
            Some(())
        };
        if part > ON_THE_GRID * period && step(part).is_none() {
            return state;
        }
        for _ in 0..full_periods as usize {
            if step(period).is_none() {
                break;
            }
        }
        state
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use vehicle::VehicleParams;

    use super::*;
    use crate::control::Limits;
    use crate::model::physics::{PhysicsModel, PhysicsParameters};
    use crate::plan::planned::PlannedBody;
    use crate::plan::planner::{PlanSettings, PlannedVehicle};
    use crate::plan::problem::STATES;

    /// Plans at 200 Hz, of one damped subproblem each.
    fn quick() -> Replanner {
        let vehicle = VehicleParams::load("crazyflie").expect("a vehicle");
        let attitude_pd = vehicle.attitude_pd.expect("a loop");
        let planned = PlannedVehicle {
            body: PlannedBody {
                mass_kg: vehicle.mass,
                inertia: vehicle.inertia,
                gravity: vehicle.gravity,
                thrust_full_n: vehicle.thrust_full_n(),
            },
            attitude_pd,
            limits: Limits::default(),
        };
        let settings = RecedingSettings {
            period_s: 0.005,
            lead_s: 0.0,
            subproblems_max: 1,
            damping: 0.5,
            ..RecedingSettings::default()
        };
        let model = PhysicsModel::new(&vehicle, &PhysicsParameters::default()).expect("physics");
        let planner = Planner::new(Arc::new(model), planned, PlanSettings::default());
        let text = "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 20\namplitude_m = 1\n\
                    period_s = 5\nyaw_period_s = 10\nramp_s = 0.5";
        let goal = Trajectory::parse(text, Path::new("sinusoid")).expect("a trajectory");
        let answer = Answer { delay_s: 0.0, lag_s: 0.0, voltage_exponent: 0.0, attitude_pd };
        Replanner::new(goal, planner.expect("a planner"), answer, settings)
    }

    /// Later plans complete what one subproblem leaves open, while the vehicle is disturbed.
    #[test]
    fn one_subproblem_per_plan_stays_near_the_converged_plan() {
        let mut replanner = quick();
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut state = [0.0; STATES];
        state[2] = -1.0;
        let mut ratios = Vec::new();
        for tick in 0..160 {
            let t = f64::from(tick) * 0.005;
            let seen = Sighting { t, state };
            replanner.replan(&seen).expect("a plan");
            if tick > 20 && tick % 5 == 0 {
                let Task { desire, start, guess, .. } =
                    replanner.task(&replanner.current, &seen).expect("a task");
                let near = replanner.current.planner.plan(&desire, start, guess, &|_| false);
                let converged = Some(near.iterate.clone());
                let converged = replanner.current.first.plan(&desire, start, converged, &|_| false);
                ratios.push(near.cost / converged.cost);
            }
            state = replanner.foreseen(&replanner.current, &seen, t + 0.005, &state);
            for value in &mut state[3..6] {
                *value += random.random_range(-0.005..0.005);
            }
            for value in &mut state[9..] {
                *value += random.random_range(-0.025..0.025);
            }
        }
        ratios.sort_by(f64::total_cmp);
        let (median, most) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
        assert!(median < 1.01 && most < 1.03, "{median} {most}");
    }

    #[test]
    fn plans_start_on_a_fixed_time_grid() {
        let replanner = quick();
        for t in [0.0, 0.0021, 0.005, 1.2349, 3.0 - 1e-9] {
            let from_s = replanner.beginning(&replanner.current, t);
            assert!(from_s > t - 1e-6 && from_s <= t + 0.0051, "{t} {from_s}");
            let on_the_grid = from_s / 0.005;
            assert!((on_the_grid - on_the_grid.round()).abs() < 1e-6, "{t} {from_s}");
        }
    }
}
