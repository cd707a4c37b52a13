//! Requests to the vehicle: sent, repeated until answered, and done only when read back.

use std::fmt;
use std::time::Duration;

use wire::dialect::MavCmd;

use super::profile::{Mode, Profile};
use crate::clock::HostTime;

/// Time between repetitions.
const REPEAT: Duration = Duration::from_millis(300);
/// Number of times a request is sent.
const ATTEMPTS: u8 = 5;
/// Time limit for an accepted mode to show in HEARTBEAT, which arrives once a second, or in
/// CURRENT_MODE.
const READ_BACK: Duration = Duration::from_millis(2500);
/// Extra time after an "in progress".
const IN_PROGRESS: Duration = Duration::from_secs(3);
/// Relative difference up to which two parameter values are equal: one went through an f32.
const SAME: f64 = 1e-6;

const DO_SET_MODE: MavCmd = MavCmd::MAV_CMD_DO_SET_MODE;
const ARM_DISARM: MavCmd = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;

/// A request to the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Change the mode.
    SetMode(FlightMode),
    /// Arm the motors.
    Arm,
    /// Disarm the motors, which the vehicle refuses in flight.
    Disarm,
    /// Read a parameter.
    ReadParameter(String),
    /// Set a parameter. It is read first where its type is not known.
    SetParameter {
        /// The parameter's name.
        name: String,
        /// New value.
        value: f64,
    },
}

/// A mode by its purpose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlightMode {
    /// Obeys setpoints.
    Offboard,
    /// Holds position.
    Hold,
    /// Lands.
    Land,
}

/// Identifies a request in its outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(u32);

/// How a request ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Done; a mode was read back.
    Done,
    /// The parameter's value, read or set.
    Parameter(f64),
    /// Refused with this MAV_RESULT.
    Refused {
        /// MAV_RESULT.
        result: u8,
    },
    /// Accepted, but a different mode or parameter value was read back.
    NotInForce,
    /// No answer to any repetition.
    NoAnswer,
    /// The autopilot's profile lacks it, or the value is not a number.
    Unsupported,
    /// The vehicle is not identified yet, so the form of the request is unknown.
    NotIdentified,
    /// No vehicle is connected.
    NotConnected,
    /// A newer request of the same kind replaced it.
    Superseded,
    /// It is no longer wanted.
    Withdrawn,
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Self::Done => "done",
            Self::Parameter(value) => return write!(f, "the value is {value}"),
            Self::Refused { result } => {
                return match result_text(*result) {
                    Some(text) => f.write_str(text),
                    None => write!(f, "MAV_RESULT {result}"),
                };
            }
            Self::NotInForce => "accepted, but not in force",
            Self::NoAnswer => "no answer",
            Self::Unsupported => "this autopilot does not support it",
            Self::NotIdentified => "the vehicle is not identified yet",
            Self::NotConnected => "no vehicle is connected",
            Self::Superseded => "a newer request replaced it",
            Self::Withdrawn => "withdrawn",
        };
        f.write_str(text)
    }
}

/// A refusing MAV_RESULT, for people.
fn result_text(result: u8) -> Option<&'static str> {
    match result {
        1 => Some("temporarily rejected"),
        2 => Some("denied"),
        3 => Some("unsupported"),
        4 => Some("failed"),
        _ => None,
    }
}

/// The message that a request sends.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Action<'a> {
    Command { command: MavCmd, params: [f32; 7], confirmation: u8 },
    ReadParameter(&'a str),
    SetParameter { name: &'a str, value: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Task {
    Command { command: MavCmd, params: [f32; 7], mode: Option<Mode> },
    Read,
    Set { value: f64, is_type_known: bool, was_sent: bool },
}

impl Task {
    /// The command, by which requests replace each other.
    fn command(&self) -> Option<MavCmd> {
        match self {
            Self::Command { command, .. } => Some(*command),
            Self::Read | Self::Set { .. } => None,
        }
    }
}

#[derive(Debug)]
struct Pending {
    id: RequestId,
    request: Request,
    task: Task,
    attempts: u8,
    next: HostTime,
    accepted: bool,
}

/// A request that ended.
pub(super) type Ended = (RequestId, Request, Outcome);

/// The pending requests.
#[derive(Debug, Default)]
pub(super) struct Requests {
    next_id: u32,
    pending: Vec<Pending>,
    ended: Vec<Ended>,
}

impl Requests {
    /// Takes a request; its outcome follows later.
    pub(super) fn submit(
        &mut self,
        now: HostTime,
        request: Request,
        profile: Option<&Profile>,
        is_type_known: impl Fn(&str) -> bool,
    ) -> RequestId {
        let task = match task_of(&request, profile, is_type_known) {
            Ok(task) => task,
            Err(outcome) => return self.refuse(request, outcome),
        };
        let id = self.next_id();
        if let Some(command) = task.command() {
            self.end_where(Outcome::Superseded, |pending| pending.task.command() == Some(command));
        }
        self.pending.push(Pending { id, request, task, attempts: 0, next: now, accepted: false });
        id
    }

    /// Ends a request before it starts.
    pub(super) fn refuse(&mut self, request: Request, outcome: Outcome) -> RequestId {
        let id = self.next_id();
        self.ended.push((id, request, outcome));
        id
    }

    fn next_id(&mut self) -> RequestId {
        let id = RequestId(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        id
    }

    /// Passes due messages to `send`, and ends requests that ran out of attempts or time.
    pub(super) fn poll(&mut self, now: HostTime, mut send: impl FnMut(Action<'_>)) {
        for pending in self.pending.iter_mut().filter(|pending| pending.next <= now) {
            if pending.accepted || pending.attempts == ATTEMPTS {
                continue;
            }
            let confirmation = pending.attempts;
            pending.attempts += 1;
            pending.next = now + REPEAT;
            let name = match &pending.request {
                Request::ReadParameter(name) | Request::SetParameter { name, .. } => name.as_str(),
                _ => "",
            };
            send(match &mut pending.task {
                Task::Command { command, params, .. } => {
                    Action::Command { command: *command, params: *params, confirmation }
                }
                Task::Set { value, is_type_known: true, was_sent } => {
                    *was_sent = true;
                    Action::SetParameter { name, value: *value }
                }
                Task::Read | Task::Set { .. } => Action::ReadParameter(name),
            });
        }
        self.end_where(Outcome::NotInForce, |pending| pending.accepted && pending.next <= now);
        self.end_where(Outcome::NoAnswer, |pending| {
            pending.attempts == ATTEMPTS && pending.next <= now
        });
    }

    /// Takes a COMMAND_ACK.
    pub(super) fn acknowledged(&mut self, now: HostTime, command: u16, result: u8) {
        const ACCEPTED: u8 = 0;
        const IN_PROGRESS_RESULT: u8 = 5;
        let Some(index) = self
            .pending
            .iter()
            .position(|p| p.task.command().is_some_and(|sent| sent as u16 == command))
        else {
            return;
        };
        let pending = &mut self.pending[index];
        match result {
            ACCEPTED if matches!(pending.task, Task::Command { mode: Some(_), .. }) => {
                if !pending.accepted {
                    pending.accepted = true;
                    pending.next = now + READ_BACK;
                }
            }
            ACCEPTED => self.end(index, Outcome::Done),
            IN_PROGRESS_RESULT => pending.next = now + IN_PROGRESS,
            result => self.end(index, Outcome::Refused { result }),
        }
    }

    /// Takes the vehicle's present mode.
    pub(super) fn mode(&mut self, custom_mode: u32) {
        self.end_where(Outcome::Done, |pending| {
            let Task::Command { mode: Some(mode), .. } = pending.task else { return false };
            pending.attempts > 0 && mode.custom_mode == custom_mode
        });
    }

    /// Takes a PARAM_VALUE.
    pub(super) fn parameter(&mut self, now: HostTime, name: &str, found: f64) {
        let mut index = 0;
        while let Some(pending) = self.pending.get_mut(index) {
            let outcome = match (&pending.request, &mut pending.task) {
                (Request::ReadParameter(requested), Task::Read) if requested == name => {
                    Some(Outcome::Parameter(found))
                }
                (
                    Request::SetParameter { name: requested, .. },
                    Task::Set { value, is_type_known, was_sent },
                ) if requested == name => {
                    let is_same = (found - *value).abs() <= SAME * value.abs().max(1.0);
                    if !*is_type_known {
                        *is_type_known = true;
                        pending.attempts = 0;
                        pending.next = now;
                    }
                    match (is_same, *was_sent) {
                        (true, _) => Some(Outcome::Parameter(found)),
                        (false, true) if pending.attempts == ATTEMPTS => Some(Outcome::NotInForce),
                        (false, _) => None,
                    }
                }
                _ => None,
            };
            match outcome {
                Some(outcome) => self.end(index, outcome),
                None => index += 1,
            }
        }
    }

    /// Ends all requests, because the vehicle is gone.
    pub(super) fn abandon(&mut self) {
        self.end_where(Outcome::NoAnswer, |_| true);
    }

    /// Ends requests that make the vehicle act, because they are no longer wanted. Reads continue.
    pub(super) fn withdraw(&mut self) {
        self.end_where(Outcome::Withdrawn, |pending| !matches!(pending.task, Task::Read));
    }

    /// The requests that ended since the last call.
    pub(super) fn take_ended(&mut self) -> impl Iterator<Item = Ended> + '_ {
        self.ended.drain(..)
    }

    /// When the next request is due.
    pub(super) fn next_deadline(&self) -> Option<HostTime> {
        self.pending.iter().map(|pending| pending.next).min()
    }

    fn end(&mut self, index: usize, outcome: Outcome) {
        let pending = self.pending.remove(index);
        self.ended.push((pending.id, pending.request, outcome));
    }

    fn end_where(&mut self, outcome: Outcome, condition: impl Fn(&Pending) -> bool) {
        for pending in self.pending.extract_if(.., |pending| condition(pending)) {
            self.ended.push((pending.id, pending.request, outcome.clone()));
        }
    }
}

/// The task of a request, or the outcome that ends it at once.
fn task_of(
    request: &Request,
    profile: Option<&Profile>,
    is_type_known: impl Fn(&str) -> bool,
) -> Result<Task, Outcome> {
    let profile = profile.ok_or(Outcome::NotIdentified);
    let command = |command, params| Task::Command { command, params, mode: None };
    Ok(match request {
        Request::SetMode(mode) => {
            let modes = profile?.modes;
            let mode = match mode {
                FlightMode::Offboard => modes.offboard,
                FlightMode::Hold => modes.hold,
                FlightMode::Land => modes.land,
            };
            let mode = mode.ok_or(Outcome::Unsupported)?;
            // Param 1: MAV_MODE_FLAG_CUSTOM_MODE_ENABLED.
            let params = [1.0, mode.main.into(), mode.sub.into(), 0.0, 0.0, 0.0, 0.0];
            Task::Command { command: DO_SET_MODE, params, mode: Some(mode) }
        }
        Request::Arm => command(ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        Request::Disarm => command(ARM_DISARM, [0.0; 7]),
        Request::ReadParameter(_) => Task::Read,
        Request::SetParameter { name, value } => {
            if !value.is_finite() {
                return Err(Outcome::Unsupported);
            }
            Task::Set { value: *value, is_type_known: is_type_known(name), was_sent: false }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: HostTime = HostTime::from_ns(0);
    const OFFBOARD: u32 = 0x0006_0000;

    fn at(ms: u64) -> HostTime {
        START + Duration::from_millis(ms)
    }

    fn submit(requests: &mut Requests, request: Request) -> RequestId {
        requests.submit(START, request, Some(&Profile::PX4), |_| false)
    }

    fn sent(requests: &mut Requests, now: HostTime) -> Vec<String> {
        let mut sent = Vec::new();
        requests.poll(now, |action| sent.push(format!("{action:?}")));
        sent
    }

    fn outcomes(requests: &mut Requests) -> Vec<Outcome> {
        requests.take_ended().map(|(_, _, outcome)| outcome).collect()
    }

    #[test]
    fn mode_request_is_done_when_the_mode_is_reported() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::SetMode(FlightMode::Offboard));
        assert_eq!(sent(&mut requests, START).len(), 1);
        requests.acknowledged(at(3), DO_SET_MODE as u16, 0);
        assert_eq!(outcomes(&mut requests), []);
        requests.mode(0x0304_0000);
        assert_eq!(outcomes(&mut requests), []);
        requests.mode(OFFBOARD);
        assert_eq!(outcomes(&mut requests), [Outcome::Done]);
    }

    #[test]
    fn accept_followed_by_reject_is_a_reject() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::SetMode(FlightMode::Offboard));
        sent(&mut requests, START);
        requests.acknowledged(at(3), DO_SET_MODE as u16, 0);
        requests.acknowledged(at(9), DO_SET_MODE as u16, 1);
        assert_eq!(outcomes(&mut requests), [Outcome::Refused { result: 1 }]);
    }

    #[test]
    fn accepted_mode_that_is_never_reported_is_not_in_force() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::SetMode(FlightMode::Land));
        sent(&mut requests, START);
        requests.acknowledged(at(3), DO_SET_MODE as u16, 0);
        assert_eq!(sent(&mut requests, at(1000)).len(), 0);
        sent(&mut requests, at(3000));
        assert_eq!(outcomes(&mut requests), [Outcome::NotInForce]);
    }

    #[test]
    fn unanswered_request_is_repeated_and_then_reported() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::Arm);
        let mut count = 0;
        for ms in (0..3000).step_by(50) {
            count += sent(&mut requests, at(ms)).len();
        }
        assert_eq!(count, usize::from(ATTEMPTS));
        assert_eq!(outcomes(&mut requests), [Outcome::NoAnswer]);
        assert_eq!(requests.next_deadline(), None);
    }

    #[test]
    fn newer_request_supersedes_one_of_the_same_kind() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::SetMode(FlightMode::Offboard));
        sent(&mut requests, START);
        submit(&mut requests, Request::SetMode(FlightMode::Land));
        assert_eq!(outcomes(&mut requests), [Outcome::Superseded]);
        requests.mode(OFFBOARD);
        assert_eq!(outcomes(&mut requests), []);
    }

    #[test]
    fn withdrawn_request_is_not_repeated() {
        let mut requests = Requests::default();
        submit(&mut requests, Request::SetMode(FlightMode::Land));
        assert_eq!(sent(&mut requests, START).len(), 1);
        requests.withdraw();
        assert_eq!(sent(&mut requests, at(1000)).len(), 0);
        assert_eq!(outcomes(&mut requests), [Outcome::Withdrawn]);
    }

    #[test]
    fn parameter_is_read_then_set_then_read_back() {
        let mut requests = Requests::default();
        let request = Request::SetParameter { name: "COM_OF_LOSS_T".into(), value: 0.2 };
        submit(&mut requests, request);
        assert!(sent(&mut requests, START)[0].starts_with("ReadParameter"));
        requests.parameter(at(10), "COM_OF_LOSS_T", 1.0);
        assert!(sent(&mut requests, at(10))[0].starts_with("SetParameter"));
        requests.parameter(at(15), "OTHER", 0.2);
        requests.parameter(at(20), "COM_OF_LOSS_T", 0.2f32.into());
        assert_eq!(outcomes(&mut requests), [Outcome::Parameter(0.2f32.into())]);
    }

    #[test]
    fn request_missing_from_the_profile_is_unsupported() {
        let mut requests = Requests::default();
        let nothing = Request::SetParameter { name: "MIS_TAKEOFF_ALT".into(), value: f64::NAN };
        submit(&mut requests, nothing);
        let hold = Request::SetMode(FlightMode::Hold);
        requests.submit(START, hold, Some(&Profile::UNKNOWN), |_| false);
        assert_eq!(outcomes(&mut requests), [Outcome::Unsupported, Outcome::Unsupported]);
        requests.submit(START, Request::SetMode(FlightMode::Hold), None, |_| false);
        assert_eq!(outcomes(&mut requests), [Outcome::NotIdentified]);
    }
}
