//! What the controller knows about the vehicle's mode, and what it does if the mode is unknown: the
//! pilot wins even after silence and pauses, and only the pilot engages.

use std::time::Duration;

use message::{Battery, ChargeState, Inbound, LandedState, SystemState};

use crate::offboard_world::{
    Curve, Flight, HOLD_MODE, Hovering, MODES, POSITION_MODE, QUAD, Vehicle, weight,
};
use downwash::link::received::Received;
use downwash::offboard::OffboardSettings;
use downwash::supervisor::{Action, EngagePolicy, FlightState, Takeover};
use vehicle::frame::Ned;

const RETURN_MODE: u32 = 0x0504_0000;

fn flight_of(policy: EngagePolicy, settings: OffboardSettings) -> Flight {
    let path = |_| (Ned::new(0.0, 0.0, -1.0), Ned::zero(), 0.0, 0.0);
    let source = Hovering(Curve(30.0, path), weight(&QUAD));
    Flight::new(Vehicle::new(QUAD, 0.04, 10), policy, source, settings)
}

fn flight(policy: EngagePolicy) -> Flight {
    flight_of(policy, OffboardSettings::default())
}

fn in_track(policy: EngagePolicy) -> Flight {
    let mut flight = flight(policy);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.2);
    if policy == EngagePolicy::PilotSwitch {
        flight.switch(MODES.offboard);
        flight.vehicle.armed = true;
    }
    flight.until(FlightState::Track, 30.0);
    flight.actions.clear();
    flight
}

fn heartbeat(flight: &Flight, mode: u32) -> Received {
    let message = Inbound::Heartbeat {
        autopilot: 12,
        vehicle_type: 2,
        armed: flight.vehicle.armed,
        custom_mode: mode,
        system: SystemState::Active,
    };
    Received { host: flight.vehicle.now(), vehicle: None, delay: None, message }
}

fn reported(flight: &Flight, words: &str) -> bool {
    flight.events.iter().any(|event| event.text.contains(words))
}

/// The vehicle flies on while no message arrives and this process does not run.
fn pause(flight: &mut Flight, seconds: f64) {
    for _ in 0..(seconds * 1000.0) as u64 {
        flight.vehicle.step();
    }
}

#[test]
fn nothing_is_commanded_while_silence_hides_the_mode() {
    let mut flight = in_track(EngagePolicy::Command);
    flight.receives = |_| false;
    flight.run(2.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Land);
    assert!(flight.actions.is_empty(), "{:?}", flight.actions);
    // The pilot took over in the meantime, and the link is back.
    flight.vehicle.mode = POSITION_MODE;
    flight.receives = |_| true;
    flight.run(0.5);
    assert_eq!(flight.offboard.flight_state(), FlightState::PilotControl);
    assert!(flight.actions.is_empty(), "{:?}", flight.actions);
}

#[test]
fn late_frame_of_another_kind_does_not_confirm_the_mode() {
    let mut flight = in_track(EngagePolicy::Command);
    flight.receives = |_| false;
    // Messages in transit before the cut arrive a little later than the state.
    for _ in 0..10 {
        flight.run(0.01);
        let message = Inbound::Battery(Battery::default());
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
    }
    flight.run(2.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Land);
    assert!(
        flight.actions.is_empty(),
        "would override the vehicle's failsafe: {:?}",
        flight.actions
    );
}

#[test]
fn landing_is_commanded_once_the_mode_is_reported_after_silence() {
    let mut flight = in_track(EngagePolicy::Command);
    flight.receives = |_| false;
    flight.run(1.0);
    flight.receives =
        |message| !matches!(message, Inbound::Heartbeat { .. } | Inbound::CurrentMode { .. });
    flight.run(0.9);
    assert!(flight.actions.is_empty(), "the mode is older than the silence");
    flight.receives = |_| true;
    flight.run(0.2);
    assert_eq!(flight.actions, [Action::SetModeLand]);
}

#[test]
fn unread_mode_change_after_a_pause_is_the_pilots() {
    let mut flight = in_track(EngagePolicy::Command);
    pause(&mut flight, 2.4);
    // The socket's backlog: the earlier mode, then the pilot's.
    for mode in [MODES.offboard, HOLD_MODE] {
        let unread = heartbeat(&flight, mode);
        flight.offboard.catch_up(&unread);
    }
    let now = flight.vehicle.now();
    flight.vehicle.mode = HOLD_MODE;
    flight.offboard.resumed(now, 2.4);
    flight.run(3.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::PilotControl);
    assert!(flight.actions.is_empty(), "{:?}", flight.actions);
    assert_eq!(flight.streamed_since(now), 0);
}

#[test]
fn mode_is_unknown_after_a_pause_until_reported_again() {
    // The socket kept only the oldest messages.
    let paused = || {
        let mut flight = in_track(EngagePolicy::Command);
        pause(&mut flight, 2.4);
        let unread = heartbeat(&flight, MODES.offboard);
        flight.offboard.catch_up(&unread);
        let now = flight.vehicle.now();
        flight.offboard.resumed(now, 2.4);
        flight.receives =
            |message| !matches!(message, Inbound::Heartbeat { .. } | Inbound::CurrentMode { .. });
        flight.run(0.5);
        assert!(flight.actions.is_empty(), "{:?}", flight.actions);
        assert_eq!(flight.streamed_since(now), 0);
        flight
    };
    let mut taken = paused();
    taken.receives = |_| true;
    taken.switch(POSITION_MODE);
    taken.run(3.0);
    assert!(taken.actions.is_empty(), "{:?}", taken.actions);
    assert_eq!(taken.offboard.takeover(), Some(&Takeover::Pilot { mode: "Position".to_owned() }));

    let mut left = paused();
    left.receives = |_| true;
    left.run(0.2);
    assert_eq!(left.actions, [Action::SetModeLand], "no state for 2.4 s");
}

#[test]
fn mode_restored_on_disarming_is_not_the_pilots_switch() {
    for heartbeat_first in [false, true] {
        let mut flight = in_track(EngagePolicy::PilotSwitch);
        // The pilot takes over, lands, and leaves the vehicle armed beside a stream that waits for
        // the switch.
        flight.switch(MODES.land);
        flight.vehicle.armed = true;
        for _ in 0..1000 {
            flight.run(0.01);
            if flight.vehicle.state.position.down() > -0.01 {
                break;
            }
        }
        flight.vehicle.armed = true;
        flight.vehicle.mode = POSITION_MODE;
        flight.until(FlightState::Standby, 10.0);
        flight.run(1.0);
        let at = flight.vehicle.now();
        // PX4 disarms and returns to OFFBOARD; CURRENT_MODE and HEARTBEAT report it in either
        // order.
        if heartbeat_first {
            flight.vehicle.armed = false;
            let message = heartbeat(&flight, POSITION_MODE);
            flight.offboard.handle(&message);
        }
        flight.vehicle.mode = MODES.offboard;
        let message = Inbound::CurrentMode {
            custom_mode: MODES.offboard,
            intended_custom_mode: MODES.offboard,
        };
        flight.offboard.handle(&Received { host: at, vehicle: None, delay: None, message });
        flight.vehicle.armed = false;
        flight.run(3.0);
        assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease, "{heartbeat_first}");
        assert!(reported(&flight, "not the pilot's switch"), "{:#?}", flight.events);
        // The next arming, by anyone, must not take off.
        let now = flight.vehicle.now();
        flight.vehicle.armed = true;
        flight.run(3.0);
        assert_eq!(flight.streamed_since(now), 0);
        assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
    }
}

/// Half of the release may pass before a cut and half after it: the pilot may have switched in it.
#[test]
fn release_counts_no_silence() {
    let mut flight = in_track(EngagePolicy::PilotSwitch);
    flight.switch(POSITION_MODE);
    flight.run(0.3);
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
    flight.receives = |_| false;
    flight.run(2.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
    flight.receives = |_| true;
    let back = flight.vehicle.now();
    flight.run(0.9);
    assert_eq!(flight.streamed_since(back), 0, "{:#?}", flight.events);
    flight.until(FlightState::Standby, 2.0);
}

#[test]
fn switch_on_the_ground_lapses_unless_the_pilot_arms() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.2);
    flight.switch(MODES.offboard);
    flight.run(29.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Arm);
    flight.run(2.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitRelease);
    assert!(reported(&flight, "did not arm within 30 s"), "{:#?}", flight.events);
}

#[test]
fn offer_ends_if_the_pilot_leaves_offboard_before_engaging() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.2);
    // CURRENT_MODE reports the switch before a HEARTBEAT reports whether the motors run.
    for mode in [MODES.offboard, POSITION_MODE] {
        flight.vehicle.mode = mode;
        let message = Inbound::CurrentMode { custom_mode: mode, intended_custom_mode: mode };
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
        flight.run(0.05);
    }
    assert!(
        reported(&flight, "the vehicle left OFFBOARD again: the mode is Position"),
        "{:#?}",
        flight.events
    );
    let left = flight.vehicle.now();
    flight.run(0.5);
    assert_eq!(flight.streamed_since(left), 0);
    // The offer returns after the release, and the next switch engages.
    flight.until(FlightState::Standby, 5.0);
    flight.run(0.2);
    flight.switch(MODES.offboard);
    flight.run(0.2);
    assert_eq!(flight.offboard.flight_state(), FlightState::Arm);
}

#[test]
fn nothing_is_offered_without_a_recent_mode_report() {
    let mut flight = flight(EngagePolicy::PilotSwitch);
    flight.until(FlightState::Standby, 10.0);
    flight.run(0.2);
    flight.receives =
        |message| !matches!(message, Inbound::Heartbeat { .. } | Inbound::CurrentMode { .. });
    flight.run(2.6);
    let old = flight.vehicle.now();
    flight.run(1.0);
    assert_eq!(flight.streamed_since(old), 0, "after an unseen switch it would be obeyed");
    flight.receives = |_| true;
    flight.run(0.5);
    assert!(flight.streamed_since(old) > 0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Standby);
}

/// Someone else flies the vehicle at four metres when this program starts.
fn flown_by_others(policy: EngagePolicy, settings: OffboardSettings) -> Flight {
    let mut flight = flight_of(policy, settings);
    flight.vehicle.state.position = Ned::new(0.0, 0.0, -4.0);
    flight.vehicle.armed = true;
    flight.vehicle.mode = POSITION_MODE;
    flight
}

#[test]
fn vehicle_flown_by_others_is_not_taken_over_unasked() {
    let mut command = flown_by_others(EngagePolicy::Command, OffboardSettings::default());
    command.run(70.0);
    assert_eq!(command.offboard.flight_state(), FlightState::Abort);
    assert!(command.actions.is_empty(), "{:?}", command.actions);
    assert!(reported(&command, "found armed, in the air"), "{:#?}", command.events);
    assert!(command.ticks.iter().all(|tick| tick.setpoint.is_none()));

    let mut switched = flown_by_others(EngagePolicy::PilotSwitch, OffboardSettings::default());
    switched.run(5.0);
    switched.switch(MODES.offboard);
    switched.run(5.0);
    assert!(
        switched.ticks.iter().all(|tick| tick.setpoint.is_none()),
        "the ground height is unknown"
    );
}

#[test]
fn requested_takeover_in_the_air_uses_local_frame_height() {
    let mut settings = OffboardSettings::default();
    settings.supervisor.take_over = true;
    let mut flight = flown_by_others(EngagePolicy::Command, settings);
    flight.until(FlightState::Track, 60.0);
    flight.run(5.0);
    let height = -flight.vehicle.state.position.down();
    assert!((height - 1.0).abs() < 0.1, "{height} m above the origin");
    assert!(!flight.actions.contains(&Action::Arm));
}

#[test]
fn nothing_is_streamed_while_the_arming_state_is_unknown() {
    let mut flight = flown_by_others(EngagePolicy::PilotSwitch, OffboardSettings::default());
    flight.receives =
        |message| !matches!(message, Inbound::Heartbeat { .. } | Inbound::LandedState(_));
    flight.run(10.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::AwaitTelemetry);
    assert!(flight.ticks.iter().all(|tick| tick.setpoint.is_none()));
}

#[test]
fn failsafe_is_not_reported_as_the_pilot() {
    let mut flight = in_track(EngagePolicy::Command);
    // CURRENT_MODE comes first; HEARTBEAT and the text give the reason within a second.
    flight.vehicle.mode = RETURN_MODE;
    flight.run(0.2);
    assert_eq!(flight.offboard.flight_state(), FlightState::PilotControl);
    assert_eq!(flight.offboard.takeover(), None, "not known yet");
    let message =
        Inbound::StatusText { severity: 2, text: "Failsafe activated: no manual control".into() };
    let host = flight.vehicle.now();
    flight.vehicle.system = SystemState::Failsafe;
    flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
    flight.run(1.5);
    let words = "PX4 failsafe: Return; vehicle: Failsafe activated: no manual control";
    assert_eq!(flight.offboard.takeover(), Some(&Takeover::Failsafe(words.to_owned())));
    assert!(!reported(&flight, "the pilot has control"), "{:#?}", flight.events);
}

#[test]
fn declared_failsafe_or_critical_battery_lands_the_vehicle() {
    let failsafe = Inbound::StatusText { severity: 3, text: "Battery Failsafe".to_owned() };
    let critical = Battery { charge: ChargeState::Critical, ..Battery::default() };
    for (message, words) in [
        (failsafe, "reports a failsafe: Battery Failsafe"),
        (Inbound::Battery(critical), "reports a critical battery"),
    ] {
        let mut flight = in_track(EngagePolicy::Command);
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
        flight.run(1.0);
        assert_eq!(flight.offboard.flight_state(), FlightState::Track);
        flight.run(2.5);
        assert_eq!(flight.actions, [Action::SetModeLand]);
        assert!(reported(&flight, words), "{:#?}", flight.events);
    }
}

#[test]
fn position_reported_unhealthy_is_not_followed() {
    let report_health = |flight: &mut Flight, health: u32, enabled: u32| {
        let message = Inbound::SysStatus { unhealthy: 0, health, enabled };
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
    };
    let mut flight = in_track(EngagePolicy::Command);
    // A vehicle that never reported a healthy position is not judged by it.
    report_health(&mut flight, 0, 0x4000);
    flight.run(1.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track);
    // Nor is one that no longer uses it, such as ArduCopter in Guided, which reports it in LAND.
    report_health(&mut flight, 0x4000, 0x4000);
    report_health(&mut flight, 0, 0);
    flight.run(1.0);
    report_health(&mut flight, 0, 0x4000);
    flight.run(1.0);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track);
    // PX4 may report it as healthy without having it enabled.
    report_health(&mut flight, 0x4000, 0);
    flight.run(0.2);
    report_health(&mut flight, 0, 0x4000);
    flight.run(0.3);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track, "one report may be wrong");
    flight.run(0.4);
    assert_eq!(flight.actions, [Action::SetModeLand]);
    assert!(reported(&flight, "unhealthy position estimate"), "{:#?}", flight.events);
}

#[test]
fn unhealthy_sensors_are_named_once() {
    let mut flight = in_track(EngagePolicy::Command);
    for _ in 0..3 {
        let message = Inbound::SysStatus { unhealthy: 0x20 | 0x0020_0000, health: 0, enabled: 0 };
        let host = flight.vehicle.now();
        flight.offboard.handle(&Received { host, vehicle: None, delay: None, message });
        flight.run(0.5);
    }
    let words = "unhealthy: GPS, attitude estimate";
    assert_eq!(flight.events.iter().filter(|event| event.text.contains(words)).count(), 1);
    assert_eq!(flight.offboard.flight_state(), FlightState::Track);
}

#[test]
fn unreported_landing_ends_in_a_disarm_request() {
    let mut flight = in_track(EngagePolicy::Command);
    let now = flight.vehicle.now();
    flight.offboard.land(now);
    // The vehicle lands but keeps reporting flight, with its motors on.
    flight.receives = |message| !matches!(message, Inbound::LandedState(_));
    flight.vehicle.stays_armed = true;
    let message = Inbound::LandedState(LandedState::InAir);
    flight.offboard.handle(&Received { host: now, vehicle: None, delay: None, message });
    flight.obeys = |action| action != Action::Disarm;
    flight.until(FlightState::Disarm, 30.0);
    assert!(reported(&flight, "reports no landing"), "{:#?}", flight.events);
    flight.until(FlightState::Abort, 70.0);
    assert!(flight.actions.contains(&Action::Disarm));
    assert!(reported(&flight, "still armed: disarm it by hand"), "{:#?}", flight.events);
    assert!(flight.vehicle.now().since(now) < Duration::from_secs(100));
}
