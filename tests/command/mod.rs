//! The program as a command, in a folder of the test's own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// An empty folder with a name that no other test uses.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("a folder");
    path
}

/// The program without the settings of the user who runs the test.
pub fn downwash(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
    command.env("XDG_CONFIG_HOME", folder);
    command
}

/// The answer of `diagnose` to these logs, with few twins.
pub fn diagnosis(folder: &Path, vehicle: &Path, logs: &[PathBuf]) -> Value {
    let output = downwash(folder)
        .args(["diagnose", "--json", "--twins", "10", "--vehicle"])
        .arg(vehicle)
        .args(logs)
        .output()
        .expect("the command runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {errors}", folder.display());
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"))
}
