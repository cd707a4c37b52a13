//! A link under load: garbage, a thousand peers, a thousand system ids; and a signed link.

use std::time::Duration;

use downwash::link::counters::LinkState;
use downwash::link::session::Event;
use downwash::link::signing::{Ledger, Remembered, SigningSettings};
use wire::Encoder;
use wire::dialect::*;
use wire::signing::{KEY_LEN, Key, Refused, Signer, Stamp};
use wire::transport::Peer;

use crate::link_world::*;

fn beat(system: u8, autopilot: MavAutopilot) -> Vec<u8> {
    let mut bytes = Vec::new();
    let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot,
        ..Default::default()
    });
    Encoder::new(system, 1).encode(&message, &mut bytes);
    bytes
}

#[test]
fn crowd_fills_bounded_tables_without_affecting_the_vehicle() {
    let settings = downwash::link::session::Settings { vehicle_system: Some(1), ..settings() };
    let (mut world, mut vehicle) = (World::new(settings), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let garbage: Vec<u8> =
        (0..1400_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for number in 0..2000_u32 {
        let peer = Peer::new(1000 + number % 1000);
        world.deliver(peer, &garbage);
        world.deliver(peer, &beat((number % 256) as u8, MavAutopilot::MAV_AUTOPILOT_PX4));
        // The same with 32-bit system ids, which MAVLink 2 has room for, and with everything in
        // pieces.
        world.deliver(peer, &garbage[..(number % 1400) as usize]);
        if number % 20 == 0 {
            world.run(&mut vehicle, STEP);
        }
    }
    assert!(world.session.senders().len() <= 32);
    assert!(world.session.others().len() <= 32);
    assert!(world.session.stats().messages.len() <= 32);
    assert_eq!(world.session.state(), LinkState::Connected);
    assert_eq!(world.session.vehicle_peer(), Some(VEHICLE));
    world.run(&mut vehicle, seconds(1.0));
    world
        .session
        .send_setpoint(world.now, &cleared(world.now, 1.0))
        .expect("the vehicle is still flown");
    let told = world.events.iter().filter(|event| matches!(event, Event::AnotherAutopilot { .. }));
    assert!(told.count() <= 32, "crowding peers are not reported one by one");
}

fn key() -> Key {
    Key::new([3; KEY_LEN])
}

fn signed(key: Key) -> SigningSettings {
    SigningSettings {
        key,
        link: 0,
        unsigned: vec![],
        ahead_max: Duration::from_secs(3600),
        before: Remembered::default(),
        ledger: Ledger::default(),
    }
}

#[test]
fn signed_session_accepts_only_its_key_and_reports_rejections() {
    let stamp = Stamp::from_unix_ns(START.as_ns());
    for (theirs, is_accepted) in [(key(), true), (Key::new([4; KEY_LEN]), false)] {
        let ours = signed(key());
        let ledger = ours.ledger.clone();
        let settings = downwash::link::session::Settings { signing: Some(ours), ..settings() };
        let (mut world, mut vehicle) = (World::new(settings), Vehicle::new(1));
        vehicle.encoder.set_signer(Some(Signer::new(theirs, 5, stamp)));
        world.deliver(STRANGER, &beat(2, MavAutopilot::MAV_AUTOPILOT_PX4));
        world.run(&mut vehicle, seconds(3.0));
        assert_eq!(world.session.vehicle().is_some(), is_accepted);
        let refused: Vec<_> = world.session.rejected_frames().filter(|(_, n)| *n > 0).collect();
        let whys: Vec<_> = refused.iter().map(|(why, _)| *why).collect();
        let told = world.events.iter().filter(|event| matches!(event, Event::FrameRejected(_)));
        if is_accepted {
            assert_eq!(whys, [Refused::Unsigned]);
            assert!(world.session.is_signed() && world.session.profile().is_some());
            // The state kept for the next run: the accepted streams and the newest timestamp.
            assert_eq!(ledger.get().streams.len(), 1);
            assert!(ledger.get().newest > stamp);
        } else {
            assert_eq!(whys, [Refused::Unsigned, Refused::Signature]);
            assert!(refused.iter().all(|(_, count)| *count >= 1));
        }
        assert_eq!(told.count(), whys.len(), "each reason once");
    }
}
