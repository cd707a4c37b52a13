//! On-board logs of autopilots, new or old, import as flights.

use crate::onboard_import::{import, left_out, place};
use std::fs;

use crate::onboard_log::{DataFlash, Ulog, dataflash, floats, old_dataflash, ulog};
use downwash_log::import::{
    Choice, Flight, MotorSource, MotorUnit, SetpointSource, VehicleKind, open, open_chosen, write,
};
use vehicle::frame::Ned;

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

/// Samples of two boots on overlapping clocks are never spliced into one flight.
#[test]
fn of_two_boots_in_one_log_one_is_read() {
    let path = place("boots", "flight.log");
    for (format, log) in [
        ("dataflash", [dataflash(8.0).bytes, dataflash(12.0).bytes].concat()),
        ("ulog", [ulog(8.0).bytes, ulog(12.0).bytes].concat()),
    ] {
        fs::write(&path, log).expect("a file");
        let chosen = |boot| open_chosen(&path, Choice { boot, ..Choice::default() });
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
