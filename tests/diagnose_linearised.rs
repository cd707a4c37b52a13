//! The linearised problem leaves the same residuals as the flights, also for short flights whose
//! bands share their variances.

use std::fs;
use std::path::Path;

use downwash::diagnose::catalogue::hypothesis::Catalogue;
use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::flights::spectrum::BANDS;
use downwash::diagnose::likelihood::channels::RATE;
use downwash::diagnose::likelihood::layout::Bin;
use downwash::diagnose::likelihood::observed::Observed;
use downwash::diagnose::likelihood::residuals::Evaluator;
use downwash::diagnose::search::Search;
use downwash::log::import;
use sitl::config::SitlConfig;
use vehicle::effects::EffectId;

use crate::{damage, lockstep};

/// A flight of seven seconds by a vehicle whose rotors flap.
fn flight() -> PreparedFlight {
    let trajectory = "family = \"figure-8\"\naltitude_m = 1.0\nduration_s = 7\nlength_m = 3.0\n\
                      width_m = 1.5\nperiod_s = 7\nclimb_m = 0.2\n";
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::toml_trajectory(trajectory));
    let effects = ["blade_flapping:moment_Nms_m=0.0004,tilt_rad_s_m=0"];
    let (_, records) = lockstep::fly(settings, &params, &effects, SitlConfig::default(), 7);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diagnose-linearised");
    fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("flight.tlog");
    damage::write_tlog(&path, &damage::entries(&records));
    let flight = import::open(&path, None).expect("a flight");
    PreparedFlight::new(flight, &params).expect("a flight that can be used")
}

#[test]
fn linearised_residuals_match_those_of_its_solution() {
    let params = lockstep::params(lockstep::NANO);
    let flights = [flight()];
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
