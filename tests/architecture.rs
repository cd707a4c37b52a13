//! Enforces the rules of ARCHITECTURE.md: which modules may depend on which, and no circular
//! dependencies between files.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use crate::rust_source::{Crate, Module, code, root, sources};

/// Module of `src/` -> modules of the crate that it may name. Manifests limit the other crates.
fn allowed() -> BTreeMap<&'static str, &'static [&'static str]> {
    BTreeMap::from([
        ("planted", &[] as &[_]),
        ("vehicle_init", &[]),
        ("vehicle_check", &["learn", "vehicle_init"]),
        ("guard", &["control"]),
        ("link", &["guard"]),
        ("telemetry", &["link"]),
        ("control", &[]),
        ("plan", &["control", "model"]),
        ("supervisor", &["guard", "link", "telemetry"]),
        ("offboard", &["guard", "link", "telemetry", "control", "plan", "supervisor"]),
        ("onset", &[]),
        ("health", &["onset"]),
        ("lap_learning", &["audit", "learn", "model", "plan"]),
        ("model", &[]),
        ("learn", &["model"]),
        ("audit", &["learn"]),
        ("diagnose", &["audit", "control", "learn", "model", "onset", "offboard", "plan"]),
        ("campaign", &["control", "exam", "link", "lockstep", "plan", "station", "supervisor"]),
        ("exam", &["control", "diagnose", "onset", "plan"]),
        ("report", &["control", "diagnose", "exam", "learn", "model", "onset", "plan"]),
        ("station", &["guard", "control", "link", "offboard", "plan", "supervisor", "telemetry"]),
        ("lockstep", &["link", "station"]),
        ("daemon", &["forward", "guard", "link", "memory", "station", "supervisor", "view"]),
        ("forward", &[]),
        ("memory", &[]),
        ("mocap", &["link"]),
        ("http", &[]),
        ("service", &["health", "http", "station", "supervisor"]),
        ("view", &["http", "offboard", "station"]),
        ("config", &["control", "link", "mocap", "offboard", "plan", "supervisor", "telemetry"]),
    ])
}

/// The folders and files of the diagnosis, from the lowest layer up.
const DIAGNOSIS: [&str; 15] = [
    "error",
    "flights",
    "onset",
    "catalogue",
    "likelihood",
    "residual_analysis",
    "simulate",
    "search",
    "context",
    "verdict",
    "discovery",
    "next_flight",
    "answer",
    "pipeline",
    "fleet",
];

/// Folders of the crates' sources.
const CRATES: [&str; 6] = ["src", "log/src", "message/src", "sitl/src", "vehicle/src", "wire/src"];

/// Paths that may name the asynchronous runtime.
const TOKIO: [&str; 11] = [
    "src/http.rs",
    "src/service.rs",
    "src/link/connection.rs",
    "src/daemon.rs",
    "src/main.rs",
    "src/view/front.rs",
    "src/view/relay.rs",
    "src/view/server.rs",
    "src/command/",
    "sitl/src/server.rs",
    "sitl/src/cli.rs",
];

/// Remaining circular dependencies: allowed between two files whose paths both start with an entry
/// of the same group.
const CIRCLES: [&[&str]; 2] = [
    // A personality acts on the commander that calls it.
    &["sitl/src/autopilot/commander.rs", "sitl/src/autopilot/personality.rs"],
    // The vehicle file holds effects, and effects act on the vehicle.
    &[
        "vehicle/src/effects",
        "vehicle/src/law",
        "vehicle/src/params.rs",
        "vehicle/src/physics",
        "vehicle/src/rotor.rs",
    ],
];

#[test]
fn modules_depend_only_on_lower_modules() {
    let allowed = allowed();
    let daemon = Crate::read("src");
    let mut wrong = Vec::new();
    for (module, known) in daemon.graph() {
        let path = &daemon.modules[module].path;
        let Some(own) = module.first() else { continue };
        if ["cli", "command"].contains(&own.as_str()) {
            continue;
        }
        let Some(row) = allowed.get(own.as_str()) else {
            wrong.push(format!("{path}: module {own} has no row in the table"));
            continue;
        };
        for other in known.iter().filter_map(|known| known.first()).collect::<BTreeSet<_>>() {
            if other != own && !row.contains(&other.as_str()) {
                wrong.push(format!("{path} names crate::{other}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A folder of the diagnosis may name only earlier ones.
#[test]
fn diagnosis_modules_are_layered() {
    let daemon = Crate::read("src");
    let layer = |module: &Module| match module.as_slice() {
        [first, folder, ..] if first == "diagnose" => DIAGNOSIS.iter().position(|l| l == folder),
        _ => None,
    };
    let mut wrong = Vec::new();
    for (module, known) in daemon.graph() {
        let path = &daemon.modules[module].path;
        let Some(own) = layer(module) else {
            assert!(!path.starts_with("src/diagnose/") || module.len() == 1, "{path} has no layer");
            continue;
        };
        let above = known.iter().filter(|other| layer(other).is_some_and(|layer| layer > own));
        wrong.extend(above.map(|other| format!("{path} names {}", other.join("::"))));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A module and its submodules may name each other.
#[test]
fn files_have_no_circular_dependencies() {
    let mut wrong = Vec::new();
    for folder in CRATES {
        let files = Crate::read(folder);
        let mut graph = files.graph();
        for (module, known) in &mut graph {
            known.retain(|other| !other.starts_with(module) && !module.starts_with(other));
        }
        let reached = |from: &Module| {
            let (mut reached, mut open) = (BTreeSet::new(), vec![from.clone()]);
            while let Some(next) = open.pop() {
                for other in graph.get(&next).into_iter().flatten() {
                    if reached.insert(other.clone()) {
                        open.push(other.clone());
                    }
                }
            }
            reached
        };
        let all: BTreeMap<_, _> = graph.keys().map(|module| (*module, reached(module))).collect();
        for (module, known) in &graph {
            let path = &files.modules[*module].path;
            for other in known {
                let (other, back) = (&files.modules[other].path, all.get(other));
                let passes = |group: &&[&str]| {
                    [path, other].iter().all(|path| group.iter().any(|g| path.starts_with(g)))
                };
                if back.is_some_and(|back| back.contains(*module)) && !CIRCLES.iter().any(passes) {
                    wrong.push(format!("{path} -> {other}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "steps of circles:\n{}", wrong.join("\n"));
}

#[test]
fn tokio_is_used_only_at_the_edge() {
    let mut wrong = Vec::new();
    for file in CRATES.into_iter().filter(|folder| *folder != "wire/src").flat_map(sources) {
        let edge = TOKIO.iter().any(|edge| file.starts_with(edge));
        if !edge && code(&file).iter().any(|token| token == "tokio") {
            wrong.push(file);
        }
    }
    assert!(wrong.is_empty(), "tokio outside of the edge: {}", wrong.join(", "));
}

#[test]
fn simulated_vehicle_does_not_depend_on_the_daemon() {
    let manifest = fs::read_to_string(root().join("sitl/Cargo.toml")).expect("the manifest");
    assert!(!manifest.lines().any(|line| line.trim_start().starts_with("downwash ")));
}

/// Tests of a file that `main.rs` does not declare would never run.
#[test]
fn every_test_file_is_included() {
    for folder in ["tests", "log/tests", "sitl/tests", "vehicle/tests"] {
        let main = code(&format!("{folder}/main.rs"));
        let named: BTreeSet<_> = main.windows(2).filter(|pair| pair[0] == "mod").collect();
        for file in sources(folder) {
            let name = file.trim_start_matches(folder).trim_matches('/').trim_end_matches(".rs");
            let name = name.trim_end_matches("/mod");
            if name != "main" {
                assert!(named.iter().any(|pair| pair[1] == name), "{folder}/main.rs: mod {name};");
            }
        }
    }
}
