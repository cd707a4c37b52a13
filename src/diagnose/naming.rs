//! From the outcome of a search to named effects: probabilities, intervals, what cannot be told
//! apart, and what the logs cannot show.

use std::collections::BTreeMap;

use sitl::effects::EffectId;

use super::answer::{EffectAnswer, NotTestable, parameters};
use super::fit::Z90;
use super::hypothesis::{Catalogue, Hypothesis, Target};
use super::law::is_itself;
use super::misfit::{Misfit, share_left};
use super::scored::Scored;
use super::selection::{Rival, Selection, TESTABLE, Thresholds};

/// Log odds that what explains flights is also their cause, where nothing is left, and by how much
/// they fall with the share that is left. By the answers of exams in which every eighth cause was
/// none of the catalogue's and every tenth followed another law.
const LOG_ODDS: f64 = 2.7;
const LOG_ODDS_BY_SHARE: f64 = 8.0;
/// The same by how far the gap stays open: from this multiple of the noise on, per unit, up to a
/// bound. In two exams 93 % were right of those named below 1.2, 19 of 25 from there to 1.3, 3 of 5
/// above 1.4.
const OPEN_FROM: f64 = 1.1;
const LOG_ODDS_BY_GAP: f64 = 8.0;
const OPEN_TO: f64 = 1.4;
/// Differences of scores count by this share: channels share noise that the scores take to be
/// independent.
pub(super) const TEMPER: f64 = 0.25;
/// Least probability of an effect that the answer mentions.
const MENTIONED: f64 = 0.01;
/// Least probability of a rival that cannot be told apart.
const AMBIGUOUS: f64 = 0.1;

/// Probability that what explains the flights is their cause, by what it leaves: the catalogue
/// itself may lack the cause, and another effect stand in for it. `open`: what of the gap stays
/// open on the flights held out, in units of the noise, where that is known.
pub(super) fn credence(misfits: &[Misfit], open: Option<f64>) -> f64 {
    let open = open.map_or(0.0, |open| open.clamp(OPEN_FROM, OPEN_TO) - OPEN_FROM);
    let log_odds = LOG_ODDS - LOG_ODDS_BY_SHARE * share_left(misfits) - LOG_ODDS_BY_GAP * open;
    1.0 / (1.0 + (-log_odds).exp())
}

/// The place in the chosen set of an effect whose numbers, freed of what a fit is off by itself,
/// may all be those of the vehicle file, or lack a part without which it is another: of several the
/// one that the set needs least. Two that trade off against one another scatter alike.
pub(super) fn idle(selection: &Selection, catalogue: &Catalogue) -> Option<usize> {
    let fit = &selection.best.fit;
    let may_be_the_files = |number: &usize| {
        let off = fit.values[*number] - catalogue.numbers[*number].reference;
        off.abs() < Z90 * fit.deviation[*number]
    };
    let is_idle = |hypothesis: usize| {
        let Hypothesis { effect, numbers, .. } = &catalogue.hypotheses[hypothesis];
        !is_itself(catalogue, fit, *effect) || numbers.iter().all(may_be_the_files)
    };
    let without = |place: &usize| selection.places[*place].0.score();
    (0..selection.places.len())
        .filter(|place| is_idle(fit.hypotheses[*place]))
        .max_by(|a, b| without(a).total_cmp(&without(b)))
}

/// The effects of the chosen set and their rivals, with probabilities, and those that cannot be
/// told apart. `credence`: the probability that the set holds the cause.
pub(super) fn named_effects(
    catalogue: &Catalogue,
    selection: &Selection,
    credence: f64,
) -> (Vec<EffectAnswer>, Vec<EffectId>) {
    let mut found: BTreeMap<EffectId, (f64, Scored)> = BTreeMap::new();
    let losses = losses(selection);
    let mut ambiguous = Vec::new();
    for (place, (without, rivals)) in selection.places.iter().enumerate() {
        let own = selection.best.fit.hypotheses[place];
        let mends = mends_a_law(catalogue, &losses, place);
        let credence = if mends { credence * MENDS_A_LAW } else { credence };
        let mut options: Vec<(Option<usize>, Scored)> = vec![(None, without.clone())];
        options.extend(
            rivals
                .iter()
                .filter(|rival| rival.hypothesis != own)
                .map(|Rival { hypothesis, scored }| (Some(*hypothesis), scored.clone())),
        );
        options.push((Some(own), selection.best.clone()));
        let top = options.iter().map(|(_, s)| s.score()).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> =
            options.iter().map(|(_, s)| (TEMPER * (s.score() - top)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        for ((hypothesis, scored), weight) in options.into_iter().zip(weights) {
            let Some(hypothesis) = hypothesis else { continue };
            let effect = catalogue.hypotheses[hypothesis].effect;
            let probability = credence * weight / sum;
            let own_effect = effect.class() == catalogue.hypotheses[own].effect.class();
            if weight / sum > AMBIGUOUS && !own_effect && !mends {
                // Either may come out first.
                ambiguous.extend([effect, catalogue.hypotheses[own].effect]);
            }
            let entry = found.entry(effect).or_insert((0.0, scored.clone()));
            entry.0 = (entry.0 + probability).min(1.0);
            if hypothesis == own || scored.score() > entry.1.score() {
                entry.1 = scored;
            }
        }
    }
    let mut answers: Vec<EffectAnswer> = found
        .into_iter()
        .filter(|(_, (probability, _))| *probability > MENTIONED)
        .map(|(effect, (probability, scored))| answer_of(catalogue, &scored, effect, probability))
        .collect();
    let effect = |hypothesis: usize| catalogue.hypotheses[hypothesis].effect;
    let loss = |answer: &EffectAnswer| {
        losses.iter().find(|(own, _)| effect(*own) == answer.id).map_or(0.0, |(_, loss)| *loss)
    };
    answers.sort_by(|a, b| {
        let certain = |answer: &EffectAnswer| answer.probability.min(credence);
        certain(b).total_cmp(&certain(a)).then(loss(b).total_cmp(&loss(a))).then(a.id.cmp(&b.id))
    });
    (answers, ambiguous)
}

/// An effect as its best fit alone has it, with a probability.
pub(super) fn single(
    catalogue: &Catalogue,
    selection: &Selection,
    effect: EffectId,
    probability: f64,
) -> Option<EffectAnswer> {
    let is_it = |rival: &&Rival| catalogue.hypotheses[rival.hypothesis].effect == effect;
    let Rival { scored, .. } = selection.singles.iter().find(is_it)?;
    Some(answer_of(catalogue, scored, effect, probability))
}

/// An effect with its numbers as a fit has them.
pub(super) fn answer_of(
    catalogue: &Catalogue,
    scored: &Scored,
    effect: EffectId,
    probability: f64,
) -> EffectAnswer {
    let set = catalogue.effects(&scored.fit.values, Some(&[effect]));
    EffectAnswer {
        id: effect,
        probability,
        parameters: parameters(&set, effect),
        intervals: intervals(catalogue, scored, effect),
    }
}

/// No law is right to more than this share of its evidence: an effect with less, beside another of
/// its family, may but mend that one's law. Where causes of exams followed other laws than the
/// catalogue's, what came along had 0.01 to 0.13 of the evidence; true second effects of a family
/// mostly had more.
const LAW_ERROR: f64 = 0.15;
/// Families of effects: through the thrust, and in how the body answers moments.
const FAMILIES: [&[EffectId]; 2] = [
    &[
        EffectId::ThrustScale,
        EffectId::Mass,
        EffectId::ThrustCurve,
        EffectId::BatterySag,
        EffectId::MotorLag,
        EffectId::GroundEffect,
        EffectId::RotorLoss,
        EffectId::TranslationalLift,
    ],
    &[EffectId::MotorLag, EffectId::Inertia, EffectId::RotorGyroscopic, EffectId::BladeFlapping],
];
/// Share of its probability that such an effect keeps.
const MENDS_A_LAW: f64 = 0.45;

/// The hypotheses of the chosen set, and how much its score would lose without each, nats.
pub(super) fn losses(selection: &Selection) -> Vec<(usize, f64)> {
    let chosen = selection.best.fit.hypotheses.iter().zip(&selection.places);
    chosen.map(|(h, (without, _))| (*h, selection.best.score() - without.score())).collect()
}

/// Whether the effect at a place of the set may only mend the law of another.
pub(super) fn mends_a_law(catalogue: &Catalogue, losses: &[(usize, f64)], place: usize) -> bool {
    let effect = |hypothesis: usize| catalogue.hypotheses[hypothesis].effect;
    let (own, loss) = losses[place];
    let is_kin = |other: usize| {
        FAMILIES.iter().any(|of| of.contains(&effect(own)) && of.contains(&effect(other)))
    };
    let beside = losses.iter().filter(|(other, _)| *other != own && is_kin(*other));
    loss < LAW_ERROR * beside.map(|(_, loss)| *loss).fold(0.0, f64::max)
}

/// What changes the level of the thrust: near one throttle only a pack's voltage that falls
/// tells them apart.
pub(super) const THRUST_LEVEL: [EffectId; 3] =
    [EffectId::BatterySag, EffectId::ThrustCurve, EffectId::ThrustScale];

/// Share of its probability that what is named keeps beside what would do as well: where nothing
/// tells them apart, and where it has the better of it. In four exams it was right 14 of 19 times
/// in the latter case.
pub(super) const UNTOLD_SHARE: f64 = 0.6;
pub(super) const BETTER_SHARE: f64 = 0.8;

/// What tilts a hover at one heading: without an accelerometer only other headings tell them apart.
pub(super) const TILTS: [EffectId; 2] = [EffectId::Wind, EffectId::AttitudeTrim];

/// Share of the evidence of what is named alone from which on its rival is one, where the flights
/// hold nothing that is made to tell them apart: what does so is then a model's small print.
const RIVALS: f64 = 0.5;

/// The effect that tilts a hover as the one does that is named alone, and explains enough of it.
pub(super) fn tilt_in_place_of(catalogue: &Catalogue, selection: &Selection) -> Option<EffectId> {
    let [named] = selection.best.fit.hypotheses[..] else { return None };
    let effect = |hypothesis: usize| catalogue.hypotheses[hypothesis].effect;
    let other = match TILTS.map(|tilt| tilt == effect(named)) {
        [true, _] => TILTS[1],
        [_, true] => TILTS[0],
        _ => return None,
    };
    let evidence = |of: EffectId| {
        let rival = selection.singles.iter().find(|rival| effect(rival.hypothesis) == of)?;
        Some(rival.scored.evidence - selection.null.evidence)
    };
    (evidence(other)? > RIVALS * evidence(effect(named))?).then_some(other)
}

/// Takes off a `family` what it does not keep of its probabilities beside `others`, which would do as
/// well and get what the first gives. The answers stay in order, the most probable first.
pub(super) fn share(
    answers: &mut Vec<EffectAnswer>,
    catalogue: &Catalogue,
    selection: &Selection,
    (family, kept): (&[EffectId], f64),
    others: &[EffectId],
) {
    if others.is_empty() {
        return;
    }
    let mut most: f64 = 0.0;
    for answer in answers.iter_mut().filter(|answer| family.contains(&answer.id.class())) {
        most = most.max(answer.probability);
        answer.probability *= kept;
    }
    let given = (1.0 - kept) * most / others.len() as f64;
    for effect in others {
        if let Some(answer) = answers.iter_mut().find(|answer| answer.id == *effect) {
            answer.probability += given;
        } else if let Some(answer) = single(catalogue, selection, *effect, given) {
            answers.push(answer);
        }
    }
    answers.sort_by(|a, b| b.probability.total_cmp(&a.probability));
}

/// Share of the evidence of the best single effect with which another explains as much: on real
/// flights no model is exact, and nats beyond that are of other things; more so where no on-board
/// law is known, by which twins of the explanation could be flown to check it. Of 495 causes of a
/// round trip 3 % had a rival beyond the former and 14 % beyond the latter.
pub(super) const AS_GOOD: f64 = 0.85;
const AS_GOOD_UNCHECKED: f64 = 2.0 / 3.0;

/// Effects that by themselves explain about as much as the one that is named alone.
pub(super) fn as_good(
    catalogue: &Catalogue,
    selection: &Selection,
    thresholds: &Thresholds,
    is_checked: bool,
) -> Vec<EffectId> {
    let share = if is_checked { AS_GOOD } else { AS_GOOD_UNCHECKED };
    let class = |h: usize| catalogue.hypotheses[h].effect.class();
    let evidence = |rival: &Rival| rival.scored.evidence - selection.null.evidence;
    let named: Vec<EffectId> = selection.best.fit.hypotheses.iter().map(|h| class(*h)).collect();
    let own = selection.singles.iter().filter(|rival| named.contains(&class(rival.hypothesis)));
    let most = own.map(evidence).fold(0.0, f64::max);
    let others = selection
        .singles
        .iter()
        .filter(|rival| !named.contains(&class(rival.hypothesis)))
        .filter(|rival| rival.scored.predicts_as_well_as(&selection.null))
        .filter(|rival| most > 0.0 && evidence(rival) > share * most)
        .filter(|rival| evidence(rival) > thresholds.asked_of(rival.hypothesis))
        .map(|rival| catalogue.hypotheses[rival.hypothesis].effect);
    let mut found: Vec<EffectId> = Vec::new();
    for other in others {
        if found.iter().all(|found| found.class() != other.class()) {
            found.push(other);
        }
    }
    found
}

/// The name of a number within its effect: of its parameter, and the component where it has
/// several.
pub(super) fn parameter_name(target: Target) -> String {
    match target {
        Target::Effect(id, slot) => match id.spec().slots().find(|s| s.index == slot) {
            Some(slot) if slot.parameter.kind.slots() > 1 => {
                format!("{}[{}]", slot.parameter.name, slot.component)
            }
            Some(slot) => slot.parameter.name.to_owned(),
            None => slot.to_string(),
        },
        Target::RotorScale(_) => "scale".to_owned(),
        Target::OutputDelay => "delay_s".to_owned(),
        Target::RotorGain(rotor) => format!("thrust of rotor {rotor}"),
        Target::Damping(axis) => format!("damping of the rate[{axis}]"),
    }
}

/// The same with its effect before it, where it is an effect's.
pub(super) fn parameter(target: Target) -> String {
    let name = parameter_name(target);
    match target {
        Target::Effect(id, _) => format!("{} {name}", id.name()),
        Target::OutputDelay => "delay of the outputs".to_owned(),
        _ => name,
    }
}

/// 90 % intervals of an effect's fitted numbers.
fn intervals(
    catalogue: &Catalogue,
    scored: &Scored,
    effect: EffectId,
) -> BTreeMap<String, [f64; 2]> {
    let mut intervals = BTreeMap::new();
    for hypothesis in &scored.fit.hypotheses {
        let hypothesis = &catalogue.hypotheses[*hypothesis];
        if hypothesis.effect != effect {
            continue;
        }
        for number in &hypothesis.numbers {
            let name = parameter_name(catalogue.numbers[*number].target);
            let (value, deviation) = (scored.fit.values[*number], scored.fit.deviation[*number]);
            intervals.insert(name, [value - Z90 * deviation, value + Z90 * deviation]);
        }
    }
    intervals
}

/// Effects that could not have been told from these logs, and why.
pub(super) fn not_testable(
    catalogue: &Catalogue,
    selection: &Selection,
    leg: bool,
) -> Vec<NotTestable> {
    let mut found = Vec::new();
    for effect in EffectId::ALL {
        let reason = if effect == EffectId::PdGain && !leg {
            Some("setpoints or the on-board law's gains are not known".to_owned())
        } else if effect == EffectId::RotorGyroscopic && catalogue.vehicle.rotor_max_rpm.is_none() {
            Some("the vehicle file has no rotor_max_rpm".to_owned())
        } else {
            let tried: Vec<&Rival> = selection
                .singles
                .iter()
                .filter(|rival| catalogue.hypotheses[rival.hypothesis].effect == effect)
                .collect();
            let seen = tried.iter().any(|rival| {
                catalogue.hypotheses[rival.hypothesis].numbers.iter().any(|number| {
                    rival.scored.fit.deviation[*number]
                        < TESTABLE * catalogue.numbers[*number].magnitude
                })
            });
            (!tried.is_empty() && !seen)
                .then(|| "the motion and the channels of these logs do not show it".to_owned())
        };
        if let Some(reason) = reason {
            found.push(NotTestable { id: effect, reason });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::answer::NAMED;
    use super::*;

    #[test]
    fn an_explanation_that_leaves_the_gap_open_is_less_credible() {
        let closed = credence(&[], Some(1.0));
        assert_eq!(closed, credence(&[], None));
        let open = credence(&[], Some(1.25));
        assert!(0.7 < open && open < closed);
        // Far off, something acts all the same: which effect it is must be told by its rivals.
        assert!(credence(&[], Some(5.0)) > NAMED);
    }

    #[test]
    fn an_effect_that_may_be_what_the_file_says_is_idle() {
        let vehicle = include_str!("../../config/vehicles/quad1200.toml");
        let vehicle = sitl::vehicle::VehicleParams::from_toml_str(vehicle).unwrap();
        let catalogue = Catalogue::new(&vehicle, true);
        let hypothesis =
            |id: EffectId| catalogue.hypotheses.iter().position(|h| h.effect == id).unwrap();
        let [inertia, drag] = [EffectId::Inertia, EffectId::RotorDrag].map(hypothesis);
        let first = catalogue.hypotheses[inertia].numbers[0];
        let idle_beside = |off: f64, drag_off: f64, without: [f64; 2]| {
            let mut best = Scored::of(vec![drag, inertia], 100.0, Vec::new());
            best.fit.values = catalogue.references();
            best.fit.deviation = vec![0.01; catalogue.numbers.len()];
            best.fit.values[catalogue.hypotheses[drag].numbers[0]] += drag_off;
            best.fit.values[first] += off;
            let null = Scored::of(Vec::new(), 0.0, Vec::new());
            let places =
                without.map(|evidence| (Scored::of(Vec::new(), evidence, Vec::new()), Vec::new()));
            let places = places.into();
            idle(&Selection { null, singles: Vec::new(), best, places }, &catalogue)
        };
        assert_eq!(idle_beside(0.016, 0.5, [10.0, 90.0]), Some(1));
        // Where both may be, the one without which more is left to say goes.
        assert_eq!(idle_beside(0.016, 0.01, [10.0, 90.0]), Some(1));
        assert_eq!(idle_beside(0.016, 0.01, [90.0, 10.0]), Some(0));
        // One of its numbers is enough.
        assert_eq!(idle_beside(-0.017, 0.5, [10.0, 90.0]), None);
    }

    #[test]
    fn an_effect_without_the_part_that_is_its_own_is_idle() {
        let vehicle = include_str!("../../config/vehicles/quad1200.toml");
        let vehicle = sitl::vehicle::VehicleParams::from_toml_str(vehicle).unwrap();
        let catalogue = Catalogue::new(&vehicle, true);
        // The first number by `off`, known to `error`, in units of its magnitude; the others there.
        let idle = |effect: EffectId, off: f64, error: f64| {
            let found = |h: &Hypothesis| h.effect == effect;
            let hypothesis = catalogue.hypotheses.iter().position(found).unwrap();
            let mut best = Scored::of(vec![hypothesis], 100.0, Vec::new());
            best.fit.values = catalogue.references();
            best.fit.deviation = vec![0.0; catalogue.numbers.len()];
            let [part, others @ ..] = &catalogue.hypotheses[hypothesis].numbers[..] else {
                panic!("{effect} has no number")
            };
            others.iter().for_each(|n| best.fit.values[*n] += catalogue.numbers[*n].magnitude);
            let magnitude = catalogue.numbers[*part].magnitude;
            best.fit.values[*part] += off * magnitude;
            best.fit.deviation[*part] = error * magnitude;
            let null = Scored::of(Vec::new(), 0.0, Vec::new());
            let places = vec![(null.clone(), Vec::new())];
            idle(&Selection { null, singles: Vec::new(), best, places }, &catalogue)
        };
        for effect in [EffectId::BladeFlapping, EffectId::RotorDrag] {
            assert_eq!(idle(effect, 0.1, 0.1), Some(0), "{effect}");
            assert_eq!(idle(effect, 0.2, 0.1), None, "{effect}");
            // Where these flights would not show it, it may have one.
            assert_eq!(idle(effect, 0.1, 1.0), None, "{effect}");
        }
        assert_eq!(idle(EffectId::AttitudeTrim, 0.1, 0.1), None);
        // A drag that the file has, of 0.28 kg/s, and the vehicle has not.
        assert_eq!(idle(EffectId::RotorDrag, -0.7, 0.1), None);
    }

    #[test]
    fn what_would_do_as_well_shares_the_probability_once() {
        let vehicle = include_str!("../../config/vehicles/quad1200.toml");
        let vehicle = sitl::vehicle::VehicleParams::from_toml_str(vehicle).unwrap();
        let catalogue = Catalogue::new(&vehicle, true);
        let rival = |(effect, evidence): (EffectId, f64)| {
            let found = |h: &Hypothesis| h.effect == effect;
            let hypothesis = catalogue.hypotheses.iter().position(found).unwrap();
            let mut scored = Scored::of(vec![hypothesis], evidence, Vec::new());
            scored.fit.values = catalogue.references();
            scored.fit.deviation = vec![0.0; catalogue.numbers.len()];
            Rival { hypothesis, scored }
        };
        let (sag, mass, scale) = (EffectId::BatterySag, EffectId::Mass, EffectId::ThrustScale);
        let singles = [(sag, 100.0), (mass, 95.0), (scale, 94.0), (EffectId::Wind, 50.0)];
        let singles: Vec<Rival> = singles.map(rival).into();
        let best = singles[0].scored.clone();
        let mut answers = vec![answer_of(&catalogue, &best, sag, 0.9)];
        let null = Scored::of(Vec::new(), 0.0, Vec::new());
        let selection = Selection { null, singles, best, places: Vec::new() };
        let others = as_good(&catalogue, &selection, &Thresholds::default(), true);
        assert_eq!(others, [mass]);
        share(&mut answers, &catalogue, &selection, (&[sag], BETTER_SHARE), &others);
        let shared: Vec<_> = answers.iter().map(|a| (a.id, a.probability)).collect();
        assert_eq!(shared[0].0, sag);
        assert!((shared[0].1 - 0.72).abs() < 1e-12 && (shared[1].1 - 0.18).abs() < 1e-12);
    }
}
