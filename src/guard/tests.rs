use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use proptest::prelude::*;
use vehicle::frame::Frd;

use super::*;

const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
const FULL_N: f64 = 10.0;
const OBEYED: Order = Order { stance: Stance::Control, obeys: Obeys::Yes };

fn guard() -> Guard {
    Guard::new(Limits::default(), FULL_N, START)
}

fn at(ms: u64) -> HostTime {
    START + Duration::from_millis(ms)
}

/// A level setpoint in answer to a sample that arrived at `ms`, with a matching stamp.
fn level(ms: u64) -> Proposal {
    let setpoint = Setpoint { thrust_n: 5.0, ..Setpoint::default() };
    let vehicle = VehicleTime::from_us(1000 * ms);
    Proposal { setpoint, sample: Answered { host: at(ms), vehicle, ..Answered::default() } }
}

impl Guard {
    fn pass(
        &mut self,
        now: HostTime,
        proposal: &Proposal,
        order: Order,
    ) -> Result<Cleared, Withheld> {
        self.propose(now, proposal, order)?;
        self.clear(now, order)
    }
}

#[test]
fn setpoint_without_permission_is_withheld() {
    let pass = |order| guard().pass(at(10), &level(10), order).is_ok();
    let passes =
        |stance| [Obeys::Unknown, Obeys::No, Obeys::Yes].map(|obeys| pass(Order { stance, obeys }));
    assert_eq!(passes(Stance::Silent), [false; 3]);
    assert_eq!(passes(Stance::Offer), [false, true, true], "an offer may be obeyed");
    assert_eq!(passes(Stance::Control), [false, false, true]);
}

#[test]
fn permission_revoked_after_the_proposal_withholds_it() {
    let mut guard = guard();
    guard.propose(at(10), &level(10), OBEYED).expect("permitted");
    assert_eq!(guard.clear(at(10), Order::default()), Err(Withheld::NotPermitted));
    assert_eq!(guard.clear(at(10), OBEYED), Err(Withheld::Nothing), "the proposal is gone");
}

#[test]
fn each_sample_is_answered_once_and_in_order() {
    let mut guard = guard();
    guard.pass(at(10), &level(10), OBEYED).expect("a first answer");
    assert_eq!(guard.clear(at(10), OBEYED), Err(Withheld::Nothing));
    assert_eq!(guard.pass(at(12), &level(10), OBEYED), Err(Withheld::Answered));
    let late = Proposal { sample: Answered { host: at(14), ..level(9).sample }, ..level(9) };
    assert_eq!(guard.pass(at(14), &late, OBEYED), Err(Withheld::Answered));
    guard.pass(at(20), &level(20), OBEYED).expect("the next");
    // The clock of a restarted vehicle counts from zero.
    guard.forget();
    let anew = Proposal { sample: Answered { host: at(30), ..level(1).sample }, ..level(1) };
    guard.pass(at(30), &anew, OBEYED).expect("another clock");
}

#[test]
fn stale_sample_is_not_answered() {
    let mut guard = guard();
    for ms in [20, 40, 60] {
        guard.turn(at(ms));
    }
    assert_eq!(guard.pass(at(71), &level(20), OBEYED), Err(Withheld::Stale));
    guard.pass(at(72), &level(72), OBEYED).expect("a fresh one");
}

#[test]
fn first_answer_after_a_stall_is_to_a_later_sample() {
    let mut guard = guard();
    guard.pass(at(10), &level(10), OBEYED).expect("before");
    guard.propose(at(20), &level(20), OBEYED).expect("before");
    // The control path stalls until 90 ms and finds unread samples, late according to the vehicle's
    // clock.
    for sampled in [30, 50, 70, 88] {
        let excess_delay_s = (90 - sampled) as f64 * 1e-3;
        let sample = Answered { host: at(90), excess_delay_s, ..level(sampled).sample };
        let found = Proposal { sample, ..level(sampled) };
        assert_eq!(guard.pass(at(90), &found, OBEYED), Err(Withheld::Stalled), "{sampled}");
    }
    // With misleading clocks they seem punctual: nothing proves otherwise until the backlog is
    // read.
    for (read, sampled) in [(90, 90), (99, 99)] {
        let found = guard.pass(at(read), &level(sampled), OBEYED);
        assert_eq!(found, Err(Withheld::Stalled), "read at {read} ms");
    }
    assert_eq!(guard.stalled(), Duration::from_millis(70));
    assert_eq!(guard.clear(at(90), OBEYED), Err(Withheld::Nothing), "proposed before the stall");
    let sample = Answered { excess_delay_s: f64::NAN, ..level(100).sample };
    let unknown = Proposal { sample, ..level(100) };
    assert_eq!(guard.pass(at(100), &unknown, OBEYED), Err(Withheld::Stalled));
    guard.pass(at(110), &level(110), OBEYED).expect("after");
}

#[test]
fn turns_up_to_fifty_milliseconds_apart_are_no_stall() {
    let mut guard = guard();
    guard.turn(at(50));
    guard.turn(at(100));
    assert_eq!(guard.stalled(), Duration::ZERO);
    guard.turn(at(151));
    assert_eq!(guard.stalled(), Duration::from_millis(51));
}

#[test]
fn setpoint_change_rates_are_limited() {
    let slow = Limits {
        thrust_change_max_per_s: 20.0,
        attitude_change_max_rad_s: 20.0,
        ..Limits::default()
    };
    let mut guard = Guard::new(slow, FULL_N, START);
    guard.pass(at(10), &level(10), OBEYED).expect("a first");
    let mut wild = level(20);
    wild.setpoint.thrust_n = 9.0;
    wild.setpoint.attitude = Euler::new(0.6, 0.0, 0.0);
    let (bounded, met) = guard.propose(at(20), &wild, OBEYED).expect("permitted");
    assert!((bounded.thrust_n - 7.0).abs() < 1e-9, "{bounded:?}");
    assert!((bounded.attitude.roll - 0.2).abs() < 1e-9, "{bounded:?}");
    assert!(met.thrust && met.tilt && !met.yaw_error);
}

/// A controller that proposes anything, at any time, about any sample.
fn talk() -> impl Strategy<Value = (u64, Proposal, Order)> {
    let number = || prop_oneof![-10.0..10.0f64, prop::num::f64::ANY];
    let stance = prop_oneof![Just(Stance::Silent), Just(Stance::Offer), Just(Stance::Control)];
    let obeys = prop_oneof![Just(Obeys::Unknown), Just(Obeys::No), Just(Obeys::Yes)];
    let words = (prop::array::uniform7(number()), -3.0..3.0f64, number());
    (0u64..120, 0u64..150, 0u64..150, words, stance, obeys).prop_map(
        |(step, age, lag, (n, yaw, excess_delay_s), stance, obeys)| {
            let setpoint = Setpoint {
                thrust_n: n[0],
                attitude: Euler::new(n[1], n[2], n[3]),
                body_rate: Frd::new(n[4], n[5], n[6]),
            };
            // These fields hold ages here; the test turns them into times.
            let host = HostTime::from_ns(age);
            let vehicle = VehicleTime::from_us(lag);
            let sample = Answered { host, vehicle, excess_delay_s, yaw };
            (step, Proposal { setpoint, sample }, Order { stance, obeys })
        },
    )
}

proptest! {
    #[test]
    fn every_passed_setpoint_is_permitted_fresh_and_bounded(
        talk in prop::collection::vec(talk(), 1..200),
    ) {
        let limits = Limits::default();
        let mut guard = guard();
        let (mut now_ms, mut ran_ms, mut woke_ms) = (1000, 0, 0);
        let mut answered = None;
        let mut before: Option<(u64, Setpoint)> = None;
        for (step, mut proposal, order) in talk {
            now_ms += step;
            if now_ms - ran_ms > 50 {
                woke_ms = now_ms;
            }
            ran_ms = now_ms;
            let came_ms = now_ms - proposal.sample.host.as_ns();
            proposal.sample.host = at(came_ms);
            let lag_ms = proposal.sample.vehicle.as_us();
            proposal.sample.vehicle = VehicleTime::from_us(1000 * (now_ms - lag_ms));
            let Ok(cleared) = guard.pass(at(now_ms), &proposal, order) else { continue };
            let setpoint = *cleared.setpoint();
            // Permitted.
            let is_offered = order.stance == Stance::Offer && order.obeys != Obeys::Unknown;
            prop_assert!(is_offered || order == OBEYED);
            // Fresh.
            prop_assert!(now_ms - came_ms <= 50 && came_ms >= woke_ms + 10);
            let late_s = proposal.sample.excess_delay_s;
            prop_assert!(late_s <= 1e-3 * (came_ms - woke_ms) as f64 + 1e-9);
            prop_assert!(answered.is_none_or(|answered| proposal.sample.vehicle > answered));
            answered = Some(proposal.sample.vehicle);
            // Within limits.
            prop_assert!(setpoint.is_finite());
            prop_assert!((0.5..=9.0).contains(&setpoint.thrust_n));
            prop_assert!(setpoint.attitude.attitude().tilt() <= limits.tilt_max_rad + 1e-6);
            prop_assert!(setpoint.body_rate.to_array().iter().all(|rate| rate.abs() <= 6.0));
            let off = wrap_angle(setpoint.attitude.yaw - proposal.sample.yaw);
            prop_assert!(off.abs() <= limits.yaw_error_max_rad + 1e-9);
            // And changes within their limits.
            if let Some((ms, before)) = before.filter(|(ms, _)| now_ms - ms <= 500) {
                let dt_s = (now_ms - ms).max(5) as f64 * 1e-3;
                prop_assert!((setpoint.thrust_n - before.thrust_n).abs() <= 500.0 * dt_s + 1e-9);
                for (rate, was) in
                    setpoint.body_rate.to_array().iter().zip(before.body_rate.to_array())
                {
                    prop_assert!((rate - was).abs() <= 1200.0 * dt_s + 1e-9);
                }
            }
            before = Some((now_ms, setpoint));
        }
    }
}

/// The system's allocator, with a count of this thread's allocations.
struct Counting;

thread_local! {
    static TAKEN: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is forwarded to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = TAKEN.try_with(|taken| taken.set(taken.get() + 1));
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn guard_allocates_nothing_after_the_start() {
    let mut guard = guard();
    let before = TAKEN.get();
    for k in 1..1000 {
        let ms = 10 * k + 60 * (k / 100);
        let order = if k % 7 == 0 { Order::default() } else { OBEYED };
        let _ = guard.pass(at(ms), &level(ms), order);
    }
    assert_eq!(TAKEN.get(), before);
    drop(Vec::<u8>::with_capacity(10));
    assert!(TAKEN.get() > before, "the counter works");
}
