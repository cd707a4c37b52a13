//! Effects that the search did not choose, or chose and could not vouch for, and that act all the
//! same.
//!
//! An effect is chosen if it explains what the equations leave and predicts flights better, beyond
//! chance. Some causes fail that and are told otherwise. One acts by another law than the
//! catalogue's: it has all the evidence that there is, and its predictions are better here and
//! worse there; it may be chosen, and leave too much to be trusted. Another is a lag of the rotors,
//! for which the equations may put stamps of the outputs that are late by as much: no stamp changes
//! what setpoints bring about, and predictions tell. A third lies in numbers of the vehicle file
//! that the flights know well, and whose priors gave way: nothing is left for an effect to explain.

use sitl::effects::{EffectId, EffectSet};

use super::answer::{Gap, Verdict};
use super::fit::Fit;
use super::gap::Errors;
use super::hypothesis::Catalogue;
use super::inquiry::{Inquiry, Judgement};
use super::judgement::{CLOSED_MIN, Unexplained, is_open, is_rate_off};
use super::law::{acts_by_its_law, has_law, is_constant, is_itself};
use super::scored::Scored;
use super::search::{Search, correct};
use super::selection::{BEYOND_DOUBT, Rival, Selection, Thresholds};
use super::strain::effect_of;

/// Share of the evidence of the effect that explains the most which others may have, for it to be
/// alone: of 495 causes of a round trip 46 % were.
const BESIDE_MAX: f64 = 0.05;
/// Standard errors by which the flights held out must confirm it, where it is not beyond doubt.
const CONFIRMED: f64 = 3.0;

/// An effect that was not chosen and is named.
#[derive(Clone, Debug)]
pub(super) struct Unchosen {
    /// The effect, as its best fit alone has it.
    pub effect: EffectId,
    /// That fit.
    pub scored: Scored,
    /// The effect with its numbers where it closes the gap; nothing where its law does not.
    pub effects: EffectSet,
}

impl Inquiry<'_> {
    /// The effect that acts where what was found, or that nothing was, does not stand: beside none,
    /// or in place of itself. `gap`: with what was found.
    pub fn unchosen(
        &self,
        search: &Search,
        judgement: &Judgement,
        gap: Option<&Gap>,
    ) -> Option<Unchosen> {
        let is_rate_off = self.leg() && gap.is_some_and(is_rate_off);
        let lag = || self.lag(search);
        match judgement.because {
            Some(Unexplained::OpenGap | Unexplained::OpenOnOne) => self.sole(search).or_else(lag),
            Some(Unexplained::Doubt) => self.sole(search).or_else(|| self.steady_drag(search)),
            Some(Unexplained::Strain) => self.strained(search),
            Some(Unexplained::Neighbour) if is_rate_off => lag(),
            None if judgement.verdict == Verdict::None && is_rate_off => lag(),
            _ => None,
        }
    }

    /// The effect that is alone in explaining anything, where no other number is strained and its
    /// own need not vary.
    fn sole(&self, search: &Search) -> Option<Unchosen> {
        let alone = alone(self.catalogue, &search.selection, &search.thresholds)?;
        let own = Some(self.catalogue.hypotheses[alone.hypothesis].effect);
        let mut varies = search.constancy.variation.iter();
        let is_kept = Some(alone.hypothesis) != search.dropped
            && !varies.any(|varies| is_constant(varies.effect))
            && search.strained.iter().all(|strain| strain.effect == own);
        let named = self.by_its_fit(search, alone).filter(|_| is_kept)?;
        Some(self.as_far(search, named))
    }

    /// The drag that was chosen alone, beyond doubt, and holds at any speed: air drags the vehicle,
    /// though more along one of its axes than along another.
    fn steady_drag(&self, search: &Search) -> Option<Unchosen> {
        let Search { selection, constancy, .. } = search;
        let [drag] = selection.best.fit.hypotheses[..] else { return None };
        let alone = selection.singles.iter().find(|rival| rival.hypothesis == drag)?;
        let is_sure = alone.scored.evidence - selection.null.evidence > BEYOND_DOUBT;
        let is_it = constancy.is_steady_drag && is_sure && search.strained.is_empty();
        self.by_its_fit(search, alone).filter(|_| is_it).map(|named| self.as_far(search, named))
    }

    /// What acts, with its numbers as far as they close the gap.
    fn as_far(&self, search: &Search, named: Unchosen) -> Unchosen {
        let closes = self.closes(search, &named.effects, &[Errors::mean_over]);
        let effects = if closes { named.effects } else { EffectSet::new() };
        Unchosen { effects, ..named }
    }

    /// The lag of the rotors, where it closes the gap.
    fn lag(&self, search: &Search) -> Option<Unchosen> {
        let effect = |rival: &Rival| self.catalogue.hypotheses[rival.hypothesis].effect;
        let mut singles = search.selection.singles.iter();
        let lag = singles.find(|rival| effect(rival) == EffectId::MotorLag)?;
        let named = self.by_its_fit(search, lag)?;
        let metrics = [Errors::mean_over, Errors::rates_over];
        self.closes(search, &named.effects, &metrics).then_some(named)
    }

    /// A hypothesis by its fit alone, where nothing else was chosen that it would replace.
    fn by_its_fit(&self, search: &Search, rival: &Rival) -> Option<Unchosen> {
        let effect = |hypothesis: usize| self.catalogue.hypotheses[hypothesis].effect;
        let named = effect(rival.hypothesis);
        let mut chosen = search.selection.best.fit.hypotheses.iter();
        let replaces_none = chosen.all(|chosen| effect(*chosen).class() == named.class());
        let freed = replaces_none.then(|| self.freed(search, rival.scored.clone()));
        freed.and_then(|scored| self.named(named, scored))
    }

    /// The effect that all strained numbers belong to, where nothing was chosen: a number that
    /// flights know, and that is further off than files are, is that effect. Its prior took the
    /// evidence from it.
    fn strained(&self, search: &Search) -> Option<Unchosen> {
        let Search { selection, strained, of_null, .. } = search;
        let found = !selection.best.fit.hypotheses.is_empty();
        let effect = effect_of(strained).filter(|_| !found)?;
        let mut hypotheses = self.catalogue.hypotheses.iter();
        let hypothesis = hypotheses.position(|hypothesis| hypothesis.effect == effect)?;
        let Scored { fit, evidence, density, .. } = &selection.null;
        let fit = Fit { hypotheses: vec![hypothesis], ..fit.clone() };
        let mut scored = Scored::new(fit, *evidence, density.clone());
        // By the twins that the numbers were nuisances of.
        correct(&mut scored, self.catalogue, of_null.as_ref()?);
        self.named(effect, scored)
    }

    /// An effect by its fit, freed of what that is off by itself, where it is the one that it is.
    fn named(&self, effect: EffectId, scored: Scored) -> Option<Unchosen> {
        let effects = self.catalogue.effects(&scored.fit.values, Some(&[effect]));
        let is_it = is_itself(self.catalogue, &scored.fit, effect);
        is_it.then_some(Unchosen { effect, scored, effects })
    }

    /// Whether `effects` close most of the gap over all flights, in several metrics together, and
    /// leave none open on those held out.
    fn closes(
        &self,
        search: &Search,
        effects: &EffectSet,
        metrics: &[fn(&Errors, &Errors) -> f64],
    ) -> bool {
        let flights = self.case.fitted.iter().chain(self.case.held_out);
        let (shipped, repaired) = match (self.simulator(&EffectSet::new()), self.simulator(effects))
        {
            (Ok(shipped), Ok(repaired)) => (shipped, repaired),
            _ => return false,
        };
        let (mut before, mut after) = (0.0, 0.0);
        for flight in flights.map(std::slice::from_ref) {
            let floor = repaired.floor(flight, &search.noise, self.settings.seed);
            let errors = shipped.errors(flight).zip(repaired.errors(flight));
            let Some(((shipped, repaired), floor)) = errors.zip(floor) else { continue };
            let excess = |errors: &Errors| -> f64 {
                metrics.iter().map(|over| (over(errors, &floor.errors) - 1.0).max(0.0)).sum()
            };
            before += excess(&shipped);
            after += excess(&repaired);
        }
        let gap = self.gap(&search.selection, effects);
        let stays_open = gap.is_ok_and(|gap| gap.is_some_and(|gap| is_open(&gap, true)));
        after < (1.0 - CLOSED_MIN) * before && !stays_open
    }
}

/// The hypothesis that explains what no other touches; `None` where there is none, or where it may
/// be chance.
fn alone<'s>(
    catalogue: &Catalogue,
    selection: &'s Selection,
    thresholds: &Thresholds,
) -> Option<&'s Rival> {
    let class = |rival: &Rival| catalogue.hypotheses[rival.hypothesis].effect.class();
    let evidence = |rival: &Rival| rival.scored.evidence - selection.null.evidence;
    let first = selection.singles.iter().max_by(|a, b| evidence(a).total_cmp(&evidence(b)))?;
    let most = evidence(first);
    let predicts = |rival: &&Rival| rival.scored.predicts_as_well_as(&selection.null);
    let others = selection.singles.iter().filter(predicts);
    let others = others.filter(|rival| class(rival) != class(first));
    let is_alone = others.map(evidence).fold(0.0, f64::max) < BESIDE_MAX * most;
    let (gain, error) = first.scored.gain_over(&selection.null);
    let effect = catalogue.hypotheses[first.hypothesis].effect;
    let is_sure = most > BEYOND_DOUBT && (has_law(effect) || predicts(&first));
    let is_sure = is_sure || gain > CONFIRMED * error;
    let is_more = most > thresholds.asked_of(first.hypothesis);
    let is_it = is_alone && is_sure && is_more && acts_by_its_law(catalogue, &first.scored.fit);
    is_it.then_some(first)
}

#[cfg(test)]
mod tests {
    use sitl::vehicle::VehicleParams;

    use super::*;

    #[test]
    fn an_effect_is_alone_where_no_other_has_evidence_and_it_is_no_chance() {
        let vehicle = include_str!("../../config/vehicles/quad1200.toml");
        let catalogue = Catalogue::new(&VehicleParams::from_toml_str(vehicle).unwrap(), true);
        let hypothesis = |effect: EffectId| {
            catalogue.hypotheses.iter().position(|h| h.effect == effect).unwrap()
        };
        let rival = |(effect, evidence, gain): (EffectId, f64, f64)| {
            let hypothesis = hypothesis(effect);
            let density = vec![0.5 * gain - 1.0, 0.5 * gain + 1.0];
            Rival { hypothesis, scored: Scored::of(vec![hypothesis], evidence, density) }
        };
        let found = |singles: &[(EffectId, f64, f64)]| {
            let null = Scored::of(Vec::new(), 0.0, vec![0.0, 0.0]);
            let singles = singles.iter().copied().map(rival).collect();
            let selection = Selection { best: null.clone(), null, singles, places: Vec::new() };
            let alone = alone(&catalogue, &selection, &Thresholds::default());
            alone.map(|rival| catalogue.hypotheses[rival.hypothesis].effect)
        };
        let (ground, lag) = (EffectId::GroundEffect, EffectId::MotorLag);
        // Beyond doubt, even where the flights held out speak against its law.
        assert_eq!(found(&[(ground, 150.0, -20.0), (lag, 3.0, 0.0)]), Some(ground));
        // With less, they must confirm it.
        assert_eq!(found(&[(ground, 60.0, 1.0)]), None);
        // What is a number, and no law, is the same there.
        let latency = EffectId::EstimatorLatency;
        assert_eq!(found(&[(latency, 150.0, -20.0)]), None);
        assert_eq!(found(&[(latency, 150.0, 0.5)]), Some(latency));
        assert_eq!(found(&[(ground, 60.0, 15.0)]), Some(ground));
        // Another that explains a part of it leaves open which of the two acts.
        assert_eq!(found(&[(ground, 150.0, 30.0), (lag, 30.0, 0.0)]), None);
        // Unless it makes the flights held out less likely.
        assert_eq!(found(&[(ground, 150.0, 30.0), (lag, 30.0, -5.0)]), Some(ground));
        assert_eq!(found(&[]), None);
    }
}
