//! Flight logs of any origin, read into one representation.

mod clocks;
mod csv;
mod dataflash;
mod epoch;
mod error;
mod facts;
mod flat;
mod flight;
mod frames;
pub mod mapping;
mod mcap;
mod onboard;
mod read_ahead;
mod references;
mod setpoints;
mod source;
mod tally;
mod tlog;
mod ulog;
mod vehicle;

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

pub use error::ImportError;
pub use facts::{RotorFact, VehicleFacts};
pub use flat::write;
pub use flight::{
    AttitudeSetpoint, Clock, Flight, MotorSource, MotorUnit, Origin, SetpointSource, Stream,
    TruthSample, UnitUnknown,
};

use super::reader::{LogReader, ReadError};
use csv::TableError;
use mapping::Mapping;
use source::Format;
use ulog::UlogError;

/// Reads a flight log, whatever it is, told by its content: an own log (.mcap), a telemetry log
/// (.tlog), a log of PX4 (ULog) or ArduPilot (DataFlash), or a table (.csv) with the mapping file
/// that says what its columns are. Damage within a log, and what does not belong to the flight, is
/// counted in [`Flight::left_out`]; a log without a usable sample is an empty flight.
///
/// # Errors
/// [`ImportError`] if a file cannot be read, is no log, or a table's mapping leaves anything
/// unsaid.
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
            LogFault::Io(source) => io(source),
            LogFault::Foreign(found) => ImportError::not_a_log(path, found),
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

/// As [`open`], of many logs with one mapping file: it is for the tables among them.
///
/// # Errors
/// As of [`open`].
pub fn open_among(path: &Path, mapping: Option<&Path>) -> Result<Flight, ImportError> {
    let is_table = mapping.is_some() && source::recognise(path)? == Format::Csv;
    open(path, mapping.filter(|_| is_table))
}

/// Why a log that describes itself is not read.
enum LogFault {
    Io(io::Error),
    /// It is something else; in words.
    Foreign(String),
}

impl From<io::Error> for LogFault {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<ReadError> for LogFault {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Io(error) => Self::Io(error),
            other => Self::Foreign(other.to_string()),
        }
    }
}

impl From<UlogError> for LogFault {
    fn from(error: UlogError) -> Self {
        match error {
            UlogError::Io(error) => Self::Io(error),
            UlogError::Foreign(found) => Self::Foreign(found),
        }
    }
}

/// Reads a log that describes itself into `flight`.
fn read(source: impl Read, format: Format, flight: &mut Flight) -> Result<(), LogFault> {
    match format {
        Format::Mcap => Ok(mcap::read(&mut LogReader::new(source)?, flight)?),
        Format::Ulog => Ok(ulog::read(source, flight)?),
        Format::DataFlash => match dataflash::read(source, flight)? {
            0 => Err(LogFault::Foreign("no whole message of a DataFlash log".into())),
            _ => Ok(()),
        },
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
    for format in [Format::Mcap, Format::Tlog, Format::Ulog, Format::DataFlash] {
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
