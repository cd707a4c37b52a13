//! MAVLink frames with the ground's stamps, of both directions, into one flight.

use std::collections::{BTreeMap, VecDeque};

use mavlink::{Message as _, MessageData};
use message::attitude_target::{self, AttitudeTarget};
use wire::Frame;
use wire::dialect::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, SET_ATTITUDE_TARGET_DATA, TIMESYNC_DATA,
};

use super::LogFault;
use super::clocks::{Exchange, Heard};
use super::flight::{AttitudeSetpoint, Flight};
use super::setpoints::Sent;
use super::tally::Tally;
use super::vehicle::VehicleLog;

/// Senders that are followed; a log has a vehicle or two, and some ground stations.
const SENDERS_MAX: usize = 32;
/// A frame is only a repetition of one this many frames of its sender before, at most: half of
/// what sequence numbers tell apart.
const REPEATED_WITHIN: u64 = 128;
/// More frames than this are not missing: the sender began anew, or numbers came out of order.
const MISSING_MAX: u8 = 64;
/// Requests of TIMESYNC that can still be answered.
const OPEN_REQUESTS: usize = 16;

/// System and component.
type Sender = (u32, u8);

/// One sender's numbers, to tell repetitions and what is missing.
#[derive(Debug)]
struct Numbers {
    count: u64,
    last: Option<(u8, u32)>,
    /// Whether different frames had one sequence number in a row: this sender does not count.
    uncounted: bool,
    /// Of the newest frame that repeats none.
    newest: Option<u8>,
    /// Frames that are missing since the last setpoint.
    missing: u32,
    /// By sequence number: number of the frame, and checksum of its bytes.
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
    /// Whether the frame came before, with the same sequence number and content.
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
        if !is_repeated && let Some(newest) = self.newest.replace(sequence) {
            let skipped = sequence.wrapping_sub(newest).wrapping_sub(1);
            self.missing += if skipped <= MISSING_MAX { u32::from(skipped) } else { 0 };
        }
        is_repeated
    }
}

/// Gathers frames; [`Frames::finish`] makes a flight of them.
#[derive(Debug, Default)]
pub(super) struct Frames {
    index: u32,
    /// First ground stamp, ns: ground times count from it.
    start_ns: Option<u64>,
    latest: f64,
    numbers: BTreeMap<Sender, Numbers>,
    vehicles: BTreeMap<Sender, VehicleLog>,
    /// By sender and the system that they are for, 0 for all.
    setpoints: BTreeMap<(Sender, u8), Vec<Sent>>,
    /// `ts1` of open requests of TIMESYNC and when they left.
    requests: VecDeque<(i64, f64)>,
    /// Name of each message that came, by its number.
    seen: BTreeMap<u32, String>,
    tally: Tally,
}

impl Frames {
    /// Takes in a frame; `ground_ns` is the ground's clock, `None` where the log has no stamp.
    pub fn add(&mut self, ground_ns: Option<u64>, frame: &Frame) {
        self.index = self.index.saturating_add(1);
        if let Some(ns) = ground_ns {
            let start = *self.start_ns.get_or_insert(ns);
            self.latest = (i128::from(ns) - i128::from(start)) as f64 * 1e-9;
        }
        self.seen.entry(frame.id()).or_insert_with(|| match frame.message() {
            Ok(message) => message.message_name().to_owned(),
            Err(_) => format!("message {}", frame.id()),
        });
        let heard = Heard { index: self.index, ground: self.latest };
        let sender = (frame.system(), frame.component());
        if !self.numbers.contains_key(&sender) && self.numbers.len() == SENDERS_MAX {
            self.tally.add("frame of one sender too many", 1);
            return;
        }
        if self.numbers.entry(sender).or_default().is_repeated(frame) {
            self.tally.add("duplicated frame", 1);
            return;
        }
        match frame.id() {
            SET_ATTITUDE_TARGET_DATA::ID => self.add_setpoint(heard, sender, frame),
            TIMESYNC_DATA::ID => self.add_timesync(heard, sender, frame),
            // What is no autopilot, as a ground station, is no vehicle.
            HEARTBEAT_DATA::ID
                if frame.payload().get(5) == Some(&(MavAutopilot::MAV_AUTOPILOT_INVALID as u8)) => {
            }
            _ => self.vehicles.entry(sender).or_default().add(heard, frame),
        }
    }

    /// Counts what could not be read as frames.
    pub fn left_out(&mut self, reason: &str, count: u64) {
        self.tally.add(reason, count);
    }

    fn add_setpoint(&mut self, heard: Heard, sender: Sender, frame: &Frame) {
        match attitude_target::decode(frame) {
            Ok(Some(target)) => {
                let AttitudeTarget { time_boot_ms, target_system, attitude, body_rate, thrust } =
                    target;
                let setpoint = AttitudeSetpoint { attitude, body_rate, thrust };
                let numbers = self.numbers.entry(sender).or_default();
                let missing = std::mem::take(&mut numbers.missing);
                let stamp_s = f64::from(time_boot_ms) * 1e-3;
                let sent = self.setpoints.entry((sender, target_system)).or_default();
                sent.push(Sent { heard, stamp_s, missing, setpoint });
            }
            Ok(None) => {}
            Err(refusal) => self.tally.add(&format!("SET_ATTITUDE_TARGET: {refusal}"), 1),
        }
    }

    /// Requests have no `tc1`; an answer repeats the request's `ts1`. Who asks stamps `ts1`, who
    /// answers stamps `tc1`: only what the ground asked was stamped here on both ways.
    fn add_timesync(&mut self, heard: Heard, sender: Sender, frame: &Frame) {
        let Ok(MavMessage::TIMESYNC(data)) = frame.message() else { return };
        if data.tc1 == 0 {
            if self.requests.len() == OPEN_REQUESTS {
                self.requests.pop_front();
            }
            self.requests.push_back((data.ts1, heard.ground));
        } else if let Some(at) = self.requests.iter().position(|(ts1, _)| *ts1 == data.ts1)
            && let Some((_, asked)) = self.requests.remove(at)
        {
            let vehicle = data.tc1 as f64 * 1e-9;
            let log = self.vehicles.entry(sender).or_default();
            log.synchronise(Exchange { asked, answered: heard, vehicle });
        }
    }

    /// Fills `flight` with the vehicle that sent most. Returns what else was sent.
    ///
    /// # Errors
    /// A boot that the vehicle does not have.
    pub fn finish(self, boot: Option<usize>, flight: &mut Flight) -> Result<Vec<String>, LogFault> {
        let Self { mut vehicles, mut setpoints, mut tally, seen, .. } = self;
        let any_autopilot = vehicles.values().any(VehicleLog::is_autopilot);
        let weight = |log: &VehicleLog| {
            (log.is_autopilot() == any_autopilot, log.attitudes(), log.messages())
        };
        let chosen =
            vehicles.iter().rev().max_by_key(|(_, log)| weight(log)).map(|(sender, _)| *sender);
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
            tally.merge(vehicle.finish(sent, boot, flight)?);
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
