//! The answer's description of a law for a gap that no effect of the catalogue explains.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::law::Law;

/// A law and how it fares on the flights.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LawAnswer {
    /// Whether it is named: it predicts flights that it was not fitted to better than every effect
    /// of the catalogue does.
    pub named: bool,
    /// Why it is not named, where it is not.
    pub because: Option<String>,
    /// Its posterior mass among all explanations, less the probability of another cause.
    pub probability: f64,
    /// Formulas, by the channel that they act on.
    pub formulas: BTreeMap<String, String>,
    /// Its terms, the one with the most evidence first.
    pub terms: Vec<TermAnswer>,
    /// Names of the quantities that it reads.
    pub depends_on: Vec<&'static str>,
    /// Range of each quantity in the flights; beyond it, the law keeps its value at the end.
    pub range: BTreeMap<String, [f64; 2]>,
    /// Evidence against the vehicle file within its tolerances, without the price of its terms,
    /// nats.
    pub evidence: f64,
    /// Ids of the effects that act beside it.
    pub beside: Vec<String>,
    /// The nearest effects of the catalogue, with comparable evidence in nats.
    pub nearest: Vec<NearEffect>,
    /// The gap on the held-out flights as shipped, with the law, and with the law and the file's
    /// numbers within their tolerances, in units of the floor.
    pub gap: Option<[f64; 3]>,
    /// (before - after) / (before - 1); missing where nothing is closable.
    pub closure: Option<f64>,
    /// The law in the form of an effects file.
    #[serde(skip)]
    pub law: Law,
}

/// A term of a law.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct TermAnswer {
    /// Its formulas, with `c` for the coefficient.
    pub term: String,
    /// Name of the coefficient in the law.
    pub name: String,
    /// Fitted value of the coefficient.
    pub value: f64,
    /// 90 % interval of the coefficient.
    pub interval: [f64; 2],
    /// Unit of the coefficient.
    pub unit: String,
    /// The fitted power or length (m), where the term has one.
    pub shape: Option<Shape>,
    /// Evidence lost without it, nats.
    pub evidence: f64,
}

/// A power or a length inside a term.
#[derive(Clone, Copy, Debug, JsonSchema, Serialize)]
pub struct Shape {
    /// The fitted value.
    pub value: f64,
    /// Its 90 % interval.
    pub interval: [f64; 2],
}

/// A set of effects of the catalogue that is near a law.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NearEffect {
    /// Ids of the effects.
    pub effects: Vec<String>,
    /// Evidence against the vehicle file within its tolerances, nats.
    pub evidence: f64,
}
