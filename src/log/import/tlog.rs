//! Telemetry logs (.tlog) into flights.

use std::io::{self, Read};

use wire::Frame;
use wire::tlog::Reader;

use super::flight::Flight;
use super::frames::Frames;

/// Reads all frames of `source` into `flight`.
///
/// # Errors
/// Those of `source`.
pub(super) fn read(source: impl Read, flight: &mut Flight) -> io::Result<()> {
    let mut reader = Reader::new(source);
    let mut frames = Frames::default();
    while let Some(entry) = reader.read()? {
        // A message that the dialect does not have is nobody's loss.
        let Some(frame) = Frame::parse(&entry.frame) else { continue };
        frames.add(entry.time_us.map(|us| us.saturating_mul(1000)), &frame);
    }
    frames.left_out("byte that belongs to no whole frame", reader.skipped_bytes());
    frames.finish(flight);
    Ok(())
}
