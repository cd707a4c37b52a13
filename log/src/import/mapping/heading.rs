//! The lines above the rows of a table, which name and identify its columns.

use super::{Column, Place};

/// Number of columns listed in an error.
const OFFERED: usize = 60;
/// Number of lines above the names that describe a column.
const NEAR: usize = 4;

/// The lines above the rows of a table.
#[derive(Clone, Copy, Debug)]
pub struct Heading<'a> {
    /// The lines above the names.
    pub above: &'a [Vec<String>],
    /// The names of the columns; `None` if no line names them.
    pub names: Option<&'a [String]>,
    /// The line below the names, if it may have their units: none of its cells is a number.
    pub units: Option<&'a [String]>,
    /// Number of columns.
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

    /// The columns that `column` identifies.
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

    /// Whether the table has such a column.
    pub fn has(&self, column: &Column) -> bool {
        !self.called(&column.place).is_empty()
    }

    /// Describes a column for people: its number and the words above it.
    pub(super) fn pointed_out(&self, column: usize) -> String {
        let near = &self.above[self.above.len().saturating_sub(NEAR)..];
        let mut words: Vec<&str> =
            near.iter().filter_map(|line| line.get(column)).map(String::as_str).collect();
        words.push(self.name(column));
        words.retain(|word| !word.is_empty());
        words.dedup();
        format!("{} ({})", column + 1, words.join(", "))
    }

    /// Says that `found` are all called `column`.
    pub(super) fn listed(&self, column: &Place, found: &[usize]) -> String {
        let all: Vec<String> = found.iter().map(|at| self.pointed_out(*at)).collect();
        format!("the table has {} columns {column}: {}", found.len(), all.join(", "))
    }

    /// The cell after the first one with this content above the table.
    pub fn after(&self, cell: &str) -> Option<&str> {
        self.above.iter().find_map(|line| {
            let at = line.iter().position(|known| known == cell)?;
            line.get(at + 1).map(String::as_str)
        })
    }

    /// Describes the table's columns, for an error about one that it lacks.
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
