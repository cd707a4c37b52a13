//! The posterior masses of the explanations, and the choice of one for the verdict.

use std::collections::{BTreeMap, BTreeSet};

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64Mcg;
use vehicle::effects::{EffectId, Need};

use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::evidence::{CHOOSING, EQUATION_SHARE_MIN, Evidence, Explained};

/// Price of an effect, nats: about forty could act, and in half of the cases one does.
pub(in crate::diagnose) const PRICE: f64 = 3.7;
/// Draws of the flights (Bayesian bootstrap over blocks) for the mean of the masses.
const DRAWS: usize = 400;
/// Share of the file's open gap that an effect must close to count as changing predictions.
pub(in crate::diagnose) const PREDICTION_SHARE_MIN: f64 = 0.12;
/// Or its share of the evidence: the body rate shows a lag that ends before it reaches the
/// position.
pub(in crate::diagnose) const EVIDENCE_SHARE_MIN: f64 = 0.3;
/// Least evidence that counts, nats: odds of twenty thousand to one, for a model that is never
/// quite right.
const EVIDENCE_MIN: f64 = 10.0;
/// Least mass of an effect that explains the flights as well as the named ones.
pub(super) const RIVAL_MASS_MIN: f64 = 0.1;
/// A healthy vehicle's predictions lie within this many times the noise.
pub(super) const HEALTHY_GAP: f64 = 1.3;
/// An open gap in units of the floor, beyond four times its scatter.
pub(in crate::diagnose) const OPEN_GAP: f64 = 1.15;

/// The common name of effects that act alike.
pub(super) fn class(effect: &str) -> &str {
    effect.parse::<EffectId>().map_or(effect, |id| id.class().name())
}

/// Whether only moments or stamps show the effect, on any flight. In a calm hover, feedback on the
/// sensors' noise looks like another inertia, and stamps that are a few milliseconds off like a
/// latency: with much evidence, and closing nothing.
fn must_close(effect: &str) -> bool {
    let is_of_kind = |need: &Need| matches!(need, Need::Moment | Need::Imu);
    effect.parse::<EffectId>().is_ok_and(|id| id.spec().needs.iter().any(is_of_kind))
}

/// The evidence with the score and the posterior mass of each explanation.
pub(super) struct Posterior<'a> {
    evidence: &'a Evidence,
    scores: Vec<f64>,
    pub masses: Vec<f64>,
}

/// Posterior masses of the explanations: the mean over draws of the flights' blocks (pseudo-BMA+;
/// Yao, Vehtari, Simpson and Gelman 2018). Each explanation's evidence errs by the inexactness of
/// its law and by chance. Implausible explanations get no mass.
fn masses(evidence: &Evidence, calibration: &Calibration, scores: &[f64]) -> Vec<f64> {
    let explanations = &evidence.explanations;
    let Some(file) = explanations.first() else { return Vec::new() };
    let count = evidence.fitted_blocks.min(file.blocks.len());
    let fitted = |explained: &Explained| -> Vec<f64> {
        let blocks = explained.blocks.iter().zip(&file.blocks).take(count);
        blocks.map(|(own, file)| own - file).collect()
    };
    let gains: Vec<Vec<f64>> = explanations.iter().map(fitted).collect();
    let implausible: Vec<bool> =
        explanations.iter().map(|explained| evidence.is_implausible(explained)).collect();
    let mut rng = Pcg64Mcg::seed_from_u64(0);
    let mut masses = vec![0.0; explanations.len()];
    for _ in 0..DRAWS {
        let weights: Vec<f64> = (0..count).map(|_| Exp1.sample(&mut rng)).collect();
        let mean = (weights.iter().sum::<f64>() / count.max(1) as f64).max(f64::MIN_POSITIVE);
        let draws: Vec<f64> = explanations
            .iter()
            .zip(&gains)
            .zip(scores)
            .zip(&implausible)
            .map(|(((explained, gains), score), is_implausible)| {
                let z: f64 = StandardNormal.sample(&mut rng);
                if *is_implausible {
                    return f64::NEG_INFINITY;
                }
                let predicted = score - gains.iter().sum::<f64>();
                let drawn: f64 = gains.iter().zip(&weights).map(|(g, w)| g * w / mean).sum();
                let off = (calibration.law * score.max(0.0)).hypot(explained.chance);
                drawn + predicted + z * off - PRICE * explained.effects.len() as f64
            })
            .collect();
        let top = draws.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let odds: Vec<f64> = draws.iter().map(|draw| (draw - top).exp()).collect();
        let total: f64 = odds.iter().sum();
        masses.iter_mut().zip(odds).for_each(|(mass, odds)| *mass += odds / total / DRAWS as f64);
    }
    masses
}

impl<'a> Posterior<'a> {
    /// Weighs the evidence with a calibration.
    pub fn new(evidence: &'a Evidence, calibration: &Calibration) -> Self {
        let scores = evidence.scores();
        let masses = masses(evidence, calibration, &scores);
        Self { evidence, scores, masses }
    }

    fn explained(&self, index: usize) -> &Explained {
        &self.evidence.explanations[index]
    }

    /// The effects of an explanation by the common names of those that act alike; a set has each
    /// once.
    fn classes(&self, index: usize) -> BTreeSet<&str> {
        self.explained(index).effects.iter().map(|effect| class(effect)).collect()
    }

    /// The squared gap on the flights for choosing. For the file it is at most the gap as shipped:
    /// its numbers need not be off.
    fn chosen(&self, index: usize) -> Option<f64> {
        let own = self.explained(index).choosing_square()?;
        let shipped = self.evidence.shipped[0]?.powi(2);
        Some(if index == 0 { own.min(shipped) } else { own })
    }

    /// The squared gap on the held-out flights, with the same limit.
    pub fn reported(&self, index: usize) -> Option<f64> {
        let own = self.explained(index).reported_square()?;
        let shipped = self.evidence.shipped[1]?.powi(2);
        Some(if index == 0 { own.min(shipped) } else { own })
    }

    /// The explanation with the most mass among those with these effects, or with ones that act
    /// alike.
    fn of(&self, effects: &BTreeSet<&str>) -> Option<usize> {
        let all = (0..self.masses.len()).filter(|index| self.classes(*index) == *effects);
        all.max_by(|a, b| self.masses[*a].total_cmp(&self.masses[*b]))
    }

    /// How much more `less` leaves open than `more` on the flights for choosing, as a share of the
    /// file's open gap. Where nothing is predicted, a share of the evidence.
    fn share(&self, more: usize, less: usize) -> f64 {
        match (self.chosen(0), self.chosen(more), self.chosen(less)) {
            (Some(file), Some(more), Some(less)) => {
                // Near the floor, shares are large and mean little.
                (less - more) / (file - 1.0).max(2.0 * (OPEN_GAP * OPEN_GAP - 1.0))
            }
            _ => self.evidence_share(more, less),
        }
    }

    /// The share of the evidence for `more` that `less` lacks.
    fn evidence_share(&self, more: usize, less: usize) -> f64 {
        let gain = self.scores[more] - self.scores[less];
        if gain > EVIDENCE_MIN { gain / self.scores[more] } else { 0.0 }
    }

    /// Whether `less` leaves a part of the gap open that `more` closes, on the flights for choosing.
    fn closes_a_part(&self, more: usize, less: usize) -> bool {
        let parts = |index: usize| self.explained(index).choosing.map(|gaps| gaps.parts);
        let Some((more, less)) = parts(more).zip(parts(less)) else { return true };
        less.iter().zip(more).any(|(less, more)| *less > HEALTHY_GAP * more.max(1.0))
    }

    /// Whether `more` closes an equation that `less` leaves open, on the flights for choosing.
    fn closes_an_equation(&self, more: usize, less: usize) -> bool {
        let [more, less] = [more, less].map(|index| self.explained(index));
        self.evidence.equation_share(more, less, CHOOSING) > EQUATION_SHARE_MIN
    }

    /// The explanation with the most mass, without effects that change no prediction.
    pub fn best(&self) -> usize {
        let by_mass = |a: &usize, b: &usize| self.masses[*a].total_cmp(&self.masses[*b]);
        let Some(likeliest) = (0..self.masses.len()).max_by(by_mass) else { return 0 };
        let mut best = self.without_negligible(likeliest);
        if best != likeliest {
            best = self.best_part(likeliest, best);
        }
        self.practical_twin(best).unwrap_or(best)
    }

    /// Where no effect of `best` is of practical size, the explanation with the highest score whose
    /// effects act like those of `best`, predict the held-out flights as well, and include one of
    /// practical size: a mass may be within its tolerance only because the thrust moved to the end
    /// of its own.
    fn practical_twin(&self, best: usize) -> Option<usize> {
        let is_practical = |index: usize| {
            let explained = self.explained(index);
            explained.effects.iter().any(|effect| explained.is_practical(effect))
        };
        if is_practical(best) {
            return None;
        }
        let (own, left) = (self.classes(best), self.reported(best)?);
        let is_twin = |index: &usize| {
            self.classes(*index) == own
                && is_practical(*index)
                && !self.evidence.is_implausible(self.explained(*index))
                && self
                    .reported(*index)
                    .is_some_and(|other| other < (1.0 + PREDICTION_SHARE_MIN) * left)
        };
        let twins = (0..self.masses.len()).filter(is_twin);
        twins.max_by(|a, b| self.scores[*a].total_cmp(&self.scores[*b]))
    }

    /// Among the parts of an explanation with as many effects as `best`, the one that best predicts
    /// the flights for choosing; `best` itself unless that one leaves a smaller gap by more than
    /// [`PREDICTION_SHARE_MIN`].
    fn best_part(&self, whole: usize, best: usize) -> usize {
        let own = self.classes(whole);
        let count = self.explained(best).effects.len();
        let is_part = |index: &usize| {
            let explained = self.explained(*index);
            let is_predicted = explained.reported.is_some() || self.evidence.shipped[1].is_none();
            explained.effects.len() == count
                && explained.effects.iter().all(|effect| own.contains(class(effect)))
                && is_predicted
                && !self.evidence.is_implausible(explained)
        };
        let parts = (0..self.masses.len()).filter(is_part);
        let left = parts.filter_map(|index| Some((index, self.chosen(index)?)));
        let least = left.min_by(|a, b| a.1.total_cmp(&b.1));
        let own_left = self.chosen(best).filter(|_| is_part(&best));
        let is_better =
            |left: f64| own_left.is_none_or(|own| left < (1.0 - PREDICTION_SHARE_MIN) * own);
        least.filter(|(_, left)| is_better(*left)).map_or(best, |(index, _)| index)
    }

    /// The explanation without its effects that change no prediction.
    fn without_negligible(&self, mut best: usize) -> usize {
        loop {
            let effects = &self.explained(best).effects;
            let without = |effect: &String| {
                let rest: BTreeSet<&str> =
                    effects.iter().filter(|other| *other != effect).map(|e| class(e)).collect();
                let less = self.of(&rest)?;
                let share = self.share(best, less);
                let is_predicting = share > -PREDICTION_SHARE_MIN
                    && (!must_close(effect) || self.closes_a_part(best, less));
                let is_carried = self.evidence_share(best, less) > EVIDENCE_SHARE_MIN
                    && (is_predicting || self.closes_an_equation(best, less));
                Some((if is_carried { share.max(PREDICTION_SHARE_MIN) } else { share }, less))
            };
            let least = effects.iter().filter_map(without).min_by(|a, b| a.0.total_cmp(&b.0));
            match least {
                Some((share, less)) if share < PREDICTION_SHARE_MIN => best = less,
                _ => return best,
            }
        }
    }

    /// Probability that each effect acts, by its class.
    pub fn inclusion(&self) -> BTreeMap<&str, f64> {
        let mut inclusion: BTreeMap<&str, f64> = BTreeMap::new();
        for (explained, mass) in self.evidence.explanations.iter().zip(&self.masses) {
            for effect in &explained.effects {
                *inclusion.entry(class(effect)).or_default() += mass;
            }
        }
        inclusion
    }

    /// Whether an effect replaces one of the explanation's effects rather than joining them.
    pub fn is_alternative(&self, best: usize, effect: &str) -> bool {
        let own = self.classes(best);
        let with = self.evidence.explanations.iter().zip(&self.masses).filter(|(explained, _)| {
            explained.effects.iter().any(|other| class(other) == effect)
                && !own.iter().all(|own| explained.effects.iter().any(|o| class(o) == *own))
        });
        with.map(|(_, mass)| mass).sum::<f64>() > RIVAL_MASS_MIN
    }
}
