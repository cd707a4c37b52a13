//! Imported flights as flat channels of a downwash log: one channel for each stream, at its native
//! rate.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use message::clock::HostTime;
use message::setpoint::State;
use prost::Message as _;
use vehicle::frame::{Attitude, Frd, Ned};

use super::flight::{
    AttitudeSetpoint, Clock, Flight, MotorSource, MotorUnit, SetpointSource, Stream, TruthSample,
};
use crate::encoder::Times;
use crate::mcap_file::McapFile;
use crate::partial::PartialFile;
use crate::reader::Message;
use crate::record::Truth;
use crate::schema::{
    AttitudeSample, AttitudeSetpointSample, BodyRateSample, Flat, InAirSample, OutputsSample,
    PositionSample, RotorSpeedSample, RowSample, SetpointsMissingSample, SpecificForceSample,
    TruthMessage, VelocitySample, VoltageSample, descriptor,
};
use crate::writer::{LOG_VERSION, LogError};

/// Converts a sample to a flat message and back.
trait Sample: Flat {
    type Value;
    fn new(time: f64, value: &Self::Value) -> Self;
    /// Returns `None` if the content is impossible.
    fn read(&self) -> Option<(f64, Self::Value)>;
}

/// Implements [`Sample`] for messages whose fields are the components of one value.
macro_rules! components {
    ($($message:ident: $value:ty, $from:expr, $to:expr, [$($field:ident),*];)*) => {$(
        impl Sample for $message {
            type Value = $value;
            fn new(time: f64, value: &$value) -> Self {
                let [$($field),*] = $from(value);
                Self { time_s: time, $($field),* }
            }
            fn read(&self) -> Option<(f64, $value)> {
                let components = [$(self.$field),*];
                let is_finite = components.iter().all(|c: &f64| c.is_finite());
                is_finite.then(|| $to(components)).flatten().map(|value| (self.time_s, value))
            }
        }
    )*};
}

components! {
    AttitudeSample: Attitude, quaternion, attitude, [q_w, q_x, q_y, q_z];
    PositionSample: Ned, |v: &Ned| v.to_array(), |c| Some(Ned::from(c)), [p_n_m, p_e_m, p_d_m];
    VelocitySample: Ned, |v: &Ned| v.to_array(), |c| Some(Ned::from(c)),
        [v_n_mps, v_e_mps, v_d_mps];
    BodyRateSample: Frd, |v: &Frd| v.to_array(), |c| Some(Frd::from(c)),
        [p_radps, q_radps, r_radps];
    SpecificForceSample: Frd, |v: &Frd| v.to_array(), |c| Some(Frd::from(c)),
        [f_x_mps2, f_y_mps2, f_z_mps2];
    OutputsSample: [f64; 4], |u: &[f64; 4]| *u, Some, [output_1, output_2, output_3, output_4];
    RotorSpeedSample: [f64; 4], |w: &[f64; 4]| *w, Some,
        [rotor_1_radps, rotor_2_radps, rotor_3_radps, rotor_4_radps];
    VoltageSample: f64, |v: &f64| [*v], |[v]: [f64; 1]| Some(v), [voltage_v];
}

fn quaternion(q: &Attitude) -> [f64; 4] {
    [q.w, q.x, q.y, q.z]
}

/// The attitude, not rescaled; `None` if the norm is not 1.
fn attitude([w, x, y, z]: [f64; 4]) -> Option<Attitude> {
    let norm = w.hypot(x).hypot(y).hypot(z);
    ((norm - 1.0).abs() < 1e-3).then_some(Attitude { w, x, y, z })
}

impl Sample for AttitudeSetpointSample {
    type Value = AttitudeSetpoint;
    fn new(time: f64, setpoint: &AttitudeSetpoint) -> Self {
        let [q_w, q_x, q_y, q_z] = setpoint.attitude.map_or([f64::NAN; 4], |q| quaternion(&q));
        let [p_radps, q_radps, r_radps] =
            setpoint.body_rate.map_or([f64::NAN; 3], |rate| rate.to_array());
        let thrust_ratio = setpoint.thrust.unwrap_or(f64::NAN);
        Self { time_s: time, q_w, q_x, q_y, q_z, p_radps, q_radps, r_radps, thrust_ratio }
    }
    fn read(&self) -> Option<(f64, AttitudeSetpoint)> {
        let rate = Frd::new(self.p_radps, self.q_radps, self.r_radps);
        let setpoint = AttitudeSetpoint {
            attitude: attitude([self.q_w, self.q_x, self.q_y, self.q_z]),
            body_rate: rate.is_finite().then_some(rate),
            thrust: self.thrust_ratio.is_finite().then_some(self.thrust_ratio),
        };
        Some((self.time_s, setpoint))
    }
}

/// Implements [`Sample`] for messages with one field that accepts any value.
macro_rules! scalars {
    ($($message:ident: $value:ty, $field:ident;)*) => {$(
        impl Sample for $message {
            type Value = $value;
            fn new(time: f64, value: &$value) -> Self {
                Self { time_s: time, $field: *value }
            }
            fn read(&self) -> Option<(f64, $value)> {
                Some((self.time_s, self.$field))
            }
        }
    )*};
}

scalars! {
    SetpointsMissingSample: u32, missing;
    InAirSample: bool, in_air;
}

impl Sample for RowSample {
    type Value = ();
    fn new(time: f64, (): &()) -> Self {
        Self { time_s: time }
    }
    fn read(&self) -> Option<(f64, ())> {
        Some((self.time_s, ()))
    }
}

impl Sample for TruthMessage {
    type Value = TruthSample;
    fn new(time: f64, truth: &TruthSample) -> Self {
        let TruthSample { position, velocity, attitude, body_rate, .. } = *truth;
        let truth = Truth {
            state: State { position, velocity, attitude, body_rate },
            acceleration: truth.acceleration,
            angular_acceleration: truth.angular_acceleration,
            // A flight does not store rotor thrusts.
            rotor_thrust: [f64::NAN; 4],
        };
        Self::new((time * 1e6).round() as u64, &truth)
    }
    fn read(&self) -> Option<(f64, TruthSample)> {
        let truth = TruthSample {
            position: Ned::new(self.p_n_m, self.p_e_m, self.p_d_m),
            velocity: Ned::new(self.v_n_mps, self.v_e_mps, self.v_d_mps),
            attitude: attitude([self.q_w, self.q_x, self.q_y, self.q_z])?,
            body_rate: Frd::new(self.p_radps, self.q_radps, self.r_radps),
            acceleration: Ned::new(self.a_n_mps2, self.a_e_mps2, self.a_d_mps2),
            angular_acceleration: Frd::new(
                self.alpha_x_radps2,
                self.alpha_y_radps2,
                self.alpha_z_radps2,
            ),
        };
        let world = [truth.position, truth.velocity, truth.acceleration];
        let body = [truth.body_rate, truth.angular_acceleration];
        let sound = world.iter().all(|v| v.is_finite()) && body.iter().all(|v| v.is_finite());
        sound.then_some((self.vehicle_time_us as f64 * 1e-6, truth))
    }
}

/// The effect of a flat message on the flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// The message does not belong to a flight.
    Other,
    /// The sample was added to the flight.
    Kept,
    /// The message does not decode, is not finite, or is out of order.
    Refused,
}

/// Adds a message to its stream in `flight`.
pub(super) fn take(message: &Message<'_>, flight: &mut Flight) -> Taken {
    fn push<S: Sample>(message: &Message<'_>, stream: &mut Stream<S::Value>) -> Taken {
        let sample = message.decode::<S>().and_then(|sample| sample.read());
        match sample.is_some_and(|(time, value)| stream.push(time, value)) {
            true => Taken::Kept,
            false => Taken::Refused,
        }
    }
    match message.channel.schema.as_str() {
        AttitudeSample::NAME => push::<AttitudeSample>(message, &mut flight.attitude),
        PositionSample::NAME => push::<PositionSample>(message, &mut flight.position),
        VelocitySample::NAME => push::<VelocitySample>(message, &mut flight.velocity),
        BodyRateSample::NAME => push::<BodyRateSample>(message, &mut flight.body_rate),
        SpecificForceSample::NAME => {
            push::<SpecificForceSample>(message, &mut flight.specific_force)
        }
        OutputsSample::NAME => push::<OutputsSample>(message, &mut flight.outputs),
        RotorSpeedSample::NAME => push::<RotorSpeedSample>(message, &mut flight.rotor_speed),
        AttitudeSetpointSample::NAME => {
            push::<AttitudeSetpointSample>(message, &mut flight.setpoint)
        }
        SetpointsMissingSample::NAME => {
            push::<SetpointsMissingSample>(message, &mut flight.setpoints_missing)
        }
        VoltageSample::NAME => push::<VoltageSample>(message, &mut flight.voltage),
        InAirSample::NAME => push::<InAirSample>(message, &mut flight.in_air),
        TruthMessage::NAME => push::<TruthMessage>(message, &mut flight.truth),
        RowSample::NAME => {
            let Some(row) = message.decode::<RowSample>() else { return Taken::Refused };
            let rows = flight.rows.get_or_insert_default();
            if rows.last().is_some_and(|last| row.time_s <= *last) || !row.time_s.is_finite() {
                return Taken::Refused;
            }
            rows.push(row.time_s);
            Taken::Kept
        }
        _ => Taken::Other,
    }
}

/// Keys of the metadata record `run` that describe the import.
const FROM: &str = "imported_from";
const CLOCK: &str = "imported_clock";
const DELAY: &str = "imported_clock_delay_s";
const UNIT: &str = "imported_motor_unit";
const MOTORS: &str = "imported_motor_source";
const TABLE: &str = "imported_table";
const LEFT_OUT: &str = "imported_left_out";
const SETPOINTS: &str = "imported_setpoint_source";
const SKEW: &str = "imported_ground_skew";
const VEHICLE: &str = "imported_vehicle_facts";

const CLOCKS: [&str; 3] = ["single", "synchronised", "least delay"];
const UNITS: [(&str, MotorUnit); 3] = [
    ("thrust fraction", MotorUnit::ThrustFraction),
    ("vehicle file", MotorUnit::VehicleFile),
    ("newton", MotorUnit::Newton),
];
const SOURCES: [(&str, MotorSource); 6] = [
    ("ACTUATOR_OUTPUT_STATUS", MotorSource::ActuatorOutputStatus),
    ("SERVO_OUTPUT_RAW", MotorSource::ServoOutputRaw),
    ("actuator_motors", MotorSource::ActuatorMotors),
    ("actuator_outputs", MotorSource::ActuatorOutputs),
    ("RCOU", MotorSource::Rcou),
    ("table", MotorSource::Table),
];
/// Value for the autopilot's setpoints in the metadata.
const ONBOARD: &str = "onboard";

fn name_in<T: PartialEq>(table: &[(&'static str, T)], value: &T) -> &'static str {
    table.iter().find(|(_, known)| known == value).map_or("", |(name, _)| name)
}

fn facts(flight: &Flight) -> BTreeMap<String, String> {
    let (clock, delay) = match flight.clock {
        Clock::Single => (CLOCKS[0], None),
        Clock::Synchronised => (CLOCKS[1], None),
        Clock::LeastDelay { assumed_s } => (CLOCKS[2], Some(assumed_s.to_string())),
    };
    let file = flight.origin.path.file_name().map(|name| name.to_string_lossy().into_owned());
    let vehicle = !flight.facts.is_empty();
    let entries = [
        ("log_version", Some(LOG_VERSION.to_owned())),
        ("frames", Some("world NED, body FRD".to_owned())),
        ("units", Some("SI, radians".to_owned())),
        ("tool", Some("downwash".to_owned())),
        ("tool_version", Some(env!("CARGO_PKG_VERSION").to_owned())),
        ("run", Some(flight.origin.run.clone())),
        (FROM, Some(file.unwrap_or_default())),
        ("imported_format", Some(flight.origin.format.to_owned())),
        ("imported_sha256", Some(flight.origin.sha256.clone())),
        (CLOCK, Some(clock.to_owned())),
        (DELAY, delay),
        (UNIT, Some(name_in(&UNITS, &flight.motor_unit).to_owned())),
        (MOTORS, Some(name_in(&SOURCES, &flight.motor_source).to_owned())),
        (TABLE, flight.rows.is_some().then(|| "true".to_owned())),
        (
            SETPOINTS,
            (flight.setpoint_source == SetpointSource::Onboard).then(|| ONBOARD.to_owned()),
        ),
        (SKEW, flight.ground_skew.map(|skew| skew.to_string())),
        (VEHICLE, vehicle.then(|| serde_json::to_string(&flight.facts).ok()).flatten()),
        (LEFT_OUT, serde_json::to_string(&flight.left_out).ok()),
    ];
    entries.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect()
}

/// Reads the metadata of an imported flight. Returns whether the log holds one.
pub(super) fn take_facts(run: &BTreeMap<String, String>, flight: &mut Flight) -> bool {
    if !run.contains_key(FROM) {
        return false;
    }
    let get = |key: &str| run.get(key).map(String::as_str);
    flight.clock = match (get(CLOCK), get(DELAY).and_then(|text| text.parse().ok())) {
        (Some("synchronised"), _) => Clock::Synchronised,
        (Some("least delay"), Some(assumed_s)) => Clock::LeastDelay { assumed_s },
        _ => Clock::Single,
    };
    if let Some((_, unit)) = UNITS.iter().find(|(name, _)| Some(*name) == get(UNIT)) {
        flight.motor_unit = *unit;
    }
    if let Some((_, source)) = SOURCES.iter().find(|(name, _)| Some(*name) == get(MOTORS)) {
        flight.motor_source = *source;
    }
    if get(TABLE).is_some() {
        flight.rows.get_or_insert_default();
    }
    if get(SETPOINTS) == Some(ONBOARD) {
        flight.setpoint_source = SetpointSource::Onboard;
    }
    flight.ground_skew =
        get(SKEW).and_then(|text| text.parse().ok()).filter(|skew: &f64| skew.is_finite());
    flight.facts =
        get(VEHICLE).and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
    let left_out = get(LEFT_OUT).and_then(|text| serde_json::from_str(text).ok());
    flight.left_out.splice(0..0, left_out.unwrap_or_else(Vec::new));
    true
}

/// Appends the message of the sample with the given index.
type Encode<'a> = Box<dyn Fn(usize, &mut Vec<u8>) + 'a>;

/// One stream being written to the file.
struct Lane<'a> {
    times: &'a [f64],
    next: usize,
    channel: u16,
    encode: Encode<'a>,
}

/// Writes `flight` to `path`, completely or not at all; [`open`](super::open) reads it back.
/// Returns the number of messages.
///
/// # Errors
/// [`LogError`] if the file cannot be created or written.
pub fn write(flight: &Flight, path: &Path) -> Result<u64, LogError> {
    let mut file = PartialFile::create(path)
        .map_err(|source| LogError::Create { path: path.to_owned(), source })?;
    write_to(flight, &mut file)
        .and_then(|messages| file.finish().map(|()| messages))
        .map_err(|source| LogError::Write { path: path.to_owned(), source })
}

/// Encodes `flight` as a log in memory.
///
/// # Errors
/// Errors of the encoder; memory itself has none.
pub fn to_bytes(flight: &Flight) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write_to(flight, &mut bytes)?;
    Ok(bytes)
}

fn write_to(flight: &Flight, out: impl io::Write) -> io::Result<u64> {
    let library = format!("downwash {}", env!("CARGO_PKG_VERSION"));
    let mut mcap = McapFile::new(out, &library)?;
    mcap.add_metadata("run", &facts(flight))?;
    if let Some(text) = &flight.vehicle_file {
        let is_json = text.trim_start().starts_with('{');
        let (name, media_type) = match is_json {
            true => ("vehicle.json", "application/json"),
            false => ("vehicle.toml", "application/toml"),
        };
        mcap.attach(0, name, media_type, text.as_bytes())?;
    }
    let mut lanes = Vec::new();
    macro_rules! lane {
        ($topic:literal, $message:ty, $times:expr, $value:expr) => {
            let times: &[f64] = $times;
            if !times.is_empty() {
                let name = <$message>::NAME;
                let channel = mcap.add_channel($topic, name, &descriptor::<$message>())?;
                let encode = Box::new(move |at: usize, out: &mut Vec<u8>| {
                    <$message as Sample>::new(times[at], $value(at)).encode_raw(out);
                });
                lanes.push(Lane { times, next: 0, channel, encode });
            }
        };
    }
    macro_rules! stream_lane {
        ($topic:literal, $message:ty, $stream:ident) => {
            lane!($topic, $message, flight.$stream.times(), |at: usize| {
                &flight.$stream.values()[at]
            });
        };
    }
    stream_lane!("/flight/attitude", AttitudeSample, attitude);
    stream_lane!("/flight/position", PositionSample, position);
    stream_lane!("/flight/velocity", VelocitySample, velocity);
    stream_lane!("/flight/body_rate", BodyRateSample, body_rate);
    stream_lane!("/flight/specific_force", SpecificForceSample, specific_force);
    stream_lane!("/flight/outputs", OutputsSample, outputs);
    stream_lane!("/flight/rotor_speed", RotorSpeedSample, rotor_speed);
    stream_lane!("/flight/setpoint", AttitudeSetpointSample, setpoint);
    stream_lane!("/flight/setpoints_missing", SetpointsMissingSample, setpoints_missing);
    stream_lane!("/flight/voltage", VoltageSample, voltage);
    stream_lane!("/flight/in_air", InAirSample, in_air);
    stream_lane!("/sim/truth", TruthMessage, truth);
    lane!("/flight/row", RowSample, flight.rows.as_deref().unwrap_or_default(), |_| &());

    let mut messages = 0;
    // Takes the lane with the earliest next sample until all are at their ends.
    let due = |lane: &Lane<'_>| lane.times.get(lane.next).copied();
    while let Some((at, time)) = lanes
        .iter()
        .enumerate()
        .filter_map(|(at, lane)| Some((at, due(lane)?)))
        .min_by(|(_, a), (_, b)| a.total_cmp(b))
    {
        let lane = &mut lanes[at];
        let at = HostTime::from_ns((time.max(0.0) * 1e9).round() as u64);
        let sample = lane.next;
        mcap.put(lane.channel, Times::host(at), |out| (lane.encode)(sample, out))?;
        lane.next += 1;
        messages += 1;
    }
    mcap.finish()?;
    Ok(messages)
}
