//! Which sender the session takes for its vehicle, and when it identifies the vehicle again.

use downwash::link::counters::LinkState;
use downwash::link::profile::Profile;
use downwash::link::request::{FlightMode, Outcome, Request};
use downwash::link::session::{Event, SetpointError, Settings};
use downwash::link::several;
use wire::Encoder;
use wire::dialect::*;

use crate::link_world::*;

#[test]
fn vehicle_is_identified_and_streams_as_requested() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    let found = world.session.vehicle().expect("found");
    assert_eq!((found.system, found.component, found.peer), (1, 1, VEHICLE));
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    assert_eq!(world.states(), [LinkState::Connected]);
    assert_eq!(vehicle.requests_of_interval, 1, "a rate that is met is not requested again");
    let stats = world.session.stats();
    let attitude = stats.messages.iter().find(|message| message.id == ATTITUDE_QUATERNION);
    assert!((attitude.expect("counted").rate_hz - 100.0).abs() < 2.0);
    assert_eq!((stats.foreign, stats.stray, stats.refused, stats.lost), (0, 0, 0, 0));
    assert!((4..=6).contains(&vehicle.heartbeats_heard));
    assert_eq!(world.frames as u64, stats.received.frames);
}

#[test]
fn vehicle_without_a_version_gets_the_safe_setpoint_form() {
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
fn other_senders_never_replace_the_vehicle() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.messages.len();

    // Another autopilot, a ground station, and a sender elsewhere with the vehicle's ids.
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
fn session_waits_for_the_configured_system() {
    let settings = Settings { vehicle_system: Some(3), ..settings() };
    let mut world = World::new(settings);
    world.run(&mut Vehicle::new(1), seconds(2.0));
    assert_eq!(world.session.vehicle(), None);
    assert_eq!(world.session.state(), LinkState::Searching);
    world.run(&mut Vehicle::new(3), seconds(2.0));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.system), Some(3));
}

#[test]
fn silent_link_goes_stale_then_lost_and_recovers_elsewhere() {
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
    assert_eq!(world.session.profile(), None, "it must be identified again");
}

#[test]
fn vehicle_is_found_again_at_once_after_its_connection_closes() {
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
fn new_connection_resets_loss_counting_but_silence_does_not() {
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
        // A tcp: connection reopens under the same peer number.
        let bytes = vehicle.encode(&vehicle.heartbeat());
        world.deliver(VEHICLE, &bytes);
        assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(VEHICLE));
        assert_eq!(world.session.stats().lost, if is_closed { 0 } else { 50 }, "{is_closed}");
    }
}

#[test]
fn vehicle_with_a_different_clock_is_identified_again() {
    // Booted now, or long before.
    for booted in [START + seconds(3.0), START - seconds(300.0)] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(3.0));
        assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
        // Another vehicle with the same ids must not get setpoints in the old one's form.
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
fn different_autopilot_with_the_same_ids_is_identified_again() {
    for is_silent in [true, false] {
        let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
        world.run(&mut vehicle, seconds(2.0));
        if is_silent {
            world.silence(seconds(3.0));
        }
        world.session.request(world.now, Request::SetMode(FlightMode::Offboard));
        world.session.transmit(|_, _| true);
        // Both booted at once, so their clocks do not distinguish them.
        vehicle.autopilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        let mode = vehicle.custom_mode;
        let bytes = vehicle.encode(&vehicle.heartbeat());
        world.deliver(VEHICLE, &bytes);
        assert_eq!(world.session.profile(), None);
        let early = world.session.send_setpoint(world.now, &cleared(world.now, 0.0));
        assert_eq!(early, Err(SetpointError::NotIdentified));
        world.run(&mut vehicle, seconds(2.0));
        assert_eq!(world.session.profile(), Some(&Profile::ARDUCOPTER), "{is_silent}");
        assert_eq!(vehicle.custom_mode, mode, "its mode numbers have other meanings");
        assert_eq!(world.outcomes(), [Outcome::Withdrawn]);
        let replaced = world.events.iter().any(|e| matches!(e, Event::VehicleReplaced(_)));
        assert!(replaced, "{:?}", world.events);
    }
}

#[test]
fn ground_station_with_an_autopilot_field_is_no_vehicle() {
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

/// A HEARTBEAT frame from these ids.
fn heartbeat_of(system: u8, component: u8, autopilot: MavAutopilot, mavtype: MavType) -> Vec<u8> {
    let data = HEARTBEAT_DATA { autopilot, mavtype, ..Default::default() };
    let mut bytes = Vec::new();
    Encoder::new(system, component).encode(&MavMessage::HEARTBEAT(data), &mut bytes);
    bytes
}

#[test]
fn heartbeats_of_a_companion_with_the_autopilots_ids_are_ignored() {
    use MavAutopilot::{MAV_AUTOPILOT_GENERIC, MAV_AUTOPILOT_INVALID};
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.modes().len();
    for (autopilot, mavtype) in [
        (MAV_AUTOPILOT_INVALID, MavType::MAV_TYPE_ONBOARD_CONTROLLER),
        (MAV_AUTOPILOT_INVALID, MavType::MAV_TYPE_QUADROTOR),
        (MAV_AUTOPILOT_GENERIC, MavType::MAV_TYPE_GIMBAL),
        (MAV_AUTOPILOT_GENERIC, MavType::MAV_TYPE_QUADROTOR),
    ] {
        world.deliver(VEHICLE, &heartbeat_of(1, 1, autopilot, mavtype));
    }
    assert_eq!(world.modes().len(), heard);
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.autopilot), Some(12));
}

#[test]
fn known_autopilot_replaces_an_unknown_one_only() {
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
fn second_autopilot_is_reported_once() {
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
    let choice = several::choice(&world.session).expect("a choice");
    assert!(choice.contains("--system 2 or --system 1"), "{choice}");
    // With a configured system there is no ambiguity to report.
    let mut world = World::new(Settings { vehicle_system: Some(2), ..settings() });
    world.run(&mut vehicle, seconds(1.5));
    let bytes = other.encode(&other.heartbeat());
    world.deliver(STRANGER, &bytes);
    assert!(world.session.others().is_empty());
    assert_eq!(several::choice(&world.session), None);
}

#[test]
fn signed_vehicle_is_recognised_by_its_first_frame() {
    let mut world = World::new(settings());
    let vehicle = &mut Vehicle::new(1);
    let mut bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &bytes);
    assert!(!world.session.is_signed());
    // The signing flag, its checksum, and a signature, which is not checked here.
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
fn mavlink_1_vehicle_is_addressed_in_mavlink_1() {
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
