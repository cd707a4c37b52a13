//! Which outputs and rotor speeds of an on-board log are the motors'.

use crate::onboard_import::import;

use crate::onboard_log::{DataFlash, Ulog, floats, px4_outputs};
use downwash_log::import::MotorUnit;

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

/// Before ArduPilot 4.1 each motor controller had its own message, before 3.6 with tens of rpm in 16
/// bits, and before 3.3 with stamps in ms.
#[test]
fn rotor_speeds_are_read_from_one_message_for_each_controller() {
    const NEWER: (&str, &str) = ("QeCCcH", "TimeUS,RPM,Volt,Curr,Temp,CTot");
    const OLDER: (&str, &str) = ("Qcccc", "TimeUS,RPM,Volt,Curr,Temp");
    const OLDEST: (&str, &str) = ("Icccc", "TimeMS,RPM,Volt,Curr,Temp");
    for (format, columns) in [NEWER, OLDER, OLDEST] {
        let mut log = DataFlash::new();
        log.define(2, "PARM", "QNf", "TimeUS,Name,Value");
        log.define(10, "ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw");
        (1..=8).for_each(|n: u8| log.define(20 + n, &format!("ESC{n}"), format, columns));
        for (output, function) in [(1, 36.0), (2, 35.0), (3, 34.0), (4, 33.0)] {
            log.parameter(&format!("SERVO{output}_FUNCTION"), function);
        }
        for step in 0..20_u64 {
            let us = 5_000_000 + 100_000 * step;
            log.message(10, &[&us.to_le_bytes()[..], &[0; 6]].concat());
            for n in 1..=4_u8 {
                let stamp = match columns.starts_with("TimeUS") {
                    true => us.to_le_bytes().to_vec(),
                    false => ((us / 1000) as u32).to_le_bytes().to_vec(),
                };
                let rpm = 1000 * i32::from(n);
                let (speed, rest) = match format {
                    "QeCCcH" => ((100 * rpm).to_le_bytes().to_vec(), 8),
                    _ => (((rpm / 10) as i16).to_le_bytes().to_vec(), 6),
                };
                log.message(20 + n, &[stamp, speed, vec![0; rest]].concat());
            }
        }
        let flight = import("controllers", "flight.bin", &log.bytes);
        let speeds = &flight.rotor_speed;
        // A row needs a report of every controller.
        assert_eq!(speeds.len(), 19, "{columns}");
        assert!((speeds.times()[0] - 5.1).abs() < 1e-9, "{columns}");
        let rpm = speeds.values()[0].map(|w| (w * 60.0 / std::f64::consts::TAU).round());
        assert_eq!(rpm, [4000.0, 3000.0, 2000.0, 1000.0], "{columns}");
    }
}
