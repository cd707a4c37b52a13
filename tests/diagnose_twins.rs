//! Twins of flights: simulated again, they leave what the flights leave.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use downwash::diagnose::arrival::Delay;
use downwash::diagnose::hypothesis::Catalogue;
use downwash::diagnose::noise::report_noise;
use downwash::diagnose::observed::Observed;
use downwash::diagnose::preparation::PreparedFlight;
use downwash::diagnose::residuals::{CHANNEL_NAMES, CHANNELS, COMMAND, Evaluator, VELOCITY};
use downwash::diagnose::selection::{Selector, Thresholds};
use downwash::diagnose::spectrum::BANDS;
use downwash::diagnose::twins::TwinFits;
use downwash::log::import;
use sitl::vehicle::VehicleParams;

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

#[test]
fn twins_leave_what_the_flights_leave() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/vehicles/crazyflie.toml");
    let vehicle = VehicleParams::load(&path).expect("the vehicle");
    let prepared: Vec<PreparedFlight> = flights(&path)
        .iter()
        .map(|log| import::open(log, None).expect("a log"))
        .map(|flight| PreparedFlight::new(flight, &vehicle).expect("a flight"))
        .collect();
    let evaluator = Evaluator::new(&vehicle).observing(&prepared);
    let law = evaluator.onboard().expect("the on-board law");
    let delay = Delay::of(&prepared, law).expect("outputs that answer setpoints");
    let catalogue = Catalogue::new(&vehicle, true).with_delay(&delay);
    let observed = Observed::new(&prepared, &evaluator, &catalogue);
    let selector = Selector {
        fitted: &observed,
        held_out: &observed,
        catalogue: &catalogue,
        setpoint_leg: true,
        thresholds: Thresholds::default(),
        floor: None,
    };
    let (null, about) = selector.null().expect("a fit");
    let noise = report_noise(&prepared, &null.fit.power, observed.counts());
    let twins =
        TwinFits::draw(&observed, &about, &[], law, &noise, (8, 1)).expect("a vehicle that flies");
    let moments = twins.moments();
    let mut ratios = Vec::new();
    for (channel, name) in CHANNEL_NAMES.iter().enumerate() {
        // Weighed by how much each band says: the mean of the logarithms of the ratios.
        let (mut sum, mut weight) = (0.0, 0.0);
        let places = channel * BANDS.len()..(channel + 1) * BANDS.len();
        let of_flights =
            null.fit.power[places.clone()].iter().zip(&observed.counts()[places.clone()]);
        for ((power, n), [mean, _]) in of_flights.zip(&moments[places]) {
            if *n > 0.0 && *mean > 0.0 {
                sum += n * (power / mean).ln();
                weight += n;
            }
        }
        assert!(weight > 0.0, "{name} was not looked at");
        let ratio = (sum / weight).exp();
        ratios.push((name, ratio));
    }
    let within = |channels: std::ops::Range<usize>, most: f64| {
        ratios[channels].iter().all(|(_, ratio)| (1.0 / most..most).contains(ratio))
    };
    assert!(within(VELOCITY..COMMAND, 1.3), "{ratios:.2?}");
    // Few setpoints come late enough to show in a command: their number scatters. Those of the yaw
    // hardly change, and little is left of them.
    assert!(within(COMMAND..CHANNELS - 1, 1.5) && within(COMMAND..CHANNELS, 3.0), "{ratios:.2?}");
    // What was flown is what is fitted: no number is off by more than its tolerance allows.
    for (i, number) in catalogue.numbers.iter().enumerate().filter(|(_, n)| n.tolerance > 0.0) {
        let off = (twins.truth[i] - number.reference) / number.tolerance;
        assert!(off.abs() < 4.0, "{:?} is off by {off:.1} tolerances", number.target);
    }
}
