//! The controller gives up the vehicle when its mode changes, the link is lost or a fault occurs, and
//! takes it back only after a new engage.

use message::{Battery, Inbound};

use crate::offboard_world::{
    Curve, Flight, HOLD_MODE, Hovering, MODES, POSITION_MODE, QUAD, Vehicle, weight,
};
use downwash::offboard::{LinkEvent, OffboardSettings, Tick};
use downwash::supervisor::{Action, EngagePolicy, FlightState, Severity};
use vehicle::frame::{Frd, Ned};

fn flight(policy: EngagePolicy) -> Flight {
    let path = |_| (Ned::new(0.0, 0.0, -1.0), Ned::zero(), 0.0, 0.0);
    let source = Hovering(Curve(30.0, path), weight(&QUAD));
    Flight::new(Vehicle::new(QUAD, 0.04, 10), policy, source, OffboardSettings::default())
}

#[test]
fn pilot_mode_change_ends_a_commanded_flight_permanently() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    flight.switch(POSITION_MODE);
    let at = flight.vehicle.now();
    flight.run(3.0);
    flight.switch(MODES.offboard);
    flight.run(3.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::PilotControl);
    assert_eq!(flight.streamed_since(at), 0);
    assert!(flight.events.iter().any(|e| e.severity == Severity::Warning));
}

#[test]
fn pilot_switch_engages_only_while_the_hold_is_streamed() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(5.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Standby);
    assert!(flight.actions.is_empty(), "a waiting daemon requests nothing");
    flight.switch(MODES.offboard);
    flight.run(0.1);
    assert_eq!(flight.offboard.flight_state(), FlightState::Arm);
    flight.run(2.0);
    assert!(flight.actions.is_empty(), "the pilot arms");
    flight.vehicle.armed = true;
    flight.until(FlightState::Track, 30.0);

    // Takeover: no stream until another mode has been reported for a second.
    flight.switch(POSITION_MODE);
    let at = flight.vehicle.now();
    flight.run(0.9);
    assert_eq!(flight.streamed_since(at), 0);
    flight.until(FlightState::Standby, 1.0);
    flight.run(0.1);
    assert!(flight.streamed_since(at) > 0);
    flight.switch(MODES.offboard);
    flight.run(0.05);
    assert!(flight.offboard.flight_state().is_in_control());
}

#[test]
fn quick_return_to_offboard_after_a_takeover_does_not_engage() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.1);
    flight.switch(MODES.offboard);
    flight.vehicle.armed = true;
    flight.until(FlightState::Track, 30.0);
    flight.switch(POSITION_MODE);
    flight.run(0.5);
    flight.switch(MODES.offboard);
    let at = flight.vehicle.now();
    flight.run(5.0);
    assert_eq!(flight.streamed_since(at), 0);
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
}

#[test]
fn daemon_started_with_a_vehicle_in_offboard_stays_silent() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.vehicle.mode = MODES.offboard;
    flight.run(10.0);
    assert_eq!(flight.streamed_since(flight.ticks[0].host), 0);
    assert!(flight.actions.is_empty(), "the mode is the pilot's");
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
    flight.switch(HOLD_MODE);
    flight.until(FlightState::Standby, 3.0);
}

#[test]
fn commanded_flight_takes_a_disarmed_vehicle_out_of_offboard() {
    // The state in which the last flight left it.
    let mut flight = flight(EngagePolicy::Command);
    flight.vehicle.mode = MODES.offboard;
    flight.until(FlightState::Standby, 10.0);
    assert_eq!(flight.actions, [Action::SetModeHold]);
    let sent = |tick: &&Tick| tick.setpoint.is_some();
    let first = flight.ticks.iter().find(sent).map_or(FlightState::Standby, |tick| tick.phase);
    assert_eq!(first, FlightState::Standby, "silent until it has left OFFBOARD");
    flight.until(FlightState::Done, 60.0);
}

#[test]
fn commanded_flight_leaves_an_armed_vehicle_in_offboard_alone() {
    let mut flight = flight(EngagePolicy::Command);
    flight.vehicle.mode = MODES.offboard;
    flight.vehicle.armed = true;
    flight.until(FlightState::Abort, 70.0);
    assert!(flight.actions.is_empty(), "{:?}", flight.actions);
    assert_eq!(flight.streamed_since(flight.ticks[0].host), 0);
}

#[test]
fn link_loss_in_flight_ends_control_until_the_mode_reads_otherwise() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.1);
    flight.switch(MODES.offboard);
    flight.vehicle.armed = true;
    flight.until(FlightState::Track, 30.0);
    flight.receives = |_| false;
    flight.obeys = |_| false;
    let at = flight.vehicle.now();
    flight.run(4.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Abort);
    flight.receives = |_| true;
    flight.run(5.0);
    assert_eq!(flight.streamed_since(at), 0, "the mode still reads OFFBOARD");
}

#[test]
fn stale_state_stops_setpoints_and_commands_landing() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    flight.receives = |message| !matches!(message, Inbound::Odometry { .. });
    let at = flight.vehicle.now();
    flight.run(0.45);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track, "a short silence is waited out");
    flight.run(0.2);
    assert_eq!(flight.offboard.flight_state(), FlightState::Land);
    assert_eq!(flight.streamed_since(at), 0);
    assert_eq!(flight.actions.last(), Some(&Action::SetModeLand));
}

#[test]
fn estimate_jump_holds_at_the_new_estimate() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    flight.vehicle.state.position += Ned::new(3.0, 0.0, 0.0);
    flight.run(0.05);
    assert_eq!(flight.offboard.flight_state(), FlightState::Hold);
    flight.run(0.5);
    let last = flight.ticks.last().expect("ticks");
    assert!(last.tracking_error < 0.2, "{} m", last.tracking_error);
    assert!(last.state.attitude.tilt() < 0.1);
    flight.until(FlightState::Done, 30.0);
}

#[test]
fn refused_arming_ends_the_flight_with_the_vehicles_reason() {
    let mut flight = flight(EngagePolicy::Command);
    flight.obeys = |action| action != Action::Arm;
    flight.until(FlightState::Arm, 20.0);
    flight.run(0.1);
    let host = flight.vehicle.now();
    let message = Inbound::StatusText { severity: 2, text: "Arming denied: compass\t".into() };
    let received = downwash::link::received::Received { host, vehicle: None, delay: None, message };
    flight.offboard.handle(&received);
    flight.run(6.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Abort);
    let reason = &flight.events.last().expect("an event").text;
    assert!(reason.contains("Arming denied: compass"), "{reason}");
}

#[test]
fn repeated_refusal_is_reported_once() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    for text in ["failed", "failed", "failed", "denied"] {
        let refused = LinkEvent::Refused { action: Action::Disarm, text: text.into() };
        flight.offboard.link_event(flight.vehicle.now(), refused);
        flight.run(0.1);
    }
    let refusals = flight.events.iter().filter(|event| event.text.contains("refuses to disarm"));
    let refusals: Vec<&str> = refusals.map(|event| event.text.as_str()).collect();
    let expected =
        ["the vehicle refuses to disarm: failed", "the vehicle refuses to disarm: denied"];
    assert_eq!(refusals, expected);
}

#[test]
fn requested_landing_hands_over_to_the_vehicle() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    let now = flight.vehicle.now();
    flight.offboard.land(now);
    flight.run(0.3);
    let handed_over = flight.vehicle.now();
    flight.until(FlightState::Done, 30.0);
    assert_eq!(flight.streamed_since(handed_over), 0);
}

#[test]
fn nan_state_is_never_used_for_control() {
    let mut flight = flight(EngagePolicy::Command);
    flight.until(FlightState::Track, 30.0);
    let state = flight.vehicle.state;
    let message = Inbound::Odometry {
        position: Ned::new(f64::NAN, 0.0, -1.0),
        velocity: state.velocity,
        attitude: state.attitude,
        body_rate: Frd::zero(),
        reset_counter: 0,
    };
    let (host, ms) = (flight.vehicle.now(), flight.vehicle.ms as u32 + 9);
    let vehicle = Some(downwash::clock::VehicleTime::from_ms(ms));
    let received = downwash::link::received::Received { host, vehicle, delay: None, message };
    assert!(flight.offboard.handle(&received).is_none());
    flight.run(1.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track);
    let sent: Vec<_> = flight.ticks.iter().filter_map(|tick| tick.setpoint).collect();
    assert!(sent.iter().all(|setpoint| setpoint.is_finite()));
}

#[test]
fn low_battery_and_fence_breach_land_the_vehicle() {
    let mut low = flight(EngagePolicy::Command);
    low.until(FlightState::Track, 30.0);
    let message = Inbound::Battery(Battery { remaining: Some(0.1), ..Battery::default() });
    let host = low.vehicle.now();
    low.offboard.handle(&downwash::link::received::Received {
        host,
        vehicle: None,
        delay: None,
        message,
    });
    low.run(2.9);
    assert_eq!(low.offboard.flight_state(), FlightState::Track);
    low.run(0.3);
    assert_eq!(low.offboard.flight_state(), FlightState::Land);

    let mut settings = OffboardSettings::default();
    settings.safety.fence_radius_m = 1.0;
    let path = |t: f64| (Ned::new(0.5 * t, 0.0, -1.0), Ned::new(0.5, 0.0, 0.0), 0.0, 0.0);
    let source = Hovering(Curve(30.0, path), weight(&QUAD));
    let vehicle = Vehicle::new(QUAD, 0.04, 10);
    let mut away = Flight::new(vehicle, EngagePolicy::Command, source, settings);
    away.until(FlightState::Land, 30.0);
    assert!((away.vehicle.state.position.north() - 1.0).abs() < 0.1);
    assert!(away.events.iter().any(|event| event.text.contains("outside the geofence")));
}
