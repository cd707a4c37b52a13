//! The directions in which modules may know each other, as ARCHITECTURE.md says.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Module of `src/` -> modules of the crate that it may name.
fn allowed() -> BTreeMap<&'static str, &'static [&'static str]> {
    BTreeMap::from([
        ("clock", &[] as &[_]),
        ("setpoint", &[]),
        ("parameters", &[]),
        ("vehicle_init", &["parameters"]),
        ("link", &["clock", "setpoint"]),
        ("telemetry", &["clock", "setpoint", "link"]),
        ("control", &["clock", "setpoint"]),
        ("plan", &["control", "model", "setpoint"]),
        ("supervisor", &["clock", "setpoint", "link", "telemetry"]),
        ("pilot", &["clock", "setpoint", "link", "telemetry", "control", "plan", "supervisor"]),
        ("log", &["clock", "setpoint", "link", "parameters"]),
        ("model", &[]),
        ("learn", &["log", "model"]),
        ("audit", &["learn", "log"]),
        ("diagnose", &["audit", "control", "learn", "log", "model", "pilot", "plan", "setpoint"]),
        ("exam", &["control", "diagnose", "plan", "setpoint"]),
        (
            "report",
            &["clock", "control", "setpoint", "diagnose", "exam", "learn", "log", "model", "plan"],
        ),
        (
            "station",
            &[
                "clock",
                "setpoint",
                "control",
                "link",
                "log",
                "parameters",
                "pilot",
                "plan",
                "supervisor",
                "telemetry",
            ],
        ),
        ("lockstep", &["clock", "link", "log", "station"]),
        ("daemon", &["clock", "link", "log", "station", "supervisor"]),
        ("config", &["control", "link", "log", "pilot", "plan", "supervisor", "telemetry"]),
    ])
}

/// Only here may the asynchronous runtime be named.
const TOKIO: [&str; 6] = [
    "src/link/connection.rs",
    "src/daemon.rs",
    "src/main.rs",
    "src/command/",
    "sitl/src/server.rs",
    "sitl/src/cli.rs",
];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a source folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found
}

/// The text without comments and without the unit tests at its end.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).expect("a source file");
    let text = text.split("#[cfg(test)]").next().unwrap_or_default();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn relative(path: &Path) -> String {
    path.strip_prefix(root()).expect("inside the repository").to_string_lossy().into_owned()
}

#[test]
fn modules_know_only_what_lies_below_them() {
    let allowed = allowed();
    let mut wrong = Vec::new();
    for path in sources(&root().join("src")) {
        let inside = path.strip_prefix(root().join("src")).expect("inside src");
        let first = inside.components().next().expect("a component").as_os_str();
        let module = first.to_string_lossy().trim_end_matches(".rs").to_owned();
        if ["lib", "main", "cli", "command"].contains(&module.as_str()) {
            continue;
        }
        let known = allowed.get(module.as_str());
        let Some(known) = known else {
            wrong.push(format!("{}: module {module} has no row in the table", relative(&path)));
            continue;
        };
        let text = code(&path);
        let named: BTreeSet<&str> = text
            .split("crate::")
            .skip(1)
            .filter_map(|rest| rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next())
            .collect();
        for name in named {
            if name != module && !name.is_empty() && !known.contains(&name) {
                wrong.push(format!("{} names crate::{name}", relative(&path)));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn tokio_stays_at_the_edge() {
    let mut wrong = Vec::new();
    for folder in ["src", "sitl/src"] {
        for path in sources(&root().join(folder)) {
            let name = relative(&path);
            if !TOKIO.iter().any(|edge| name.starts_with(edge)) && code(&path).contains("tokio") {
                wrong.push(name);
            }
        }
    }
    assert!(wrong.is_empty(), "tokio outside of the edge: {}", wrong.join(", "));
}

#[test]
fn the_vehicle_knows_nothing_of_the_daemon() {
    let manifest = fs::read_to_string(root().join("sitl/Cargo.toml")).expect("the manifest");
    assert!(!manifest.lines().any(|line| line.trim_start().starts_with("downwash ")));
}
