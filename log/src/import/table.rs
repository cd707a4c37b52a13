//! Reads tables (CSV) into flights, with a mapping file.

pub(super) mod dates;
mod head;
mod numbers;
mod rows;
mod text;

use std::io::{self, Cursor, Read};

use super::Contents;
use super::flight::{Flight, MotorSource, MotorUnit};
use super::mapping::{self, Cell, Mapping, Outputs};
use super::tally::Tally;
pub(super) use head::{Head, Sheet};
use head::{Layout, records};
pub(super) use numbers::Numbers;
use rows::Rows;
pub(super) use text::decoded;

/// A pause of more periods than this is a gap.
const GAP_PERIODS: f64 = 3.0;
/// Largest share of rows whose roll or pitch is beyond a full turn by damage.
const BEYOND_TURN_MAX: f64 = 0.02;
/// Number of characters of a row in an error.
const SHOWN: usize = 120;
/// Reason to leave out a row.
const OTHER_WIDTH: &str = "row with more or fewer cells than the header";

/// Why a table could not be read.
#[derive(Debug)]
pub(super) enum TableError {
    /// Reading failed.
    Io(io::Error),
    /// The mapping does not fit the table, or the table has no header; the text says why.
    Unmapped(String),
}

impl From<io::Error> for TableError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<csv::Error> for TableError {
    fn from(error: csv::Error) -> Self {
        match error.into_kind() {
            csv::ErrorKind::Io(error) => Self::Io(error),
            other => Self::Unmapped(format!("the table cannot be cut into cells: {other:?}")),
        }
    }
}

/// Reads the table into `flight`. Returns a description of the first unusable row.
///
/// # Errors
/// [`TableError`]. Unusable rows are counted and are not an error.
pub(super) fn read(
    source: impl Read,
    mapping: &Mapping,
    flight: &mut Flight,
) -> Result<Contents, TableError> {
    let mut source = decoded(source)?;
    let head = Head::read(&mut source, mapping.skip_lines.unwrap_or(0))?;
    let Layout { separator, records_above, cells: [least, most], reader } =
        head.layout(mapping).map_err(TableError::Unmapped)?;
    let mut table = records(separator, Cursor::new(head.bytes).chain(source));
    let mut record = csv::ByteRecord::new();
    for _ in 0..records_above {
        table.read_byte_record(&mut record)?;
    }

    let mut tally = Tally::default();
    let mut numbers = Numbers::new(mapping.decimal);
    let mut rows = Rows::new(reader.clock_period());
    let mut cells = vec![Cell::Empty; most];
    let mut refused = None;
    let (mut index, mut usable, mut beyond_turn) = (0, 0_u64, 0_u64);
    while table.read_byte_record(&mut record)? {
        let number = index;
        index += 1;
        let filled = record.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
        if filled == 0 {
            continue;
        }
        if record.len() < least || filled > most {
            // An unclosed quotation mark makes one record of all lines behind it.
            let lines = 1 + record.as_slice().iter().filter(|byte| **byte == b'\n').count();
            tally.add(OTHER_WIDTH, lines as u64);
            refused.get_or_insert_with(|| {
                let found = record.len();
                let cure = match separator {
                    b',' if found > most => {
                        "; if its numbers have decimal commas, separate the cells by semicolons or \
                         quote them"
                    }
                    _ => "",
                };
                format!("row {} has {found} cells where the header has {most}{cure}", number + 1)
            });
            continue;
        }
        for (at, cell) in cells.iter_mut().enumerate() {
            *cell = match record.get(at) {
                Some(text) if reader.is_date(at) => dates::read(text),
                Some(text) if reader.uses(at) => numbers.read(text),
                _ => Cell::Empty,
            };
        }
        match reader.read(number, &cells) {
            Err(reason) => {
                tally.add(reason, 1);
                refused.get_or_insert_with(|| {
                    let cells: Vec<_> = record.iter().map(String::from_utf8_lossy).collect();
                    let shown: String = cells.join(" ").chars().take(SHOWN).collect();
                    format!("row {} is {shown:?}", number + 1)
                });
            }
            Ok(row) => {
                usable += 1;
                beyond_turn += u64::from(reader.is_beyond_turn(&cells));
                rows.add(row, flight, &mut tally);
            }
        }
    }
    let times = rows.finish(flight, &mut tally);
    if let Some(doubt) = numbers.doubt() {
        return Err(TableError::Unmapped(doubt));
    }
    if beyond_turn as f64 > BEYOND_TURN_MAX * usable as f64 {
        return Err(TableError::Unmapped(format!(
            "attitude.unit: roll or pitch is beyond a full turn in {beyond_turn} of {usable} rows: \
             these angles are in another unit; correct it"
        )));
    }
    flight.facts.notes.extend(reader.notes().iter().cloned());
    flight.motor_source = MotorSource::Table;
    flight.motor_unit = match reader.outputs() {
        Outputs::Fraction => MotorUnit::ThrustFraction,
        Outputs::Newton => MotorUnit::Newton,
    };
    tally.add("gap of more than 3 periods between rows", gaps(&times));
    flight.rows = Some(times);
    tally.give(flight);
    Ok(Contents { reason: refused, ..Contents::default() })
}

/// Whether a text may be a table: one of its first lines consists of numbers.
pub(super) fn looks_like_one(text: &str) -> bool {
    Head::read(&mut text.as_bytes(), 0).is_ok_and(|head| head.has_numbers())
}

/// Proposes a mapping file for the table at the start of `source`.
///
/// # Errors
/// Errors of `source`, or it does not look like a table.
pub(super) fn propose(source: impl Read) -> Result<String, TableError> {
    let mut source = decoded(source)?;
    let head = Head::read(&mut source, 0)?;
    for (name, text) in mapping::SHIPPED {
        // A mapping for one program's exports has expectations of them.
        let fits =
            Mapping::parse(text).is_ok_and(|m| !m.expect.is_empty() && head.layout(&m).is_ok());
        if fits {
            let title =
                format!("# The shipped mapping {name:?} fits this table (--mapping {name}):\n\n");
            return Ok(title + text);
        }
    }
    let sheet = head.table().ok_or_else(|| {
        let message =
            "no line of names is followed by a line of numbers: it does not look like a table";
        TableError::Unmapped(message.to_owned())
    })?;
    Ok(mapping::propose(&sheet))
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

#[cfg(test)]
mod tests {
    use super::*;

    const MAPPING: &str = "world_frame = \"ned\"\n[time]\ncolumn = \"t\"\nunit = \"s\"\n\
                           [position]\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"m\"\n";

    fn flight(times: impl IntoIterator<Item = f64>) -> Flight {
        flight_in("s", times)
    }

    fn flight_in(unit: &str, times: impl IntoIterator<Item = f64>) -> Flight {
        let rows = times.into_iter().map(|time| format!("{time},1.5,2.5,3.5\n"));
        let table = format!("t,x,y,z\n{}", rows.collect::<String>());
        let mapping = MAPPING.replace("unit = \"s\"", &format!("unit = {unit:?}"));
        imported(&table, &mapping).expect("a table")
    }

    /// The flight of a table, or why it is refused.
    fn imported(table: &str, mapping: &str) -> Result<Flight, String> {
        let mut flight = Flight::in_memory("memory", "csv");
        let mapping = Mapping::parse(mapping).expect("a mapping");
        match read(table.as_bytes(), &mapping, &mut flight) {
            Ok(_) => Ok(flight),
            Err(TableError::Unmapped(why)) => Err(why),
            Err(TableError::Io(error)) => panic!("{error}"),
        }
    }

    #[test]
    fn one_unknown_unit_does_not_hide_the_others() {
        let table = |units: &str| format!("t,x,y,z,state\n{units}\n0,1,2,3,4\n1,1,2,3,4\n");
        let flight = imported(&table("sec,Meters,metre,furlong,enum"), MAPPING).expect("a flight");
        assert_eq!((flight.position.len(), flight.left_out.len()), (2, 0));
        let note = "the unit \"furlong\" of column 4 (z) is unknown and was not compared";
        assert_eq!(flight.facts.notes, [note]);
        for (units, column) in
            [("s,m,millimeters,m,enum", "3 (y)"), ("ms,words,words,words,enum", "1 (t)")]
        {
            let refusal = imported(&table(units), MAPPING).expect_err("a contradiction");
            assert!(refusal.contains(&format!("column {column} is in")), "{refusal}");
        }
    }

    #[test]
    fn a_refusal_is_that_of_the_separator_with_the_columns() {
        // Spaces cut the line of names into more cells than commas do.
        let mapping = MAPPING.replace("\"t\"", "\"the time of it [s]\"");
        let names = "the time of it [s],x,y,z,an error of the mean value";
        let table = |names: &str| format!("{names}\n0,1,2,3,4\n1,1,2,3,4\n");
        assert!(imported(&table(names), &mapping).is_ok());
        let refusal = imported(&table(&names.replace("[s]", "[ms]")), &mapping);
        let refusal = refusal.expect_err("another name");
        assert!(refusal.contains("it has the time of it [ms], x, y, z, an error"), "{refusal}");
        let refusal = imported(&table(names), &mapping.replace("\"s\"", "\"ms\""));
        assert!(refusal.as_ref().is_err_and(|why| why.contains("is in \"s\"")), "{refusal:?}");
        // No column is known, but the rows are as wide as the line of names.
        let other = mapping.replace("the time of it [s]", "u");
        let other = other.replace("\"x\", \"y\", \"z\"", "\"a\", \"b\", \"c\"");
        let refusal = imported(&table(names), &other).expect_err("other names");
        assert!(refusal.contains("it has the time of it [s], x, y"), "{refusal}");
    }

    #[test]
    fn time_far_ahead_costs_only_its_row() {
        let sound = |row: u32| 100.0 + 0.01 * f64::from(row);
        let damaged = flight((0..200).map(|row| if row == 90 { 4.3e9 } else { sound(row) }));
        assert_eq!(damaged.position.len(), 199);
        let reason = "row whose time is far ahead of the rows around it";
        assert_eq!(damaged.left_out, [(reason.to_owned(), 1)]);
        let counter = |row: u32| if row == 9 { f64::from(u32::MAX) } else { 1e4 * f64::from(row) };
        let first = flight_in("us", (0..200).map(counter));
        assert!((first.position.times()[198] - 1.99).abs() < 1e-9);
        // A pause of the logger.
        let paused = flight((0..200).map(|row| sound(row) + if row < 90 { 0.0 } else { 600.0 }));
        assert_eq!(paused.position.len(), 200);
    }

    #[test]
    fn a_mapping_for_one_body_refuses_several() {
        let take = |bodies: &[&str]| {
            let mut lines =
                ["Rotation Type,Quaternion,Coordinate Space,Global,Length Units,Meters"]
                    .map(str::to_owned)
                    .to_vec();
            let line = |start: &str, cells: &dyn Fn(&str) -> String| {
                let cells: Vec<String> = bodies.iter().map(|body| cells(body)).collect();
                format!("{start},{}", cells.join(","))
            };
            lines.push(line(",Type", &|_| ["Rigid Body"; 7].join(",")));
            lines.push(line(",Name", &|body| [body; 7].join(",")));
            let groups = [["Rotation"; 4].as_slice(), ["Position"; 3].as_slice()].concat();
            lines.push(line(",", &|_| groups.join(",")));
            lines.push(line("Frame,Time (Seconds)", &|_| "X,Y,Z,W,X,Y,Z".to_owned()));
            for row in 0..9 {
                lines.push(line(&format!("{row},0.{row}"), &|_| "0,0,0,1,1,2,3".to_owned()));
            }
            lines.join("\n")
        };
        let (_, motive) = mapping::SHIPPED[1];
        let proposed = |take: &str| propose(take.as_bytes()).expect("a table");
        let one = take(&["quad"]);
        assert_eq!(imported(&one, motive).expect("a flight").position.len(), 9);
        assert!(proposed(&one).contains("--mapping motive"));
        let two = take(&["wand", "quad"]);
        let refusal = imported(&two, motive).expect_err("two bodies");
        for body in ["7 (Rigid Body, wand, Position, X)", "14 (Rigid Body, quad, Position, X)"] {
            assert!(refusal.contains(body), "{refusal}");
        }
        assert!(!proposed(&two).contains("--mapping motive"));
        let own = motive.replace("single", "# single").replace("[7, 8, 9]", "[14, 15, 16]");
        let flight = imported(&two, &own.replace("[3, 4, 5, 6]", "[10, 11, 12, 13]"));
        assert_eq!(flight.expect("a flight").position.len(), 9);
    }

    #[test]
    fn angles_in_another_unit_are_refused() {
        let mapping = |unit: &str| {
            format!(
                "body_frame = \"frd\"\n{MAPPING}[attitude]\neuler = [\"r\", \"p\", \"w\"]\n\
                 unit = {unit:?}\n"
            )
        };
        let import = |unit: &str, degrees: [f64; 3]| {
            let row = |k: u32| {
                let [r, p, w] = degrees.map(|angle| angle * (0.3 * f64::from(k)).sin());
                format!("{k},1,2,3,{r},{p},{w}\n")
            };
            let rows: String = (0..300).map(row).collect();
            imported(&format!("t,x,y,z,r,p,w\n{rows}"), &mapping(unit))
        };
        for lean in [[20.0, 0.0, 0.0], [0.0, 8.0, 90.0]] {
            let refusal = import("rad", lean).expect_err("degrees");
            assert!(
                refusal.contains("attitude.unit") && refusal.contains("of 300 rows"),
                "{refusal}"
            );
            assert!(import("deg", lean).is_ok());
        }
        // A roll in 0..2 pi, and a yaw that counts its turns.
        assert!(import("rad", [std::f64::consts::TAU, 1.5, 80.0]).is_ok());
    }

    /// Times of the rows, and their number in place of the position.
    fn numbered(times: impl IntoIterator<Item = (u32, f64)>) -> Flight {
        let row = |(number, time)| format!("{time},{number},2,3\n");
        let rows: String = times.into_iter().map(row).collect();
        imported(&format!("t,x,y,z\n{rows}"), MAPPING).expect("a table")
    }

    #[test]
    fn rows_out_of_order_are_sorted() {
        let time = |row: u32| 0.01 * f64::from(row);
        for count in [50, 3000] {
            let sound = numbered((0..count).map(|row| (row, time(row))));
            assert_eq!((sound.left_out.len(), sound.facts.notes.len()), (0, 0));
            // Prime to both counts.
            let shuffled = (0..count).map(|row| row * 677 % count);
            for order in [(0..count).rev().collect::<Vec<_>>(), shuffled.collect()] {
                let flight = numbered(order.into_iter().map(|row| (row, time(row))));
                assert_eq!(flight.position, sound.position);
                assert_eq!((&flight.rows, &flight.left_out), (&sound.rows, &sound.left_out));
                let note = "rows were out of order and were sorted by time";
                assert_eq!(flight.facts.notes, [note]);
            }
        }
    }

    #[test]
    fn a_restarted_clock_is_not_sorted_into_the_rows_before() {
        for count in [15, 900, 3000] {
            let twice = (0..2 * count).map(|row| (row, 0.01 * f64::from(row % count)));
            let flight = numbered(twice);
            assert_eq!(flight.position.len(), count as usize);
            let reason = "row with an earlier time than the row before";
            let first = ("row with the time of the row before".to_owned(), 1);
            let earlier: u64 = flight.left_out.iter().map(|(_, rows)| rows).sum();
            assert!(flight.left_out.iter().any(|(what, _)| what == reason));
            assert!(flight.left_out.iter().all(|left| left.0 == reason || *left == first));
            assert_eq!((earlier, flight.facts.notes.len()), (u64::from(count), 0));
        }
        // Rows after the end of a counter are not the first.
        let counter = |row: u32| f64::from(4_294_900_000_u32.wrapping_add(10_000 * row));
        let short = flight_in("us", (0..9).map(counter));
        assert_eq!((short.position.len(), short.facts.notes.len()), (9, 0));
    }

    #[test]
    fn identical_rows_are_told_from_contradictory_ones() {
        let twice = numbered((0..200).map(|row| (row / 2, 0.01 * f64::from(row / 2))));
        assert_eq!(twice.position.len(), 100);
        let reason = "duplicated row, with the time of the row before";
        assert_eq!(twice.left_out, [(reason.to_owned(), 100)]);
        let other = numbered((0..200).map(|row| (row, 0.01 * f64::from(row / 2))));
        let reason = "row with the time of the row before";
        assert_eq!(other.left_out, [(reason.to_owned(), 100)]);
    }

    #[test]
    fn counter_of_32_bits_continues_after_its_end() {
        let wrapped = |row: u32| 4_294_900_000_u32.wrapping_add(10_000 * row);
        let flight = flight_in("us", (0..200).map(|row| f64::from(wrapped(row))));
        assert_eq!((flight.position.len(), flight.left_out.len()), (200, 0));
        let times = flight.position.times();
        assert!((times[199] - times[0] - 1.99).abs() < 1e-9, "{} {}", times[0], times[199]);
    }
}
