//! The fleet diagnosis as a command: shared effects, individual effects, and resuming from finished
//! work.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

const VEHICLE: &str = "config/vehicles/crazyflie.toml";
const DRAG: &str = "rotor_drag:d_xy=0.02,d_z=0.01";
const OFFSET: &str = "com_offset:x_m=0.004,y_m=0";

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn downwash(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
    command.env("XDG_CONFIG_HOME", folder).current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// Flies a vehicle of the fleet.
fn fly(folder: &Path, name: &str, seed: u32, effects: &[&str]) {
    let mut command = downwash(folder);
    command.args(["collect", "--seconds", "60", "--vehicle", VEHICLE, "--seed"]);
    command.arg(seed.to_string()).arg("--out").arg(folder.join("fleet").join(name));
    for effect in effects {
        command.args(["--effect", effect]);
    }
    let output = command.output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn diagnose(folder: &Path, rows: &str, threads: u32) -> Output {
    let mut command = downwash(folder);
    command.env("RAYON_NUM_THREADS", threads.to_string());
    command.args(["diagnose", "--vehicle", VEHICLE, "--json", "--fail-on", "shared", "--fleet"]);
    command.arg(folder.join("fleet")).arg("--rows").arg(folder.join(rows));
    command.arg("-o").arg(folder.join("type.toml"));
    command.output().expect("the command runs")
}

fn answer(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

#[test]
fn single_vehicle_is_refused_as_a_fleet() {
    let folder = folder("fleet-of-one");
    fs::create_dir_all(folder.join("fleet/a")).expect("a folder");
    fs::write(folder.join("fleet/a/1.tlog"), b"").expect("a file");
    let output = diagnose(&folder, "rows", 1);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("two vehicles"));
    assert!(!folder.join("type.toml").exists());
}

#[test]
#[ignore = "long: tests/run --all"]
fn shared_and_individual_effects_are_separated_with_any_thread_count() {
    let folder = folder("fleet-shared");
    for (seed, name) in (1..).zip(["a", "b", "c", "d", "e", "f"]) {
        let own = if name == "d" { &[DRAG, OFFSET][..] } else { &[DRAG] };
        fly(&folder, name, seed, own);
    }
    let first = diagnose(&folder, "rows", 2);
    assert_eq!(first.status.code(), Some(10), "{}", String::from_utf8_lossy(&first.stderr));
    let found = answer(&first);
    let shared = found["shared"].as_array().expect("causes");
    assert_eq!(shared.len(), 1, "{found:#}");
    assert_eq!(shared[0]["id"], "rotor_drag");
    let d_xy = shared[0]["numbers"][0]["value"].as_f64().expect("a number");
    assert!((d_xy / 0.02 - 1.0).abs() < 0.1, "{d_xy}");
    for vehicle in found["vehicles"].as_array().expect("vehicles") {
        let is_damaged = vehicle["name"] == "d";
        assert_eq!(vehicle["state"], if is_damaged { "own" } else { "as_type" }, "{vehicle:#}");
        if is_damaged {
            assert_eq!(vehicle["effects"][0]["id"], "com_offset");
        }
    }
    let file = fs::read_to_string(folder.join("type.toml")).expect("the file of the type");
    assert!(file.contains("spread_between_vehicles") && !file.contains("com_offset"));
    // The answer is the same with stored rows and without them on one thread.
    let rows = folder.join("rows/rows-1-of-1.jsonl");
    let lines = fs::read_to_string(&rows).expect("rows");
    let kept: Vec<&str> = lines.lines().take(9).collect();
    fs::write(&rows, kept.join("\n")).expect("some rows");
    assert_eq!(diagnose(&folder, "rows", 2).stdout, first.stdout);
    assert_eq!(diagnose(&folder, "other-rows", 1).stdout, first.stdout);
    // Other logs belong to another fleet.
    fs::remove_dir_all(folder.join("fleet/a")).expect("a folder");
    assert_eq!(diagnose(&folder, "rows", 2).status.code(), Some(2));
}
