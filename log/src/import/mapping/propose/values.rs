//! Infers units and meanings of columns from the first rows of a table.

use super::super::super::table::{Numbers, dates};
use super::super::Cell;
use super::{Group, Proposal};

impl Proposal<'_> {
    /// The numbers of a column in the first rows.
    pub(super) fn numbers(&self, at: usize) -> Vec<f64> {
        let mut numbers = Numbers::new(None);
        let read = |row: &Vec<String>| match numbers.read(row.get(at)?.as_bytes()) {
            Cell::Number(number) => Some(number),
            _ => None,
        };
        self.sheet.rows.iter().filter_map(read).collect()
    }

    /// Whether the first rows of a column are dates or times of day.
    pub(super) fn is_date(&self, at: usize) -> bool {
        let cells: Vec<&String> = self.sheet.rows.iter().filter_map(|row| row.get(at)).collect();
        let is_date = |cell: &&String| matches!(dates::read(cell.as_bytes()), Cell::Number(_));
        !cells.is_empty() && cells.iter().all(is_date)
    }

    /// The unit for which the rate of the rows is 1 Hz to a few kHz, and the step.
    pub(super) fn time_unit(&self, at: usize) -> (&'static str, f64) {
        let times = self.numbers(at);
        let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let step = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let unit = match step {
            step if step < 1.0 => "s",
            step if step < 250.0 => "ms",
            step if step < 250_000.0 => "us",
            _ => "ns",
        };
        (unit, (step * 1e9).round() * 1e-9)
    }

    pub(super) fn largest(&self, group: &Group) -> f64 {
        let sizes = group.at.iter().flat_map(|at| self.numbers(*at)).map(f64::abs);
        sizes.fold(0.0, f64::max)
    }

    /// Angles beyond a full turn are not radians.
    pub(super) fn angle_unit(&self, group: &Group) -> Option<&'static str> {
        (self.largest(group) > std::f64::consts::TAU).then_some("deg")
    }

    /// The mean length of a vector in the first rows.
    pub(super) fn mean_size(&self, group: &Group) -> f64 {
        let columns: Vec<Vec<f64>> = group.at.iter().map(|at| self.numbers(*at)).collect();
        let count = columns.iter().map(Vec::len).min().unwrap_or(0);
        let sizes = (0..count)
            .map(|row| columns.iter().map(|column| column[row].powi(2)).sum::<f64>().sqrt());
        sizes.sum::<f64>() / count.max(1) as f64
    }

    /// At rest an accelerometer measures gravity, while an acceleration is zero.
    pub(super) fn force_meaning(&self, group: &Group) -> &'static str {
        let mean = self.mean_size(group);
        let is_gravity = (mean - 9.8).abs() < 2.0 || (mean - 1.0).abs() < 0.2;
        if is_gravity { "specific_force" } else { "acceleration" }
    }
}
