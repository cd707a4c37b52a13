//! The truth of a case: what its vehicle has beyond its file.

use vehicle::effects::{EffectId, EffectSet};
use vehicle::foreign::Foreign;

/// The effects, or the disturbance, that a vehicle has beyond its file.
#[derive(Clone, Debug, Default)]
pub(in crate::exam) struct Truth {
    pub effects: EffectSet,
    pub foreign: Option<Foreign>,
    /// Effects of the catalogue that have the same cause as `foreign`.
    pub causes: &'static [EffectId],
    /// The rotor that `foreign` acts on.
    pub rotor: Option<usize>,
}

impl From<EffectSet> for Truth {
    fn from(effects: EffectSet) -> Self {
        Self { effects, ..Self::default() }
    }
}

/// Ids of the effects in a set.
pub(super) fn ids(effects: &EffectSet) -> Vec<EffectId> {
    effects.iter().map(|(effect, _)| effect).collect()
}
