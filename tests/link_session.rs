//! Streams, requests, time synchronisation and damaged frames between the session and its vehicle.

use std::time::Duration;

use downwash::clock::VehicleTime;
use downwash::link::counters::LinkState;
use downwash::link::external_pose::{ExternalPose, PoseForm};
use downwash::link::intervals::IntervalEvent;
use downwash::link::request::{FlightMode, Outcome, Request};
use downwash::link::session::{Delivery, Event, Session, Settings};
use downwash::link::vehicle_clock::ClockSource;
use message::Inbound;
use vehicle::frame::{Attitude, Ned};
use wire::Decoder;
use wire::dialect::*;

use crate::link_world::*;

#[test]
fn clock_converges_despite_asymmetric_jitter() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    // Answers are up to 37 ms late; one in eight is immediate.
    vehicle.reply_delay = |n| match n % 8 {
        0 => Duration::ZERO,
        n => Duration::from_millis(u64::from(n * 7919 % 38)),
    };
    world.run(&mut vehicle, seconds(8.0));
    let clock = world.session.clock().expect("known");
    assert_eq!(clock.source, ClockSource::Timesync);
    let truth = 30_000_000_000 - START.as_ns() as i64;
    let error = (clock.offset_ns - truth).unsigned_abs();
    // The virtual clock steps by a millisecond, so an immediate answer takes one.
    assert!(error <= 1_000_000, "{error} ns");
}

#[test]
fn lowered_rate_is_requested_again() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    // Another ground station lowers the rate.
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
fn requests_are_repeated_and_modes_verified() {
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
fn vehicle_timesync_is_answered_from_the_host_clock() {
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

/// The messages that the session has ready to send.
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

/// A pose bridge answers TIMESYNC in vehicle time, so poses stamped in it need no conversion.
#[test]
fn pose_and_timesync_answers_use_vehicle_time() {
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
        "no vehicle is known"
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

/// Frames from before the restart may still be on their way: until the vehicle reports its mode
/// again, nothing may rely on it.
#[test]
fn one_timesync_answer_from_a_restarted_vehicle_puts_the_mode_in_doubt() {
    for restarted_s in [Some(0.05), Some(1e6), None] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(2.0));
        sent(&mut world);
        world.now = world.now + seconds(0.2);
        world.session.poll(world.now);
        let request = sent(&mut world).into_iter().find_map(|message| match message {
            MavMessage::TIMESYNC(request) if request.tc1 == 0 => Some(request.ts1),
            _ => None,
        });
        let boot_s = vehicle.boot(world.now).as_secs_f64();
        let tc1 = (restarted_s.unwrap_or(boot_s) * 1e9) as i64;
        let answer = TIMESYNC_DATA { tc1, ts1: request.expect("due"), ..Default::default() };
        let bytes = vehicle.encode(&MavMessage::TIMESYNC(answer));
        let before = world.messages.len();
        world.deliver(VEHICLE, &bytes);
        let doubts = world.messages[before..]
            .iter()
            .filter(|received| received.message == Inbound::DoubtfulMode)
            .count();
        assert_eq!(doubts, usize::from(restarted_s.is_some()), "{restarted_s:?}");
    }
}

#[test]
fn invalid_content_is_counted_and_not_forwarded() {
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
    // The next intact frame is received.
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &bytes);
    let last = world.messages.last().map(|received| &received.message);
    assert!(matches!(last, Some(Inbound::Heartbeat { autopilot: 12, .. })));
}

#[test]
fn payloads_of_any_length_never_end_the_session() {
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
    // Payloads that end before q1 does are refused; fields after it default to zero.
    let refused = world.session.stats().refused - refused;
    assert_eq!((refused, world.messages.len() - heard), (8, 256 - 8));
    assert_eq!(world.session.state(), LinkState::Connected);
}

#[test]
fn byte_streams_of_several_peers_do_not_mix() {
    let mut session = Session::new(settings(), START);
    let mut vehicle = Vehicle::new(1);
    let frame = vehicle.encode(&vehicle.heartbeat());
    let (first, rest) = frame.split_at(9);
    let mut count = 0;
    let mut on =
        |delivery: Delivery<'_>| count += usize::from(matches!(delivery, Delivery::Frame { .. }));
    session.receive(START, VEHICLE, first, false, &mut on);
    session.receive(START, STRANGER, first, false, &mut on);
    session.receive(START, VEHICLE, rest, false, &mut on);
    session.receive(START, STRANGER, rest, false, &mut on);
    assert_eq!(count, 2);
    assert_eq!(session.stats().received.unframed_bytes, 0);
}

#[test]
fn requested_rates_fit_the_serial_line() {
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

#[test]
fn second_radio_never_restores_an_older_mode() {
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
        let told = world.modes();
        let first = told.iter().position(|mode| *mode == 0x0304_0001).expect("told");
        let older = told[first..].iter().filter(|mode| **mode != 0x0304_0001).count();
        assert_eq!(older, 0, "lag {lag}");
        assert_eq!(world.messages.len() - before, 3000, "lag {lag}: each once");
        assert_eq!(world.session.stats().lost, 0, "lag {lag}");
    }
}

#[test]
fn overtaken_heartbeat_does_not_replace_the_known_mode() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let old = vehicle.encode(&vehicle.heartbeat());
    vehicle.custom_mode = OFFBOARD;
    let new = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &new);
    world.deliver(VEHICLE, &old);
    assert_eq!(world.modes().last(), Some(&OFFBOARD));
    // A mode that only other messages overtook is new.
    vehicle.custom_mode = 0x0304_0000;
    let mode = vehicle.encode(&vehicle.heartbeat());
    let other = vehicle.encode(&vehicle.parameter_value());
    world.deliver(VEHICLE, &other);
    world.deliver(VEHICLE, &mode);
    assert_eq!(world.modes().last(), Some(&0x0304_0000));
}
