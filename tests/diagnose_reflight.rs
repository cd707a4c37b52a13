//! Held-out flights, flown again in closed loop with the identified effects.

use std::fs;
use std::path::{Path, PathBuf};

use crate::command;
use crate::lockstep::{NANO, config_file};
use serde_json::Value;

fn run(folder: &Path, arguments: &[&str]) -> Value {
    let output = command::downwash(folder).args(arguments).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

/// Logs of a short programme with a hidden effect.
fn fly(folder: &Path, effect: &str) -> Vec<PathBuf> {
    let out = folder.join("flown");
    let (vehicle, out_text) = (config_file("vehicles", NANO), text(&out).to_owned());
    run(
        folder,
        &[
            "collect",
            "--json",
            "--seconds",
            "40",
            "--vehicle",
            text(&vehicle),
            "--out",
            &out_text,
            "--effect",
            effect,
        ],
    );
    let entries = fs::read_dir(&out).expect("the folder");
    let mut logs: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    logs.sort();
    logs
}

fn difference(answer: &Value, quantity: &str) -> [f64; 3] {
    ["before", "after", "floor"]
        .map(|of| answer["closed_loop"][quantity][of].as_f64().unwrap_or(f64::NAN))
}

#[test]
fn weak_thrust_is_repaired_in_position_and_thrust() {
    let folder = command::folder("reflight");
    let logs = fly(&folder, "thrust_scale:scale=0.9");
    let vehicle = config_file("vehicles", NANO);
    let mut arguments = vec!["diagnose", "--json", "--twins", "0", "--vehicle", text(&vehicle)];
    arguments.extend(logs.iter().map(|log| text(log)));
    let answer = run(&folder, &arguments);
    assert_eq!(answer["schema"], "downwash.diagnose");
    assert_eq!(answer["schema_version"], 2);
    assert_eq!(answer["closed_loop"]["flights"][0]["reference"], "logged");
    for quantity in ["position_m", "thrust_n", "output"] {
        let [before, after, floor] = difference(&answer, quantity);
        assert!(before > 2.0 * floor, "{quantity}: {before} {floor}");
        assert!(after < 1.3 * floor, "{quantity}: {after} {floor}");
    }
}
