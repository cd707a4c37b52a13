//! The first lines of a table: detects the separator of its cells and the line that names its
//! columns.

use std::io::{self, BufRead};

use super::super::mapping::{Cell, Heading, Mapping, RowReader, is_line_of_units, is_no_unit};
use super::super::read_ahead::read_ahead;
use super::dates;
use super::numbers::Numbers;
use super::text;

/// Number of bytes read as the head.
const SIZE: usize = 64 * 1024;
/// Number of lines in which the column names are searched for.
const LINES: usize = 100;
/// Separators of cells, in the order in which they are tried.
const SEPARATORS: [u8; 5] = *b",;\t| ";
/// Fewest numbers in a line whose cells are separated by spaces: sentences contain some too.
const SPACED: usize = 4;

/// The first lines of a table, and its bytes from there on.
#[derive(Debug)]
pub(in crate::import) struct Head {
    /// The skipped lines above.
    skipped: Vec<String>,
    /// The separator from a line `sep=`.
    separator: Option<u8>,
    /// The bytes behind the skipped lines.
    pub bytes: Vec<u8>,
}

/// Layout of a table.
#[derive(Debug)]
pub(super) struct Layout {
    pub separator: u8,
    /// Number of records before the first row.
    pub records_above: usize,
    /// Fewest and most cells of a row; the most does not count empty cells at its end.
    pub cells: [usize; 2],
    pub reader: RowReader,
}

/// Creates a reader of a table's records.
pub(super) fn records<R: io::Read>(separator: u8, source: R) -> csv::Reader<R> {
    csv::ReaderBuilder::new()
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(source)
}

impl Head {
    /// Reads the first lines of `source` after `skip_lines` lines.
    ///
    /// # Errors
    /// Errors of `source`.
    pub fn read(source: &mut impl BufRead, skip_lines: u64) -> io::Result<Self> {
        let mut head = Self { skipped: Vec::new(), separator: None, bytes: Vec::new() };
        // Some spreadsheets state the separator in a first line.
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

    /// The complete records of the head.
    fn cut(&self, separator: u8) -> Vec<Vec<String>> {
        let is_last_cut = self.bytes.len() == SIZE;
        let end = self.bytes.iter().rposition(|byte| *byte == b'\n').filter(|_| is_last_cut);
        let bytes = self.bytes.get(..end.unwrap_or(self.bytes.len())).unwrap_or_default();
        let all = records(separator, bytes).into_byte_records();
        let text = |cell: &[u8]| String::from_utf8_lossy(cell).trim().to_owned();
        all.map_while(Result::ok).take(LINES).map(|r| r.iter().map(text).collect()).collect()
    }

    /// The cells of the skipped lines.
    fn above(&self, separator: u8) -> Vec<Vec<String>> {
        let cells = |line: &String| {
            let record = records(separator, line.as_bytes()).into_records().next();
            let record = record.and_then(Result::ok).unwrap_or_default();
            record.iter().map(str::to_owned).collect()
        };
        self.skipped.iter().map(cells).collect()
    }

    /// The separators to try, in order; only one if the mapping or the table states it.
    fn separators(&self, stated: Option<char>) -> Result<Vec<u8>, String> {
        if let Some(stated) = stated {
            let byte = u8::try_from(stated).ok().filter(u8::is_ascii);
            let byte = byte.ok_or_else(|| {
                format!("separator: expected an ASCII character, found {stated:?}")
            })?;
            return Ok(vec![byte]);
        }
        Ok(self.separator.map_or(SEPARATORS.to_vec(), |separator| vec![separator]))
    }

    /// Finds the columns of `mapping`, by name or by number.
    ///
    /// # Errors
    /// The table lacks a column, or the mapping lacks a key; the text says which.
    pub(super) fn layout(&self, mapping: &Mapping) -> Result<Layout, String> {
        // Every separator refuses the table in its own words: those of the likeliest count.
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
            // A mapping that gives every column by number needs no line of names.
            let numbered = (offset..lines.len()).find_map(|at| {
                let (above, rest) = lines.split_at(at);
                let found = by_number(mapping, above, &rest[0])?;
                Some((at - offset, found))
            });
            let named = || {
                (offset..lines.len()).find_map(|at| {
                    let found = by_name(mapping, &lines, at).ok()?;
                    Some((at - offset + 1 + usize::from(found.0.has_units()), found))
                })
            };
            if let Some((records_above, (reader, cells))) = numbered.or_else(named) {
                return Ok(Layout { separator, records_above, cells, reader });
            }
            let like_names = header(&lines);
            let rank = |at: usize| (columns_found(mapping, &lines, at), Some(at) == like_names);
            let best = (offset..lines.len()).rev().max_by_key(|at| rank(*at)).unwrap_or(offset);
            let Err(error) = by_name(mapping, &lines, best) else { continue };
            let rank = (rank(best).0, rows_as_wide(&lines, best));
            if refusal.as_ref().is_none_or(|(most, _)| rank > *most) {
                refusal = Some((rank, error));
            }
        }
        Err(refusal.map_or_else(String::new, |(_, error)| error))
    }

    /// Whether any line has several numbers.
    pub fn has_numbers(&self) -> bool {
        let separators = self.separators(None).unwrap_or_default();
        separators.into_iter().any(|separator| {
            let mut numbers = Numbers::new(None);
            self.cut(separator).iter().any(|line| {
                let of = |cell: &String| numbers.read(cell.as_bytes());
                let count = line.iter().map(of).filter(|c| matches!(c, Cell::Number(_))).count();
                match separator {
                    b' ' => count >= SPACED && count == line.len(),
                    _ => count > 1,
                }
            })
        })
    }

    /// Finds the separator and the line of names without a mapping; `None` if the head does not look
    /// like a table.
    pub fn table(&self) -> Option<Sheet> {
        let separators = self.separators(None).ok()?;
        let sheets = separators.into_iter().filter_map(|separator| {
            let lines = self.cut(separator);
            let at = header(&lines)?;
            let (above, rest) = lines.split_at(at);
            let (line, rest) = rest.split_first()?;
            let units = rest.first().filter(|line| is_line_of_units(line));
            let rows = rest.get(usize::from(units.is_some())..)?.to_vec();
            let names = names(line);
            let units = units.cloned().unwrap_or_default();
            let least = if separator == b' ' { SPACED } else { 2 };
            let above = above.to_vec();
            (names.len() >= least).then_some(Sheet { separator, above, names, units, rows })
        });
        // The first of those with the most columns.
        sheets.reduce(|most, sheet| if sheet.names.len() > most.names.len() { sheet } else { most })
    }
}

/// A table's head without a mapping.
#[derive(Debug)]
pub(in crate::import) struct Sheet {
    pub separator: u8,
    /// The lines above the names.
    pub above: Vec<Vec<String>>,
    pub names: Vec<String>,
    /// The units in the line below the names; empty without such a line.
    pub units: Vec<String>,
    /// The first rows.
    pub rows: Vec<Vec<String>>,
}

impl Sheet {
    /// The word above a column in the nearest line that distinguishes columns of the same name, such
    /// as "Position" above X.
    pub fn group(&self, column: usize) -> &str {
        let is_twice = |at: &usize| {
            let name = &self.names[*at];
            !name.is_empty() && self.names.iter().filter(|known| *known == name).count() > 1
        };
        let twice: Vec<usize> = (0..self.names.len()).filter(is_twice).collect();
        let has = |line: &Vec<String>, at: &usize| line.get(*at).is_some_and(|c| !c.is_empty());
        let distinguishes =
            |line: &&Vec<String>| !twice.is_empty() && twice.iter().all(|at| has(line, at));
        let line = self.above.iter().rev().find(distinguishes);
        line.and_then(|line| line.get(column)).map_or("", String::as_str)
    }
}

/// The names in a line, without the comment mark that some tools put before them.
fn names(line: &[String]) -> Vec<String> {
    let mut names = line.to_vec();
    let Some(first) = names.first_mut() else { return names };
    let bare = first.trim_start_matches(['\u{feff}', '#', '%']).trim().to_owned();
    if bare.is_empty() && !first.is_empty() {
        // The mark is a cell of its own.
        names.remove(0);
    } else {
        *first = bare;
    }
    names
}

/// The first line of words above a line of numbers; a line of units may be in between.
fn header(lines: &[Vec<String>]) -> Option<usize> {
    let mut numbers = Numbers::new(None);
    let mut is_numeric = |line: &[String]| {
        let mut count = [0, 0];
        for cell in line {
            match numbers.read(cell.as_bytes()) {
                Cell::Number(_) => count[0] += 1,
                Cell::Other => count[1] += 1,
                Cell::Empty => {}
            }
        }
        // A single number is not a row: some tools write their rate above the table.
        count[0] > count[1].max(1)
    };
    let is_numeric: Vec<bool> = lines.iter().map(|line| is_numeric(line)).collect();
    let at = is_numeric.windows(2).position(|pair| pair == [false, true]);
    let is_units = at.is_some_and(|at| is_line_of_units(&lines[at]));
    let named = || at?.checked_sub(1).filter(|at| !is_numeric[*at] && lines[*at].len() > 1);
    if is_units { named().or(at) } else { at }
}

/// Finds the mapping's columns by the names in line `at`, with the fewest and most cells of a row.
fn by_name(
    mapping: &Mapping,
    lines: &[Vec<String>],
    at: usize,
) -> Result<(RowReader, [usize; 2]), String> {
    let (above, rest) = lines.split_at(at.min(lines.len()));
    let names = rest.first().map(|line| names(line)).unwrap_or_default();
    let mut numbers = Numbers::new(mapping.decimal);
    let is_word = |cell: &String| {
        is_no_unit(cell) || !matches!(numbers.read(cell.as_bytes()), Cell::Number(_))
    };
    let units = rest.get(1).filter(|line| line.iter().all(is_word)).map(Vec::as_slice);
    let heading = Heading { above, names: Some(&names), units, width: names.len() };
    let least = names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1);
    Ok((RowReader::new(mapping, heading)?, [least, names.len()]))
}

/// Number of the mapping's columns that the names in line `at` have.
fn columns_found(mapping: &Mapping, lines: &[Vec<String>], at: usize) -> usize {
    let (above, rest) = lines.split_at(at.min(lines.len()));
    let names = rest.first().map(|line| names(line)).unwrap_or_default();
    let heading = Heading { above, names: Some(&names), units: None, width: names.len() };
    mapping.columns().filter(|column| heading.has(column)).count()
}

/// Number of lines below line `at` with as many cells, if these are several.
fn rows_as_wide(lines: &[Vec<String>], at: usize) -> usize {
    let mut below = lines.iter().skip(at).map(Vec::len);
    let width = below.next().filter(|width| *width > 1);
    below.filter(|cells| Some(*cells) == width).count()
}

/// As [`by_name`], for a mapping that gives every column by number; `None` unless `line` is a valid
/// row.
fn by_number(
    mapping: &Mapping,
    above: &[Vec<String>],
    line: &[String],
) -> Option<(RowReader, [usize; 2])> {
    let heading = Heading { above, names: None, units: None, width: line.len() };
    let reader = RowReader::new(mapping, heading).ok()?;
    let mut numbers = Numbers::new(mapping.decimal);
    let read = |(at, cell): (usize, &String)| match reader.is_date(at) {
        true => dates::read(cell.as_bytes()),
        false => numbers.read(cell.as_bytes()),
    };
    let cells: Vec<Cell> = line.iter().enumerate().map(read).collect();
    let least = (0..line.len()).rev().find(|at| reader.uses(*at)).map_or(0, |last| last + 1);
    reader.read(0, &cells).is_ok().then_some((reader, [least, line.len()]))
}

/// Compares the first lines with the mapping's expectations.
fn expected(mapping: &Mapping, above: &[Vec<String>]) -> Result<(), String> {
    let heading = Heading { above, names: None, units: None, width: 0 };
    for (name, expected) in &mapping.expect {
        if let Some(found) = heading.after(name).filter(|found| found != expected) {
            return Err(format!(
                "expect: the table has {name:?} = {found:?}, the mapping is for {expected:?}; copy \
                 the mapping, and change it and this value to fit the table"
            ));
        }
    }
    Ok(())
}
