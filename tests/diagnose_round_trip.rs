//! From a simulated vehicle with a hidden effect to the effect's name and numbers.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use crate::command;
use crate::command::downwash;
use crate::lockstep::{NANO, QUAD, config_file};
use serde_json::Value;
use vehicle::VehicleParams;
use vehicle::effects::EffectId;

fn vehicle(name: &str) -> PathBuf {
    config_file("vehicles", name)
}

fn folder(name: &str) -> PathBuf {
    command::folder(&format!("diagnose/{name}"))
}

/// Flies a programme of `seconds` with hidden effects; returns the logs in order.
fn fly(name: &str, vehicle_file: &str, seconds: u32, effects: &[&str]) -> Vec<PathBuf> {
    let folder = folder(name);
    let mut command = downwash(&folder);
    command.args(["collect", "--seconds", &seconds.to_string(), "--vehicle"]);
    command.arg(vehicle(vehicle_file)).arg("--out").arg(&folder);
    for effect in effects {
        command.args(["--effect", effect]);
    }
    let output = command.output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let entries = fs::read_dir(&folder).expect("the folder");
    let mut logs: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    logs.sort();
    logs
}

fn diagnose(name: &str, vehicle_file: &str, logs: &[PathBuf], more: &[&str]) -> Output {
    downwash(&folder(&format!("{name}-diagnosis")))
        .args(["diagnose", "--json", "--vehicle"])
        .arg(vehicle(vehicle_file))
        .args(logs)
        .args(more)
        .output()
        .expect("the command runs")
}

fn answer(output: &Output) -> Value {
    ended_with(output, 0)
}

fn ended_with(output: &Output, code: i32) -> Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"))
}

fn named(answer: &Value) -> Vec<&str> {
    let effects = answer["effects"].as_array().expect("effects");
    effects
        .iter()
        .filter(|effect| effect["probability"].as_f64().is_some_and(|p| p >= 0.5))
        .filter_map(|effect| effect["id"].as_str())
        .collect()
}

#[test]
fn drag_is_identified_and_the_improved_file_closes_the_gap() {
    let logs = fly("drag", NANO, 60, &["rotor_drag:d_xy=0.01,d_z=0.004"]);
    let improved = folder("drag-improved").join("improved.toml");
    let out = improved.to_str().expect("a path in UTF-8");
    let more = ["--twins", "10", "-o", out, "--fail-on", "effect"];
    let answer = ended_with(&diagnose("drag", NANO, &logs, &more), 10);
    assert_eq!(answer["verdict"], "effect", "{}", answer["finding"]);
    assert_eq!(named(&answer), ["rotor_drag"]);
    let d_xy = answer["effects"][0]["parameters"]["d_xy"].as_f64().expect("d_xy");
    assert!((d_xy / 0.01 - 1.0).abs() < 0.05, "{d_xy}");
    assert!(answer["gap"]["closure"].as_f64().expect("a closure") > 0.9, "{}", answer["gap"]);
    // Drag is a function of the state, so a learner finds it too.
    let gap = |key: &str| answer["gap"][key].as_f64().unwrap_or_else(|| panic!("no {key}"));
    let learner = gap("with_learner");
    assert!(gap("before") - learner > 0.5 * (gap("before") - gap("floor")), "{}", answer["gap"]);

    let improved = vehicle::VehicleParams::load(&improved).expect("the improved file");
    let written = improved.modelled_effects.value(vehicle::effects::EffectId::RotorDrag, "d_xy", 0);
    assert!(written.is_some_and(|written| (written - d_xy).abs() < 1e-12));
}

/// No fit finds gusts: the diagnosis derives them from the residual force.
#[test]
#[ignore = "long: tests/run --all"]
fn improved_file_contains_gusts() {
    let nominal = folder("gusts-file").join("nano.toml");
    let text = fs::read_to_string(vehicle(NANO)).expect("the vehicle file");
    let drag = "[modelled_effects]\nparasitic_drag = { cda_m2 = 0.02 }\n";
    let with_drag = text.replace("[modelled_effects]\n", drag);
    assert_ne!(with_drag, text);
    fs::write(&nominal, with_drag).expect("a file");
    let nominal = nominal.to_str().expect("a path in UTF-8");
    let logs = fly("gusts", nominal, 40, &["gusts:sigma_m_s=0.8"]);
    let improved = folder("gusts-improved").join("improved.toml");
    let out = improved.to_str().expect("a path in UTF-8");
    let answer = answer(&diagnose("gusts", nominal, &logs, &["--twins", "10", "-o", out]));
    assert_eq!(named(&answer), ["gusts"], "{}", answer["finding"]);
    let improved = VehicleParams::load(&improved).expect("the improved file");
    let sigma = improved.modelled_effects.value(EffectId::Gusts, "sigma_m_s", 0);
    assert!(sigma.is_some_and(|sigma| (0.4..1.2).contains(&sigma)), "{sigma:?}");
}

#[test]
fn vehicle_without_effects_is_diagnosed_as_none() {
    let logs = fly("null", QUAD, 40, &[]);
    let output = diagnose("null", QUAD, &logs, &["--twins", "10", "--fail-on", "gap"]);
    let answer = answer(&output);
    assert_eq!(answer["verdict"], "none", "{}", answer["finding"]);
    assert!(named(&answer).is_empty());
}

/// Any delay between two ticks of the loop leaves the same setpoints in force, so the fitted delay
/// is as good as the one from the outputs, and twins with the wrong one would leave smaller
/// residuals than the flights.
#[test]
#[ignore = "long: tests/run --all"]
fn delay_of_whole_ticks_is_identified() {
    let logs = fly("ticks", NANO, 40, &["command_delay:delay_s=0.012"]);
    let answer = answer(&diagnose("ticks", NANO, &logs, &["--twins", "10"]));
    assert_eq!(named(&answer), ["command_delay"], "{}", answer["finding"]);
    let delay = answer["effects"][0]["parameters"]["delay_s"].as_f64().expect("delay_s");
    assert!((delay - 0.012).abs() < 1.5e-3, "{delay}");
}

/// Predictions from the flown state hardly show the delay, and loop gains act as a proxy: they have
/// the evidence but close no gap.
#[test]
#[ignore = "long: tests/run --all"]
fn proxy_effect_that_closes_no_gap_is_not_named() {
    let logs = fly("stand-in", NANO, 40, &["command_delay:delay_s=0.009"]);
    let more = ["--twins", "10", "--without", "command_delay"];
    let answer = answer(&diagnose("stand-in", NANO, &logs, &more));
    assert!(named(&answer).is_empty(), "{}", answer["finding"]);
}

#[test]
fn invalid_logs_are_refused_and_nothing_is_written() {
    let own = folder("bad");
    let (empty, foreign) = (own.join("empty.tlog"), own.join("foreign.tlog"));
    fs::write(&empty, []).expect("a file");
    fs::write(&foreign, "not a log").expect("a file");
    let improved = own.join("improved.toml");
    let out = improved.to_str().expect("a path in UTF-8");
    let output = diagnose("bad", NANO, &[empty, foreign], &["-o", out]);
    assert_eq!(output.status.code(), Some(2));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        errors.contains("empty.tlog is not a flight log") && errors.contains("found an empty file"),
        "{errors}"
    );
    assert!(errors.contains("foreign.tlog"), "{errors}");
    assert!(!improved.exists());
}
