//! The posterior masses of the explanations, and which of them a verdict rests on.

use std::collections::{BTreeMap, BTreeSet};

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64Mcg;
use vehicle::effects::EffectId;

use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::evidence::{Evidence, Explained};

/// The price of an effect, nats: about forty may act, and one does in half of the cases.
pub(in crate::diagnose) const PRICE: f64 = 3.7;
/// Draws of the flights (Bayesian bootstrap over blocks) that masses are the mean over.
const DRAWS: usize = 400;
/// Share of what the file leaves open that an effect must close to change predictions.
pub(in crate::diagnose) const CHANGES: f64 = 0.12;
/// Or share of the evidence: the body rate shows a lag that is over before a position tells.
pub(in crate::diagnose) const CARRIES: f64 = 0.3;
/// Least evidence that counts, nats: odds of twenty thousand to one, for a model that is never
/// quite right.
const EVIDENCE: f64 = 10.0;
/// Least mass of an effect that would explain the flights as well as what is named.
pub(super) const RIVAL: f64 = 0.1;
/// A gap that is open, in units of what noise alone leaves, beyond four times its scatter.
pub(in crate::diagnose) const OPEN: f64 = 1.15;

/// Effects that act alike have one name here.
pub(super) fn class(effect: &str) -> &str {
    effect.parse::<EffectId>().map_or(effect, |id| id.class().name())
}

/// The evidence with the score and the posterior mass of each explanation.
pub(super) struct Posterior<'a> {
    evidence: &'a Evidence,
    scores: Vec<f64>,
    pub masses: Vec<f64>,
}

/// Posterior masses of the explanations: the mean over draws of the flights' blocks (pseudo-BMA+;
/// Yao, Vehtari, Simpson and Gelman 2018), each explanation's evidence off by what its law is not
/// exact, and by what chance gives it. What stands for something else has none.
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
    /// Of evidence, by a calibration.
    pub fn new(evidence: &'a Evidence, calibration: &Calibration) -> Self {
        let scores = evidence.scores();
        let masses = masses(evidence, calibration, &scores);
        Self { evidence, scores, masses }
    }

    fn explained(&self, index: usize) -> &Explained {
        &self.evidence.explanations[index]
    }

    /// The squared gap on the flights for choosing, at most as shipped: the file's numbers need not
    /// be off.
    fn chosen(&self, index: usize) -> Option<f64> {
        let own = self.explained(index).choosing_square()?;
        let shipped = self.evidence.shipped[0]?.powi(2);
        Some(if index == 0 { own.min(shipped) } else { own })
    }

    /// The same on the flights reported on.
    pub fn reported(&self, index: usize) -> Option<f64> {
        let own = self.explained(index).reported_square()?;
        let shipped = self.evidence.shipped[1]?.powi(2);
        Some(if index == 0 { own.min(shipped) } else { own })
    }

    /// The explanation of the most mass with these effects, or what acts as they do.
    fn of(&self, effects: &BTreeSet<&str>) -> Option<usize> {
        let is_it = |index: &usize| {
            let own = &self.explained(*index).effects;
            own.len() == effects.len() && own.iter().all(|own| effects.contains(class(own)))
        };
        let all = (0..self.masses.len()).filter(is_it);
        all.max_by(|a, b| self.masses[*a].total_cmp(&self.masses[*b]))
    }

    /// The share of what the file leaves open on the flights for choosing that the explanation
    /// `less` leaves more than `more`; of the evidence, where nothing is predicted.
    fn share(&self, more: usize, less: usize) -> f64 {
        match (self.chosen(0), self.chosen(more), self.chosen(less)) {
            (Some(file), Some(more), Some(less)) => {
                // Near the floor shares are large and say little.
                (less - more) / (file - 1.0).max(2.0 * (OPEN * OPEN - 1.0))
            }
            _ => self.evidence_share(more, less),
        }
    }

    /// The share of the evidence for `more` that `less` lacks.
    fn evidence_share(&self, more: usize, less: usize) -> f64 {
        let gain = self.scores[more] - self.scores[less];
        if gain > EVIDENCE { gain / self.scores[more] } else { 0.0 }
    }

    /// The explanation of the most mass without effects that change no prediction.
    pub fn best(&self) -> usize {
        let by_mass = |a: &usize, b: &usize| self.masses[*a].total_cmp(&self.masses[*b]);
        let Some(likeliest) = (0..self.masses.len()).max_by(by_mass) else { return 0 };
        let best = self.without_idle(likeliest);
        if best == likeliest { best } else { self.best_part(likeliest, best) }
    }

    /// Of the parts of an explanation with as many effects as `best` the one that predicts the flights
    /// for choosing best.
    fn best_part(&self, whole: usize, best: usize) -> usize {
        let own: BTreeSet<&str> = self.explained(whole).effects.iter().map(|e| class(e)).collect();
        let count = self.explained(best).effects.len();
        let is_part = |index: &usize| {
            let explained = self.explained(*index);
            let is_predicted = explained.reported.is_some() || self.evidence.shipped[1].is_none();
            count > 0
                && explained.effects.len() == count
                && explained.effects.iter().all(|effect| own.contains(class(effect)))
                && is_predicted
                && !self.evidence.is_implausible(explained)
        };
        let parts = (0..self.masses.len()).filter(is_part);
        let left = parts.filter_map(|index| Some((index, self.chosen(index)?)));
        left.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(best, |(index, _)| index)
    }

    /// An explanation without effects that change no prediction.
    fn without_idle(&self, mut best: usize) -> usize {
        loop {
            let effects = &self.explained(best).effects;
            let without = |effect: &String| {
                let rest: BTreeSet<&str> =
                    effects.iter().filter(|other| *other != effect).map(|e| class(e)).collect();
                let less = self.of(&rest)?;
                let share = self.share(best, less);
                let carries = share > -CHANGES && self.evidence_share(best, less) > CARRIES;
                Some((if carries { share.max(CHANGES) } else { share }, less))
            };
            let least = effects.iter().filter_map(without).min_by(|a, b| a.0.total_cmp(&b.0));
            match least {
                Some((share, less)) if share < CHANGES => best = less,
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

    /// Whether an effect stands in the place of one of an explanation's, rather than beside it.
    pub fn is_in_place(&self, best: usize, effect: &str) -> bool {
        let own: BTreeSet<&str> = self.explained(best).effects.iter().map(|e| class(e)).collect();
        let with = self.evidence.explanations.iter().zip(&self.masses).filter(|(explained, _)| {
            explained.effects.iter().any(|other| class(other) == effect)
                && !own.iter().all(|own| explained.effects.iter().any(|o| class(o) == *own))
        });
        with.map(|(_, mass)| mass).sum::<f64>() > RIVAL
    }
}
