//! A planner that stalls, lies or fails.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use vehicle::frame::Ned;

use super::script::{Fault, Script};
use crate::plan::reference::{FeedForward, ReferenceSource};
use crate::setpoint::{Expected, Reference};

/// The simulated time, which triggers the planner's faults.
pub type SharedTime = Arc<AtomicU64>;

type Source = Arc<dyn ReferenceSource + Send + Sync>;

/// `source` with the planner faults of a script; unchanged where there are none.
pub fn faulty(script: &Script, source: Source, now_us: &SharedTime) -> Source {
    let is_planners = |fault: &Fault| {
        matches!(fault, Fault::PlannerStalls | Fault::PlannerLies { .. } | Fault::PlannerFails)
    };
    if !script.faults.iter().any(|timed| is_planners(&timed.fault)) {
        return source;
    }
    let faulty = Faulty {
        script: script.clone(),
        source,
        now_us: Arc::clone(now_us),
        held: AtomicU64::new(0),
    };
    Arc::new(faulty)
}

struct Faulty {
    script: Script,
    source: Source,
    now_us: SharedTime,
    /// Bits of the time at which a stalled planner stopped.
    held: AtomicU64,
}

impl ReferenceSource for Faulty {
    fn duration(&self) -> f64 {
        self.source.duration()
    }

    fn sample(&self, t: f64) -> Reference {
        let now_us = self.now_us.load(Ordering::Relaxed);
        let acting = self.script.faults.iter().filter(|timed| timed.acts(now_us));
        let (mut at, mut off, mut fails) = (t, 0.0, false);
        for timed in acting {
            match timed.fault {
                Fault::PlannerStalls => {
                    let held = f64::from_bits(self.held.load(Ordering::Relaxed));
                    at = if held > 0.0 { held.min(t) } else { t };
                    self.held.store(at.to_bits(), Ordering::Relaxed);
                }
                Fault::PlannerLies { metres } => off = metres,
                Fault::PlannerFails => fails = true,
                _ => {}
            }
        }
        let mut reference = self.source.sample(at);
        reference.position += Ned::new(off, 0.0, 0.0);
        if fails {
            reference.position = Ned::new(f64::NAN, 0.0, 0.0);
            reference.feedforward.thrust_n = f64::NAN;
        }
        reference
    }

    fn expected(&self, t: f64) -> Option<Expected> {
        self.source.expected(t)
    }

    fn with_feed_forward(&self, with: &FeedForward) -> Option<Source> {
        let source = self.source.with_feed_forward(with)?;
        let (script, now_us) = (self.script.clone(), Arc::clone(&self.now_us));
        Some(Arc::new(Self { script, source, now_us, held: AtomicU64::new(0) }))
    }

    fn start_thrust_n(&self) -> f64 {
        self.source.start_thrust_n()
    }
}
