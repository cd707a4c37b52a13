//! The table of transitions between the states of a flight.

use serde::Serialize;

use FlightState::*;
use Trigger as On;

/// The state of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightState {
    /// Nothing was received from the vehicle, or not for too long.
    Connect,
    /// Silent until the present and the intended mode read something other than OFFBOARD.
    AwaitRelease,
    /// Telemetry is stale or too slow.
    AwaitTelemetry,
    /// Runs the checks before a flight.
    Preflight,
    /// Streams a hold that follows the vehicle; not in control.
    Standby,
    /// Requests OFFBOARD and reads the mode back.
    Engage,
    /// In OFFBOARD; requests arming, or waits for the pilot to arm.
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
    /// On the ground; waits for the motors to stop, and after a while requests it.
    Disarm,
    /// The flight is over as planned.
    Done,
    /// The flight is over, not as planned; silent, so that the vehicle's own failsafe acts.
    Abort,
    /// The pilot took the vehicle over.
    PilotControl,
}

/// The cause of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Trigger {
    /// A message from the vehicle arrived.
    VehicleHeard,
    /// The vehicle was silent for too long, restarted, or was replaced by another.
    LinkLost,
    /// Mode and intended mode have read something other than OFFBOARD for a while.
    Released,
    /// The mode, or the intended mode, reads OFFBOARD without a request.
    OffboardFound,
    /// Samples are fresh and frequent enough.
    TelemetryReady,
    /// Samples stopped coming.
    TelemetryLost,
    /// Every preflight check passes, and a flight is wanted.
    PreflightPassed,
    /// The hold was streamed for long enough, and the controller may request OFFBOARD.
    StreamEstablished,
    /// The mode reads OFFBOARD.
    OffboardRead,
    /// The mode reads something that the controller did not request.
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
    /// The state exceeded its time limit.
    TimedOut,
    /// A fault calls for a hold.
    HoldNow,
    /// A fault calls for a landing.
    LandNow,
    /// A fault calls for silence.
    StopNow,
    /// A command requests a flight.
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

/// Present states, a trigger, and the next state. A combination without a row changes nothing.
type Row = (&'static [FlightState], Trigger, FlightState);

#[rustfmt::skip]
const TABLE: &[Row] = &[
    // Towards a flight, in silence.
    (&[Connect],                                    On::VehicleHeard,      AwaitRelease),
    (&[AwaitRelease],                               On::Released,          AwaitTelemetry),
    (&[AwaitTelemetry],                             On::TelemetryReady,    Preflight),
    (&[AwaitTelemetry, Preflight, Standby],         On::OffboardFound,     AwaitRelease),
    (&[Preflight, Standby],                         On::TelemetryLost,     AwaitTelemetry),
    (&[Preflight],                                  On::PreflightPassed,   Standby),
    (&[Standby],                                    On::ModeChanged,       AwaitRelease),
    (&[AwaitRelease, AwaitTelemetry, Preflight],    On::TimedOut,          Abort),
    // From a streamed hold to control.
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

/// The next state for each trigger in one state.
type Successors = [Option<FlightState>; TRIGGERS.len()];

/// The table by state and trigger. Every tick looks up several triggers of one state, which are
/// adjacent here.
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
    /// The next state on `trigger`, or `None` where the trigger changes nothing.
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

    /// Whether setpoints may be streamed: a hold before control, control, and a landing until the
    /// vehicle has taken over.
    pub fn may_stream(self) -> bool {
        self == Standby || self == Engage || self == Land || self.is_in_control()
    }

    /// Whether a flight is being prepared: the vehicle is connected but not ready yet.
    pub fn is_preparing(self) -> bool {
        matches!(self, AwaitRelease | AwaitTelemetry | Preflight)
    }

    /// Whether the preflight checks are still ahead.
    pub fn precedes_stream(self) -> bool {
        matches!(self, Connect | AwaitRelease | AwaitTelemetry | Preflight)
    }

    /// Whether the controller flies the vehicle: OFFBOARD was read back.
    pub fn is_in_control(self) -> bool {
        matches!(self, Arm | TakeOff | Approach | Track | Hold)
    }

    /// Whether the flight is over.
    pub fn is_over(self) -> bool {
        matches!(self, Done | Abort | PilotControl)
    }

    /// Whether the controller flies the vehicle off the ground.
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
    fn no_row_shadows_another() {
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
    fn streaming_resumes_only_after_an_explicit_engage() {
        for state in STATES.into_iter().filter(|state| state.is_over()) {
            let after = reachable(state, &[On::EngageAsked]);
            assert_eq!(after, BTreeSet::from([state]), "{state:?} is final");
        }
    }

    #[test]
    fn every_path_to_streaming_passes_the_release() {
        let after = reachable(Connect, &[On::Released]);
        assert!(after.iter().all(|state| !state.may_stream()), "{after:?}");
        for state in STATES.into_iter().filter(|state| state.is_over()) {
            let after = reachable(state, &[On::Released]);
            assert!(after.iter().all(|state| !state.may_stream()), "{after:?}");
        }
    }

    #[test]
    fn pilot_and_stop_end_control_from_every_control_state() {
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
    fn control_starts_only_on_offboard_while_streaming() {
        for state in STATES.into_iter().filter(|state| !state.is_in_control()) {
            for trigger in TRIGGERS {
                if state.next(trigger).is_some_and(FlightState::is_in_control) {
                    assert!(trigger == On::OffboardRead && state.may_stream());
                }
            }
        }
    }
}
