//! What a flight waits for before it begins, and for how long.

use message::{Battery, Inbound};

use crate::offboard_world::{Curve, Flight, Hovering, QUAD, Vehicle, weight};
use downwash::link::received::Received;
use downwash::offboard::OffboardSettings;
use downwash::supervisor::{EngagePolicy, FlightState};
use vehicle::frame::Ned;

fn flight() -> Flight {
    let hover = |_: f64| (Ned::new(0.0, 0.0, -1.0), Ned::zero(), 0.0, 0.0);
    let source = Hovering(Curve(5.0, hover), weight(&QUAD));
    let vehicle = Vehicle::new(QUAD, 0.04, 10);
    Flight::new(vehicle, EngagePolicy::Command, source, OffboardSettings::default())
}

fn is_no_odometry(message: &Inbound) -> bool {
    !matches!(message, Inbound::Odometry { .. })
}

#[test]
fn missing_current_mode_is_reported_once_and_flown() {
    let mut flight = flight();
    flight.receives = |message| !matches!(message, Inbound::CurrentMode { .. });
    flight.until(FlightState::Track, 30.0);
    let notices = flight.events.iter().filter(|event| event.text.contains("no CURRENT_MODE"));
    assert_eq!(notices.count(), 1, "{:#?}", flight.events);
}

#[test]
fn present_current_mode_is_not_reported_missing() {
    let mut flight = flight();
    flight.until(FlightState::Track, 30.0);
    assert!(!flight.events.iter().any(|event| event.text.contains("CURRENT_MODE")));
}

#[test]
fn intermittent_telemetry_does_not_restart_the_wait() {
    let mut flight = flight();
    let limit_s = OffboardSettings::default().supervisor.ready_timeout_s;
    let mut waited_s = 0.0;
    // While telemetry arrives, a low battery keeps the flight in its checks.
    while flight.offboard.flight_state() != FlightState::Abort && waited_s < 2.0 * limit_s {
        let message = Inbound::Battery(Battery { remaining: Some(0.2), ..Battery::default() });
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
        flight.receives = |_| true;
        flight.run(2.0);
        flight.receives = is_no_odometry;
        flight.run(1.0);
        waited_s += 3.0;
    }
    assert!(waited_s <= limit_s + 6.0, "{waited_s} s");
    let reason = &flight.events.last().expect("an event").text;
    assert!(reason.contains("battery"), "{reason}");
}
