//! Verdicts of the watch on flying bodies and on faulty rooms.

use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use vehicle::frame::{Attitude, Euler, Ned};

use super::{Accepted, Seen, Watch};
use crate::mocap::fault::Fault;
use crate::mocap::settings::WatchSettings;

/// A body that flies at up to `speed`, seen with a room's noise.
struct Flight {
    rng: Pcg64Mcg,
    phases: [f64; 3],
    centre: Ned,
    speed: f64,
}

impl Flight {
    fn new(seed: u64, centre: Ned, speed: f64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let phases = std::array::from_fn(|_| rng.random_range(0.0..6.0));
        Self { rng, phases, centre, speed }
    }

    /// Circles of 0.7 m with a vertical weave, the tilt that they need, and 0.3 mm and 0.2 degrees
    /// of noise.
    fn at(&mut self, t: f64) -> Seen {
        let turn = self.speed / 0.7;
        let [a, b, c] = self.phases;
        let noise: [f64; 3] =
            std::array::from_fn(|_| 3e-4 * self.rng.sample::<f64, _>(StandardNormal));
        let way = Ned::new(
            0.7 * (turn * t + a).sin(),
            0.7 * (turn * t + b).cos(),
            0.3 * (0.7 * turn * t + c).sin(),
        );
        let tilt = (turn * turn * 0.7 / 9.81).atan();
        let shake: f64 = 3e-3 * self.rng.sample::<f64, _>(StandardNormal);
        let attitude =
            Euler::new(-tilt * (turn * t + a).sin() + shake, tilt * (turn * t + b).cos(), 0.3 * t);
        Seen {
            at_s: t,
            position: self.centre + way + Ned::from(noise),
            attitude: attitude.attitude(),
        }
    }
}

fn watch() -> Watch {
    Watch::new(WatchSettings::default())
}

/// Shows `flight` to `watch` at `rate` from `from` to `to`; returns the verdicts.
fn show(
    watch: &mut Watch,
    flight: &mut Flight,
    rate: f64,
    (from, to): (f64, f64),
) -> Vec<Result<Accepted, Fault>> {
    let count = ((to - from) * rate) as usize;
    (0..count).map(|k| watch.see(flight.at(from + k as f64 / rate), true)).collect()
}

fn accepted(verdicts: &[Result<Accepted, Fault>]) -> usize {
    verdicts.iter().filter(|verdict| verdict.is_ok()).count()
}

const HERE: Ned = Ned::new(0.0, 0.0, -1.0);
const ELSEWHERE: Ned = Ned::new(2.5, 0.5, -1.0);

/// An honest room's poses are never rejected after the start: 200 flights of 20 s at 60 to 240 Hz
/// and up to 3 m/s, with a second and a half at rest in each, are 600,000 poses.
#[test]
fn poses_of_a_healthy_room_are_accepted() {
    let mut poses = 0;
    for seed in 0..200 {
        let rate = [60.0, 100.0, 120.0, 240.0][seed as usize % 4];
        let mut flight = Flight::new(seed, HERE, 0.2 + 0.014 * seed as f64);
        let mut watch = watch();
        let settling = show(&mut watch, &mut flight, rate, (0.0, 1.1));
        assert!(settling.iter().any(Result::is_ok), "seed {seed} is never accepted");
        let verdicts = show(&mut watch, &mut flight, rate, (1.1, 20.0));
        poses += verdicts.len();
        let refused = verdicts.len() - accepted(&verdicts);
        assert_eq!(refused, 0, "seed {seed}: {:?}", verdicts.iter().find(|v| v.is_err()));
    }
    assert!(poses > 400_000, "{poses}");
}

/// Two bodies swap for a while. No pose is accepted from the first wrong one on, and the right ones
/// are accepted again once they return in time. Both fly. Where they are within the watch's reach
/// of each other, poses cannot show the swap, and that seed is skipped.
#[test]
fn swap_is_detected_at_once_and_ends_with_the_swap() {
    let (mut swaps, mut named) = (0, 0);
    for seed in 0..300u64 {
        let (mut own, mut other) =
            (Flight::new(seed, HERE, 1.0), Flight::new(seed + 1000, HERE, 0.8));
        let mut watch = watch();
        let begins = 3.0 + 0.01 * (seed % 50) as f64;
        let lasts = 0.25;
        let mut back = false;
        let apart = (own.at(begins).position - other.at(begins).position).norm();
        if apart < 0.4 {
            continue;
        }
        swaps += 1;
        for k in 0..600 {
            let t = 0.01 * f64::from(k);
            let (mut first, mut second) = (own.at(t), other.at(t));
            let is_swapped = t >= begins && t < begins + lasts;
            if is_swapped {
                std::mem::swap(&mut first, &mut second);
            }
            // Trackers report bodies in any order.
            if seed % 2 == 0 {
                watch.see_other("other", second);
            }
            let verdict = watch.see(first, true);
            if seed % 2 != 0 {
                watch.see_other("other", second);
            }
            if is_swapped {
                assert!(verdict.is_err(), "seed {seed} at {t}: {apart} m apart");
                named += usize::from(verdict == Err(Fault::Swapped));
            }
            back |= t > begins + lasts && verdict.is_ok();
        }
        // At 1 m/s on a circle of 0.7 m it is within 0.3 m of its expected position after that
        // time.
        assert!(back, "seed {seed} is not accepted again");
    }
    assert!(swaps > 200 && named == swaps, "{swaps} swaps, {named} named");
}

/// A lasting swap is never accepted, neither while the vehicle is armed nor on the ground.
#[test]
fn lasting_swap_is_never_accepted() {
    for (is_armed, is_last) in [(true, true), (false, true), (true, false), (false, false)] {
        let (mut own, mut other) = (Flight::new(1, HERE, 0.5), Flight::new(2, ELSEWHERE, 0.5));
        let mut watch = watch();
        for k in 0..2000 {
            let t = 0.01 * f64::from(k);
            let (mut first, mut second) = (own.at(t), other.at(t));
            if t >= 3.0 {
                std::mem::swap(&mut first, &mut second);
            }
            if is_last {
                watch.see_other("other", second);
            }
            let verdict = watch.see(first, is_armed);
            if !is_last {
                watch.see_other("other", second);
            }
            assert!(t < 3.0 || verdict.is_err(), "{t}");
        }
    }
}

#[test]
fn frozen_room_is_rejected_from_the_first_repetition() {
    for seed in 0..100 {
        let mut flight = Flight::new(seed, HERE, 1.0);
        let mut watch = watch();
        show(&mut watch, &mut flight, 100.0, (0.0, 3.0));
        let frozen = flight.at(3.0);
        assert!(watch.see(frozen, true).is_ok());
        for k in 1..200 {
            let at_s = 3.0 + 0.01 * f64::from(k);
            assert_eq!(watch.see(Seen { at_s, ..frozen }, true), Err(Fault::Frozen));
            assert_eq!(watch.is_frozen(at_s), k >= 10);
        }
        assert!(!watch.holds());
        // It moved on by 2 m meanwhile: too far and too long ago to be certain.
        let after = show(&mut watch, &mut flight, 100.0, (5.0, 9.0));
        assert_eq!(accepted(&after), 0, "seed {seed}");
    }
}

/// A hidden body returns to its expected position within half a second, or stays away for good.
#[test]
fn hidden_body_is_accepted_again_at_its_expected_position() {
    let (mut back, mut wrong) = (0, 0);
    for seed in 0..200 {
        let mut flight = Flight::new(seed, HERE, 0.5);
        let mut watch = watch();
        show(&mut watch, &mut flight, 100.0, (0.0, 3.0));
        watch.lose(Fault::Silent);
        let after = show(&mut watch, &mut flight, 100.0, (3.4, 5.0));
        back += usize::from(accepted(&after) > 50);
        // The other body's label appeared in its place.
        let mut flight = Flight::new(seed, HERE, 0.5);
        let mut watch = self::watch();
        show(&mut watch, &mut flight, 100.0, (0.0, 3.0));
        watch.lose(Fault::Silent);
        let mut other = Flight::new(seed, ELSEWHERE, 0.5);
        wrong += accepted(&show(&mut watch, &mut other, 100.0, (3.4, 9.0)));
    }
    assert_eq!((back, wrong), (200, 0));
}

/// A body that was carried elsewhere by hand while disarmed is accepted at its new place, and the
/// vehicle is notified of a restart.
#[test]
fn carried_body_is_accepted_anew_while_disarmed() {
    let mut flight = Flight::new(1, HERE, 0.2);
    let mut watch = watch();
    show(&mut watch, &mut flight, 100.0, (0.0, 3.0));
    let mut carried = Flight::new(1, ELSEWHERE, 0.2);
    assert_eq!(watch.see(carried.at(3.0), false), Err(Fault::Jumped));
    let verdicts: Vec<_> =
        (1..150).map(|k| watch.see(carried.at(3.0 + 0.01 * f64::from(k)), false)).collect();
    let first = verdicts.iter().position(Result::is_ok).expect("it is accepted");
    assert!((99..=102).contains(&first), "{first}");
    assert_eq!(verdicts[first], Ok(Accepted { is_anew: true }));
    assert_eq!(verdicts[first + 1], Ok(Accepted { is_anew: false }));
}

#[test]
fn sudden_attitude_flip_is_a_jump() {
    let mut flight = Flight::new(3, HERE, 0.5);
    let mut watch = watch();
    show(&mut watch, &mut flight, 100.0, (0.0, 3.0));
    let seen = flight.at(3.0);
    let over = Attitude { w: 0.0, x: 1.0, y: 0.0, z: 0.0 };
    let turned = Seen { attitude: seen.attitude.compose(over), ..seen };
    assert_eq!(watch.see(turned, true), Err(Fault::Jumped));
}

proptest! {
    /// A jump beyond the reach is detected at the first pose, in any direction.
    #[test]
    fn jump_is_detected_at_once(
        seed in 0..1000u64, north in -1.0..1.0f64, east in -1.0..1.0f64, down in -1.0..1.0f64,
        by in 0.1..5.0f64,
    ) {
        let way = Ned::new(north, east, down);
        prop_assume!(way.norm() > 0.1);
        let mut flight = Flight::new(seed, HERE, 1.5);
        let mut watch = watch();
        show(&mut watch, &mut flight, 100.0, (0.0, 2.0));
        let seen = flight.at(2.0);
        let jumped = Seen { position: seen.position + way * (by / way.norm()), ..seen };
        prop_assert_eq!(watch.see(jumped, true), Err(Fault::Jumped));
    }
}
