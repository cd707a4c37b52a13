//! Flight logs of any origin become the same flight, and damage to them is counted.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::damage::{move_vehicle_clock, sign, spoil};
use crate::{damage, lockstep, log_flight};
use downwash::log::import::{
    Choice, Clock, Flight, ImportError, MotorSource, MotorUnit, Stream, VehicleKind, open,
    open_chosen, write,
};
use downwash::log::record::Record;
use sitl::config::SitlConfig;
use wire::Encoder;
use wire::dialect::*;

/// A fresh file of the test's own.
fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_import").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    let path = directory.join(name);
    let _ = fs::remove_file(&path);
    path
}

/// A whole flight of the nano quadrotor in lockstep, with sensor noise.
static RECORDS: LazyLock<Vec<Record>> = LazyLock::new(|| {
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::trajectory("sinusoid-xy.toml"));
    lockstep::fly(settings, &params, &[], SitlConfig::default(), 3).1
});

/// The flight's frames as entries of a telemetry log, each with its stamp in us.
fn entries() -> Vec<(u64, Vec<u8>)> {
    damage::entries(&RECORDS)
}

fn write_tlog(test: &str, name: &str, entries: &[(u64, Vec<u8>)]) -> PathBuf {
    let path = place(test, name);
    damage::write_tlog(&path, entries);
    path
}

fn import(path: &Path) -> Flight {
    open(path, None).unwrap_or_else(|error| panic!("{error}"))
}

/// Count of what was left out for a reason that has `words` in it.
fn left_out(flight: &Flight, words: &str) -> u64 {
    flight.left_out.iter().filter(|(reason, _)| reason.contains(words)).map(|(_, n)| n).sum()
}

fn assert_ascends<T>(stream: &Stream<T>, name: &str) {
    assert!(stream.times().windows(2).all(|pair| pair[0] < pair[1]), "{name}");
    assert!(stream.times().iter().all(|time| time.is_finite()), "{name}");
}

fn assert_same_streams(a: &Flight, b: &Flight) {
    assert_eq!(a.attitude, b.attitude);
    assert_eq!(a.position, b.position);
    assert_eq!(a.velocity, b.velocity);
    assert_eq!(a.body_rate, b.body_rate);
    assert_eq!(a.specific_force, b.specific_force);
    assert_eq!(a.outputs, b.outputs);
    assert_eq!(a.rotor_speed, b.rotor_speed);
    assert_eq!(a.setpoint, b.setpoint);
    assert_eq!(a.voltage, b.voltage);
    assert_eq!(a.in_air, b.in_air);
    assert_eq!((a.motor_unit, a.motor_source, a.clock), (b.motor_unit, b.motor_source, b.clock));
}

#[test]
fn own_log_and_telemetry_log_of_a_flight_are_the_same_flight() {
    let folder = place("same", "mcap");
    let _ = fs::remove_dir_all(&folder);
    let mcap = import(&log_flight::write(&folder, &RECORDS));
    let tlog = import(&write_tlog("same", "flight.tlog", &entries()));
    assert_same_streams(&mcap, &tlog);
    assert_eq!(mcap.left_out, []);
    assert_eq!(tlog.left_out, []);
    assert_eq!((mcap.origin.format, tlog.origin.format), ("mcap", "tlog"));
    assert_eq!(tlog.origin.run, "flight");
    assert_eq!(tlog.origin.sha256.len(), 64);

    assert!(mcap.attitude.rate() > 240.0, "{}", mcap.attitude.rate());
    assert!(mcap.body_rate.rate() > 240.0 && mcap.specific_force.rate() > 240.0);
    assert!(mcap.position.rate() > 45.0 && mcap.setpoint.rate() > 95.0);
    assert_eq!((mcap.motor_unit, mcap.motor_source), {
        (MotorUnit::ThrustFraction, MotorSource::ActuatorOutputStatus)
    });
    assert_eq!(mcap.clock, Clock::Synchronised);
    assert!(mcap.in_air.values().contains(&true) && !mcap.voltage.is_empty());
    // The truth is on the clock of the reports.
    assert!(tlog.truth.is_empty() && mcap.truth.len() > 1000);
    let mut compared = 0;
    for (time, truth) in mcap.truth.iter() {
        if let Some(at) = mcap.attitude.index_at(time)
            && time - mcap.attitude.times()[at] < 1e-6
        {
            assert!(mcap.attitude.values()[at].angle_to(truth.attitude) < 0.02, "at {time}");
            compared += 1;
        }
    }
    assert!(compared > 500, "{compared}");
    // A setpoint is sent at the time of the state that it answers.
    let first = mcap.setpoint.times()[0];
    let at = mcap.attitude.index_at(first + 1e-4).expect("an attitude before");
    assert!(first - mcap.attitude.times()[at] < 0.011);
    for (stream, name) in [(&mcap.voltage, "voltage"), (&tlog.voltage, "voltage")] {
        assert_ascends(stream, name);
    }
}

#[test]
fn an_imported_flight_reads_back_the_same() {
    let folder = place("again", "mcap");
    let _ = fs::remove_dir_all(&folder);
    let flight = import(&log_flight::write(&folder, &RECORDS));
    let path = place("again", "imported.mcap");
    let messages = write(&flight, &path).expect("a log");
    assert!(messages as usize > 3 * flight.attitude.len());
    let back = import(&path);
    assert_same_streams(&back, &flight);
    assert_eq!(back.truth, flight.truth);
    assert_eq!((&back.vehicle_file, &back.left_out), (&flight.vehicle_file, &flight.left_out));
    assert_eq!((back.rows, back.origin.run.as_str()), (None, "imported"));
}

#[test]
fn what_is_no_log_is_an_error_that_says_so() {
    let path = place("garbage", "noise.tlog");
    fs::write(&path, [0x55; 5000]).expect("a file");
    let error = open(&path, None).expect_err("no log");
    assert!(matches!(error, ImportError::NotALog { .. }));
    assert!(error.to_string().contains("noise.tlog"), "{error}");
    let missing = open(Path::new("no/such.tlog"), None).expect_err("no file");
    assert!(missing.to_string().contains("no/such.tlog"), "{missing}");
    let ulog = place("garbage", "log.ulg");
    // Cut within its head: a log of nothing, and that is counted.
    fs::write(&ulog, b"ULog\x01\x12\x35\x01 and").expect("a file");
    let nothing = open(&ulog, None).expect_err("nothing in it").to_string();
    assert!(nothing.contains("log.ulg") && nothing.contains("cut short"), "{nothing}");
}

#[test]
fn a_short_log_is_a_flight() {
    let all = entries();
    let start = all[0].0;
    let short: Vec<_> = all.into_iter().filter(|(time, _)| time - start < 2_000_000).collect();
    let flight = import(&write_tlog("short", "short.tlog", &short));
    let times = flight.attitude.times();
    assert!(times.last().unwrap() - times[0] < 2.1 && flight.attitude.len() > 100);
    assert_eq!(flight.left_out, []);
}

#[test]
fn a_log_cut_short_gives_what_is_whole() {
    let path = write_tlog("cut", "flight.tlog", &entries());
    let bytes = fs::read(&path).expect("the log");
    let cut = place("cut", "cut.tlog");
    fs::write(&cut, &bytes[..bytes.len() / 2 - 3]).expect("a file");
    let (whole, cut) = (import(&path), import(&cut));
    assert!(cut.attitude.len() > whole.attitude.len() / 3);
    assert_eq!(cut.attitude.times(), &whole.attitude.times()[..cut.attitude.len()]);
    let skipped = left_out(&cut, "no whole frame");
    assert!(skipped > 0 && skipped < 300, "{skipped}");
}

#[test]
fn a_burst_of_nan_is_left_out_and_counted() {
    let mut entries = entries();
    let middle = entries.len() / 2;
    let spoiled = spoil(&mut entries, 31, middle, 400, f32::NAN);
    assert!(spoiled > 20, "{spoiled}");
    let flight = import(&write_tlog("nan", "flight.tlog", &entries));
    assert_eq!(left_out(&flight, "ATTITUDE_QUATERNION"), spoiled);
    assert!(flight.attitude.values().iter().all(|q| q.w.is_finite() && q.z.is_finite()));
}

#[test]
fn duplicated_frames_are_left_out_and_counted() {
    let sound = entries();
    let mut doubled = Vec::new();
    for (number, entry) in sound.iter().enumerate() {
        doubled.push(entry.clone());
        if number % 7 == 0 {
            doubled.push((entry.0 + 50, entry.1.clone()));
        }
    }
    let flight = import(&write_tlog("double", "flight.tlog", &doubled));
    assert_eq!(left_out(&flight, "duplicated") as usize, doubled.len() - sound.len());
    assert_same_streams(&flight, &import(&write_tlog("double", "sound.tlog", &sound)));
}

#[test]
fn after_a_jump_of_the_vehicles_clock_the_longer_part_is_the_flight() {
    for by_ms in [-20_000, 300_000] {
        let mut entries = entries();
        let two_thirds = entries.len() * 2 / 3;
        move_vehicle_clock(&mut entries, two_thirds, by_ms);
        let flight = import(&write_tlog("jump", &format!("jump{by_ms}.tlog"), &entries));
        let whole = import(&write_tlog("jump", "whole.tlog", &self::entries()));
        let kept = flight.attitude.len();
        assert!(kept < whole.attitude.len() && kept > whole.attitude.len() / 2, "{kept}");
        assert_eq!(flight.attitude.times(), &whole.attitude.times()[..kept]);
        let last = flight.attitude.times()[kept - 1];
        assert!(flight.setpoint.times().iter().all(|time| *time < last + 0.1));
        let other = left_out(&flight, "another run of the vehicle's clock");
        assert!(other as usize > whole.attitude.len() / 5, "{:?}", flight.left_out);
    }
}

#[test]
fn a_step_of_the_grounds_clock_leaves_the_streams_alone() {
    let whole = import(&write_tlog("step", "whole.tlog", &entries()));
    let mut entries = entries();
    let middle = entries.len() / 2;
    entries.iter_mut().skip(middle).for_each(|(time, _)| *time -= 7_000_000);
    let flight = import(&write_tlog("step", "flight.tlog", &entries));
    assert_eq!(flight.attitude, whole.attitude);
    assert_eq!(flight.body_rate, whole.body_rate);
    assert_eq!(left_out(&flight, "step of the ground's clock"), 1);
    // Setpoints right at the step are lost, the others are where they were.
    assert!(flight.setpoint.len() + 250 > whole.setpoint.len());
    let worst = flight.setpoint.iter().map(|(time, _)| {
        let at = whole.setpoint.index_at(time + 1e-3).expect("a setpoint");
        (whole.setpoint.times()[at] - time).abs()
    });
    assert!(worst.fold(0.0, f64::max) < 0.011);
}

#[test]
fn of_two_vehicles_the_one_with_more_attitudes_is_the_flight() {
    let mut both = Vec::new();
    for (number, (time, bytes)) in entries().into_iter().enumerate() {
        if bytes[5] == 1 && number % 3 == 0 {
            let mut other = bytes.clone();
            other[5] = 2;
            sign(&mut other);
            both.push((time, other));
        }
        both.push((time, bytes));
    }
    let flight = import(&write_tlog("two", "flight.tlog", &both));
    let alone = import(&write_tlog("two", "alone.tlog", &entries()));
    assert_same_streams(&flight, &alone);
    assert!(left_out(&flight, "another vehicle") > 1000, "{:?}", flight.left_out);
}

/// A telemetry log of one vehicle, message by message, every 10 ms of both clocks.
struct Telemetry {
    entries: Vec<(u64, Vec<u8>)>,
    encoder: Encoder,
    ground_us: u64,
    vehicle_ms: u32,
}

impl Telemetry {
    fn new() -> Self {
        let encoder = Encoder::new(1, 1);
        Self { entries: Vec::new(), encoder, ground_us: 1_760_000_000_000_000, vehicle_ms: 4000 }
    }

    fn send(&mut self, message: &MavMessage) {
        let mut bytes = Vec::new();
        self.encoder.encode(message, &mut bytes);
        self.ground_us += 20;
        self.entries.push((self.ground_us, bytes));
    }

    fn wait(&mut self, ms: u32) {
        self.vehicle_ms += ms;
        self.ground_us += u64::from(ms) * 1000;
    }

    fn heartbeat(&mut self, mavtype: MavType, autopilot: MavAutopilot, armed: bool) {
        let armed =
            if armed { MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { MavModeFlag::empty() };
        let data = HEARTBEAT_DATA { mavtype, autopilot, base_mode: armed, ..Default::default() };
        self.send(&MavMessage::HEARTBEAT(data));
    }

    /// Attitudes for so many seconds, with what `also` sends at each.
    fn fly(&mut self, seconds: u32, mut also: impl FnMut(&mut Self, u32)) {
        for step in 0..100 * seconds {
            let (roll, time_boot_ms) = (0.2 * (0.01 * step as f32).sin(), self.vehicle_ms);
            self.send(&MavMessage::ATTITUDE(ATTITUDE_DATA {
                time_boot_ms,
                roll,
                ..Default::default()
            }));
            also(self, step);
            self.wait(10);
        }
    }
}

fn parameter(name: &str, value: f32) -> MavMessage {
    let mut param_id = [0; 16];
    param_id[..name.len()].copy_from_slice(name.as_bytes());
    let param_type = MavParamType::MAV_PARAM_TYPE_REAL32;
    let param_id = param_id.into();
    MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value: value,
        param_id,
        param_type,
        ..Default::default()
    })
}

#[test]
fn of_two_boots_the_longest_flight_is_taken_or_the_one_asked_for() {
    let mut log = Telemetry::new();
    let quad = MavType::MAV_TYPE_QUADROTOR;
    // On the ground for longer than the flight takes; switched off between.
    for (boot, seconds) in [(1, 40), (2, 20), (3, 5)] {
        log.vehicle_ms = 1000 * boot;
        log.fly(seconds, |log, step| {
            if step % 100 == 0 {
                log.heartbeat(quad, MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, boot == 2);
            }
        });
        log.ground_us += 30_000_000;
    }
    let path = write_tlog("boots", "flight.tlog", &log.entries);
    let flight = import(&path);
    let span = |flight: &Flight| {
        let times = flight.attitude.times();
        (times[0].round(), times[times.len() - 1].round())
    };
    assert_eq!(span(&flight), (2.0, 22.0));
    let note = |words: &str| flight.facts.notes.iter().any(|note| note.contains(words));
    assert!(note("boot 2 of 3 (--boot 2)") && note("flown, used"), "{:?}", flight.facts.notes);
    let chosen = |boot| open_chosen(&path, Choice { mapping: None, boot: Some(boot) });
    assert_eq!(span(&chosen(1).expect("a boot")), (1.0, 41.0));
    assert_eq!(span(&chosen(3).expect("a boot")), (3.0, 8.0));
    for boot in [0, 4] {
        let error = chosen(boot).expect_err("no such boot").to_string();
        assert!(error.contains(&format!("from 1 to 3 (--boot), found {boot}")), "{error}");
    }
}

#[test]
fn imus_and_voltages_of_every_message_are_read() {
    let (ardupilot, px4) =
        (MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, MavAutopilot::MAV_AUTOPILOT_PX4);
    let recorded = |autopilot: MavAutopilot, message: fn(u32) -> MavMessage| {
        let mut log = Telemetry::new();
        log.fly(4, |log, step| {
            let now = log.vehicle_ms;
            log.send(&message(now));
            if step % 100 == 0 {
                log.heartbeat(MavType::MAV_TYPE_QUADROTOR, autopilot, true);
                let data = SYS_STATUS_DATA { voltage_battery: 15_100, ..Default::default() };
                log.send(&MavMessage::SYS_STATUS(data));
            }
        });
        import(&write_tlog("imus", "flight.tlog", &log.entries))
    };
    macro_rules! scaled {
        ($message:ident, $data:ident) => {
            |time_boot_ms| {
                MavMessage::$message($data {
                    time_boot_ms,
                    zacc: -1000,
                    xgyro: 250,
                    ..Default::default()
                })
            }
        };
    }
    let raw = |ms: u32| {
        let data = RAW_IMU_DATA {
            time_usec: u64::from(ms) * 1000,
            zacc: -1000,
            xgyro: 250,
            ..Default::default()
        };
        MavMessage::RAW_IMU(data)
    };
    for (autopilot, message) in [
        (ardupilot, raw as fn(u32) -> MavMessage),
        (px4, scaled!(SCALED_IMU, SCALED_IMU_DATA)),
        (ardupilot, scaled!(SCALED_IMU2, SCALED_IMU2_DATA)),
        (ardupilot, scaled!(SCALED_IMU3, SCALED_IMU3_DATA)),
    ] {
        let flight = recorded(autopilot, message);
        assert_eq!((flight.specific_force.len(), flight.body_rate.len()), (400, 400));
        assert_eq!(flight.specific_force.values()[9].to_array(), [0.0, 0.0, -9.80665]);
        assert_eq!(flight.body_rate.values()[9].to_array(), [0.25, 0.0, 0.0]);
        assert_eq!((flight.voltage.len(), flight.voltage.values()[0]), (4, 15.1));
        assert_eq!(flight.left_out, []);
    }
    // What another autopilot means by a raw number is not known.
    let flight = recorded(px4, raw);
    assert!(flight.specific_force.is_empty());
    assert_eq!(left_out(&flight, "RAW_IMU"), 400);
}

#[test]
fn telemetry_tells_what_the_vehicle_is_and_which_outputs_are_motors() {
    let recorded = |mavtype: MavType, parameters: &[(&str, f32)]| {
        let mut log = Telemetry::new();
        log.heartbeat(mavtype, MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, true);
        for (name, value) in parameters {
            log.send(&parameter(name, *value));
        }
        log.fly(4, |log, step| {
            let time_usec = log.vehicle_ms * 1000;
            let pulse = |n: u16| 1400 + 10 * n + (step % 7) as u16;
            let data = SERVO_OUTPUT_RAW_DATA {
                time_usec,
                servo1_raw: pulse(1),
                servo2_raw: pulse(2),
                servo3_raw: pulse(3),
                servo4_raw: pulse(4),
                servo9_raw: pulse(9),
                servo10_raw: pulse(10),
                ..Default::default()
            };
            log.send(&MavMessage::SERVO_OUTPUT_RAW(data));
        });
        import(&write_tlog("kinds", "flight.tlog", &log.entries))
    };
    let quad = recorded(MavType::MAV_TYPE_QUADROTOR, &[]);
    assert_eq!((quad.facts.stated_otherwise(), quad.facts.motors), (None, Some(4)));
    assert_eq!(quad.outputs.values()[0], [1410.0, 1420.0, 1430.0, 1440.0]);
    let functions = [
        ("SERVO3_FUNCTION", 33.0),
        ("SERVO9_FUNCTION", 34.0),
        ("SERVO10_FUNCTION", 35.0),
        ("SERVO1_FUNCTION", 36.0),
    ];
    let quad = recorded(MavType::MAV_TYPE_QUADROTOR, &functions);
    assert_eq!(quad.outputs.values()[0], [1430.0, 1490.0, 1500.0, 1410.0]);
    assert!(quad.facts.notes.iter().any(|note| note.contains("outputs 3, 9, 10, 1")));
    for (mavtype, kind) in [
        (MavType::MAV_TYPE_FIXED_WING, VehicleKind::FixedWing),
        (MavType::MAV_TYPE_VTOL_TILTROTOR, VehicleKind::Vtol),
        (MavType::MAV_TYPE_GROUND_ROVER, VehicleKind::Rover),
        (MavType::MAV_TYPE_SUBMARINE, VehicleKind::Submarine),
        (MavType::MAV_TYPE_HELICOPTER, VehicleKind::Helicopter),
    ] {
        let flight = recorded(mavtype, &[]);
        let stated = flight.facts.stated_otherwise().expect("a statement");
        assert_eq!(stated.kind, kind);
        assert!(stated.by.contains("HEARTBEAT"), "{stated:?}");
    }
    assert_eq!(recorded(MavType::MAV_TYPE_HEXAROTOR, &[]).facts.motors, Some(6));
}

#[test]
fn telemetry_without_a_flight_says_what_it_has() {
    let mut log = Telemetry::new();
    for _ in 0..20 {
        log.heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4, false);
        log.wait(1000);
    }
    let path = write_tlog("nothing", "ground.tlog", &log.entries);
    let error = open(&path, None).expect_err("nothing").to_string();
    assert!(error.contains("ground.tlog") && error.contains("it has HEARTBEAT"), "{error}");
}

/// Folders of practice flights: `DOWNWASH_PRACTICE`, else `shared/` beside the repository.
fn practice_tlogs() -> Vec<PathBuf> {
    let folders = match std::env::var_os("DOWNWASH_PRACTICE") {
        Some(folder) => vec![PathBuf::from(folder)],
        None => {
            let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
            ["practice", "practice-autopilot", "practice-real"].map(|n| shared.join(n)).to_vec()
        }
    };
    let cases = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten();
    let files = cases.filter_map(|case| fs::read_dir(case.ok()?.path()).ok()).flatten();
    let mut files: Vec<PathBuf> = files
        .filter_map(|file| Some(file.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "tlog"))
        .collect();
    files.sort();
    files
}

/// Slope of the best line through the origin, and the share of `y` that it explains.
fn regression(pairs: &[(f64, f64)]) -> (f64, f64) {
    let sum = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    let (xx, xy, yy) = (sum(|(x, _)| x * x), sum(|(x, y)| x * y), sum(|(_, y)| y * y));
    (xy / xx, xy * xy / (xx * yy))
}

/// A stream's integral from its start, by the trapezoidal rule.
struct Integral {
    times: Vec<f64>,
    sums: Vec<[f64; 3]>,
}

impl Integral {
    fn new(stream: &Stream<[f64; 3]>) -> Self {
        let mut sum = [0.0; 3];
        let mut sums = vec![sum];
        for (t, v) in stream.times().windows(2).zip(stream.values().windows(2)) {
            sum = std::array::from_fn(|i| sum[i] + 0.5 * (t[1] - t[0]) * (v[0][i] + v[1][i]));
            sums.push(sum);
        }
        Self { times: stream.times().to_vec(), sums }
    }

    fn at(&self, time: f64) -> Option<[f64; 3]> {
        let b = self.times.partition_point(|t| *t <= time);
        let a = b.checked_sub(1)?;
        let share = (time - self.times[a]) / (self.times.get(b)? - self.times[a]);
        Some(std::array::from_fn(|i| self.sums[a][i] + share * (self.sums[b][i] - self.sums[a][i])))
    }
}

/// How the changes of `stream` over `window` seconds follow the integral of `rate`: slope, share
/// explained, and the delay of `stream` at which it is largest.
fn kinematics<T>(
    stream: &Stream<T>,
    rate: &Stream<[f64; 3]>,
    window: f64,
    change: impl Fn(&T, &T) -> [f64; 3],
) -> Option<(f64, f64, f64)> {
    let integral = Integral::new(rate);
    let (first, last) = (stream.times().first()? + 0.5, stream.times().last()? - 0.5);
    let mut best = None;
    for step in -20..=20 {
        let delay = f64::from(step) * 4e-3;
        let mut pairs = Vec::new();
        let mut time = first;
        while time < last {
            let (a, b) = (stream.index_at(time)?, stream.index_at(time + window)?);
            let (from, to) = (stream.times()[a] - delay, stream.times()[b] - delay);
            if let (Some(before), Some(after)) = (integral.at(from), integral.at(to)) {
                let found = change(&stream.values()[a], &stream.values()[b]);
                pairs.extend((0..3).map(|i| (after[i] - before[i], found[i])));
            }
            time += window;
        }
        let (slope, explained) = regression(&pairs);
        if pairs.len() > 100 && best.is_none_or(|(_, most, _)| explained > most) {
            best = Some((slope, explained, delay));
        }
    }
    best
}

/// Every practice log: rates, order of times, and streams that fit each other.
#[test]
fn practice_logs_are_read_and_their_streams_agree() {
    for path in practice_tlogs() {
        let name = path.display().to_string();
        let flight = import(&path);
        assert_ascends(&flight.attitude, &name);
        assert_ascends(&flight.position, &name);
        assert_ascends(&flight.body_rate, &name);
        assert_ascends(&flight.outputs, &name);
        assert_ascends(&flight.setpoint, &name);
        assert_ascends(&flight.voltage, &name);
        assert!(flight.outputs.rate() > 50.0, "{name}: {}", flight.outputs.rate());
        // The streams of a flight cover the same time.
        let ends = |times: &[f64]| Some((*times.first()?, *times.last()?));
        let outputs = ends(flight.outputs.times()).expect("outputs");
        for times in [flight.attitude.times(), flight.position.times(), flight.body_rate.times()] {
            let Some((from, to)) = ends(times) else { continue };
            assert!((from - outputs.0).abs() < 1.0 && (to - outputs.1).abs() < 1.0, "{name}");
        }
        let period = flight.outputs.period().expect("outputs");
        let pauses = flight.outputs.times().windows(2).map(|pair| pair[1] - pair[0]);
        let longest = pauses.fold(0.0, f64::max);
        let rate = flight.body_rate.map(|rate| rate.to_array());
        let turn = kinematics(&flight.attitude, &rate, 0.1, |a, b| {
            let turn = a.inverse().compose(*b).canonical();
            [turn.x, turn.y, turn.z].map(|c| 2.0 * c)
        });
        let velocity = flight.velocity.map(|velocity| velocity.to_array());
        let way = kinematics(&flight.position, &velocity, 0.2, |a, b| (*b - *a).to_array());
        println!(
            "{name}: attitude {} at {:.1} Hz, rate {:.1}, force {:.1}, position {:.1}, \
             outputs {:.1} (longest {:.1} periods) {:?}, setpoint {:.1}, voltage {:.1}, rpm {:.1}, \
             in air {}, {:?}; turn {turn:.4?}, way {way:.4?}; {:?}",
            flight.attitude.len(),
            flight.attitude.rate(),
            flight.body_rate.rate(),
            flight.specific_force.rate(),
            flight.position.rate(),
            flight.outputs.rate(),
            longest / period,
            flight.motor_unit,
            flight.setpoint.rate(),
            flight.voltage.rate(),
            flight.rotor_speed.rate(),
            flight.in_air.len(),
            flight.clock,
            flight.left_out,
        );
        for (slope, explained, _) in [turn, way].into_iter().flatten() {
            // Real flights near hover hardly turn: noise then explains the rest, and lowers the
            // slope by as much.
            let tolerance = if explained > 0.9 { 0.1 } else { 0.35 };
            assert!((slope - 1.0).abs() < tolerance, "{name}: {slope} {explained}");
        }
        assert_eq!(flight.left_out, [], "{name}");
    }
}

#[test]
fn outputs_span_what_the_autopilots_own_parameters_state() {
    let (ardupilot, px4) =
        (MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, MavAutopilot::MAV_AUTOPILOT_PX4);
    let recorded = |autopilot, stated: &[(&str, f32)], message: fn(u32) -> MavMessage| {
        let mut log = Telemetry::new();
        log.heartbeat(MavType::MAV_TYPE_QUADROTOR, autopilot, true);
        for (name, value) in stated {
            log.send(&parameter(name, *value));
        }
        log.fly(4, |log, _| {
            let now = log.vehicle_ms;
            log.send(&message(now));
        });
        import(&write_tlog("ranges", "flight.tlog", &log.entries))
    };
    let status = |ms: u32| {
        let mut actuator = [0.0; 32];
        actuator[..4].copy_from_slice(&[1100.0, 1500.0, 1900.0, 900.0]);
        let time_usec = u64::from(ms) * 1000;
        MavMessage::ACTUATOR_OUTPUT_STATUS(ACTUATOR_OUTPUT_STATUS_DATA {
            time_usec,
            active: 4,
            actuator,
        })
    };
    let functions = [1, 2, 3, 4].map(|n| (format!("PWM_MAIN_FUNC{n}"), 100.0 + n as f32));
    let mut stated: Vec<(&str, f32)> = functions.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let vehicle = lockstep::params(lockstep::NANO);
    let normalised = |mut flight: Flight, vehicle: &vehicle::VehicleParams| {
        flight.normalise_outputs(vehicle).expect("a unit");
        flight.outputs.values()[50]
    };
    // PX4's simulated outputs have functions and no range.
    let flight = recorded(px4, &stated, status);
    assert_eq!(normalised(flight.clone(), &vehicle), [0.1, 0.5, 0.9, 0.0]);
    // It outlives an import.
    let copy = place("ranges", "copy.mcap");
    write(&flight, &copy).expect("a log");
    assert_eq!(normalised(import(&copy), &vehicle), [0.1, 0.5, 0.9, 0.0]);
    // A range of the file's own wins.
    let own = vehicle::MotorOutput {
        message: "ACTUATOR_OUTPUT_STATUS".to_owned(),
        fields: Vec::new(),
        zero: 900.0,
        one: 1900.0,
        disarmed: 900.0,
    };
    let with_own = vehicle::VehicleParams { motor_output: Some(own), ..vehicle.clone() };
    assert_eq!(normalised(flight, &with_own), [0.2, 0.6, 1.0, 0.0]);
    // A real one states both.
    let ends = [1, 2, 3, 4].map(|n| [format!("PWM_MAIN_MIN{n}"), format!("PWM_MAIN_MAX{n}")]);
    for [low, high] in &ends {
        stated.extend([(low.as_str(), 1100.0), (high.as_str(), 1900.0)]);
    }
    assert_eq!(normalised(recorded(px4, &stated, status), &vehicle), [0.0, 0.5, 1.0, 0.0]);
    let servos = |ms: u32| {
        MavMessage::SERVO_OUTPUT_RAW(SERVO_OUTPUT_RAW_DATA {
            time_usec: ms * 1000,
            servo1_raw: 1150,
            servo2_raw: 1550,
            servo3_raw: 1950,
            servo4_raw: 1000,
            ..Default::default()
        })
    };
    let motors = [
        ("SERVO1_FUNCTION", 33.0),
        ("SERVO2_FUNCTION", 34.0),
        ("SERVO3_FUNCTION", 35.0),
        ("SERVO4_FUNCTION", 36.0),
        ("MOT_PWM_MIN", 1000.0),
        ("MOT_PWM_MAX", 2000.0),
        ("MOT_SPIN_MIN", 0.15),
        ("MOT_SPIN_MAX", 0.95),
    ];
    let found = normalised(recorded(ardupilot, &motors, servos), &vehicle);
    for (found, expected) in found.into_iter().zip([0.0, 0.5, 1.0, 0.0]) {
        assert!((found - expected).abs() < 1e-6, "{found}");
    }
    // Without a word on it nothing is concluded.
    let mut flight = recorded(ardupilot, &motors[..4], servos);
    let error = flight.normalise_outputs(&vehicle).expect_err("no unit").to_string();
    assert!(error.contains("MOT_PWM_*") && error.contains("motor_output"), "{error}");
}
