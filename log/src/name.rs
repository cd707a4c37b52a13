//! Names of log files.

use message::clock::HostTime;

use crate::calendar;

/// `YYYY-MM-DDTHH-MM-SSZ_<vehicle>_<run>`, UTC; of the two names, only letters, digits, `-` and `.`
/// remain.
pub(super) fn stem(start: HostTime, vehicle: &str, run: &str) -> String {
    let seconds = start.as_ns() / 1_000_000_000;
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    format!(
        "{}T{hour:02}-{minute:02}-{second:02}Z_{}_{}",
        date(seconds),
        sanitised(vehicle),
        sanitised(run)
    )
}

/// `YYYY-MM-DD`, UTC, from seconds since 1970.
pub fn date(seconds: u64) -> String {
    let (year, month, day) = calendar::date(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Replaces every character in `name` that could confuse a file system or a shell.
pub(super) fn sanitised(name: &str) -> String {
    let kept = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.');
    let name: String = name.chars().map(|c| if kept(c) { c } else { '-' }).take(64).collect();
    let name = name.trim_matches(['.', '-']);
    if name.is_empty() { "unnamed".into() } else { name.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_contain_utc_and_no_path_separators() {
        let at = |seconds: u64| HostTime::from_ns(seconds * 1_000_000_000);
        assert_eq!(stem(at(0), "x", "y"), "1970-01-01T00-00-00Z_x_y");
        assert_eq!(stem(at(1_709_210_096), "../quad 1", ""), "2024-02-29T12-34-56Z_quad-1_unnamed");
        assert_eq!(stem(at(4_102_444_799), "a", "b"), "2099-12-31T23-59-59Z_a_b");
    }
}
