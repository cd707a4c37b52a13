//! Onboard logs of autopilots, whole, old or damaged, import as flights that agree with the
//! telemetry of the same flight.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::onboard_log::{DataFlash, Ulog, dataflash, floats, old_dataflash, px4_outputs, ulog};
use downwash_log::import::{
    Choice, Flight, MotorSource, MotorUnit, SetpointSource, Stream, VehicleKind, open, open_chosen,
    read_bytes, write,
};
use proptest::prelude::*;
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Frd, Ned};

fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_onboard").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    directory.join(name)
}

fn import(test: &str, name: &str, bytes: &[u8]) -> Flight {
    let path = place(test, name);
    fs::write(&path, bytes).expect("a file");
    open(&path, None).unwrap_or_else(|error| panic!("{error}"))
}

fn left_out(flight: &Flight, words: &str) -> u64 {
    flight.left_out.iter().filter(|(reason, _)| reason.contains(words)).map(|(_, n)| n).sum()
}

fn assert_sound<T>(stream: &Stream<T>) {
    assert!(stream.times().windows(2).all(|pair| pair[0] < pair[1]));
    assert!(stream.times().iter().all(|time| time.is_finite()));
}

#[test]
fn ulog_imports_as_a_flight() {
    // The file name does not matter.
    let flight = import("ulog", "flight.txt", &ulog(4.0).bytes);
    assert_eq!(flight.origin.format, "ulog");
    assert_eq!(
        flight.left_out,
        [
            ("battery_status: of instance 1, where 0 is used".to_owned(), 20),
            ("vehicle_local_position: velocity not valid, by its own flags".to_owned(), 11),
        ]
    );
    assert_eq!((flight.attitude.len(), flight.body_rate.len()), (500, 1000));
    assert_eq!((flight.position.len(), flight.velocity.len()), (100, 89));
    // Samples carry the time of measurement: their own timestamp, or the middle of their interval.
    assert!((flight.attitude.times()[1] - 1.008).abs() < 1e-9);
    assert!((flight.body_rate.times()[1] - 1.002).abs() < 1e-9);
    assert!((flight.specific_force.times()[1] - 1.0025).abs() < 1e-9);
    assert_eq!(flight.outputs.values()[7].map(|u| (10.0 * u).round()), [4.0, 5.0, 6.0, 7.0]);
    assert_eq!((flight.motor_unit, flight.motor_source), {
        (MotorUnit::ThrustFraction, MotorSource::ActuatorMotors)
    });
    let rpm = flight.rotor_speed.values()[0].map(|w| (w * 60.0 / std::f64::consts::TAU).round());
    assert_eq!(rpm, [200.0, 100.0, 300.0, 400.0]);
    assert!(!flight.in_air.values()[0] && flight.in_air.values()[19]);
    assert!((flight.voltage.values()[3] - 15.5).abs() < 1e-6);
    assert_eq!((flight.facts.autopilot.as_deref(), flight.facts.motors), (Some("PX4"), Some(4)));
}

#[test]
fn dataflash_log_imports_as_a_flight() {
    let flight = import("dataflash", "flight.log", &dataflash(4.0).bytes);
    assert_eq!(flight.origin.format, "dataflash");
    assert_eq!(flight.left_out, [("IMU: of instance 1, where 0 is used".to_owned(), 400)]);
    assert_eq!((flight.attitude.len(), flight.body_rate.len()), (200, 400));
    let roll = flight.attitude.values()[100].euler().roll;
    assert!((roll - 0.3 * 2_f64.sin()).abs() < 1e-4, "{roll}");
    assert_eq!(flight.position.values()[9], Ned::new(1.0, 2.0, -3.0));
    // Motors are assigned by output functions and scaled to the range in the parameters.
    let outputs = flight.outputs.values()[0].map(|u| (100.0 * u).round());
    assert_eq!(outputs, [25.0, 50.0, 75.0, 100.0]);
    assert_eq!((flight.motor_unit, flight.motor_source), {
        (MotorUnit::ThrustFraction, MotorSource::Rcou)
    });
    let rpm = flight.rotor_speed.values()[0].map(|w| (w * 60.0 / std::f64::consts::TAU).round());
    assert_eq!(rpm, [4000.0, 3000.0, 2000.0, 1000.0]);
    assert_eq!(flight.in_air.values(), [true]);
    assert_eq!(flight.facts.frame.as_deref(), Some("QUAD/X"));
    let spins: Vec<i8> = flight.facts.rotors.iter().map(|rotor| rotor.spin).collect();
    assert_eq!(spins, [1, 1, -1, -1]);
    assert!(flight.facts.notes.iter().any(|note| note.contains("10 Hz")), "{:?}", flight.facts);
}

#[test]
fn imported_log_round_trips_through_mcap_with_its_facts() {
    for (name, bytes) in [("px4", ulog(2.0).bytes), ("copter", dataflash(2.0).bytes)] {
        let flight = import("again", name, &bytes);
        let path = place("again", &format!("{name}.mcap"));
        write(&flight, &path).expect("a log");
        let back = open(&path, None).expect("a flight");
        assert_eq!((&back.facts, &back.left_out), (&flight.facts, &flight.left_out));
        assert_eq!(back.setpoint_source, flight.setpoint_source);
        assert_eq!((back.motor_unit, back.motor_source), (flight.motor_unit, flight.motor_source));
        assert_eq!(back.attitude, flight.attitude);
    }
}

#[test]
fn older_ulog_layouts_are_read() {
    let mut log = Ulog::new();
    log.format("vehicle_attitude:uint64_t timestamp;float rollspeed;float pitchspeed;float yawspeed;float[4] q;");
    log.format("actuator_outputs:uint64_t timestamp;uint32_t noutputs;float[16] output;");
    log.format("vehicle_attitude_setpoint:uint64_t timestamp;float roll_body;float pitch_body;float yaw_body;float[3] thrust_body;");
    log.parameter("PWM_MIN", 1000.0);
    log.parameter("PWM_MAX", 2000.0);
    let attitude = log.subscribe("vehicle_attitude", 0);
    let outputs = log.subscribe("actuator_outputs", 0);
    let setpoint = log.subscribe("vehicle_attitude_setpoint", 0);
    for step in 0..50_u64 {
        let us = 10_000 * (step + 1);
        log.row(attitude, us, &floats(&[0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]));
        let mut pulses = [0.0; 16];
        pulses[..4].copy_from_slice(&[1100.0, 1200.0, 1300.0, 900.0]);
        log.row(outputs, us, &[&16_u32.to_le_bytes()[..], &floats(&pulses)].concat());
        log.row(setpoint, us, &floats(&[0.1, 0.0, 0.0, 0.0, 0.0, -0.6]));
    }
    let flight = import("old", "flight.ulg", &log.bytes);
    assert_eq!(flight.left_out, []);
    assert_eq!(
        flight.body_rate.values()[3].to_array().map(|w| (10.0 * w).round()),
        [1.0, 2.0, 3.0]
    );
    assert_eq!(flight.outputs.values()[3].map(|u| (100.0 * u).round()), [10.0, 20.0, 30.0, 0.0]);
    assert_eq!(flight.motor_unit, MotorUnit::ThrustFraction);
    let asked = flight.setpoint.values()[3];
    assert!((asked.attitude.expect("an attitude").euler().roll - 0.1).abs() < 1e-6);
    assert!((asked.thrust.expect("a thrust") - 0.6).abs() < 1e-6);
    assert_eq!(flight.setpoint_source, SetpointSource::Onboard);
}

#[test]
fn pulses_without_a_stated_range_are_not_normalised() {
    let mut log = Ulog::new();
    log.format("actuator_outputs:uint64_t timestamp;float[16] output;");
    let outputs = log.subscribe("actuator_outputs", 0);
    for step in 0..50_u64 {
        log.row(outputs, 10_000 * step, &floats(&[1500.0; 16]));
    }
    let flight = import("pulses", "flight.ulg", &log.bytes);
    assert_eq!(flight.motor_unit, MotorUnit::VehicleFile);
    assert_eq!(flight.outputs.values()[0], [1500.0; 4]);
    assert!(flight.facts.notes.iter().any(|note| note.contains("which motor")));
}

#[test]
fn dataflash_log_from_before_2016_imports_as_a_flight() {
    let flight = import("timems", "flight.bin", &old_dataflash(4.0).bytes);
    assert_eq!(flight.left_out, []);
    assert_eq!(
        (flight.attitude.len(), flight.body_rate.len(), flight.position.len()),
        (200, 200, 200)
    );
    // Stamps in ms.
    assert!((flight.attitude.times()[1] - 10.02).abs() < 1e-9);
    assert!((flight.attitude.values()[100].euler().roll - 0.3 * 2_f64.sin()).abs() < 1e-4);
    assert_eq!(flight.position.values()[9], Ned::new(1.0, 2.0, -3.0));
    // Scaled to the range of the throttle channel, because nothing else is stated.
    let outputs = flight.outputs.values()[3].map(|u| (100.0 * u).round());
    assert_eq!(
        (outputs, flight.motor_unit),
        ([25.0, 50.0, 75.0, 100.0], MotorUnit::ThrustFraction)
    );
    assert!((flight.voltage.values()[0] - 12.34).abs() < 1e-9);
    let taken = flight.facts.notes.iter().find(|note| note.contains("motors 1 to 4"));
    assert!(taken.is_some_and(|note| note.contains("no SERVOn_FUNCTION")), "{:?}", flight.facts);
    assert_eq!(flight.facts.stated_otherwise(), None);
}

#[test]
fn px4_log_from_before_ulog_is_identified_in_the_refusal() {
    let mut log = DataFlash::new();
    log.define(129, "TIME", "Q", "StartTime");
    log.define(2, "ATT", "fff", "Roll,Pitch,Yaw");
    for step in 0..100_u64 {
        log.message(129, &(step * 4000).to_le_bytes());
        log.message(2, &floats(&[0.1, 0.2, 0.3]));
    }
    for name in ["flight.px4log", "flight.bin"] {
        let path = place("sdlog2", name);
        fs::write(&path, &log.bytes).expect("a file");
        let error = open(&path, None).expect_err("not read").to_string();
        assert!(error.contains("PX4 before ULog") && error.contains(name), "{error}");
    }
}

#[test]
fn refusal_of_unknown_log_lists_its_topics() {
    let mut log = DataFlash::new();
    log.define(2, "CTUN", "f", "ThrIn");
    log.define(3, "WIND", "Qf", "TimeUS,Speed");
    for step in 0..100_u64 {
        log.message(2, &floats(&[0.1]));
        log.message(3, &[&step.to_le_bytes()[..], &floats(&[0.1])].concat());
    }
    let mut other = Ulog::new();
    other.format("cpuload:uint64_t timestamp;float load;");
    let load = other.subscribe("cpuload", 0);
    (0..50_u64).for_each(|step| other.row(load, 1000 * step, &floats(&[0.5])));
    for (name, bytes, said) in [
        ("flight.bin", &log.bytes, "it has CTUN (without a time), WIND"),
        ("flight.ulg", &other.bytes, "it has cpuload"),
    ] {
        let path = place("unknown", name);
        fs::write(&path, bytes).expect("a file");
        let error = open(&path, None).expect_err("nothing").to_string();
        assert!(error.contains(said) && error.contains(name), "{error}");
    }
}

#[test]
fn non_multirotor_is_recognised_in_every_log_kind() {
    let kind = |flight: &Flight| flight.facts.stated_otherwise().map(|stated| stated.kind);
    // ArduPilot: from the firmware alone, and from the output functions alone.
    let mut named = dataflash(1.0).bytes;
    let copter = b"ArduCopter V4.5.0";
    let at = named.windows(copter.len()).position(|bytes| bytes == copter).expect("the firmware");
    named[at..at + copter.len()].copy_from_slice(b"ArduPlane V4.5.0\0");
    assert_eq!(kind(&import("kinds", "named.bin", &named)), Some(VehicleKind::FixedWing));
    let mut stated = dataflash(1.0);
    for (name, value) in [
        ("SERVO1_FUNCTION", 4.0),
        ("SERVO2_FUNCTION", 19.0),
        ("SERVO3_FUNCTION", 70.0),
        ("SERVO4_FUNCTION", 21.0),
    ] {
        stated.parameter(name, value);
    }
    let flight = import("kinds", "stated.bin", &stated.bytes);
    assert_eq!(kind(&flight), Some(VehicleKind::FixedWing));
    assert!(flight.outputs.is_empty());
    assert!(flight.facts.notes.iter().any(|note| note.contains("no output of motor 1, 2, 3, 4")));
    let mut hovering = dataflash(1.0);
    hovering.parameter("SERVO5_FUNCTION", 77.0);
    assert_eq!(kind(&import("kinds", "hovering.bin", &hovering.bytes)), Some(VehicleKind::Vtol));
    assert_eq!(kind(&import("kinds", "copter.bin", &dataflash(1.0).bytes)), None);

    // From the frame in its messages.
    for (name, expected, motors) in [
        (b"HEXA/X", None, Some(6)),
        (b"OCTA/X", None, Some(8)),
        (b"HELI\0\0", Some(VehicleKind::Helicopter), None),
    ] {
        let mut framed = dataflash(1.0).bytes;
        let frame = b"Frame: QUAD/X";
        let at = framed.windows(frame.len()).position(|bytes| bytes == frame).expect("the frame");
        framed[at + 7..at + 13].copy_from_slice(name);
        // Older builds have no such parameter.
        let class = b"FRAME_CLASS";
        let at = framed.windows(class.len()).position(|bytes| bytes == class).expect("a parameter");
        framed[at] = b'_';
        let flight = import("kinds", "framed.bin", &framed);
        assert_eq!(kind(&flight), expected);
        if motors.is_some() {
            assert_eq!(flight.facts.motors, motors);
        }
    }

    // PX4: from parameters, and from its reported state.
    for (name, value, expected) in [
        ("CA_AIRFRAME", 1, Some(VehicleKind::FixedWing)),
        ("CA_AIRFRAME", 3, Some(VehicleKind::Vtol)),
        ("MAV_TYPE", 10, Some(VehicleKind::Rover)),
        ("MAV_TYPE", 12, Some(VehicleKind::Submarine)),
        ("SYS_AUTOSTART", 13006, Some(VehicleKind::Vtol)),
        ("MAV_TYPE", 2, None),
    ] {
        let mut log = ulog(1.0);
        log.whole_parameter(name, value);
        assert_eq!(kind(&import("kinds", "flight.ulg", &log.bytes)), expected, "{name} {value}");
    }
    for (field, value, expected) in [
        ("vehicle_type", 2, Some(VehicleKind::FixedWing)),
        ("vehicle_type", 1, None),
        ("is_vtol", 1, Some(VehicleKind::Vtol)),
        ("system_type", 1, Some(VehicleKind::FixedWing)),
        ("is_rotary_wing", 0, Some(VehicleKind::Other)),
        ("is_rotary_wing", 1, None),
    ] {
        let mut log = ulog(1.0);
        log.format(&format!("vehicle_status:uint64_t timestamp;uint8_t {field};"));
        let status = log.subscribe("vehicle_status", 0);
        (0..10).for_each(|k| log.row(status, 1_000_000 + 100_000 * k, &[value]));
        assert_eq!(kind(&import("kinds", "flight.ulg", &log.bytes)), expected, "{field} {value}");
    }
    let mut six = ulog(1.0);
    six.whole_parameter("CA_ROTOR_COUNT", 6);
    assert_eq!(import("kinds", "six.ulg", &six.bytes).facts.motors, Some(6));
}

/// Pulses near 1500 us on four outputs from `first` on, all moving.
fn hovering(step: usize) -> [f32; 16] {
    let move_by = |i: usize| 20.0 * ((step * (i + 3)) as f32 * 0.1).sin();
    std::array::from_fn(|i| if i < 4 { 1500.0 + move_by(i) } else { 900.0 })
}

/// A gimbal moves on the first output; the others are constant.
fn gimbal(step: usize) -> [f32; 16] {
    std::array::from_fn(|i| match i {
        0 => 1500.0 + 80.0 * (step as f32 * 0.03).sin(),
        1..4 => 1500.0,
        _ => 900.0,
    })
}

/// What PX4 outputs without motors: disarmed, then armed.
fn idle(step: usize) -> [f32; 16] {
    std::array::from_fn(|i| if i < 8 { if step < 50 { 900.0 } else { 1000.0 } } else { 0.0 })
}

/// Commands to motor controllers on CAN.
fn can(step: usize) -> [f32; 16] {
    std::array::from_fn(|i| {
        if i < 4 { 4096.0 + 100.0 * ((step * (i + 2)) as f32 * 0.1).sin() } else { 0.0 }
    })
}

#[test]
fn motors_are_read_from_the_device_that_drives_them() {
    let mut functions: Vec<(String, i32)> = Vec::new();
    for n in 1..=8 {
        functions.push((format!("PWM_MAIN_FUNC{n}"), 0));
        functions.push((format!("PWM_AUX_FUNC{n}"), if n <= 4 { 100 + n } else { 0 }));
        functions.push((format!("PWM_AUX_MIN{n}"), 1100));
        functions.push((format!("PWM_AUX_MAX{n}"), 1900));
    }
    let functions: Vec<(&str, i32)> = functions.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let expected = hovering(100).map(|pulse| (f64::from(pulse) - 1100.0) / 800.0);
    for (name, instances, instance) in [
        ("second.ulg", [(8, &gimbal as &dyn Fn(usize) -> [f32; 16]), (8, &hovering as _)], 1),
        ("first.ulg", [(8, &hovering as _), (8, &gimbal as _)], 0),
    ] {
        let flight = import("devices", name, &px4_outputs(&functions, &instances).bytes);
        assert_eq!(flight.motor_unit, MotorUnit::ThrustFraction);
        for (found, expected) in flight.outputs.values()[100].iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{name}");
        }
        let said = format!(
            "outputs 1, 2, 3, 4 of actuator_outputs, instance {instance}, by PWM_AUX_FUNCn"
        );
        assert!(
            flight.facts.notes.iter().any(|note| note.contains(&said)),
            "{:?}",
            flight.facts.notes
        );
    }
    // Motors in another order, and none on the first outputs.
    let order = [
        ("PWM_MAIN_FUNC5", 102),
        ("PWM_MAIN_FUNC6", 101),
        ("PWM_MAIN_FUNC7", 104),
        ("PWM_MAIN_FUNC8", 103),
    ];
    let last = |step: usize| {
        let first = hovering(step);
        std::array::from_fn(|i| if (4..8).contains(&i) { first[i - 4] } else { 1500.0 })
    };
    let flight = import("devices", "last.ulg", &px4_outputs(&order, &[(8, &last)]).bytes);
    let [a, b, c, d, ..] = hovering(77).map(f64::from);
    assert_eq!(
        (flight.outputs.values()[77], flight.motor_unit),
        ([b, a, d, c].map(|pulse| (pulse - 1000.0) / 1000.0), MotorUnit::ThrustFraction)
    );
}

#[test]
fn motors_on_can_of_older_px4_are_found() {
    let parameters = [("MAV_TYPE", 2), ("PWM_MIN", 1000), ("PWM_MAX", 2000), ("UAVCAN_ENABLE", 3)];
    let flight =
        import("can", "flight.ulg", &px4_outputs(&parameters, &[(8, &idle), (4, &can)]).bytes);
    let expected = f64::from(can(60)[2]) / 8191.0;
    assert!((flight.outputs.values()[60][2] - expected).abs() < 1e-6);
    let note = |words: &str| flight.facts.notes.iter().any(|note| note.contains(words));
    assert!(note("instance 1, as no parameter") && note("over CAN"), "{:?}", flight.facts.notes);
    // Stated: a device identified by its parameters alone.
    let stated: Vec<(String, i32)> =
        (1..=4).map(|n| (format!("UAVCAN_EC_FUNC{n}"), 105 - n)).collect();
    let stated: Vec<(&str, i32)> = stated.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let flight = import("can", "stated.ulg", &px4_outputs(&stated, &[(8, &idle), (4, &can)]).bytes);
    assert!((flight.outputs.values()[60][0] - f64::from(can(60)[3]) / 8191.0).abs() < 1e-6);
}

#[test]
fn outputs_that_drive_no_motor_are_dropped() {
    let wing = [("PWM_MAIN_FUNC1", 201), ("PWM_MAIN_FUNC2", 202)];
    let flight = import("none", "flight.ulg", &px4_outputs(&wing, &[(8, &hovering)]).bytes);
    assert!(flight.outputs.is_empty());
    assert!(flight.facts.notes.iter().any(|note| note.contains("no motor outputs")));
}

#[test]
fn oldest_ulog_layouts_are_read() {
    let mut log = Ulog::new();
    log.format(
        "vehicle_attitude:uint64_t timestamp;float rollspeed;float pitchspeed;float yawspeed;float roll;float pitch;float yaw;",
    );
    log.format("sensor_combined:uint64_t timestamp;float[9] gyro_rad_s;float gyro_integral_dt;float[3] accelerometer_m_s2;");
    log.format("vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;");
    let attitude = log.subscribe("vehicle_attitude", 0);
    let sensors = log.subscribe("sensor_combined", 0);
    let position = log.subscribe("vehicle_local_position", 0);
    for step in 0..50_u64 {
        let us = 1_000_000 + 4000 * step;
        log.row(attitude, us, &floats(&[0.0, 0.0, 0.0, 0.1, 0.2, 0.3]));
        let mut rates = [0.0; 9];
        rates[..3].copy_from_slice(&[0.1, 0.2, 0.3]);
        log.row(sensors, us, &floats(&[&rates[..], &[0.004], &[0.0, 0.0, -9.8]].concat()));
        log.row(position, us, &floats(&[1.0, 2.0, -3.0, 0.0, 0.0, 0.0]));
    }
    let flight = import("oldest", "flight.ulg", &log.bytes);
    assert_eq!(flight.left_out, []);
    let angles = flight.attitude.values()[3].euler();
    assert!((angles.roll - 0.1).abs() < 1e-6 && (angles.yaw - 0.3).abs() < 1e-6);
    assert!((flight.body_rate.values()[3].to_array()[1] - 0.2).abs() < 1e-6);
    // The interval is in s, and the sample lies in its middle.
    assert!((flight.body_rate.times()[0] - 0.998).abs() < 1e-6);
    assert_eq!(flight.position.len(), 50);
}

/// PX4 of 2016: the topic has a quaternion that is not filled in, and the first of two batteries is
/// not connected.
#[test]
fn a_quaternion_that_is_not_filled_in_gives_way_to_the_angles() {
    let mut log = Ulog::new();
    log.format("vehicle_attitude:uint64_t timestamp;float roll;float pitch;float yaw;float[4] q;");
    log.format("battery_status:uint64_t timestamp;float voltage_v;bool connected;");
    let attitude = log.subscribe("vehicle_attitude", 0);
    let first = log.subscribe("battery_status", 0);
    let second = log.subscribe("battery_status", 1);
    for step in 0..50_u64 {
        let us = 1_000_000 + 4000 * step;
        log.row(attitude, us, &floats(&[0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 0.0]));
        log.row(first, us, &[&floats(&[0.0])[..], &[0]].concat());
        log.row(second, us, &[&floats(&[15.0])[..], &[1]].concat());
    }
    let flight = import("unfilled", "flight.ulg", &log.bytes);
    assert_eq!(flight.attitude.len(), 50);
    let angles = flight.attitude.values()[3].euler();
    assert!((angles.pitch - 0.2).abs() < 1e-6 && (angles.yaw - 0.3).abs() < 1e-6);
    assert_eq!((flight.voltage.len(), flight.voltage.values()[0]), (50, 15.0));
}

/// Each sample has the signal of the parameter's value at its time.
#[test]
fn a_parameter_that_is_tuned_in_flight_acts_from_then_on() {
    let mut log = Ulog::new();
    log.format("vehicle_attitude:uint64_t timestamp;float[4] q;");
    log.format("actuator_motors:uint64_t timestamp;float[12] control;");
    log.parameter("THR_MDL_FAC", 0.0);
    let attitude = log.subscribe("vehicle_attitude", 0);
    let motors = log.subscribe("actuator_motors", 0);
    for step in 0..90_u64 {
        let us = 1_000_000 + 4000 * step;
        if step == 30 {
            log.parameter("THR_MDL_FAC", 1.0);
        } else if step == 60 {
            log.parameter("THR_MDL_FAC", 0.0);
        }
        log.row(attitude, us, &floats(&[1.0, 0.0, 0.0, 0.0]));
        log.row(motors, us, &floats(&[0.25; 12]));
    }
    let flight = import("tuned", "flight.ulg", &log.bytes);
    let outputs: Vec<f64> = flight.outputs.values().iter().map(|u| u[0]).collect();
    assert_eq!([outputs[29], outputs[30], outputs[59], outputs[60]], [0.25, 0.5, 0.5, 0.25]);
}

/// The controllers of the motors need not be the first four.
#[test]
fn rotor_speeds_are_of_the_controllers_that_drive_the_motors() {
    let mut log = Ulog::new();
    log.format("vehicle_attitude:uint64_t timestamp;float[4] q;");
    log.format("esc_report:uint64_t timestamp;int32_t esc_rpm;uint8_t actuator_function;");
    log.format("esc_status:uint64_t timestamp;uint8_t esc_count;esc_report[8] esc;");
    let attitude = log.subscribe("vehicle_attitude", 0);
    let esc = log.subscribe("esc_status", 0);
    for step in 0..50_u64 {
        let us = 1_000_000 + 4000 * step;
        log.row(attitude, us, &floats(&[1.0, 0.0, 0.0, 0.0]));
        let report = |at: u8| {
            let (rpm, function) = if at < 4 { (0, 0) } else { (1000 * i32::from(at), 108 - at) };
            [&us.to_le_bytes()[..], &i32::to_le_bytes(rpm), &[function]].concat()
        };
        let reports: Vec<u8> = (0..8).flat_map(report).collect();
        log.row(esc, us, &[&[4][..], &reports].concat());
    }
    let flight = import("controllers", "flight.ulg", &log.bytes);
    let rpm = flight.rotor_speed.values()[3].map(|w| (w * 60.0 / std::f64::consts::TAU).round());
    assert_eq!(rpm, [7000.0, 6000.0, 5000.0, 4000.0]);
}

/// Samples of two boots on overlapping clocks are never spliced into one flight.
#[test]
fn of_two_boots_in_one_log_one_is_read() {
    let path = place("boots", "flight.log");
    for (format, log) in [
        ("dataflash", [dataflash(8.0).bytes, dataflash(12.0).bytes].concat()),
        ("ulog", [ulog(8.0).bytes, ulog(12.0).bytes].concat()),
    ] {
        fs::write(&path, log).expect("a file");
        let chosen = |boot| open_chosen(&path, Choice { mapping: None, boot });
        let length = |flight: &Flight| {
            let times = flight.attitude.times();
            (times[times.len() - 1] - times[0]).round()
        };
        let flight = chosen(None).expect("a flight");
        assert_eq!((flight.origin.format, length(&flight)), (format, 12.0));
        assert_eq!(left_out(&flight, "out of order"), 0, "{:?}", flight.left_out);
        assert!(left_out(&flight, "another boot") > 1000, "{:?}", flight.left_out);
        let notes = flight.facts.notes.join("; ");
        assert!(
            notes.contains("boot 1 of 2 (--boot 1)") && notes.contains("flown, used"),
            "{notes}"
        );
        assert_eq!(length(&chosen(Some(1)).expect("a boot")), 8.0);
        let error = chosen(Some(3)).expect_err("no such boot").to_string();
        assert!(error.contains("from 1 to 2 (--boot), found 3"), "{error}");
    }
}

/// A damaged type byte turns a data row into a flag message, whose bits would forbid reading the
/// file.
#[test]
fn flag_message_amid_a_ulog_is_treated_as_damage() {
    let whole = survives(&ULOG).expect("a flight").body_rate.len();
    let rows = (ULOG.len() / 5..ULOG.len()).filter(|at| ULOG[*at] == b'D').step_by(7);
    for at in rows {
        let mut log = ULOG.clone();
        log[at] = b'B';
        let left = survives(&log).expect("a flight").body_rate.len();
        assert!(left + 6 >= whole, "{left} of {whole}, byte {at}");
    }
}

#[test]
fn data_appended_after_a_crash_is_read() {
    let mut log = ulog(1.0);
    let cut = log.bytes.len() - 11;
    let rest = ulog(1.5).bytes;
    // The first part ends within a message; the appended data begin at the stated offset.
    let whole = log.bytes.len();
    log.bytes.truncate(cut);
    log.bytes.extend(&rest[whole..]);
    let flags = 16 + 3;
    log.bytes[flags + 8] = 1;
    log.bytes[flags + 16..flags + 24].copy_from_slice(&(cut as u64).to_le_bytes());
    let flight = import("appended", "flight.ulg", &log.bytes);
    let all = import("appended", "whole.ulg", &rest);
    assert!(flight.body_rate.len() + 2 >= all.body_rate.len(), "{}", flight.body_rate.len());
    assert!(left_out(&flight, "byte") < 80, "{:?}", flight.left_out);
}

#[test]
fn newer_incompatible_ulog_is_refused_by_name() {
    let mut bytes = ulog(0.1).bytes;
    bytes[16 + 3 + 8] = 2;
    let path = place("newer", "flight.ulg");
    fs::write(&path, &bytes).expect("a file");
    let error = open(&path, None).expect_err("not read").to_string();
    assert!(error.contains("newer kind") && error.contains("flight.ulg"), "{error}");
}

static ULOG: LazyLock<Vec<u8>> = LazyLock::new(|| ulog(1.0).bytes);
static DATAFLASH: LazyLock<Vec<u8>> = LazyLock::new(|| dataflash(1.0).bytes);

/// Reads bytes as any kind of log and checks that the streams are sound.
fn survives(bytes: &[u8]) -> Option<Flight> {
    let flights = read_bytes(bytes, "");
    for flight in &flights {
        assert_sound(&flight.attitude);
        assert_sound(&flight.body_rate);
        assert_sound(&flight.specific_force);
        assert_sound(&flight.position);
        assert_sound(&flight.outputs);
        assert_sound(&flight.rotor_speed);
        assert_sound(&flight.setpoint);
        assert_sound(&flight.voltage);
        assert_sound(&flight.in_air);
    }
    flights.into_iter().max_by_key(|flight| flight.body_rate.len())
}

#[test]
fn truncated_logs_are_read_up_to_the_cut() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        let whole = survives(bytes).expect("a flight").body_rate.len();
        let mut before = 0;
        for length in (0..bytes.len()).step_by(37) {
            let Some(flight) = survives(&bytes[..length]) else { continue };
            let samples = flight.body_rate.len();
            assert!(samples + 1 >= before && samples <= whole, "{length}");
            before = samples;
        }
        assert!(before + 3 >= whole);
    }
}

#[test]
fn truncated_or_damaged_log_reports_where() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        assert_eq!(survives(bytes).expect("a flight").losses, Vec::<String>::new());
        // Some of these lengths end between two messages, which looks like a complete log.
        let losses = (1..20).map(|short| {
            survives(&bytes[..bytes.len() - short]).expect("a flight").losses.join(" ")
        });
        let said = losses.filter(|loss| loss.contains("it was cut short")).count();
        assert!(said >= 10, "{said} of 19");
        let middle = bytes.len() / 2;
        let damaged = [&bytes[..middle], &bytes[middle + 333..]].concat();
        let loss = survives(&damaged).expect("a flight").losses.join(" ");
        assert!(loss.contains("belong to no message"), "{loss}");
    }
}

#[test]
fn removed_bytes_lose_only_their_own_messages() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        let whole = survives(bytes).expect("a flight").body_rate.len();
        let middle = bytes.len() / 2;
        for length in [1, 2, 3, 5, 50, 333] {
            let damaged = [&bytes[..middle], &bytes[middle + length..]].concat();
            let flight = survives(&damaged).expect("a flight");
            let lost = whole - flight.body_rate.len();
            assert!(lost <= 4 + length / 20, "{lost} of {length} bytes");
            assert!(left_out(&flight, "") > 0);
            let foreign = [&bytes[..middle], &vec![0x41; length][..], &bytes[middle..]].concat();
            let flight = survives(&foreign).expect("a flight");
            assert!(whole - flight.body_rate.len() <= 3, "{length} foreign bytes");
            assert!(left_out(&flight, "byte") + left_out(&flight, "damaged") > 0);
        }
    }
}

/// The high byte of a length: some values point to the start of another message.
#[test]
fn damaged_length_loses_no_later_message() {
    let whole = survives(&ULOG).expect("a flight").body_rate.len();
    let middle = ULOG.len() / 2;
    let head = |at: &usize| ULOG[*at..].starts_with(&[46, 0, b'D', 1, 0]);
    let at = (middle..ULOG.len()).find(head).expect("a row of sensor_combined");
    for high in 1..=u8::MAX {
        let mut log = ULOG.clone();
        log[at + 1] = high;
        let left = survives(&log).expect("a flight").body_rate.len();
        assert!(left + 4 >= whole, "{left} of {whole} with {high}");
    }
}

proptest! {
    #[test]
    fn damaged_onboard_log_never_panics_the_reader(
        is_ulog in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..40),
        length in any::<prop::sample::Index>(),
    ) {
        let mut log = if is_ulog { ULOG.clone() } else { DATAFLASH.clone() };
        for (at, byte) in changes {
            let at = at.index(log.len());
            log[at] = byte;
        }
        log.truncate(length.index(log.len()) + 1);
        survives(&log);
    }

    #[test]
    fn few_damaged_bytes_lose_few_samples(
        is_ulog in any::<bool>(),
        // Only after the definitions, on which everything else depends.
        changes in prop::collection::vec((0.2..1.0, any::<u8>()), 1..6),
    ) {
        let sound = if is_ulog { &*ULOG } else { &*DATAFLASH };
        let mut log = sound.clone();
        for (at, byte) in &changes {
            let at = (at * log.len() as f64) as usize;
            log[at] = *byte;
        }
        let whole = survives(sound).expect("a flight").body_rate.len();
        let left = survives(&log).expect("a flight").body_rate.len();
        prop_assert!(left + 6 * changes.len() >= whole, "{left} of {whole}");
    }

    #[test]
    fn arbitrary_bytes_after_the_magic_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        survives(&[&Ulog::new().bytes[..], &bytes].concat());
        survives(&[&DataFlash::new().bytes[..], &bytes].concat());
    }
}

/// The vehicle's own log, telemetry of the same flight, and the vehicle file.
fn practice() -> Vec<(PathBuf, PathBuf, VehicleParams)> {
    let folder = match std::env::var_os("DOWNWASH_PRACTICE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/practice-autopilot"),
    };
    let mut found = Vec::new();
    for case in fs::read_dir(folder).into_iter().flatten().flatten() {
        for file in fs::read_dir(case.path()).into_iter().flatten().flatten() {
            let path = file.path();
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
            let tlog = path.with_extension("tlog");
            if ["ulg", "BIN"].contains(&extension) && tlog.exists() {
                let vehicle = VehicleParams::load(case.path().join("vehicle.json"));
                found.push((path, tlog, vehicle.expect("a vehicle")));
            }
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

/// The delay of `b` relative to `a` with the smallest difference, and that difference as RMS per
/// component.
fn apart<T>(
    a: &Stream<T>,
    b: &Stream<T>,
    flying: std::ops::Range<f64>,
    difference: impl Fn(&T, &T, &T, f64) -> f64,
) -> (f64, f64) {
    let mut best = (0.0, f64::INFINITY);
    for step in -30..=30 {
        let delay = 1e-3 * f64::from(step);
        let (mut sum, mut count) = (0.0, 0.0);
        for (time, value) in a.iter().filter(|(time, _)| flying.contains(time)) {
            let Some(at) = b.index_at(time + delay) else { continue };
            let (Some(before), Some(after)) = (b.values().get(at), b.values().get(at + 1)) else {
                continue;
            };
            let share = (time + delay - b.times()[at]) / (b.times()[at + 1] - b.times()[at]);
            sum += difference(value, before, after, share).powi(2);
            count += 1.0;
        }
        let error = (sum / count).sqrt();
        if error < best.1 {
            best = (delay, error);
        }
    }
    best
}

#[test]
fn onboard_practice_logs_agree_with_their_telemetry() {
    let practice = practice();
    if practice.is_empty() {
        eprintln!(
            "skipped: no practice flights of autopilots; set DOWNWASH_PRACTICE to their folder"
        );
        return;
    }
    for (own, tlog, vehicle) in practice {
        let name = own.display();
        let own = open(&own, None).expect("the vehicle's log");
        let mut telemetry = open(&tlog, None).expect("telemetry");
        telemetry.normalise_outputs(&vehicle).expect("a unit");
        assert_eq!(own.motor_unit, MotorUnit::ThrustFraction, "{name}");
        assert_eq!(left_out(&own, "byte") + left_out(&own, "order"), 0, "{:?}", own.left_out);
        let flying = {
            let times = telemetry.setpoint.times();
            times[0] + 3.0..times[times.len() - 1] - 1.0
        };
        let mix = |a: f64, b: f64, share: f64| a + share * (b - a);
        let ned =
            |value: &Ned, a: &Ned, b: &Ned, share: f64| (*value - (*a + (*b - *a) * share)).norm();
        let frd =
            |value: &Frd, a: &Frd, b: &Frd, share: f64| (*value - (*a + (*b - *a) * share)).norm();
        let turn = |value: &Attitude, a: &Attitude, b: &Attitude, share: f64| {
            value.angle_to(if share < 0.5 { *a } else { *b }) - a.angle_to(*b) * 0.25
        };
        let outputs = |value: &[f64; 4], a: &[f64; 4], b: &[f64; 4], share: f64| {
            let error = (0..4).map(|i| (value[i] - mix(a[i], b[i], share)).powi(2)).sum::<f64>();
            (0.25 * error).sqrt()
        };
        let found = [
            apart(&own.position, &telemetry.position, flying.clone(), ned),
            apart(&own.velocity, &telemetry.velocity, flying.clone(), ned),
            apart(&own.attitude, &telemetry.attitude, flying.clone(), turn),
            apart(&own.body_rate, &telemetry.body_rate, flying.clone(), frd),
            apart(&own.outputs, &telemetry.outputs, flying.clone(), outputs),
        ];
        println!(
            "{name}: delay in s and difference of position, velocity, attitude, rate, outputs: {found:.4?}"
        );
        // Both logs are decimated, so fast changes between two samples show as differences.
        let most = [0.02, 0.03, 0.01, 0.12, 0.03];
        for ((delay, error), most) in found.into_iter().zip(most) {
            assert!(error < most && delay.abs() < 0.012, "{name}: {found:?}");
        }
    }
}
