//! Imports flight logs of any origin into one representation, [`Flight`].

mod boot;
mod clocks;
mod collected;
mod dataflash;
mod epoch;
mod error;
mod facts;
mod flat;
mod flight;
mod foreign;
mod frames;
mod functions;
mod kind;
pub mod mapping;
mod mcap;
mod onboard;
mod ranges;
mod read_ahead;
mod references;
mod setpoints;
mod source;
mod statements;
mod stream;
mod table;
mod tally;
mod tlog;
mod ulog;
mod vehicle;

use std::f64::consts::TAU;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

pub use collected::Collected;
pub use error::ImportError;
pub use facts::{RotorFact, VehicleFacts};
pub use flat::{to_bytes, write};
pub use flight::{
    AttitudeSetpoint, Clock, Flight, MotorSource, MotorUnit, Origin, SetpointSource, Stream,
    TruthSample, UnitUnknown,
};
pub use kind::{StatedKind, VehicleKind};
pub use ranges::{OutputRange, output_ranges};
pub use source::tell_apart;

use super::reader::{LogReader, ReadError};
use mapping::Mapping;
use source::Format;
use table::TableError;
use ulog::UlogError;

/// One revolution per minute, rad/s.
const RPM: f64 = TAU / 60.0;
/// The unit g of autopilots and of accelerometers, m/s^2.
const STANDARD_GRAVITY: f64 = 9.806_65;

/// Options for reading a log.
#[derive(Clone, Copy, Debug, Default)]
pub struct Choice<'a> {
    /// Mapping file of a table, or the name of a shipped one.
    pub mapping: Option<&'a Path>,
    /// Boot of the vehicle, counted from 1; by default the one that flew longest.
    pub boot: Option<usize>,
    /// System id of the vehicle in telemetry; by default of the one that sent most among those that
    /// flew as long as any.
    pub system: Option<u8>,
}

/// Reads a flight log and detects its format from the content: downwash's log (.mcap), a telemetry
/// log (.tlog), a log of PX4 (ULog) or ArduPilot (DataFlash), or a table (.csv) with the mapping
/// file that defines its columns. [`Flight::left_out`] counts damage within a log, and data that
/// does not belong to the flight.
///
/// # Errors
/// [`ImportError`] if a file cannot be read, is not a log, has no data of a flight, or a table's
/// mapping is incomplete.
pub fn open(path: &Path, mapping: Option<&Path>) -> Result<Flight, ImportError> {
    open_chosen(path, Choice { mapping, ..Choice::default() })
}

/// As [`open`], with options.
///
/// # Errors
/// As [`open`]; also if the log does not have the chosen boot or system.
pub fn open_chosen(path: &Path, choice: Choice<'_>) -> Result<Flight, ImportError> {
    let io = |source| ImportError::Read { path: path.to_owned(), source };
    let format = source::recognise(path)?;
    let mapping = match (format, choice.mapping) {
        (Format::Csv, Some(file)) => Some((file, Mapping::load(file)?)),
        (Format::Csv, None) => return Err(ImportError::NoMapping { path: path.to_owned() }),
        (format, Some(_)) => {
            return Err(ImportError::NotATable { path: path.to_owned(), format: format.name() });
        }
        (_, None) => None,
    };
    // A table has one.
    if let (Some(_), Some(boot @ (0 | 2..))) = (&mapping, choice.boot) {
        return Err(ImportError::NoBoot { path: path.to_owned(), boot, boots: 1 });
    }
    if let (Some(system), Format::Csv | Format::Ulog | Format::DataFlash) = (choice.system, format)
    {
        let found = format!("a {} file has one vehicle, without an id", format.name());
        return Err(ImportError::NoSystem { path: path.to_owned(), system, found });
    }
    let origin = source::origin(path, format)?;
    let file = File::open(path).map_err(io)?;
    let mut flight = Flight::empty(origin, Clock::Single);
    let source = io::BufReader::with_capacity(1 << 16, file);
    let contents = match mapping {
        None => read(source, format, choice, &mut flight).map_err(|error| match error {
            LogFault::Io(source) => io(source),
            LogFault::Foreign(found) => ImportError::not_a_log(path, found),
            LogFault::NoBoot { boot, boots } => {
                ImportError::NoBoot { path: path.to_owned(), boot, boots }
            }
            LogFault::NoSystem { system, found } => {
                ImportError::NoSystem { path: path.to_owned(), system, found }
            }
        })?,
        Some((file, mapping)) => table::read(source, &mapping, &mut flight)
            .map_err(|error| unmapped(path, file, error))?,
    };
    if !flight.has_motion() {
        let why = contents.why_nothing(&flight);
        return Err(ImportError::Nothing { path: path.to_owned(), format: format.name(), why });
    }
    Ok(flight)
}

fn unmapped(path: &Path, mapping: &Path, error: TableError) -> ImportError {
    match error {
        TableError::Io(source) => ImportError::Read { path: path.to_owned(), source },
        TableError::Unmapped(message) => {
            ImportError::Unmapped { path: path.to_owned(), mapping: mapping.to_owned(), message }
        }
    }
}

/// The name of a log's format, recognised by its content: `mcap`, `tlog`, `ulog`, `dataflash` or
/// `csv`.
///
/// # Errors
/// [`ImportError`] if the file cannot be read or is not a log.
pub fn format_of(path: &Path) -> Result<&'static str, ImportError> {
    source::recognise(path).map(Format::name)
}

/// Proposes a mapping file for a table, from its column names and first rows.
///
/// # Errors
/// [`ImportError`] if the file cannot be read or is not a table.
pub fn propose(path: &Path) -> Result<String, ImportError> {
    let io = |source| ImportError::Read { path: path.to_owned(), source };
    match source::recognise(path)? {
        Format::Csv => {}
        format => {
            return Err(ImportError::NotATable { path: path.to_owned(), format: format.name() });
        }
    }
    table::propose(File::open(path).map_err(io)?).map_err(|error| match error {
        TableError::Io(source) => io(source),
        TableError::Unmapped(found) => ImportError::not_a_log(path, found),
    })
}

/// What a file contains, to explain to people why it yields no flight.
#[derive(Debug, Default)]
struct Contents {
    /// Term for its parts, such as `topic` or `message`.
    part: &'static str,
    /// Names of its parts.
    names: Vec<String>,
    /// Known reason, if any.
    reason: Option<String>,
}

impl Contents {
    /// Number of parts listed in an error.
    const NAMED: usize = 12;
    /// Number of reasons listed in an error.
    const REASONS: usize = 4;

    fn why_nothing(&self, flight: &Flight) -> String {
        let mut parts = Vec::from_iter(self.reason.clone());
        let mut left_out: Vec<&(String, u64)> = flight.left_out.iter().collect();
        left_out.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let left_out = left_out.iter().take(Self::REASONS);
        parts.extend(left_out.map(|(what, count)| format!("left out {count} x {what}")));
        let what = self.part;
        match self.names.as_slice() {
            [] if what.is_empty() => {}
            [] => parts.push(format!("it has no readable {what}")),
            names => {
                let more = names.len().saturating_sub(Self::NAMED);
                let named = names[..names.len() - more].join(", ");
                let more = if more > 0 { format!(" and {more} more") } else { String::new() };
                parts.push(format!("no known {what}: it has {named}{more}"));
            }
        }
        let missing = "neither pose, IMU, motor outputs nor setpoints".to_owned();
        if parts.is_empty() { missing } else { parts.join("; ") }
    }
}

/// As [`open`], for one of many logs: the mapping file applies to tables and is ignored for other
/// formats.
///
/// # Errors
/// As [`open`].
pub fn open_among(path: &Path, mapping: Option<&Path>) -> Result<Flight, ImportError> {
    let is_table = mapping.is_some() && source::recognise(path)? == Format::Csv;
    open(path, mapping.filter(|_| is_table))
}

/// Why a self-describing log cannot be read.
#[derive(Debug)]
enum LogFault {
    Io(io::Error),
    /// The file is something else; the text says what.
    Foreign(String),
    /// The log has fewer boots.
    NoBoot {
        boot: usize,
        boots: usize,
    },
    /// The log has no such vehicle; the text says which it has.
    NoSystem {
        system: u8,
        found: String,
    },
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

/// Reads a self-describing log into `flight`. Returns what the file contains.
fn read(
    source: impl Read,
    format: Format,
    choice: Choice<'_>,
    flight: &mut Flight,
) -> Result<Contents, LogFault> {
    match format {
        Format::Mcap => mcap::read(&mut LogReader::new(source)?, choice, flight),
        Format::Ulog => ulog::read(source, choice.boot, flight),
        Format::DataFlash => dataflash::read(source, choice.boot, flight),
        Format::Tlog | Format::Csv => tlog::read(source, choice, flight),
    }
}

/// The proposed mapping for bytes that look like a table, for fuzz targets.
#[doc(hidden)]
pub fn propose_bytes(bytes: &[u8]) -> Option<String> {
    table::propose(bytes).ok()
}

/// Reads bytes as a log of every format, and as a table with `mapping`, for fuzz targets.
#[doc(hidden)]
pub fn read_bytes(bytes: &[u8], mapping: &str) -> Vec<Flight> {
    let flight = || Flight::in_memory("memory", "bytes");
    let mut flights = Vec::new();
    for format in [Format::Mcap, Format::Tlog, Format::Ulog, Format::DataFlash] {
        let mut flight = flight();
        if read(bytes, format, Choice::default(), &mut flight).is_ok() {
            flights.push(flight);
        }
    }
    let mut table = flight();
    let read = Mapping::parse(mapping).map(|mapping| table::read(bytes, &mapping, &mut table));
    if let Ok(Ok(_)) = read {
        flights.push(table);
    }
    flights
}
