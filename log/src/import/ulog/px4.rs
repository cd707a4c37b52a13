//! Maps PX4's topics to the streams of a flight. They are already in NED and FRD, SI units and
//! radians. This module chooses the topic for each stream and interprets the motor outputs.

mod outputs;

use std::collections::BTreeMap;

use message::parameters::{Parameters, is_of_vehicle};
use vehicle::frame::{Attitude, Euler, Frd, Ned};

use super::Contents;
use crate::import::facts::VehicleFacts;
use crate::import::flight::{AttitudeSetpoint, Clock, Flight, SetpointSource, Stream};
use crate::import::functions;
use crate::import::kind::{self, StatedKind, VehicleKind};
use crate::import::onboard::{Row, Sample, TopicSpec, Topics};
use crate::import::tally::Tally;

/// Largest number of notes; a damaged log may have any number of changes.
const NOTES_MAX: usize = 60;
/// Value that marks a missing accelerometer time stamp.
const NO_STAMP: f64 = i32::MAX as f64;

macro_rules! topic_specs {
    ($($topic:literal: [$($field:literal),* $(,)?]),* $(,)?) => {
        /// Topics and fields that are read.
        pub(super) const TOPIC_SPECS: &[TopicSpec] =
            &[$(TopicSpec { topic: $topic, fields: &["timestamp", $($field),*] }),*];
    };
}

topic_specs! {
    "vehicle_attitude": ["timestamp_sample", "q[0]", "q[1]", "q[2]", "q[3]", "roll", "pitch", "yaw",
        "rollspeed", "pitchspeed", "yawspeed"],
    "vehicle_angular_velocity": ["timestamp_sample", "xyz[0]", "xyz[1]", "xyz[2]"],
    "vehicle_acceleration": ["timestamp_sample", "xyz[0]", "xyz[1]", "xyz[2]"],
    "sensor_combined": ["gyro_rad_s[0]", "gyro_rad_s[1]", "gyro_rad_s[2]", "gyro_integral_dt",
        "gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]",
        "accelerometer_timestamp_relative", "accelerometer_m_s2[0]", "accelerometer_m_s2[1]",
        "accelerometer_m_s2[2]", "accelerometer_integral_dt"],
    "vehicle_local_position": ["timestamp_sample", "x", "y", "z", "vx", "vy", "vz", "xy_valid",
        "z_valid", "v_xy_valid", "v_z_valid", "xy_reset_counter", "z_reset_counter",
        "vxy_reset_counter", "vz_reset_counter"],
    "actuator_motors": ["control[0]", "control[1]", "control[2]", "control[3]", "control[4]",
        "control[5]", "control[6]", "control[7]", "control[8]", "control[9]", "control[10]",
        "control[11]"],
    "actuator_outputs": ["noutputs", "output[0]", "output[1]", "output[2]", "output[3]",
        "output[4]", "output[5]", "output[6]", "output[7]", "output[8]", "output[9]", "output[10]",
        "output[11]", "output[12]", "output[13]", "output[14]", "output[15]"],
    "vehicle_attitude_setpoint": ["q_d[0]", "q_d[1]", "q_d[2]", "q_d[3]", "roll_body",
        "pitch_body", "yaw_body", "thrust_body[0]", "thrust_body[1]", "thrust_body[2]", "thrust"],
    "vehicle_rates_setpoint": ["roll", "pitch", "yaw", "thrust_body[0]", "thrust_body[1]",
        "thrust_body[2]", "thrust"],
    "battery_status": ["voltage_v", "connected"],
    "esc_status": ["esc_count", "esc[0].esc_rpm", "esc[1].esc_rpm", "esc[2].esc_rpm",
        "esc[3].esc_rpm", "esc[4].esc_rpm", "esc[5].esc_rpm", "esc[6].esc_rpm", "esc[7].esc_rpm",
        "esc[0].actuator_function", "esc[1].actuator_function", "esc[2].actuator_function",
        "esc[3].actuator_function", "esc[4].actuator_function", "esc[5].actuator_function",
        "esc[6].actuator_function", "esc[7].actuator_function"],
    "vehicle_land_detected": ["landed", "maybe_landed", "ground_contact"],
    "vehicle_status": ["arming_state", "nav_state", "vehicle_type", "is_vtol", "is_rotary_wing",
        "system_type"],
}

/// Time stamp of a row, s.
fn stamp(row: &Row<'_>) -> f64 {
    row.get("timestamp") * 1e-6
}

/// Sample time of a row, s; older logs have only the time stamp.
fn sampled(row: &Row<'_>) -> f64 {
    let sampled = row.get("timestamp_sample");
    if sampled > 0.0 { sampled * 1e-6 } else { stamp(row) }
}

/// The middle of the averaging interval `field` before `time`.
fn middle(row: &Row<'_>, time: f64, field: &str) -> f64 {
    let interval = row.get(field);
    // In us; before PX4 1.7 in s.
    let seconds = if interval < 1.0 { interval } else { 1e-6 * interval };
    if seconds.is_finite() { time - 0.5 * seconds } else { time }
}

fn attitude(components: [f64; 4]) -> Option<Attitude> {
    Attitude::from_wire(components.map(|c| c as f32))
}

impl Contents {
    /// Fills the streams of `flight`.
    pub(super) fn fill(mut self, flight: &mut Flight) {
        let mut tally = std::mem::take(&mut self.tally);
        let mut facts = self.facts();
        facts.notes.append(&mut self.notes);
        let topics = &self.topics;
        flight.clock = Clock::Single;
        fill_attitude(topics, flight, &mut facts, &mut tally);
        fill_sensors(topics, flight, &mut facts, &mut tally);
        fill_position(topics, flight, &mut facts, &mut tally);
        fill_setpoint(topics, flight, &mut facts, &mut tally);
        self.fill_outputs(flight, &mut facts, &mut tally);
        self.fill_states(flight, &mut tally);
        self.note_modes(&mut facts);
        std::mem::take(&mut self.texts).give(&mut facts);
        flight.facts = facts;
        tally.give(flight);
    }

    fn facts(&self) -> VehicleFacts {
        let parameter = |name: &str| self.parameters.get(name).copied();
        let stated = Parameters::from(self.parameters.clone());
        let autopilot = self.info.get("sys_name").map(|name| {
            let version = self.info.get("ver_sw").map(|hash| hash.chars().take(8).collect());
            let release = self.info.get("ver_sw_release").and_then(|n| n.parse::<u32>().ok());
            let release =
                release.map(|n| format!("{}.{}.{}", n >> 24, n >> 16 & 0xFF, n >> 8 & 0xFF));
            let parts: Vec<String> =
                [Some(name.clone()), release, version].into_iter().flatten().collect();
            parts.join(" ")
        });
        let parameters = self.parameters.iter().filter(|(name, _)| is_of_vehicle(name));
        let motors = stated.motor_count().or_else(|| {
            let kind = parameter("MAV_TYPE").and_then(kind::motors_of_mav_type);
            let system = self.status("system_type").and_then(kind::motors_of_mav_type);
            kind.or(system).or_else(|| functions::more_motors(&self.parameters))
        });
        let mut facts = VehicleFacts {
            autopilot,
            kinds: self.kinds(),
            frame: parameter("CA_AIRFRAME").map(|class| match class {
                0.0 => "multirotor".to_owned(),
                class => format!("airframe class {class}, not a multirotor"),
            }),
            motors,
            rotors: stated.rotors(),
            parameters: parameters.map(|(name, value)| (name.clone(), *value)).collect(),
            ..VehicleFacts::default()
        };
        for (name, value) in &self.changed {
            facts.notes.push(format!("parameter {name} was changed to {value} during the log"));
        }
        facts
    }

    /// The most frequent value in `vehicle_status`.
    fn status(&self, field: &str) -> Option<f64> {
        self.topics.instances("vehicle_status").next()?.1.most_frequent(field)
    }

    /// Statements of the vehicle's kind.
    fn kinds(&self) -> Vec<StatedKind> {
        let status = |field: &str, kind: fn(f64) -> Option<VehicleKind>| {
            let value = self.status(field)?;
            StatedKind::new(kind(value), || format!("{field} of vehicle_status is {value}"))
        };
        let is_vtol = |value: f64| (value == 1.0).then_some(VehicleKind::Vtol);
        let of_type = |value: f64| match value as u8 {
            1 => Some(VehicleKind::Multirotor),
            2 => Some(VehicleKind::FixedWing),
            3 => Some(VehicleKind::Rover),
            4 => Some(VehicleKind::Airship),
            _ => None,
        };
        // Before PX4 1.10 this was the only field.
        let is_rotary = |value: f64| {
            Some(if value == 0.0 { VehicleKind::Other } else { VehicleKind::Multirotor })
        };
        let rotary = || match self.status("vehicle_type") {
            None => status("is_rotary_wing", is_rotary),
            Some(_) => None,
        };
        let stated = [
            status("is_vtol", is_vtol),
            status("system_type", kind::of_mav_type),
            status("vehicle_type", of_type),
            rotary(),
        ];
        stated.into_iter().flatten().chain(kind::of_parameters(&self.parameters)).collect()
    }

    /// Notes the times of arming and mode changes.
    fn note_modes(&self, facts: &mut VehicleFacts) {
        const ARMED: f64 = 2.0;
        let Some((_, topic)) = self.topics.instances("vehicle_status").next() else { return };
        let mut last = [f64::NAN; 2];
        for row in topic.rows() {
            let now = row.all(["arming_state", "nav_state"]);
            if now[0] != last[0] && (now[0] == ARMED || last[0] == ARMED) {
                let state = if now[0] == ARMED { "armed" } else { "disarmed" };
                facts.notes.push(format!("{state} at {:.2} s", stamp(&row)));
            }
            if now[1] != last[1] {
                facts.notes.push(format!("mode {} from {:.2} s", mode(now[1]), stamp(&row)));
            }
            last = now;
            if facts.notes.len() > NOTES_MAX {
                break;
            }
        }
    }

    fn fill_states(&self, flight: &mut Flight, tally: &mut Tally) {
        // Of several packs or sensors, the first that is connected.
        let is_connected = |row: Row<'_>| row.get("connected") != 0.0 && row.get("voltage_v") > 0.0;
        let pack = self.topics.first_live("battery_status", is_connected);
        if let Some(topic) = self.topics.primary("battery_status", pack, tally) {
            flight.voltage = self.topics.stream(topic, tally, |row| {
                let voltage = row.get("voltage_v");
                if row.get("connected") == 0.0 || voltage == 0.0 {
                    return Sample::Skip;
                }
                Sample::of(stamp(&row), (voltage > 0.0 && voltage < 1e3).then_some(voltage))
            });
        }
        if let Some(topic) = self.topics.primary("vehicle_land_detected", 0, tally) {
            flight.in_air =
                self.topics.stream(topic, tally, |row| Sample::of(stamp(&row), in_air(&row)));
        }
    }
}

/// Whether the vehicle is in the air, by a row of `vehicle_land_detected`.
fn in_air(row: &Row<'_>) -> Option<bool> {
    let touches = ["landed", "maybe_landed", "ground_contact"].map(|field| row.get(field));
    touches[0].is_finite().then(|| !touches.contains(&1.0))
}

/// Time in the air of a boot, s.
pub(super) fn flown(topics: &Topics) -> f64 {
    topics.time_in_air("vehicle_land_detected", |row| Some((stamp(&row), in_air(&row)?)))
}

/// Name of a `nav_state`.
fn mode(state: f64) -> String {
    let name = match state {
        0.0 => "manual",
        1.0 => "altitude",
        2.0 => "position",
        3.0 => "mission",
        4.0 => "hold",
        5.0 => "return",
        10.0 => "acro",
        12.0 => "descend",
        14.0 => "offboard",
        15.0 => "stabilized",
        17.0 => "take-off",
        18.0 => "land",
        state => return format!("{state}"),
    };
    name.to_owned()
}

fn fill_attitude(
    topics: &Topics,
    flight: &mut Flight,
    facts: &mut VehicleFacts,
    tally: &mut Tally,
) {
    let Some(topic) = topics.primary("vehicle_attitude", 0, tally) else { return };
    flight.attitude = topics.stream(topic, tally, |row| {
        let quaternion = attitude(row.all(["q[0]", "q[1]", "q[2]", "q[3]"]));
        // In 2016 the quaternion could be there and not filled in.
        let has_none =
            || row.all(["q[0]", "q[1]", "q[2]", "q[3]"]).iter().all(|c| c.is_nan() || *c == 0.0);
        let euler = || row.finite(["roll", "pitch", "yaw"]).filter(|_| has_none());
        let euler = || euler().map(|[roll, pitch, yaw]| Euler::new(roll, pitch, yaw).attitude());
        Sample::of(sampled(&row), quaternion.or_else(euler))
    });
    if topics.instances("vehicle_angular_velocity").next().is_none() && topic.has("rollspeed") {
        flight.body_rate = topics.stream(topic, tally, |row| {
            let rate = row.finite(["rollspeed", "pitchspeed", "yawspeed"]);
            Sample::of(sampled(&row), rate.map(Frd::from))
        });
        facts.notes.push("body rate from vehicle_attitude".to_owned());
    }
}

/// Fills body rate and specific force from the filtered or the raw topics, whichever has the higher
/// rate.
fn fill_sensors(topics: &Topics, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
    const XYZ: [&str; 3] = ["xyz[0]", "xyz[1]", "xyz[2]"];
    let filtered = |name: &'static str, tally: &mut Tally| -> Stream<Frd> {
        topics.primary(name, 0, tally).map_or_else(Stream::default, |topic| {
            topics.stream(topic, tally, |row| {
                Sample::of(sampled(&row), row.finite(XYZ).map(Frd::from))
            })
        })
    };
    let rate = filtered("vehicle_angular_velocity", tally);
    let force = filtered("vehicle_acceleration", tally);
    let (mut raw_rate, mut raw_force) = (Stream::default(), Stream::default());
    if let Some(topic) = topics.primary("sensor_combined", 0, tally) {
        raw_rate = topics.stream(topic, tally, |row| {
            let rate = row.finite(["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"]);
            let older = || row.finite(["gyro_rad_s[0]", "gyro_rad_s[1]", "gyro_rad_s[2]"]);
            let time = middle(&row, stamp(&row), "gyro_integral_dt");
            Sample::of(time, rate.or_else(older).map(Frd::from))
        });
        raw_force = topics.stream(topic, tally, |row| {
            let later = row.get("accelerometer_timestamp_relative");
            if later == NO_STAMP {
                return Sample::Skip;
            }
            let later = if later.is_finite() { 1e-6 * later } else { 0.0 };
            let time = middle(&row, stamp(&row) + later, "accelerometer_integral_dt");
            let force = row.finite([
                "accelerometer_m_s2[0]",
                "accelerometer_m_s2[1]",
                "accelerometer_m_s2[2]",
            ]);
            Sample::of(time, force.map(Frd::from))
        });
    }
    let mut choose = |filtered: Stream<Frd>, raw: Stream<Frd>, of: &str, topic: &str| {
        let is_raw = raw.is_more_frequent(&filtered);
        let chosen = if is_raw { raw } else { filtered };
        if !chosen.is_empty() {
            let topic = if is_raw { "sensor_combined" } else { topic };
            facts.notes.push(format!("{of} from {topic}"));
        }
        chosen
    };
    let rate = choose(rate, raw_rate, "body rate", "vehicle_angular_velocity");
    if !rate.is_empty() {
        flight.body_rate = rate;
    }
    flight.specific_force = choose(force, raw_force, "specific force", "vehicle_acceleration");
}

fn fill_position(
    topics: &Topics,
    flight: &mut Flight,
    facts: &mut VehicleFacts,
    tally: &mut Tally,
) {
    let Some(topic) = topics.primary("vehicle_local_position", 0, tally) else { return };
    // A flag that is not logged counts as valid.
    let is_valid = |row: &Row<'_>, flags: [&str; 2]| flags.iter().all(|flag| row.get(flag) != 0.0);
    flight.position = topics.stream(topic, tally, |row| {
        if !is_valid(&row, ["xy_valid", "z_valid"]) {
            return Sample::Refuse("position not valid, by its own flags");
        }
        Sample::of(sampled(&row), row.finite(["x", "y", "z"]).map(Ned::from))
    });
    flight.velocity = topics.stream(topic, tally, |row| {
        if !is_valid(&row, ["v_xy_valid", "v_z_valid"]) {
            return Sample::Refuse("velocity not valid, by its own flags");
        }
        Sample::of(sampled(&row), row.finite(["vx", "vy", "vz"]).map(Ned::from))
    });
    let counters = ["xy_reset_counter", "z_reset_counter", "vxy_reset_counter", "vz_reset_counter"];
    let mut resets: BTreeMap<&str, u32> = BTreeMap::new();
    let mut last: Option<[f64; 4]> = None;
    for now in topic.rows().filter_map(|row| row.finite(counters)) {
        for (i, name) in counters.into_iter().enumerate() {
            if last.is_some_and(|last| last[i] != now[i]) {
                *resets.entry(name).or_default() += 1;
            }
        }
        last = Some(now);
    }
    for (name, count) in resets {
        facts.notes.push(format!("{count} resets of the estimate, by {name}"));
    }
}

/// Fills the setpoint of the autopilot's attitude loop, which is the ground's in OFFBOARD.
fn fill_setpoint(
    topics: &Topics,
    flight: &mut Flight,
    facts: &mut VehicleFacts,
    tally: &mut Tally,
) {
    let thrust = |row: &Row<'_>| {
        let body = row.finite(["thrust_body[0]", "thrust_body[1]", "thrust_body[2]"]);
        let thrust = body.map_or(row.get("thrust"), |[x, y, z]| x.hypot(y).hypot(z));
        thrust.is_finite().then_some(thrust)
    };
    flight.setpoint_source = SetpointSource::Onboard;
    if let Some(topic) = topics.primary("vehicle_attitude_setpoint", 0, tally) {
        flight.setpoint = topics.stream(topic, tally, |row| {
            let euler = row.finite(["roll_body", "pitch_body", "yaw_body"]);
            let quaternion = attitude(row.all(["q_d[0]", "q_d[1]", "q_d[2]", "q_d[3]"]));
            let attitude = quaternion
                .or(euler.map(|[roll, pitch, yaw]| Euler::new(roll, pitch, yaw).attitude()));
            let setpoint = AttitudeSetpoint { attitude, body_rate: None, thrust: thrust(&row) };
            let is_any = setpoint.attitude.is_some() || setpoint.thrust.is_some();
            Sample::of(stamp(&row), is_any.then_some(setpoint))
        });
        facts.notes.push("setpoints from vehicle_attitude_setpoint".to_owned());
    } else if let Some(topic) = topics.primary("vehicle_rates_setpoint", 0, tally) {
        flight.setpoint = topics.stream(topic, tally, |row| {
            let body_rate = row.finite(["roll", "pitch", "yaw"]).map(Frd::from);
            let setpoint = AttitudeSetpoint { attitude: None, body_rate, thrust: thrust(&row) };
            Sample::of(stamp(&row), body_rate.map(|_| setpoint))
        });
        facts.notes.push("setpoints from vehicle_rates_setpoint".to_owned());
    }
}
