//! OFFBOARD: entering it, the effect of each type mask, and the loss of the stream.

use crate::bench;
use crate::bench::{Bench, setpoint};
use sitl::autopilot::Mode;
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const REJECTED: MavResult = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
const HOVER: f32 = 0.4905;

fn in_offboard(mask: u8) -> Bench {
    let mut bench = Bench::new();
    bench.fly();
    bench.stream(setpoint(0.0, 0.0, HOVER, mask));
    bench.run(0.05);
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    bench.run(0.2);
    assert_eq!(bench.mode(), Mode::Offboard);
    bench
}

/// Time until the vehicle leaves OFFBOARD, s.
fn time_to_leave(bench: &mut Bench) -> f64 {
    let start = bench.vehicle.now_us();
    while bench.mode() == Mode::Offboard {
        let now = bench.vehicle.now_us();
        assert!(now - start < 5_000_000, "OFFBOARD was never left");
        bench.vehicle.advance_to(now + 1000);
    }
    (bench.vehicle.now_us() - start) as f64 * 1e-6
}

#[test]
fn disarmed_offboard_is_accepted_and_arming_requires_a_stream() {
    let mut bench = Bench::new();
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    let (result, texts) = bench.command_and_texts(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(result, REJECTED);
    assert!(texts.contains("Arming denied: no offboard signal"), "{texts}");
    bench.stream(setpoint(0.0, 0.0, 0.1, 0x00));
    bench.run(0.05);
    assert_eq!(bench.arm(), ACCEPTED);
}

#[test]
fn offboard_in_flight_without_a_stream_is_refused() {
    let mut bench = Bench::new();
    bench.fly();
    assert_eq!(bench.set_mode(Mode::Offboard), REJECTED);
    assert_eq!(bench.mode(), Mode::Hold);
    bench.run(0.1);
    assert_eq!(bench.mode(), Mode::Hold);
}

#[test]
fn takes_off_in_offboard() {
    let mut bench = Bench::new();
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    bench.stream(setpoint(0.0, 0.0, 0.6, 0x07));
    bench.run(0.1);
    assert_eq!(bench.arm(), ACCEPTED);
    bench.run(2.0);
    assert!(bench.height() > 0.5, "height {}", bench.height());
}

#[test]
fn attitude_is_tracked_with_and_without_rates() {
    for mask in [0x00, 0x07] {
        let mut bench = in_offboard(mask);
        bench.stream(setpoint(0.14, 0.0, HOVER, mask));
        bench.run(1.0);
        let roll = bench.vehicle.plant().state().attitude.euler().roll;
        assert!((roll - 0.14).abs() < 0.02, "mask {mask:#x}: roll {roll}");
    }
}

#[test]
fn rates_are_followed_with_and_without_attitude() {
    // With attitude: the offset at which kp balances kd, kd / kp * rate.
    let mut bench = in_offboard(0x00);
    bench.stream(setpoint(0.0, 0.5, HOVER, 0x00));
    bench.run(1.0);
    let roll = bench.vehicle.plant().state().attitude.euler().roll;
    assert!((roll - 0.075 / 0.6 * 0.5).abs() < 0.01, "roll {roll}");
    // Masked rates are ignored.
    bench.stream(setpoint(0.0, 0.5, HOVER, 0x07));
    bench.run(1.0);
    let roll = bench.vehicle.plant().state().attitude.euler().roll;
    assert!(roll.abs() < 0.01, "roll {roll}");
    // Without attitude, the body turns at the commanded rate.
    bench.stream(setpoint(0.0, 0.5, HOVER, 0x80));
    bench.run(0.4);
    let rate = bench.vehicle.plant().state().body_rate.front();
    assert!((rate - 0.5).abs() < 0.05, "rate {rate}");
}

#[test]
fn attitude_target_echoes_the_active_setpoint() {
    let mut bench = in_offboard(0x00);
    bench.stream(setpoint(0.1, 0.0, 0.5, 0x07));
    bench.run(0.1);
    bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[83.0]));
    let echo = bench.received().into_iter().rev().find_map(|received| match received.message {
        MavMessage::ATTITUDE_TARGET(target) => Some(target),
        _ => None,
    });
    let echo = echo.expect("an ATTITUDE_TARGET");
    assert_eq!(echo.thrust, 0.5);
    assert_eq!(echo.type_mask.bits(), 0x07);
    assert!((echo.q[1] - 0.05_f32.sin()).abs() < 1e-6);
}

#[test]
fn stream_loss_holds_the_last_setpoint_then_lands() {
    let mut bench = in_offboard(0x00);
    bench.stream(setpoint(0.05, 0.0, 0.5, 0x00));
    bench.run(0.5);
    bench.stop_stream();
    bench.received();
    bench.run(0.9);
    assert_eq!(bench.mode(), Mode::Offboard);
    let roll = bench.vehicle.plant().state().attitude.euler().roll;
    assert!((roll - 0.05).abs() < 0.02, "the last setpoint is kept: roll {roll}");
    let left = 0.9 + time_to_leave(&mut bench);
    assert!((0.98..1.01).contains(&left), "left after {left} s");
    assert_eq!(bench.mode(), Mode::Land);
    bench.run(0.05);
    let received = bench.received();
    let current = received.iter().find_map(|received| match &received.message {
        MavMessage::CURRENT_MODE(mode) => Some((mode.custom_mode, mode.intended_custom_mode)),
        _ => None,
    });
    assert_eq!(current, Some((0x0604_0000, 0x0006_0000)));
    assert!(bench.run_until(20.0, |bench| !bench.armed()), "lands and disarms");
}

#[test]
fn loss_timeout_follows_the_parameter() {
    let mut bench = in_offboard(0x00);
    bench.set_parameter("COM_OF_LOSS_T", 0.2, MavParamType::MAV_PARAM_TYPE_REAL32);
    bench.run(0.1);
    bench.stop_stream();
    let left = time_to_leave(&mut bench);
    assert!((0.18..0.21).contains(&left), "left after {left} s");
    bench.run(0.01);
    assert!(bench.texts().contains("No offboard signal: failsafe activated"));
}

#[test]
fn resumed_stream_regains_control_only_while_offboard_is_intended() {
    let mut bench = in_offboard(0x00);
    bench.stop_stream();
    bench.run(1.2);
    assert_eq!(bench.mode(), Mode::Land);
    bench.stream(setpoint(0.0, 0.0, HOVER, 0x00));
    bench.run(0.05);
    assert_eq!(bench.mode(), Mode::Offboard, "as PX4");

    bench.stop_stream();
    bench.run(1.2);
    assert_eq!(bench.set_mode(Mode::Hold), ACCEPTED);
    bench.stream(setpoint(0.0, 0.0, HOVER, 0x00));
    bench.run(1.0);
    assert_eq!(bench.mode(), Mode::Hold);
}

#[test]
fn invalid_setpoints_do_not_keep_offboard_alive() {
    for bad in [
        setpoint(0.0, 0.0, HOVER, 0x87),
        setpoint(0.0, 0.0, HOVER, 0x47),
        setpoint(0.0, 0.0, f32::NAN, 0x00),
        SET_ATTITUDE_TARGET_DATA { q: [f32::NAN; 4], ..setpoint(0.0, 0.0, HOVER, 0x00) },
        SET_ATTITUDE_TARGET_DATA { target_system: 7, ..setpoint(0.0, 0.0, HOVER, 0x00) },
    ] {
        let mut bench = in_offboard(0x00);
        bench.stream(bad.clone());
        bench.run(1.2);
        assert_eq!(bench.mode(), Mode::Land, "{bad:?}");
    }
}

#[test]
fn setpoint_acts_after_the_command_delay() {
    let mut bench = in_offboard(0x00);
    bench.run(0.1);
    bench.stop_stream();
    let sent = bench.vehicle.now_us();
    let before = bench.vehicle.flight().outputs();
    bench.send(&MavMessage::SET_ATTITUDE_TARGET(setpoint(0.0, 0.0, 0.8, 0x00)));
    while bench.vehicle.flight().outputs().iter().sum::<f64>() < before.iter().sum::<f64>() + 0.5 {
        let now = bench.vehicle.now_us();
        assert!(now - sent < 50_000, "the setpoint never acted");
        bench.vehicle.advance_to(now + 1000);
    }
    let delay_ms = (bench.vehicle.now_us() - sent) / 1000;
    assert!((4..16).contains(&delay_ms), "{delay_ms} ms");
}
