//! The pilot's switch, and traffic on the link besides the vehicle's own frames.

use crate::lockstep::{Bench, NANO, hover, params, settings};
use downwash::station::End;
use downwash::supervisor::{EngagePolicy, FlightState};
use proptest::prelude::*;
use sitl::autopilot::Mode;

/// A station that waits for the pilot.
fn waiting() -> Bench {
    let params = params(NANO);
    let mut settings = settings(&params, hover(30.0));
    settings.policy = EngagePolicy::PilotSwitch;
    settings.search_timeout_s = None;
    Bench::new(settings, &params)
}

#[test]
fn pilot_mode_change_ends_every_phase_permanently() {
    use FlightState::{Approach, Hold, Land, TakeOff, Track};
    for phase in [TakeOff, Approach, Track, Hold, Land] {
        let mut bench = Bench::hovering(NANO, 2.0);
        bench.until(phase, 60.0);
        bench.run(0.1);
        bench.pilot_mode(Mode::Position);
        bench.run(0.05);
        assert_eq!(bench.vehicle.flight().mode(), Mode::Position, "{phase:?}");
        let now_us = bench.now_us();
        bench.run(5.0);
        assert_eq!(bench.setpoints_after(now_us), 0, "{phase:?}");
        assert_eq!(bench.phase(), Some(FlightState::PilotControl), "{phase:?}");
        assert_eq!(bench.station.end(), Some(&End::PilotTookOver), "{phase:?}");
    }
}

#[test]
fn pilot_switch_engages_takes_over_and_engages_again() {
    let mut bench = waiting();
    bench.engage();
    bench.run(1.0);
    bench.pilot_mode(Mode::Position);
    bench.run(0.05);
    let now_us = bench.now_us();
    bench.run(0.8);
    assert_eq!(bench.setpoints_after(now_us), 0, "another mode must be reported for a second");
    assert!(!bench.phase().is_some_and(FlightState::is_in_control));
}

#[test]
fn stop_request_does_not_hide_the_end_of_the_flight() {
    // The pilot takes over during the landing that the stop caused.
    let mut bench = waiting();
    bench.engage();
    let now = bench.now();
    bench.station.land(now);
    bench.run(0.2);
    bench.pilot_mode(Mode::Position);
    bench.run(1.5);
    assert_eq!(bench.station.end(), Some(&End::PilotTookOver));

    // The link has been silent since the flight.
    let mut bench = waiting();
    bench.engage();
    bench.downlink = Box::new(|_, _| vec![]);
    bench.run(4.0);
    assert_eq!(bench.station.end(), None, "it waits for the link");
    let now = bench.now();
    bench.station.land(now);
    assert!(matches!(bench.station.end(), Some(End::LinkLost(_))), "{:?}", bench.station.end());

    // The takeover is over, so the stop ends the flight.
    let mut bench = waiting();
    bench.engage();
    bench.pilot_mode(Mode::Position);
    bench.until(FlightState::Standby, 5.0);
    let now = bench.now();
    bench.station.land(now);
    assert_eq!(bench.station.end(), Some(&End::Stopped));
}

#[test]
fn flight_log_continues_after_a_pilot_takeover() {
    let mut bench = waiting();
    bench.engage();
    bench.pilot_mode(Mode::Position);
    bench.run(8.0);
    assert!(!bench.has_recorded_end(), "still in the air");
    bench.run(3.0);
    assert!(bench.has_recorded_end());
}

#[test]
fn link_pause_interrupts_the_streamed_hold_only_while_it_lasts() {
    let mut bench = waiting();
    bench.until(FlightState::Standby, 10.0);
    bench.run(2.0);
    bench.downlink = Box::new(|_, _| Vec::new());
    bench.run(0.3);
    let resumed_us = bench.now_us();
    bench.downlink = Box::new(|_, frame| vec![frame.to_vec()]);
    bench.run(0.5);
    let setpoints = bench.setpoints_after(resumed_us);
    assert!((48..=51).contains(&setpoints), "{setpoints} setpoints in half a second");
    assert_eq!(bench.phase(), Some(FlightState::Standby));
}

#[test]
fn vehicle_already_in_offboard_is_left_alone() {
    let params = params(NANO);
    let mut bench = waiting();
    bench.engage();
    let mut settings = settings(&params, hover(30.0));
    settings.policy = EngagePolicy::PilotSwitch;
    settings.search_timeout_s = None;
    bench.restart(settings);
    let now_us = bench.now_us();
    bench.run(0.8);
    assert_eq!(bench.vehicle.flight().mode(), Mode::Offboard);
    bench.run(0.5);
    assert_eq!(bench.vehicle.flight().mode(), Mode::Land, "by the vehicle's own failsafe");
    // The pilot's intended mode is OFFBOARD throughout: streaming would resume it.
    bench.run(15.0);
    assert_eq!(bench.setpoints_after(now_us), 0);
    assert!(!bench.phase().is_some_and(FlightState::is_in_control));
}

/// What arrives instead of `frame`, which followed the frame `before`.
fn corrupted(kind: u8, bytes: &[u8], frame: &[u8], before: &[u8]) -> Vec<Vec<u8>> {
    let own = frame.to_vec();
    match kind {
        0 => vec![bytes.to_vec(), own],
        1 => vec![own.clone(), own],
        2 => vec![frame.get(..frame.len() / 2).unwrap_or_default().to_vec(), own],
        3 => vec![own, before.to_vec()],
        _ => {
            // A frame of another vehicle, with an invalid checksum.
            let mut foreign = own.clone();
            if let Some(system) = foreign.get_mut(5) {
                *system = system.wrapping_add(7);
            }
            vec![foreign, own]
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, ..ProptestConfig::default() })]

    #[test]
    fn corrupted_and_foreign_bytes_change_no_flight(
        noise in proptest::collection::vec((0u8..5, proptest::collection::vec(any::<u8>(), 0..60)), 64),
    ) {
        let mut bench = Bench::hovering(NANO, 3.0);
        let (mut count, mut before) = (0_usize, Vec::new());
        bench.downlink = Box::new(move |_, frame| {
            count += 1;
            let (kind, bytes) = &noise[(count / 7) % noise.len()];
            let before = std::mem::replace(&mut before, frame.to_vec());
            if count.is_multiple_of(7) {
                corrupted(*kind, bytes, frame, &before)
            } else {
                vec![frame.to_vec()]
            }
        });
        bench.until(FlightState::Done, 60.0);
        prop_assert_eq!(bench.station.end(), Some(&End::Done));
    }
}
