//! Whole flights of the daemon's station with each simulated autopilot, in lockstep.

use std::cell::RefCell;
use std::rc::Rc;

use crate::lockstep;
use crate::lockstep::{Bench, QUAD, errors, fly, hover, masks, params, settings, tracked};
use downwash::campaign::bench;
use downwash::control::Use;
use downwash::log::record::Record;
use downwash::station::End;
use downwash::supervisor::FlightState;
use sitl::autopilot::Mode;
use sitl::config::{Autopilot, GpsGlitch, SitlConfig, Stall};

/// The vehicle as set up by an operator: a short timeout, and on ArduCopter direct thrust and a
/// failsafe that monitors the station.
pub fn set_up(autopilot: Autopilot) -> SitlConfig {
    bench::set_up(autopilot, 1.0)
}

#[test]
fn each_autopilot_flies_a_whole_flight_with_its_type_mask() {
    let cases = [
        (Autopilot::Bundled, "bundled", 0x00),
        (Autopilot::Px4, "PX4", 0x07),
        (Autopilot::Arducopter, "ArduCopter", 0x07),
    ];
    for (autopilot, name, mask) in cases {
        let params = params(QUAD);
        let settings = settings(&params, hover(10.0));
        let (end, records) = fly(settings, &params, &[], set_up(autopilot), 1);
        assert_eq!(end, End::Done, "{name}");
        let named = records.iter().any(|record| match record {
            Record::Event { text, .. } => text.contains(&format!("vehicle is {name}")),
            _ => false,
        });
        assert!(named, "the station identifies it as {name}");
        assert_eq!(masks(&records), [mask], "{name}");
        let (rms, most) = errors(&records);
        assert!(rms < 0.2 && most < 0.5, "{name}: {rms} m, {most} m");
    }
}

#[test]
fn same_seed_gives_the_same_flight_with_wander_and_slip() {
    for autopilot in [Autopilot::Px4, Autopilot::Arducopter] {
        let flight = |seed| {
            let params = params(QUAD);
            let mut config = set_up(autopilot);
            config.estimator.wander_m = 0.05;
            config.clock.rate = 0.9999;
            let settings = settings(&params, hover(2.0));
            let (_, records) = fly(settings, &params, &[], config, seed);
            tracked(&records).iter().map(|row| row.state.position.to_array()).collect::<Vec<_>>()
        };
        let first = flight(1);
        assert!(first.len() > 50 && first == flight(1));
        assert!(first != flight(2));
    }
}

#[test]
fn clock_slip_shows_in_timesync_and_stall_in_arrivals() {
    let params = params(QUAD);
    let mut config = set_up(Autopilot::Px4);
    config.clock.rate = 0.989;
    config.clock.stalls = vec![Stall { at_s: 4.0, for_s: 0.4 }];
    let mut bench = Bench::with(settings(&params, hover(1.0)), &params, &[], config);
    let arrivals = Rc::new(RefCell::new(Vec::new()));
    let recorded = Rc::clone(&arrivals);
    let clock = bench.vehicle.clock().clone();
    bench.downlink = Box::new(move |us, frame| {
        recorded.borrow_mut().push(clock.host_us(us));
        vec![frame.to_vec()]
    });
    let vehicle_s = |bench: &Bench| bench.vehicle.now_us() as f64 * 1e-6;
    bench.run(3.0);
    assert!((vehicle_s(&bench) - 3.0 * 0.989).abs() < 0.002, "{} s", vehicle_s(&bench));
    bench.run(7.0);
    assert!((vehicle_s(&bench) - 9.6 * 0.989).abs() < 0.002, "{} s", vehicle_s(&bench));
    let longest = arrivals.borrow().windows(2).map(|pair| pair[1] - pair[0]).max();
    let longest_s = longest.expect("frames") as f64 * 1e-6;
    assert!((0.4..0.45).contains(&longest_s), "nothing arrives for {longest_s} s");
}

/// ArduCopter's estimate after ten seconds of GPS that is wrong by 5.5 m: it jumps at the end, and
/// slides back within half a second while its velocity reads zero.
#[test]
fn sliding_estimate_is_not_followed() {
    let params = params(QUAD);
    let mut config = set_up(Autopilot::Arducopter);
    config.estimator.gps_glitch =
        Some(GpsGlitch { at_s: 12.0, for_s: 10.3, offset_m: [5.5, 0.0, 0.0] });
    config.estimator.reset_after_s = 10.0;
    config.estimator.slide_time_s = 0.23;
    let mut bench = Bench::with(settings(&params, hover(40.0)), &params, &[], config);
    bench.until(FlightState::Hold, 60.0);
    assert!(bench.logged("position estimate jumped by 5.5"), "{:?}", bench.texts());
    let held = bench.position();
    let mut farthest: f64 = 0.0;
    while bench.phase() == Some(FlightState::Hold) {
        bench.run(0.05);
        farthest = farthest.max((bench.position() - held).norm());
    }
    assert!(bench.logged("position estimate drifted by"), "{:?}", bench.texts());
    assert!(!bench.logged("from the reference"), "{:?}", bench.texts());
    // The 1 m that is not yet a slide, and the remainder of one.
    assert!(farthest < 1.2, "{farthest} m in truth");
    bench.until(FlightState::Done, 30.0);
}

/// An autopilot in its landing mode aims to stop ahead of its motion and tilt. If it touches the
/// ground before, ArduCopter leans towards that point for ever and refuses to disarm, and a vehicle
/// that is handed over tilted flies off backwards: the controller brings it to rest first, level.
#[test]
fn moving_vehicle_comes_to_rest_before_landing() {
    for autopilot in [Autopilot::Arducopter, Autopilot::Px4] {
        let landing = |land_brake_s: f64| {
            let params = params(QUAD);
            let mut settings = settings(&params, lockstep::trajectory("sinusoid-yaw.toml"));
            settings.offboard.supervisor.land_brake_s = land_brake_s;
            let mut bench = Bench::with(settings, &params, &[], set_up(autopilot));
            bench.until(FlightState::Track, 60.0);
            bench.run(4.0);
            let now = bench.now();
            bench.station.land(now);
            let (mut before, mut fastest) = (bench.position(), 0.0_f64);
            let mut step = |bench: &mut Bench| {
                bench.run(0.02);
                let moved = bench.position() - before;
                before = bench.position();
                moved.north().hypot(moved.east()) / 0.02
            };
            let mut at_handover = f64::NAN;
            while bench.vehicle.flight().mode() != Mode::Land {
                at_handover = step(&mut bench);
            }
            let tilt = bench.vehicle.plant().state().attitude.tilt();
            let from = bench.position();
            for _ in 0..100 {
                fastest = fastest.max(step(&mut bench));
            }
            bench.until(FlightState::Done, 30.0);
            let moved = bench.position() - from;
            [at_handover, fastest, moved.north().hypot(moved.east()), tilt]
        };
        let (braked, at_once) = (landing(2.0), landing(0.0));
        println!("{autopilot:?}: {braked:?}, {at_once:?} at once");
        assert!(at_once[0] > 0.8, "{at_once:?}");
        assert!(braked.iter().all(|value| *value < 0.4), "{autopilot:?}: {braked:?}");
        let tilt = braked[3];
        assert!(tilt < 0.15, "{autopilot:?}: handed over at a tilt of {tilt} rad");
    }
}

/// For two seconds commands and setpoints do not arrive, but telemetry does: the observer must not
/// take the vehicle's motion for a disturbance and counter it afterwards.
#[test]
fn observer_learns_nothing_while_setpoints_do_not_arrive() {
    let farthest_after = |observer: Use| {
        let params = params(QUAD);
        let mut settings = settings(&params, lockstep::trajectory("sinusoid-yaw.toml"));
        settings.offboard.offset_free.observer = observer;
        settings.offboard.safety.tracking_error_max_m = 20.0;
        let mut bench = Bench::with(settings, &params, &[], set_up(Autopilot::Arducopter));
        bench.until(FlightState::Track, 60.0);
        bench.run(4.0);
        bench.uplink = false;
        bench.run(2.0);
        bench.uplink = true;
        let healed = *tracked(&bench.records).last().expect("a tick");
        bench.run(6.0);
        let back = tracked(&bench.records).into_iter().filter(|row| row.t > healed.t);
        back.map(|row| row.error_m).fold(0.0, f64::max)
    };
    let (observed, alone) = (farthest_after(Use::On), farthest_after(Use::Off));
    assert!(observed < 1.1 * alone, "{observed} m, {alone} m without an observer");
}

/// ArduCopter's position control, active in LAND and idle in Guided, says nothing about its
/// position estimate.
#[test]
fn vehicle_left_in_landing_mode_flies_again() {
    let params = params(QUAD);
    let flight = || settings(&params, hover(2.0));
    let mut bench = Bench::with(flight(), &params, &[], set_up(Autopilot::Arducopter));
    bench.until(FlightState::Done, 60.0);
    bench.restart(flight());
    bench.until(FlightState::Done, 60.0);
    assert_eq!(bench.station.end(), Some(&End::Done), "{:?}", bench.texts());
}

#[test]
fn slow_serial_line_is_reported_with_a_feasible_rate() {
    for autopilot in [Autopilot::Px4, Autopilot::Arducopter] {
        let params = params(QUAD);
        let mut settings = settings(&params, hover(1.0));
        settings.session.baud = Some(57_600);
        let mut bench = Bench::with(settings, &params, &[], set_up(autopilot));
        bench.run(8.0);
        let line = "serial line: expected room for 80 Hz of attitude and position";
        assert!(bench.logged(line), "{:?}", bench.texts());
        assert!(bench.logged("set control.rate_hz to 25 or less"), "{:?}", bench.texts());
        assert!(bench.logged("57600 baud, which carries 5760 bytes/s"), "{:?}", bench.texts());
        assert_eq!(bench.setpoints_after(0), 0);
    }
}
