//! Reads times written as dates, as in ISO 8601.

use super::super::mapping::Cell;
use crate::calendar;

const DAY_S: f64 = 86400.0;

/// Seconds since 1970 for a date with a time of day, such as `2024-03-01T23:59:50.25Z`; seconds
/// since midnight for a time of day alone, such as `23:59:50.25`. A time without an offset is UTC.
pub(in crate::import) fn read(cell: &[u8]) -> Cell {
    let Ok(text) = std::str::from_utf8(cell) else { return Cell::Other };
    let text = text.trim().trim_matches('"').trim();
    if text.is_empty() {
        return Cell::Empty;
    }
    seconds(text).map_or(Cell::Other, Cell::Number)
}

fn seconds(text: &str) -> Option<f64> {
    let Some((date, time)) = text.split_once(['T', 't', ' ']) else { return time_of_day(text) };
    let mut parts = date.split(['-', '/']);
    let year = digits(parts.next()?, 4)?;
    let (month, day) = (digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let is_date = (1..=12).contains(&month) && (1..=31).contains(&day) && parts.next().is_none();
    let time = time.trim();
    let (time, offset) = match time.strip_suffix(['Z', 'z']) {
        Some(time) => (time, 0.0),
        None => match time.rfind(['+', '-']) {
            Some(at) => (time.get(..at)?, offset(time.get(at..)?)?),
            None => (time, 0.0),
        },
    };
    let midnight = DAY_S * calendar::days(year, month, day) as f64;
    is_date.then_some(midnight + time_of_day(time.trim())? - offset)
}

/// Seconds since midnight.
fn time_of_day(text: &str) -> Option<f64> {
    let mut parts = text.split(':');
    let (hour, minute, second) = (parts.next()?, parts.next()?, parts.next()?);
    let second = second.replace(',', ".");
    let is_second = second.starts_with(|c: char| c.is_ascii_digit());
    let second = second.parse::<f64>().ok().filter(|s| is_second && (0.0..61.0).contains(s))?;
    let (hour, minute) = (digits(hour, 2)?, digits(minute, 2)?);
    let is_time = hour < 24 && minute < 60 && parts.next().is_none();
    is_time.then_some(3600.0 * hour as f64 + 60.0 * minute as f64 + second)
}

/// Offset from UTC in s, from `+01:00`, `+0100` or `+01`.
fn offset(text: &str) -> Option<f64> {
    let (sign, text) = match text.strip_prefix('-') {
        Some(text) => (-1.0, text),
        None => (1.0, text.strip_prefix('+')?),
    };
    let text = text.replace(':', "");
    let hours = digits(text.get(..2)?, 2)?;
    let minutes = if text.len() > 2 { digits(&text[2..], 2)? } else { 0 };
    Some(sign * (3600.0 * hours as f64 + 60.0 * minutes as f64))
}

/// An unsigned integer of one to `most` digits.
fn digits(text: &str, most: usize) -> Option<i64> {
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    (is_number && text.len() <= most).then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_seconds_since_1970() {
        for (text, seconds) in [
            ("1970-01-01T00:00:00Z", 0.0),
            ("2000-03-01 00:00:00", 951_868_800.0),
            ("2024-02-29T12:30:15.25Z", 1_709_209_815.25),
            ("\"2024-02-29T13:30:15,25+01:00\"", 1_709_209_815.25),
            ("2024-02-29 04:30:15.25-0800", 1_709_209_815.25),
            ("2024/02/29 12:30:15.250", 1_709_209_815.25),
            ("23:59:50.5", 86_390.5),
        ] {
            assert_eq!(read(text.as_bytes()), Cell::Number(seconds), "{text}");
        }
        for text in ["1.5", "12:30", "2024-02-29", "2024-13-01T00:00:00", "25:00:00", "1:2:inf"] {
            assert_eq!(read(text.as_bytes()), Cell::Other, "{text}");
        }
        assert_eq!(read(b" "), Cell::Empty);
    }
}
