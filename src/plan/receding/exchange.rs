//! Another model to plan through, handed over in flight.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::board::{Board, Candidate, Verdict};
use crate::plan::planned::Answer;
use crate::plan::planner::Planner;

/// Hands models to a [`RecedingReference`](super::RecedingReference) in flight.
#[derive(Clone)]
pub struct Exchange {
    board: Arc<Board>,
}

impl Exchange {
    pub(super) fn new(board: Arc<Board>) -> Self {
        Self { board }
    }

    /// Offers a model to plan through. The next plan, due at once, is searched for through it; if
    /// that plan may be flown, so are those after it. It starts where the vehicle will be, so the
    /// reference goes on from there. An offer that was not taken up yet is replaced.
    pub fn offer(&self, planner: Planner, answer: Answer) {
        if let Ok(mut offered) = self.board.offered.lock() {
            *offered = Some(Box::new(Candidate { planner, answer }));
        }
    }

    /// Withdraws the newest model: the next plan goes through the model before it, if there is one.
    pub fn withdraw(&self) {
        self.board.withdrawn.store(true, Ordering::Release);
    }

    /// What became of the newest model that was tried; each verdict once.
    pub fn take_verdict(&self) -> Option<Verdict> {
        self.board.verdict.lock().ok()?.take()
    }

    /// When the first setpoint of a plan through this model was made, s into the trajectory;
    /// `None` unless its plans are the newest flown.
    pub fn used_from_s(&self, model: u64) -> Option<f64> {
        let (used, from_s) = self.board.used();
        (used == model && from_s.is_finite()).then_some(from_s)
    }
}
