//! Inputs of a sweep of an exam.

use serde::Deserialize;
use toml::{Table, Value};

use crate::command::exam::Questions;
use crate::exam::order::Kind;

/// The inputs as the manifest gives them: flags of `exam`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Given {
    pub cases: Option<usize>,
    #[serde(default = "nulls")]
    pub nulls: usize,
    #[serde(default)]
    pub kinds: Vec<Kind>,
    #[serde(default)]
    pub round_trip: bool,
    #[serde(default = "seconds")]
    pub seconds: f64,
    #[serde(default = "strengths")]
    pub strengths: [f64; 2],
    #[serde(default)]
    pub exact: bool,
    pub twins: Option<u32>,
}

fn nulls() -> usize {
    20
}

fn seconds() -> f64 {
    22.5
}

fn strengths() -> [f64; 2] {
    [0.3, 30.0]
}

impl Given {
    /// The selected cases.
    pub fn questions(&self) -> Questions {
        let Self { cases, nulls, kinds, round_trip, .. } = self;
        Questions { cases: *cases, nulls: *nulls, kinds: kinds.clone(), round_trip: *round_trip }
    }
}

/// The number of cases of each seed.
///
/// # Errors
/// An input has the wrong type.
pub(super) fn cases(fixed: &Table) -> anyhow::Result<usize> {
    let given: Given = Value::Table(fixed.clone()).try_into()?;
    Ok(given.questions().orders(0)?.len())
}
