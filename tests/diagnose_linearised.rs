//! The linearised problem leaves the same residuals as the flights, also for short flights whose
//! bands share their variances.

use std::fs;
use std::path::Path;

use downwash::diagnose::catalogue::hypothesis::Catalogue;
use downwash::diagnose::catalogue::number::Target;
use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::flights::spectrum::BANDS;
use downwash::diagnose::likelihood::channels::RATE;
use downwash::diagnose::likelihood::layout::Bin;
use downwash::diagnose::likelihood::observed::Observed;
use downwash::diagnose::likelihood::residuals::Evaluator;
use downwash::diagnose::search::Search;
use downwash::log::import::{self, Flight, Stream};
use sitl::config::SitlConfig;
use vehicle::effects::EffectId;
use vehicle::frame::Ned;

use crate::{damage, lockstep};

/// A flight by a vehicle with these effects. `name` is that of its log.
fn flight(name: &str, trajectory: &str, effects: &[&str]) -> Flight {
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::toml_trajectory(trajectory));
    let (_, records) = lockstep::fly(settings, &params, effects, SitlConfig::default(), 7);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diagnose-linearised");
    fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(name).with_extension("tlog");
    damage::write_tlog(&path, &damage::entries(&records));
    import::open(&path, None).expect("a flight")
}

/// A flight of seven seconds by a vehicle whose rotors flap.
fn short_flight() -> PreparedFlight {
    let trajectory = "family = \"figure-8\"\naltitude_m = 1.0\nduration_s = 7\nlength_m = 3.0\n\
                      width_m = 1.5\nperiod_s = 7\nclimb_m = 0.2\n";
    let flight =
        flight("short", trajectory, &["blade_flapping:moment_Nms_m=0.0004,tilt_rad_s_m=0"]);
    PreparedFlight::new(flight, &lockstep::params(lockstep::NANO)).expect("a usable flight")
}

/// Each velocity's mean over `width_s` about it, as the slope of positions over that time.
fn smoothed(velocity: &Stream<Ned>, width_s: f64) -> Stream<Ned> {
    let mut smoothed = Stream::default();
    for (time, _) in velocity.iter() {
        let near = velocity.iter().filter(|(t, _)| (t - time).abs() <= 0.5 * width_s);
        let near: Vec<Ned> = near.map(|(_, v)| *v).collect();
        let sum = near.iter().fold(Ned::zero(), |sum, v| sum + *v);
        smoothed.push(time, sum * (1.0 / near.len() as f64));
    }
    smoothed
}

#[test]
fn smoothed_velocity_does_not_lower_the_thrust() {
    let trajectory = "family = \"figure-8\"\naltitude_m = 1.0\nduration_s = 20\nlength_m = 0.8\n\
                      width_m = 0.4\nperiod_s = 2.5\nclimb_m = 0.05\n";
    let params = lockstep::params(lockstep::NANO);
    let mut flight = flight("fast", trajectory, &[]);
    flight.velocity = smoothed(&flight.velocity, 0.24);
    let flights = [PreparedFlight::new(flight, &params).expect("a usable flight")];
    let evaluator = Evaluator::new(&params).observing(&flights);
    let catalogue = Catalogue::new(&params, false);
    let observed = Observed::new(&flights, &evaluator, &catalogue);
    let search = Search::without_chance(&observed, &catalogue);
    let (_, about) = search.file().expect("a fit");
    let number = |target: Target| {
        let found = catalogue.numbers.iter().position(|number| number.target == target);
        found.expect("in the catalogue")
    };
    let thrust = number(Target::Effect(EffectId::ThrustScale, 0));
    let solution = about.solve(&catalogue, observed.counts(), &[thrust]).expect("a minimum");
    // The variance of times that are uniform over the width.
    let smoothing = solution.values[number(Target::VelocitySmoothing)];
    assert!((smoothing / (0.24 * 0.24 / 12.0) - 1.0).abs() < 0.2, "{smoothing}");
    assert!((solution.values[thrust] - 1.0).abs() < 0.02, "{}", solution.values[thrust]);
}

#[test]
fn linearised_residuals_match_those_of_its_solution() {
    let params = lockstep::params(lockstep::NANO);
    let flights = [short_flight()];
    let evaluator = Evaluator::new(&params).observing(&flights);
    let catalogue = Catalogue::at_scale(&params, false, 0.15);
    let observed = Observed::new(&flights, &evaluator, &catalogue);
    let search = Search::without_chance(&observed, &catalogue);
    let (file, about) = search.file().expect("a fit");
    let flapping = catalogue.hypotheses.iter().find(|h| h.effect == EffectId::BladeFlapping);
    let numbers = &flapping.expect("in the catalogue").numbers;
    let counts = observed.counts();
    let solution = about.solve(&catalogue, counts, numbers).expect("a minimum");
    let left = observed.power(&observed.residuals(&solution.values).expect("a vehicle"));
    let bins = || {
        let axes = (RATE..RATE + 2).flat_map(|axis| (0..5).map(move |band| (axis, band)));
        axes.map(|(axis, band)| Bin::index_of(axis, band)).filter(|bin| counts[*bin] > 0.0)
    };
    let shared = bins().filter(|bin| counts[*bin] < 8.0).count();
    assert!(shared > 4, "bands up to {} Hz have enough coefficients each", BANDS[4]);
    let total = |power: &[f64]| bins().map(|bin| power[bin]).sum::<f64>();
    let [solved, of_flights, by_file] = [&solution.power, &left, &file.fit.power].map(|p| total(p));
    assert!((solved - of_flights).abs() < 0.05 * by_file, "{solved}, {of_flights} of {by_file}");
    assert!(of_flights < 0.2 * by_file, "{of_flights} of {by_file}");
    let moment = solution.values[numbers[0]];
    assert!((moment / 4e-4 - 1.0).abs() < 0.15, "{moment}");
}
