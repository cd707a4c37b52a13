//! From samples of one body to poses, with every fault of a room.

use std::time::Duration;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{Bridge, News, Pose};
use crate::clock::HostTime;
use crate::mocap::fault::Fault;
use crate::mocap::room_frame::Up;
use crate::mocap::sample::Sample;
use crate::mocap::settings::{MocapSettings, WatchSettings};

const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
/// The room's clock, less the host's time since the start, s.
const APART_S: f64 = 5000.0;

struct Room {
    bridge: Bridge,
    rng: Pcg64Mcg,
}

impl Room {
    fn new() -> Self {
        Self::with(MocapSettings::default())
    }

    fn with(settings: MocapSettings) -> Self {
        Self {
            bridge: Bridge::new("quad".to_owned(), settings, START),
            rng: Pcg64Mcg::seed_from_u64(1),
        }
    }

    /// The sample of a body at rest at (1, 2, 3) at time `t`, with noise.
    fn sample(&mut self, t: f64) -> Sample {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|_| 1e-4 * (self.rng.random::<f64>() - 0.5));
        Sample {
            body: "quad".to_owned(),
            captured_s: t + APART_S,
            sent_s: None,
            position_m: [1.0 + x, 2.0 + y, 3.0 + z],
            rotation: [1.0, 0.0, 0.0, 0.0],
            is_tracked: true,
        }
    }

    fn give(&mut self, arrives: f64, sample: &Sample) -> Option<Pose> {
        self.bridge.take(at(arrives), sample, true)
    }

    /// Samples at 100 Hz from `from` to `to`, each delayed by 2 ms; returns the poses to forward.
    fn run(&mut self, from: f64, to: f64) -> Vec<Pose> {
        let count = ((to - from) * 100.0).round() as u32;
        let times = (0..count).map(|k| from + 0.01 * f64::from(k));
        times
            .filter_map(|t| {
                let sample = self.sample(t);
                self.give(t + 0.002, &sample)
            })
            .collect()
    }

    fn news(&mut self) -> Vec<News> {
        std::iter::from_fn(|| self.bridge.next_news()).collect()
    }
}

fn at(t: f64) -> HostTime {
    START + Duration::from_secs_f64(t)
}

#[test]
fn body_is_forwarded_at_its_rate_in_vehicle_axes() {
    let mut room = Room::new();
    assert!(room.run(0.0, 0.9).is_empty(), "the body must be visible for a second");
    assert_eq!(room.news(), []);
    room.run(0.9, 2.0);
    assert_eq!(room.news(), [News::Accepted]);
    let poses = room.run(2.0, 6.0);
    assert_eq!(poses.len(), 200, "50 Hz of 100");
    for pose in &poses {
        assert!((pose.position.to_array()[1] + 2.0).abs() < 1e-3 && pose.reset_count == 0);
    }
    // The stamp is late by the unknowable 2 ms, and the latency setting removes them.
    let off = poses[10].at.since(at(2.2)).as_secs_f64();
    assert!((off - 0.002).abs() < 3e-4, "{off}");
    let mut room = Room::with(MocapSettings { latency_s: 0.002, up: Up::Y, ..Default::default() });
    room.run(0.0, 2.0);
    let pose = room.run(2.0, 2.1)[0];
    let off = pose.at.since(at(2.0)).as_secs_f64();
    assert!(off < 3e-4, "{off}");
    assert!((pose.position.down() + 2.0).abs() < 1e-3, "y is up");
}

#[test]
fn forwarding_rate_is_capped_at_any_room_rate() {
    for (room_hz, expected) in [(30.0, 300..=300), (120.0, 490..=500), (333.0, 490..=500)] {
        let mut room = Room::new();
        let mut forwarded = 0;
        for k in 0..(12.0 * room_hz) as u32 {
            let t = f64::from(k) / room_hz;
            let sample = room.sample(t);
            let pose = room.give(t + 0.002, &sample);
            forwarded += usize::from(pose.is_some() && t >= 2.0);
        }
        assert!(expected.contains(&forwarded), "{room_hz} Hz: {forwarded}");
    }
}

/// Each fault of a single sample: it is not forwarded, is counted, and is reported once. The next
/// sample is forwarded again.
#[test]
fn faulty_samples_are_dropped_and_reported_once() {
    let wrong = |change: fn(&mut Sample)| {
        let mut room = Room::new();
        room.run(0.0, 2.0);
        room.news();
        for k in 0..5 {
            let t = 2.0 + 0.01 * f64::from(k);
            let mut sample = room.sample(t);
            change(&mut sample);
            assert_eq!(room.give(t + 0.002, &sample), None);
        }
        let news = room.news();
        let after = room.run(2.05, 3.0).len();
        (news, room.bridge.tally().faults, after)
    };
    type Spoil = fn(&mut Sample);
    let cases: [(Fault, Spoil); 8] = [
        (Fault::NotANumber, |s| s.position_m[1] = f64::NAN),
        (Fault::NotANumber, |s| s.captured_s = f64::INFINITY),
        (Fault::NotAUnit, |s| s.rotation = [0.0; 4]),
        (Fault::NotAUnit, |s| s.rotation = [1.0, 0.2, 0.0, 0.0]),
        (Fault::NotTracked, |s| s.is_tracked = false),
        (Fault::OutOfOrder, |s| s.captured_s -= 0.2),
        (Fault::Ahead, |s| s.captured_s += 3.0),
        (Fault::Jumped, |s| s.position_m[0] += 1.0),
    ];
    for (fault, change) in cases {
        let (news, faults, after) = wrong(change);
        assert_eq!(news, [News::Fault(fault, None)], "{fault:?}");
        let settling = if fault == Fault::Jumped { 4 } else { 0 };
        assert_eq!(faults.of(fault), 5 - settling, "{fault:?}");
        assert!((30..=48).contains(&after), "{fault:?}: {after} after it");
    }
}

#[test]
fn old_frames_are_tracked_but_not_forwarded() {
    let mut room = Room::new();
    room.run(0.0, 2.0);
    room.news();
    for k in 0..50 {
        let t = 2.0 + 0.01 * f64::from(k);
        let sample = room.sample(t);
        assert_eq!(room.give(t + 0.15, &sample), None);
    }
    assert_eq!(room.news(), [News::Fault(Fault::Old, None)]);
    assert!(room.bridge.holds(), "the position is still known");
    let after = room.run(2.65, 3.65).len();
    assert_eq!(after, 50);
}

#[test]
fn frozen_and_silent_rooms_are_reported() {
    let mut room = Room::new();
    room.run(0.0, 2.0);
    let frozen = room.sample(2.0);
    room.news();
    for k in 0..100 {
        let t = 2.0 + 0.01 * f64::from(k);
        let pose = room.give(t + 0.002, &Sample { captured_s: t + APART_S, ..frozen.clone() });
        assert!(k == 0 || pose.is_none());
    }
    assert_eq!(room.news(), [News::Fault(Fault::Frozen, None)]);
    assert_eq!(room.bridge.tally().losses, 1);

    let mut room = Room::new();
    room.run(0.0, 2.0);
    room.news();
    room.bridge.tick(at(2.1));
    assert_eq!(room.news(), []);
    room.bridge.tick(at(2.3));
    room.bridge.tick(at(2.4));
    assert_eq!(room.news(), [News::Fault(Fault::Silent, None)]);
    let tally = room.bridge.tally();
    assert_eq!((tally.losses, tally.faults.silent), (1, 1));
    assert!(room.run(2.5, 4.0).len() > 60, "it returns to where it was");
}

#[test]
fn room_is_never_silent_with_a_gap_beyond_any_time() {
    let watch = WatchSettings { gap_s: 1e300, ..Default::default() };
    let mut room = Room::with(MocapSettings { watch, ..Default::default() });
    room.run(0.0, 2.0);
    room.bridge.tick(at(1e6));
    assert!(room.bridge.holds());
}

/// A restarted room has a different clock. It is accepted after a second, with the body where it
/// was.
#[test]
fn restarted_room_is_accepted_again() {
    let mut room = Room::new();
    room.run(0.0, 2.0);
    room.news();
    let mut forwarded = 0;
    for k in 0..300 {
        let t = 2.0 + 0.01 * f64::from(k);
        let mut sample = room.sample(t);
        sample.captured_s -= 4000.0;
        forwarded += usize::from(room.give(t + 0.002, &sample).is_some());
    }
    assert_eq!(room.news(), [News::Fault(Fault::OutOfOrder, None), News::ClockSet, News::Accepted]);
    assert!(forwarded > 70, "{forwarded}");
}

#[test]
fn reason_for_waiting_is_reported() {
    let mut room = Room::new();
    let reason = |room: &Room, t| room.bridge.waits_for(at(t)).unwrap_or_default();
    assert!(reason(&room, 1.0).contains("nothing arrives"));
    let mut other = room.sample(1.0);
    other.body = "cart".to_owned();
    room.give(1.0, &other);
    assert!(reason(&room, 1.1).contains("\"cart\" (--body)"), "{}", reason(&room, 1.1));
    room.run(1.2, 1.5);
    assert!(reason(&room, 1.5).contains("steady"));
    room.run(1.5, 3.0);
    assert_eq!(room.bridge.waits_for(at(3.0)), None);
    assert_eq!(room.bridge.tally().others, 1);
}
