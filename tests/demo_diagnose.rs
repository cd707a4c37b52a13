//! The whole cycle in one command: hide an effect, identify it, and fly better with the result.

use std::fs;
use std::path::PathBuf;

use crate::command;
use serde_json::Value;
use vehicle::VehicleParams;

fn run(name: &str, arguments: &[&str]) -> (PathBuf, Value) {
    let folder = command::folder(&format!("demo-diagnose/{name}"));
    let output = command::downwash(&folder)
        .args(["demo", "--diagnose", "--json", "--excite", "60", "--out"])
        .arg(&folder)
        .args(arguments)
        .output()
        .expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    (folder, serde_json::from_slice(&output.stdout).expect("a summary"))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
fn hidden_drag_is_found_and_improves_the_planned_flight() {
    let (folder, summary) = run("drag", &["--hidden", "rotor_drag:d_xy=0.012,d_z=0.006"]);
    assert_eq!(summary["end"], "done");
    let found = number(&summary["found"]["rotor_drag"]["d_xy"]);
    assert!((found / 0.012 - 1.0).abs() < 0.05, "{found}");
    let (before, after) = (number(&summary["gap"]["before"]), number(&summary["gap"]["after"]));
    assert!(after < 0.4 * before, "gap {before} -> {after}");
    let error = |index: usize| number(&summary["contenders"][index]["mean"]["rmse_3d_m"]);
    assert!(error(1) < 0.3 * error(0), "error {} -> {}", error(0), error(1));
    assert!(VehicleParams::load(folder.join("improved.toml")).is_ok());
    for page in ["report.html", "diagnosis.html"] {
        let html = fs::read_to_string(folder.join(page)).expect("a page");
        assert!(html.contains("rotor_drag"), "{page}");
    }
}

#[test]
#[ignore = "long: tests/run --all"]
fn hidden_law_is_written_and_improves_the_planned_flight() {
    let hidden = "force_x = -0.012[kg/s]*air_x*(airspeed/1[m/s])^0.4; \
                  force_y = -0.012[kg/s]*air_y*(airspeed/1[m/s])^0.4";
    let (folder, summary) = run("law", &["--hidden", hidden]);
    assert_eq!(summary["end"], "done");
    let law = &summary["found"]["law"]["found"];
    // Over these speeds several forms give the same curve.
    assert!(law["force_x"].as_str().is_some_and(|text| text.contains("air_x")), "{law}");
    assert!(law["range"]["airspeed"][1].as_f64().is_some_and(|most| most > 0.5), "{law}");
    let (before, after) = (number(&summary["gap"]["before"]), number(&summary["gap"]["after"]));
    assert!(after < 0.4 * before, "gap {before} -> {after}");
    let error = |index: usize| number(&summary["contenders"][index]["mean"]["rmse_3d_m"]);
    assert!(error(1) < 0.4 * error(0), "error {} -> {}", error(0), error(1));
    let improved = VehicleParams::load(folder.join("improved.toml")).expect("a vehicle file");
    assert_eq!(improved.modelled_effects.laws().len(), 1);
    let html = fs::read_to_string(folder.join("diagnosis.html")).expect("a page");
    assert!(html.contains("The law") && html.contains("airspeed"));
}

#[test]
#[ignore = "long: tests/run --all"]
fn improved_file_compensates_weak_rotors_only_once() {
    let (_, summary) = run("weak", &["--hidden", "thrust_scale:scale=0.92"]);
    let error = |index: usize| number(&summary["contenders"][index]["mean"]["rmse_3d_m"]);
    assert!(error(1) < 0.3 * error(0), "error {} -> {}", error(0), error(1));
}
