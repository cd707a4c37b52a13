//! What the import reads from the messages of a telemetry log: boots, sensors, vehicle type, motors.

use std::fs;

use crate::import_support::{import, left_out, place, write_tlog};
use crate::lockstep;
use downwash::log::import::{Choice, Flight, VehicleKind, open, open_chosen, write};
use wire::Encoder;
use wire::dialect::*;

/// Builds a telemetry log of one vehicle, message by message, with its ground and vehicle clocks.
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

    /// Sends attitudes at 100 Hz, and calls `also` after each with its number.
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
fn longest_flight_or_the_requested_boot_is_imported() {
    let mut log = Telemetry::new();
    let quad = MavType::MAV_TYPE_QUADROTOR;
    // The first boot stays on the ground for longer than the second one flies.
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
    let chosen = |boot| open_chosen(&path, Choice { boot: Some(boot), ..Choice::default() });
    assert_eq!(span(&chosen(1).expect("a boot")), (1.0, 41.0));
    assert_eq!(span(&chosen(3).expect("a boot")), (3.0, 8.0));
    for boot in [0, 4] {
        let error = chosen(boot).expect_err("no such boot").to_string();
        assert!(error.contains(&format!("from 1 to 3 (--boot), found {boot}")), "{error}");
    }
}

#[test]
fn imu_and_voltage_are_read_from_every_message() {
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
    // The scale of another autopilot's raw values is unknown.
    let flight = recorded(px4, raw);
    assert!(flight.specific_force.is_empty());
    assert_eq!(left_out(&flight, "RAW_IMU"), 400);
}

#[test]
fn telemetry_gives_vehicle_kind_and_motor_outputs() {
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
fn telemetry_without_a_flight_lists_its_messages() {
    let mut log = Telemetry::new();
    for _ in 0..20 {
        log.heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4, false);
        log.wait(1000);
    }
    let path = write_tlog("nothing", "ground.tlog", &log.entries);
    let error = open(&path, None).expect_err("nothing").to_string();
    assert!(error.contains("ground.tlog") && error.contains("it has HEARTBEAT"), "{error}");
}

#[test]
fn output_range_follows_the_autopilots_parameters() {
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
    // PX4's simulated outputs state functions and no range.
    let flight = recorded(px4, &stated, status);
    assert_eq!(normalised(flight.clone(), &vehicle), [0.1, 0.5, 0.9, 0.0]);
    // The range survives an import.
    let copy = place("ranges", "copy.mcap");
    write(&flight, &copy).expect("a log");
    assert_eq!(normalised(import(&copy), &vehicle), [0.1, 0.5, 0.9, 0.0]);
    // The vehicle file's range takes precedence.
    let own = vehicle::MotorOutput {
        message: "ACTUATOR_OUTPUT_STATUS".to_owned(),
        fields: Vec::new(),
        zero: 900.0,
        one: 1900.0,
        disarmed: 900.0,
    };
    let with_own = vehicle::VehicleParams { motor_output: Some(own), ..vehicle.clone() };
    assert_eq!(normalised(flight, &with_own), [0.2, 0.6, 1.0, 0.0]);
    // A real PX4 states both.
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
    // Without a stated range no unit is assumed.
    let mut flight = recorded(ardupilot, &motors[..4], servos);
    let error = flight.normalise_outputs(&vehicle).expect_err("no unit").to_string();
    assert!(error.contains("MOT_PWM_*") && error.contains("motor_output"), "{error}");
}

/// What a boot reports before its first stamp is not the time of the boot before it.
#[test]
fn no_boot_flies_longer_than_it_lasts() {
    let mut log = Telemetry::new();
    for seconds in [10, 20] {
        log.vehicle_ms = 3000;
        log.heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4, true);
        log.fly(seconds, |log, step| {
            if step % 100 == 99 {
                log.heartbeat(MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4, true);
            }
        });
        log.ground_us += 60_000_000;
    }
    let flight = import(&write_tlog("lasts", "flight.tlog", &log.entries));
    let notes = flight.facts.notes.join("; ");
    assert_eq!(flight.attitude.len(), 2000 - 7, "{notes}");
    assert!(
        notes.contains("boot 1 of 2 (--boot 1): 3.00 to 12.99 s, 10.0 s of it flown;"),
        "{notes}"
    );
}

#[test]
fn a_damaged_telemetry_log_says_where() {
    let mut log = Telemetry::new();
    log.fly(5, |_, _| {});
    let mut bytes = fs::read(write_tlog("says", "flight.tlog", &log.entries)).expect("a log");
    let end = bytes.len();
    bytes.extend([0; 3000]);
    let path = write_tlog("says", "damaged.tlog", &[]);
    fs::write(&path, bytes).expect("a file");
    let losses = import(&path).losses.join(" ");
    assert!(
        losses.contains(&format!("3000 bytes belong to no whole frame, the first at byte {end}")),
        "{losses}"
    );
}
