//! Twins of flights, simulated again, leave the same residuals as the flights.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use downwash::diagnose::catalogue::hypothesis::Catalogue;
use downwash::diagnose::flights::command_delay::MeasuredDelay;
use downwash::diagnose::flights::onboard::OnboardLaw;
use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::flights::spectrum::BANDS;
use downwash::diagnose::likelihood::channels::{
    ATTITUDE, CHANNEL_NAMES, CHANNELS, COMMAND, RATE, VELOCITY,
};
use downwash::diagnose::likelihood::noise::report_noise;
use downwash::diagnose::likelihood::observed::Observed;
use downwash::diagnose::likelihood::residuals::Evaluator;
use downwash::diagnose::search::Search;
use downwash::diagnose::search::twins::{Draws, TwinFits, screened};
use downwash::exam::case::Case;
use downwash::exam::condition::Condition;
use downwash::exam::order::{Kind, Order, Settings};
use downwash::log::import;
use vehicle::VehicleParams;
use vehicle::effects::EffectId;

/// Flights of the shipped nano quadrotor without an effect.
fn flights(vehicle: &Path) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diagnose-twins");
    let _ = fs::remove_dir_all(&folder);
    let output = Command::new(env!("CARGO_BIN_EXE_downwash"))
        .env("XDG_CONFIG_HOME", &folder)
        .args(["collect", "--seconds", "90", "--vehicle"])
        .arg(vehicle)
        .arg("--out")
        .arg(&folder)
        .output()
        .expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let entries = fs::read_dir(&folder).expect("the folder").map(|entry| entry.expect("it").path());
    let mut logs: Vec<_> =
        entries.filter(|path| path.extension() == Some("mcap".as_ref())).collect();
    logs.sort();
    logs
}

/// Scale of the file tolerances of these flights: the files are exact, and the clocks add jitter.
const FILE: f64 = 0.15;

/// The catalogue with the delay measured in the flights.
fn catalogue(vehicle: &VehicleParams, prepared: &[PreparedFlight], law: &OnboardLaw) -> Catalogue {
    let delay = MeasuredDelay::of(prepared, law).expect("outputs that answer setpoints");
    Catalogue::at_scale(vehicle, true, FILE).with_delay(&delay)
}

fn search<'a>(observed: &'a Observed<'a>, catalogue: &'a Catalogue) -> Search<'a> {
    Search { fitted: observed, choosing: observed, catalogue, chance: Vec::new() }
}

/// The flights of a case, with its logs in a given condition.
fn prepared(case: &Case, condition: Condition, folder: &str) -> Vec<PreparedFlight> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(folder);
    fs::create_dir_all(&folder).expect("a folder");
    let logs = case.logs.iter().enumerate().map(|(number, log)| {
        let path = folder.join(format!("{number}.tlog"));
        fs::write(&path, condition.apply(log, 0)).expect("a file");
        import::open(&path, None).expect("a log")
    });
    logs.map(|flight| PreparedFlight::new(flight, &case.nominal).expect("a flight")).collect()
}

/// Residuals of the nuisance fit to the flights over those of their twins, by channel: the
/// exponential of the mean logarithm, each band weighted by its information. Also the twin
/// vehicle's numbers, as offsets from the file's in tolerances.
fn ratios(
    vehicle: &VehicleParams,
    prepared: &[PreparedFlight],
) -> (Vec<(&'static str, f64)>, Vec<f64>) {
    ratios_up_to(f64::INFINITY, vehicle, prepared)
}

/// The same for residuals up to a frequency, Hz.
fn ratios_up_to(
    most_hz: f64,
    vehicle: &VehicleParams,
    prepared: &[PreparedFlight],
) -> (Vec<(&'static str, f64)>, Vec<f64>) {
    let evaluator = Evaluator::new(vehicle).observing(prepared);
    let law = evaluator.onboard().expect("the on-board law");
    let catalogue = catalogue(vehicle, prepared, law);
    let observed = Observed::new(prepared, &evaluator, &catalogue);
    let search = search(&observed, &catalogue);
    let (null, about) = search.file().expect("a fit");
    let noise = report_noise(prepared, &null.fit.power, observed.counts());
    let twins = TwinFits::of_null(&observed, &about, law, &noise, Draws { count: 8, seed: 1 })
        .expect("a vehicle that flies");
    let moments = twins.moments();
    let mut ratios = Vec::new();
    for (channel, name) in CHANNEL_NAMES.iter().enumerate() {
        let (mut sum, mut weight) = (0.0, 0.0);
        let bands = BANDS.iter().filter(|upper| **upper <= most_hz).count();
        let bins = channel * BANDS.len()..channel * BANDS.len() + bands;
        let of_flights = null.fit.power[bins.clone()].iter().zip(&observed.counts()[bins.clone()]);
        for ((power, n), [mean, _]) in of_flights.zip(&moments[bins]) {
            if *n > 0.0 && *mean > 0.0 {
                sum += n * (power / mean).ln();
                weight += n;
            }
        }
        assert!(weight > 0.0, "{name} was not checked");
        ratios.push((*name, (sum / weight).exp()));
    }
    let numbers = catalogue.numbers.iter().zip(&twins.truth);
    let off = numbers
        .filter(|(number, _)| number.tolerance > 0.0)
        .map(|(number, truth)| (truth - number.reference) / number.tolerance);
    (ratios, off.collect())
}

#[test]
#[ignore = "long: tests/run --all"]
fn twin_residuals_match_flight_residuals() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/vehicles/crazyflie.toml");
    let vehicle = VehicleParams::load(&path).expect("the vehicle");
    let mut prepared: Vec<PreparedFlight> = flights(&path)
        .iter()
        .map(|log| import::open(log, None).expect("a log"))
        .map(|flight| PreparedFlight::new(flight, &vehicle).expect("a flight"))
        .collect();
    // As if started on a hill: the flight has no floor at the log's zero.
    for [_, _, down] in prepared.iter_mut().flat_map(|flight| flight.position.values_mut()) {
        *down += 20.0;
    }
    let (ratios, off) = ratios(&vehicle, &prepared);
    let within = |channels: std::ops::Range<usize>, most: f64| {
        ratios[channels].iter().all(|(_, ratio)| (1.0 / most..most).contains(ratio))
    };
    assert!(within(VELOCITY..COMMAND, 1.3), "{ratios:.2?}");
    // Few setpoints arrive late enough to show in a command, so their number scatters. Yaw
    // setpoints hardly change, and their residuals are small.
    assert!(within(COMMAND..CHANNELS - 1, 1.5) && within(COMMAND..CHANNELS, 3.0), "{ratios:.2?}");
    // The fit recovers the flown vehicle: no number is off by more than its tolerance allows.
    assert!(off.iter().all(|off| off.abs() < 4.0), "{off:.1?}");
    // The twins include the noise that ground feedback puts into the setpoints. A course that
    // removed part of it lowered the slow moment residuals by a third.
    let (slow, _) = ratios_up_to(3.2, &vehicle, &prepared);
    assert!(slow[RATE..RATE + 2].iter().all(|(_, ratio)| *ratio < 1.17), "{slow:.2?}");
}

/// Half of the setpoints that the vehicle followed are in no log: twins that held the others longer
/// would leave a third of the moments.
#[test]
#[ignore = "long: tests/run --all"]
fn twin_residuals_match_a_thinned_log() {
    let settings = Settings { flights: 2, ..Settings::default() };
    let case = Case::fly(&settings, 5, 0, "thinned", &Order::from(Kind::Null)).expect("a case");
    let prepared = prepared(&case, Condition::HalfRate, "diagnose-twins-thinned");
    assert!(prepared.iter().all(|flight| !flight.inferred.is_empty()));
    let (ratios, _) = ratios(&case.nominal, &prepared);
    let moments = &ratios[RATE..ATTITUDE];
    assert!(moments.iter().all(|(_, ratio)| (0.6..1.6).contains(ratio)), "{ratios:.2?}");
}

/// A hover neither tilts nor turns, so its outputs are the loop's answer to the gyro noise, and the
/// same noise is in the moments that they explain. A heavier body would seem to explain it, in
/// twins as in the flights.
#[test]
fn hover_twins_reproduce_its_evidence_for_inertia() {
    let settings = Settings { flights: 2, ..Settings::default() };
    let of_trap = |number| Case::fly(&settings, 5, number, "hover", &Order::from(Kind::Trap));
    let shows_nothing = |case: &Case| case.key.effects.iter().any(|e| e.id == "vortex_ring");
    let mut cases = (0..32).filter_map(|number| of_trap(number).ok());
    let case = cases.find(shows_nothing).expect("a hover");
    let prepared = prepared(&case, Condition::Plain, "diagnose-twins-hover");
    let evaluator = Evaluator::new(&case.nominal).observing(&prepared);
    let law = evaluator.onboard().expect("the on-board law");
    let catalogue = catalogue(&case.nominal, &prepared, law);
    let observed = Observed::new(&prepared, &evaluator, &catalogue);
    let search = search(&observed, &catalogue);
    let (null, about) = search.file().expect("a fit");
    let noise = report_noise(&prepared, &null.fit.power, observed.counts());
    let draws = Draws { count: 8, seed: 1 };
    let twins = TwinFits::of_null(&observed, &about, law, &noise, draws).expect("twins");
    let screened = screened(&search, &null, &about, &twins, 1);
    let inertia = catalogue.hypotheses.iter().position(|h| h.effect == EffectId::Inertia);
    let inertia = inertia.expect("a hypothesis");
    let gains = search.screen(&about, &[]);
    let (_, gain) = gains.iter().find(|(hypothesis, _)| *hypothesis == inertia).expect("its gain");
    let (chance, threshold) = (screened.chance[inertia], screened.thresholds[inertia]);
    assert!(*gain > 20.0 && chance > 20.0, "{gain} {chance}");
    assert!(gain - chance < threshold, "{gain} {chance} {threshold}");
}
