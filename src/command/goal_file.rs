//! The trajectory's file as the goal of a flight: from a change of the file on, the flight follows
//! the new content.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime};

use anyhow::Context;

use crate::plan::receding::Goal;
use crate::plan::{FlightEnvelope, Trajectory};

/// Time between two reads of the file.
const PERIOD: Duration = Duration::from_millis(100);

/// Reads the file in its own thread until dropped.
pub(super) struct GoalFile {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl GoalFile {
    /// Moves `goal` whenever the file at `path` changes to a trajectory within the envelope.
    pub fn watch(
        path: &Path,
        goal: Goal,
        envelope: FlightEnvelope,
        gravity: f64,
    ) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let (path, stopping) = (path.to_owned(), Arc::clone(&stop));
        let mut last = modified(&path);
        let look = move || {
            while !stopping.load(Ordering::Relaxed) {
                thread::sleep(PERIOD);
                let now = modified(&path);
                if now.is_some() && now != last {
                    last = now;
                    take(&path, &goal, &envelope, gravity);
                }
            }
        };
        let thread = thread::Builder::new().name("goal".to_owned()).spawn(look);
        Ok(Self { stop, thread: Some(thread.context("cannot start the goal's thread")?) })
    }
}

impl Drop for GoalFile {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn modified(path: &PathBuf) -> Option<SystemTime> {
    std::fs::metadata(path).and_then(|metadata| metadata.modified()).ok()
}

/// A file that is incomplete, or outside the envelope, changes nothing.
fn take(path: &Path, goal: &Goal, envelope: &FlightEnvelope, gravity: f64) {
    match Trajectory::load(path) {
        Err(error) => tracing::warn!("keeping the present goal: {error}"),
        Ok(trajectory) => match envelope.check(&trajectory, gravity) {
            Err(error) => tracing::warn!("keeping the present goal: {error}"),
            Ok(_) => {
                tracing::info!("new goal: {}", trajectory.name());
                goal.move_to(trajectory);
            }
        },
    }
}
