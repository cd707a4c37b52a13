//! Who ended control by a mode change: the pilot, or the vehicle's own failsafe.
//!
//! Control ends at once in either case. The cause often shows only afterwards, because CURRENT_MODE
//! reports a mode before HEARTBEAT and STATUSTEXT report a failsafe.

use std::time::Duration;

use super::ModeMap;
use crate::clock::HostTime;
use crate::telemetry::VehicleStatus;

/// Time within which the vehicle reports a failsafe: HEARTBEAT arrives once a second.
const SETTLING: Duration = Duration::from_millis(1200);
/// A text about a failsafe may arrive this much earlier than the mode.
const TEXT_AHEAD: Duration = Duration::from_secs(3);

/// Who ended control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Takeover {
    /// The pilot, who has the vehicle in this mode.
    Pilot {
        /// The mode's name.
        mode: String,
    },
    /// The vehicle's failsafe, as a message for people.
    Failsafe(String),
}

/// A mode change that ended control.
#[derive(Clone, Debug)]
pub(super) struct ModeTaken {
    at: HostTime,
    by: Option<Takeover>,
}

impl ModeTaken {
    pub fn new(at: HostTime) -> Self {
        Self { at, by: None }
    }

    /// The cause, once it is known.
    pub fn by(&self) -> Option<&Takeover> {
        self.by.as_ref()
    }

    /// Evaluates what the vehicle reported since, and returns the cause when it becomes known.
    pub fn settle(
        &mut self,
        now: HostTime,
        status: &VehicleStatus,
        modes: &ModeMap,
    ) -> Option<&Takeover> {
        if self.by.is_some() {
            return None;
        }
        let mode =
            status.mode.map_or_else(|| "an unknown mode".to_owned(), |mode| modes.name(mode));
        if let Some(text) = status.failsafe_since(self.at - TEXT_AHEAD) {
            let warned = status.warning.as_ref().filter(|(at, _)| *at >= self.at - TEXT_AHEAD);
            let text = warned.map_or(text, |(_, warning)| warning);
            let colon = if text.is_empty() { "" } else { "; vehicle: " };
            let reason = format!("{} failsafe: {mode}{colon}{text}", modes.autopilot);
            self.by = Some(Takeover::Failsafe(reason));
        } else if now.since(self.at) >= SETTLING {
            self.by = Some(Takeover::Pilot { mode });
        }
        self.by.as_ref()
    }
}
