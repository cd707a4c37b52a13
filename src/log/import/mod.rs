//! Flight logs of any origin, read into one representation.

mod clocks;
mod csv;
mod epoch;
mod error;
mod flat;
mod flight;
mod frames;
pub mod mapping;
mod mcap;
mod source;
mod tally;
mod tlog;
mod vehicle;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

pub use error::ImportError;
pub use flat::write;
pub use flight::{
    AttitudeSetpoint, Clock, Flight, MotorSource, MotorUnit, Origin, Stream, TruthSample,
    UnitUnknown,
};

use super::reader::{LogReader, ReadError};
use csv::TableError;
use mapping::Mapping;
use source::Format;

/// Reads a flight log, whatever it is, told by its content: an own log (.mcap), a telemetry log
/// (.tlog), or a table (.csv) with the mapping file that says what its columns are. Damage within a
/// log, and what does not belong to the flight, is counted in [`Flight::left_out`]; a log without
/// a usable sample is an empty flight.
///
/// # Errors
/// [`ImportError`] if a file cannot be read, is no log, or a table's mapping leaves anything unsaid.
pub fn open(path: &Path, mapping: Option<&Path>) -> Result<Flight, ImportError> {
    let io = |source| ImportError::Read { path: path.to_owned(), source };
    let format = source::recognise(path)?;
    let mapping = match (format, mapping) {
        (Format::Csv, Some(file)) => Some((file, Mapping::load(file)?)),
        (Format::Csv, None) => return Err(ImportError::NoMapping { path: path.to_owned() }),
        (format, Some(_)) => {
            return Err(ImportError::NotATable { path: path.to_owned(), format: format.name() });
        }
        (_, None) => None,
    };
    let origin = source::origin(path, format)?;
    let file = File::open(path).map_err(io)?;
    let mut flight = Flight::empty(origin, Clock::Single);
    let source = BufReader::with_capacity(1 << 16, file);
    match mapping {
        None => read(source, format, &mut flight).map_err(|error| match error {
            ReadError::Io(source) => io(source),
            other => ImportError::not_a_log(path, other.to_string()),
        })?,
        Some((file, mapping)) => {
            csv::read(source, &mapping, &mut flight).map_err(|error| match error {
                TableError::Io(source) => io(source),
                TableError::Unmapped(message) => ImportError::Unmapped {
                    path: path.to_owned(),
                    mapping: file.to_owned(),
                    message,
                },
            })?;
        }
    }
    Ok(flight)
}

/// Reads a log of frames into `flight`.
fn read(source: impl Read, format: Format, flight: &mut Flight) -> Result<(), ReadError> {
    match format {
        Format::Mcap => mcap::read(&mut LogReader::new(source)?, flight),
        Format::Tlog | Format::Csv => Ok(tlog::read(source, flight)?),
    }
}

/// Reads bytes as any log that they could be, a table by `mapping`, without knowing a file: what
/// the fuzz targets do.
#[doc(hidden)]
pub fn read_bytes(bytes: &[u8], mapping: &str) -> Vec<Flight> {
    let origin = Origin {
        path: "memory".into(),
        run: "memory".into(),
        sha256: String::new(),
        format: "bytes",
    };
    let flight = || Flight::empty(origin.clone(), Clock::Single);
    let mut flights = Vec::new();
    for format in [Format::Mcap, Format::Tlog] {
        let mut flight = flight();
        if read(bytes, format, &mut flight).is_ok() {
            flights.push(flight);
        }
    }
    let mut table = flight();
    let read = Mapping::parse(mapping).map(|mapping| csv::read(bytes, &mapping, &mut table));
    if let Ok(Ok(())) = read {
        flights.push(table);
    }
    flights
}
