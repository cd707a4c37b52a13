//! A level of the thrust, or a law of it: a mass or a thrust scale that stands for a sagging pack or
//! a curve of another shape than the catalogue's.

use sitl::effects::EffectId;

use super::linearised::Linearised;
use super::naming::AS_GOOD;
use super::selection::{Rival, Selection, Selector};

/// Laws by which the thrust's level changes.
const LAWS_OF_THRUST: [EffectId; 2] = [EffectId::BatterySag, EffectId::ThrustCurve];
/// Standard deviations, beside a free level, by which flights part a law from it.
const PARTED: f64 = 5.0;

impl Selector<'_> {
    /// The selection with a law of the thrust in the place of a level that was chosen alone. A level
    /// is exact: where it is the cause, what only resembles it falls behind, as far as the flights
    /// part the two. No law is quite the catalogue's: one that is as good is likelier the cause. Of
    /// 33 true levels with more than 50 nats none had a law above 0.83 of its evidence; of six levels
    /// of an exam that stood for a law of another shape five had one above 0.85.
    pub(super) fn by_law(&self, about: &Linearised, selection: Selection) -> Selection {
        let Selection { null, singles, best, .. } = &selection;
        let class = |rival: &&Rival| self.hypothesis(rival.hypothesis).effect.class();
        let is_level = |rival: &&Rival| class(rival) == EffectId::ThrustScale;
        let is_chosen = |rival: &&Rival| best.fit.hypotheses == [rival.hypothesis];
        if !singles.iter().any(|rival| is_chosen(&rival) && is_level(&rival)) {
            return selection;
        }
        let evidence = |rival: &Rival| rival.scored.evidence - null.evidence;
        let most = singles.iter().filter(is_level).map(evidence).fold(0.0, f64::max);
        let near = singles.iter().filter(|rival| evidence(rival) > AS_GOOD * most);
        let laws: Vec<&Rival> =
            near.filter(|rival| LAWS_OF_THRUST.contains(&class(rival))).collect();
        // Where both do, the flights part nothing.
        let [law] = laws[..] else { return selection };
        if !self.accepts(&law.scored, null) || !self.is_parted_from_level(about, law) {
            return selection;
        }
        let rivals = singles.iter().filter(|rival| {
            !is_level(rival)
                && rival.hypothesis != law.hypothesis
                && self.accepts(&rival.scored, null)
        });
        let places = vec![(null.clone(), rivals.cloned().collect())];
        Selection { best: law.scored.clone(), places, ..selection }
    }

    /// Whether the flights would tell a law of the thrust, as large as its fit alone has it, from
    /// another level.
    fn is_parted_from_level(&self, about: &Linearised, law: &Rival) -> bool {
        let level = self.catalogue.number_of(EffectId::ThrustScale, 0);
        let numbers = &self.hypothesis(law.hypothesis).numbers;
        let joint: Vec<usize> = level.into_iter().chain(numbers.iter().copied()).collect();
        let together = about.solve(self.catalogue, self.fitted.counts(), &joint);
        together.is_some_and(|together| {
            numbers.iter().all(|number| {
                let size =
                    law.scored.fit.values[*number] - self.catalogue.numbers[*number].reference;
                size.abs() > PARTED * together.deviation[*number]
            })
        })
    }
}
