//! Units as tables write them: at the end of a name, or in a line below the names.

use crate::import::{RPM, STANDARD_GRAVITY};

/// Replaces every sequence of separators between the words of a name.
pub(super) const UNDERSCORE: char = '_';

/// Spellings of units in tables, and the spelling in a mapping file. Those that a mapping file
/// cannot state are known so that they are not taken for another.
const UNITS: [(&str, &str); 62] = [
    ("mrad_s", "mrad/s"),
    ("mrad", "mrad"),
    ("cdeg_s", "cdeg/s"),
    ("cdeg", "cdeg"),
    ("rev_s", "rev/s"),
    ("hz", "rev/s"),
    ("km_h", "km/h"),
    ("kmh", "km/h"),
    ("kph", "km/h"),
    ("ft_s", "ft/s"),
    ("kt", "kt"),
    ("knots", "kt"),
    ("km", "km"),
    ("ft", "ft"),
    ("feet", "ft"),
    ("inch", "in"),
    ("inches", "in"),
    ("mg", "mg"),
    ("g", "g"),
    ("\u{b5}s", "us"),
    ("\u{3bc}s", "us"),
    ("min", "min"),
    ("minutes", "min"),
    ("hours", "h"),
    ("m_s2", "m/s2"),
    ("m_s_2", "m/s2"),
    ("m_s_s", "m/s2"),
    ("mps2", "m/s2"),
    ("ms2", "m/s2"),
    ("rad_s", "rad/s"),
    ("radps", "rad/s"),
    ("rad_sec", "rad/s"),
    ("deg_s", "deg/s"),
    ("degps", "deg/s"),
    ("deg_sec", "deg/s"),
    ("dps", "deg/s"),
    ("cm_s", "cm/s"),
    ("mm_s", "mm/s"),
    ("m_s_1", "m/s"),
    ("rad_s_1", "rad/s"),
    ("deg_s_1", "deg/s"),
    ("m_s", "m/s"),
    ("mps", "m/s"),
    ("seconds", "s"),
    ("sec", "s"),
    ("secs", "s"),
    ("us", "us"),
    ("usec", "us"),
    ("ns", "ns"),
    ("nsec", "ns"),
    ("ms", "ms"),
    ("msec", "ms"),
    ("s", "s"),
    ("rad", "rad"),
    ("deg", "deg"),
    ("degrees", "deg"),
    ("rpm", "rpm"),
    ("mv", "mV"),
    ("v", "V"),
    ("mm", "mm"),
    ("cm", "cm"),
    ("m", "m"),
];

/// Words spelt out, each also with an s at its end, and how [`UNITS`] writes them.
const SPELT: [(&str, &str); 19] = [
    ("second", "s"),
    ("sec", "s"),
    ("millisecond", "ms"),
    ("microsecond", "us"),
    ("nanosecond", "ns"),
    ("minute", "min"),
    ("hour", "hours"),
    ("meter", "m"),
    ("metre", "m"),
    ("millimeter", "mm"),
    ("millimetre", "mm"),
    ("centimeter", "cm"),
    ("centimetre", "cm"),
    ("foot", "ft"),
    ("radian", "rad"),
    ("degree", "deg"),
    ("volt", "v"),
    ("millivolt", "mv"),
    ("squared", "2"),
];

/// Cells of a unit line for columns without a unit.
const NONE: [&str; 4] = ["", "1", "none", "frame"];

/// A name in lower case with its words joined by underscores; text in brackets counts as words.
pub(super) fn words(name: &str) -> String {
    let mut words = String::new();
    for c in name.chars() {
        match c {
            '²' => words.push('2'),
            '°' => words.push_str("deg"),
            c if c.is_alphanumeric() => words.extend(c.to_lowercase()),
            _ if words.ends_with(UNDERSCORE) => {}
            _ => words.push(UNDERSCORE),
        }
    }
    words.trim_matches(UNDERSCORE).to_owned()
}

/// Splits a trailing unit off the words.
pub(super) fn split(words: &str) -> (String, Option<&'static str>) {
    let ending = UNITS.iter().find_map(|(ending, unit)| {
        let stem = words.strip_suffix(ending)?.strip_suffix(UNDERSCORE)?;
        let stem = stem.trim_end_matches(UNDERSCORE);
        (!stem.is_empty()).then(|| (stem.to_owned(), Some(*unit)))
    });
    ending.unwrap_or_else(|| (words.to_owned(), None))
}

/// The unit in a cell, alone or in brackets.
pub(super) fn of_cell(cell: &str) -> Option<&'static str> {
    let short = |word: &str| {
        let is_it = |(spelt, _): &&(&str, &str)| {
            word.strip_prefix(spelt).is_some_and(|rest| matches!(rest, "" | "s"))
        };
        SPELT.iter().find(is_it).map_or_else(|| word.to_owned(), |(_, short)| (*short).to_owned())
    };
    let words = words(cell);
    let words: Vec<String> =
        words.split(UNDERSCORE).filter(|word| *word != "per").map(short).collect();
    let words = words.join("_");
    UNITS.iter().find(|(written, _)| *written == words).map(|(_, unit)| *unit)
}

/// Whether a cell below a name says that the column has no unit.
pub(in crate::import) fn is_none(cell: &str) -> bool {
    NONE.contains(&words(cell).as_str())
}

/// The unit in brackets at the end of a name.
pub(super) fn in_brackets(name: &str) -> Option<&'static str> {
    let open = name.rfind(['(', '['])?;
    name.ends_with([')', ']']).then(|| of_cell(name.get(open..)?)).flatten()
}

/// Whether most cells of a line that say anything are units.
pub(in crate::import) fn is_line(cells: &[String]) -> bool {
    let (units, others): (Vec<&String>, Vec<&String>) =
        cells.iter().filter(|cell| !is_none(cell)).partition(|cell| of_cell(cell).is_some());
    units.len() > others.len()
}

/// The SI value of one of a unit.
pub(super) fn in_si(unit: &str) -> Option<f64> {
    Some(match unit {
        "s" | "m" | "m/s" | "m/s2" | "rad" | "rad/s" | "V" => 1.0,
        "cm" | "cm/s" => 0.01,
        "ms" | "mm" | "mm/s" | "mV" => 1e-3,
        "us" => 1e-6,
        "ns" => 1e-9,
        "deg" | "deg/s" => 1f64.to_radians(),
        "rpm" => RPM,
        "rev/s" => std::f64::consts::TAU,
        "mrad" | "mrad/s" => 1e-3,
        "cdeg" | "cdeg/s" => 0.01 * 1f64.to_radians(),
        "g" => STANDARD_GRAVITY,
        "mg" => 1e-3 * STANDARD_GRAVITY,
        "km" => 1e3,
        "km/h" => 1.0 / 3.6,
        "ft" | "ft/s" => 0.3048,
        "kt" => 1852.0 / 3600.0,
        "in" => 0.0254,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_recognised_in_every_spelling() {
        for (cell, unit) in [
            ("mm", "mm"),
            ("[m/s]", "m/s"),
            ("(m/s²)", "m/s2"),
            ("m/s^2", "m/s2"),
            ("[rad s^-1]", "rad/s"),
            ("[m s^-2]", "m/s2"),
            ("°/s", "deg/s"),
            ("Deg", "deg"),
            ("Meters", "m"),
            ("[Seconds]", "s"),
            ("Volt", "V"),
            ("metres/second", "m/s"),
            ("meters per second squared", "m/s2"),
            ("degrees/sec", "deg/s"),
            ("radian", "rad"),
            ("milliseconds", "ms"),
            ("hours", "h"),
        ] {
            assert_eq!(of_cell(cell), Some(unit), "{cell}");
        }
        assert_eq!(of_cell("x"), None);
        assert_eq!(in_brackets("Position X (mm)"), Some("mm"));
        assert_eq!(in_brackets("Rot[0]"), None);
        assert_eq!(split(&words("gyro_x_dps")), ("gyro_x".to_owned(), Some("deg/s")));
        assert_eq!(split("s"), ("s".to_owned(), None));
    }

    #[test]
    fn unit_row_is_distinguished_from_header_row() {
        let line = |text: &str| is_line(&text.split(',').map(str::to_owned).collect::<Vec<_>>());
        assert!(line(",,rad,rad,rad,mm,mm,mm"));
        assert!(line("[s],[m],[m],[-],[-]"));
        assert!(line("-,s,m,m,m,deg,deg,deg,enum"));
        assert!(!line("t,px,py,pz"));
        assert!(!line("0,1,2"));
        assert!(!line(",,"));
    }
}
