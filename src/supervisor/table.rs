//! The table of transitions.

use serde::Serialize;

use FlightState::*;
use Trigger as On;

/// Where a flight stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightState {
    /// Nothing was heard from the vehicle, or not for long.
    Connect,
    /// Silent until the mode in force, and the intended one, read something other than OFFBOARD.
    AwaitRelease,
    /// Telemetry is not fresh or too slow.
    AwaitTelemetry,
    /// The checks before a flight.
    Preflight,
    /// Streams a hold that follows the vehicle; not in control.
    Standby,
    /// Asks for OFFBOARD and reads the mode back.
    Engage,
    /// In OFFBOARD; asks for arming, or waits for the pilot to arm.
    Arm,
    /// Spins up and climbs to the trajectory's start height.
    TakeOff,
    /// Moves to the trajectory's start and settles.
    Approach,
    /// Follows the trajectory.
    Track,
    /// Stays where it is.
    Hold,
    /// The vehicle lands itself.
    Land,
    /// On the ground; waits for the motors to stop, then asks for it.
    Disarm,
    /// The flight is over as planned.
    Done,
    /// The flight is over, not as planned; silent, so that the vehicle's own failsafe acts.
    Abort,
    /// The pilot took the vehicle over.
    PilotControl,
}

/// What moves a flight on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Trigger {
    /// A message of the vehicle came.
    VehicleHeard,
    /// Nothing was heard for too long, or the vehicle restarted or is another.
    LinkLost,
    /// Mode and intended mode have read something other than OFFBOARD for a while.
    Released,
    /// The mode reads OFFBOARD, or is intended to, though it was not asked for.
    OffboardFound,
    /// Samples are fresh and quick enough.
    TelemetryReady,
    /// Samples stopped coming.
    TelemetryLost,
    /// Every preflight check passed, and a flight is wanted.
    PreflightPassed,
    /// The hold was streamed for long enough, and the daemon is to ask for OFFBOARD.
    StreamEstablished,
    /// The mode reads OFFBOARD.
    OffboardRead,
    /// The mode reads something that the daemon did not ask for.
    ModeChanged,
    /// The motors are armed, on the ground.
    Armed,
    /// The motors are armed, in the air.
    ArmedInAir,
    /// The motors are not armed.
    Disarmed,
    /// The start height is reached.
    TakenOff,
    /// At rest at the trajectory's start.
    StartReached,
    /// The trajectory is at its end.
    TrajectoryDone,
    /// The hold was long enough.
    HoldDone,
    /// The vehicle is on the ground.
    Landed,
    /// The state took too long.
    TimedOut,
    /// A fault asks for a hold.
    HoldNow,
    /// A fault asks for landing.
    LandNow,
    /// A fault asks for silence.
    StopNow,
    /// A flight is asked for, explicitly.
    EngageAsked,
}

/// Every state, in the order of a flight.
pub const STATES: [FlightState; 16] = [
    Connect,
    AwaitRelease,
    AwaitTelemetry,
    Preflight,
    Standby,
    Engage,
    Arm,
    TakeOff,
    Approach,
    Track,
    Hold,
    Land,
    Disarm,
    Done,
    Abort,
    PilotControl,
];

/// Every trigger.
pub const TRIGGERS: [Trigger; 23] = [
    On::VehicleHeard,
    On::LinkLost,
    On::Released,
    On::OffboardFound,
    On::TelemetryReady,
    On::TelemetryLost,
    On::PreflightPassed,
    On::StreamEstablished,
    On::OffboardRead,
    On::ModeChanged,
    On::Armed,
    On::ArmedInAir,
    On::Disarmed,
    On::TakenOff,
    On::StartReached,
    On::TrajectoryDone,
    On::HoldDone,
    On::Landed,
    On::TimedOut,
    On::HoldNow,
    On::LandNow,
    On::StopNow,
    On::EngageAsked,
];

/// States, a trigger, and the state that follows. What is not here changes nothing.
type Row = (&'static [FlightState], Trigger, FlightState);

#[rustfmt::skip]
const TABLE: &[Row] = &[
    // Towards a flight, silent.
    (&[Connect],                                    On::VehicleHeard,      AwaitRelease),
    (&[AwaitRelease],                               On::Released,          AwaitTelemetry),
    (&[AwaitTelemetry],                             On::TelemetryReady,    Preflight),
    (&[AwaitTelemetry, Preflight, Standby],         On::OffboardFound,     AwaitRelease),
    (&[Preflight, Standby],                         On::TelemetryLost,     AwaitTelemetry),
    (&[Preflight],                                  On::PreflightPassed,   Standby),
    (&[Standby],                                    On::ModeChanged,       AwaitRelease),
    (&[AwaitRelease, AwaitTelemetry, Preflight],    On::TimedOut,          Abort),
    // Streaming a hold, to control.
    (&[Standby],                                    On::StreamEstablished, Engage),
    (&[Standby, Engage],                            On::OffboardRead,      Arm),
    (&[Engage, Arm],                                On::TimedOut,          Abort),
    (&[Arm],                                        On::Armed,             TakeOff),
    (&[Arm],                                        On::ArmedInAir,        Approach),
    // The flight.
    (&[TakeOff],                                    On::TakenOff,          Approach),
    (&[Approach],                                   On::StartReached,      Track),
    (&[Track],                                      On::TrajectoryDone,    Hold),
    (&[Hold],                                       On::HoldDone,          Land),
    (&[TakeOff, Approach],                          On::TimedOut,          Land),
    (&[Land],                                       On::Landed,            Disarm),
    (&[Land, Disarm],                               On::Disarmed,          Done),
    (&[Land, Disarm],                               On::TimedOut,          Abort),
    // The pilot wins.
    (&[Engage, Arm, TakeOff, Approach, Track, Hold, Land],
                                                    On::ModeChanged,       PilotControl),
    (&[TakeOff, Approach, Track, Hold],             On::Disarmed,          Abort),
    // Reactions to faults.
    (&[Approach, Track],                            On::HoldNow,           Hold),
    (&[TakeOff],                                    On::HoldNow,           Land),
    (&[TakeOff, Approach, Track, Hold],             On::LandNow,           Land),
    (&[Engage, Arm],                                On::HoldNow,           Abort),
    (&[Engage, Arm],                                On::LandNow,           Abort),
    (&[Engage, Arm, TakeOff, Approach, Track, Hold, Land],
                                                    On::StopNow,           Abort),
    // The link.
    (&[AwaitRelease, AwaitTelemetry, Preflight, Standby],
                                                    On::LinkLost,          Connect),
    (&[Engage, Arm, TakeOff, Approach, Track, Hold, Land, Disarm],
                                                    On::LinkLost,          Abort),
    // Another flight, which begins with the release of the last.
    (&[Done, Abort, PilotControl],                  On::EngageAsked,       AwaitRelease),
];

/// What follows on each trigger in one state.
type Successors = [Option<FlightState>; TRIGGERS.len()];

/// The table by state and trigger. Every tick asks for several triggers of one state, which are
/// side by side here.
static SUCCESSORS: [Successors; STATES.len()] = {
    let mut successors = [[None; TRIGGERS.len()]; STATES.len()];
    let mut row = 0;
    while row < TABLE.len() {
        let (from, on, to) = TABLE[row];
        let mut state = 0;
        while state < from.len() {
            successors[from[state] as usize][on as usize] = Some(to);
            state += 1;
        }
        row += 1;
    }
    successors
};

impl FlightState {
    /// The state that follows on `trigger`, if it changes anything.
    pub fn next(self, trigger: Trigger) -> Option<FlightState> {
        SUCCESSORS[self as usize][trigger as usize]
    }

    /// The name in logs and on screens.
    pub fn name(self) -> &'static str {
        match self {
            Connect => "connect",
            AwaitRelease => "await_release",
            AwaitTelemetry => "await_telemetry",
            Preflight => "preflight",
            Standby => "standby",
            Engage => "engage",
            Arm => "arm",
            TakeOff => "take_off",
            Approach => "approach",
            Track => "track",
            Hold => "hold",
            Land => "land",
            Disarm => "disarm",
            Done => "done",
            Abort => "abort",
            PilotControl => "pilot_control",
        }
    }

    /// Whether setpoints may be streamed: a hold before control, control, and landing while the
    /// vehicle has not taken over yet.
    pub fn may_stream(self) -> bool {
        self == Standby || self == Engage || self == Land || self.is_in_control()
    }

    /// Whether a flight is prepared: the vehicle is heard, and not ready yet.
    pub fn is_preparing(self) -> bool {
        matches!(self, AwaitRelease | AwaitTelemetry | Preflight)
    }

    /// Whether the preflight checks are still ahead.
    pub fn precedes_stream(self) -> bool {
        matches!(self, Connect | AwaitRelease | AwaitTelemetry | Preflight)
    }

    /// Whether the daemon flies the vehicle: OFFBOARD was read back.
    pub fn is_in_control(self) -> bool {
        matches!(self, Arm | TakeOff | Approach | Track | Hold)
    }

    /// Whether the flight is over.
    pub fn is_over(self) -> bool {
        matches!(self, Done | Abort | PilotControl)
    }

    /// Whether the daemon flies the vehicle off the ground.
    pub fn is_flying(self) -> bool {
        self.is_in_control() && self != Arm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn reachable(from: FlightState, without: &[Trigger]) -> BTreeSet<FlightState> {
        let (mut seen, mut open) = (BTreeSet::from([from]), vec![from]);
        while let Some(state) = open.pop() {
            let triggers = TRIGGERS.iter().filter(|trigger| !without.contains(trigger));
            for next in triggers.filter_map(|trigger| state.next(*trigger)) {
                if seen.insert(next) {
                    open.push(next);
                }
            }
        }
        seen
    }

    #[test]
    fn no_row_is_hidden_by_another() {
        for state in STATES {
            for trigger in TRIGGERS {
                let rows =
                    TABLE.iter().filter(|(from, on, _)| *on == trigger && from.contains(&state));
                assert!(rows.count() <= 1, "{state:?} on {trigger:?}");
            }
        }
    }

    #[test]
    fn every_state_is_reachable_and_every_flight_can_end() {
        assert_eq!(reachable(Connect, &[]).len(), STATES.len());
        for state in STATES {
            assert!(reachable(state, &[]).contains(&Done), "{state:?}");
        }
    }

    #[test]
    fn nothing_leads_back_to_the_stream_without_an_explicit_engage() {
        for state in STATES.into_iter().filter(|state| state.is_over()) {
            let after = reachable(state, &[On::EngageAsked]);
            assert_eq!(after, BTreeSet::from([state]), "{state:?} is final");
        }
    }

    #[test]
    fn every_way_to_the_stream_passes_the_release() {
        let after = reachable(Connect, &[On::Released]);
        assert!(after.iter().all(|state| !state.may_stream()), "{after:?}");
        for state in STATES.into_iter().filter(|state| state.is_over()) {
            let after = reachable(state, &[On::Released]);
            assert!(after.iter().all(|state| !state.may_stream()), "{after:?}");
        }
    }

    #[test]
    fn the_pilot_and_a_stop_end_control_from_every_state_of_control() {
        for state in STATES.into_iter().filter(|state| state.is_in_control()) {
            assert_eq!(state.next(On::ModeChanged), Some(PilotControl), "{state:?}");
            for trigger in [On::StopNow, On::LinkLost] {
                let next = state.next(trigger).expect("a reaction");
                assert!(!next.may_stream(), "{state:?} on {trigger:?} streams in {next:?}");
            }
            for trigger in [On::LandNow, On::StopNow] {
                let next = state.next(trigger).expect("a reaction");
                assert!(!next.is_in_control(), "{state:?} on {trigger:?} stays in {next:?}");
            }
        }
    }

    #[test]
    fn control_is_entered_by_reading_offboard_while_streaming_only() {
        for state in STATES.into_iter().filter(|state| !state.is_in_control()) {
            for trigger in TRIGGERS {
                if state.next(trigger).is_some_and(FlightState::is_in_control) {
                    assert!(trigger == On::OffboardRead && state.may_stream());
                }
            }
        }
    }
}
