//! Whole flights of the offboard controller, with transport delay and rotor lag that its model
//! lacks.

use std::f64::consts::TAU;

use crate::offboard_world::{Curve, Flight, Hovering, NANO, Numbers, QUAD, Vehicle, weight};
use downwash::offboard::OffboardSettings;
use downwash::supervisor::{EngagePolicy, FlightState};
use vehicle::frame::Ned;

fn hover(_: f64) -> (Ned, Ned, f64, f64) {
    (Ned::new(0.0, 0.0, -1.0), Ned::zero(), 0.0, 0.0)
}

fn command(
    numbers: Numbers,
    seconds: f64,
    path: impl Fn(f64) -> (Ned, Ned, f64, f64) + Send + 'static,
) -> Flight {
    let source = Hovering(Curve(seconds, path), weight(&numbers));
    let vehicle = Vehicle::new(numbers, 0.04, 20);
    Flight::new(vehicle, EngagePolicy::Command, source, OffboardSettings::default())
}

#[test]
fn nano_and_quad_take_off_hover_and_land() {
    for numbers in [NANO, QUAD] {
        let mut flight = command(numbers, 5.0, hover);
        flight.until(FlightState::Done, 40.0);
        assert!(!flight.vehicle.armed);
        let tracked: Vec<_> =
            flight.ticks.iter().filter(|t| t.phase == FlightState::Track).collect();
        assert!((495..=505).contains(&tracked.len()), "{} ticks", tracked.len());
        let worst = tracked.iter().map(|t| t.tracking_error).fold(0.0, f64::max);
        assert!(worst < 0.05, "{worst} m off in hover");
        assert!(flight.ticks.iter().all(|t| t.state.attitude.tilt() < 0.1));
    }
}

#[test]
fn flight_starts_with_idle_hold_setpoints() {
    let mut flight = command(QUAD, 1.0, hover);
    flight.until(FlightState::Arm, 20.0);
    let sent: Vec<_> = flight.ticks.iter().filter_map(|t| t.setpoint).collect();
    assert!(sent.len() > 40);
    assert!(sent.iter().all(|s| s.thrust_n < 0.2 * weight(&QUAD) && s.attitude.roll == 0.0));
}

#[test]
fn sinusoid_while_turning_is_tracked() {
    let path = |t: f64| {
        let ramp = (t / 3.0).min(1.0);
        let (s, c) = (TAU * t / 6.0).sin_cos();
        let rate = TAU / 6.0 * ramp;
        (
            Ned::new(0.8 * s * ramp, 0.8 * (c - 1.0) * ramp, -1.0),
            Ned::new(0.8 * c * rate, -0.8 * s * rate, 0.0),
            TAU * t / 10.0,
            TAU / 10.0,
        )
    };
    for numbers in [NANO, QUAD] {
        let mut flight = command(numbers, 20.0, path);
        flight.until(FlightState::Done, 60.0);
        let tracked = flight.ticks.iter().filter(|t| t.phase == FlightState::Track);
        let worst = tracked.map(|t| t.tracking_error).fold(0.0, f64::max);
        assert!(worst < 0.5, "{worst} m off");
        assert!(worst > 0.005, "{worst} m is too good to be true without acceleration");
    }
}

#[test]
fn step_response_has_little_overshoot_at_every_heading() {
    for numbers in [NANO, QUAD] {
        let mut flight = command(numbers, 10.0, |t| {
            let north = if t < 1.0 { 0.0 } else { 1.0 };
            (Ned::new(north, 0.0, -1.0), Ned::zero(), 2.0, 0.0)
        });
        flight.until(FlightState::Hold, 60.0);
        let tracked: Vec<_> =
            flight.ticks.iter().filter(|t| t.phase == FlightState::Track).collect();
        let north = |t: &downwash::offboard::Tick| t.state.position.north();
        let highest = tracked.iter().map(|t| north(t)).fold(0.0, f64::max);
        assert!(highest < 1.2, "overshoot to {highest}");
        let last = tracked.last().expect("tracked");
        assert!((north(last) - 1.0).abs() < 0.03, "{}", north(last));
        let rise = tracked.iter().find(|t| north(t) > 0.9).and_then(|t| t.trajectory_time);
        assert!(rise.is_some_and(|at| at < 4.0), "{rise:?}");
        let aside = tracked.iter().map(|t| t.state.position.east().abs()).fold(0.0, f64::max);
        assert!(aside < 0.1, "{aside} m aside");
        let sunk = tracked.iter().map(|t| t.state.position.down()).fold(-1.0, f64::max);
        assert!(sunk < -0.8, "sank to {sunk}");
    }
}

#[test]
fn vehicle_twenty_percent_heavier_still_flies() {
    let heavy = Numbers { mass: QUAD.mass * 1.2, ..QUAD };
    let source = Hovering(Curve(5.0, hover), weight(&QUAD));
    let mut flight = Flight::new(
        Vehicle::new(heavy, 0.04, 20),
        EngagePolicy::Command,
        source,
        OffboardSettings::default(),
    );
    flight.until(FlightState::Done, 60.0);
}

#[test]
fn repeated_flight_is_identical() {
    let fly = || {
        let mut flight = command(NANO, 2.0, hover);
        flight.until(FlightState::Done, 40.0);
        flight.ticks
    };
    assert!(fly() == fly());
}
