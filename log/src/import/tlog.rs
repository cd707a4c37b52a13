//! Reads telemetry logs (.tlog) into flights.

use std::io::Read;

use wire::Frame;
use wire::tlog::Reader;

use super::flight::Flight;
use super::frames::Frames;
use super::{Choice, Contents, LogFault};

/// Reads all frames of `source` into `flight`. Returns the names of the messages.
///
/// # Errors
/// Errors of `source`, or the log does not have the chosen vehicle or boot.
pub(super) fn read(
    source: impl Read,
    choice: Choice<'_>,
    flight: &mut Flight,
) -> Result<Contents, LogFault> {
    let mut reader = Reader::new(source);
    let mut frames = Frames::default();
    while let Some(entry) = reader.read()? {
        // A message that the dialect lacks is not counted as left out. The next frame of its sender
        // shows a gap.
        let Some(frame) = Frame::parse(&entry.frame) else { continue };
        frames.add(entry.time_us.map(|us| us.saturating_mul(1000)), &frame);
    }
    let skipped = reader.skipped_bytes();
    frames.left_out("byte that belongs to no whole frame", skipped);
    if let Some(first) = reader.first_skipped() {
        frames.lose(format!("{skipped} bytes belong to no whole frame, the first at byte {first}"));
    }
    let names = frames.finish(choice, flight)?;
    Ok(Contents { part: "message", names, reason: None })
}
