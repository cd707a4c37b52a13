//! Checks of a law's text, and the compilation of its formulas.

use std::collections::BTreeMap;

use super::parser::{self, Constant};
use super::{CONSTANTS_MAX, Channel, LawError, LawText, Needed, Program, QUANTITIES, Quantity};

/// Longest name of a law or constant, and longest name in an error, in characters.
const NAME_MAX: usize = 32;
const QUOTED_MAX: usize = 64;

/// The key at fault, and what is wrong there.
pub(super) struct Fault {
    place: String,
    reason: String,
}

impl Fault {
    fn at(place: &str, reason: impl Into<String>) -> Self {
        Self { place: place.to_owned(), reason: reason.into() }
    }

    /// The error of the law with this name.
    pub fn of(self, law: &str) -> LawError {
        let short = |text: &str| text.chars().take(QUOTED_MAX).collect();
        LawError { law: short(law), place: short(&self.place), reason: self.reason }
    }
}

fn is_name(name: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    name.len() <= NAME_MAX
        && name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(is_part)
}

/// Checks a law's name.
pub(super) fn name(name: &str) -> Result<(), Fault> {
    if is_name(name) {
        return Ok(());
    }
    Err(Fault::at("name", "a law's name is up to 32 letters, digits and '_'"))
}

/// The constants, by name.
pub(super) fn constants(text: &LawText) -> Result<BTreeMap<String, Constant>, Fault> {
    if text.constants.len() > CONSTANTS_MAX {
        return Err(Fault::at("constants", format!("more than {CONSTANTS_MAX}")));
    }
    let mut constants = BTreeMap::new();
    for (key, written) in &text.constants {
        let is_taken = Quantity::ALL.iter().any(|quantity| quantity.name() == key);
        if !is_name(key) || is_taken {
            let reason =
                "a constant's name is letters, digits and '_', and not the name of a quantity";
            return Err(Fault::at(key, reason));
        }
        let constant = Constant::parse(written).map_err(|reason| Fault::at(key, reason))?;
        constants.insert(key.clone(), constant);
    }
    Ok(constants)
}

/// The compiled formulas, at least one.
pub(super) fn formulas(
    text: &LawText,
    constants: &BTreeMap<String, Constant>,
) -> Result<Vec<(Channel, Program)>, Fault> {
    let mut formulas = Vec::new();
    for (key, formula) in &text.formulas {
        let Some(channel) = Channel::of(key) else {
            let known: Vec<&str> = Channel::ALL.iter().map(|channel| channel.name()).collect();
            let reason = format!(
                "unknown key; a law has about, constants, range, intervals_90, max_force_N, \
                 max_moment_Nm, and formulas at {}",
                known.join(", ")
            );
            return Err(Fault::at(key, reason));
        };
        let program = parser::parse(formula, constants, channel.unit())
            .map_err(|reason| Fault::at(key, reason))?;
        formulas.push((channel, program));
    }
    if formulas.is_empty() {
        return Err(Fault::at("formulas", "expected at least one, such as force_x"));
    }
    Ok(formulas)
}

/// The range of validity of each quantity; unbounded where none is given.
pub(super) fn limits(text: &LawText) -> Result<[[f64; 2]; QUANTITIES], Fault> {
    let mut limits = [[f64::NEG_INFINITY, f64::INFINITY]; QUANTITIES];
    for (key, [low, high]) in &text.range {
        let quantity = Quantity::ALL.into_iter().find(|quantity| quantity.name() == key);
        let Some(slot) = quantity.and_then(|q| limits.get_mut(q as usize)) else {
            return Err(Fault::at("range", format!("{key:?} is not a quantity")));
        };
        if !(low.is_finite() && high.is_finite() && low <= high) {
            let reason = format!("{key}: expected [low, high], found [{low}, {high}]");
            return Err(Fault::at("range", reason));
        }
        *slot = [*low, *high];
    }
    Ok(limits)
}

/// Checks the intervals of the constants, and the bounds of force and moment.
pub(super) fn bounds(text: &LawText) -> Result<(), Fault> {
    if let Some((key, _)) =
        text.intervals_90.iter().find(|(_, ends)| ends.iter().any(|end| !end.is_finite()))
    {
        return Err(Fault::at("intervals_90", format!("{key}: expected two numbers")));
    }
    for (key, bound) in [("max_force_N", text.max_force_n), ("max_moment_Nm", text.max_moment_nm)] {
        if bound.is_some_and(|bound| !(bound.is_finite() && bound > 0.0)) {
            return Err(Fault::at(key, "expected a number above 0"));
        }
    }
    Ok(())
}

/// The extra lag of the rotors, s; 0 without a formula for it.
pub(super) fn lag_s(
    formulas: &[(Channel, Program)],
    limits: &[[f64; 2]; QUANTITIES],
) -> Result<f64, Fault> {
    let at_rest = [0.0; QUANTITIES];
    let mut lag_s = 0.0;
    for (_, program) in formulas.iter().filter(|(channel, _)| *channel == Channel::Lag) {
        if program.needed() != Needed::default() {
            let reason = "a lag takes only constants and numbers: it is the same in every flight";
            return Err(Fault::at("lag", reason));
        }
        lag_s = program.value(&at_rest, limits);
        if !(0.0..=1.0).contains(&lag_s) {
            let reason = format!("expected an added lag of 0..=1 s, found {lag_s}");
            return Err(Fault::at("lag", reason));
        }
    }
    Ok(lag_s)
}
