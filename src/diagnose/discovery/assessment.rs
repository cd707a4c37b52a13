//! Compares a law with the other explanations: the gap that it leaves, and its answer.

use vehicle::VehicleError;
use vehicle::effects::EffectSet;
use vehicle::law::Quantity;

use super::{Discovered, Draft, LawGaps};
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::term::name_of;
use crate::diagnose::context::DiagnosisContext;
use crate::diagnose::discovery::law::{LawAnswer, NearEffect};
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::decide;
use crate::diagnose::verdict::evidence::{Evidence, Explained, Found, Gaps};
use crate::diagnose::verdict::posterior::OPEN_GAP;

/// Explanations of the catalogue that are listed beside a law.
const NEAREST: usize = 3;

impl DiagnosisContext<'_> {
    /// Compares a draft with the other explanations, and describes it for the answer.
    pub(super) fn assess(
        &self,
        evidence: &Evidence,
        floors: &[Option<Errors>; 2],
        draft: Draft,
        explanation: &Explanation,
    ) -> Result<Discovered, DiagnoseError> {
        let name = name_of(&self.input.vehicle.modelled_effects);
        let gaps = |which: usize, draft: &Draft| -> Result<Option<Gaps>, VehicleError> {
            let data = [&self.choosing, &self.reported][which];
            Ok(self.law_gaps(floors[which].as_ref(), data, draft)?.map(|law| law.gaps))
        };
        let mut explained = self.explained_by(&draft, explanation, &name);
        explained.choosing = gaps(0, &draft)?;
        explained.reported = gaps(1, &draft)?;
        // Where a flight shows no gap and the law adds none, its predictions cannot rank the two:
        // noise alone would decide. Its equations can.
        let is_small = |gap: Option<f64>| gap.is_none_or(|gap| gap < OPEN_GAP);
        if is_small(evidence.shipped[0]) && is_small(explained.choosing.map(|gaps| gaps.effects)) {
            explained.choosing = None;
        }
        let mut with = evidence.clone();
        with.explanations.push(explained);
        let decision = decide(&with);
        let index = with.explanations.len() - 1;
        let is_chosen = decision.explanation == index && decision.verdict == Verdict::Effect;
        let scores = with.scores();

        // Fitted to all flights except the held-out ones.
        let refit = self.fitted_terms(&self.all, &draft.fit, &draft.beside, &draft.terms);
        let refit = Draft { fit: refit.unwrap_or_else(|| draft.fit.clone()), ..draft };
        let after = gaps(1, &refit)?;
        let (law, effects) = self.law_with_effects(&refit, &name)?;
        let shipped = evidence.shipped[1];
        let gap = shipped.zip(after).map(|(before, after)| [before, after.effects, after.both]);
        let because = (!is_chosen).then(|| not_named(&with, decision.explanation));
        let mut order: Vec<usize> = (1..index).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let nearest = order.into_iter().take(NEAREST).map(|rank| NearEffect {
            effects: with.explanations[rank].effects.clone(),
            evidence: scores[rank],
        });
        let mut depends_on: Vec<Quantity> =
            refit.terms.iter().flat_map(|(term, _)| term.quantities()).collect();
        depends_on.sort_unstable();
        depends_on.dedup();
        let answer = LawAnswer {
            named: is_chosen,
            because,
            probability: decision.masses.get(index).copied().unwrap_or(0.0)
                * (1.0 - decision.outside),
            formulas: law.text().formulas.clone(),
            terms: self.terms_of(&refit),
            depends_on: depends_on.into_iter().map(Quantity::name).collect(),
            range: law.text().range.clone(),
            evidence: scores[index],
            beside: self.names(&refit),
            nearest: nearest.collect(),
            gap,
            closure: gap.filter(|[before, ..]| *before > 1.05).map(|[b, a, _]| (b - a) / (b - 1.0)),
            law,
        };
        Ok(Discovered { answer, effects })
    }

    /// A draft in plain numbers, before its predictions, with the law's coefficients as the numbers
    /// of an effect `name`.
    fn explained_by(&self, draft: &Draft, explanation: &Explanation, name: &str) -> Explained {
        let catalogue = draft.catalogue(self);
        let coefficient = |index: usize| Found {
            effect: name.to_owned(),
            name: catalogue.numbers[index].target.name(),
            value: draft.fit.values[index],
            deviation: draft.fit.deviation[index],
            magnitude: catalogue.numbers[index].magnitude,
            ..Found::default()
        };
        let first = self.catalogue.numbers.len();
        let mut effects = self.names(draft);
        effects.push(name.to_owned());
        Explained {
            effects,
            numbers: (first..catalogue.numbers.len()).map(coefficient).collect(),
            blocks: explanation.blocks.clone(),
            ..Explained::default()
        }
    }

    /// Ids of the effects beside a law.
    pub(super) fn names(&self, draft: &Draft) -> Vec<String> {
        let effects = draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect);
        effects.map(|effect| effect.name().to_owned()).collect()
    }

    /// The gaps with a law and with the file's numbers, which are adapted to those flights.
    pub(super) fn law_gaps(
        &self,
        floor: Option<&Errors>,
        data: &Observed<'_>,
        draft: &Draft,
    ) -> Result<Option<LawGaps>, VehicleError> {
        let catalogue = draft.catalogue(self);
        let flights = data.flights;
        let Some(floor) = floor else { return Ok(None) };
        let alone = self.simulator(&self.set_of(&catalogue, draft, &draft.fit.values))?;
        let Some(effects) = alone.errors(flights) else { return Ok(None) };
        let values = self.adapted_to(&catalogue, draft, data);
        let (vehicle, all) = catalogue.vehicle_of(&values);
        let own: Vec<_> =
            draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect).collect();
        let mut file = EffectSet::new();
        for (id, slots) in all.iter().filter(|(id, _)| !own.contains(id)) {
            // This insertion has succeeded before.
            let _ = file.insert(id, *slots);
        }
        let errors = |effects: &EffectSet| -> Result<Option<Errors>, VehicleError> {
            Ok(self.simulator(effects)?.with_vehicle(&vehicle, effects)?.errors(flights))
        };
        let both = errors(&all)?.zip(errors(&file)?);
        Ok(both.map(|(both, file)| LawGaps {
            gaps: Gaps::over([effects, both], floor, self.metric),
            file: file.over(floor, self.metric),
        }))
    }

    /// The values of a draft, with the file's numbers adapted to the flights of `data`.
    fn adapted_to(&self, catalogue: &Catalogue, draft: &Draft, data: &Observed<'_>) -> Vec<f64> {
        let observed = data.with_catalogue(catalogue);
        let values = &draft.fit.values;
        let pinned = catalogue.with_pinned(&draft.active(self), values);
        let numbers: Vec<usize> = (0..self.catalogue.numbers.len()).collect();
        let about = Linearised::new(&observed, values, &numbers);
        let solution = about.and_then(|about| about.solve(&pinned, observed.counts(), &[]));
        solution.map_or_else(|| values.clone(), |solution| solution.values)
    }

    /// A law and the effects beside it, without changes to the file's numbers.
    fn set_of(&self, catalogue: &Catalogue, draft: &Draft, values: &[f64]) -> EffectSet {
        let own = draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect);
        let mut set = self.catalogue.effects(values, Some(&own.collect::<Vec<_>>()));
        let (_, all) = catalogue.vehicle_of(values);
        for law in all.laws() {
            let _ = set.insert_law(law.clone());
        }
        set
    }
}

/// Why a law, the last explanation of the evidence, is not named where the verdict rests on
/// explanation `chosen`.
fn not_named(evidence: &Evidence, chosen: usize) -> String {
    match chosen {
        0 => {
            "it predicts the held-out flights no better than the vehicle file's numbers do within \
              their tolerances"
                .to_owned()
        }
        law if law + 1 == evidence.explanations.len() => {
            "the gap that it leaves makes another cause more likely".to_owned()
        }
        other => {
            let effects = evidence.explanations[other].effects.join(" and ");
            format!("{effects} from the catalogue does as well")
        }
    }
}
