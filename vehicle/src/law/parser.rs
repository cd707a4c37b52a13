//! Parses a formula and checks its units. It has no input except the text and the constants, and
//! its work is bounded by the text's length.

use std::collections::BTreeMap;

use super::program::{Binary, OPERATIONS_MAX, Operation, Program, STACK_MAX, Unary};
use super::quantity::Quantity;
use super::unit::Unit;

/// Length limit of a formula, bytes.
pub const LENGTH_MAX: usize = 1024;
/// Limit on the nesting of parentheses and function calls.
const DEPTH_MAX: usize = 24;
/// Largest magnitude of an exponent.
const POWER_MAX: f64 = 8.0;

/// A number with its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constant {
    /// The value in SI units.
    pub value: f64,
    /// The unit of the value.
    pub unit: Unit,
}

impl Constant {
    /// Parses a number with its unit, such as `0.012 kg/s`.
    ///
    /// # Errors
    /// A sentence that says what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let (number, unit) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let expected = || {
            format!(
                "{text:?} is not a number with a unit; write it as \"0.012 kg/s\", or \"1.3\" \
                 where it has none"
            )
        };
        let value: f64 = number.parse().map_err(|_| expected())?;
        let unit = Unit::parse(unit).ok_or_else(expected)?;
        if value.is_finite() { Ok(Self { value, unit }) } else { Err(expected()) }
    }
}

/// Parses a formula and checks that it has the given unit.
///
/// # Errors
/// A sentence that says what is wrong and where.
pub fn parse(
    text: &str,
    constants: &BTreeMap<String, Constant>,
    unit: Unit,
) -> Result<Program, String> {
    if text.len() > LENGTH_MAX {
        return Err(format!("the formula has {} bytes; expected at most {LENGTH_MAX}", text.len()));
    }
    let mut parser = Parser { text, at: 0, depth: 0, constants, operations: Vec::new() };
    let found = parser.sum()?;
    parser.skip_blank();
    if parser.at < text.len() {
        return Err(parser.wrong("an operator or the end"));
    }
    if found != unit {
        return Err(format!("the formula is in {found}, expected {unit}"));
    }
    Program::new(parser.operations).ok_or_else(|| {
        format!("the formula is too long: at most {OPERATIONS_MAX} operations, {STACK_MAX} at once")
    })
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    constants: &'a BTreeMap<String, Constant>,
    operations: Vec<Operation>,
}

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn skip_blank(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    /// The next byte that is not whitespace.
    fn next(&mut self) -> Option<u8> {
        self.skip_blank();
        self.rest().bytes().next()
    }

    fn takes(&mut self, byte: u8) -> bool {
        let is_there = self.next() == Some(byte);
        self.at += usize::from(is_there);
        is_there
    }

    fn needs(&mut self, byte: u8) -> Result<(), String> {
        match self.takes(byte) {
            true => Ok(()),
            false => Err(self.wrong(&format!("{:?}", char::from(byte)))),
        }
    }

    fn wrong(&self, expected: &str) -> String {
        match self.rest().chars().next() {
            Some(found) => {
                format!("at character {}: expected {expected}, found {found:?}", self.at)
            }
            None => format!("the formula ends too early: expected {expected}"),
        }
    }

    fn push(&mut self, operation: Operation) -> Result<(), String> {
        if self.operations.len() >= OPERATIONS_MAX {
            return Err(format!("the formula has more than {OPERATIONS_MAX} operations"));
        }
        self.operations.push(operation);
        Ok(())
    }

    fn binary(&mut self, binary: Binary) -> Result<(), String> {
        self.push(Operation::Binary(binary))
    }

    fn sum(&mut self) -> Result<Unit, String> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(format!("the formula is nested deeper than {DEPTH_MAX}"));
        }
        let unit = self.product()?;
        loop {
            let (binary, word) = match self.next() {
                Some(b'+') => (Binary::Add, "added to"),
                Some(b'-') => (Binary::Subtract, "subtracted from"),
                _ => break,
            };
            self.at += 1;
            let other = self.product()?;
            if other != unit {
                return Err(format!("a value in {other} cannot be {word} a value in {unit}"));
            }
            self.binary(binary)?;
        }
        self.depth -= 1;
        Ok(unit)
    }

    fn product(&mut self) -> Result<Unit, String> {
        let mut unit = self.signed()?;
        loop {
            let binary = match self.next() {
                Some(b'*') => Binary::Multiply,
                Some(b'/') => Binary::Divide,
                _ => return Ok(unit),
            };
            self.at += 1;
            let other = self.signed()?;
            let joint =
                if binary == Binary::Multiply { unit.times(other) } else { unit.over(other) };
            unit = joint.ok_or("the powers of a unit are too large")?;
            self.binary(binary)?;
        }
    }

    fn signed(&mut self) -> Result<Unit, String> {
        let mut is_negative = false;
        while let Some(sign @ (b'-' | b'+')) = self.next() {
            is_negative ^= sign == b'-';
            self.at += 1;
        }
        let unit = self.power()?;
        if is_negative {
            self.push(Operation::Unary(Unary::Negate))?;
        }
        Ok(unit)
    }

    fn power(&mut self) -> Result<Unit, String> {
        let unit = self.atom()?;
        if !self.takes(b'^') {
            return Ok(unit);
        }
        let is_bracketed = self.takes(b'(');
        let sign = if self.takes(b'-') { -1.0 } else { 1.0 };
        let power = sign * self.exponent()?;
        if is_bracketed {
            self.needs(b')')?;
        }
        if power.is_nan() || power.abs() > POWER_MAX {
            return Err(format!("the power {power} is beyond {POWER_MAX}"));
        }
        if power.fract() == 0.0 {
            let integer = power as i8;
            self.push(Operation::Unary(Unary::IntegerPower(integer)))?;
            return unit.to_power(integer).ok_or_else(|| "a unit's power is too large".to_owned());
        }
        if power == 0.5
            && let Some(unit) = unit.root()
        {
            self.push(Operation::Unary(Unary::Root))?;
            return Ok(unit);
        }
        if !unit.is_none() {
            return Err(format!(
                "a value in {unit} cannot be raised to the power {power}; divide it by a reference \
                 first, as in (airspeed / 1[m/s])^{power}"
            ));
        }
        self.push(Operation::Unary(Unary::Power(power)))?;
        Ok(unit)
    }

    /// Parses an exponent: a number or a dimensionless constant.
    fn exponent(&mut self) -> Result<f64, String> {
        self.skip_blank();
        if let Some(name) = self.name() {
            let constant = self.constants.get(name).filter(|constant| constant.unit.is_none());
            let wrong = || format!("the power {name} is not a constant without a unit");
            return constant.map(|constant| constant.value).ok_or_else(wrong);
        }
        self.number()
    }

    fn atom(&mut self) -> Result<Unit, String> {
        if self.takes(b'(') {
            let unit = self.sum()?;
            self.needs(b')')?;
            return Ok(unit);
        }
        self.skip_blank();
        let Some(name) = self.name() else { return self.literal() };
        if self.next() == Some(b'(') {
            return self.function(name);
        }
        if let Some(constant) = self.constants.get(name) {
            self.push(Operation::Constant(constant.value))?;
            return Ok(constant.unit);
        }
        let quantity = Quantity::ALL.into_iter().find(|quantity| quantity.name() == name);
        let Some(quantity) = quantity else {
            let known = Quantity::ALL.map(Quantity::name).join(", ");
            return Err(format!("{name:?} is neither a constant of this law nor one of {known}"));
        };
        self.push(Operation::Quantity(quantity))?;
        Ok(quantity.unit())
    }

    fn function(&mut self, name: &str) -> Result<Unit, String> {
        self.needs(b'(')?;
        let unit = self.sum()?;
        let unary = match name {
            "abs" => Unary::Absolute,
            "sqrt" => Unary::Root,
            "exp" => Unary::Exponential,
            "sin" => Unary::Sine,
            "cos" => Unary::Cosine,
            "min" | "max" => {
                self.needs(b',')?;
                let other = self.sum()?;
                if other != unit {
                    return Err(format!("{name} of a value in {unit} and one in {other}"));
                }
                let binary = if name == "min" { Binary::Least } else { Binary::Greatest };
                self.binary(binary)?;
                self.needs(b')')?;
                return Ok(unit);
            }
            _ => {
                return Err(format!(
                    "there is no function {name:?}; there are abs, sqrt, exp, sin, cos, min and max"
                ));
            }
        };
        self.needs(b')')?;
        self.push(Operation::Unary(unary))?;
        match unary {
            Unary::Absolute => Ok(unit),
            Unary::Root => unit.root().ok_or_else(|| format!("sqrt of a value in {unit}")),
            _ if unit.is_none() => Ok(unit),
            _ => Err(format!("{name} needs a number without a unit; this one is in {unit}")),
        }
    }

    /// Parses a number, optionally followed by a unit in brackets.
    fn literal(&mut self) -> Result<Unit, String> {
        let value = self.number()?;
        let mut unit = Unit::NONE;
        if self.takes(b'[') {
            let rest = self.rest();
            let end = rest.find(']').ok_or("a unit's '[' has no ']'")?;
            let text = rest.get(..end).unwrap_or_default();
            unit = Unit::parse(text).ok_or_else(|| {
                format!(
                    "{text:?} is not a unit; units are made of kg, m, s, V, N and rad, such as kg/s"
                )
            })?;
            self.at += end + 1;
        }
        self.push(Operation::Constant(value))?;
        Ok(unit)
    }

    fn number(&mut self) -> Result<f64, String> {
        self.skip_blank();
        let rest = self.rest().as_bytes();
        let mut end = 0;
        while let Some(byte) = rest.get(end) {
            let after_exponent = end > 0 && matches!(rest.get(end - 1), Some(b'e' | b'E'));
            let is_part = byte.is_ascii_digit()
                || *byte == b'.'
                || (matches!(byte, b'e' | b'E') && end > 0)
                || (matches!(byte, b'-' | b'+') && after_exponent);
            if !is_part {
                break;
            }
            end += 1;
        }
        let text = self.rest().get(..end).unwrap_or_default();
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        let value = value.ok_or_else(|| self.wrong("a number, a name or '('"))?;
        self.at += end;
        Ok(value)
    }

    fn name(&mut self) -> Option<&'a str> {
        let rest = self.rest();
        let is_first = rest.bytes().next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_');
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let end = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
        let name = rest.get(..end).filter(|_| is_first)?;
        self.at += end;
        Some(name)
    }
}
