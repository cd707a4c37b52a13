//! The law that was written for what no effect of the catalogue explains, as the answer tells it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::law::Law;

/// A law, and what it makes of the flights.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LawAnswer {
    /// Whether it is named: it predicts flights that it was not made from better than every effect
    /// of the catalogue does.
    pub named: bool,
    /// Why it is not, where it is not.
    pub because: Option<String>,
    /// Its probability: its posterior mass among all explanations, less that of a cause that is
    /// something else again.
    pub probability: f64,
    /// Formulas, by where they act.
    pub formulas: BTreeMap<String, String>,
    /// Its terms, the one with the most evidence first.
    pub terms: Vec<TermAnswer>,
    /// The quantities that it depends on.
    pub depends_on: Vec<&'static str>,
    /// What the flights show of each: beyond it the law stays as it is at the end.
    pub range: BTreeMap<String, [f64; 2]>,
    /// Evidence over the vehicle file within its tolerances, without the price of its terms, nats.
    pub evidence: f64,
    /// Effects that act beside it.
    pub beside: Vec<String>,
    /// What of the catalogue comes nearest, with its evidence by the same measure, nats.
    pub nearest: Vec<NearEffect>,
    /// The gap on the flights held out as shipped, with the law, and with the law and the file's
    /// numbers within their tolerances, in units of what noise alone leaves.
    pub gap: Option<[f64; 3]>,
    /// (before - after) / (before - 1), where there is a gap.
    pub closure: Option<f64>,
    /// As an effects file has it.
    #[serde(skip)]
    pub law: Law,
}

/// A term of a law.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct TermAnswer {
    /// Where and how it acts, with `c` for its coefficient.
    pub term: String,
    /// The coefficient's name in the law.
    pub name: String,
    /// The coefficient.
    pub value: f64,
    /// Its 90 % interval.
    pub interval: [f64; 2],
    /// Its unit.
    pub unit: String,
    /// A power or a length (m) that was fitted too, with its 90 % interval.
    pub shape: Option<Shape>,
    /// Evidence that is lost without it, nats.
    pub evidence: f64,
}

/// A number inside a term.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
pub struct Shape {
    /// As fitted.
    pub value: f64,
    /// Its 90 % interval.
    pub interval: [f64; 2],
}

/// Effects of the catalogue that come near a law.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NearEffect {
    /// Their ids.
    pub effects: Vec<String>,
    /// Evidence over the vehicle file within its tolerances, nats.
    pub evidence: f64,
}
