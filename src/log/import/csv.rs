//! Tables (CSV) into flights, by a mapping file.

use std::io::{self, BufRead};

use super::flight::{AttitudeSetpoint, Flight, MotorSource, MotorUnit};
use super::mapping::{Mapping, Outputs, Row, RowReader};
use super::tally::Tally;

/// Longest line; a file whose lines are longer is no table.
const LINE_MAX: u64 = 1 << 20;
/// A pause of more periods than this is a gap.
const GAP_PERIODS: f64 = 3.0;

/// Why a table could not be read.
#[derive(Debug)]
pub(super) enum TableError {
    /// Reading failed.
    Io(io::Error),
    /// The mapping does not fit the table, or the table has no header; in words.
    Unmapped(String),
}

impl From<io::Error> for TableError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Reads the table into `flight`: its first line names the columns.
///
/// # Errors
/// [`TableError`]. Rows that cannot be used are counted, and are no error.
pub(super) fn read(
    mut source: impl BufRead,
    mapping: &Mapping,
    flight: &mut Flight,
) -> Result<(), TableError> {
    let separator = mapping.separator.unwrap_or(',');
    let mut line = String::new();
    loop {
        if !next_line(&mut source, &mut line)? {
            let message = "the table has no header line that names its columns".to_owned();
            return Err(TableError::Unmapped(message));
        }
        if !line.trim().is_empty() {
            break;
        }
    }
    // Some tools mark the header as a comment, some files as UTF-8.
    let header = line.trim_start_matches('\u{feff}').trim_start_matches(['#', '%']);
    let header: Vec<String> = fields(header, separator).map(str::to_owned).collect();
    let reader = RowReader::new(mapping, &header).map_err(TableError::Unmapped)?;

    let mut tally = Tally::default();
    let mut rows: Vec<f64> = Vec::new();
    let mut cells = vec![f64::NAN; header.len()];
    let mut index = 0;
    while next_line(&mut source, &mut line)? {
        if line.trim().is_empty() {
            continue;
        }
        let number = index;
        index += 1;
        let mut count = 0;
        for field in fields(&line, separator) {
            if let Some(cell) = cells.get_mut(count) {
                *cell = match reader.uses(count) {
                    true => field.parse().unwrap_or(f64::NAN),
                    false => f64::NAN,
                };
            }
            count += 1;
        }
        if count != header.len() {
            tally.add("row with more or fewer cells than the header", 1);
            continue;
        }
        match reader.read(number, &cells) {
            Err(reason) => tally.add(reason, 1),
            Ok(row) if rows.last().is_some_and(|last| row.time == *last) => {
                tally.add("row with the time of the row before", 1);
            }
            Ok(row) if rows.last().is_some_and(|last| row.time < *last) => {
                tally.add("row with an earlier time than the row before", 1);
            }
            Ok(row) => {
                rows.push(row.time);
                keep(&row, flight);
            }
        }
    }
    flight.motor_source = MotorSource::Table;
    flight.motor_unit = match reader.outputs() {
        Outputs::Fraction => MotorUnit::ThrustFraction,
        Outputs::Newton => MotorUnit::Newton,
    };
    tally.add("gap of more than 3 periods between rows", gaps(&rows));
    flight.rows = Some(rows);
    flight.left_out.extend(tally.into_vec());
    Ok(())
}

/// Appends a row's samples; its time is later than any before.
fn keep(row: &Row, flight: &mut Flight) {
    fn push<T>(stream: &mut super::flight::Stream<T>, time: f64, value: Option<T>) {
        if let Some(value) = value {
            stream.push(time, value);
        }
    }
    let time = row.time;
    push(&mut flight.position, time, row.position);
    push(&mut flight.velocity, time, row.velocity);
    push(&mut flight.attitude, time, row.attitude);
    push(&mut flight.body_rate, time, row.body_rate);
    push(&mut flight.specific_force, time, row.specific_force);
    push(&mut flight.outputs, time, row.outputs);
    push(&mut flight.rotor_speed, time, row.rotor_speed);
    push(&mut flight.voltage, time, row.voltage);
    let setpoint = AttitudeSetpoint {
        attitude: row.setpoint_attitude,
        body_rate: row.setpoint_rate,
        thrust: row.setpoint_thrust,
    };
    let is_any =
        setpoint.attitude.is_some() || setpoint.body_rate.is_some() || setpoint.thrust.is_some();
    push(&mut flight.setpoint, time, is_any.then_some(setpoint));
}

fn gaps(rows: &[f64]) -> u64 {
    let mut periods: Vec<f64> = rows.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if periods.is_empty() {
        return 0;
    }
    let middle = periods.len() / 2;
    let median = *periods.select_nth_unstable_by(middle, f64::total_cmp).1;
    periods.iter().filter(|period| **period > GAP_PERIODS * median).count() as u64
}

/// The cells of a line, without blanks and quotation marks around them.
fn fields(line: &str, separator: char) -> impl Iterator<Item = &str> {
    line.trim_end_matches(['\r', '\n'])
        .split(separator)
        .map(|field| field.trim().trim_matches('"').trim())
}

/// Reads a line; bytes that are no UTF-8 become no numbers. Returns `false` at the end.
fn next_line(source: &mut impl BufRead, line: &mut String) -> io::Result<bool> {
    let mut bytes = Vec::new();
    let count = io::Read::take(&mut *source, LINE_MAX).read_until(b'\n', &mut bytes)?;
    line.clear();
    line.push_str(&String::from_utf8_lossy(&bytes));
    Ok(count > 0)
}
