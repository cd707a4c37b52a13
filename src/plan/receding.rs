//! A plan that is made anew while it is flown: from where the vehicle is, over a horizon that
//! recedes.
//!
//! The control tick only ever reads the newest plan that is ready and hands over where the vehicle
//! is; it never waits. A plan that is late is used as far as it still reaches, one that fails is
//! not used, and where none reaches to, the desired trajectory itself is the reference.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;

use vehicle::frame::Ned;
use vehicle::rigid_body::State;

use super::discretisation::{CommandedDynamics, Dynamics};
use super::flyable::{NotFlyable, check_in_flight};
use super::iterate::Iterate;
use super::model_free::model_free;
use super::planned::{Answer, PlannedReference};
use super::planner::Planner;
pub use super::planner::RecedingSettings;
use super::problem::{STATES, StateVector, YAW};
use super::reference::ReferenceSource;
use super::scp::Outcome;
use super::trajectory::Trajectory;
use crate::setpoint::{Expected, Reference};

/// A plan from a time on.
#[derive(Clone, Debug)]
struct Stretch {
    /// Seconds into the trajectory at which it begins.
    from_s: f64,
    reference: PlannedReference,
    iterate: Iterate<7>,
}

impl Stretch {
    fn reaches(&self, t: f64) -> bool {
        (self.from_s..self.from_s + self.reference.duration()).contains(&t)
    }
}

/// Stretches that are kept.
const SLOTS: usize = 4;

/// What is to be followed, and the stretches that were planned.
struct Board {
    goal: Mutex<Arc<Trajectory>>,
    /// The newest stretch is at `newest`, the ones before it in the slots before, round and round:
    /// while the vehicle is slow to answer, several are on their way. A reader never waits for a
    /// writer: while one slot is written, the others are read.
    slots: [Mutex<Option<Arc<Stretch>>>; SLOTS],
    newest: AtomicUsize,
}

impl Board {
    /// The newest stretch that reaches to `t`.
    fn at(&self, t: f64) -> Option<Arc<Stretch>> {
        let newest = self.newest.load(Ordering::Acquire);
        (0..SLOTS).find_map(|back| {
            let slot = &self.slots[(newest + SLOTS - back) % SLOTS];
            let stretch = slot.try_lock().ok()?.clone()?;
            stretch.reaches(t).then_some(stretch)
        })
    }

    /// The reference at `t`, and the setpoint that acts `delay_s` later.
    fn reference(&self, t: f64, delay_s: f64) -> Option<Reference> {
        let state = self.at(t)?;
        let mut reference = state.reference.sample(t - state.from_s);
        if let Some(acting) = self.at(t + delay_s) {
            reference.feedforward = acting.reference.sent(t - acting.from_s);
        }
        Some(reference)
    }

    fn publish(&self, stretch: Stretch) {
        let oldest = (self.newest.load(Ordering::Acquire) + 1) % SLOTS;
        if let Ok(mut slot) = self.slots[oldest].lock() {
            *slot = Some(Arc::new(stretch));
        }
        self.newest.store(oldest, Ordering::Release);
    }

    fn clear(&self) {
        for slot in &self.slots {
            if let Ok(mut slot) = slot.lock() {
                *slot = None;
            }
        }
    }

    fn goal(&self) -> Option<Arc<Trajectory>> {
        self.goal.lock().ok().map(|goal| Arc::clone(&goal))
    }
}

/// Makes plans from states; the work behind a [`RecedingReference`].
struct Replanner {
    planner: Planner,
    answer: Answer,
    settings: RecedingSettings,
    board: Arc<Board>,
}

/// Where the vehicle was seen.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    /// Seconds into the trajectory.
    t: f64,
    state: StateVector,
}

/// When the next plan is due.
#[derive(Clone, Copy, Debug, Default)]
struct Due {
    last_s: f64,
    next_s: f64,
}

impl Due {
    fn is_due(&mut self, t: f64, replanner: &Replanner) -> bool {
        if t < self.last_s {
            // Another flight begins.
            replanner.board.clear();
            self.next_s = t;
        }
        self.last_s = t;
        let is_due = t >= self.next_s;
        if is_due {
            self.next_s = t + replanner.settings.period_s;
        }
        is_due
    }
}

/// Why no plan was made from a state.
#[derive(Debug, thiserror::Error)]
enum ReplanError {
    #[error(transparent)]
    Planner(#[from] super::planner::PlannerError),
    #[error(transparent)]
    NotFlyable(#[from] NotFlyable),
    #[error("there is no goal")]
    NoGoal,
}

impl Replanner {
    fn new(goal: Trajectory, planner: Planner, answer: Answer, settings: RecedingSettings) -> Self {
        let board = Arc::new(Board {
            goal: Mutex::new(Arc::new(goal)),
            slots: std::array::from_fn(|_| Mutex::new(None)),
            newest: AtomicUsize::new(0),
        });
        let planner = planner.replanning(&settings);
        Self { planner, answer, settings, board }
    }

    /// Plans from a state, and publishes the plan if it holds.
    fn replan(&self, seen: &Sighting) -> Result<(), ReplanError> {
        let goal = self.board.goal().ok_or(ReplanError::NoGoal)?;
        let period = self.planner.period_s();
        // Until then acts what the last plan has sent.
        let lead = ((self.settings.lead_s + self.answer.delay_s) / period).round() as usize;
        let from_s = seen.t + lead as f64 * period;
        let periods = (self.settings.horizon_s / period).round().max(1.0) as usize;
        let desire = self.planner.desire_from(&goal, from_s, periods)?;

        let before = self.board.at(from_s);
        let mut start = self.foreseen(seen, lead, &desire.states[0]);
        if let Some((knee, _)) = self.settings.caution() {
            // The first plan goes on from where the vehicle is to be.
            let planned = match &before {
                None => desire.states.first(),
                Some(stretch) => {
                    let first = ((from_s - stretch.from_s) / period).round() as usize;
                    stretch.iterate.states.get(first)
                }
            };
            if let Some(planned) = planned {
                start = self.planner.beyond(planned, &start, knee);
            }
        }
        // The last plan, as far as it reaches into this one.
        let guess = before.map(|stretch| {
            let mut guess =
                Iterate { states: desire.states.clone(), inputs: desire.inputs.clone() };
            let skipped = ((from_s - stretch.from_s) / period).round() as usize;
            let old = &stretch.iterate;
            for (input, old) in guess.inputs.iter_mut().zip(old.inputs.iter().skip(skipped)) {
                *input = *old;
            }
            for (state, old) in guess.states.iter_mut().zip(old.states.iter().skip(skipped)) {
                *state = *old;
            }
            guess
        });
        let outcome: Outcome<7> = self.planner.plan(&desire, start, guess, &|_| false);
        check_in_flight(&outcome, self.planner.keep_out())?;
        let Outcome { iterate, .. } = outcome;
        let Iterate { states, inputs } = &iterate;
        let body = self.planner.body();
        let reference = PlannedReference::of(states, inputs, period, &self.answer, body);
        self.board.publish(Stretch { from_s, reference, iterate });
        Ok(())
    }

    /// The state some periods after it was seen, by the model and the inputs that act until then.
    /// Yaw is brought to the turn of the desired one.
    fn foreseen(&self, seen: &Sighting, periods: usize, desired: &StateVector) -> StateVector {
        let mut state = seen.state;
        let turn = std::f64::consts::TAU;
        state[YAW] += ((desired[YAW] - state[YAW]) / turn).round() * turn;
        let period = self.planner.period_s();
        let dynamics =
            CommandedDynamics::new(self.planner.model(), self.answer.attitude_pd, period);
        for n in 0..periods {
            let middle = seen.t + (n as f64 + 0.5) * period;
            let Some(stretch) = self.board.at(middle) else { return state };
            let index = ((middle - stretch.from_s) / period) as usize;
            let Some(input) = stretch.iterate.inputs.get(index) else { return state };
            state = dynamics.step(&state, input);
        }
        state
    }
}

/// Who makes the plans.
enum Work {
    /// The caller, when a plan is due: for flights on a virtual clock, where planning takes no
    /// time.
    Inline { replanner: Box<Replanner>, due: Mutex<Due> },
    /// A thread of its own, which gets the vehicle's state.
    Thread(SyncSender<Sighting>),
}

/// A reference that follows a desired trajectory by plans that are made anew in flight.
pub struct RecedingReference {
    board: Arc<Board>,
    work: Work,
    hover_thrust_n: f64,
    voltage_exponent: f64,
    delay_s: f64,
}

/// Moves the goal of a [`RecedingReference`] in flight.
#[derive(Clone)]
pub struct Goal {
    board: Arc<Board>,
}

impl Goal {
    /// From the next plan on, another trajectory is followed, at the same time along it.
    pub fn move_to(&self, trajectory: Trajectory) {
        if let Ok(mut goal) = self.board.goal.lock() {
            *goal = Arc::new(trajectory);
        }
    }
}

impl RecedingReference {
    /// Plans on a thread of its own, which ends with the reference.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn threaded(
        goal: Trajectory,
        planner: Planner,
        answer: Answer,
        settings: RecedingSettings,
    ) -> std::io::Result<Self> {
        let hover_thrust_n = planner.hover_thrust_n();
        let replanner = Replanner::new(goal, planner, answer, settings);
        let board = Arc::clone(&replanner.board);
        // Room for one: while a plan is made, what else is seen is dropped.
        let (sender, receiver) = sync_channel(1);
        thread::Builder::new()
            .name("replanning".to_owned())
            .spawn(move || work(&replanner, &receiver))?;
        let Answer { voltage_exponent, delay_s, .. } = answer;
        Ok(Self { board, work: Work::Thread(sender), hover_thrust_n, voltage_exponent, delay_s })
    }

    /// Plans inside of [`ReferenceSource::observe`], on the clock that the times are of.
    pub fn inline(
        goal: Trajectory,
        planner: Planner,
        answer: Answer,
        settings: RecedingSettings,
    ) -> Self {
        let hover_thrust_n = planner.hover_thrust_n();
        let replanner = Box::new(Replanner::new(goal, planner, answer, settings));
        Self {
            board: Arc::clone(&replanner.board),
            work: Work::Inline { replanner, due: Mutex::new(Due::default()) },
            hover_thrust_n,
            voltage_exponent: answer.voltage_exponent,
            delay_s: answer.delay_s,
        }
    }

    /// What moves the goal in flight.
    pub fn goal(&self) -> Goal {
        Goal { board: Arc::clone(&self.board) }
    }
}

/// Makes plans from what is seen, until nobody sees any more. Between two plans is at least the
/// period, in the vehicle's time.
fn work(replanner: &Replanner, seen: &Receiver<Sighting>) {
    let mut due = Due::default();
    while let Ok(sighting) = seen.recv() {
        if !due.is_due(sighting.t, replanner) {
            continue;
        }
        if let Err(error) = replanner.replan(&sighting) {
            tracing::warn!("no new plan at {:.2} s: {error}", sighting.t);
        }
    }
}

impl ReferenceSource for RecedingReference {
    fn duration(&self) -> f64 {
        self.board.goal().map_or(0.0, |goal| goal.duration())
    }

    fn sample(&self, t: f64) -> Reference {
        if let Some(reference) = self.board.reference(t, self.delay_s) {
            return reference;
        }
        match self.board.goal() {
            Some(goal) => model_free(&goal, t, self.hover_thrust_n),
            None => Reference::default(),
        }
    }

    fn desired(&self, t: f64) -> Ned {
        self.board.goal().map_or_else(|| self.sample(t).position, |goal| goal.sample(t).position)
    }

    fn expected(&self, t: f64) -> Option<Expected> {
        let stretch = self.board.at(t)?;
        stretch.reference.expected(t - stretch.from_s)
    }

    fn voltage_exponent(&self) -> f64 {
        self.voltage_exponent
    }

    fn observe(&self, t: f64, state: &State) {
        let sighting = Sighting { t, state: state_vector(state) };
        match &self.work {
            Work::Inline { replanner, due } => {
                if !due.lock().is_ok_and(|mut due| due.is_due(t, replanner)) {
                    return;
                }
                if let Err(error) = replanner.replan(&sighting) {
                    tracing::warn!("no new plan at {t:.2} s: {error}");
                }
            }
            Work::Thread(sender) => match sender.try_send(sighting) {
                // Full: the planner is at work. Gone: it can only have panicked; the desired
                // trajectory is what is left.
                Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
            },
        }
    }
}

fn state_vector(state: &State) -> StateVector {
    let mut vector = [0.0; STATES];
    let angles = state.attitude.euler();
    vector[..3].copy_from_slice(&state.position.to_array());
    vector[3..6].copy_from_slice(&state.velocity.to_array());
    vector[6..9].copy_from_slice(&[angles.roll, angles.pitch, angles.yaw]);
    vector[9..].copy_from_slice(&state.body_rate.to_array());
    vector
}
