//! Tables.

use std::fmt::Write;

use super::page::{Mood, escape};

/// Characters above which a text wraps.
const LONG: usize = 60;

/// A table with a header; columns of numbers stand to the right.
#[derive(Clone, Debug)]
pub struct Table {
    numeric: Vec<bool>,
    html: String,
}

impl Table {
    /// A table of these columns: heading, and whether they hold numbers.
    pub fn new(columns: &[(&str, bool)]) -> Self {
        let mut html = String::from("<div class=\"scroll\"><table><thead><tr>");
        for (heading, numeric) in columns {
            let class = if *numeric { " class=\"num\"" } else { "" };
            let _ = write!(html, "<th{class}>{}</th>", escape(heading));
        }
        html.push_str("</tr></thead><tbody>");
        Self { numeric: columns.iter().map(|(_, numeric)| *numeric).collect(), html }
    }

    /// Adds a row. `mood` colours its first cell.
    pub fn row(&mut self, mood: Mood, cells: &[String]) {
        let cells: Vec<Cell> = cells.iter().map(|cell| Cell::from(cell.as_str())).collect();
        self.cells(mood, &cells);
    }

    /// Adds a row of cells that may lead to an instant.
    pub fn cells(&mut self, mood: Mood, cells: &[Cell]) {
        self.html.push_str("<tr>");
        for (column, Cell(cell)) in cells.iter().enumerate() {
            let numeric = self.numeric.get(column).copied().unwrap_or(false);
            let class = match (column, mood, numeric) {
                (0, Mood::Good | Mood::Warning | Mood::Bad, _) => mood.class(),
                (_, _, true) => "num",
                _ if cell.len() > LONG => "text long",
                _ => "text",
            };
            let _ = write!(self.html, "<td class=\"{class}\">{cell}</td>");
        }
        self.html.push_str("</tr>");
    }

    /// The table.
    pub fn into_html(mut self) -> String {
        self.html.push_str("</tbody></table></div>");
        self.html
    }
}

/// What stands in a cell, as HTML.
#[derive(Clone, Debug)]
pub struct Cell(String);

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self(escape(text))
    }
}

impl Cell {
    /// A time that leads to the section `anchor`, and there to itself.
    pub fn instant(time_s: f64, anchor: &str) -> Self {
        Self(format!("<a href=\"#{anchor}\" data-at=\"{time_s}\">{time_s:.2}</a>"))
    }
}

/// Terms and what they are, one a line.
pub fn definitions<'a>(entries: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let mut html = String::from("<dl>");
    for (term, value) in entries {
        let _ = write!(html, "<dt>{}</dt><dd>{}</dd>", escape(term), escape(value));
    }
    html.push_str("</dl>");
    html
}
