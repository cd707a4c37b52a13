//! The catalogue of effects.

use serde::{Deserialize, Serialize};

/// Effects that are switched on, with their parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectSet {}
