//! `autopilot = "arducopter"` reproduces what was measured on ArduCopter.

use crate::bench;
use crate::bench::{Bench, setpoint};
use sitl::autopilot::Mode;
use sitl::config::{Autopilot, SitlConfig};
use vehicle::frame::Euler;
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const HOVER: f32 = 0.4905;
const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;

const GUIDED: u8 = 4;
const LAND: u8 = 9;
const BRAKE: u8 = 17;

fn on_the_ground() -> Bench {
    let config = SitlConfig { autopilot: Autopilot::Arducopter, ..SitlConfig::default() };
    Bench::with(config, 1)
}

/// A careful operator's settings: direct thrust, no angle boost, a short timeout.
fn set_up(bench: &mut Bench) {
    bench.set_parameter("GUID_OPTIONS", 8.0, REAL);
    bench.set_parameter("ATC_ANGLE_BOOST", 0.0, REAL);
    bench.set_parameter("GUID_TIMEOUT", 0.2, REAL);
}

/// In GUIDED, 20 m up, with a stream of level setpoints.
fn in_guided() -> Bench {
    let mut bench = Bench::hovering(Autopilot::Arducopter);
    set_up(&mut bench);
    assert_eq!(bench.set_mode_number(GUIDED), ACCEPTED);
    bench.stream(setpoint(0.0, 0.0, HOVER, 0x07));
    bench.run(0.5);
    bench
}

fn custom_mode(bench: &mut Bench) -> Option<u32> {
    bench.received();
    bench.run(1.1);
    bench.received().into_iter().rev().find_map(|received| match received.message {
        MavMessage::HEARTBEAT(heartbeat) => Some(heartbeat.custom_mode),
        _ => None,
    })
}

fn speed(bench: &Bench) -> f64 {
    bench.vehicle.plant().state().velocity.norm()
}

#[test]
fn heartbeat_and_modes_match_arducopter() {
    let mut bench = on_the_ground();
    bench.run(1.1);
    let heartbeat = bench.received().into_iter().find_map(|received| match received.message {
        MavMessage::HEARTBEAT(heartbeat) => Some((heartbeat.autopilot, heartbeat.custom_mode)),
        _ => None,
    });
    assert_eq!(heartbeat, Some((MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, 0)));
    for number in [0, 2, 4, 5, 6, 9, 17] {
        assert_eq!(bench.set_mode_number(number), ACCEPTED);
        assert_eq!(custom_mode(&mut bench), Some(number.into()));
    }
    assert_eq!(bench.set_mode_number(99), DENIED);
}

#[test]
fn guided_is_accepted_without_a_stream() {
    let mut bench = Bench::hovering(Autopilot::Arducopter);
    let (answers, _) = bench.answers(MavCmd::MAV_CMD_DO_SET_MODE, &[1.0, 4.0]);
    assert_eq!(answers, [ACCEPTED]);
    let before = bench.height();
    bench.run(3.0);
    assert_eq!(bench.mode(), Mode::Offboard);
    assert!((bench.height() - before).abs() < 0.2, "holds its position");
}

#[test]
fn setpoints_take_off_after_arming_delay_and_spool_up() {
    let mut bench = on_the_ground();
    set_up(&mut bench);
    bench.set_mode_number(GUIDED);
    bench.stream(setpoint(0.0, 0.0, 0.6, 0x07));
    assert_eq!(bench.arm(), ACCEPTED);
    bench.run(1.9);
    assert!(bench.height() < 0.02, "the motors do not spin at first");
    bench.run(2.5);
    assert!(bench.height() > 0.5, "height {}", bench.height());
}

#[test]
fn take_off_command_is_flown_in_guided() {
    let mut bench = on_the_ground();
    bench.set_mode_number(GUIDED);
    bench.arm();
    let take_off = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0];
    assert_eq!(bench.command(MavCmd::MAV_CMD_NAV_TAKEOFF, &take_off), ACCEPTED);
    bench.run(10.0);
    assert_eq!(bench.mode(), Mode::Offboard);
    assert!((bench.height() - 2.0).abs() < 0.2, "height {}", bench.height());
}

#[test]
fn setpoints_outside_guided_are_ignored() {
    let mut bench = Bench::hovering(Autopilot::Arducopter);
    set_up(&mut bench);
    bench.set_mode_number(BRAKE);
    bench.stream(setpoint(0.3, 0.0, HOVER, 0x07));
    bench.run(0.5);
    assert!(bench.roll_deg().abs() < 1.0);
}

#[test]
fn thrust_means_climb_rate_unless_guid_options_is_set() {
    let climb = |thrust: f32| {
        let mut bench = in_guided();
        bench.set_parameter("GUID_OPTIONS", 0.0, REAL);
        bench.stream(setpoint(0.0, 0.0, thrust, 0x07));
        bench.run(3.0);
        -bench.vehicle.plant().state().velocity.down()
    };
    assert!(climb(0.5).abs() < 0.05, "0.5 holds the height");
    // Half of WPNAV_SPEED_UP's 2.5 m/s.
    let rate = climb(0.75);
    assert!((rate - 1.25).abs() < 0.15, "{rate} m/s");
    assert!(climb(0.25) < -0.5);
}

#[test]
fn angle_boost_divides_thrust_by_the_cosine_of_the_tilt() {
    let collective = |boost: f32| {
        let mut bench = in_guided();
        bench.set_parameter("ATC_ANGLE_BOOST", boost, REAL);
        bench.stream(setpoint(30f64.to_radians(), 0.0, 0.369, 0x07));
        bench.run(1.5);
        bench.vehicle.flight().outputs().iter().sum::<f64>() / 4.0
    };
    assert!((collective(0.0) - 0.369).abs() < 0.01);
    assert!((collective(1.0) - 0.369 / 30f64.to_radians().cos()).abs() < 0.01);
}

#[test]
fn attitude_step_is_shaped() {
    // Measured: 63 % of 8 degrees after some 209 ms.
    let time = in_guided().roll_step_s(8.0, HOVER, 0x07);
    assert!((0.15..0.3).contains(&time), "{time} s");
}

#[test]
fn attitude_target_echoes_the_shaped_setpoint() {
    let mut bench = in_guided();
    bench.request(83, 100.0);
    bench.stream(setpoint(0.14, 0.0, HOVER, 0x07));
    bench.received();
    bench.run(0.1);
    let echo = bench.received().into_iter().rev().find_map(|received| match received.message {
        MavMessage::ATTITUDE_TARGET(target) => Some(target),
        _ => None,
    });
    let echo = echo.expect("an ATTITUDE_TARGET");
    let roll = 2.0 * f64::from(echo.q[1]).asin();
    assert!(roll > 0.01 && roll < 0.1, "on its way to 0.14: {roll}");
    assert_eq!(echo.type_mask.bits(), 0);
}

#[test]
fn rates_with_attitude_are_fed_forward_in_the_commanded_axes() {
    // At 0.8 Hz and 8 degrees the measured gain is 0.83 with attitude alone and 1.05 with rates. At
    // a heading of 90 degrees the sender must rotate the rates back.
    let amplitude = 8f64.to_radians();
    let omega = 0.8 * std::f64::consts::TAU;
    let gain = |yaw: f64, with_rates: bool, turned_back: bool| {
        let mut bench = in_guided();
        let level = Euler::new(0.0, 0.0, yaw).attitude();
        let message = setpoint(0.0, 0.0, HOVER, 0x07);
        bench.stream(SET_ATTITUDE_TARGET_DATA { q: level.to_wire(), ..message.clone() });
        bench.run(6.0);
        let (mut most_roll, mut most_pitch) = (0f64, 0f64);
        for step in 0..400 {
            let t = f64::from(step) * 0.01;
            let command = Euler::new(amplitude * (omega * t).sin(), 0.0, yaw).attitude();
            let rate = [amplitude * omega * (omega * t).cos(), 0.0, 0.0];
            let sent = if turned_back { command.to_body(rate.into()).to_array() } else { rate };
            let [x, y, z] = sent.map(|rate| rate as f32);
            bench.stream(SET_ATTITUDE_TARGET_DATA {
                q: command.to_wire(),
                body_roll_rate: x,
                body_pitch_rate: y,
                body_yaw_rate: z,
                type_mask: AttitudeTargetTypemask::from_bits_retain(if with_rates { 0 } else { 7 }),
                ..message.clone()
            });
            bench.run(0.01);
            if t > 2.0 {
                let euler = bench.vehicle.plant().state().attitude.euler();
                most_roll = most_roll.max(euler.roll.abs());
                most_pitch = most_pitch.max(euler.pitch.abs());
            }
        }
        [most_roll / amplitude, most_pitch / amplitude]
    };
    let [alone, _] = gain(0.0, false, false);
    let [roll, pitch] = gain(0.0, true, true);
    assert!((0.95..1.25).contains(&roll) && pitch < 0.1, "with rates: {roll} {pitch}");
    assert!(alone < 0.9 * roll, "attitude alone: {alone}, with rates {roll}");
    let yaw = std::f64::consts::FRAC_PI_2;
    let [roll, pitch] = gain(yaw, true, true);
    assert!((0.95..1.25).contains(&roll) && pitch < 0.1, "rotated back: {roll} {pitch}");
    let [_, pitch] = gain(yaw, true, false);
    assert!(pitch > 0.5, "without rotating back, roll excites pitch: {pitch}");
}

#[test]
fn partial_masks_and_invalid_quaternions_stop_the_vehicle() {
    let tilted = setpoint(0.14, 0.0, HOVER, 0x07);
    let scaled = tilted.q.map(|c| 1.2 * c);
    for bad in [
        setpoint(0.14, 0.0, HOVER, 0x03),
        setpoint(0.14, 0.0, HOVER, 0x47),
        SET_ATTITUDE_TARGET_DATA { q: scaled, ..tilted.clone() },
        SET_ATTITUDE_TARGET_DATA { q: [f32::NAN; 4], ..tilted.clone() },
    ] {
        let mut bench = in_guided();
        bench.stream(tilted.clone());
        bench.run(1.0);
        assert!(speed(&bench) > 0.5);
        bench.stream(bad.clone());
        bench.run(4.0);
        assert_eq!(bench.mode(), Mode::Offboard);
        assert!(speed(&bench) < 0.2, "{bad:?}: {} m/s", speed(&bench));
    }
}

#[test]
fn lost_stream_levels_out_after_its_timeout_and_stays_guided() {
    let mut bench = in_guided();
    bench.set_parameter("GUID_TIMEOUT", 3.0, REAL);
    bench.stream(setpoint(8f64.to_radians(), 0.0, HOVER, 0x07));
    bench.run(1.0);
    bench.stop_stream();
    bench.run(2.8);
    assert!((bench.roll_deg() - 8.0).abs() < 1.0, "still tilted: {}", bench.roll_deg());
    let height = bench.height();
    bench.run(1.2);
    assert!(bench.roll_deg().abs() < 1.0, "level: {}", bench.roll_deg());
    bench.run(20.0);
    assert_eq!(bench.mode(), Mode::Offboard, "no reaction");
    assert!((bench.height() - height).abs() < 1.0, "holds its height");
    assert!(bench.texts().is_empty(), "reports nothing");
    bench.stream(setpoint(8f64.to_radians(), 0.0, HOVER, 0x07));
    bench.run(0.6);
    assert!(bench.roll_deg() > 5.0, "the next setpoint is flown at once");
}

#[test]
fn last_yaw_rate_is_held_until_the_timeout() {
    let mut bench = in_guided();
    bench.set_parameter("GUID_TIMEOUT", 3.0, REAL);
    let message = setpoint(0.0, 0.0, HOVER, 0x00);
    bench.stream(SET_ATTITUDE_TARGET_DATA { body_yaw_rate: 0.5, ..message });
    bench.run(0.5);
    bench.stop_stream();
    bench.run(4.0);
    let yaw = bench.vehicle.plant().state().attitude.yaw().to_degrees();
    assert!((75.0..100.0).contains(&yaw), "measured 84 degrees: {yaw}");
}

/// A ground station's heartbeat with this system id.
fn heartbeat(bench: &mut Bench, system: u8) {
    let mut encoder = wire::Encoder::new(system, 190);
    let mut bytes = Vec::new();
    let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        ..Default::default()
    });
    assert!(encoder.encode(&message, &mut bytes));
    bench.vehicle.receive(bench::GROUND, &bytes);
}

#[test]
fn only_ground_station_loss_triggers_return_or_land() {
    for (action, expected) in [(0.0, Mode::Offboard), (1.0, Mode::Return), (5.0, Mode::Land)] {
        for (system, expected) in [(255, Mode::Offboard), (7, expected)] {
            let mut bench = in_guided();
            bench.set_parameter("FS_GCS_ENABLE", action, REAL);
            bench.set_parameter("FS_GCS_TIMEOUT", 3.0, REAL);
            heartbeat(&mut bench, 255);
            for _ in 0..4 {
                bench.run(1.0);
                // Heartbeats of a station that it does not monitor do not mask the silence.
                heartbeat(&mut bench, system);
            }
            assert_eq!(bench.mode(), expected, "action {action}, heartbeats of {system}");
            if expected != Mode::Offboard {
                assert!(bench.texts().contains("GCS Failsafe"));
            }
        }
    }
}

#[test]
fn radio_loss_triggers_return() {
    let mut bench = in_guided();
    bench.send(&MavMessage::MANUAL_CONTROL(MANUAL_CONTROL_DATA {
        target: 1,
        z: 500,
        ..Default::default()
    }));
    bench.run(0.8);
    assert_eq!(bench.mode(), Mode::Offboard, "sticks alone do not take over");
    bench.run(0.4);
    assert_eq!(bench.mode(), Mode::Return);
    assert!(bench.texts().contains("Radio Failsafe"));
}

#[test]
fn landing_disarms_at_once_and_keeps_the_mode() {
    let mut bench = in_guided();
    bench.set_mode_number(LAND);
    bench.stop_stream();
    assert!(bench.run_until(90.0, |bench| !bench.armed()), "lands and disarms");
    assert_eq!(bench.mode(), Mode::Land);
    assert_eq!(bench.arm(), MavResult::MAV_RESULT_TEMPORARILY_REJECTED, "no arming in LAND");
}

#[test]
fn disarms_after_its_delay_without_take_off() {
    let mut bench = on_the_ground();
    bench.set_mode_number(GUIDED);
    assert_eq!(bench.arm(), ACCEPTED);
    bench.run(9.5);
    assert!(bench.armed());
    bench.run(1.0);
    assert!(!bench.armed());
}

#[test]
fn parameters_are_plain_numbers_and_match_the_vehicle_loop() {
    let mut bench = on_the_ground();
    assert_eq!(bench.parameter("GUID_OPTIONS"), Some(0.0));
    assert_eq!(bench.parameter("MAV_GCS_SYSID"), Some(255.0));
    assert_eq!(bench.parameter("COM_OF_LOSS_T"), None);
    bench.set_parameter("GUID_OPTIONS", 8.0, REAL);
    assert_eq!(bench.parameter("GUID_OPTIONS"), Some(8.0));
    let pd = bench::params().attitude_pd.unwrap();
    let mut value = |name: &str| f64::from(bench.parameter(name).unwrap_or(f32::NAN));
    // 2 y T and 2 T kappa: moments of a torque of 1.
    for (axis, name, moment) in [(0, "RLL", 0.5), (1, "PIT", 0.5), (2, "YAW", 0.075)] {
        let rate_p = value(&format!("ATC_RAT_{name}_P")) * moment;
        let angle_p = value(&format!("ATC_ANG_{name}_P"));
        assert!((rate_p - pd.kd[axis]).abs() < 1e-6, "{name}: {rate_p}");
        assert!((angle_p * rate_p - pd.kp[axis]).abs() < 1e-5, "{name}: {angle_p}");
    }
    let servos: Vec<f64> = (1..=4).map(|servo| value(&format!("SERVO{servo}_FUNCTION"))).collect();
    assert_eq!(servos, [33.0, 36.0, 34.0, 35.0], "front right, rear right, rear left, front left");
}

#[test]
fn streams_are_off_by_default_and_unreachable_rates_are_denied() {
    let mut bench = Bench::hovering(Autopilot::Arducopter);
    for id in [30, 31, 32, 331, 36, 83, 147, 1] {
        assert_eq!(bench.rate_of(id), 0.0, "default of {id}");
    }
    for (id, hz) in [(31, 100.0), (31, 333.0), (32, 100.0), (36, 50.0), (147, 5.0)] {
        assert_eq!(bench.request(id, hz), ACCEPTED);
        let found = bench.rate_of(id);
        assert!((found - f64::from(hz)).abs() <= 1.5, "{id} requested at {hz}: {found} Hz");
    }
    for (id, hz) in [(31, 500.0), (331, 100.0), (375, 50.0), (291, 10.0), (9999, 1.0)] {
        assert_eq!(bench.request(id, hz), DENIED, "{id} at {hz} Hz");
    }
}

#[test]
fn outputs_are_pulses_within_the_spin_range() {
    let outputs = |bench: &mut Bench| {
        bench.request(36, 50.0);
        bench.received();
        bench.run(0.2);
        bench.received().into_iter().rev().find_map(|received| match received.message {
            MavMessage::SERVO_OUTPUT_RAW(servo) => Some(servo.servo1_raw),
            _ => None,
        })
    };
    assert_eq!(outputs(&mut on_the_ground()), Some(1000));
    let hover = outputs(&mut Bench::hovering(Autopilot::Arducopter)).expect("outputs");
    // 1000 + 1000 (0.15 + 0.8 u).
    assert!((1530..1560).contains(&hover), "{hover}");
}
