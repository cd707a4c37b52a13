//! The program as a command, in a folder of the test's own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

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
