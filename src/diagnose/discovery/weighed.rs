//! Weighs a law against the other explanations: the gap that it leaves, and its answer.

use vehicle::VehicleError;
use vehicle::effects::EffectSet;
use vehicle::law::Quantity;

use super::{Discovered, Draft};
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::term::name_of;
use crate::diagnose::discovery::law::{LawAnswer, NearEffect};
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::inquiry::Inquiry;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::decide;
use crate::diagnose::verdict::evidence::{Evidence, Explained, Found, Gaps};
use crate::diagnose::verdict::posterior::OPEN;

/// Explanations of the catalogue that are listed beside a law.
const NEAREST: usize = 3;

impl Inquiry<'_> {
    /// Weighs a draft against the other explanations, and describes it for the answer.
    pub(super) fn weigh(
        &self,
        evidence: &Evidence,
        floors: &[Option<Errors>; 2],
        (draft, explanation): (Draft, Explanation),
    ) -> Result<Discovered, DiagnoseError> {
        let catalogue = draft.catalogue(self);
        let name = name_of(&self.case.vehicle.modelled_effects);
        let mut explained = Explained {
            effects: self.names(&draft),
            blocks: explanation.blocks.clone(),
            ..Explained::default()
        };
        explained.effects.push(name.clone());
        let first = self.catalogue.numbers.len();
        explained.numbers = (first..catalogue.numbers.len())
            .map(|index| Found {
                effect: name.clone(),
                name: catalogue.numbers[index].target.name(),
                value: draft.fit.values[index],
                deviation: draft.fit.deviation[index],
                magnitude: catalogue.numbers[index].magnitude,
                ..Found::default()
            })
            .collect();
        let reported = |draft: &Draft| self.law_gaps(floors[1].as_ref(), &self.reported, draft);
        explained.choosing = self.law_gaps(floors[0].as_ref(), &self.choosing, &draft)?;
        explained.reported = reported(&draft)?;
        // Where a flight shows no gap and the law adds none, its predictions cannot rank the two:
        // noise alone would decide. Its equations can.
        let is_small = |gap: Option<f64>| gap.is_none_or(|gap| gap < OPEN);
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
        let after = reported(&refit)?;
        let (law, effects) = self.written(&refit, &name)?;
        let shipped = evidence.shipped[1];
        let gap = shipped.zip(after).map(|(before, after)| [before, after.effects, after.both]);
        let because = match (is_chosen, decision.explanation) {
            (true, _) => None,
            (false, 0) => Some(
                "it predicts the held-out flights no better than the vehicle file's \
                 numbers do within their tolerances"
                    .to_owned(),
            ),
            (false, other) if other == index => {
                Some("the gap that it leaves makes another cause more likely".to_owned())
            }
            (false, other) => {
                let effects = with.explanations[other].effects.join(" and ");
                Some(format!("{effects} from the catalogue does as well"))
            }
        };
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

    /// Ids of the effects beside a law.
    pub(super) fn names(&self, draft: &Draft) -> Vec<String> {
        let effects = draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect);
        effects.map(|effect| effect.name().to_owned()).collect()
    }

    /// The gaps with a law and with the file's numbers, which are adapted to those flights.
    pub(super) fn law_gaps(
        &self,
        floor: Option<&Errors>,
        look: &Observed<'_>,
        draft: &Draft,
    ) -> Result<Option<Gaps>, VehicleError> {
        let catalogue = draft.catalogue(self);
        let flights = look.flights;
        let Some(floor) = floor else { return Ok(None) };
        let alone = self.simulator(&self.set_of(&catalogue, draft, &draft.fit.values))?;
        let Some(effects) = alone.errors(flights) else { return Ok(None) };
        let values = self.adapted_to(&catalogue, draft, look);
        let (vehicle, all) = catalogue.vehicle_of(&values);
        let own: Vec<_> =
            draft.beside.iter().map(|h| self.catalogue.hypotheses[*h].effect).collect();
        let mut file = EffectSet::new();
        for (id, slots) in all.iter().filter(|(id, _)| !own.contains(id)) {
            // This insertion has succeeded before.
            let _ = file.insert(id, *slots);
        }
        let errors = |effects: &EffectSet| -> Result<Option<Errors>, VehicleError> {
            Ok(self.simulator(effects)?.flying(&vehicle, effects)?.errors(flights))
        };
        let both = errors(&all)?.zip(errors(&file)?);
        Ok(both.map(|(both, file)| Gaps::over([effects, file, both], floor, self.metric)))
    }

    /// The values of a draft, with the file's numbers adapted to the flights of `look`.
    fn adapted_to(&self, catalogue: &Catalogue, draft: &Draft, look: &Observed<'_>) -> Vec<f64> {
        let observed = look.by(catalogue);
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
