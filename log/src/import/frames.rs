//! Turns MAVLink frames of both directions, with the ground's time stamps, into one flight.

use std::collections::{BTreeMap, VecDeque};

use mavlink::MessageData;
use message::attitude_target::{self, AttitudeTarget};
use wire::dialect::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, SET_ATTITUDE_TARGET_DATA, TIMESYNC_DATA,
};
use wire::{Frame, message_name};

use super::clocks::{Exchange, FrameTime};
use super::flight::{AttitudeSetpoint, Flight};
use super::setpoints::Sent;
use super::tally::Tally;
use super::vehicle::VehicleLog;
use super::{Choice, LogFault};

/// Largest number of senders; a log has one or two vehicles and some ground stations.
const SENDERS_MAX: usize = 32;
/// A frame counts as a repetition only of one of this many previous frames from its sender: half
/// the range of sequence numbers.
const REPEATED_WITHIN: u64 = 128;
/// A larger gap does not mean missing frames: the sender restarted, or frames are out of order.
const MISSING_MAX: u8 = 64;
/// Why a frame of a flight log is left out.
pub(super) const UNREAD_FRAME: &str = "frame that is damaged or unknown to the dialect";
/// Number of TIMESYNC requests that replies can match.
const REQUESTS_KEPT: usize = 16;

/// System id and component id.
type Sender = (u32, u8);

/// One sender's sequence numbers, to detect repeated and missing frames.
#[derive(Debug)]
struct Numbers {
    count: u64,
    last: Option<(u8, u32)>,
    /// Whether consecutive different frames had the same sequence number: this sender does not
    /// count.
    uncounted: bool,
    /// Sequence number of the newest frame that is not a repetition.
    newest: Option<u8>,
    /// Number of frames missing since the last setpoint.
    missing: u32,
    /// Number and checksum of the latest frame with each sequence number.
    recent: Box<[(u64, u32); 256]>,
}

impl Default for Numbers {
    fn default() -> Self {
        Self {
            count: 0,
            last: None,
            uncounted: false,
            newest: None,
            missing: 0,
            recent: Box::new([(0, 0); 256]),
        }
    }
}

impl Numbers {
    /// Whether a frame with the same sequence number and content came before.
    fn is_repeated(&mut self, frame: &Frame) -> bool {
        let sequence = frame.sequence();
        let hash = crc32fast::hash(frame.bytes());
        if let Some((last, before)) = self.last.replace((sequence, hash)) {
            self.uncounted =
                if last == sequence { self.uncounted || before != hash } else { false };
        }
        self.count += 1;
        let slot = &mut self.recent[usize::from(sequence)];
        let (number, before) = std::mem::replace(slot, (self.count, hash));
        let is_recent = number > 0 && self.count - number <= REPEATED_WITHIN;
        let is_repeated = is_recent && before == hash && !self.uncounted;
        if !is_repeated {
            self.count_missing(sequence);
        }
        is_repeated
    }

    /// Counts the frames missing before one with this sequence number.
    fn count_missing(&mut self, sequence: u8) {
        let newest = self.newest.unwrap_or(sequence.wrapping_sub(1));
        let (ahead, behind) = (sequence.wrapping_sub(newest), newest.wrapping_sub(sequence));
        if (1..=MISSING_MAX).contains(&behind) {
            // Others overtook it. It was counted when they came.
            self.missing = self.missing.saturating_sub(1);
            return;
        }
        if (1..=MISSING_MAX + 1).contains(&ahead) {
            self.missing = self.missing.saturating_add(u32::from(ahead) - 1);
        }
        self.newest = Some(sequence);
    }
}

/// Collects frames; [`Frames::finish`] turns them into a flight.
#[derive(Debug, Default)]
pub(super) struct Frames {
    index: u32,
    /// First time stamp of the ground, ns; ground times count from it.
    start_ns: Option<u64>,
    latest: f64,
    numbers: BTreeMap<Sender, Numbers>,
    vehicles: BTreeMap<Sender, VehicleLog>,
    /// Setpoints by sender and target system, 0 for all.
    setpoints: BTreeMap<(Sender, u8), Vec<Sent>>,
    /// `ts1` and ground time of the newest TIMESYNC requests; several vehicles may answer one.
    requests: VecDeque<(i64, f64)>,
    /// Names of the messages received, by id.
    seen: BTreeMap<u32, String>,
    tally: Tally,
}

impl Frames {
    /// Adds a frame; `ground_ns` is the ground's clock, `None` if the log has no time stamp.
    pub fn add(&mut self, ground_ns: Option<u64>, frame: &Frame) {
        self.index = self.index.saturating_add(1);
        if let Some(ns) = ground_ns {
            let start = *self.start_ns.get_or_insert(ns);
            self.latest = (i128::from(ns) - i128::from(start)) as f64 * 1e-9;
        }
        self.seen.entry(frame.id()).or_insert_with(|| message_name(frame.id()));
        let frame_time = FrameTime { index: self.index, ground: self.latest };
        let sender = (frame.system(), frame.component());
        if !self.numbers.contains_key(&sender) && self.numbers.len() == SENDERS_MAX {
            self.tally.add("frame from one sender too many", 1);
            return;
        }
        if self.numbers.entry(sender).or_default().is_repeated(frame) {
            self.tally.add("duplicated frame", 1);
            return;
        }
        match frame.id() {
            SET_ATTITUDE_TARGET_DATA::ID => self.add_setpoint(frame_time, sender, frame),
            TIMESYNC_DATA::ID => self.add_timesync(frame_time, sender, frame),
            // A sender that is not an autopilot, such as a ground station, is not a vehicle.
            HEARTBEAT_DATA::ID
                if frame.payload().get(5) == Some(&(MavAutopilot::MAV_AUTOPILOT_INVALID as u8)) => {
            }
            _ => self.vehicles.entry(sender).or_default().add(frame_time, frame),
        }
    }

    /// Counts data that cannot be read as frames.
    pub fn left_out(&mut self, reason: &str, count: u64) {
        self.tally.add(reason, count);
    }

    /// Records a description of lost data.
    pub fn lose(&mut self, what: String) {
        self.tally.lose(what);
    }

    fn add_setpoint(&mut self, frame_time: FrameTime, sender: Sender, frame: &Frame) {
        match attitude_target::decode(frame) {
            Ok(Some(target)) => {
                let AttitudeTarget { time_boot_ms, target_system, attitude, body_rate, thrust } =
                    target;
                let setpoint = AttitudeSetpoint { attitude, body_rate, thrust };
                let numbers = self.numbers.entry(sender).or_default();
                let missing = std::mem::take(&mut numbers.missing);
                let stamp_s = f64::from(time_boot_ms) * 1e-3;
                let sent = self.setpoints.entry((sender, target_system)).or_default();
                sent.push(Sent { frame_time, stamp_s, missing, setpoint });
            }
            Ok(None) => {}
            Err(refusal) => self.tally.add(&format!("SET_ATTITUDE_TARGET: {refusal}"), 1),
        }
    }

    /// Requests have no `tc1`; a reply repeats the request's `ts1`. The requester stamps `ts1` and
    /// the responder `tc1`, so only the ground's requests have ground times for both directions.
    fn add_timesync(&mut self, frame_time: FrameTime, sender: Sender, frame: &Frame) {
        let Ok(MavMessage::TIMESYNC(data)) = frame.message() else { return };
        if data.tc1 == 0 {
            if self.requests.len() == REQUESTS_KEPT {
                self.requests.pop_front();
            }
            self.requests.push_back((data.ts1, frame_time.ground));
        } else if let Some((_, requested)) = self.requests.iter().find(|(ts1, _)| *ts1 == data.ts1)
        {
            let (requested, vehicle) = (*requested, data.tc1 as f64 * 1e-9);
            let log = self.vehicles.entry(sender).or_default();
            log.synchronise(Exchange { requested, answered: frame_time, vehicle });
        }
    }

    /// Fills `flight` with one vehicle, of the chosen system where one is chosen: autopilots first,
    /// then those that flew longest in one boot, then the one with most attitudes, then with most
    /// messages. Notes the other vehicles. Returns the names of all messages.
    ///
    /// # Errors
    /// The log has no vehicle of the chosen system, or the vehicle does not have the chosen boot.
    pub fn finish(self, choice: Choice<'_>, flight: &mut Flight) -> Result<Vec<String>, LogFault> {
        let Self { mut vehicles, mut setpoints, mut tally, seen, .. } = self;
        let any_autopilot = vehicles.values().any(VehicleLog::is_autopilot);
        let flown_s = |log: &VehicleLog| log.flown().into_iter().fold(0.0, f64::max);
        let longest_s = vehicles.values().map(flown_s).fold(0.0, f64::max);
        // States arrive at a low rate: nearly the same time is the same.
        let has_flown = |log: &VehicleLog| flown_s(log) >= 0.8 * longest_s;
        let weight = |log: &VehicleLog| {
            let is_kind = log.is_autopilot() == any_autopilot;
            (is_kind, has_flown(log), log.attitudes(), log.messages())
        };
        let is_chosen =
            |sender: &Sender| choice.system.is_none_or(|system| sender.0 == u32::from(system));
        let candidates = vehicles.iter().rev().filter(|(sender, _)| is_chosen(sender));
        let chosen = candidates.max_by_key(|(_, log)| weight(log)).map(|(sender, _)| *sender);
        if let (None, Some(system)) = (chosen, choice.system) {
            let mut systems: Vec<u32> = vehicles.keys().map(|sender| sender.0).collect();
            systems.dedup();
            let systems: Vec<String> = systems.iter().map(u32::to_string).collect();
            let found = match systems.as_slice() {
                [] => "this log has none".to_owned(),
                systems => format!("this log has {}", systems.join(", ")),
            };
            return Err(LogFault::NoSystem { system, found });
        }
        if let Some(chosen) = chosen
            && let Some(vehicle) = vehicles.remove(&chosen)
        {
            let is_for =
                |(_, target): &(Sender, u8)| *target == 0 || u32::from(*target) == chosen.0;
            let commander = setpoints
                .iter()
                .filter(|(key, _)| is_for(key))
                .rev()
                .max_by_key(|(_, sent)| sent.len())
                .map(|(key, _)| *key);
            let sent = commander.and_then(|key| setpoints.remove(&key)).unwrap_or_default();
            tally.merge(vehicle.finish(sent, choice.boot, flight)?);
            let is_vehicle = |(_, log): &(&Sender, &VehicleLog)| {
                log.is_autopilot() == any_autopilot && log.attitudes() > 0
            };
            let others = vehicles.iter().filter(is_vehicle);
            let others: Vec<String> = others.map(|(sender, _)| sender.0.to_string()).collect();
            if !others.is_empty() {
                let why = match choice.system {
                    Some(_) => "chosen by --system",
                    None => "which flew as long as any and sent most (--system chooses another)",
                };
                flight.facts.notes.push(format!(
                    "of several vehicles, system {} is read, {why}; the others are {}",
                    chosen.0,
                    others.join(", ")
                ));
            }
        }
        for (((system, component), target), sent) in setpoints {
            let reason = format!("setpoint from {system}/{component} to system {target}");
            tally.add(&reason, sent.len() as u64);
        }
        for ((system, component), log) in vehicles {
            let reason = format!("message of another vehicle or component, {system}/{component}");
            tally.add(&reason, log.messages());
        }
        tally.give(flight);
        Ok(seen.into_values().collect())
    }
}

#[cfg(test)]
mod tests {
    use wire::Encoder;
    use wire::dialect::*;

    use super::*;

    /// Frames of system 1, which is armed, and of system 2.
    fn of_two_vehicles() -> Frames {
        let mut frames = Frames::default();
        let mut encoders = [Encoder::new(1, 1), Encoder::new(2, 1)];
        for step in 0..400_u32 {
            let mut send = |vehicle: usize, message: MavMessage| {
                let mut bytes = Vec::new();
                encoders[vehicle].encode(&message, &mut bytes);
                let frame = Frame::parse(&bytes).expect("a frame");
                frames.add(Some(20_000_000 * u64::from(step)), &frame);
            };
            for (vehicle, armed) in [(0, true), (1, false)] {
                if step % 50 == 0 {
                    let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
                    let base_mode = if armed {
                        MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
                    } else {
                        MavModeFlag::empty()
                    };
                    let data = HEARTBEAT_DATA { autopilot, base_mode, ..Default::default() };
                    send(vehicle, MavMessage::HEARTBEAT(data));
                }
                // The one on the ground sends more.
                if !armed || step % 4 == 0 {
                    let data = ATTITUDE_DATA { time_boot_ms: 20 * step, ..Default::default() };
                    send(vehicle, MavMessage::ATTITUDE(data));
                }
            }
        }
        frames
    }

    #[test]
    fn the_vehicle_that_flew_is_read_unless_another_is_chosen() {
        let read = |system: Option<u8>| {
            let mut flight = Flight::in_memory("memory", "tlog");
            let choice = Choice { system, ..Choice::default() };
            of_two_vehicles().finish(choice, &mut flight).map(|_| flight)
        };
        for (system, read_system, other, attitudes) in [(None, 1, 2, 100), (Some(2), 2, 1, 400)] {
            let flight = read(system).expect("a flight");
            assert_eq!(flight.attitude.len(), attitudes);
            let is_noted = |text: String| flight.facts.notes.iter().any(|n| n.contains(&text));
            assert!(is_noted(format!("system {read_system} is read")));
            assert!(is_noted(format!("the others are {other}")));
        }
        let Err(LogFault::NoSystem { system: 7, found }) = read(Some(7)) else {
            panic!("a flight of no vehicle")
        };
        assert_eq!(found, "this log has 1, 2");
    }
}
