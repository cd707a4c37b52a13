//! Finished plans, shared by the thread that makes them and the control tick that reads them.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use crate::plan::desire::Desire;
use crate::plan::iterate::Iterate;
use crate::plan::planned::{Answer, PlannedReference};
use crate::plan::planner::Planner;
use crate::plan::problem::StateVector;
use crate::plan::reference::ReferenceSource;
use crate::plan::trajectory::Trajectory;
use crate::setpoint::Reference;

/// A plan and the time at which it starts.
#[derive(Clone, Debug)]
pub(super) struct Stretch {
    /// Seconds into the trajectory at which it starts.
    pub from_s: f64,
    pub reference: PlannedReference,
    pub iterate: Iterate<7>,
    /// Number of the model that it was planned with, from 0.
    pub model: u64,
    /// Time by which its setpoints are sent ahead, s.
    pub delay_s: f64,
}

impl Stretch {
    pub fn reaches(&self, t: f64) -> bool {
        (self.from_s..self.from_s + self.reference.duration()).contains(&t)
    }

    /// The planned state at a time, interpolated linearly.
    pub fn state(&self, t: f64, period: f64) -> Option<StateVector> {
        let (first, share) = self.place(t, period);
        let (before, after) = (self.iterate.states.get(first)?, self.iterate.states.get(first + 1));
        Some(between(before, after.unwrap_or(before), share))
    }

    /// `of` from `from_s`, replaced by this plan as far as it reaches. A plan that is renewed more
    /// often than it has states starts between two states of its predecessor.
    pub fn carried_into(&self, of: &Desire, from_s: f64, period: f64) -> Iterate<7> {
        let mut guess = Iterate { states: of.states.clone(), inputs: of.inputs.clone() };
        let at = |n: usize| from_s + n as f64 * period;
        for (n, state) in guess.states.iter_mut().enumerate() {
            *state = self.state(at(n), period).unwrap_or(*state);
        }
        for (n, input) in guess.inputs.iter_mut().enumerate() {
            let (first, share) = self.place(at(n), period);
            let Some(before) = self.iterate.inputs.get(first) else { break };
            let after = self.iterate.inputs.get(first + 1).unwrap_or(before);
            *input = between(before, after, share);
        }
        guess
    }

    /// The index of the last state up to a time, and the fraction of the way to the next.
    fn place(&self, t: f64, period: f64) -> (usize, f64) {
        let periods = ((t - self.from_s) / period).max(0.0) + ON_THE_GRID;
        (periods as usize, (periods.fract() - ON_THE_GRID).max(0.0))
    }
}

/// Tolerance for times on a state, in periods: rounding puts them before or after it.
pub(super) const ON_THE_GRID: f64 = 1e-6;

/// Linear interpolation from `a` to `b` at `share`.
fn between<const N: usize>(a: &[f64; N], b: &[f64; N], share: f64) -> [f64; N] {
    std::array::from_fn(|i| a[i] + share * (b[i] - a[i]))
}

/// Number of stretches kept.
const SLOTS: usize = 8;

/// A model to plan with: its planner and the vehicle's response.
pub(super) struct Candidate {
    pub planner: Planner,
    pub answer: Answer,
}

/// The planner's decision on a model.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Its first plan is flyable; later plans use it too.
    Taken {
        /// Number of the model, from 1; 0 is the initial model.
        model: u64,
    },
    /// Its plans are not flyable, at the start or later. Planning uses the previous model.
    Refused {
        /// The error of the last plan.
        reason: String,
    },
}

/// Time before any model but the initial one was used.
const NEVER: u64 = f64::NAN.to_bits();

/// The trajectory to follow, and the planned stretches.
pub(super) struct Board {
    pub goal: Mutex<Arc<Trajectory>>,
    /// A model that the next plan tries.
    pub offered: Mutex<Option<Box<Candidate>>>,
    /// The newest decision that was not read yet.
    pub verdict: Mutex<Option<Verdict>>,
    /// Whether the next plan goes back to the previous model.
    pub withdrawn: AtomicBool,
    /// Number of the model whose plan is flown.
    used: AtomicU64,
    /// Bits of the time from which on it is, s into the trajectory.
    used_from: AtomicU64,
    /// Bits of that model's exponent of thrust in voltage.
    voltage_exponent: AtomicU64,
    /// Ring buffer: the newest stretch is at `newest`, the older ones in the slots before it. While
    /// the vehicle responds slowly, several are in use. A reader never waits for a writer: while
    /// one slot is being written, the others can be read.
    slots: [Mutex<Option<Arc<Stretch>>>; SLOTS],
    newest: AtomicUsize,
}

impl Board {
    pub fn new(goal: Trajectory, voltage_exponent: f64) -> Self {
        Self {
            goal: Mutex::new(Arc::new(goal)),
            offered: Mutex::new(None),
            verdict: Mutex::new(None),
            withdrawn: AtomicBool::new(false),
            used: AtomicU64::new(0),
            used_from: AtomicU64::new(NEVER),
            voltage_exponent: AtomicU64::new(voltage_exponent.to_bits()),
            slots: std::array::from_fn(|_| Mutex::new(None)),
            newest: AtomicUsize::new(0),
        }
    }

    /// The stretches that reach `t`, the newest first.
    fn reaching(&self, t: f64) -> impl Iterator<Item = Arc<Stretch>> + '_ {
        let newest = self.newest.load(Ordering::Acquire);
        (0..SLOTS).filter_map(move |back| {
            let slot = &self.slots[(newest + SLOTS - back) % SLOTS];
            slot.try_lock().ok()?.clone().filter(|stretch| stretch.reaches(t))
        })
    }

    /// The newest stretch that reaches `t`.
    pub fn at(&self, t: f64) -> Option<Arc<Stretch>> {
        self.reaching(t).next()
    }

    /// The newest stretch that reaches `t` and has a state there, or the newest that reaches it:
    /// plans that are renewed more often than they have states interleave, and each continues a
    /// plan on its own time grid.
    pub fn going_on(&self, t: f64, period: f64) -> Option<Arc<Stretch>> {
        let is_on_a_state = |stretch: &Arc<Stretch>| stretch.place(t, period).1 < 2.0 * ON_THE_GRID;
        self.reaching(t).find(is_on_a_state).or_else(|| self.at(t))
    }

    /// The reference at `t`, with the setpoint that acts the delay later. Only the control tick
    /// calls this.
    pub fn reference(&self, t: f64) -> Option<Reference> {
        let state = self.at(t)?;
        let mut reference = state.reference.sample(t - state.from_s);
        if let Some(acting) = self.at(t + state.delay_s) {
            if acting.model != self.used.load(Ordering::Relaxed) {
                let exponent = acting.reference.voltage_exponent();
                self.voltage_exponent.store(exponent.to_bits(), Ordering::Relaxed);
                self.used_from.store(t.to_bits(), Ordering::Relaxed);
                self.used.store(acting.model, Ordering::Release);
            }
            reference.feedforward = acting.reference.sent(t - acting.from_s);
        }
        Some(reference)
    }

    /// The model whose plan is flown, and since when, s into the trajectory.
    pub fn used(&self) -> (u64, f64) {
        let model = self.used.load(Ordering::Acquire);
        (model, f64::from_bits(self.used_from.load(Ordering::Relaxed)))
    }

    pub fn voltage_exponent(&self) -> f64 {
        f64::from_bits(self.voltage_exponent.load(Ordering::Relaxed))
    }

    pub fn is_offered(&self) -> bool {
        self.offered.lock().is_ok_and(|offered| offered.is_some())
    }

    pub fn publish(&self, stretch: Stretch) {
        let oldest = (self.newest.load(Ordering::Acquire) + 1) % SLOTS;
        if let Ok(mut slot) = self.slots[oldest].lock() {
            *slot = Some(Arc::new(stretch));
        }
        self.newest.store(oldest, Ordering::Release);
    }

    pub fn clear(&self) {
        for slot in &self.slots {
            if let Ok(mut slot) = slot.lock() {
                *slot = None;
            }
        }
    }

    pub fn goal(&self) -> Option<Arc<Trajectory>> {
        self.goal.lock().ok().map(|goal| Arc::clone(&goal))
    }
}
