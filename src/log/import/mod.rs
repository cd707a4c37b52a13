//! Flight logs of any origin, read into one representation.

mod clocks;
mod error;
mod flight;
mod frames;
mod mcap;
mod source;
mod tally;
mod tlog;
mod vehicle;

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

pub use error::ImportError;
pub use flight::{
    AttitudeSetpoint, Clock, Flight, MotorSource, MotorUnit, Origin, Stream, TruthSample,
};

use super::reader::{LogReader, ReadError};
use source::Format;

/// Reads a flight log, whatever it is: an own log (.mcap) or a telemetry log (.tlog), told by its
/// content. Damage within a log, and what does not belong to the flight, is counted in
/// [`Flight::left_out`]; a log without a usable sample is an empty flight.
///
/// # Errors
/// [`ImportError`] if the file cannot be read or is no log.
pub fn open(path: &Path, mapping: Option<&Path>) -> Result<Flight, ImportError> {
    let _ = mapping;
    let io = |source| ImportError::Read { path: path.to_owned(), source };
    let format = source::recognise(path)?;
    let origin = source::origin(path, format)?;
    let file = File::open(path).map_err(io)?;
    let mut flight = Flight::empty(origin, Clock::Single);
    match format {
        Format::Mcap => {
            let failed = |error| match error {
                ReadError::Io(source) => io(source),
                other => ImportError::not_a_log(path, other.to_string()),
            };
            let source = BufReader::with_capacity(1 << 16, file);
            let mut reader = LogReader::new(source).map_err(failed)?;
            mcap::read(&mut reader, &mut flight).map_err(failed)?;
        }
        Format::Tlog => {
            let stamped = tlog::read(file, &mut flight).map_err(io)?;
            let is_empty = std::fs::metadata(path).map_err(io)?.len() == 0;
            if !stamped && !is_empty {
                let found = "no MAVLink frame with a time stamp".to_owned();
                return Err(ImportError::not_a_log(path, found));
            }
        }
    }
    Ok(flight)
}
