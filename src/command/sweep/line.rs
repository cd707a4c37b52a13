//! A point's row in its shard's file.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::command::rows::Numbered;

/// A row of a shard's file.
#[derive(Debug, JsonSchema, Deserialize, Serialize)]
pub struct Line {
    /// The point's number.
    pub index: usize,
    /// The varied inputs, by their paths.
    pub inputs: BTreeMap<String, Value>,
    /// Why it failed.
    pub failure: Option<String>,
    /// The row of `simulate`, of a diagnosis, or of an exam's case.
    pub row: Option<Value>,
}

impl Numbered for Line {
    fn number(&self) -> usize {
        self.index
    }
}
