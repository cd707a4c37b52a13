//! Adjustments by viewers in flight: when they are accepted, where the vehicle then goes, and what
//! remains of them after the flight.

use std::collections::BTreeMap;

use crate::lockstep::{SLOW, VEHICLES, effects, params, settings, trajectory};
use crate::offboard_world::{Curve, Flight, Hovering, NANO, Vehicle, weight};
use downwash::clock::HostTime;
use downwash::control::{LAWS, Law};
use downwash::lockstep;
use downwash::log::record::Record;
use downwash::offboard::{Adjusted, Adjustment, OffboardSettings};
use downwash::station::{End, Station};
use downwash::supervisor::{EngagePolicy, FlightState, Severity};
use sitl::config::SitlConfig;
use vehicle::frame::Ned;

const ASKED: Adjustment =
    Adjustment { north_m: Some(1.2), east_m: Some(-0.8), up_m: Some(0.5), feedback_scale: None };
/// The same in world axes, m.
const MOVED: Ned = Ned::new(1.2, -0.8, -0.5);

fn hovering(seconds: f64) -> Flight {
    let hover = |_: f64| (Ned::new(0.0, 0.0, -1.0), Ned::zero(), 0.0, 0.0);
    let source = Hovering(Curve(seconds, hover), weight(&NANO));
    let vehicle = Vehicle::new(NANO, 0.04, 20);
    Flight::new(vehicle, EngagePolicy::Command, source, OffboardSettings::default())
}

fn adjust(flight: &mut Flight, asked: &Adjustment) {
    flight.offboard.adjust(flight.vehicle.now(), asked);
    flight.run(0.0);
    flight.events.extend(flight.offboard.take_events());
}

fn last_words(flight: &Flight) -> (Severity, String) {
    let event = flight.events.last().expect("an event");
    (event.severity, event.text.clone())
}

#[test]
fn moved_goal_is_reached_held_and_landed_at() {
    let mut flight = hovering(12.0);
    flight.until(FlightState::Track, 30.0);
    let start = flight.ticks.last().expect("a tick").state.position;
    adjust(&mut flight, &ASKED);
    let (severity, words) = last_words(&flight);
    assert_eq!(severity, Severity::Info);
    assert!(words.contains("goal 1.20 m north, -0.80 m east, 0.50 m up"), "{words}");
    flight.run(8.0);
    let tick = flight.ticks.last().expect("a tick");
    assert_eq!(tick.phase, FlightState::Track);
    let off = (tick.state.position - start - MOVED).norm();
    assert!(off < 0.1, "{off} m off the goal");
    // The vehicle was led smoothly to the goal.
    let worst = flight.ticks.iter().map(|tick| tick.tracking_error).fold(0.0, f64::max);
    let tilt = flight.ticks.iter().map(|tick| tick.state.attitude.tilt()).fold(0.0, f64::max);
    assert!(worst < 0.25 && tilt < 0.2, "{worst} m, {tilt} rad");

    flight.until(FlightState::Hold, 10.0);
    let back = Adjustment { north_m: Some(0.0), east_m: Some(0.0), ..Adjustment::default() };
    adjust(&mut flight, &back);
    let held = flight.ticks.last().expect("a tick").reference.position;
    flight.run(1.0);
    let reference = flight.ticks.last().expect("a tick").reference.position;
    assert!((reference - held).norm() > 0.05, "the held position moves with the goal");
    flight.until(FlightState::Land, 10.0);
    let landing = flight.offboard.adjusted().goal;
    flight.run(0.3);
    assert_eq!(flight.offboard.adjusted().goal, landing, "nothing moves while it lands");
    adjust(&mut flight, &ASKED);
    assert!(last_words(&flight).1.contains("refused"), "{:?}", last_words(&flight));
    flight.until(FlightState::Done, 40.0);
    assert_eq!(flight.offboard.adjusted(), Adjusted::default());
    assert!(flight.events.iter().any(|event| event.text.contains("end with the flight")));
}

#[test]
fn adjustment_on_the_ground_sets_the_take_off_goal() {
    let mut flight = hovering(2.0);
    // Once the vehicle reports that it is on the ground.
    while flight.offboard.adjusted() == Adjusted::default() {
        assert!(flight.offboard.flight_state().precedes_stream(), "{:?}", last_words(&flight));
        flight.run(0.002);
        adjust(&mut flight, &ASKED);
    }
    assert_eq!(last_words(&flight).0, Severity::Info, "{:?}", last_words(&flight));
    flight.until(FlightState::Track, 30.0);
    let position = flight.ticks.last().expect("a tick").state.position;
    let goal = MOVED + Ned::new(0.0, 0.0, -1.0);
    assert!((position - goal).norm() < 0.4, "{position:?}");
}

#[test]
fn adjustments_are_refused_outside_track_hold_and_ground() {
    let mut flight = hovering(2.0);
    for state in [FlightState::TakeOff, FlightState::Approach] {
        flight.until(state, 30.0);
        adjust(&mut flight, &ASKED);
        let (severity, words) = last_words(&flight);
        assert_eq!(severity, Severity::Warning);
        assert!(words.contains("in track, in hold and before a flight"), "{words}");
        assert_eq!(flight.offboard.adjusted(), Adjusted::default());
    }
    flight.until(FlightState::Track, 30.0);
    flight.switch(3);
    flight.run(0.1);
    assert_eq!(flight.offboard.flight_state(), FlightState::PilotControl);
    adjust(&mut flight, &ASKED);
    assert!(last_words(&flight).1.contains("refused"));
}

#[test]
fn out_of_bounds_goal_is_refused_in_flight() {
    let mut flight = hovering(8.0);
    flight.until(FlightState::Track, 30.0);
    let up = |up: f64| Adjustment { up_m: Some(up), ..Adjustment::default() };
    for asked in [up(-0.8), up(3.1), up(f64::NAN), up(f64::NEG_INFINITY)] {
        adjust(&mut flight, &asked);
        assert!(last_words(&flight).1.contains("refused"), "{asked:?}");
        assert_eq!(flight.offboard.adjusted(), Adjusted::default());
    }
    flight.run(1.0);
    let tick = flight.ticks.last().expect("a tick");
    assert!((tick.state.position - Ned::new(0.0, 0.0, -1.0)).norm() < 0.05);
}

/// RMS distance from the reference, m, with this feedback factor from the trajectory's start on.
fn flown(vehicle_file: &str, law: Law, scale: f64) -> f64 {
    let params = params(vehicle_file);
    let mut settings = settings(&params, trajectory("figure-8.toml"));
    settings.control.law = law;
    let mut vehicle =
        sitl::autopilot::Vehicle::new(params, effects(&SLOW), SitlConfig::default(), 5)
            .expect("a vehicle");
    let mut station = Station::new(settings, lockstep::host_time(0));
    let (mut sum, mut count, mut tilt) = (0.0, 0.0, 0.0_f64);
    let log = |record: Record| {
        if let Record::Tick(tick) = record
            && tick.trajectory_time.is_some()
            && let Some(reference) = tick.reference
        {
            sum += (tick.state.position - reference.position).norm().powi(2);
            count += 1.0;
            tilt = tilt.max(tick.state.attitude.tilt());
        }
    };
    let mut is_asked = false;
    let act = |vehicle: &mut sitl::autopilot::Vehicle, station: &mut Station| {
        if !is_asked && station.status().phase == Some(FlightState::Track) {
            is_asked = true;
            let now: HostTime = lockstep::host_time(vehicle.clock().host_us(vehicle.now_us()));
            station.adjust(now, &Adjustment { feedback_scale: Some(scale), ..Default::default() });
        }
    };
    let end = lockstep::fly_disturbed(&mut vehicle, &mut station, 120.0, log, |_, _| {}, act);
    assert_eq!(end.expect("an end"), End::Done, "{vehicle_file} {law} x {scale}");
    assert!(tilt < 0.7, "{vehicle_file} {law} x {scale}: {tilt} rad");
    f64::sqrt(sum / count)
}

/// With transport delay and rotor lag that the feedback design does not include, at both ends of
/// the permitted range.
#[test]
fn every_law_flies_with_scaled_feedback() {
    for vehicle in VEHICLES {
        let mut found = BTreeMap::new();
        for spec in LAWS {
            let errors = [1.0 / 1.5, 1.0, 1.5].map(|scale| flown(vehicle, Law::new(spec), scale));
            assert!(errors.iter().all(|error| *error < 0.8), "{vehicle} {}: {errors:?}", spec.id);
            found.insert(spec.id, errors);
        }
        let lqr = found["lqr"];
        assert!(lqr[0] > lqr[1] && lqr[1] > lqr[2], "more feedback, less error: {lqr:?}");
        println!("{vehicle} {found:?}");
    }
}
