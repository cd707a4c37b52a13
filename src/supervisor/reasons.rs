//! The reasons for transitions, as events give them.

use super::{EngagePolicy, FlightState, Observation, Supervisor, Trigger};
use crate::telemetry::VehicleStatus;

impl Supervisor {
    /// Why `trigger` moves the flight on.
    pub(super) fn describe(&self, trigger: Trigger, seen: &Observation) -> String {
        let text = match trigger {
            Trigger::ModeChanged => return self.control_ends(seen.status),
            Trigger::OffboardFound if self.state == FlightState::Standby => {
                return format!(
                    "{} returned to OFFBOARD when it disarmed, which is not the pilot's switch; \
                     switch to another mode first",
                    self.modes.autopilot
                );
            }
            Trigger::OffboardFound => {
                let mode = self.mode_name(seen.status);
                return format!("the mode is {mode}; waiting until it is not OFFBOARD");
            }
            Trigger::TimedOut => return self.timed_out(seen),
            Trigger::LinkLost => "the link is silent",
            Trigger::VehicleHeard => "the vehicle is on the link",
            Trigger::EngageAsked => "ready for the pilot's next switch",
            Trigger::Disarmed if self.state.is_flying() => "the motors were stopped in flight",
            Trigger::Disarmed => "disarmed",
            Trigger::Released
                if self.modes.reports_intended && seen.status.intended_mode.is_none() =>
            {
                "free to stream, judged by the mode in HEARTBEAT alone: the vehicle sends no \
                 CURRENT_MODE (PX4 before 1.15, or MAVLink 1), so its intended mode is unknown"
            }
            Trigger::Released => "free to stream",
            Trigger::TelemetryLost => "telemetry is not fresh",
            Trigger::TelemetryReady => "telemetry is fresh",
            Trigger::PreflightPassed => "preflight checks passed",
            Trigger::OffboardRead => "the mode is OFFBOARD",
            Trigger::StreamEstablished => "requesting OFFBOARD",
            Trigger::ArmedInAir => "in the air",
            Trigger::Armed => "armed",
            Trigger::HoldDone => "landing",
            Trigger::Landed if seen.airborne == Some(false) => "on the ground",
            Trigger::Landed => "at rest on the ground, though the vehicle reports no landing",
            Trigger::TakenOff
            | Trigger::StartReached
            | Trigger::TrajectoryDone
            | Trigger::HoldNow
            | Trigger::LandNow
            | Trigger::StopNow => "as requested",
        };
        text.to_owned()
    }

    fn mode_name(&self, status: &VehicleStatus) -> String {
        status.mode.map_or_else(|| "unknown".to_owned(), |mode| self.modes.name(mode))
    }

    /// Why control, or an offer of it, ends, naming the mode.
    pub(super) fn control_ends(&self, status: &VehicleStatus) -> String {
        let mode = self.mode_name(status);
        match self.state {
            FlightState::Standby => format!("the vehicle left OFFBOARD again: the mode is {mode}"),
            _ => format!("control ends: the mode is {mode}"),
        }
    }

    /// What did not happen in time.
    fn timed_out(&self, seen: &Observation) -> String {
        let what = match self.state {
            FlightState::AwaitRelease => "the vehicle is in OFFBOARD, or its mode is unknown; \
                                          switch it to another mode first"
                .to_owned(),
            FlightState::AwaitTelemetry | FlightState::Preflight => {
                let late = seen.condition.late;
                let lacks = match self.state {
                    FlightState::AwaitTelemetry if late.count > 0 => {
                        format!("no fresh attitude and position: {late}; ")
                    }
                    FlightState::AwaitTelemetry => "no fresh attitude and position; ".to_owned(),
                    _ => String::new(),
                };
                let failed: Vec<_> = seen.preflight.iter().map(ToString::to_string).collect();
                format!("{lacks}preflight: {}", failed.join("; "))
            }
            FlightState::Engage => "the vehicle did not enter OFFBOARD".to_owned(),
            FlightState::Arm if self.policy == EngagePolicy::PilotSwitch => format!(
                "the pilot did not arm within {:.0} s of switching to OFFBOARD",
                self.settings.pilot_arm_timeout_s
            ),
            FlightState::Arm => "arming had no effect".to_owned(),
            FlightState::TakeOff => "the take-off did not reach its height".to_owned(),
            FlightState::Approach => "the vehicle did not reach the trajectory's start".to_owned(),
            FlightState::Land => {
                format!("the vehicle did not report that it landed{}", still_armed(seen.status))
            }
            _ => format!("the motors did not stop{}", still_armed(seen.status)),
        };
        match &seen.status.warning {
            Some((host, text)) if *host >= self.since => format!("{what}; vehicle: {text}"),
            _ => what,
        }
    }
}

/// What the operator has to do if the motors did not stop.
fn still_armed(status: &VehicleStatus) -> &'static str {
    if status.armed == Some(true) { "; it is still armed: disarm it by hand" } else { "" }
}
