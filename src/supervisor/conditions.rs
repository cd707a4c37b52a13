//! When each trigger of the table holds.

use super::{EngagePolicy, FlightState, Observation, Supervisor, Trigger};
use crate::clock::HostTime;
use crate::guard::Obeys;
use crate::telemetry::VehicleStatus;

/// Time for CURRENT_MODE, which is requested twice a second, to follow the first HEARTBEAT, s.
const INTENDED_MODE_WAIT_S: f64 = 3.0;

impl Supervisor {
    /// The first trigger that holds and has a transition from the present state.
    pub(super) fn trigger(&self, now: HostTime, seen: &Observation) -> Option<(Trigger, String)> {
        let linked = self.is_linked(now, seen.status);
        let mode = seen.status.mode;
        let offboard = mode == Some(self.modes.offboard);
        let released = self.is_released(now, seen.status);
        // Only time in which the vehicle was heard counts.
        let released_s = self
            .other_mode_since
            .zip(seen.status.last_received)
            .map_or(0.0, |(since, heard)| heard.since(since.max(self.since)).as_secs_f64());
        let in_state_s = self.seconds_in_state(now);
        let armed = seen.status.armed;
        let by_command = self.policy == EngagePolicy::Command;
        let is_return = offboard && seen.status.mode_changed_with_disarming();
        let on_ground = seen.airborne == Some(false);
        let rests_s = self.rest_since.map_or(0.0, |since| now.since(since).as_secs_f64());
        // In order of precedence.
        let rows = [
            (Trigger::LinkLost, !linked),
            (Trigger::VehicleHeard, linked && mode.is_some()),
            (Trigger::EngageAsked, linked && !by_command),
            (Trigger::ModeChanged, self.mode_changed(seen.status)),
            (Trigger::Disarmed, armed == Some(false)),
            (
                Trigger::OffboardFound,
                linked && if self.state == FlightState::Standby { is_return } else { !released },
            ),
            (Trigger::Released, released_s >= self.settings.release_s),
            (Trigger::TelemetryLost, !seen.telemetry_ready),
            (Trigger::TelemetryReady, seen.telemetry_ready),
            (Trigger::PreflightPassed, seen.preflight.is_empty() && (self.engaged || !by_command)),
            (
                Trigger::OffboardRead,
                self.obeys(now, seen.status) == Obeys::Yes
                    && self.streamed
                    && (by_command || self.pilot_switched(seen)),
            ),
            (
                Trigger::StreamEstablished,
                self.engaged
                    && by_command
                    && self.streamed
                    && in_state_s >= self.settings.stream_before_engage_s,
            ),
            (Trigger::ArmedInAir, armed == Some(true) && seen.airborne == Some(true)),
            (Trigger::Armed, armed == Some(true) && on_ground),
            (Trigger::HoldDone, in_state_s >= self.settings.hold_s),
            (
                Trigger::Landed,
                on_ground && mode == Some(self.modes.land) || rests_s >= self.settings.rest_s,
            ),
            (
                Trigger::TimedOut,
                self.time_limit_s().is_some_and(|limit| self.waited_s(now) > limit),
            ),
        ];
        let (trigger, _) = rows
            .into_iter()
            .find(|(trigger, holds)| *holds && self.state.next(*trigger).is_some())?;
        Some((trigger, self.describe(trigger, seen)))
    }

    /// Whether mode and intended mode read something other than OFFBOARD.
    fn is_released(&self, now: HostTime, status: &VehicleStatus) -> bool {
        let offboard = Some(self.modes.offboard);
        status.mode.is_some()
            && status.mode != offboard
            && status.intended_mode != offboard
            && (status.intended_mode.is_some() || self.relies_on_heartbeat(now, status))
    }

    fn is_linked(&self, now: HostTime, status: &VehicleStatus) -> bool {
        status.silence_s(now) < self.settings.link_lost_after_s
    }

    /// Notes since when the vehicle has been released. A doubt or a silence may hide OFFBOARD: what
    /// was read before it does not count.
    pub(super) fn note_release(&mut self, now: HostTime, status: &VehicleStatus) {
        if self.is_released(now, status)
            && self.is_linked(now, status)
            && status.is_mode_newer_than_silence()
        {
            self.other_mode_since.get_or_insert(now);
        } else {
            self.other_mode_since = None;
        }
    }

    /// Whether not to wait for the intended mode: the vehicle has none, or does not report it.
    fn relies_on_heartbeat(&self, now: HostTime, status: &VehicleStatus) -> bool {
        let known_s = status.mode_since.map_or(0.0, |since| now.since(since).as_secs_f64());
        !self.modes.reports_intended || known_s > INTENDED_MODE_WAIT_S
    }

    /// Whether OFFBOARD was entered by the pilot's switch. In the air it always was. On the ground
    /// it may be the autopilot's return to an earlier choice on disarming, so a HEARTBEAT later
    /// than the mode must have reported whether the motors are armed.
    fn pilot_switched(&self, seen: &Observation) -> bool {
        let status = seen.status;
        let is_confirmed = status
            .armed_reported
            .is_some_and(|reported| status.mode_changed.is_none_or(|changed| reported >= changed));
        seen.airborne == Some(true) || (is_confirmed && !status.mode_changed_with_disarming())
    }

    /// Whether the mode is one that the controller did not request and that was not there before.
    /// An offer ends when the pilot leaves OFFBOARD before it counts as the pilot's switch.
    pub(super) fn mode_changed(&self, status: &VehicleStatus) -> bool {
        let Some(mode) = status.mode else { return false };
        let offboard = mode == self.modes.offboard;
        let has_left = !offboard && self.was_offboard && !status.is_mode_doubtful();
        match self.state {
            FlightState::Standby => has_left,
            FlightState::Engage => {
                has_left || !offboard && self.mode_at_entry.is_some_and(|at| at != mode)
            }
            FlightState::Land => !offboard && mode != self.modes.land,
            _ => !offboard,
        }
    }

    /// Time that counts against the limit: the whole preparation where telemetry comes and goes, s.
    fn waited_s(&self, now: HostTime) -> f64 {
        let preparing = self.preparing_since.filter(|_| self.state.is_preparing());
        now.since(preparing.unwrap_or(self.since)).as_secs_f64()
    }

    fn time_limit_s(&self) -> Option<f64> {
        let s = &self.settings;
        let commanded =
            |limit| (self.policy == EngagePolicy::Command && self.engaged).then_some(limit);
        match self.state {
            FlightState::AwaitRelease | FlightState::AwaitTelemetry | FlightState::Preflight => {
                commanded(s.ready_timeout_s)
            }
            FlightState::Engage => Some(s.engage_timeout_s),
            FlightState::Arm if self.policy == EngagePolicy::PilotSwitch => {
                Some(s.pilot_arm_timeout_s)
            }
            FlightState::Arm => commanded(s.arm_timeout_s),
            FlightState::TakeOff | FlightState::Approach => Some(s.take_off_timeout_s),
            FlightState::Land => Some(s.land_timeout_s),
            FlightState::Disarm => Some(s.disarm_after_s + s.land_timeout_s),
            _ => None,
        }
    }
}
