//! What `train` finds in flights with known truth: delays, labels, inputs, a model. Neither threads
//! nor interruptions change a byte.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use crate::learn;
use crate::learn::{logs, number};
use downwash::learn::commands::Onboard;
use downwash::learn::dataset::{ObservedFlight, Row, WindowSettings};
use downwash::learn::networks::Progress;
use downwash::learn::networks::Watch;
use downwash::learn::procedure::{Outcome, train};
use downwash::learn::refine::{FlightSpans, network_open_loop};
use downwash::learn::summary::TrainSettings;
use downwash::learn::training::Method;
use downwash::learn::training_set::TrainingSet;
use downwash::log::import::{self, Flight, MotorSource, MotorUnit, Stream};
use downwash::model::Model;
use downwash::model::features::Features;
use downwash::model::file::AccelerationSource::SpecificForce;
use downwash::model::file::ModelFile;
use downwash::model::learned::NetworkModel;
use serde_json::Value;
use vehicle::VehicleParams;

static REALISTIC: LazyLock<Vec<PathBuf>> = LazyLock::new(|| learn::collect("realistic", 120, &[]));
static SHORT: LazyLock<Vec<PathBuf>> = LazyLock::new(|| learn::collect("short", 32, &[]));
/// A model of the short flights, trained on one thread.
static MODEL: LazyLock<PathBuf> = LazyLock::new(|| {
    let (output, model) = learn::train("one-thread", &SHORT, &["--threads", "1"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    model
});
/// A training on the realistic flights.
static SUMMARY: LazyLock<Value> =
    LazyLock::new(|| learn::summary(&learn::train("whole", &REALISTIC, &[]).0));

#[test]
fn rotor_response_is_identified() {
    let found = |name: &str| number(&SUMMARY, &format!("/actuation/{name}"));
    // The delay counts from when a setpoint is sent; the vehicle's 250 Hz loop adds to it.
    assert!((found("delay_s") - 0.020).abs() < 0.003, "{}", found("delay_s"));
    assert!((found("lag_s") - 0.050).abs() < 0.004, "{}", found("lag_s"));
    assert!((found("voltage_exponent") - 1.4).abs() < 0.15, "{}", found("voltage_exponent"));
    assert!(SUMMARY["actuation"]["balance_s"].is_null(), "nothing is balanced in simulation");
}

#[test]
fn labels_are_close_to_the_truth() {
    assert!(number(&SUMMARY, "/data/label_error/linear") < 0.006);
    assert!(number(&SUMMARY, "/data/label_error/angular") < 0.05);
    assert!(number(&SUMMARY, "/data/label_bandwidth_hz") > 10.0);
}

#[test]
fn inputs_match_those_logged_by_the_vehicle() {
    for log in logs(&SUMMARY) {
        assert_eq!(log["source"], "setpoints through the on-board law");
        assert!(number(log, "/law_error") < 0.03, "{log}");
        for latency in ["/attitude_latency_s", "/velocity_latency_s"] {
            assert!(number(log, latency).abs() < 0.003, "{log}");
        }
    }
}

#[test]
fn no_flight_is_split_between_parts() {
    assert_eq!(SUMMARY["data"]["split"], "whole-flights");
    assert!(logs(&SUMMARY).iter().all(|log| log["parts"].as_array().expect("parts").len() == 1));
    let rows: f64 = (0..3).map(|part| number(&SUMMARY, &format!("/data/rows/{part}"))).sum();
    let logged: f64 = logs(&SUMMARY).iter().map(|log| number(log, "/rows")).sum();
    assert!(rows == logged && rows > 12_000.0, "{rows} of {logged}");
}

#[test]
fn every_model_beats_mean_and_baselines() {
    for (index, at_most) in [0.3, 0.02, 0.05].into_iter().enumerate() {
        for kind in ["linear", "angular"] {
            let error = number(&SUMMARY, &format!("/one_step/{index}/truth/2/{kind}"));
            assert!(error < at_most, "{}: {error}", SUMMARY["one_step"][index]["model"]);
        }
    }
    // Physics, then hold and constant velocity, at half a second.
    let error = |predictor: usize, of: &str| {
        number(&SUMMARY, &format!("/multi_step/{predictor}/errors/2/{of}"))
    };
    for of in ["position_m", "velocity_m_s", "attitude_rad", "rate_rad_s"] {
        assert!(error(1, of) < 0.5 * error(3, of).min(error(4, of)), "{of}");
    }
}

#[test]
fn estimate_latencies_are_found() {
    let flights =
        observed(flights(&learn::collect("late", 40, &["estimator_latency:latency_s=0.03"])));
    for flight in flights {
        let (attitude, velocity) = (flight.alignment.attitude_s, flight.alignment.velocity_s);
        assert!((attitude.expect("found") - 0.03).abs() < 0.002, "{attitude:?}");
        assert!((velocity.expect("found") - 0.03).abs() < 0.003, "{velocity:?}");
    }
}

#[test]
fn outputs_replace_a_law_that_does_not_match_the_vehicle() {
    let gain = "pd_gain:kp_scale=[2.0,2.0,2.0],kd_scale=[1.8,1.8,1.8]";
    let flights = observed(flights(&learn::collect("gain", 40, &[gain])));
    let by_outputs = |flight: &&ObservedFlight| flight.source.name() == "motor outputs";
    let found: Vec<_> = flights.iter().map(|f| (f.source, f.law_error)).collect();
    assert!(flights.iter().filter(by_outputs).count() >= 3, "{found:?}");
}

fn vehicle() -> VehicleParams {
    VehicleParams::load(learn::vehicle()).expect("a vehicle")
}

fn flights(logs: &[PathBuf]) -> impl Iterator<Item = Flight> {
    logs.iter().map(|path| import::open(path, None).expect("a log"))
}

fn observed(flights: impl Iterator<Item = Flight>) -> Vec<ObservedFlight> {
    let vehicle = vehicle();
    let onboard = Onboard::new(&vehicle).expect("a mixer");
    let windows = WindowSettings::default();
    let observe = |flight| ObservedFlight::new(flight, &vehicle, &onboard, &windows, &[]);
    flights.map(|flight| observe(flight).expect("a flight")).collect()
}

/// The paper's setup: setpoints and a known law, without motor outputs.
#[test]
fn flights_without_motor_outputs_are_usable() {
    let without = flights(&SHORT).map(|flight| Flight {
        outputs: Stream::default(),
        motor_unit: MotorUnit::VehicleFile,
        ..flight
    });
    let flights = observed(without);
    assert_eq!(flights.len(), SHORT.len());
    for flight in &flights {
        assert_eq!(flight.source.name(), "setpoints through the on-board law");
    }
}

#[test]
fn missing_outputs_are_computed_by_the_onboard_law() {
    let onboard = Onboard::new(&vehicle()).expect("a mixer");
    for flight in flights(&SHORT) {
        let logged = flight.outputs.clone();
        assert!(!onboard.complete_outputs(&mut flight.clone(), 0.0), "logged outputs are kept");
        let mut without = Flight { outputs: Stream::default(), ..flight.clone() };
        assert!(onboard.complete_outputs(&mut without, 0.0));
        assert_eq!(without.motor_source, MotorSource::OnboardLaw);
        let off = without.outputs.iter().filter_map(|(time, made)| {
            let index = logged.index_at(time)?;
            let flown = flight.in_air.index_at(time).is_some_and(|i| flight.in_air.values()[i]);
            let pairs = logged.values()[index].iter().zip(made);
            flown.then(|| pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 4.0)
        });
        let off: Vec<f64> = off.collect();
        let rms = (off.iter().sum::<f64>() / off.len() as f64).sqrt();
        assert!(off.len() > 500 && rms < 0.08, "{rms} over {}", off.len());
    }
}

#[test]
#[ignore = "long: tests/run --all"]
fn thread_count_and_log_order_do_not_change_a_byte() {
    let turned: Vec<PathBuf> = SHORT.iter().rev().cloned().collect();
    let (two, second) = learn::train("two-threads", &turned, &["--threads", "2"]);
    assert!(two.status.success());
    assert!(fs::read(&*MODEL).expect("a model") == fs::read(second).expect("a model"));
}

#[test]
#[ignore = "long: tests/run --all"]
fn open_loop_refinement_corrects_wrong_gains() {
    let vehicle = vehicle();
    let onboard = Onboard::new(&vehicle).expect("a mixer");
    let flights = observed(flights(&SHORT));
    let ModelFile { net, actuation, .. } = ModelFile::load(&MODEL).expect("a model");
    let angular = net.angular.corrected([0.7, 0.7, 0.7], [0.3, -0.3, 0.0], &[]);
    let spoiled = NetworkModel { angular, ..net.clone() };
    let of = |flight| FlightSpans { flight, spans: flight.segments.spans.clone() };
    let spans: Vec<_> = flights.iter().map(of).collect();
    let refined = network_open_loop(&spans, &onboard, &actuation, &spoiled).expect("windows");
    let off = |model: &NetworkModel| -> f64 {
        let rows = flights.iter().flat_map(|f| f.rows(&onboard, &actuation, SpecificForce));
        let off = |row: Row| {
            let pairs =
                model.accelerations(&row.point).into_iter().zip(net.accelerations(&row.point));
            pairs.skip(3).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        rows.map(off).sum()
    };
    let (before, after) = (off(&spoiled), off(&refined));
    assert!(after < 0.1 * before, "{before} {after}");
}

/// Interrupts after a number of steps of the networks' training.
struct Patience {
    left: usize,
    training: bool,
}

impl Watch for Patience {
    fn stage(&mut self, name: &str, _: u64) {
        self.training = name == "networks";
    }

    fn step(&mut self, _: &str) {
        if self.training {
            self.left = self.left.saturating_sub(1);
        }
    }

    fn interrupted(&self) -> bool {
        self.left == 0
    }
}

#[test]
#[ignore = "long: tests/run --all"]
fn interrupted_training_resumes_to_the_same_result() {
    let vehicle = vehicle();
    let onboard = Onboard::new(&vehicle).expect("a mixer");
    let windows = WindowSettings::default();
    let mut flights = observed(flights(&SHORT));
    let set = TrainingSet::new(&vehicle, &onboard, &mut flights).expect("a set");
    let settings = TrainSettings {
        features: Features::Heading,
        hidden: 10,
        passes: 12,
        method: Method::Rprop,
        regularization: vec![1e-6, 1e-4],
        seed: 1,
        window_half_s: windows.half_s,
        windows_half_s: vec![windows.half_s],
    };
    let run = |settings: &TrainSettings, progress: Option<Progress>, steps: usize| {
        let mut watch = Patience { left: steps, training: false };
        train(&set, settings, &windows, Vec::new(), progress, &mut watch)
    };
    let done = |outcome| match outcome {
        Ok(Outcome::Done(done)) => *done,
        Ok(Outcome::Interrupted(_)) => panic!("interrupted"),
        Err(error) => panic!("{error}"),
    };
    let whole = done(run(&settings, None, usize::MAX));
    let mut progress = None;
    let mut interruptions = 0;
    // Interrupted as often as needed, each time resumed from the checkpoint.
    let resumed = loop {
        match run(&settings, progress.take(), 21).expect("a training") {
            Outcome::Done(done) => break *done,
            Outcome::Interrupted(so_far) => {
                interruptions += 1;
                let text = serde_json::to_string(&so_far).expect("JSON");
                progress = Some(serde_json::from_str(&text).expect("a checkpoint"));
            }
        }
        assert!(interruptions < 100, "no progress");
    };
    assert!(interruptions >= 2, "{interruptions}");
    assert_eq!(resumed, whole);

    let Ok(Outcome::Interrupted(progress)) = run(&settings, None, 5) else { panic!("done") };
    let other = TrainSettings { seed: 2, ..settings };
    let Err(error) = run(&other, Some(progress), 5) else { panic!("another training's") };
    assert!(error.to_string().contains("--resume"), "{error}");
    let Ok(Outcome::Interrupted(progress)) = run(&other, None, 5) else { panic!("done") };
    let other = TrainSettings { windows_half_s: vec![0.06], ..other };
    let Err(error) = run(&other, Some(progress), 5) else { panic!("other windows'") };
    assert!(error.to_string().contains("--resume"), "{error}");
}
