//! Summary of a log's content.

use std::collections::BTreeMap;
use std::io::Read;

use prost::Message as _;
use schemars::JsonSchema;
use serde::Serialize;

use super::reader::{LogReader, Message, ReadError};
use super::schema::{BatteryMessage, ControlMessage};

/// Number of events listed; the rest are only counted.
const EVENTS_LISTED: usize = 1000;
/// A pause this many times longer than the median interval is a gap.
const GAP_FACTOR: f64 = 3.0;

/// A log's summary, and the JSON of `downwash log info --json`.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LogInfo {
    /// `downwash.log.info`.
    pub schema: &'static str,
    /// Version of this JSON.
    pub schema_version: u32,
    /// Whether the log was closed properly.
    pub finished: bool,
    /// Number of readable messages.
    pub messages: u64,
    /// Number of damaged parts that were skipped.
    pub damaged: u64,
    /// Descriptions of the first damaged parts.
    pub damages: Vec<String>,
    /// First `log_time`, ns since 1970; 0 if the log is empty.
    pub start_ns: u64,
    /// Last `log_time` minus first, s.
    pub duration_s: f64,
    /// Facts about the run, from the metadata record `run`.
    pub run: BTreeMap<String, String>,
    /// Attached files and their sizes in bytes.
    pub attachments: BTreeMap<String, usize>,
    /// Topics, sorted by name.
    pub topics: Vec<TopicInfo>,
    /// Flight states in order of time.
    pub phases: Vec<PhaseInfo>,
    /// Tracking errors, if a trajectory was flown.
    pub tracking: Option<TrackingInfo>,
    /// Extremes of the battery, if it was reported.
    pub battery: Option<BatteryInfo>,
    /// The first 1000 events.
    pub events: Vec<EventInfo>,
    /// Number of events.
    pub events_total: u64,
    /// Number of events by level, listed or not.
    pub events_by_level: BTreeMap<&'static str, u64>,
}

/// Summary of one topic.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct TopicInfo {
    /// Name.
    pub topic: String,
    /// Type of the messages.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
    /// Bytes of message bodies.
    pub bytes: u64,
    /// Mean rate from the topic's first to its last message, 1/s; `null` for fewer than two
    /// messages.
    pub rate_hz: Option<f64>,
    /// Longest pause between two messages, s.
    pub longest_gap_s: f64,
    /// Number of pauses longer than three times the median interval.
    pub gaps: u64,
}

/// One flight state with its duration.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct PhaseInfo {
    /// Name.
    pub name: String,
    /// Start, s after the log's start.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
}

/// Position errors while a trajectory was flown.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct TrackingInfo {
    /// Number of control ticks with a trajectory.
    pub ticks: u64,
    /// Root mean square of the error along north, m.
    pub rmse_n_m: f64,
    /// Root mean square of the error along east, m.
    pub rmse_e_m: f64,
    /// Root mean square of the error along down, m.
    pub rmse_d_m: f64,
    /// Root mean square of the error's norm, m.
    pub rmse_3d_m: f64,
    /// Largest norm of the error, m.
    pub max_3d_m: f64,
}

/// Extremes of the battery.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct BatteryInfo {
    /// Lowest voltage, V; `null` where unknown.
    pub voltage_min_v: Option<f64>,
    /// Highest voltage, V.
    pub voltage_max_v: Option<f64>,
    /// Highest current, A.
    pub current_max_a: Option<f64>,
    /// Last known remaining charge in 0..1.
    pub remaining_ratio: Option<f64>,
}

/// One line of `/log`.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct EventInfo {
    /// Time, s after the log's start.
    pub time_s: f64,
    /// `debug`, `info`, `warning`, `error` or `fatal`.
    pub level: &'static str,
    /// Source: the vehicle or downwash.
    pub source: String,
    /// Text of the event.
    pub text: String,
}

impl LogInfo {
    /// Reads the rest of `reader`.
    ///
    /// # Errors
    /// [`ReadError::Io`]; a damaged or unfinished log is not an error.
    pub fn read<R: Read>(reader: &mut LogReader<R>) -> Result<Self, ReadError> {
        Self::read_with(reader, |_| {})
    }

    /// Reads the rest of `reader` and passes each message to `visit`.
    ///
    /// # Errors
    /// [`ReadError::Io`].
    pub fn read_with<R: Read>(
        reader: &mut LogReader<R>,
        mut visit: impl FnMut(&Message<'_>),
    ) -> Result<Self, ReadError> {
        let mut scan = Scan::default();
        while let Some(message) = reader.next_message()? {
            scan.add(&message);
            visit(&message);
        }
        let ending = reader.ending();
        let start = scan.start_ns.unwrap_or(0);
        let duration_s = seconds(start, scan.end_ns);
        if let Some(last) = scan.phases.last_mut() {
            last.duration_s = seconds(start, scan.phase_end_ns) - last.start_s;
        }
        Ok(Self {
            schema: "downwash.log.info",
            schema_version: 1,
            finished: ending.finished,
            messages: scan.topics.values().map(|t| t.messages).sum(),
            damaged: ending.damaged,
            damages: ending.damages.clone(),
            start_ns: start,
            duration_s,
            run: reader.run().clone(),
            attachments: reader
                .attachments()
                .iter()
                .map(|a| (a.name.clone(), a.data.len()))
                .collect(),
            topics: scan.topics.into_iter().map(|(topic, t)| t.info(topic)).collect(),
            phases: scan.phases,
            tracking: scan.tracking.info(),
            battery: scan.battery,
            events: scan.events,
            events_total: scan.events_by_level.values().sum(),
            events_by_level: scan.events_by_level,
        })
    }
}

/// Sums of squares that become a [`TrackingInfo`].
#[derive(Clone, Copy, Debug, Default)]
struct TrackingSums {
    ticks: u64,
    squares: [f64; 3],
    max: f64,
}

impl TrackingSums {
    /// Adds a tick, if a trajectory was flown and the error is known.
    fn add(&mut self, control: &ControlMessage) {
        if !is_tracking(control) {
            return;
        }
        let error = [control.error_n_m, control.error_e_m, control.error_d_m];
        self.ticks += 1;
        for (sum, e) in self.squares.iter_mut().zip(error) {
            *sum += e * e;
        }
        self.max = self.max.max(control.error_3d_m);
    }

    /// The root mean squares; `None` without ticks.
    fn info(&self) -> Option<TrackingInfo> {
        let n = self.ticks as f64;
        let [rmse_n_m, rmse_e_m, rmse_d_m] = self.squares.map(|s| (s / n).sqrt());
        (self.ticks > 0).then(|| TrackingInfo {
            ticks: self.ticks,
            rmse_n_m,
            rmse_e_m,
            rmse_d_m,
            rmse_3d_m: (self.squares.iter().sum::<f64>() / n).sqrt(),
            max_3d_m: self.max,
        })
    }
}

/// Whether a trajectory was flown at a tick and the error is known.
pub fn is_tracking(control: &ControlMessage) -> bool {
    let error = [control.error_n_m, control.error_e_m, control.error_d_m];
    !control.trajectory_time_s.is_nan() && error.iter().all(|e| e.is_finite())
}

/// Seconds from `start` to `time`, both in ns.
fn seconds(start: u64, time: u64) -> f64 {
    time.saturating_sub(start) as f64 * 1e-9
}

/// Decodes `message` if it is a line of `/log`; times count from `start_ns`.
fn event(message: &Message<'_>, start_ns: u64) -> Option<EventInfo> {
    if message.channel.schema != "foxglove.Log" {
        return None;
    }
    let log = foxglove::messages::Log::decode(message.data).ok()?;
    let level = match log.level {
        0 | 1 => "debug",
        2 => "info",
        3 => "warning",
        4 => "error",
        _ => "fatal",
    };
    let time_s = seconds(start_ns, message.log_time.as_ns());
    Some(EventInfo { time_s, level, source: log.name, text: log.message })
}

/// State of the scan through a log.
#[derive(Default)]
struct Scan {
    start_ns: Option<u64>,
    end_ns: u64,
    topics: BTreeMap<String, Topic>,
    phases: Vec<PhaseInfo>,
    phase_end_ns: u64,
    tracking: TrackingSums,
    battery: Option<BatteryInfo>,
    events: Vec<EventInfo>,
    events_by_level: BTreeMap<&'static str, u64>,
}

impl Scan {
    fn add(&mut self, message: &Message<'_>) {
        let time = message.log_time.as_ns();
        let start = *self.start_ns.get_or_insert(time);
        self.end_ns = self.end_ns.max(time);
        match self.topics.get_mut(&message.channel.topic) {
            Some(topic) => topic.add(message),
            None => {
                let mut topic = Topic::new(&message.channel.schema);
                topic.add(message);
                self.topics.insert(message.channel.topic.clone(), topic);
            }
        }
        if let Some(control) = message.decode::<ControlMessage>() {
            self.tracking.add(&control);
            self.add_phase(control.phase, seconds(start, time));
            self.phase_end_ns = time;
        } else if let Some(battery) = message.decode::<BatteryMessage>() {
            self.add_battery(&battery);
        } else if let Some(event) = event(message, start) {
            *self.events_by_level.entry(event.level).or_insert(0) += 1;
            if self.events.len() < EVENTS_LISTED {
                self.events.push(event);
            }
        }
    }

    fn add_phase(&mut self, name: String, start_s: f64) {
        if let Some(last) = self.phases.last_mut() {
            if last.name == name {
                return;
            }
            last.duration_s = start_s - last.start_s;
        }
        self.phases.push(PhaseInfo { name, start_s, duration_s: 0.0 });
    }

    fn add_battery(&mut self, message: &BatteryMessage) {
        let known = |x: f64| x.is_finite().then_some(x);
        let battery = self.battery.get_or_insert(BatteryInfo {
            voltage_min_v: None,
            voltage_max_v: None,
            current_max_a: None,
            remaining_ratio: None,
        });
        if let Some(v) = known(message.voltage_v) {
            battery.voltage_min_v = Some(battery.voltage_min_v.map_or(v, |m| m.min(v)));
            battery.voltage_max_v = Some(battery.voltage_max_v.map_or(v, |m| m.max(v)));
        }
        if let Some(a) = known(message.current_a) {
            battery.current_max_a = Some(battery.current_max_a.map_or(a, |m| m.max(a)));
        }
        battery.remaining_ratio = known(message.remaining_ratio).or(battery.remaining_ratio);
    }
}

/// Bins of the histogram of intervals: eight per octave from 1 us up, which gives the median within
/// 9 % in fixed memory.
const BINS: usize = 256;

struct Topic {
    schema: String,
    messages: u64,
    bytes: u64,
    first_ns: u64,
    last_ns: u64,
    longest_ns: u64,
    intervals: [u32; BINS],
}

impl Topic {
    fn new(schema: &str) -> Self {
        Self {
            schema: schema.into(),
            messages: 0,
            bytes: 0,
            first_ns: 0,
            last_ns: 0,
            longest_ns: 0,
            intervals: [0; BINS],
        }
    }

    fn add(&mut self, message: &Message<'_>) {
        let time = message.log_time.as_ns();
        if self.messages == 0 {
            self.first_ns = time;
        } else {
            let interval = time.saturating_sub(self.last_ns);
            self.longest_ns = self.longest_ns.max(interval);
            self.intervals[bin(interval)] += 1;
        }
        self.last_ns = time;
        self.messages += 1;
        self.bytes += message.data.len() as u64;
    }

    fn info(self, topic: String) -> TopicInfo {
        let span = seconds(self.first_ns, self.last_ns);
        let intervals = self.messages.saturating_sub(1);
        let mut below = 0u64;
        let median = self.intervals.iter().position(|count| {
            below += u64::from(*count);
            2 * below >= intervals
        });
        let gap_bins = (GAP_FACTOR.log2() * 8.0).ceil() as usize;
        let gaps = self.intervals.iter().skip(median.unwrap_or(0) + gap_bins + 1);
        TopicInfo {
            topic,
            schema: self.schema,
            messages: self.messages,
            bytes: self.bytes,
            rate_hz: (intervals > 0 && span > 0.0).then(|| intervals as f64 / span),
            longest_gap_s: self.longest_ns as f64 * 1e-9,
            gaps: gaps.map(|count| u64::from(*count)).sum(),
        }
    }
}

fn bin(interval_ns: u64) -> usize {
    let octaves = (interval_ns as f64 / 1000.0).max(1.0).log2();
    ((octaves * 8.0) as usize).min(BINS - 1)
}
