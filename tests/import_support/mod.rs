//! Telemetry logs written for a test, and checks of what their import returns.

use std::fs;
use std::path::{Path, PathBuf};

use crate::damage;
use downwash::log::import::{Flight, Stream, open};

/// Path of a log file that does not exist yet, in a folder that only this test uses.
pub fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_import").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    let path = directory.join(name);
    let _ = fs::remove_file(&path);
    path
}

pub fn write_tlog(test: &str, name: &str, entries: &[(u64, Vec<u8>)]) -> PathBuf {
    let path = place(test, name);
    damage::write_tlog(&path, entries);
    path
}

pub fn import(path: &Path) -> Flight {
    open(path, None).unwrap_or_else(|error| panic!("{error}"))
}

/// How many messages or samples the import left out for a reason that contains `words`.
pub fn left_out(flight: &Flight, words: &str) -> u64 {
    flight.left_out.iter().filter(|(reason, _)| reason.contains(words)).map(|(_, n)| n).sum()
}

/// Asserts that time stamps are finite and increase strictly.
pub fn assert_ascends<T>(stream: &Stream<T>, name: &str) {
    assert!(stream.times().windows(2).all(|pair| pair[0] < pair[1]), "{name}");
    assert!(stream.times().iter().all(|time| time.is_finite()), "{name}");
}
