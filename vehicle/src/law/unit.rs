//! Units of formulas: integer powers of kg, m, s and V. Angles are dimensionless.

use std::fmt;

/// A unit as powers of kg, m, s and V.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unit([i8; 4]);

/// Base units, in the order of the powers.
const BASE: [&str; 4] = ["kg", "m", "s", "V"];

/// Unit names and their powers of the base units.
const NAMED: [(&str, [i8; 4]); 8] = [
    ("kg", [1, 0, 0, 0]),
    ("m", [0, 1, 0, 0]),
    ("s", [0, 0, 1, 0]),
    ("V", [0, 0, 0, 1]),
    ("N", [1, 1, -2, 0]),
    ("rad", [0; 4]),
    ("1", [0; 4]),
    ("-", [0; 4]),
];

impl Unit {
    /// Dimensionless.
    pub const NONE: Self = Self([0; 4]);
    /// N.
    pub const FORCE: Self = Self([1, 1, -2, 0]);
    /// N m.
    pub const MOMENT: Self = Self([1, 2, -2, 0]);
    /// m/s.
    pub const SPEED: Self = Self([0, 1, -1, 0]);
    /// 1/s, also for rad/s.
    pub const RATE: Self = Self([0, 0, -1, 0]);
    /// m.
    pub const LENGTH: Self = Self([0, 1, 0, 0]);
    /// s.
    pub const TIME: Self = Self([0, 0, 1, 0]);
    /// V.
    pub const VOLTAGE: Self = Self([0, 0, 0, 1]);

    /// Parses a unit such as `kg/s`, `N m` or `s^2/m^2`. A `/` inverts only the next unit.
    pub fn parse(text: &str) -> Option<Self> {
        let mut unit = Self::NONE;
        let mut sign = 1;
        let mut rest = text.trim();
        while !rest.is_empty() {
            let end = rest.find([' ', '/', '*']).unwrap_or(rest.len());
            let (token, behind) = rest.split_at(end);
            if !token.is_empty() {
                let (name, power) = match token.split_once('^') {
                    Some((name, power)) => (name, power.parse::<i8>().ok()?),
                    None => (token, 1),
                };
                let (_, powers) = NAMED.iter().find(|(known, _)| *known == name)?;
                unit = unit.times(Self(*powers).to_power(power.checked_mul(sign)?)?)?;
                sign = 1;
            }
            if behind.starts_with('/') {
                sign = -1;
            }
            rest = behind.get(1..).unwrap_or_default();
        }
        (sign == 1).then_some(unit)
    }

    /// The unit of a product; `None` if a power overflows.
    pub fn times(self, other: Self) -> Option<Self> {
        let mut powers = self.0;
        for (mine, theirs) in powers.iter_mut().zip(other.0) {
            *mine = mine.checked_add(theirs)?;
        }
        Some(Self(powers))
    }

    /// The unit of a quotient; `None` if a power overflows.
    pub fn over(self, other: Self) -> Option<Self> {
        self.times(other.to_power(-1)?)
    }

    /// The unit of an integer power; `None` if a power overflows.
    pub fn to_power(self, power: i8) -> Option<Self> {
        let mut powers = self.0;
        for mine in &mut powers {
            *mine = mine.checked_mul(power)?;
        }
        Some(Self(powers))
    }

    /// The unit of a square root; `None` if a power is odd.
    pub fn root(self) -> Option<Self> {
        self.0.iter().all(|power| power % 2 == 0).then(|| Self(self.0.map(|power| power / 2)))
    }

    /// Whether it is dimensionless.
    pub fn is_none(self) -> bool {
        self == Self::NONE
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = [(Self::FORCE, "N"), (Self::MOMENT, "N m"), (Self::NONE, "1")];
        if let Some((_, name)) = named.iter().find(|(unit, _)| unit == self) {
            return f.write_str(name);
        }
        let write = |f: &mut fmt::Formatter<'_>, name: &str, power: i8| match power {
            1 => f.write_str(name),
            _ => write!(f, "{name}^{power}"),
        };
        let mut above = BASE.iter().zip(self.0).filter(|(_, power)| *power > 0).peekable();
        if above.peek().is_none() {
            f.write_str("1")?;
        }
        for (index, (name, power)) in above.enumerate() {
            f.write_str(if index > 0 { " " } else { "" })?;
            write(f, name, power)?;
        }
        for (name, power) in BASE.iter().zip(self.0).filter(|(_, power)| *power < 0) {
            f.write_str("/")?;
            write(f, name, power.saturating_neg())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_parsed_and_printed() {
        for (text, written) in [
            ("N m", "N m"),
            ("kg m/s^2", "N"),
            ("N s/m", "kg/s"),
            ("s^2/m^2", "s^2/m^2"),
            ("1/s", "1/s"),
            ("rad", "1"),
            ("", "1"),
        ] {
            assert_eq!(Unit::parse(text).unwrap().to_string(), written, "{text}");
        }
        for wrong in ["furlong", "m^", "m^999", "kg/", "m^99 m^99"] {
            assert_eq!(Unit::parse(wrong), None, "{wrong}");
        }
    }
}
