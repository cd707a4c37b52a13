//! The protocol: streams and their rates, commands, parameters, versions, addresses, several peers.

use std::collections::BTreeMap;

use crate::bench;
use crate::bench::{Bench, GROUND, count};
use mavlink::{MavlinkVersion, Message, MessageData};
use sitl::autopilot::Peer;
use wire::dialect::*;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;
const UNSUPPORTED: MavResult = MavResult::MAV_RESULT_UNSUPPORTED;
const SET_INTERVAL: MavCmd = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;

#[test]
fn default_stream_rates_match_px4() {
    let mut bench = Bench::new();
    bench.run(1.0);
    bench.received();
    bench.run(20.0);
    let received = bench.received();
    let rates = [
        (0, 1.0),
        (30, 100.0),
        (31, 50.0),
        (32, 30.0),
        (331, 30.0),
        (105, 50.0),
        (36, 10.0),
        (375, 0.0),
        (147, 0.5),
        (291, 0.0),
        (111, 10.0),
        (436, 0.5),
    ];
    for (id, rate) in rates {
        let got = count(&received, id) as f64 / 20.0;
        assert!((got - rate).abs() <= 0.051, "message {id}: {got} Hz, expected {rate}");
    }
}

#[test]
fn requested_rates_are_met_at_whole_intervals() {
    let mut bench = Bench::new();
    bench.run(0.5);
    for (id, interval) in
        [(31, 4000.0), (105, 4000.0), (32, 10000.0), (375, 10000.0), (331, 10000.0)]
    {
        assert_eq!(bench.command(SET_INTERVAL, &[id as f32, interval]), ACCEPTED);
    }
    bench.received();
    bench.run(4.0);
    let received = bench.received();
    for (id, rate) in [(31, 250), (105, 250), (32, 100), (375, 100), (331, 100)] {
        assert!(count(&received, id).abs_diff(4 * rate) <= 1, "message {id}");
    }
    for received in received {
        match received.message {
            MavMessage::ODOMETRY(odometry) => {
                assert_eq!(odometry.time_usec % 10_000, 0);
                assert_eq!(odometry.time_usec, received.time_us);
                assert_eq!(odometry.child_frame_id, MavFrame::MAV_FRAME_LOCAL_NED);
            }
            MavMessage::HIGHRES_IMU(imu) => {
                assert_eq!(imu.time_usec % 4_000, 0);
                assert_eq!(imu.fields_updated.bits(), 0x3F);
            }
            _ => {}
        }
    }
}

#[test]
fn setting_a_fixed_or_unknown_interval_fails() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(SET_INTERVAL, &[0.0, 10_000.0]), FAILED, "HEARTBEAT");
    assert_eq!(bench.command(SET_INTERVAL, &[9999.0, 10_000.0]), FAILED, "unknown");
    assert_eq!(bench.command(SET_INTERVAL, &[f32::NAN, f32::NAN]), FAILED);
    assert_eq!(bench.command(SET_INTERVAL, &[30.0, -1.0]), ACCEPTED);
    bench.received();
    bench.run(1.0);
    assert_eq!(count(&bench.received(), 30), 0);
}

#[test]
fn message_interval_can_be_queried() {
    let mut bench = Bench::new();
    bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[331.0]));
    bench.send(&bench::command_long(SET_INTERVAL, &[331.0, 10_000.0]));
    bench.received();
    #[allow(deprecated, reason = "clients still request it this way")]
    bench.send(&bench::command_long(MavCmd::MAV_CMD_GET_MESSAGE_INTERVAL, &[331.0]));
    let received = bench.received();
    let MavMessage::MESSAGE_INTERVAL(interval) = &received[0].message else {
        panic!("no interval")
    };
    assert_eq!((interval.message_id, interval.interval_us), (331, 10_000));
}

#[test]
fn heartbeat_and_version_identify_the_vehicle() {
    let mut bench = Bench::new();
    bench.run(1.1);
    let received = bench.received();
    let heartbeat = received.iter().find_map(|received| match &received.message {
        MavMessage::HEARTBEAT(heartbeat) => Some(heartbeat.clone()),
        _ => None,
    });
    let heartbeat = heartbeat.expect("a heartbeat");
    assert_eq!(heartbeat.autopilot, MavAutopilot::MAV_AUTOPILOT_PX4);
    assert_eq!(heartbeat.mavtype, MavType::MAV_TYPE_QUADROTOR);
    assert_eq!(heartbeat.custom_mode, 0x0304_0000);
    bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[148.0]));
    let received = bench.received();
    let MavMessage::AUTOPILOT_VERSION(version) = &received[0].message else { panic!("no version") };
    assert_eq!((version.vendor_id, version.product_id), (0x4457, 1));
    assert!(matches!(&received[1].message, MavMessage::COMMAND_ACK(ack) if ack.result == ACCEPTED));
}

#[test]
fn battery_status_reports_no_fault() {
    let mut bench = Bench::new();
    bench.fly();
    let received = bench.received();
    let battery = received.iter().rev().find_map(|received| match &received.message {
        MavMessage::BATTERY_STATUS(battery) => Some(battery.clone()),
        _ => None,
    });
    let battery = battery.expect("a BATTERY_STATUS");
    assert!(battery.fault_bitmask.is_empty());
    assert!((3_500..4_200).contains(&battery.voltages[0]) && battery.voltages[3] == u16::MAX);
    assert!(battery.current_battery > 0 && battery.battery_remaining > 90);
}

#[test]
fn every_message_can_be_requested() {
    let mut bench = Bench::new();
    bench.fly();
    let all = [
        0, 1, 2, 24, 30, 31, 32, 33, 36, 49, 74, 83, 105, 111, 141, 147, 148, 242, 245, 291, 331,
        375, 435, 436,
    ];
    for id in all {
        bench.received();
        bench.send(&bench::command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[id as f32]));
        assert!(count(&bench.received(), id) >= 1, "message {id}");
    }
    let unknown = bench.command(MavCmd::MAV_CMD_REQUEST_MESSAGE, &[9999.0]);
    assert_eq!(unknown, MavResult::MAV_RESULT_DENIED);
}

#[test]
fn unknown_commands_are_answered_unsupported() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(MavCmd::MAV_CMD_DO_SET_ROI_NONE, &[]), UNSUPPORTED);
    bench.received();
    // COMMAND_LONG 65000 is built by hand, because the dialect's types cannot express it.
    let mut payload = [0_u8; 33];
    payload[28..30].copy_from_slice(&65_000_u16.to_le_bytes());
    payload[30..32].copy_from_slice(&[1, 1]);
    let mut frame = vec![0xFD, 33, 0, 0, 0, 255, 190, 76, 0, 0];
    frame.extend_from_slice(&payload);
    let crc = mavlink::calculate_crc(&frame[1..], COMMAND_LONG_DATA::EXTRA_CRC);
    frame.extend_from_slice(&crc.to_le_bytes());
    bench.vehicle.receive(GROUND, &frame);
    let mut answered = false;
    bench.vehicle.take_output(|_, bytes| {
        answered |= bytes[7] == 77 && bytes[10..12] == 65_000_u16.to_le_bytes() && bytes[12] == 3;
    });
    assert!(answered);
}

#[test]
fn command_int_acts_like_command_long() {
    let mut bench = Bench::new();
    bench.received();
    bench.send(&MavMessage::COMMAND_INT(COMMAND_INT_DATA {
        param1: 1.0,
        command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    }));
    assert!(bench.armed());
    assert_eq!(count(&bench.received(), 77), 1);
}

#[test]
fn commands_for_other_systems_are_ignored() {
    let mut bench = Bench::new();
    let arm = |target_system, target_component| {
        let MavMessage::COMMAND_LONG(mut command) =
            bench::command_long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0])
        else {
            panic!("a command")
        };
        (command.target_system, command.target_component) = (target_system, target_component);
        MavMessage::COMMAND_LONG(command)
    };
    bench.received();
    for (system, component) in [(2, 1), (1, 2), (255, 0)] {
        bench.send(&arm(system, component));
        assert!(!bench.armed(), "{system}/{component}");
    }
    assert_eq!(count(&bench.received(), 77), 0);
    bench.send(&arm(0, 0));
    assert!(bench.armed(), "a broadcast");
}

#[test]
fn timesync_is_answered_with_the_vehicle_clock() {
    let mut bench = Bench::new();
    bench.vehicle.advance_to(1_234_567);
    bench.received();
    bench.send(&MavMessage::TIMESYNC(TIMESYNC_DATA { ts1: 42, ..Default::default() }));
    let answer = bench.received().into_iter().find_map(|received| match received.message {
        MavMessage::TIMESYNC(sync) if sync.tc1 != 0 => Some(sync),
        _ => None,
    });
    let answer = answer.expect("an answer");
    assert_eq!((answer.tc1, answer.ts1), (1_234_567_000, 42));
    assert_eq!((answer.target_system, answer.target_component), (255, 190));
}

#[test]
fn parameters_are_listed_read_and_set() {
    let mut bench = Bench::new();
    bench.received();
    bench.send(&MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
    }));
    bench.run(0.5);
    let mut listed = BTreeMap::new();
    for received in bench.received() {
        if let MavMessage::PARAM_VALUE(value) = received.message {
            listed.insert(value.param_index, value);
        }
    }
    let total = listed[&0].param_count;
    assert_eq!(listed.len(), usize::from(total));
    let loss_action =
        listed.values().find(|value| value.param_id.to_str() == Ok("COM_OBL_RC_ACT")).unwrap();
    assert_eq!(loss_action.param_type, MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(loss_action.param_value.to_bits(), 4, "Land, byte-cast");

    bench.join(Peer(3), MavlinkVersion::V2);
    bench.received_by(Peer(3));
    bench.set_parameter("COM_OBL_RC_ACT", f32::from_bits(5), MavParamType::MAV_PARAM_TYPE_INT32);
    for peer in [GROUND, Peer(3)] {
        let notified =
            bench.received_by(peer).into_iter().find_map(|received| match received.message {
                MavMessage::PARAM_VALUE(value) => Some(value.param_value.to_bits()),
                _ => None,
            });
        assert_eq!(notified, Some(5), "every peer is notified of a change");
    }
    bench.send(&MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
        param_index: -1,
        target_system: 1,
        target_component: 1,
        param_id: "NO_SUCH_PARAM".into(),
    }));
    assert_eq!(count(&bench.received(), PARAM_ERROR_DATA::ID), 1);
}

#[test]
fn mavlink_1_peer_gets_version_1_until_it_sends_version_2() {
    let mut bench = Bench::new();
    let old = Peer(1);
    bench.join(old, MavlinkVersion::V1);
    bench.run(2.5);
    let received = bench.received_by(old);
    assert!(count(&received, 30) > 200);
    for received in &received {
        assert_eq!(received.version, MavlinkVersion::V1);
        assert!(received.message.message_id() < 256);
    }
    let modern = bench.received();
    let after_hello: Vec<_> = modern.iter().filter(|received| received.time_us > 0).collect();
    assert!(after_hello.iter().all(|received| received.version == MavlinkVersion::V2));
    assert!(count(&modern, 331) > 50);
}

#[test]
fn each_peer_has_its_own_rates() {
    let mut bench = Bench::new();
    bench.join(Peer(1), MavlinkVersion::V2);
    assert_eq!(bench.command(SET_INTERVAL, &[30.0, -1.0]), ACCEPTED);
    bench.run(1.0);
    assert_eq!(count(&bench.received(), 30), 0);
    assert!(count(&bench.received_by(Peer(1)), 30) >= 99);
    bench.vehicle.disconnect(Peer(1));
    bench.run(1.0);
    assert_eq!(count(&bench.received_by(Peer(1)), 0), 0, "forgotten");
}

#[test]
fn mission_request_gets_an_empty_mission() {
    let mut bench = Bench::new();
    bench.received();
    bench.send(&MavMessage::MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
        ..Default::default()
    }));
    let received = bench.received();
    assert!(
        matches!(&received[0].message, MavMessage::MISSION_COUNT(mission) if mission.count == 0)
    );
}

#[test]
fn vehicle_file_without_attitude_pd_is_refused() {
    let mut params = bench::params();
    params.attitude_pd = None;
    let refused = sitl::autopilot::Vehicle::new(params, Default::default(), Default::default(), 1);
    let words = refused.err().expect("a refusal").to_string();
    assert!(words.contains("bench") && words.contains("attitude_pd"), "{words}");
}
