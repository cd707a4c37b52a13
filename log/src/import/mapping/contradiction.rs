//! Contradictions between a table's own labels and the mapping, which would give wrong numbers.

use super::QuaternionOrder;
use super::heading::Heading;
use super::unit_word;

/// Accepted relative difference between two factors of the same unit.
const ALIKE: f64 = 1e-9;
/// Axes of a quaternion.
const AXES: [char; 4] = ['w', 'x', 'y', 'z'];

/// Compares the factor to SI that the mapping gives a column with the unit below the column's name,
/// or in brackets in it.
pub(super) fn unit(
    heading: &Heading<'_>,
    field: &str,
    column: usize,
    factor: f64,
) -> Result<(), String> {
    let below = heading.units.and_then(|units| unit_word::of_cell(units.get(column)?));
    let stated = below.or_else(|| unit_word::in_brackets(heading.name(column)));
    let Some((stated, in_si)) = stated.and_then(|stated| Some((stated, unit_word::in_si(stated)?)))
    else {
        return Ok(());
    };
    if (in_si / factor - 1.0).abs() <= ALIKE {
        return Ok(());
    }
    Err(format!(
        "{field}: the table says that column {} is in {stated:?}, the mapping uses another unit; \
         correct the one that is wrong",
        heading.pointed_out(column)
    ))
}

/// Compares the order of a quaternion with the last letters of its columns' names, if these are its
/// axes.
pub(super) fn order(
    heading: &Heading<'_>,
    field: &str,
    columns: [usize; 4],
    order: QuaternionOrder,
) -> Result<(), String> {
    let (expected, written) = match order {
        QuaternionOrder::Wxyz => (['w', 'x', 'y', 'z'], "wxyz"),
        QuaternionOrder::Xyzw => (['x', 'y', 'z', 'w'], "xyzw"),
    };
    let names = columns.map(|column| heading.name(column).trim());
    let letters = names.map(|name| {
        let last = name.chars().rfind(|c| c.is_alphanumeric()).unwrap_or(' ');
        last.to_ascii_lowercase()
    });
    let is_all = AXES.iter().all(|axis| letters.contains(axis));
    let is_bare = names.iter().all(|name| name.chars().count() == 1)
        && letters.iter().all(|letter| AXES.contains(letter));
    if letters == expected || !(is_all || is_bare) {
        return Ok(());
    }
    let found: Vec<String> = columns.iter().map(|at| heading.pointed_out(*at)).collect();
    Err(format!(
        "{field}: the order is {written:?}, but the columns are {}; correct the order, or the columns",
        found.join(", ")
    ))
}
