//! The answer key of a case: its vehicle's truth and the right answer.

use std::collections::BTreeMap;

use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

use super::Bench;
use super::drawn::Drawn;
use super::size::TruthStrength;
use super::truth::ids;
use crate::diagnose::catalogue::reference::reference_slots;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::parameter::parameters;
use crate::exam::condition::Condition;
use crate::exam::deviations::Deviation;
use crate::exam::draw::rounded;
use crate::exam::key::{KeyEntry, TrueEffect};
use crate::exam::order::Kind;
use crate::exam::strength::Strength;
use crate::exam::world::World;

impl Bench {
    /// The key entry of a truth whose flights are logged in `condition`.
    pub(super) fn key(&self, kind: Kind, condition: Condition, drawn: &Drawn) -> KeyEntry {
        let Drawn { truth, sizes, candidates, total } = drawn;
        let verdict = match kind {
            Kind::Null => Verdict::None,
            Kind::Trap if candidates.is_empty() => Verdict::None,
            Kind::LeftOut | Kind::Foreign => Verdict::Unknown,
            _ => Verdict::Effect,
        };
        let shown_as =
            |shown: &Option<TruthStrength>| shown.as_ref().map_or(0.0, |s| s.strength.ratio);
        let mut effects: Vec<TrueEffect> = sizes
            .iter()
            .map(|(effect, shown)| {
                true_effect(&self.nominal, &truth.effects, *effect, shown_as(shown))
            })
            .collect();
        effects.extend(truth.causes.first().map(|cause| TrueEffect {
            id: cause.name().to_owned(),
            parameters: BTreeMap::new(),
            neutral: BTreeMap::new(),
            ratio: rounded(shown_as(total)),
        }));
        let is_practical = match total {
            None => false,
            Some(total) if sizes.is_empty() => self.is_practical(total),
            Some(_) => sizes.iter().all(|(_, s)| s.as_ref().is_some_and(|s| self.is_practical(s))),
        };
        let names = |ids: &[EffectId]| ids.iter().map(|id| id.name().to_owned()).collect();
        let strength = total.as_ref().map_or_else(Strength::none, |total| total.strength.clone());
        let beyond_file = total.as_ref().filter(|_| self.world == World::Builders);
        let mut deviations = self.deviations_beside(truth).listed(&self.nominal);
        if kind == Kind::OtherLaw {
            deviations.extend(payload(&self.nominal, &truth.effects));
        }
        KeyEntry {
            kind,
            condition,
            file: self.setting.file,
            on_board: self.setting.on_board,
            outputs_hz: self.setting.outputs_hz,
            verdict: verdict.name().to_owned(),
            effects,
            also_right: names(truth.causes.get(1..).unwrap_or_default()),
            candidates: names(candidates),
            foreign: truth.foreign.clone(),
            without: if kind == Kind::LeftOut { names(&ids(&truth.effects)) } else { Vec::new() },
            deviations,
            beyond_tolerances: beyond_file.map_or_else(Vec::new, |shown| {
                shown.tolerances.iter().map(|off| off.map(rounded)).collect()
            }),
            ratio_beyond_file: beyond_file.map(|shown| rounded(shown.beyond.ratio)),
            is_practical,
            is_weak: strength.ratio < 1.0,
            snr: strength,
            nominal_mass_kg: self.nominal.mass,
            tags: self.notes.clone(),
        }
    }
}

fn true_effect(
    nominal: &VehicleParams,
    effects: &EffectSet,
    effect: EffectId,
    ratio: f64,
) -> TrueEffect {
    let values = |set: &EffectSet| {
        let all = parameters(set, effect);
        all.iter().map(|(name, value)| ((*name).to_owned(), value.into())).collect()
    };
    let mut neutral = EffectSet::new();
    let _ = neutral.insert(effect, reference_slots(nominal, effect));
    TrueEffect {
        id: effect.name().to_owned(),
        parameters: values(effects),
        neutral: values(&neutral),
        ratio: rounded(ratio),
    }
}

/// A payload's inertia, as a deviation: it is not an effect of its own.
fn payload(nominal: &VehicleParams, effects: &EffectSet) -> Option<Deviation> {
    effects.contains(EffectId::Inertia).then(|| {
        let TrueEffect { id, parameters, neutral, .. } =
            true_effect(nominal, effects, EffectId::Inertia, 0.0);
        Deviation { id, parameters, neutral, alternatives: Vec::new(), tolerances: None }
    })
}
