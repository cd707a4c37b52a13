//! The end of a station's flight.

use super::Station;
use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::offboard::OffboardController;
use crate::supervisor::{EngagePolicy, FlightState, Takeover};

/// Why a station stopped.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The flight went from take-off to landing.
    Done,
    /// The checks before a flight passed, and no flight was requested.
    Checked,
    /// No vehicle was found.
    NoVehicle,
    /// The vehicle did not fly, because preflight, mode or arming failed; with the reason.
    Refused(String),
    /// The flight ended early, with the reason.
    Aborted(String),
    /// The link was lost in flight, with the reason.
    LinkLost(String),
    /// The pilot took over.
    PilotTookOver,
    /// It was stopped, and the vehicle came to no other end.
    Stopped,
}

impl Station {
    /// Marks the flight in the log, and finds the end of a commanded one.
    pub(super) fn watch(&mut self, now: HostTime, state: FlightState) {
        self.mark_flight(now, state);
        self.flown |= state.is_flying();
        if self.end.is_none() {
            self.end = self.verdict(now, state);
        }
    }

    /// How the station ended, if it has: the commanded flight is over, or a requested stop is done.
    /// The vehicle's own end takes precedence over the requested one.
    pub(super) fn verdict(&self, now: HostTime, state: FlightState) -> Option<End> {
        let is_commanded = self.settings.policy == EngagePolicy::Command;
        let is_airborne =
            state.is_flying() || matches!(state, FlightState::Land | FlightState::Disarm);
        if self.is_check && state == FlightState::Standby {
            return Some(End::Checked);
        }
        let has_stopped = self.is_stopping && !is_airborne;
        if !is_commanded && !has_stopped {
            return None;
        }
        let trouble = || self.last_trouble.clone().unwrap_or_else(|| "no reason given".to_owned());
        match self.over_in {
            // The cause shows within a second or so.
            Some(FlightState::PilotControl) => match self.offboard.as_ref()?.takeover()? {
                Takeover::Pilot { .. } => Some(End::PilotTookOver),
                Takeover::Failsafe(text) => Some(End::Aborted(text.clone())),
            },
            Some(FlightState::Abort) if self.flown && self.is_link_silent(now) => {
                Some(End::LinkLost(trouble()))
            }
            Some(FlightState::Abort) if self.flown => Some(End::Aborted(trouble())),
            Some(FlightState::Abort) if is_commanded => Some(End::Refused(trouble())),
            Some(FlightState::Done) if is_commanded && self.last_trouble.is_some() => {
                Some(End::Aborted(trouble()))
            }
            Some(FlightState::Done) if !self.is_stopping => Some(End::Done),
            _ => has_stopped.then_some(End::Stopped),
        }
    }

    pub(super) fn is_link_silent(&self, now: HostTime) -> bool {
        let limit_s = self.settings.offboard.supervisor.link_lost_after_s;
        let is_silent =
            |offboard: &OffboardController| offboard.telemetry().status().silence_s(now) >= limit_s;
        self.session.state() != LinkState::Connected || self.offboard.as_ref().is_none_or(is_silent)
    }
}
