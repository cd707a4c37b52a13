//! What stands above the rows of a table: the names of its columns, and what points one out.

use super::Place;

/// Columns that an error names.
const OFFERED: usize = 60;
/// So many lines above the names point a column out.
const NEAR: usize = 4;

/// What stands above the rows of a table.
#[derive(Clone, Copy, Debug)]
pub struct Heading<'a> {
    /// The lines above the names.
    pub above: &'a [Vec<String>],
    /// The names of the columns, `None` where no line names them.
    pub names: Option<&'a [String]>,
    /// The units in a line below the names.
    pub units: Option<&'a [String]>,
    /// Columns of a row.
    pub width: usize,
}

impl Heading<'_> {
    pub(super) fn name(&self, column: usize) -> &str {
        self.names.and_then(|names| names.get(column)).map_or("", String::as_str)
    }

    /// Whether a line above has this word in this column.
    fn has_above(&self, column: usize, word: &str) -> bool {
        self.above.iter().any(|line| line.get(column).is_some_and(|cell| cell == word))
    }

    /// Columns that are called so.
    pub(super) fn called(&self, column: &Place) -> Vec<usize> {
        let is_called = |at: &usize| match column {
            Place::Name(name) => self.names.is_some() && self.name(*at) == name,
            Place::Number(number) => at + 1 == *number,
            Place::Words(words) => words.split_last().is_some_and(|(name, words)| {
                self.name(*at) == name && words.iter().all(|word| self.has_above(*at, word))
            }),
        };
        (0..self.width).filter(is_called).collect()
    }

    /// A column as one would point it out: its number and all that stands above it.
    pub(super) fn pointed_out(&self, column: usize) -> String {
        let near = &self.above[self.above.len().saturating_sub(NEAR)..];
        let mut words: Vec<&str> =
            near.iter().filter_map(|line| line.get(column)).map(String::as_str).collect();
        words.push(self.name(column));
        words.retain(|word| !word.is_empty());
        words.dedup();
        format!("{} ({})", column + 1, words.join(", "))
    }

    /// The cell that follows one of this content above the table.
    pub fn after(&self, cell: &str) -> Option<&str> {
        self.above.iter().find_map(|line| {
            let at = line.iter().position(|known| known == cell)?;
            line.get(at + 1).map(String::as_str)
        })
    }

    /// What the table has in place of a column that it lacks.
    pub(super) fn offers(&self) -> String {
        match self.names {
            Some(names) => {
                let named = names.len().min(OFFERED);
                let more = names.len() - named;
                let more = if more > 0 { format!(" and {more} more") } else { String::new() };
                format!("it has {}{more}", names[..named].join(", "))
            }
            None => format!("it has {} columns", self.width),
        }
    }
}
