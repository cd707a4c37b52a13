//! Maps ArduCopter's messages to the streams of a flight.

mod facts;
mod outputs;

use vehicle::frame::{Attitude, Euler, Frd, Ned};

use super::layout::{Access, Layout};
use super::{Contents, Source};
use crate::import::RPM;
use crate::import::facts::VehicleFacts;
use crate::import::flight::{AttitudeSetpoint, Clock, Flight, SetpointSource, Stream};
use crate::import::onboard::{Row, Sample, Topic, TopicSpec, Topics};
use crate::import::tally::Tally;
pub(super) use facts::kinds;

/// Names of RCOU's outputs.
const CHANNELS: [&str; 14] =
    ["C1", "C2", "C3", "C4", "C5", "C6", "C7", "C8", "C9", "C10", "C11", "C12", "C13", "C14"];
/// Their older names, in the same order.
const CHANNELS_BEFORE: [[&str; 2]; 14] = [
    ["Ch1", "Chan1"],
    ["Ch2", "Chan2"],
    ["Ch3", "Chan3"],
    ["Ch4", "Chan4"],
    ["Ch5", "Chan5"],
    ["Ch6", "Chan6"],
    ["Ch7", "Chan7"],
    ["Ch8", "Chan8"],
    ["Ch9", "Chan9"],
    ["Ch10", "Chan10"],
    ["Ch11", "Chan11"],
    ["Ch12", "Chan12"],
    ["Ch13", "Chan13"],
    ["Ch14", "Chan14"],
];
/// Messages that each are of one core of an estimator or of one motor controller, as ArduPilot wrote
/// them before 4.1: the name, the message that has all instances since, and the instance.
const SINGLES: [(&str, &str, u8); 14] = [
    ("XKQ1", "XKQ", 0),
    ("XKQ2", "XKQ", 1),
    ("XKF6", "XKF1", 1),
    ("NKQ1", "NKQ", 0),
    ("NKQ2", "NKQ", 1),
    ("NKF6", "NKF1", 1),
    ("ESC1", "ESC", 0),
    ("ESC2", "ESC", 1),
    ("ESC3", "ESC", 2),
    ("ESC4", "ESC", 3),
    ("ESC5", "ESC", 4),
    ("ESC6", "ESC", 5),
    ("ESC7", "ESC", 6),
    ("ESC8", "ESC", 7),
];

/// Messages of an estimator.
struct Estimator {
    /// Position and velocity.
    state: &'static str,
    quaternion: &'static str,
    /// Has the core that flies.
    status: &'static str,
    /// The parameter with that core, where there is one.
    primary: Option<&'static str>,
}

const EKF2: Estimator =
    Estimator { state: "NKF1", quaternion: "NKQ", status: "NKF4", primary: None };
const EKF3: Estimator =
    Estimator { state: "XKF1", quaternion: "XKQ", status: "XKF4", primary: Some("EK3_PRIMARY") };

/// Unit of CURR's integer voltage before ArduPilot 3.4, V.
const CENTIVOLT: f64 = 0.01;
/// Unit of the speeds of ESC1 to ESC8 before ArduPilot 3.6, rad/s: their 16 bits count tens of rpm,
/// and their format states hundredths.
const THOUSAND_RPM: f64 = 1000.0 * RPM;
/// One degree, rad.
const DEG: f64 = std::f64::consts::PI / 180.0;

macro_rules! sources {
    ($($topic:literal $has_instances:ident: [$($field:literal = $default_factor:expr),* $(,)?]),* $(,)?) => {
        /// The messages that are read, with the fields and their units.
        pub(super) const SOURCES: &[Source] = &[$(Source {
            spec: TopicSpec { topic: $topic, fields: &["TimeUS", $($field),*] },
            default_factors: &[1e-6, $($default_factor),*],
            has_instances: $has_instances,
        }),*];
    };
}

sources! {
    "ATT" false: ["Roll" = DEG, "Pitch" = DEG, "Yaw" = DEG, "DesRoll" = DEG, "DesPitch" = DEG, "DesYaw" = DEG],
    "ANG" false: ["Roll" = DEG, "Pitch" = DEG, "Yaw" = DEG, "DesRoll" = DEG, "DesPitch" = DEG, "DesYaw" = DEG],
    "RATE" false: ["R" = DEG, "P" = DEG, "Y" = DEG, "AOut" = 1.0],
    "IMU" true: ["GyrX" = 1.0, "GyrY" = 1.0, "GyrZ" = 1.0, "AccX" = 1.0, "AccY" = 1.0, "AccZ" = 1.0],
    "GYR" true: ["SampleUS" = 1e-6, "GyrX" = 1.0, "GyrY" = 1.0, "GyrZ" = 1.0],
    "ACC" true: ["SampleUS" = 1e-6, "AccX" = 1.0, "AccY" = 1.0, "AccZ" = 1.0],
    "XKQ" true: ["Q1" = 1.0, "Q2" = 1.0, "Q3" = 1.0, "Q4" = 1.0],
    "NKQ" true: ["Q1" = 1.0, "Q2" = 1.0, "Q3" = 1.0, "Q4" = 1.0],
    "XKF1" true: ["VN" = 1.0, "VE" = 1.0, "VD" = 1.0, "PN" = 1.0, "PE" = 1.0, "PD" = 1.0],
    "NKF1" true: ["VN" = 1.0, "VE" = 1.0, "VD" = 1.0, "PN" = 1.0, "PE" = 1.0, "PD" = 1.0],
    "EKF1" true: ["VN" = 1.0, "VE" = 1.0, "VD" = 1.0, "PN" = 1.0, "PE" = 1.0, "PD" = 1.0],
    "XKF4" true: ["PI" = 1.0],
    "NKF4" true: ["PI" = 1.0],
    "RCOU" false: ["C1" = 1.0, "C2" = 1.0, "C3" = 1.0, "C4" = 1.0, "C5" = 1.0, "C6" = 1.0, "C7" = 1.0,
        "C8" = 1.0, "C9" = 1.0, "C10" = 1.0, "C11" = 1.0, "C12" = 1.0, "C13" = 1.0, "C14" = 1.0],
    "ESC" true: ["RPM" = RPM],
    "BAT" true: ["Volt" = 1.0],
    "CURR" true: ["Volt" = 1.0],
    "EV" false: ["Id" = 1.0],
    "MODE" false: ["ModeNum" = 1.0, "Mode" = 1.0],
    "GUIA" false: ["Roll" = DEG, "Pitch" = DEG, "Yaw" = DEG, "RollRt" = DEG, "PitchRt" = DEG, "YawRt" = DEG,
        "Thrust" = 1.0, "ClimbRt" = 1.0],
}

/// The message that has all instances, and the instance, for the name of an older message of one.
pub(super) fn instance_of(message: &str) -> Option<(&'static str, u8)> {
    let known = SINGLES.iter().find(|(name, ..)| *name == message);
    known.map(|(_, all, instance)| (*all, *instance))
}

/// All names that a field had over the years.
pub(super) fn names(field: &'static str) -> Vec<&'static str> {
    let channel = CHANNELS.iter().position(|channel| *channel == field);
    let before = channel.into_iter().flat_map(|channel| CHANNELS_BEFORE[channel]);
    std::iter::once(field).chain(before).collect()
}

/// The SI value of a field's unit, if its format shows that the log is an old one.
pub(super) fn older_unit(layout: &Layout, access: Access) -> Option<f64> {
    match (layout.name.as_str(), instance_of(&layout.name)) {
        ("CURR", _) if access.is_integer() => Some(CENTIVOLT),
        (_, Some(("ESC", _))) if access.is_short_hundredths() => Some(THOUSAND_RPM),
        _ => None,
    }
}

fn stamp(row: &Row<'_>) -> f64 {
    row.get("TimeUS")
}

/// Sample time of a row, s; without a `SampleUS`, its time stamp.
fn sampled(row: &Row<'_>) -> f64 {
    let sampled = row.get("SampleUS");
    if sampled > 0.0 { sampled } else { stamp(row) }
}

fn euler(row: &Row<'_>, fields: [&str; 3]) -> Option<Attitude> {
    row.finite(fields).map(|[roll, pitch, yaw]| Euler::new(roll, pitch, yaw).attitude())
}

impl Contents {
    /// Fills the streams of `flight`.
    pub(super) fn fill(mut self, flight: &mut Flight) {
        let mut tally = std::mem::take(&mut self.tally);
        let mut facts = self.facts();
        facts.notes.append(&mut self.notes);
        flight.clock = Clock::Single;
        self.fill_attitude(flight, &mut facts, &mut tally);
        self.fill_sensors(flight, &mut facts, &mut tally);
        self.fill_position(flight, &mut facts, &mut tally);
        self.fill_setpoint(flight, &mut facts, &mut tally);
        self.fill_outputs(flight, &mut facts, &mut tally);
        self.fill_rotor_speed(flight, &mut tally);
        self.fill_states(flight, &mut facts, &mut tally);
        std::mem::take(&mut self.stated.texts).give(&mut facts);
        flight.facts = facts;
        tally.give(flight);
    }

    fn parameter(&self, name: &str) -> Option<f64> {
        self.stated.parameters.get(name).copied()
    }

    /// The estimators, first the one that flies: both may run and be logged.
    fn estimators(&self) -> [Estimator; 2] {
        match self.parameter("AHRS_EKF_TYPE") {
            Some(2.0) => [EKF2, EKF3],
            _ => [EKF3, EKF2],
        }
    }

    /// The core of an estimator that flies.
    fn core(&self, estimator: &Estimator) -> u8 {
        let mut status = self.topics.instances(estimator.status);
        let primary = status.next().and_then(|(_, topic)| topic.most_frequent("PI"));
        let stated = || self.parameter(estimator.primary?);
        primary.or_else(stated).map_or(0, |core| core as u8)
    }

    fn fill_attitude(&self, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
        let quaternions = self.estimators().map(|e| (e.quaternion, self.core(&e)));
        let mut chosen = ("", 0, Stream::default());
        for (name, core) in quaternions.into_iter().chain([("ATT", 0), ("ANG", 0)]) {
            let Some(core) = self.topics.primary_instance(name, core) else { continue };
            let Some(topic) = self.topics.primary(name, core, tally) else { continue };
            let stream = self.topics.stream(topic, tally, |row| {
                let quaternion = row.finite(["Q1", "Q2", "Q3", "Q4"]);
                let attitude = match quaternion {
                    Some(q) => Attitude::from_wire(q.map(|c| c as f32)),
                    None => euler(&row, ["Roll", "Pitch", "Yaw"]),
                };
                Sample::of(stamp(&row), attitude)
            });
            if stream.is_more_frequent(&chosen.2) || chosen.2.is_empty() {
                chosen = (name, core, stream);
            }
        }
        let (name, core, stream) = chosen;
        if !stream.is_empty() {
            let of_core =
                if name.ends_with('Q') { format!(" of core {core}") } else { String::new() };
            facts.notes.push(format!("attitude from {name}{of_core}"));
        }
        flight.attitude = stream;
    }

    /// Fills body rate and specific force, each from the message with the highest rate.
    fn fill_sensors(&self, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
        const GYRO: [&str; 3] = ["GyrX", "GyrY", "GyrZ"];
        const ACCELEROMETER: [&str; 3] = ["AccX", "AccY", "AccZ"];
        const RATE: [&str; 3] = ["R", "P", "Y"];
        let mut most =
            |of: &str, sources: &[(&'static str, [&'static str; 3])], tally: &mut Tally| {
                let mut chosen = ("", Stream::default());
                for (name, fields) in sources {
                    let Some(topic) = self.topics.primary(name, 0, tally) else { continue };
                    let stream = self.topics.stream(topic, tally, |row| {
                        Sample::of(sampled(&row), row.finite(*fields).map(Frd::from))
                    });
                    if stream.is_more_frequent(&chosen.1) || chosen.1.is_empty() {
                        chosen = (*name, stream);
                    }
                }
                if !chosen.1.is_empty() {
                    facts.notes.push(format!("{of} from {}", chosen.0));
                }
                chosen.1
            };
        flight.body_rate =
            most("body rate", &[("IMU", GYRO), ("GYR", GYRO), ("RATE", RATE)], tally);
        // The tally above has counted these instances.
        let mut again = Tally::default();
        flight.specific_force =
            most("specific force", &[("IMU", ACCELEROMETER), ("ACC", ACCELEROMETER)], &mut again);
    }

    fn fill_position(&self, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
        let states = self.estimators().map(|e| (e.state, self.core(&e)));
        for (name, core) in states.into_iter().chain([("EKF1", 0)]) {
            let Some(core) = self.topics.primary_instance(name, core) else { continue };
            let Some(topic) = self.topics.primary(name, core, tally) else { continue };
            let vector = |fields: [&'static str; 3], tally: &mut Tally| {
                self.topics.stream(topic, tally, |row| {
                    Sample::of(stamp(&row), row.finite(fields).map(Ned::from))
                })
            };
            flight.position = vector(["PN", "PE", "PD"], tally);
            flight.velocity = vector(["VN", "VE", "VD"], &mut Tally::default());
            facts.notes.push(format!("position and velocity from {name} of core {core}"));
            return;
        }
    }

    /// Fills the setpoint of the attitude loop: the ground's if GUIDED logged it, else the target
    /// that the autopilot shaped.
    fn fill_setpoint(&self, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
        if let Some(topic) = self.topics.primary("GUIA", 0, tally) {
            flight.setpoint = self.topics.stream(topic, tally, |row| {
                let thrust = row.get("Thrust");
                let setpoint = AttitudeSetpoint {
                    attitude: euler(&row, ["Roll", "Pitch", "Yaw"]),
                    body_rate: row.finite(["RollRt", "PitchRt", "YawRt"]).map(Frd::from),
                    thrust: thrust.is_finite().then_some(thrust),
                };
                Sample::of(stamp(&row), setpoint.attitude.map(|_| setpoint))
            });
            flight.setpoint_source = SetpointSource::Ground;
            facts.notes.push("setpoints from GUIA".to_owned());
            return;
        }
        let more = |name: &'static str| self.topics.instance(name, 0).map_or(0, Topic::len);
        let name = if more("ANG") > more("ATT") { "ANG" } else { "ATT" };
        let Some(topic) = self.topics.instance(name, 0) else { return };
        let throttle: Stream<f64> = match self.topics.instance("RATE", 0) {
            Some(topic) => self.topics.stream(topic, &mut Tally::default(), |row| {
                let throttle = row.get("AOut");
                Sample::of(stamp(&row), throttle.is_finite().then_some(throttle))
            }),
            None => Stream::default(),
        };
        flight.setpoint = self.topics.stream(topic, &mut Tally::default(), |row| {
            let attitude = euler(&row, ["DesRoll", "DesPitch", "DesYaw"]);
            let thrust = throttle.held_at(stamp(&row)).copied();
            let setpoint = AttitudeSetpoint { attitude, body_rate: None, thrust };
            Sample::of(stamp(&row), attitude.map(|_| setpoint))
        });
        flight.setpoint_source = SetpointSource::Onboard;
        facts
            .notes
            .push(format!("setpoints are the target that the autopilot shaped, from {name}"));
    }

    fn fill_states(&self, flight: &mut Flight, facts: &mut VehicleFacts, tally: &mut Tally) {
        for name in ["BAT", "CURR"] {
            // Of several packs, the first that has a voltage.
            let pack = self.topics.first_live(name, |row| row.get("Volt") > 0.0);
            let Some(topic) = self.topics.primary(name, pack, tally) else { continue };
            flight.voltage = self.topics.stream(topic, tally, |row| {
                let voltage = row.get("Volt");
                if voltage == 0.0 {
                    return Sample::Skip;
                }
                Sample::of(stamp(&row), (voltage > 0.0 && voltage < 1e3).then_some(voltage))
            });
            break;
        }
        if let Some(topic) = self.topics.instance("EV", 0) {
            flight.in_air = self.topics.stream(topic, tally, |row| match in_air(&row) {
                Some(in_air) => Sample::Keep(stamp(&row), in_air),
                None => Sample::Skip,
            });
        }
        if let Some(topic) = self.topics.instance("MODE", 0) {
            let mut last = f64::NAN;
            for row in topic.rows() {
                let number = row.get("ModeNum");
                let number = if number.is_finite() { number } else { row.get("Mode") };
                if number != last && facts.notes.len() < NOTES_MAX {
                    facts.notes.push(format!("mode {} from {:.2} s", mode(number), stamp(&row)));
                }
                last = number;
            }
        }
    }
}

/// Whether the vehicle is in the air after an event; `None` for others.
fn in_air(row: &Row<'_>) -> Option<bool> {
    match row.get("Id") {
        // Not landed.
        28.0 => Some(true),
        // Disarmed, possibly landed, landed.
        11.0 | 17.0 | 18.0 => Some(false),
        _ => None,
    }
}

/// Time in the air of a boot, s.
pub(super) fn flown(topics: &Topics) -> f64 {
    topics.time_in_air("EV", |row| Some((stamp(&row), in_air(&row)?)))
}

/// Largest number of notes; a damaged log may have any number of modes.
const NOTES_MAX: usize = 60;

/// Name of a mode of ArduCopter.
fn mode(number: f64) -> String {
    let name = match number {
        0.0 => "STABILIZE",
        1.0 => "ACRO",
        2.0 => "ALT_HOLD",
        3.0 => "AUTO",
        4.0 => "GUIDED",
        5.0 => "LOITER",
        6.0 => "RTL",
        9.0 => "LAND",
        16.0 => "POSHOLD",
        17.0 => "BRAKE",
        20.0 => "GUIDED_NOGPS",
        number => return format!("{number}"),
    };
    name.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A log with ten rows of each of these messages: name, core, a field and its number.
    fn log(parameters: &[(&str, f64)], messages: &[(&str, u8, &str, f64)]) -> Contents {
        let mut contents = Contents::default();
        contents
            .stated
            .parameters
            .extend(parameters.iter().map(|(name, x)| ((*name).to_owned(), *x)));
        for step in 0..10 {
            let time = 0.1 * f64::from(step);
            for (name, core, field, number) in messages {
                let source = SOURCES.iter().find(|source| source.spec.topic == *name);
                let spec = source.expect("a known message").spec;
                let value = |of: &&str| match *of {
                    "TimeUS" => time,
                    of if of == *field => *number,
                    _ => 0.0,
                };
                let values: Vec<f64> = spec.fields.iter().map(value).collect();
                contents.topics.push(spec, *core, time, &values);
            }
        }
        contents
    }

    #[test]
    fn position_is_of_the_estimator_and_the_core_that_fly() {
        let messages = [
            ("XKF1", 0, "PN", 1.0),
            ("XKF1", 1, "PN", 2.0),
            ("NKF1", 0, "PN", 3.0),
            ("NKF1", 1, "PN", 4.0),
            ("XKF4", 0, "PI", 1.0),
            ("NKF4", 0, "PI", 0.0),
        ];
        for (parameters, north, note) in [
            (vec![], 2.0, "XKF1 of core 1"),
            (vec![("AHRS_EKF_TYPE", 3.0)], 2.0, "XKF1 of core 1"),
            (vec![("AHRS_EKF_TYPE", 2.0)], 3.0, "NKF1 of core 0"),
        ] {
            let mut flight = flight();
            let mut facts = VehicleFacts::default();
            let contents = log(&parameters, &messages);
            contents.fill_position(&mut flight, &mut facts, &mut Tally::default());
            assert_eq!(flight.position.values()[0].north(), north);
            assert_eq!(facts.notes, [format!("position and velocity from {note}")]);
        }
    }

    fn flight() -> Flight {
        Flight::in_memory("memory", "dataflash")
    }

    #[test]
    fn voltage_is_of_the_first_pack_that_has_one() {
        for (volts, used) in [([0.0, 12.0], 12.0), ([11.0, 12.0], 11.0)] {
            let packs = [("BAT", 0, "Volt", volts[0]), ("BAT", 1, "Volt", volts[1])];
            let (mut flight, mut tally) = (flight(), Tally::default());
            let mut facts = VehicleFacts::default();
            log(&[], &packs).fill_states(&mut flight, &mut facts, &mut tally);
            assert_eq!(flight.voltage.values(), [used; 10]);
        }
    }

    #[test]
    fn older_messages_are_of_one_instance() {
        assert_eq!(instance_of("NKF6"), Some(("NKF1", 1)));
        assert_eq!(instance_of("XKQ1"), Some(("XKQ", 0)));
        assert_eq!(instance_of("ESC8"), Some(("ESC", 7)));
        assert_eq!(instance_of("NKF1"), None);
        assert!(SINGLES.iter().all(|(_, all, _)| SOURCES.iter().any(|s| s.spec.topic == *all)));
    }
}
