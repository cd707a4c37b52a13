//! Exchange of the planner's model in flight.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::board::{Board, Candidate, Verdict};
use crate::plan::planned::Answer;
use crate::plan::planner::Planner;

/// Offers models to a [`RecedingReference`](super::RecedingReference) in flight.
#[derive(Clone)]
pub struct Exchange {
    board: Arc<Board>,
}

impl Exchange {
    pub(super) fn new(board: Arc<Board>) -> Self {
        Self { board }
    }

    /// Offers a model. The next plan, due at once, uses it; if that plan is flyable, later plans
    /// use the model too. The plan starts at the predicted state, so the reference does not jump. A
    /// new offer replaces one that was not tried yet.
    pub fn offer(&self, planner: Planner, answer: Answer) {
        if let Ok(mut offered) = self.board.offered.lock() {
            *offered = Some(Box::new(Candidate { planner, answer }));
        }
    }

    /// Withdraws the current model: the next plan uses the previous model, if there is one.
    pub fn withdraw(&self) {
        self.board.withdrawn.store(true, Ordering::Release);
    }

    /// Takes the newest decision on a model; `None` if there is no new one.
    pub fn take_verdict(&self) -> Option<Verdict> {
        self.board.verdict.lock().ok()?.take()
    }

    /// Time of the first setpoint of a plan with this model, s into the trajectory; `None` unless
    /// the vehicle flies a plan with it.
    pub fn used_from_s(&self, model: u64) -> Option<f64> {
        let (used, from_s) = self.board.used();
        (used == model && from_s.is_finite()).then_some(from_s)
    }
}
