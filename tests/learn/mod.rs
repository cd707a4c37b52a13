//! Flights of the bundled vehicle for learning, and `train` on them.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use crate::command;
pub use crate::command::downwash;
use crate::lockstep;
use serde_json::Value;

/// Differences from the vehicle file, as on a real vehicle.
pub const REALISTIC: [&str; 4] = [
    "rotor_drag:d_xy=0.012,d_z=0.008",
    "motor_lag:tau_s=0.05",
    "command_delay:delay_s=0.02",
    "battery_sag:exponent=1.4",
];

/// The bundled vehicle's file.
pub fn vehicle() -> PathBuf {
    lockstep::config_file("vehicles", lockstep::NANO)
}

pub fn folder(name: &str) -> PathBuf {
    command::folder(&format!("learn/{name}"))
}

/// Flies a programme of `seconds` with the realistic effects and `more`; returns the logs in order.
pub fn collect(name: &str, seconds: u32, more: &[&str]) -> Vec<PathBuf> {
    let folder = folder(name);
    let mut command = downwash(&folder);
    command.args(["collect", "--seconds", &seconds.to_string(), "--out"]).arg(&folder);
    for effect in REALISTIC.iter().chain(more) {
        command.args(["--effect", effect]);
    }
    let output = command.output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let entries = fs::read_dir(&folder).expect("the folder");
    let mut logs: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    logs.sort();
    logs
}

/// Trains small networks; returns the output and the model file.
pub fn train(name: &str, logs: &[PathBuf], more: &[&str]) -> (Output, PathBuf) {
    let folder = folder(name);
    let model = folder.join("model.safetensors");
    let small = ["--passes", "30", "--hidden", "24", "--regularization", "1e-5", "--json"];
    let output = downwash(&folder)
        .args(["train", "--vehicle"])
        .arg(vehicle())
        .args(logs)
        .arg("--out")
        .arg(&model)
        .args(small)
        .args(more)
        .output()
        .expect("the command runs");
    (output, model)
}

/// The summary of a successful training.
pub fn summary(output: &Output) -> Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"))
}

pub fn number(summary: &Value, pointer: &str) -> f64 {
    let value = summary.pointer(pointer).and_then(Value::as_f64);
    value.unwrap_or_else(|| panic!("{pointer} in {summary}"))
}

pub fn logs(summary: &Value) -> &[Value] {
    summary["data"]["logs"].as_array().expect("logs")
}
