//! Reads cells as numbers.

use super::super::mapping::{Cell, DecimalMark};

/// Words for an empty cell.
const NOTHING: [&str; 8] = ["", "-", "nan", "na", "n/a", "#n/a", "null", "none"];

/// Reads numbers with the stated decimal mark, or with either, which must then be the same in all
/// cells.
#[derive(Clone, Debug, Default)]
pub(in crate::import) struct Numbers {
    stated: Option<DecimalMark>,
    /// The first number with a point and the first with a comma.
    point: Option<String>,
    comma: Option<String>,
    /// Whether a number has a comma that cannot be a mark of thousands.
    has_decimal_comma: bool,
}

impl Numbers {
    pub fn new(stated: Option<DecimalMark>) -> Self {
        Self { stated, ..Self::default() }
    }

    pub fn read(&mut self, cell: &[u8]) -> Cell {
        let Ok(text) = std::str::from_utf8(cell) else { return Cell::Other };
        let text = text.trim().trim_matches('"').trim();
        if NOTHING.iter().any(|word| text.eq_ignore_ascii_case(word)) {
            return Cell::Empty;
        }
        let has_comma = text.contains(',');
        let number = if has_comma {
            // Where commas separate cells, one within a cell was quoted. A comma is read as the
            // decimal mark, never as a mark of thousands; `doubt` tells where it may be one.
            let is_mark = self.stated != Some(DecimalMark::Point) && !text.ends_with(',');
            let is_one = text.bytes().filter(|byte| matches!(byte, b',' | b'.')).count() == 1;
            (is_mark && is_one).then(|| text.replace(',', ".").parse::<f64>().ok()).flatten()
        } else {
            let is_wrong = self.stated == Some(DecimalMark::Comma) && text.contains('.');
            if is_wrong { None } else { text.parse::<f64>().ok() }
        };
        let Some(number) = number.filter(|number| number.is_finite()) else { return Cell::Other };
        self.has_decimal_comma |= has_comma && !may_be_thousands(text);
        let seen = match (has_comma, text.contains('.')) {
            (true, _) => &mut self.comma,
            (false, true) => &mut self.point,
            (false, false) => return Cell::Number(number),
        };
        if seen.is_none() {
            *seen = Some(text.to_owned());
        }
        Cell::Number(number)
    }

    /// Why the decimal mark is ambiguous, if it is.
    pub fn doubt(&self) -> Option<String> {
        let (None, Some(comma)) = (self.stated, &self.comma) else { return None };
        match &self.point {
            Some(point) => Some(format!(
                "decimal is missing, and cells have both marks, as {point:?} and {comma:?}: write \
                 decimal = \".\" or decimal = \",\""
            )),
            None if self.has_decimal_comma => None,
            None => Some(format!(
                "decimal is missing, and cells such as {comma:?} may have commas for thousands: \
                 write decimal = \",\" if these are decimal marks, else decimal = \".\" and the \
                 numbers without commas"
            )),
        }
    }
}

/// Whether a number with a comma, as 12,500, may be one of thousands: three digits follow the comma,
/// and one to three, the first not 0, precede it.
fn may_be_thousands(text: &str) -> bool {
    let is_digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    let parts = text.trim_start_matches(['-', '+']).split_once(',');
    parts.is_some_and(|(before, after)| {
        (1..=3).contains(&before.len())
            && after.len() == 3
            && !before.starts_with('0')
            && is_digits(before)
            && is_digits(after)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_decimal_mark_is_read_and_mixed_marks_are_ambiguous() {
        let mut numbers = Numbers::new(None);
        assert_eq!(numbers.read(b" \"-0,25\" "), Cell::Number(-0.25));
        assert_eq!(numbers.read(b"NaN"), Cell::Empty);
        assert_eq!(numbers.read(b"inf"), Cell::Other);
        assert_eq!(numbers.read(b"1.234,5"), Cell::Other);
        assert_eq!(numbers.read(b"3"), Cell::Number(3.0));
        assert_eq!(numbers.doubt(), None);
        assert_eq!(numbers.read(b"0.5"), Cell::Number(0.5));
        assert!(numbers.doubt().is_some_and(|doubt| doubt.contains("\"0.5\" and \"-0,25\"")));
    }

    #[test]
    fn commas_that_may_be_of_thousands_are_ambiguous() {
        let doubt = |cells: &[&str], stated: Option<DecimalMark>| {
            let mut numbers = Numbers::new(stated);
            for cell in cells {
                numbers.read(cell.as_bytes());
            }
            numbers.doubt()
        };
        let thousands = ["900", "12,500", "-1,250"];
        let said = doubt(&thousands, None).expect("a doubt");
        assert!(said.contains("\"12,500\" may have commas for thousands"), "{said}");
        assert_eq!(doubt(&thousands, Some(DecimalMark::Comma)), None);
        for decimal in ["0,250", "1234,567", "1,5", "1,2500"] {
            assert_eq!(doubt(&["12,500", decimal], None), None, "{decimal}");
        }
    }

    #[test]
    fn stated_decimal_mark_excludes_the_other() {
        let mut numbers = Numbers::new(Some(DecimalMark::Comma));
        assert_eq!(numbers.read(b"0,5"), Cell::Number(0.5));
        assert_eq!(numbers.read(b"0.5"), Cell::Other);
        let mut numbers = Numbers::new(Some(DecimalMark::Point));
        assert_eq!(numbers.read(b"0,5"), Cell::Other);
    }
}
