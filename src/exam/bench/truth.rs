//! What a case's vehicle has beyond its file.

use vehicle::effects::{EffectId, EffectSet};
use vehicle::foreign::Foreign;

/// What the vehicle has as an effect.
#[derive(Clone, Debug, Default)]
pub(in crate::exam) struct Truth {
    pub effects: EffectSet,
    pub foreign: Option<Foreign>,
    /// The causes of what the catalogue does not have.
    pub causes: &'static [EffectId],
    /// The rotor that this acts on.
    pub rotor: Option<usize>,
}

impl From<EffectSet> for Truth {
    fn from(effects: EffectSet) -> Self {
        Self { effects, ..Self::default() }
    }
}

/// Which effects a set has.
pub(super) fn ids(effects: &EffectSet) -> Vec<EffectId> {
    effects.iter().map(|(effect, _)| effect).collect()
}
