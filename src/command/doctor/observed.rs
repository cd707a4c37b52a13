//! What was received while listening, as numbers and as text.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use message::{Inbound, LandedState};
use schemars::JsonSchema;
use serde::Serialize;
use wire::message_name;

use crate::command::listen::Listener;
use crate::config::Config;
use crate::link::budget::LineBudget;
use crate::link::loss_reaction::LossReaction;
use crate::link::profile::Profile;
use crate::link::request::Request;
use crate::link::session::Delivery;
use crate::link::vehicle_clock::ClockSource;
use crate::telemetry::Telemetry;

/// Further parameters that decide how a flight goes, besides those of the profile.
const PX4_PARAMETERS: &[&str] = &["COM_RC_IN_MODE", "COM_RCL_EXCEPT", "COM_ARM_WO_GPS"];
const ARDUCOPTER_PARAMETERS: &[&str] = &["ARMING_CHECK", "FS_THR_ENABLE"];
/// Rate below which rates over the last second mean nothing, Hz.
const SLOW_HZ: f64 = 3.0;
/// Number of the vehicle's texts that are kept.
const TEXTS_MAX: usize = 20;

/// What was received while listening.
pub(super) struct Observed {
    pub telemetry: Telemetry,
    pub version: Option<u32>,
    pub texts: Vec<String>,
    /// MAV_SYS_STATUS_SENSOR bits of the healthy parts.
    pub health: Option<u32>,
    frames: BTreeSet<(String, String)>,
    requested: Option<Vec<String>>,
    round_trips_s: Vec<f64>,
}

impl Observed {
    pub(super) fn new(config: &Config) -> Self {
        let mut settings = config.settings.offboard.telemetry;
        settings.rate_hz = config.settings.control.rate_hz;
        Self {
            telemetry: Telemetry::new(settings),
            version: None,
            texts: Vec::new(),
            health: None,
            frames: BTreeSet::new(),
            requested: None,
            round_trips_s: Vec::new(),
        }
    }

    pub(super) fn take(&mut self, delivery: Delivery<'_>) {
        match delivery {
            Delivery::Frame { bytes, .. } => self.odometry_frame(bytes),
            Delivery::Replaced => self.telemetry.forget(),
            Delivery::Message(received) => {
                // Jumps and late messages are counted elsewhere.
                let _ = self.telemetry.update(&received);
                match received.message {
                    Inbound::AutopilotVersion { flight_sw_version, .. } => {
                        self.version = Some(flight_sw_version);
                    }
                    Inbound::StatusText { text, .. }
                        if self.texts.len() < TEXTS_MAX && !self.texts.contains(&text) =>
                    {
                        self.texts.push(text);
                    }
                    Inbound::SysStatus { health, .. } => self.health = Some(health),
                    _ => {}
                }
            }
        }
    }

    fn odometry_frame(&mut self, bytes: &[u8]) {
        let frame = wire::Frame::parse(bytes).and_then(|frame| frame.message().ok());
        if let Some(wire::dialect::MavMessage::ODOMETRY(data)) = frame {
            let names = (format!("{:?}", data.frame_id), format!("{:?}", data.child_frame_id));
            self.frames.insert(names);
        }
    }

    /// Requests the parameters once the vehicle is identified.
    pub(super) fn follow(&mut self, listener: &mut Listener) {
        let session = &mut listener.session;
        let round_trip = session.stats().round_trip;
        self.round_trips_s.extend(round_trip.map(|time| time.as_secs_f64()));
        let Some(profile) = session.profile().filter(|_| self.requested.is_none()) else { return };
        let more = match profile.name {
            name if name == Profile::ARDUCOPTER.name => ARDUCOPTER_PARAMETERS,
            name if name == Profile::UNKNOWN.name => &[],
            _ => PX4_PARAMETERS,
        };
        let rules = profile.required.iter().chain(&profile.loss_timeout).map(|rule| rule.name);
        let names =
            rules.chain(profile.loss.parameters().iter().copied()).chain(more.iter().copied());
        let names: BTreeSet<String> = names.map(str::to_owned).collect();
        let now = listener.clock.now();
        for name in &names {
            session.request(now, Request::ReadParameter(name.clone()));
        }
        self.requested = Some(names.into_iter().collect());
    }

    pub(super) fn report(&self, listener: &Listener, seconds: f64) -> Report {
        let session = &listener.session;
        let stats = session.stats();
        let status = self.telemetry.status();
        let [odometry_hz, attitude_hz, position_hz] = self.telemetry.rates_hz();
        let clock = stats.clock;
        let mut round_trips = self.round_trips_s.clone();
        round_trips.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = round_trips.len().checked_sub(1)?;
            round_trips.get((share * last as f64) as usize).copied()
        };
        let budget = match (&listener.endpoint, session.profile()) {
            (wire::Endpoint::Serial { baud, .. }, Some(profile)) => {
                Some(LineBudget::fit(profile.telemetry, *baud).to_string())
            }
            _ => None,
        };
        Report {
            endpoint: listener.endpoint.to_string(),
            seconds,
            bytes: stats.received.bytes,
            frames: stats.received.frames,
            bytes_per_s: stats.received.bytes as f64 / seconds,
            wrong_checksums: stats.received.crc_errors,
            unknown_frames: stats.received.unknown,
            lost_frames: stats.lost,
            repeated_frames: stats.repeated,
            lost_share: stats.lost as f64 / ((stats.lost + stats.vehicle_frames) as f64).max(1.0),
            vehicle: session.vehicle().map(|id| id.to_string()),
            autopilot: session.profile().map(|profile| profile.name),
            version: self.version.map(version),
            mavlink: session.protocol(),
            is_signed: session.is_signed(),
            others: session.others().iter().map(ToString::to_string).collect(),
            senders: session.senders().iter().map(ToString::to_string).collect(),
            mode: status.mode,
            intended_mode: status.intended_mode,
            armed: status.armed,
            landed: match status.landed {
                LandedState::Undefined => None,
                landed => Some(format!("{landed:?}")),
            },
            battery_v: status.battery.voltage,
            battery_share: status.battery.remaining,
            odometry_hz,
            odometry_frames: self.frames.iter().map(|(f, c)| format!("{f}, child {c}")).collect(),
            attitude_hz,
            position_hz,
            clock: clock.map(|clock| match clock.source {
                ClockSource::Timesync => "TIMESYNC",
                ClockSource::Arrival => "stamps",
            }),
            clock_error_s: clock.and_then(|clock| clock.error_ns).map(|ns| ns as f64 * 1e-9),
            clock_skew: clock.map(|clock| clock.skew),
            round_trip_p50_s: at(0.5),
            round_trip_max_s: at(1.0),
            budget,
            serial_latency_timer_ms: latency_timer(&listener.endpoint),
            loss_reaction: session.profile().and_then(|profile| {
                let own = listener.config.settings.link.system;
                match profile.loss.reaction(&status.parameters, own) {
                    LossReaction::Acts(text) => Some(text),
                    _ => None,
                }
            }),
            parameters: self
                .requested
                .iter()
                .flatten()
                .filter_map(|name| status.parameters.get(name).map(|value| (name.clone(), *value)))
                .collect(),
            messages: stats
                .messages
                .iter()
                .map(|message| MessageRow {
                    id: message.id,
                    name: message_name(message.id),
                    rate_hz: if message.rate_hz < SLOW_HZ {
                        message.total as f64 / seconds
                    } else {
                        message.rate_hz
                    },
                    count: message.total,
                })
                .collect(),
            texts: self.texts.clone(),
        }
    }
}

/// Major, minor and patch of the firmware, from the highest byte down.
fn version(packed: u32) -> String {
    let [major, minor, patch, _] = packed.to_be_bytes();
    format!("{major}.{minor}.{patch}")
}

/// How long an FTDI serial adapter waits for more bytes before it delivers them, ms.
fn latency_timer(endpoint: &wire::Endpoint) -> Option<u32> {
    let wire::Endpoint::Serial { path, .. } = endpoint else { return None };
    let device = std::fs::canonicalize(path).ok()?;
    let name = device.file_name()?.to_str()?;
    let file = format!("/sys/bus/usb-serial/devices/{name}/latency_timer");
    std::fs::read_to_string(file).ok()?.trim().parse().ok()
}

/// All that was received, as numbers.
#[derive(JsonSchema, Serialize)]
pub(super) struct Report {
    endpoint: String,
    seconds: f64,
    bytes: u64,
    frames: u64,
    bytes_per_s: f64,
    wrong_checksums: u64,
    unknown_frames: u64,
    lost_frames: u64,
    repeated_frames: u64,
    pub lost_share: f64,
    vehicle: Option<String>,
    pub autopilot: Option<&'static str>,
    version: Option<String>,
    mavlink: Option<u8>,
    pub is_signed: bool,
    pub others: Vec<String>,
    senders: Vec<String>,
    pub mode: Option<u32>,
    pub intended_mode: Option<u32>,
    pub armed: Option<bool>,
    landed: Option<String>,
    battery_v: Option<f64>,
    pub battery_share: Option<f64>,
    pub odometry_hz: f64,
    odometry_frames: Vec<String>,
    pub attitude_hz: f64,
    pub position_hz: f64,
    pub clock: Option<&'static str>,
    clock_error_s: Option<f64>,
    pub clock_skew: Option<f64>,
    pub round_trip_p50_s: Option<f64>,
    round_trip_max_s: Option<f64>,
    budget: Option<String>,
    pub serial_latency_timer_ms: Option<u32>,
    loss_reaction: Option<String>,
    pub parameters: BTreeMap<String, f64>,
    messages: Vec<MessageRow>,
    texts: Vec<String>,
}

/// One message of the vehicle.
#[derive(JsonSchema, Serialize)]
struct MessageRow {
    id: u32,
    name: String,
    rate_hz: f64,
    count: u64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "link       {}: {} frames in {:.1} s, {:.1} kB/s; {} with wrong checksums, {} unknown, \
             {} lost ({:.1} %), {} repeated",
            self.endpoint,
            self.frames,
            self.seconds,
            self.bytes_per_s / 1000.0,
            self.wrong_checksums,
            self.unknown_frames,
            self.lost_frames,
            100.0 * self.lost_share,
            self.repeated_frames
        )?;
        if let Some(budget) = &self.budget {
            writeln!(f, "budget     {budget}")?;
        }
        for sender in &self.senders {
            writeln!(f, "beside     {sender}")?;
        }
        let Some(vehicle) = &self.vehicle else { return Ok(()) };
        let version = self.version.as_deref().unwrap_or("unknown");
        let signed = if self.is_signed { ", signed" } else { "" };
        let mavlink = self.mavlink.unwrap_or_default();
        writeln!(f, "vehicle    {vehicle}, version {version}, MAVLink {mavlink}{signed}")?;
        for other in &self.others {
            writeln!(f, "another    {other}")?;
        }
        let mode_text =
            |mode: Option<u32>| mode.map_or("unknown".to_owned(), |m| format!("{m:#010x}"));
        let armed = match self.armed {
            Some(true) => "armed",
            Some(false) => "disarmed",
            None => "armed state unknown",
        };
        let landed = self.landed.as_deref().unwrap_or("landed state unknown");
        writeln!(
            f,
            "mode       {}, intended {}; {armed}, {landed}",
            mode_text(self.mode),
            mode_text(self.intended_mode)
        )?;
        writeln!(
            f,
            "state      ODOMETRY {:.0} Hz, attitude {:.0} Hz, position {:.0} Hz",
            self.odometry_hz, self.attitude_hz, self.position_hz
        )?;
        for frames in &self.odometry_frames {
            writeln!(f, "frames     ODOMETRY in {frames}")?;
        }
        if self.battery_v.is_some() || self.battery_share.is_some() {
            let volts = self.battery_v.map_or(String::new(), |volts| format!("{volts:.1} V "));
            let share = self.battery_share.map_or(String::new(), |s| format!("{:.0} %", 100.0 * s));
            writeln!(f, "battery    {volts}{share}")?;
        }
        if let (Some(source), Some(skew)) = (self.clock, self.clock_skew) {
            write!(f, "clock      {source}, runs at {:.4} times real time", 1.0 + skew)?;
            if let Some(error) = self.clock_error_s {
                write!(f, ", offset known to {:.1} ms", 1e3 * error)?;
            }
            writeln!(f)?;
        }
        if let (Some(p50), Some(max)) = (self.round_trip_p50_s, self.round_trip_max_s) {
            write!(f, "round trip {:.1} ms, at most {:.1} ms", 1e3 * p50, 1e3 * max)?;
            match self.serial_latency_timer_ms {
                Some(timer) => writeln!(f, "; latency timer of the serial adapter {timer} ms")?,
                None => writeln!(f)?,
            }
        }
        if let Some(reaction) = &self.loss_reaction {
            writeln!(f, "loss       if downwash vanishes: {reaction}")?;
        }
        for (name, value) in &self.parameters {
            // PARAM_VALUE carries f32.
            writeln!(f, "parameter  {name} {}", *value as f32)?;
        }
        for MessageRow { id, name, rate_hz, count } in &self.messages {
            writeln!(f, "message    {name} ({id}) {rate_hz:.1} Hz, {count} in total")?;
        }
        for text in &self.texts {
            writeln!(f, "text       {text}")?;
        }
        Ok(())
    }
}
