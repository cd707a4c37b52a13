//! The session against a vehicle made of messages, on a virtual clock.

use std::time::Duration;

use downwash::clock::VehicleTime;
use downwash::link::counters::LinkState;
use downwash::link::external_pose::{ExternalPose, PoseForm};
use downwash::link::intervals::IntervalEvent;
use downwash::link::profile::Profile;
use downwash::link::request::{FlightMode, Outcome, Request};
use downwash::link::session::{Event, Heard, Session, SetpointError, Settings};
use downwash::link::vehicle_clock::ClockSource;
use message::Inbound;
use vehicle::frame::{Attitude, Ned};
use wire::dialect::*;
use wire::{Decoder, Encoder};

use crate::link_world::*;

#[test]
fn a_vehicle_is_found_identified_and_streams_as_asked() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    let found = world.session.vehicle().expect("found");
    assert_eq!((found.system, found.component, found.peer), (1, 1, VEHICLE));
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    assert_eq!(world.states(), [LinkState::Connected]);
    assert_eq!(vehicle.requests_of_interval, 1, "a rate that comes is not asked for again");
    let stats = world.session.stats();
    let attitude = stats.messages.iter().find(|message| message.id == ATTITUDE_QUATERNION);
    assert!((attitude.expect("counted").rate_hz - 100.0).abs() < 2.0);
    assert_eq!((stats.foreign, stats.stray, stats.refused, stats.lost), (0, 0, 0, 0));
    assert!((4..=6).contains(&vehicle.heartbeats_heard));
    assert_eq!(world.frames as u64, stats.received.frames);
}

#[test]
fn a_vehicle_that_does_not_tell_its_version_gets_the_safe_form() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    vehicle.version = None;
    world.run(&mut vehicle, seconds(1.0));
    let early = world.session.send_setpoint(world.now, &cleared(world.now, 0.0));
    assert_eq!(early, Err(SetpointError::NotIdentified));
    world.run(&mut vehicle, seconds(3.0));
    assert_eq!(world.session.profile(), Some(&Profile::PX4));
    world.session.send_setpoint(world.now, &cleared(world.now, 0.0)).expect("sent");
    world.run(&mut vehicle, STEP);
    assert_eq!(vehicle.setpoints[0].type_mask.bits(), 0x07);
    assert_eq!(vehicle.setpoints[0].target_system, 1);
}

#[test]
fn others_never_take_the_vehicles_place() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.messages.len();

    // Another autopilot, a ground station, and someone with the vehicle's ids elsewhere.
    let mut other = Vehicle::new(2);
    let bytes = other.encode(&other.heartbeat());
    world.deliver(STRANGER, &bytes);
    let mut station = Encoder::new(255, 190);
    let mut bytes = Vec::new();
    let data = HEARTBEAT_DATA { mavtype: MavType::MAV_TYPE_GCS, ..Default::default() };
    station.encode(&MavMessage::HEARTBEAT(data), &mut bytes);
    world.deliver(STRANGER, &bytes);
    let mut twin = Vehicle::new(1);
    let bytes = twin.encode(&twin.heartbeat());
    world.deliver(STRANGER, &bytes);

    assert_eq!(world.messages.len(), heard);
    let stats = world.session.stats();
    assert_eq!((stats.foreign, stats.stray), (2, 1));
    assert_eq!(world.session.vehicle().map(|v| (v.system, v.peer)), Some((1, VEHICLE)));
}

#[test]
fn a_configured_system_is_waited_for() {
    let settings = Settings { vehicle_system: Some(3), ..settings() };
    let mut world = World::new(settings);
    world.run(&mut Vehicle::new(1), seconds(2.0));
    assert_eq!(world.session.vehicle(), None);
    assert_eq!(world.session.state(), LinkState::Searching);
    world.run(&mut Vehicle::new(3), seconds(2.0));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.system), Some(3));
}

#[test]
fn silence_is_stale_then_lost_and_the_vehicle_is_found_again_elsewhere() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let pending = Request::ReadParameter("X".to_owned());
    world.session.request(world.now, pending);
    world.silence(seconds(6.0));
    use LinkState::{Connected, Lost, Stale};
    assert_eq!(world.states(), [Connected, Stale, Lost]);
    assert_eq!(world.outcomes(), [Outcome::NoAnswer]);
    world.session.request(world.now, Request::Arm);
    world.silence(STEP);
    assert_eq!(world.outcomes(), [Outcome::NoAnswer, Outcome::NotConnected]);
    assert_eq!(
        world.session.send_setpoint(world.now, &cleared(world.now, 0.0)),
        Err(SetpointError::NotConnected)
    );
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(STRANGER, &bytes);
    world.silence(seconds(0.1));
    assert_eq!(world.states(), [Connected, Stale, Lost, Connected]);
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(STRANGER));
    assert_eq!(world.session.profile(), None, "it is identified anew");
}

#[test]
fn a_closed_connection_is_relearnt_at_once() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    assert!(!world.session.peer_closed(STRANGER) && world.session.peer_closed(VEHICLE));
    assert_eq!(
        world.session.send_setpoint(world.now, &cleared(world.now, 0.0)),
        Err(SetpointError::NotConnected)
    );
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(STRANGER, &bytes);
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(STRANGER));
    assert!(world.session.send_setpoint(world.now, &cleared(world.now, 0.0)).is_ok());
    assert_eq!(world.states(), [LinkState::Connected]);
}

#[test]
fn a_new_connection_counts_anew_and_silence_does_not() {
    for is_closed in [true, false] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(2.0));
        if is_closed {
            assert!(world.session.peer_closed(VEHICLE));
        } else {
            world.silence(seconds(3.0));
            assert_eq!(world.session.state(), LinkState::Stale);
        }
        for _ in 0..50 {
            vehicle.encode(&vehicle.heartbeat());
        }
        // A closed tcp: connection is opened again under the number that it had.
        let bytes = vehicle.encode(&vehicle.heartbeat());
        world.deliver(VEHICLE, &bytes);
        assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(VEHICLE));
        assert_eq!(world.session.stats().lost, if is_closed { 0 } else { 50 }, "{is_closed}");
    }
}

#[test]
fn the_clock_converges_through_lopsided_jitter() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    // Answers wait up to 37 ms; one in eight comes at once.
    vehicle.reply_delay = |n| match n % 8 {
        0 => Duration::ZERO,
        n => Duration::from_millis(u64::from(n * 7919 % 38)),
    };
    world.run(&mut vehicle, seconds(8.0));
    let clock = world.session.clock().expect("known");
    assert_eq!(clock.source, ClockSource::Timesync);
    let truth = 30_000_000_000 - START.as_ns() as i64;
    let error = (clock.offset_ns - truth).unsigned_abs();
    // The virtual clock steps by a millisecond, so an answer "at once" takes one.
    assert!(error <= 1_000_000, "{error} ns");
}

#[test]
fn a_vehicle_whose_clock_is_another_is_identified_anew() {
    // Started now, or long before.
    for booted in [START + seconds(3.0), START - seconds(300.0)] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(3.0));
        assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
        // Another one with the same ids, at once: it must not get setpoints of the old one's form.
        let is_back = booted > vehicle.booted;
        vehicle.booted = booted;
        vehicle.version = None;
        world.run(&mut vehicle, seconds(0.6));
        assert_eq!(world.session.profile(), None);
        world.run(&mut vehicle, seconds(3.0));
        assert_eq!(world.session.profile(), Some(&Profile::PX4));
        let jumps = world.events.iter().filter_map(|event| match event {
            Event::ClockJump { by_ns } => Some(*by_ns < 0),
            _ => None,
        });
        assert_eq!(jumps.collect::<Vec<_>>(), [is_back]);
    }
}

#[test]
fn another_autopilot_under_the_vehicles_ids_is_identified_anew() {
    for is_silent in [true, false] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(2.0));
        if is_silent {
            world.silence(seconds(3.0));
        }
        world.session.request(world.now, Request::SetMode(FlightMode::Offboard));
        world.session.transmit(|_, _| true);
        // It was started with the other, so that no clock tells the two apart.
        vehicle.autopilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        let mode = vehicle.custom_mode;
        let bytes = vehicle.encode(&vehicle.heartbeat());
        world.deliver(VEHICLE, &bytes);
        assert_eq!(world.session.profile(), None);
        let early = world.session.send_setpoint(world.now, &cleared(world.now, 0.0));
        assert_eq!(early, Err(SetpointError::NotIdentified));
        world.run(&mut vehicle, seconds(2.0));
        assert_eq!(world.session.profile(), Some(&Profile::ARDUCOPTER), "{is_silent}");
        assert_eq!(vehicle.custom_mode, mode, "the other's modes mean something else to it");
        assert_eq!(world.outcomes(), [Outcome::Withdrawn]);
        let replaced = world.events.iter().any(|e| matches!(e, Event::VehicleReplaced(_)));
        assert!(replaced, "{:?}", world.events);
    }
}

#[test]
fn a_ground_station_is_no_vehicle_whatever_it_calls_its_autopilot() {
    let mut world = World::new(settings());
    for mavtype in [MavType::MAV_TYPE_GCS, MavType::MAV_TYPE_ONBOARD_CONTROLLER] {
        let data = HEARTBEAT_DATA {
            mavtype,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        Encoder::new(255, 190).encode(&MavMessage::HEARTBEAT(data), &mut bytes);
        world.deliver(STRANGER, &bytes);
    }
    assert_eq!(world.session.vehicle(), None);
    assert_eq!(world.session.stats().foreign, 2);
}

#[test]
fn a_lowered_rate_is_asked_for_again() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    // Another ground station wants it slow.
    vehicle.periods.insert(ATTITUDE_QUATERNION, Duration::from_millis(250));
    world.run(&mut vehicle, seconds(8.0));
    assert_eq!(vehicle.periods[&ATTITUDE_QUATERNION], Duration::from_millis(10));
    let news: Vec<_> = world.events.iter().filter(|e| matches!(e, Event::Interval(_))).collect();
    assert!(
        matches!(
            news[..],
            [
                Event::Interval(IntervalEvent::Short { id: ATTITUDE_QUATERNION, .. }),
                Event::Interval(IntervalEvent::Served { id: ATTITUDE_QUATERNION, .. }),
            ]
        ),
        "{news:?}"
    );
}

#[test]
fn requests_are_repeated_and_modes_read_back() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    vehicle.deaf_for = 2;
    world.session.request(world.now, Request::SetMode(FlightMode::Offboard));
    world.run(&mut vehicle, seconds(2.5));
    assert_eq!(vehicle.custom_mode, OFFBOARD);
    assert_eq!(world.outcomes(), [Outcome::Done]);
    world.events.clear();
    let set = Request::SetParameter { name: "COM_OF_LOSS_T".to_owned(), value: 0.2 };
    world.session.request(world.now, set);
    world.run(&mut vehicle, seconds(0.5));
    assert_eq!(vehicle.parameter.1, 0.2);
    assert_eq!(world.outcomes(), [Outcome::Parameter(0.2f32.into())]);
}

#[test]
fn the_vehicles_timesync_is_answered_from_the_host_clock() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let request = TIMESYNC_DATA { tc1: 0, ts1: 12_345, ..Default::default() };
    let bytes = vehicle.encode(&MavMessage::TIMESYNC(request));
    world.session.transmit(|_, _| true);
    world.deliver(VEHICLE, &bytes);
    let mut answers = Vec::new();
    world.session.transmit(|to, bytes| {
        let mut decoder = Decoder::new();
        decoder.push(bytes);
        answers.push((to, decoder.next_frame().expect("whole").message().expect("valid")));
        true
    });
    let expected = TIMESYNC_DATA {
        tc1: world.now.as_ns() as i64,
        ts1: 12_345,
        target_system: 1,
        target_component: 1,
    };
    assert_eq!(answers, [(Some(VEHICLE), MavMessage::TIMESYNC(expected))]);
}

/// What a session sends now.
fn sent(world: &mut World) -> Vec<MavMessage> {
    let mut sent = Vec::new();
    world.session.transmit(|_, bytes| {
        let mut decoder = Decoder::new();
        decoder.push(bytes);
        sent.push(decoder.next_frame().expect("whole").message().expect("valid"));
        true
    });
    sent
}

/// A bridge of poses answers with the vehicle's own time, so that stamps of that need no conversion.
#[test]
fn a_pose_goes_out_in_the_vehicles_time_which_timesync_tells_it_too() {
    let settings = Settings { answers_in_vehicle_time: true, ..settings() };
    let (mut world, mut vehicle) = (World::new(settings), Vehicle::new(1));
    let pose = |time| ExternalPose {
        time,
        position: Ned::new(1.0, 2.0, -3.0),
        attitude: Attitude::default(),
        position_deviation_m: 0.01,
        attitude_deviation_rad: 0.01,
        reset_count: 0,
    };
    assert!(
        !world.session.send_pose(&pose(VehicleTime::from_us(1)), PoseForm::Vision),
        "nobody is there"
    );
    world.run(&mut vehicle, seconds(2.0));
    sent(&mut world);
    let boot_us = vehicle.boot(world.now).as_micros() as i64;
    let request = TIMESYNC_DATA { tc1: 0, ts1: 12_345, ..Default::default() };
    let bytes = vehicle.encode(&MavMessage::TIMESYNC(request));
    world.deliver(VEHICLE, &bytes);
    let clock = world.session.clock().expect("it answers TIMESYNC");
    assert!(world.session.send_pose(&pose(clock.to_vehicle(world.now)), PoseForm::Vision));
    let (mut told, mut posed) = (None, None);
    for message in sent(&mut world) {
        match message {
            MavMessage::TIMESYNC(answer) if answer.ts1 == 12_345 => told = Some(answer.tc1 / 1000),
            MavMessage::VISION_POSITION_ESTIMATE(pose) => posed = Some(pose.usec as i64),
            _ => {}
        }
    }
    for found_us in [told, posed] {
        let off_us = found_us.expect("it is sent") - boot_us;
        assert!(off_us.abs() < 1000, "{off_us} us off");
    }
}

#[test]
fn broken_content_is_counted_and_not_passed_on() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.messages.len();
    let broken = ATTITUDE_QUATERNION_DATA { q1: f32::NAN, ..Default::default() };
    let mut bytes = vehicle.encode(&MavMessage::ATTITUDE_QUATERNION(broken));
    world.deliver(VEHICLE, &bytes);
    assert_eq!(world.session.stats().refused, 1);
    *bytes.last_mut().expect("not empty") ^= 0xFF;
    world.deliver(VEHICLE, &bytes);
    world.deliver(VEHICLE, b"garbage");
    assert_eq!(world.session.stats().received.crc_errors, 1);
    assert_eq!(world.messages.len(), heard);
    // The next whole frame is heard as ever.
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &bytes);
    let last = world.messages.last().map(|received| &received.message);
    assert!(matches!(last, Some(Inbound::Heartbeat { autopilot: 12, .. })));
}

#[test]
fn payloads_of_a_wrong_length_are_padded_cut_or_refused_and_never_end_the_session() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let level = ATTITUDE_QUATERNION_DATA { q1: 1.0, ..Default::default() };
    let honest = vehicle.encode(&MavMessage::ATTITUDE_QUATERNION(level));
    let extra_crc = <MavMessage as mavlink::Message>::extra_crc(ATTITUDE_QUATERNION);
    let (heard, refused) = (world.messages.len(), world.session.stats().refused);
    for len in 0..=u8::MAX {
        let mut bytes = honest.clone();
        bytes.truncate(bytes.len() - 2);
        bytes.resize(10 + usize::from(len), 0);
        bytes[1] = len;
        bytes.extend(mavlink::calculate_crc(&bytes[1..], extra_crc).to_le_bytes());
        world.deliver(VEHICLE, &bytes);
    }
    // Without all of q1 there is no attitude; without the zeros that follow there is.
    let refused = world.session.stats().refused - refused;
    assert_eq!((refused, world.messages.len() - heard), (8, 256 - 8));
    assert_eq!(world.session.state(), LinkState::Connected);
}

#[test]
fn streams_of_several_peers_do_not_mix() {
    let mut session = Session::new(settings(), START);
    let mut vehicle = Vehicle::new(1);
    let frame = vehicle.encode(&vehicle.heartbeat());
    let (first, rest) = frame.split_at(9);
    let mut count = 0;
    let mut on = |heard: Heard<'_>| count += usize::from(matches!(heard, Heard::Frame { .. }));
    session.receive(START, VEHICLE, first, false, &mut on);
    session.receive(START, STRANGER, first, false, &mut on);
    session.receive(START, VEHICLE, rest, false, &mut on);
    session.receive(START, STRANGER, rest, false, &mut on);
    assert_eq!(count, 2);
    assert_eq!(session.stats().received.unframed_bytes, 0);
}

#[test]
fn a_serial_line_is_asked_for_what_it_has_room_for() {
    let over = |baud| Settings { telemetry: None, baud, ..settings() };
    let asked = |world: &World, vehicle: &Vehicle| {
        let hz = |id| vehicle.periods.get(&id).map(|period| (1.0 / period.as_secs_f64()).round());
        let news = world.events.iter().find_map(|event| match event {
            Event::LineBudget(budget) => Some(budget.to_string()),
            _ => None,
        });
        // ATTITUDE_QUATERNION, LOCAL_POSITION_NED, ODOMETRY, HIGHRES_IMU.
        ([31, 32, 331, 105].map(hz), news)
    };
    let cases = [
        (None, [Some(250.0), Some(100.0), Some(100.0), Some(250.0)]),
        (Some(921_600), [Some(250.0), Some(100.0), Some(100.0), Some(100.0)]),
        (Some(115_200), [Some(50.0), Some(50.0), None, Some(25.0)]),
    ];
    for (baud, expected) in cases {
        let (mut world, mut vehicle) = (World::new(over(baud)), Vehicle::new(1));
        world.run(&mut vehicle, seconds(3.0));
        let (rates, news) = asked(&world, &vehicle);
        assert_eq!(rates, expected, "{baud:?}");
        assert_eq!(news.is_some(), baud.is_some(), "{baud:?}: {news:?}");
    }
}

/// The modes that the session handed on, in order.
fn modes(world: &World) -> Vec<u32> {
    let modes = world.messages.iter().filter_map(|received| match received.message {
        Inbound::Heartbeat { custom_mode, .. } | Inbound::CurrentMode { custom_mode, .. } => {
            Some(custom_mode)
        }
        _ => None,
    });
    modes.collect()
}

#[test]
fn a_second_radio_never_brings_back_an_older_mode() {
    for lag in [1usize, 40, 130, 256, 300, 700] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(2.0));
        let before = world.messages.len();
        let mut sent: Vec<Vec<u8>> = Vec::new();
        for k in 0..3000u32 {
            if k == 1500 {
                vehicle.custom_mode = 0x0304_0001;
            }
            let message = if k % 200 == 0 {
                vehicle.heartbeat()
            } else {
                MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                    time_boot_ms: vehicle.boot(world.now).as_millis() as u32,
                    q1: 1.0,
                    ..Default::default()
                })
            };
            sent.push(vehicle.encode(&message));
            world.deliver(VEHICLE, &sent[k as usize]);
            if let Some(old) = (k as usize).checked_sub(lag) {
                world.deliver(VEHICLE, &sent[old]);
            }
            world.now = world.now + Duration::from_millis(2);
        }
        let told = modes(&world);
        let first = told.iter().position(|mode| *mode == 0x0304_0001).expect("told");
        let older = told[first..].iter().filter(|mode| **mode != 0x0304_0001).count();
        assert_eq!(older, 0, "lag {lag}");
        assert_eq!(world.messages.len() - before, 3000, "lag {lag}: each once");
        assert_eq!(world.session.stats().lost, 0, "lag {lag}");
    }
}

#[test]
fn an_overtaken_heartbeat_is_older_than_the_mode_that_is_known() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let old = vehicle.encode(&vehicle.heartbeat());
    vehicle.custom_mode = OFFBOARD;
    let new = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &new);
    world.deliver(VEHICLE, &old);
    assert_eq!(modes(&world).last(), Some(&OFFBOARD));
    // What was merely overtaken by something else is news.
    vehicle.custom_mode = 0x0304_0000;
    let mode = vehicle.encode(&vehicle.heartbeat());
    let other = vehicle.encode(&vehicle.parameter_value());
    world.deliver(VEHICLE, &other);
    world.deliver(VEHICLE, &mode);
    assert_eq!(modes(&world).last(), Some(&0x0304_0000));
}

/// A HEARTBEAT of these ids.
fn heartbeat_of(system: u8, component: u8, autopilot: MavAutopilot, mavtype: MavType) -> Vec<u8> {
    let data = HEARTBEAT_DATA { autopilot, mavtype, ..Default::default() };
    let mut bytes = Vec::new();
    Encoder::new(system, component).encode(&MavMessage::HEARTBEAT(data), &mut bytes);
    bytes
}

#[test]
fn a_companion_with_the_autopilots_ids_says_nothing_of_the_vehicle() {
    use MavAutopilot::{MAV_AUTOPILOT_GENERIC, MAV_AUTOPILOT_INVALID};
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = modes(&world).len();
    for (autopilot, mavtype) in [
        (MAV_AUTOPILOT_INVALID, MavType::MAV_TYPE_ONBOARD_CONTROLLER),
        (MAV_AUTOPILOT_INVALID, MavType::MAV_TYPE_QUADROTOR),
        (MAV_AUTOPILOT_GENERIC, MavType::MAV_TYPE_GIMBAL),
        (MAV_AUTOPILOT_GENERIC, MavType::MAV_TYPE_QUADROTOR),
    ] {
        world.deliver(VEHICLE, &heartbeat_of(1, 1, autopilot, mavtype));
    }
    assert_eq!(modes(&world).len(), heard);
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.autopilot), Some(12));
}

#[test]
fn a_known_autopilot_takes_the_place_of_an_unknown_one_and_never_the_other_way() {
    use MavAutopilot::MAV_AUTOPILOT_GENERIC;
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    let unknown = heartbeat_of(1, 154, MAV_AUTOPILOT_GENERIC, MavType::MAV_TYPE_GENERIC);
    world.deliver(VEHICLE, &unknown);
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.component), Some(154));
    world.run(&mut vehicle, seconds(2.0));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.component), Some(1));
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    world.deliver(VEHICLE, &unknown);
    world.run(&mut vehicle, seconds(1.0));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.component), Some(1));
    assert!(!world.events.iter().any(|e| matches!(e, Event::AnotherAutopilot { .. })));
}

#[test]
fn two_autopilots_are_both_named_once() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(2));
    world.run(&mut vehicle, seconds(1.5));
    let mut other = Vehicle::new(1);
    for _ in 0..3 {
        let bytes = other.encode(&other.heartbeat());
        world.deliver(STRANGER, &bytes);
        world.run(&mut vehicle, seconds(0.5));
    }
    let named: Vec<_> = world
        .events
        .iter()
        .filter_map(|event| match event {
            Event::AnotherAutopilot { vehicle, other } => Some((vehicle.system, other.system)),
            _ => None,
        })
        .collect();
    assert_eq!(named, [(2, 1)]);
    assert_eq!(world.session.others().len(), 1);
    // Where one was chosen there is nothing to ask.
    let mut world = World::new(Settings { vehicle_system: Some(2), ..settings() });
    world.run(&mut vehicle, seconds(1.5));
    let bytes = other.encode(&other.heartbeat());
    world.deliver(STRANGER, &bytes);
    assert!(world.session.others().is_empty());
}

#[test]
fn a_signed_vehicle_is_known_by_its_first_frame() {
    let mut world = World::new(settings());
    let vehicle = &mut Vehicle::new(1);
    let mut bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &bytes);
    assert!(!world.session.is_signed());
    // The flag, the checksum over it, and a signature, which is not checked here.
    bytes[2] = 1;
    let extra_crc = <MavMessage as mavlink::Message>::extra_crc(0);
    let end = bytes.len() - 2;
    let crc = mavlink::calculate_crc(&bytes[1..end], extra_crc).to_le_bytes();
    bytes[end..].copy_from_slice(&crc);
    bytes.extend([7; 13]);
    let mut world = World::new(settings());
    world.deliver(VEHICLE, &bytes);
    assert!(world.session.is_signed());
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.system), Some(1));
}

#[test]
fn a_vehicle_that_speaks_mavlink_1_only_is_spoken_to_in_it() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    vehicle.encoder.set_version(mavlink::MavlinkVersion::V1);
    vehicle.version = None;
    world.run(&mut vehicle, seconds(4.0));
    assert_eq!(world.session.protocol(), Some(1));
    world.session.send_setpoint(world.now, &cleared(world.now, 0.0)).expect("sent");
    let mut markers = Vec::new();
    world.session.transmit(|_, bytes| {
        markers.push(bytes[0]);
        true
    });
    assert_eq!(markers.last(), Some(&mavlink::MAV_STX), "{markers:?}");
}
