//! The live status on a terminal.

use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::screen_content::SharedContent;
use crate::station::Status;

/// The display that is always visible.
#[derive(Clone)]
enum Shown {
    Line(ProgressBar),
    Screen(SharedContent),
}

/// A process has one terminal, and so one line or one screen. Everything that prints must know of
/// it.
static SHOWN: Mutex<Option<Shown>> = Mutex::new(None);

fn set_shown(shown: Option<Shown>) {
    *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = shown;
}

/// Messages go to the screen from now on, or to stderr again.
pub(super) fn print_on(screen: Option<SharedContent>) {
    set_shown(screen.map(Shown::Screen));
}

/// Prints on stderr, above a status line.
///
/// # Errors
/// Writing to stderr fails.
pub(super) fn print_above(text: &[u8]) -> io::Result<()> {
    let shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let print = || io::stderr().write_all(text);
    match shown {
        None => print(),
        Some(Shown::Line(bar)) => bar.suspend(print),
        Some(Shown::Screen(content)) => {
            content.print(text);
            Ok(())
        }
    }
}

/// One line on stderr, drawn again at each change; nothing if stderr is no terminal.
pub(super) struct StatusLine {
    bar: ProgressBar,
}

impl StatusLine {
    /// A line, shown only on a terminal.
    pub fn new(is_terminal: bool) -> Self {
        let target =
            if is_terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(None, target);
        let style = ProgressStyle::with_template("{spinner} {wide_msg}");
        let bar = bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
        bar.enable_steady_tick(Duration::from_millis(250));
        set_shown(Some(Shown::Line(bar.clone())));
        Self { bar }
    }

    /// Draws the status.
    pub fn show(&self, status: &Status) {
        self.bar.set_message(status_text(status));
    }

    /// Removes the line.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
        set_shown(None);
    }
}

/// Most important first: a narrow terminal cuts the end.
fn status_text(status: &Status) -> String {
    let mut parts = Vec::new();
    if status.link != "connected" {
        parts.push(format!("link {}", status.link));
    }
    parts.extend(status.vehicle.map(str::to_owned));
    parts.extend(status.phase.map(|phase| phase.name().to_owned()));
    let mode = |mode| status.mode_name.map_or(format!("mode {mode:#010x}"), str::to_owned);
    parts.extend(status.mode.map(mode));
    parts.extend(status.armed.map(|armed| if armed { "armed" } else { "disarmed" }.to_owned()));
    let ticks = status.tick_rate_hz > 0.0;
    if ticks {
        parts.push(format!("{:.0} Hz", status.tick_rate_hz));
        parts.push(format!("error {:.2} m", status.tracking_error_m));
    }
    parts.extend(status.progress.map(|(t, length)| format!("{t:.1}/{length:.1} s")));
    parts.extend(status.battery.map(|left| format!("battery {:.0} %", 100.0 * left)));
    if ticks {
        let p = status.position;
        parts.push(format!("n {:+.2} e {:+.2} d {:+.2} m", p.north(), p.east(), p.down()));
    }
    parts.extend(status.round_trip_s.map(|rtt| format!("rtt {:.1} ms", 1e3 * rtt)));
    parts.join(" | ")
}
