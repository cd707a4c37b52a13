//! The first lines of a table: what separates its cells, and which line names its columns.

use std::io::{self, BufRead};

use super::super::mapping::{Cell, Heading, Mapping, RowReader};
use super::super::read_ahead::read_ahead;
use super::numbers::Numbers;
use super::text;

/// So much of a table is read for its head.
const SIZE: usize = 64 * 1024;
/// The names of the columns are in one of so many lines.
const LINES: usize = 100;
/// What separates cells, in the order in which it is tried.
const SEPARATORS: [u8; 4] = *b",;\t|";

/// The first lines of a table, and its bytes from there on.
#[derive(Debug)]
pub(in crate::import) struct Head {
    /// Lines that were skipped.
    skipped: Vec<String>,
    /// By a line `sep=`.
    separator: Option<u8>,
    /// The bytes behind them: whole lines, unless there is only one.
    pub bytes: Vec<u8>,
}

/// How a table is laid out.
#[derive(Debug)]
pub(super) struct Layout {
    pub separator: u8,
    /// Records before the first row.
    pub records_above: usize,
    /// Least and most cells of a row, empty ones at its end left out of the most.
    pub cells: [usize; 2],
    pub reader: RowReader,
}

/// A reader of records as tables have them.
pub(super) fn records<R: io::Read>(separator: u8, source: R) -> csv::Reader<R> {
    csv::ReaderBuilder::new()
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(source)
}

impl Head {
    /// Reads the first lines of `source`, and skips so many.
    ///
    /// # Errors
    /// Those of `source`.
    pub fn read(source: &mut impl BufRead, skip_lines: u64) -> io::Result<Self> {
        let mut head = Self { skipped: Vec::new(), separator: None, bytes: Vec::new() };
        // A spreadsheet's line that says what separates cells.
        let first = source.fill_buf()?.to_ascii_lowercase();
        if first.strip_prefix(b"\"").unwrap_or(&first).starts_with(b"sep=") {
            let line = text::line(source)?.unwrap_or_default();
            head.separator = line.trim_matches('"').as_bytes().get(4).copied().filter(u8::is_ascii);
        }
        for _ in 0..skip_lines {
            let Some(line) = text::line(source)? else { break };
            if head.skipped.len() < LINES {
                head.skipped.push(line);
            }
        }
        read_ahead(source, &mut head.bytes, SIZE)?;
        Ok(head)
    }

    /// The whole records of the head.
    fn cut(&self, separator: u8) -> Vec<Vec<String>> {
        let is_last_cut = self.bytes.len() == SIZE;
        let end = self.bytes.iter().rposition(|byte| *byte == b'\n').filter(|_| is_last_cut);
        let bytes = self.bytes.get(..end.unwrap_or(self.bytes.len())).unwrap_or_default();
        let all = records(separator, bytes).into_byte_records();
        let text = |cell: &[u8]| String::from_utf8_lossy(cell).trim().to_owned();
        all.map_while(Result::ok).take(LINES).map(|r| r.iter().map(text).collect()).collect()
    }

    /// The lines that were skipped, in cells.
    fn above(&self, separator: u8) -> Vec<Vec<String>> {
        let cells = |line: &String| {
            let record = records(separator, line.as_bytes()).into_records().next();
            let record = record.and_then(Result::ok).unwrap_or_default();
            record.iter().map(str::to_owned).collect()
        };
        self.skipped.iter().map(cells).collect()
    }

    /// What separates cells, in the order in which it is tried; only one where it is said.
    fn separators(&self, stated: Option<char>) -> Result<Vec<u8>, String> {
        if let Some(stated) = stated {
            let byte = u8::try_from(stated).ok().filter(u8::is_ascii);
            let byte = byte.ok_or_else(|| {
                format!("separator: expected a character of ASCII, found {stated:?}")
            })?;
            return Ok(vec![byte]);
        }
        Ok(self.separator.map_or(SEPARATORS.to_vec(), |separator| vec![separator]))
    }

    /// Where the columns are that `mapping` names, or whose numbers it gives.
    ///
    /// # Errors
    /// What the table lacks, or the mapping does not say.
    pub(super) fn layout(&self, mapping: &Mapping) -> Result<Layout, String> {
        let mut refusal = None;
        for separator in self.separators(mapping.separator)? {
            let found = self.cut(separator);
            let mut lines = self.above(separator);
            let offset = lines.len();
            lines.extend(found);
            if lines.len() == offset {
                return Err("the table has no header line that names its columns".to_owned());
            }
            expected(mapping, &lines)?;
            // Where every column is given by its number, no line need name them.
            let numbered = (offset..lines.len()).find_map(|at| {
                let (above, rest) = lines.split_at(at);
                let found = by_number(mapping, separator, above, &rest[0])?;
                Some((at - offset, found))
            });
            let named = || {
                (offset..lines.len()).find_map(|at| {
                    let (above, rest) = lines.split_at(at);
                    let found = by_name(mapping, above, &rest[0]).ok()?;
                    Some((at - offset + 1, found))
                })
            };
            if let Some((records_above, (reader, cells))) = numbered.or_else(named) {
                return Ok(Layout { separator, records_above, cells, reader });
            }
            let names = header(&lines, separator).unwrap_or(offset).max(offset);
            let (above, rest) = lines.split_at(names);
            let width = rest[0].len();
            let error = match by_name(mapping, above, &rest[0]) {
                Err(error) => error,
                Ok(_) => continue,
            };
            if refusal.as_ref().is_none_or(|(most, _)| width > *most) {
                refusal = Some((width, error));
            }
        }
        Err(refusal.map_or_else(String::new, |(_, error)| error))
    }

    /// Whether any line is one of several numbers.
    pub fn has_numbers(&self) -> bool {
        let separators = self.separators(None).unwrap_or_default();
        separators.into_iter().any(|separator| {
            let mut numbers = Numbers::new(None, separator);
            self.cut(separator).iter().any(|line| {
                let of = |cell: &String| numbers.read(cell.as_bytes());
                line.iter().map(of).filter(|cell| matches!(cell, Cell::Number(_))).count() > 1
            })
        })
    }

    /// What separates the cells and where the line is that names the columns, without a mapping.
    pub fn table(&self) -> Option<Sheet> {
        let separators = self.separators(None).ok()?;
        let sheets = separators.into_iter().filter_map(|separator| {
            let lines = self.cut(separator);
            let at = header(&lines, separator)?;
            let names = names(&lines[at]);
            let rows = lines[at + 1..].to_vec();
            (names.len() > 1).then_some(Sheet { separator, names, rows })
        });
        sheets.max_by_key(|sheet| sheet.names.len())
    }
}

/// A table as it looks without a mapping.
#[derive(Debug)]
pub(in crate::import) struct Sheet {
    pub separator: u8,
    pub names: Vec<String>,
    /// The first rows.
    pub rows: Vec<Vec<String>>,
}

/// The names of a line; some tools mark it as a comment.
fn names(line: &[String]) -> Vec<String> {
    let mut names = line.to_vec();
    if let Some(first) = names.first_mut() {
        *first = first.trim_start_matches(['\u{feff}', '#', '%']).trim().to_owned();
    }
    names
}

/// The first line of words above a line of numbers.
fn header(lines: &[Vec<String>], separator: u8) -> Option<usize> {
    let mut numbers = Numbers::new(None, separator);
    let mut is_numeric = |line: &[String]| {
        let mut count = [0, 0];
        for cell in line {
            match numbers.read(cell.as_bytes()) {
                Cell::Number(_) => count[0] += 1,
                Cell::Other => count[1] += 1,
                Cell::Empty => {}
            }
        }
        count[0] > count[1]
    };
    let is_numeric: Vec<bool> = lines.iter().map(|line| is_numeric(line)).collect();
    is_numeric.windows(2).position(|pair| pair == [false, true])
}

fn by_name(
    mapping: &Mapping,
    above: &[Vec<String>],
    line: &[String],
) -> Result<(RowReader, [usize; 2]), String> {
    let names = names(line);
    let heading = Heading { above, names: Some(&names), width: names.len() };
    let least = names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1);
    Ok((RowReader::new(mapping, heading)?, [least, names.len()]))
}

/// Where every column is given by its number: the first line whose cells are what they should be.
fn by_number(
    mapping: &Mapping,
    separator: u8,
    above: &[Vec<String>],
    line: &[String],
) -> Option<(RowReader, [usize; 2])> {
    let heading = Heading { above, names: None, width: line.len() };
    let reader = RowReader::new(mapping, heading).ok()?;
    let mut numbers = Numbers::new(mapping.decimal, separator);
    let cells: Vec<Cell> = line.iter().map(|cell| numbers.read(cell.as_bytes())).collect();
    let least = (0..line.len()).rev().find(|at| reader.uses(*at)).map_or(0, |last| last + 1);
    reader.read(0, &cells).is_ok().then_some((reader, [least, line.len()]))
}

/// Holds what the first lines say against what the mapping expects of them.
fn expected(mapping: &Mapping, above: &[Vec<String>]) -> Result<(), String> {
    let heading = Heading { above, names: None, width: 0 };
    for (name, expected) in &mapping.expect {
        if let Some(said) = heading.after(name).filter(|said| said != expected) {
            return Err(format!(
                "expect: the table says {name:?} is {said:?}, the mapping is for {expected:?}; copy \
                 the mapping, change it to what the table is, and what it says there"
            ));
        }
    }
    Ok(())
}
