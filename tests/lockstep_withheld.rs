//! A setpoint answers the newest sample of the vehicle that it was made for, while the supervisor
//! permits it. Whatever else a read brings, nothing leaves.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use crate::lockstep::{Bench, Downlink, NANO, hover, masks, message_id, params, settings};
use downwash::lockstep::EPOCH;
use downwash::log::record::{Direction, Record};
use downwash::station::{End, StationSettings};
use downwash::supervisor::{EngagePolicy, FlightState};
use sitl::autopilot::{COMPONENT_ID, Mode, SYSTEM_ID};
use wire::dialect::*;
use wire::{Decoder, Encoder};

const HEARTBEAT: u32 = 0;
const TIMESYNC: u32 = 111;
const AUTOPILOT_VERSION: u32 = 148;
const ODOMETRY: u32 = 331;
const CURRENT_MODE: u32 = 436;

/// A forged frame of the vehicle.
fn forged(message: &MavMessage) -> Vec<u8> {
    let mut bytes = Vec::new();
    assert!(Encoder::new(SYSTEM_ID, COMPONENT_ID).encode(message, &mut bytes));
    bytes
}

fn heartbeat(mode: Mode) -> Vec<u8> {
    heartbeat_of(MavAutopilot::MAV_AUTOPILOT_PX4, mode.custom_mode())
}

fn heartbeat_of(autopilot: MavAutopilot, custom_mode: u32) -> Vec<u8> {
    forged(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot,
        base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    }))
}

fn message(frame: &[u8]) -> Option<MavMessage> {
    let mut decoder = Decoder::new();
    decoder.push(frame);
    decoder.next_frame()?.message().ok()
}

/// The vehicle's TIMESYNC answer with its clock two seconds back.
fn set_back(frame: &[u8]) -> Vec<u8> {
    match message(frame) {
        Some(MavMessage::TIMESYNC(mut data)) if data.tc1 != 0 => {
            data.tc1 -= 2_000_000_000;
            forged(&MavMessage::TIMESYNC(data))
        }
        _ => frame.to_vec(),
    }
}

/// Another vehicle replaces the flown one: its clock is two seconds back, and its version is
/// unknown. The same read as a sample identifies it.
fn exchanged() -> Downlink {
    let mut version = None;
    Box::new(move |_, frame| match message_id(frame) {
        Some(TIMESYNC) => vec![set_back(frame)],
        Some(AUTOPILOT_VERSION) => {
            let data = AUTOPILOT_VERSION_DATA::default();
            version = Some(forged(&MavMessage::AUTOPILOT_VERSION(data)));
            vec![]
        }
        Some(ODOMETRY) => vec![[version.take().unwrap_or_default(), frame.to_vec()].concat()],
        _ => vec![frame.to_vec()],
    })
}

/// The records of vehicles and of flights in the log, in order.
fn facts_and_flights(bench: &Bench) -> Vec<String> {
    let words = bench.records.iter().filter_map(|record| match record {
        Record::Facts(facts) => facts.get("autopilot").cloned(),
        Record::FlightBegins(_) => Some("begins".to_owned()),
        Record::FlightEnds => Some("ends".to_owned()),
        _ => None,
    });
    words.collect()
}

#[test]
fn flight_ends_when_another_vehicle_replaces_the_flown_one() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.downlink = exchanged();
    bench.until(FlightState::Abort, 2.0);
    let aborted_us = bench.now_us();
    assert!(bench.logged("vehicle is PX4"), "{:#?}", bench.texts());
    bench.run(5.0);
    assert_eq!(bench.setpoints_after(aborted_us), 0);
    assert_eq!(masks(&bench.records), [0x00], "no setpoint in another form");
    assert_eq!(bench.phase(), Some(FlightState::Abort), "no other vehicle is flown");
    let why = "another vehicle answers on the link";
    assert_eq!(bench.station.end(), Some(&End::Aborted(why.to_owned())));
    assert_eq!(facts_and_flights(&bench), ["bundled", "begins", "ends"]);
}

/// A vehicle with another autopilot replaces the flown one. Both booted together, so the clock does
/// not distinguish them.
fn exchanged_for(autopilot: MavAutopilot) -> Downlink {
    Box::new(move |_, frame| match message_id(frame) {
        Some(HEARTBEAT) => vec![heartbeat_of(autopilot, 0)],
        Some(AUTOPILOT_VERSION | CURRENT_MODE) => vec![],
        _ => vec![frame.to_vec()],
    })
}

#[test]
fn replacement_autopilot_gets_no_setpoints_and_is_not_the_pilot() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.downlink = exchanged_for(MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA);
    bench.until(FlightState::Abort, 1.1);
    let aborted_us = bench.now_us();
    assert!(
        bench.logged("another vehicle is on the link: system 1 component 1: autopilot ArduPilot")
    );
    bench.run(3.0);
    assert!(bench.logged("vehicle is ArduCopter"), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(aborted_us), 0);
    let why = "another vehicle answers on the link";
    assert_eq!(bench.station.end(), Some(&End::Aborted(why.to_owned())));
    assert_eq!(facts_and_flights(&bench), ["bundled", "begins", "ends"]);
}

/// A flight under the pilot's switch.
fn switched() -> Bench {
    let params = params(NANO);
    let mut settings = settings(&params, hover(30.0));
    settings.policy = EngagePolicy::PilotSwitch;
    settings.search_timeout_s = None;
    let mut bench = Bench::new(settings, &params);
    bench.engage();
    bench.run(2.0);
    bench
}

#[test]
fn replacement_vehicle_is_kept_out_of_the_switched_flights_log() {
    for (other, name) in [
        (exchanged(), "PX4"),
        (exchanged_for(MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA), "ArduCopter"),
    ] {
        let mut bench = switched();
        bench.downlink = other;
        bench.run(if name == "PX4" { 0.9 } else { 3.2 });
        assert!(bench.logged("abort: another vehicle answers on the link"), "{:#?}", bench.texts());
        assert!(!bench.logged("recording continues"), "{:#?}", bench.texts());
        assert_eq!(facts_and_flights(&bench), ["bundled", "begins", "ends", name]);
        let waits = bench.phase().is_some_and(FlightState::precedes_stream);
        assert!(waits, "waits for the next flight's pilot: {:?}", bench.phase());
        assert_eq!(masks(&bench.records), [0x00]);
        assert_eq!(bench.station.end(), None);
    }
}

#[test]
fn unsupported_vehicle_is_waited_out_under_the_pilots_switch() {
    for policy in [EngagePolicy::PilotSwitch, EngagePolicy::Command] {
        let params = params(NANO);
        let mut bench =
            Bench::new(StationSettings { policy, ..settings(&params, hover(30.0)) }, &params);
        bench.downlink = exchanged_for(MavAutopilot::MAV_AUTOPILOT_GENERIC);
        bench.run(3.5);
        let why = "the modes of autopilot \"unknown\" are unknown";
        assert!(bench.logged(why), "{:#?}", bench.texts());
        assert_eq!((bench.phase(), bench.setpoints_after(0)), (None, 0));
        if policy == EngagePolicy::Command {
            assert_eq!(bench.station.end(), Some(&End::Refused(why.to_owned())));
            continue;
        }
        assert_eq!(bench.station.end(), None);
        bench.downlink = Box::new(|_, frame| vec![frame.to_vec()]);
        bench.until(FlightState::Standby, 10.0);
        assert!(bench.setpoints_after(0) > 0);
        assert_eq!(masks(&bench.records), [0x00]);
    }
}

/// The next sample arrives in the same read as a mode report after it, and other mode reports are
/// lost. Returns the time of that read.
fn read_with_mode(bench: &mut Bench, mode: Mode) -> Rc<Cell<Option<u64>>> {
    let taken_us = Rc::new(Cell::new(None));
    let taken = Rc::clone(&taken_us);
    let heartbeat = heartbeat(mode);
    bench.downlink = Box::new(move |now_us, frame| match message_id(frame) {
        Some(ODOMETRY) if taken.get().is_none() => {
            taken.set(Some(now_us));
            vec![[frame, heartbeat.as_slice()].concat()]
        }
        Some(HEARTBEAT | CURRENT_MODE) => vec![],
        _ => vec![frame.to_vec()],
    });
    taken_us
}

/// In one datagram the sample comes first, and the message that ends control after it.
#[test]
fn sample_is_not_answered_if_the_same_read_ends_control() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let taken_us = read_with_mode(&mut bench, Mode::Position);
    bench.run(0.2);
    let taken_us = taken_us.get().expect("a sample");
    assert_eq!(bench.phase(), Some(FlightState::PilotControl), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(taken_us - 1), 0);
}

#[test]
fn sample_is_not_answered_if_the_same_read_starts_landing() {
    let mut bench = Bench::hovering(NANO, 1.0);
    // The vehicle never receives the land command, and control continues for its grace period.
    bench.until(FlightState::Hold, 30.0);
    bench.run(1.9);
    bench.uplink = false;
    bench.until(FlightState::Land, 1.0);
    let asked_us = bench.now_us();
    bench.run(0.1);
    assert!(bench.setpoints_after(asked_us) > 5, "streams until the vehicle has taken over");
    let taken_us = read_with_mode(&mut bench, Mode::Land);
    bench.run(0.2);
    let taken_us = taken_us.get().expect("a sample");
    assert_eq!(bench.phase(), Some(FlightState::Land), "{:#?}", bench.texts());
    assert_eq!(bench.setpoints_after(taken_us - 1), 0);
}

/// Ticks in the log after `us` of simulation: their number, and the number with a setpoint.
fn ticks_after(bench: &Bench, us: u64) -> (usize, usize) {
    let after = EPOCH + Duration::from_micros(us);
    let ticks = bench.records.iter().filter_map(|record| match record {
        Record::Tick(tick) if tick.stamp.host > after => Some(tick),
        _ => None,
    });
    let ticks: Vec<_> = ticks.map(|tick| (tick.setpoint.is_some(), tick.saturation)).collect();
    assert!(ticks.iter().all(|(is_sent, saturation)| *is_sent || *saturation == 0));
    (ticks.len(), ticks.iter().filter(|(is_sent, _)| *is_sent).count())
}

/// Two samples arrive in one read.
fn in_pairs() -> Downlink {
    let mut first = None;
    Box::new(move |_, frame| match (message_id(frame), first.take()) {
        (Some(ODOMETRY), None) => {
            first = Some(frame.to_vec());
            vec![]
        }
        (Some(ODOMETRY), Some(first)) => vec![[first, frame.to_vec()].concat()],
        (_, kept) => {
            first = kept;
            vec![frame.to_vec()]
        }
    })
}

/// The vehicle may be a different one and does not identify itself.
fn unidentified() -> Downlink {
    Box::new(|_, frame| match message_id(frame) {
        Some(AUTOPILOT_VERSION) => vec![],
        _ => vec![set_back(frame)],
    })
}

#[test]
fn log_contains_exactly_the_setpoints_sent() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    bench.downlink = in_pairs();
    let from_us = bench.now_us();
    bench.run(0.5);
    let (ticks, sent) = ticks_after(&bench, from_us);
    assert!((48..=51).contains(&ticks) && (24..=26).contains(&sent), "{sent} of {ticks}");
    assert_eq!(sent, bench.setpoints_after(from_us));

    bench.downlink = unidentified();
    bench.run(0.5);
    assert!(bench.logged("no setpoint is sent: the vehicle is not identified"));
    let from_us = bench.now_us();
    bench.run(0.2);
    let (ticks, sent) = ticks_after(&bench, from_us);
    assert!(ticks > 10, "{ticks} ticks");
    assert_eq!((sent, bench.setpoints_after(from_us)), (0, 0));
    assert_eq!(bench.phase(), Some(FlightState::Track), "{:#?}", bench.texts());
}

/// Number of frames logged as sent.
fn sent_frames(records: &[Record]) -> usize {
    let is_sent =
        |record: &&Record| matches!(record, Record::Frame(it) if it.direction == Direction::Tx);
    records.iter().filter(is_sent).count()
}

#[test]
fn setpoint_refused_by_the_transport_is_not_logged_as_sent() {
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let (from_us, from) = (bench.now_us(), bench.records.len());
    let setpoints = bench.station.status().setpoints;
    bench.is_jammed = true;
    bench.run(0.2);
    let (ticks, sent) = ticks_after(&bench, from_us);
    assert!(ticks > 15, "{ticks} ticks");
    assert_eq!((sent, sent_frames(&bench.records[from..])), (0, 0));
    assert_eq!(bench.station.status().setpoints, setpoints);
    bench.is_jammed = false;
    bench.run(1.1);
    assert_eq!(bench.phase(), Some(FlightState::Track), "{:#?}", bench.texts());
    assert!(sent_frames(&bench.records[from..]) > 100);
    let dropped = bench.records.iter().rev().find_map(|record| match record {
        Record::Link { stats, .. } => Some(stats.dropped_frames),
        _ => None,
    });
    assert!(dropped.is_some_and(|dropped| dropped >= ticks as u64), "{dropped:?}");
}

/// A permitted stream that does not leave does not count.
#[test]
fn offboard_is_not_requested_while_no_setpoint_leaves() {
    let mut bench = Bench::hovering(NANO, 30.0);
    bench.until(FlightState::Standby, 10.0);
    bench.downlink = unidentified();
    bench.run(1.5);
    assert!(bench.logged("no setpoint is sent: the vehicle is not identified"));
    assert_eq!(bench.phase(), Some(FlightState::Standby), "{:#?}", bench.texts());
    assert!(!bench.logged("refuses"), "{:#?}", bench.texts());
}

/// The backlog after a stall looks fresh to a late reader.
#[test]
fn nothing_is_sent_after_a_stall_until_a_newer_sample() {
    for stall_s in [0.06, 0.1, 0.25] {
        let mut bench = Bench::hovering(NANO, 30.0).in_track();
        let stopped_us = bench.now_us();
        bench.stall(stall_s);
        let woke_us = bench.now_us();
        assert_eq!(bench.setpoints_after(stopped_us), 0, "{stall_s}");
        bench.run(0.004);
        assert_eq!(bench.setpoints_after(stopped_us), 0, "{stall_s}");
        bench.run(0.03);
        assert!(bench.setpoints_after(woke_us) >= 2, "{stall_s}: {:#?}", bench.texts());
        bench.run(0.5);
        assert!(bench.logged("this process stalled for"), "{:#?}", bench.texts());
        assert_eq!(bench.phase(), Some(FlightState::Track), "{stall_s}: {:#?}", bench.texts());
    }
    // A short stall does not count.
    let mut bench = Bench::hovering(NANO, 30.0).in_track();
    let stopped_us = bench.now_us();
    bench.stall(0.04);
    assert!(bench.setpoints_after(stopped_us) >= 3);
    assert!(!bench.logged("this process stalled"));
}
