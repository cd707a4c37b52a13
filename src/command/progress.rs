//! Progress bars on stderr, shown only on a terminal.

use std::io::{self, IsTerminal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::print_status;
use crate::learn::networks::Progress;
use crate::learn::networks::Watch;

/// A bar of `steps` steps.
fn bar(steps: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(10));
    let style = ProgressStyle::with_template(template);
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// A bar over `length_s` seconds of trajectory, in tenths.
pub(super) fn flight_bar(length_s: f64) -> ProgressBar {
    bar((length_s * 10.0) as u64, "{bar:40} {percent:>3} %  {msg}")
}

/// A bar over `count` items.
pub(super) fn count_bar(count: u64) -> ProgressBar {
    bar(count, "{bar:40} {pos}/{len}  {eta}")
}

/// Stores trained networks.
pub(super) type Keep = Box<dyn Fn(&Progress) + Send>;

/// A bar for each stage of a training.
pub(super) struct StageBar {
    bar: ProgressBar,
    interrupted: Arc<AtomicBool>,
    keep: Option<Keep>,
}

impl StageBar {
    /// Creates a bar; `interrupted` ends the training.
    pub fn new(interrupted: Arc<AtomicBool>) -> Self {
        Self { bar: bar(1, "{prefix:10} {bar:40} {percent:>3} %  {msg}"), interrupted, keep: None }
    }

    /// Sets what stores trained networks before their evaluation.
    pub fn keep_by(&mut self, keep: Option<Keep>) {
        self.keep = keep;
    }

    /// Removes the bar from the terminal.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

impl Watch for StageBar {
    fn stage(&mut self, name: &str, steps: u64) {
        // A bar shows only on a terminal.
        if !io::stderr().is_terminal() {
            print_status(format_args!("... {name}"));
        }
        self.bar.set_prefix(name.to_owned());
        self.bar.set_length(steps);
        self.bar.set_position(0);
    }

    fn step(&mut self, note: &str) {
        self.bar.set_message(note.to_owned());
        self.bar.inc(1);
    }

    fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    fn trained(&mut self, progress: &Progress) {
        if let Some(keep) = &self.keep {
            keep(progress);
        }
    }
}
