//! Whole flights of the daemon's station with the simulated vehicle as each autopilot, in lockstep.

use std::cell::RefCell;
use std::rc::Rc;

use crate::lockstep::{Bench, QUAD, errors, fly, hover, masks, params, settings, tracked};
use downwash::campaign::bench;
use downwash::log::record::Record;
use downwash::station::End;
use sitl::config::{Autopilot, SitlConfig, Stall};

/// The vehicle as an operator sets it up: a short time-out, and on ArduCopter thrust as thrust and a
/// failsafe that listens to the station.
pub fn set_up(autopilot: Autopilot) -> SitlConfig {
    bench::set_up(autopilot, 1.0)
}

#[test]
fn each_autopilot_is_flown_from_take_off_to_landing_with_the_mask_that_it_takes() {
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
        assert!(named, "the station takes it for {name}");
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
fn a_slipping_clock_shows_in_timesync_and_a_stall_in_what_arrives() {
    let params = params(QUAD);
    let mut config = set_up(Autopilot::Px4);
    config.clock.rate = 0.989;
    config.clock.stalls = vec![Stall { at_s: 4.0, for_s: 0.4 }];
    let mut bench = Bench::with(settings(&params, hover(1.0)), &params, &[], config);
    let arrivals = Rc::new(RefCell::new(Vec::new()));
    let heard = Rc::clone(&arrivals);
    let clock = bench.vehicle.clock().clone();
    bench.downlink = Box::new(move |us, frame| {
        heard.borrow_mut().push(clock.host_us(us));
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
