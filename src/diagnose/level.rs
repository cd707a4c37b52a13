//! A level of the thrust, or a law of it: a mass or a thrust scale that stands for a sagging pack or
//! a curve of another shape than the catalogue's.

use sitl::effects::EffectId;

use super::hypothesis::Catalogue;
use super::linearised::Linearised;
use super::naming::{AS_GOOD, THRUST_LEVEL};
use super::selection::{Rival, Selection, Selector};

/// Standard deviations, beside a free level, by which flights part a law from it.
const PARTED: f64 = 5.0;

impl Selector<'_> {
    /// The selection with a law of the thrust in the place of a level that was chosen alone, where
    /// that law is as good and the flights would tell it from the level.
    pub(super) fn by_law(&self, about: &Linearised, selection: Selection) -> Selection {
        let Selection { null, singles, .. } = &selection;
        let law = law_as_good(self.catalogue, &selection);
        let law = law.filter(|law| self.accepts(&law.scored, null));
        let Some(law) = law.filter(|law| self.is_parted_from_level(about, law)) else {
            return selection;
        };
        let rivals = singles.iter().filter(|rival| {
            !is_level(self.catalogue, rival)
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
        let numbers = &self.catalogue.hypotheses[law.hypothesis].numbers;
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

/// Whether a hypothesis is a level of the thrust.
fn is_level(catalogue: &Catalogue, rival: &Rival) -> bool {
    catalogue.hypotheses[rival.hypothesis].effect.class() == EffectId::ThrustScale
}

/// The one law of the thrust that has about as much evidence as a level that was chosen alone.
///
/// A level is exact: where it is the cause, what only resembles it falls behind. No law is quite the
/// catalogue's: one that is as good is likelier the cause. Of 34 true levels with more than 50 nats
/// none had a law above 0.84 of its evidence, and of four with less three had; of seven levels of an
/// exam that stood for a law of another shape five had one above 0.85.
fn law_as_good<'s>(catalogue: &Catalogue, selection: &'s Selection) -> Option<&'s Rival> {
    let Selection { null, singles, best, .. } = selection;
    let evidence = |rival: &Rival| rival.scored.evidence - null.evidence;
    let levels = || singles.iter().filter(|rival| is_level(catalogue, rival));
    levels().find(|level| best.fit.hypotheses == [level.hypothesis])?;
    let most = levels().map(evidence).fold(0.0, f64::max);
    let is_law = |rival: &&Rival| {
        THRUST_LEVEL.contains(&catalogue.hypotheses[rival.hypothesis].effect)
            && !is_level(catalogue, rival)
            && evidence(rival) > AS_GOOD * most
    };
    let laws: Vec<&Rival> = singles.iter().filter(is_law).collect();
    match laws[..] {
        [law] => Some(law),
        // Where both are as good, the flights part nothing.
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use sitl::vehicle::VehicleParams;

    use super::*;
    use crate::diagnose::scored::Scored;

    #[test]
    fn one_law_that_is_as_good_as_a_level_alone_comes_before_it() {
        let vehicle = include_str!("../../config/vehicles/quad1200.toml");
        let catalogue = Catalogue::new(&VehicleParams::from_toml_str(vehicle).unwrap(), true);
        let hypothesis = |effect: EffectId| {
            catalogue.hypotheses.iter().position(|h| h.effect == effect).unwrap()
        };
        let law = |chosen: &[EffectId], singles: &[(EffectId, f64)]| {
            let scored = |set, evidence| Scored::of(set, evidence, Vec::new());
            let singles = singles.iter().map(|(effect, evidence)| {
                let hypothesis = hypothesis(*effect);
                Rival { hypothesis, scored: scored(vec![hypothesis], *evidence) }
            });
            let selection = Selection {
                null: scored(Vec::new(), 0.0),
                singles: singles.collect(),
                best: scored(chosen.iter().map(|effect| hypothesis(*effect)).collect(), 0.0),
                places: Vec::new(),
            };
            let law = law_as_good(&catalogue, &selection);
            law.map(|law| catalogue.hypotheses[law.hypothesis].effect)
        };
        let (mass, scale) = (EffectId::Mass, EffectId::ThrustScale);
        let (sag, curve) = (EffectId::BatterySag, EffectId::ThrustCurve);
        let evidence = [(mass, 100.0), (scale, 80.0), (curve, 90.0), (sag, 50.0)];
        assert_eq!(law(&[mass], &evidence), Some(curve));
        // Of the level that has the most, whichever was chosen.
        assert_eq!(law(&[scale], &[(mass, 100.0), (scale, 80.0), (curve, 75.0)]), None);
        // Where the flights part nothing, beside another effect, or in place of a law.
        assert_eq!(law(&[mass], &[(mass, 100.0), (curve, 90.0), (sag, 95.0)]), None);
        assert_eq!(law(&[mass, EffectId::YawTorque], &evidence), None);
        assert_eq!(law(&[curve], &evidence), None);
    }
}
