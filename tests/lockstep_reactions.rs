//! What ends a flight early, each case flown over the protocol: faults, silence, refusals.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use crate::lockstep;
use crate::lockstep::{Bench, NANO, QUAD, effects, hover, message_id, params, settings};
use downwash::lockstep::EPOCH;
use downwash::log::record::Record;
use downwash::station::End;
use downwash::supervisor::{EngagePolicy, FlightState, Reaction};
use sitl::autopilot::{COMPONENT_ID, Mode, SYSTEM_ID, Vehicle};
use sitl::config::{BatteryConfig, SitlConfig};
use wire::Encoder;
use wire::dialect::*;
use wire::transport::Peer;

/// Messages from which the state is built.
const STATE_MESSAGES: [u32; 4] = [30, 31, 32, 331];

/// The vehicle lands and disarms without any further setpoint.
fn comes_down_silently(bench: &mut Bench) {
    let now_us = bench.now_us();
    bench.until_disarmed(30.0);
    assert!(bench.position().down() > -0.05, "on the ground");
    assert_eq!(bench.setpoints_after(now_us), 0);
}

#[test]
fn missing_samples_stop_setpoints_and_command_landing() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.downlink = Box::new(|_, frame| {
        let is_state = message_id(frame).is_some_and(|id| STATE_MESSAGES.contains(&id));
        if is_state { vec![] } else { vec![frame.to_vec()] }
    });
    let silent_us = bench.now_us();
    bench.run(0.9);
    assert_eq!(bench.setpoints_after(silent_us + 20_000), 0, "no sample, no setpoint");
    assert!(bench.logged("no state for"), "{:?}", bench.texts());
    assert_eq!(bench.vehicle.flight().mode(), Mode::Land);
    comes_down_silently(&mut bench);
}

#[test]
fn link_silence_leaves_landing_to_the_vehicle() {
    for vehicle in [NANO, QUAD] {
        let mut bench = Bench::hovering(vehicle, 30.0).in_track();
        bench.downlink = Box::new(|_, _| vec![]);
        bench.uplink = false;
        let cut_us = bench.now_us();
        bench.run(0.9);
        assert_eq!(bench.vehicle.flight().mode(), Mode::Offboard);
        bench.run(0.3);
        assert_eq!(bench.vehicle.flight().mode(), Mode::Land, "after COM_OF_LOSS_T");
        assert_eq!(bench.setpoints_after(cut_us + 20_000), 0);
        bench.run(4.0);
        assert!(matches!(bench.station.end(), Some(End::LinkLost(_) | End::Aborted(_))));
        comes_down_silently(&mut bench);
    }
}

#[test]
fn restored_link_does_not_resume_setpoints() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.downlink = Box::new(|_, _| vec![]);
    let cut_us = bench.now_us();
    bench.run(4.0);
    bench.downlink = Box::new(|_, frame| vec![frame.to_vec()]);
    bench.run(10.0);
    assert_eq!(bench.setpoints_after(cut_us + 20_000), 0);
    bench.until_disarmed(20.0);
}

#[test]
fn search_times_out_without_messages_from_the_vehicle() {
    let params = params(NANO);
    let mut settings = settings(&params, hover(30.0));
    // The pilot does not switch: the vehicle stands and waits.
    settings.policy = EngagePolicy::PilotSwitch;
    settings.search_timeout_s = Some(8.0);
    let mut bench = Bench::new(settings, &params);
    bench.run(10.0);
    bench.downlink = Box::new(|_, _| vec![]);
    bench.run(7.9);
    assert!(bench.logged("link Stale -> Lost") && bench.station.end().is_none());
    bench.run(0.2);
    assert!(matches!(bench.station.end(), Some(End::LinkLost(_))), "{:?}", bench.station.end());
}

/// Injects a forged frame of the autopilot once.
fn inject(bench: &mut Bench, message: MavMessage) {
    let mut encoder = Encoder::new(SYSTEM_ID, COMPONENT_ID);
    let mut forged = Vec::new();
    assert!(encoder.encode(&message, &mut forged));
    let mut once = Some(forged);
    bench.downlink = Box::new(move |_, frame| {
        let mut out = vec![frame.to_vec()];
        out.extend(once.take());
        out
    });
}

fn odometry(bench: &Bench, north_m: f32, q_w: f32) -> MavMessage {
    let now_us = bench.vehicle.now_us();
    let down_m = bench.position().down() as f32;
    MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: now_us,
        x: north_m,
        z: down_m,
        q: [q_w, 0.0, 0.0, 0.0],
        frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        ..Default::default()
    })
}

#[test]
fn estimate_jump_leads_to_hold_and_landing() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let message = odometry(&bench, 5.0, 1.0);
    inject(&mut bench, message);
    bench.run(0.1);
    assert_eq!(bench.phase(), Some(FlightState::Hold));
    bench.until(FlightState::Done, 30.0);
    assert!(bench.position().north().abs() < 1.0);
    assert!(matches!(bench.station.end(), Some(End::Aborted(_))), "{:?}", bench.station.end());
}

#[test]
fn nan_telemetry_is_ignored() {
    let mut bench = Bench::hovering(NANO, 10.0).in_track();
    for message in [odometry(&bench, f32::NAN, 1.0), odometry(&bench, 0.0, f32::NAN)] {
        inject(&mut bench, message);
        bench.run(0.5);
        assert_eq!(bench.phase(), Some(FlightState::Track), "{:?}", bench.texts());
    }
    bench.until(FlightState::Done, 40.0);
    assert_eq!(bench.station.end(), Some(&End::Done));
}

#[test]
fn vehicle_blown_off_course_lands() {
    let params = params(NANO);
    let mut settings = settings(&params, hover(30.0));
    settings.offboard.safety.tracking_error_max_m = 0.3;
    let wind = ["rotor_drag:d_xy=0.02,d_z=0.005", "wind:north_m_s=5"];
    let mut bench = Bench::with(settings, &params, &wind, SitlConfig::default());
    let limit = 60.0;
    bench.until(FlightState::Land, limit);
    assert!(bench.logged("from the reference"), "{:?}", bench.texts());
    bench.until(FlightState::Done, limit);
    assert!(matches!(bench.station.end(), Some(End::Aborted(_))));
}

#[test]
fn fence_breach_and_excessive_tilt_end_the_flight() {
    let params = params(NANO);
    let mut fenced = settings(&params, lockstep::trajectory("sinusoid-xy.toml"));
    fenced.offboard.safety.fence_radius_m = 0.6;
    let mut bench = Bench::new(fenced, &params);
    bench.until(FlightState::Land, 60.0);
    assert!(bench.logged("outside the geofence"), "{:?}", bench.texts());
    bench.until(FlightState::Done, 60.0);

    let mut bench = stopped_in_flight();
    assert!(bench.logged("tilted"), "{:?}", bench.texts());
    let now_us = bench.now_us();
    bench.run(2.0);
    assert_eq!(bench.setpoints_after(now_us), 0, "silent: the vehicle's failsafe acts");
    assert_eq!(bench.vehicle.flight().mode(), Mode::Land);
    comes_down_silently(&mut bench);
}

#[test]
fn empty_battery_lands_the_vehicle() {
    let params = params(NANO);
    let battery = BatteryConfig { capacity_mah: Some(40.0), charge: 0.5, ..Default::default() };
    let config = SitlConfig { battery, ..SitlConfig::default() };
    let mut bench = Bench::with(settings(&params, hover(300.0)), &params, &[], config);
    bench.until(FlightState::Land, 120.0);
    assert!(bench.logged("battery at"), "{:?}", bench.texts());
    bench.until(FlightState::Done, 60.0);
    assert!(matches!(bench.station.end(), Some(End::Aborted(_))));
}

#[test]
fn vehicle_reboot_in_flight_ends_the_flight_permanently() {
    let params = params(NANO);
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let fresh = Vehicle::new(params, effects(&[]), SitlConfig::default(), 2).expect("a vehicle");
    bench.reboot(fresh);
    let now_us = bench.now_us();
    bench.run(15.0);
    assert_eq!(bench.setpoints_after(now_us + 20_000), 0);
    assert!(!bench.vehicle.flight().armed());
    assert!(bench.station.end().is_some_and(|end| *end != End::Done), "{:?}", bench.texts());
}

/// Turns the vehicle's answers to a command into refusals.
fn refuse(bench: &mut Bench, command: MavCmd) -> Rc<Cell<u32>> {
    let refused = Rc::new(Cell::new(0));
    let count = Rc::clone(&refused);
    bench.downlink = Box::new(move |_, frame| {
        let mut decoder = wire::Decoder::new();
        decoder.push(frame);
        let message = decoder.next_frame().and_then(|frame| frame.message().ok());
        let Some(MavMessage::COMMAND_ACK(mut ack)) = message else { return vec![frame.to_vec()] };
        if ack.command != command {
            return vec![frame.to_vec()];
        }
        count.set(count.get() + 1);
        ack.result = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        let mut bytes = Vec::new();
        Encoder::new(SYSTEM_ID, COMPONENT_ID).encode(&MavMessage::COMMAND_ACK(ack), &mut bytes);
        vec![bytes]
    });
    refused
}

#[test]
fn refused_arming_is_reported_and_nothing_flies() {
    let params = params(NANO);
    let empty = BatteryConfig { charge: 0.01, ..Default::default() };
    let config = SitlConfig { battery: empty, ..SitlConfig::default() };
    let mut settings = settings(&params, hover(5.0));
    settings.offboard.preflight.battery_min = 0.0;
    settings.offboard.safety.battery_min = 0.0;
    let mut bench = Bench::with(settings, &params, &[], config);
    bench.until(FlightState::Abort, 30.0);
    let Some(End::Refused(reason)) = bench.station.end() else {
        panic!("{:?}", bench.station.end());
    };
    assert!(reason.contains("refuses to arm"), "{reason}");
    assert!(!bench.vehicle.flight().armed() && bench.position().down() > -0.01);
}

#[test]
fn refused_offboard_is_reported_and_nothing_flies() {
    let params = params(NANO);
    let mut settings = settings(&params, hover(5.0));
    settings.offboard.supervisor.engage_timeout_s = 3.0;
    let mut bench = Bench::new(settings, &params);
    bench.until(FlightState::Standby, 10.0);
    // The request and the setpoints are lost, and the answer is a refusal.
    bench.uplink = false;
    let _refused = refuse(&mut bench, MavCmd::MAV_CMD_DO_SET_MODE);
    bench.until(FlightState::Abort, 20.0);
    assert!(matches!(bench.station.end(), Some(End::Refused(_))), "{:?}", bench.station.end());
    assert!(!bench.vehicle.flight().armed());
    let now_us = bench.now_us();
    bench.run(3.0);
    assert_eq!(bench.setpoints_after(now_us), 0);
}

#[test]
fn low_battery_blocks_a_commanded_flight() {
    let params = params(NANO);
    let low = BatteryConfig { charge: 0.2, ..Default::default() };
    let config = SitlConfig { battery: low, ..SitlConfig::default() };
    let mut settings = settings(&params, hover(5.0));
    settings.offboard.supervisor.ready_timeout_s = 5.0;
    let mut bench = Bench::with(settings, &params, &[], config);
    bench.until(FlightState::Abort, 30.0);
    let Some(End::Refused(reason)) = bench.station.end() else {
        panic!("{:?}", bench.station.end());
    };
    assert!(reason.contains("battery"), "{reason}");
    assert!(bench.setpoints_us.is_empty(), "nothing was streamed");
}

#[test]
fn land_request_lands_the_vehicle() {
    let mut bench = Bench::hovering(QUAD, 30.0).in_track();
    let now = bench.now();
    bench.station.land(now);
    bench.run(1.0);
    assert_eq!(bench.vehicle.flight().mode(), Mode::Land);
    comes_down_silently(&mut bench);
    bench.until(FlightState::Done, 10.0);
    assert_eq!(bench.station.end(), Some(&End::Stopped));
}

fn cut(bench: &mut Bench) {
    bench.downlink = Box::new(|_, _| vec![]);
    bench.uplink = false;
}

#[test]
fn link_loss_takes_precedence_over_a_stop_request() {
    // Silence after the request, and the request during the silence.
    for stops_first in [true, false] {
        let mut bench = Bench::hovering(NANO, 30.0).in_track();
        if !stops_first {
            cut(&mut bench);
            bench.run(1.0);
        }
        let now = bench.now();
        bench.station.land(now);
        cut(&mut bench);
        bench.run(3.0);
        let end = bench.station.end();
        assert!(matches!(end, Some(End::LinkLost(_))), "{stops_first}: {end:?}");
    }
}

#[test]
fn link_is_lost_after_the_configured_silence() {
    let params = params(NANO);
    let mut settings = settings(&params, hover(30.0));
    settings.offboard.supervisor.link_lost_after_s = 1.0;
    let mut bench = Bench::new(settings, &params).in_track();
    cut(&mut bench);
    bench.until(FlightState::Abort, 1.5);
    assert!(matches!(bench.station.end(), Some(End::LinkLost(_))), "{:?}", bench.station.end());
}

/// Ticks after `us` of simulation: their number, the number with a setpoint, and the last height.
fn recorded_after(bench: &Bench, us: u64) -> (usize, usize, f64) {
    let after = EPOCH + Duration::from_micros(us);
    let ticks = || {
        bench.records.iter().filter_map(|record| match record {
            Record::Tick(tick) if tick.stamp.host > after => Some(tick),
            _ => None,
        })
    };
    let height_m = ticks().next_back().map_or(f64::NAN, |tick| -tick.state.position.down());
    (ticks().count(), ticks().filter(|tick| tick.setpoint.is_some()).count(), height_m)
}

/// A flight that exceeds its tilt limit, which stops the stream.
fn stopped_in_flight() -> Bench {
    let params = params(NANO);
    let mut settings = settings(&params, lockstep::trajectory("steps.toml"));
    settings.offboard.safety.tilt_max_rad = 0.1;
    settings.offboard.safety.tilt_for_s = 0.05;
    settings.offboard.safety.on_tilt = Reaction::Stop;
    let mut bench = Bench::new(settings, &params);
    bench.until(FlightState::Abort, 60.0);
    bench
}

#[test]
fn vehicle_is_recorded_after_an_abort() {
    let mut bench = stopped_in_flight();
    let aborted_us = bench.now_us();
    let verdict = bench.station.end().cloned();
    assert!(matches!(verdict, Some(End::Aborted(_))), "{verdict:?}");
    assert!(!bench.station.is_over() && !bench.has_recorded_end());

    bench.until_over(11.0);
    assert!(bench.now_us() - aborted_us <= 10_020_000, "{:?}", bench.texts());
    let (ticks, setpoints, height_m) = recorded_after(&bench, aborted_us);
    assert!(ticks > 300 && height_m < 0.05, "{ticks} ticks down to {height_m} m");
    assert_eq!((setpoints, bench.setpoints_after(aborted_us)), (0, 0));
    assert!(bench.has_recorded_end());
    assert_eq!(bench.station.end(), verdict.as_ref(), "the reported end does not change");
}

#[test]
fn recording_continues_ten_seconds_after_pilot_takeover() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.pilot_mode(Mode::Position);
    bench.until(FlightState::PilotControl, 1.0);
    let taken_us = bench.now_us();
    bench.until_over(11.0);
    let recorded_s = (bench.now_us() - taken_us) as f64 * 1e-6;
    assert!((9.9..10.1).contains(&recorded_s), "{recorded_s} s");
    assert!(bench.vehicle.flight().armed());
    let (ticks, setpoints, _) = recorded_after(&bench, taken_us);
    assert!(ticks > 900 && setpoints == 0, "{ticks} ticks, {setpoints} setpoints");
    assert_eq!(bench.station.end(), Some(&End::PilotTookOver));
}

#[test]
fn stop_request_after_an_abort_ends_the_recording() {
    let mut bench = stopped_in_flight();
    let verdict = bench.station.end().cloned();
    let now = bench.now();
    bench.station.land(now);
    assert!(bench.station.is_over());
    assert_eq!(bench.station.end(), verdict.as_ref());
}

#[test]
fn recording_ends_with_a_normal_landing() {
    let mut bench = Bench::hovering(NANO, 1.0);
    bench.until(FlightState::Done, 60.0);
    assert!(bench.station.is_over() && bench.station.end() == Some(&End::Done));
}

/// The vehicle reboots and does not report its version, like one with different firmware.
#[test]
fn different_vehicle_after_an_abort_is_not_flown() {
    let params = params(NANO);
    let mut bench = stopped_in_flight();
    let aborted_us = bench.now_us();
    // The link goes silent in the air, so the recording lasts until the new vehicle is identified.
    bench.downlink = Box::new(|_, _| vec![]);
    bench.run(0.1);
    let fresh = Vehicle::new(params, effects(&[]), SitlConfig::default(), 2).expect("a vehicle");
    bench.reboot(fresh);
    const AUTOPILOT_VERSION: u32 = 148;
    bench.downlink = Box::new(|_, frame| match message_id(frame) {
        Some(AUTOPILOT_VERSION) => vec![],
        _ => vec![frame.to_vec()],
    });
    bench.run(30.0);
    assert!(bench.logged("vehicle is PX4"), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(aborted_us), 0, "{:#?}", bench.texts());
    assert!(!bench.vehicle.flight().armed());
}

#[test]
fn only_the_vehicles_closed_connection_is_reported() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let now = bench.now();
    bench.station.peer_closed(now, Peer::new(7));
    bench.run(0.1);
    assert!(!bench.logged("connection closed"));
    bench.station.peer_closed(now, Peer::new(0));
    bench.run(0.1);
    assert!(bench.logged("the vehicle's connection closed"), "{:#?}", bench.texts());
}

#[test]
fn lossy_link_blocks_the_flight() {
    let params = params(NANO);
    let mut settings = settings(&params, hover(5.0));
    settings.offboard.supervisor.ready_timeout_s = 5.0;
    let mut bench = Bench::new(settings, &params);
    let mut count = 0_u32;
    bench.downlink = Box::new(move |_, frame| {
        count += 1;
        if count.is_multiple_of(10) { vec![] } else { vec![frame.to_vec()] }
    });
    bench.until(FlightState::Abort, 30.0);
    let Some(End::Refused(reason)) = bench.station.end() else {
        panic!("{:?}", bench.station.end());
    };
    let expected = "link: expected at most 5 % of frames lost, found 10 %";
    assert!(reason.contains(expected), "{reason}");
}

#[test]
fn sequence_gaps_of_other_senders_are_not_link_loss() {
    let mut bench = Bench::hovering(NANO, 5.0);
    let mut stranger = Encoder::new(9, 1);
    bench.downlink = Box::new(move |_, frame| {
        let mut bytes = Vec::new();
        for _ in 0..4 {
            bytes.clear();
            stranger.encode(&MavMessage::ATTITUDE(Default::default()), &mut bytes);
        }
        vec![bytes, frame.to_vec()]
    });
    bench.until(FlightState::Track, 30.0);
}
