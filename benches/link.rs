//! Cost of the link in the control path: a telemetry datagram in, a setpoint frame out.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use downwash::clock::HostTime;
use downwash::control::Limits;
use downwash::guard::{Answered, Cleared, Guard, Obeys, Order, Proposal, Stance};
use downwash::link::attitude_target::ThrustMap;
use downwash::link::session::{Session, Settings};
use downwash::setpoint::Setpoint;
use wire::dialect::*;
use wire::signing::{KEY_LEN, Key, Signer, Stamp, Verifier, VerifierSettings};
use wire::transport::Peer;
use wire::{Encoder, Frame};

const NOW: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
const VEHICLE: Peer = Peer::new(0);

fn frame(encoder: &mut Encoder, message: MavMessage) -> Vec<u8> {
    let mut bytes = Vec::new();
    encoder.encode(&message, &mut bytes);
    bytes
}

/// A setpoint that may be sent.
fn cleared(now: HostTime) -> Cleared {
    let mut guard = Guard::new(Limits::default(), 20.0, now);
    let setpoint = Setpoint { thrust_n: 9.81, ..Setpoint::default() };
    let sample = Answered { host: now, ..Answered::default() };
    let order = Order { stance: Stance::Offer, obeys: Obeys::No };
    guard.propose(now, &Proposal { setpoint, sample }, order).expect("permitted");
    guard.clear(now, order).expect("permitted")
}

/// A session with an identified vehicle.
fn session(encoder: &mut Encoder) -> Session {
    let thrust = ThrustMap::linear(20.0).expect("a positive thrust");
    let mut session = Session::new(Settings::new(thrust), NOW);
    let heartbeat = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        ..Default::default()
    };
    for message in [
        MavMessage::HEARTBEAT(heartbeat),
        MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA::default()),
    ] {
        session.receive(NOW, VEHICLE, &frame(encoder, message), true, &mut |_| {});
    }
    session.transmit(|_, _| true);
    session
}

fn link(criterion: &mut Criterion) {
    let mut encoder = Encoder::new(1, 1);
    let mut session = session(&mut encoder);
    let odometry = MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: 1_000_000,
        q: [1.0, 0.0, 0.0, 0.0],
        // The longest possible frame.
        pose_covariance: [0.1; 21],
        velocity_covariance: [0.1; 21],
        frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
        child_frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
        quality: 100,
        ..Default::default()
    });
    let datagram = frame(&mut encoder, odometry);
    let setpoint = cleared(NOW);
    criterion.bench_function("odometry datagram to message", |bencher| {
        bencher.iter(|| {
            session.receive(NOW, VEHICLE, black_box(&datagram), true, &mut |delivery| {
                black_box(&delivery);
            });
        });
    });
    criterion.bench_function("setpoint to frame", |bencher| {
        bencher.iter(|| {
            session.send_setpoint(NOW, black_box(&setpoint)).expect("the vehicle is identified");
            session.transmit(|_, bytes| {
                black_box(bytes);
                true
            });
        });
    });
}

/// Cost of a signature for a frame of typical length.
fn sign(criterion: &mut Criterion) {
    let key = Key::new([7; KEY_LEN]);
    let now = Stamp::from_unix_ns(NOW.as_ns());
    let attitude = MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        q1: 1.0,
        yawspeed: 0.1,
        repr_offset_q: [1.0; 4],
        ..Default::default()
    });
    let mut plain = Encoder::new(1, 1);
    let mut signed = Encoder::new(1, 1);
    signed.set_signer(Some(Signer::new(key.clone(), 0, now)));
    for (name, encoder) in
        [("frame without a signature", &mut plain), ("sign a frame", &mut signed)]
    {
        let mut bytes = Vec::new();
        criterion.bench_function(name, |bencher| {
            bencher.iter(|| {
                bytes.clear();
                encoder.encode(black_box(&attitude), &mut bytes);
            });
        });
    }
    let frame = Frame::parse(&frame(&mut signed, attitude)).expect("a frame");
    let settings =
        VerifierSettings { key, unsigned: vec![], ahead_max: 60 * Stamp::PER_S, streams: vec![] };
    let mut verifier = Verifier::new(settings, now);
    // The verifier accepts only the first frame, but computes the hash of each.
    criterion.bench_function("check a signature", |bencher| {
        bencher.iter(|| black_box(verifier.check(black_box(&frame))));
    });
}

criterion_group!(benches, link, sign);
criterion_main!(benches);
