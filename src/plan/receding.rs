//! Receding-horizon planning: plans renewed in flight from the vehicle's present state.
//!
//! The control tick only reads the newest finished plan and hands over the vehicle's state; it
//! never waits. A late plan is used for the time that it still covers, a failed plan is discarded,
//! and where no plan covers the time, the desired trajectory itself is the reference.

mod board;
mod exchange;
mod replanner;

use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;

use vehicle::frame::Ned;
use vehicle::rigid_body::State;

use self::board::Board;
pub use self::board::Verdict;
pub use self::exchange::Exchange;
use self::replanner::{Replanner, Sighting};
use super::model_free::model_free;
use super::planned::Answer;
use super::planner::Planner;
pub use super::planner::RecedingSettings;
use super::problem::{STATES, StateVector};
use super::reference::ReferenceSource;
use super::trajectory::Trajectory;
use crate::setpoint::{Expected, Reference};

/// Where planning runs.
enum Work {
    /// In the caller, when a plan is due: for flights on a virtual clock, where planning takes no
    /// time.
    Inline(Box<Mutex<Replanner>>),
    /// On a separate thread, which receives the vehicle's states.
    Thread(SyncSender<Sighting>),
}

/// A reference that tracks a desired trajectory through plans renewed in flight.
pub struct RecedingReference {
    board: Arc<Board>,
    work: Work,
    hover_thrust_n: f64,
}

/// Moves the goal of a [`RecedingReference`] in flight.
#[derive(Clone)]
pub struct Goal {
    board: Arc<Board>,
}

impl Goal {
    /// Sets another trajectory, which the next plan follows from the same time along it.
    pub fn move_to(&self, trajectory: Trajectory) {
        if let Ok(mut goal) = self.board.goal.lock() {
            *goal = Arc::new(trajectory);
        }
    }
}

impl RecedingReference {
    /// Plans on a separate thread, which ends with the reference.
    ///
    /// # Errors
    /// Returns the error of the system if it cannot start the thread.
    pub fn threaded(
        goal: Trajectory,
        planner: Planner,
        answer: Answer,
        settings: RecedingSettings,
    ) -> std::io::Result<Self> {
        let hover_thrust_n = planner.hover_thrust_n();
        let mut replanner = Replanner::new(goal, planner, answer, settings);
        let board = replanner.board();
        // A queue of one: states that arrive while a plan is being made are dropped.
        let (sender, receiver) = sync_channel(1);
        thread::Builder::new().name("replanning".to_owned()).spawn(move || {
            for seen in receiver {
                replanner.see(&seen);
            }
        })?;
        Ok(Self { board, work: Work::Thread(sender), hover_thrust_n })
    }

    /// Plans within [`ReferenceSource::observe`], on the clock of the times that it receives.
    pub fn inline(
        goal: Trajectory,
        planner: Planner,
        answer: Answer,
        settings: RecedingSettings,
    ) -> Self {
        let hover_thrust_n = planner.hover_thrust_n();
        let replanner = Replanner::new(goal, planner, answer, settings);
        let board = replanner.board();
        let work = Work::Inline(Box::new(Mutex::new(replanner)));
        Self { board, work, hover_thrust_n }
    }

    /// A handle that exchanges the model in flight.
    pub fn exchange(&self) -> Exchange {
        Exchange::new(Arc::clone(&self.board))
    }

    /// A handle that moves the goal in flight.
    pub fn goal(&self) -> Goal {
        Goal { board: Arc::clone(&self.board) }
    }
}

impl ReferenceSource for RecedingReference {
    fn duration(&self) -> f64 {
        self.board.goal().map_or(0.0, |goal| goal.duration())
    }

    fn sample(&self, t: f64) -> Reference {
        if let Some(reference) = self.board.reference(t) {
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
        self.board.voltage_exponent()
    }

    fn observe(&self, t: f64, state: &State) {
        let sighting = Sighting { t, state: state_vector(state) };
        match &self.work {
            Work::Inline(replanner) => {
                if let Ok(mut replanner) = replanner.lock() {
                    replanner.see(&sighting);
                }
            }
            Work::Thread(sender) => match sender.try_send(sighting) {
                // Full: the planner is busy. Disconnected: it can only have panicked; the desired
                // trajectory then remains.
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
