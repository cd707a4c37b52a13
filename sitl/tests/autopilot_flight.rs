//! Arming, take-off, position hold, landing and command authority, on the virtual clock.

use crate::bench;
use crate::bench::{Bench, setpoint};
use sitl::autopilot::{Mode, Peer};
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const REJECTED: MavResult = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;

#[test]
fn takes_off_to_the_parameter_height_and_holds() {
    let mut bench = Bench::new();
    bench.run(0.5);
    bench.fly();
    let state = *bench.vehicle.plant().state();
    assert!((bench.height() - 2.5).abs() < 0.3, "height {}", bench.height());
    bench.run(5.0);
    let later = *bench.vehicle.plant().state();
    assert!((later.position - state.position).norm() < 0.3);
    assert!((bench.height() - 2.5).abs() < 0.15, "height {}", bench.height());
}

#[test]
fn take_off_command_altitude_is_above_sea_level() {
    let mut bench = Bench::new();
    bench.run(0.1);
    bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[242.0]));
    let home = bench
        .received()
        .into_iter()
        .find_map(|received| match received.message {
            MavMessage::HOME_POSITION(home) => Some(home.altitude as f32 * 1e-3),
            _ => None,
        })
        .expect("a home position");
    assert_eq!(bench.arm(), ACCEPTED);
    let params = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, home + 4.0];
    assert_eq!(bench.command(MavCmd::MAV_CMD_NAV_TAKEOFF, &params), ACCEPTED);
    assert!(bench.run_until(15.0, |bench| bench.mode() == Mode::Hold));
    bench.run(4.0);
    assert!((bench.height() - 4.0).abs() < 0.2, "height {}", bench.height());
}

#[test]
fn lands_and_disarms_automatically() {
    let mut bench = Bench::new();
    bench.fly();
    assert_eq!(bench.command(MavCmd::MAV_CMD_NAV_LAND, &[]), ACCEPTED);
    assert_eq!(bench.mode(), Mode::Land);
    assert!(bench.run_until(20.0, |bench| !bench.armed()), "disarms");
    assert!(bench.height().abs() < 0.1);
    assert_eq!(bench.mode(), Mode::Hold, "the mode chosen while disarmed");
    assert!(bench.texts().contains("Disarmed by landing"));
}

#[test]
fn returns_to_the_arming_position() {
    let mut bench = Bench::new();
    bench.fly();
    bench.stream(setpoint(0.2, 0.0, 0.5, 0x07));
    bench.run(0.02);
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    bench.run(1.5);
    bench.stop_stream();
    assert_eq!(bench.set_mode(Mode::Return), ACCEPTED);
    assert!(bench.vehicle.plant().state().position.east() > 0.5);
    assert!(bench.run_until(40.0, |bench| !bench.armed()), "lands at home");
    assert!(bench.vehicle.plant().state().position.norm() < 0.7);
}

#[test]
fn disarms_without_take_off() {
    let mut bench = Bench::new();
    assert_eq!(bench.arm(), ACCEPTED);
    bench.run(9.5);
    assert!(bench.armed());
    bench.run(1.0);
    assert!(!bench.armed());
}

#[test]
fn disarming_in_the_air_requires_the_force_code() {
    let mut bench = Bench::new();
    bench.fly();
    let (result, texts) = bench.command_and_texts(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[0.0]);
    assert_eq!(result, REJECTED);
    assert!(texts.contains("not landed"), "{texts}");
    assert!(bench.armed());
    assert_eq!(bench.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[0.0, 21196.0]), ACCEPTED);
    assert!(!bench.armed());
    // It cannot be armed again while it falls.
    bench.run(0.2);
    let (result, texts) = bench.command_and_texts(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0]);
    assert_eq!(result, REJECTED);
    assert!(texts.contains("not landed"), "{texts}");
}

#[test]
fn arming_in_land_mode_is_refused_with_a_reason() {
    let mut bench = Bench::new();
    assert_eq!(bench.set_mode(Mode::Land), ACCEPTED);
    let (result, texts) =
        bench.command_and_texts(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0, 21196.0]);
    assert_eq!(result, REJECTED, "force does not skip the arming checks");
    assert!(texts.contains("Arming denied: mode Land"), "{texts}");
}

#[test]
fn arming_requires_a_ground_station_if_a_parameter_says_so() {
    let mut bench = Bench::new();
    let one = f32::from_bits(1);
    bench.set_parameter("NAV_DLL_ACT", one, MavParamType::MAV_PARAM_TYPE_INT32);
    // The bench's peer sent its hello too long ago.
    bench.run(11.0);
    assert_eq!(bench.arm(), REJECTED);
    bench.join(Peer(7), mavlink::MavlinkVersion::V2);
    assert_eq!(bench.arm(), ACCEPTED);
}

#[test]
fn second_peer_takes_over_from_offboard() {
    let mut bench = Bench::new();
    let pilot = Peer(9);
    bench.join(pilot, mavlink::MavlinkVersion::V1);
    bench.fly();
    bench.stream(setpoint(0.0, 0.0, 0.5, 0x00));
    bench.run(0.02);
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    bench.run(0.2);
    bench.received();
    bench.send_from(pilot, &bench::command_long(MavCmd::MAV_CMD_DO_SET_MODE, &[1.0, 3.0]));
    assert_eq!(bench.mode(), Mode::Position, "immediately");
    let received = bench.received();
    let is_notified = received.iter().any(|received| {
        matches!(&received.message, MavMessage::CURRENT_MODE(mode)
            if mode.custom_mode == Mode::Position.custom_mode())
    });
    assert!(is_notified, "the first peer is notified immediately");
    bench.run(3.0);
    assert_eq!(bench.mode(), Mode::Position, "the live stream does not take control back");
}

#[test]
fn sticks_take_over_and_move_the_vehicle() {
    let mut bench = Bench::new();
    bench.fly();
    bench.stream(setpoint(0.0, 0.0, 0.49, 0x00));
    bench.run(0.02);
    assert_eq!(bench.set_mode(Mode::Offboard), ACCEPTED);
    bench.run(0.1);
    let sticks = MavMessage::MANUAL_CONTROL(MANUAL_CONTROL_DATA {
        x: 500,
        z: 500,
        target: 1,
        ..Default::default()
    });
    for _ in 0..20 {
        bench.send(&sticks);
        bench.run(0.1);
    }
    assert_eq!(bench.mode(), Mode::Position);
    assert!(bench.vehicle.plant().state().velocity.north() > 0.5);
    bench.run(4.0);
    assert!(
        bench.vehicle.plant().state().velocity.norm() < 0.2,
        "stops once the sticks are released"
    );
}
