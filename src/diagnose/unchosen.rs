//! Effects that the search did not choose, or chose and could not vouch for, and that act all the
//! same.
//!
//! An effect is chosen if it explains what the equations leave and predicts flights better, beyond
//! chance. Two kinds of causes fail that and are told by what stays open. One acts by another law
//! than the catalogue's: it has all the evidence that there is, and its predictions are better here
//! and worse there; it may be chosen, and leave too much to be trusted. The other is a lag of the
//! rotors, for which the equations may put stamps of the outputs that are late by as much: no stamp
//! changes what setpoints bring about, and predictions tell.

use sitl::effects::{EffectId, EffectSet};

use super::gap::Errors;
use super::hypothesis::Catalogue;
use super::inquiry::{Inquiry, Judgement};
use super::judgement::{CLOSED_MIN, Unexplained, is_open};
use super::scored::Scored;
use super::search::Search;
use super::selection::{BEYOND_DOUBT, Rival, Selection, Thresholds, is_along_the_floor};

/// Share of the evidence of the effect that explains the most which others may have, for it to be
/// alone.
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
    /// The effect that acts where the gap stays open or doubt remains: beside none, or in place of
    /// itself.
    pub fn unchosen(&self, search: &Search, judgement: &Judgement) -> Option<Unchosen> {
        let is_open =
            matches!(judgement.because, Some(Unexplained::OpenGap | Unexplained::OpenOnOne));
        let is_unexplained = is_open || judgement.because == Some(Unexplained::Doubt);
        let Search { selection, thresholds, .. } = search;
        let effect = |hypothesis: usize| self.catalogue.hypotheses[hypothesis].effect;
        let chosen = &selection.best.fit.hypotheses;
        let replaces_none = |rival: &&Rival| {
            chosen.iter().all(|chosen| effect(*chosen).class() == effect(rival.hypothesis).class())
        };
        let effects = |rival: &Rival| {
            let named = effect(rival.hypothesis);
            self.catalogue.effects(&rival.scored.fit.values, Some(&[named]))
        };
        let named = |rival: &Rival, effects: EffectSet| Unchosen {
            effect: effect(rival.hypothesis),
            scored: rival.scored.clone(),
            effects,
        };
        let alone = alone(self.catalogue, selection, thresholds);
        let is_kept = |rival: &&Rival| Some(rival.hypothesis) != search.dropped;
        let alone = alone.filter(|rival| is_unexplained && is_kept(rival) && replaces_none(rival));
        if let Some(rival) = alone {
            let effects = Some(effects(rival)).filter(|effects| self.closes(search, effects));
            return Some(named(rival, effects.unwrap_or_default()));
        }
        let is_lag = |rival: &&Rival| effect(rival.hypothesis) == EffectId::MotorLag;
        let lag = selection.singles.iter().find(is_lag);
        let lag = lag.filter(|rival| is_open && replaces_none(rival))?;
        let effects = effects(lag);
        self.closes(search, &effects).then(|| named(lag, effects))
    }

    /// Whether `effects` close most of the gap over all flights, and leave none open on those held
    /// out.
    fn closes(&self, search: &Search, effects: &EffectSet) -> bool {
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
            let excess = |errors: &Errors| (errors.mean_over(&floor.errors) - 1.0).max(0.0);
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
    let others = selection.singles.iter().filter(|rival| class(rival) != class(first));
    let is_alone = others.map(evidence).fold(0.0, f64::max) < BESIDE_MAX * most;
    let (gain, error) = first.scored.gain_over(&selection.null);
    let is_sure = most > BEYOND_DOUBT || gain > CONFIRMED * error;
    let is_more = most > thresholds.asked_of(first.hypothesis);
    let is_it = is_alone && is_sure && is_more && is_along_the_floor(catalogue, &first.scored.fit);
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
        assert_eq!(found(&[(ground, 60.0, 15.0)]), Some(ground));
        // Another that explains a part of it leaves open which of the two acts.
        assert_eq!(found(&[(ground, 150.0, 30.0), (lag, 30.0, 0.0)]), None);
        assert_eq!(found(&[]), None);
    }
}
