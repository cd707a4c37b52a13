//! Writes on-board logs into files and imports them.

use std::fs;
use std::path::{Path, PathBuf};

use downwash_log::import::{Flight, Stream, open};

/// Where a test writes a file.
pub fn place(test: &str, name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log_onboard").join(test);
    fs::create_dir_all(&directory).expect("a folder");
    directory.join(name)
}

/// The flight of a log with these bytes.
pub fn import(test: &str, name: &str, bytes: &[u8]) -> Flight {
    let path = place(test, name);
    fs::write(&path, bytes).expect("a file");
    open(&path, None).unwrap_or_else(|error| panic!("{error}"))
}

/// How many messages were left out for a reason with these words.
pub fn left_out(flight: &Flight, words: &str) -> u64 {
    flight.left_out.iter().filter(|(reason, _)| reason.contains(words)).map(|(_, n)| n).sum()
}

/// Checks that times are finite and increase.
pub fn assert_sound<T>(stream: &Stream<T>) {
    assert!(stream.times().windows(2).all(|pair| pair[0] < pair[1]));
    assert!(stream.times().iter().all(|time| time.is_finite()));
}
