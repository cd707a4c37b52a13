//! The explanation that a verdict rests on: its effects of practical size, their probabilities and
//! their rivals.

use std::collections::{BTreeMap, BTreeSet};

use crate::diagnose::verdict::evidence::{Evidence, Explained};
use crate::diagnose::verdict::posterior::{Posterior, RIVAL_MASS_MIN, class};

/// Effects that act alike where some channel is missing, by class.
struct Alike {
    /// The named effects that it applies to.
    own: &'static [&'static str],
    /// The effects that act alike.
    effects: &'static [&'static str],
    are_separated: fn(&Evidence) -> bool,
}

const THRUST: &[&str] = &["battery_sag", "thrust_curve", "thrust_scale"];
const MOMENT: &[&str] = &["inertia", "pd_gain", "yaw_torque"];

/// Near one throttle, only a falling pack voltage separates effects on the thrust, and only motor
/// outputs separate effects on a moment. Only its moments separate a weak rotor from another level
/// of the thrust.
const ALIKE: [Alike; 3] = [
    Alike { own: THRUST, effects: THRUST, are_separated: |evidence| evidence.voltage_differs },
    Alike { own: MOMENT, effects: MOMENT, are_separated: |evidence| evidence.outputs_logged },
    Alike {
        own: &["rotor_loss"],
        effects: &["battery_sag", "rotor_loss", "thrust_curve", "thrust_scale"],
        are_separated: |evidence| evidence.turning[..2].iter().any(|axis| axis.is_usable),
    },
];
/// Share of its probability that an effect keeps when its class is not separated.
const UNSEPARATED_SHARE: f64 = 0.6;

/// The explanation that a verdict rests on.
pub(super) struct Leading<'a> {
    pub evidence: &'a Evidence,
    pub posterior: &'a Posterior<'a>,
    /// Index of the explanation.
    pub index: usize,
    pub explained: &'a Explained,
    /// Its effects of practical size.
    pub practical: Vec<&'a String>,
    /// Effects that the logs' channels do not separate from its own, these included.
    unseparated: Vec<&'static str>,
    /// Probability that each effect acts, by its class.
    inclusion: BTreeMap<&'a str, f64>,
}

impl<'a> Leading<'a> {
    pub fn new(
        evidence: &'a Evidence,
        posterior: &'a Posterior<'a>,
        index: usize,
        explained: &'a Explained,
    ) -> Self {
        let effects = &explained.effects;
        let is_own = |effect: &&str| effects.iter().any(|own| class(own) == *effect);
        let unseparated = ALIKE
            .iter()
            .filter(|alike| alike.own.iter().any(is_own) && !(alike.are_separated)(evidence))
            .flat_map(|alike| alike.effects)
            .copied()
            .collect();
        let practical = effects.iter().filter(|effect| explained.is_practical(effect)).collect();
        let inclusion = posterior.inclusion();
        Self { evidence, posterior, index, explained, practical, unseparated, inclusion }
    }

    /// Whether the file explains all of its effects: each is within the file's tolerance.
    pub fn is_within_tolerances(&self) -> bool {
        self.practical.is_empty() && !self.explained.effects.is_empty()
    }

    /// Effects that explain the flights as well as its own: those with mass in other explanations,
    /// and those that the channels do not separate from its own.
    pub fn rivals(&self) -> Vec<String> {
        let own: BTreeSet<&str> = self.explained.effects.iter().map(|e| class(e)).collect();
        let others = self.inclusion.iter().filter(|(effect, mass)| {
            !own.contains(*effect)
                && **mass > RIVAL_MASS_MIN
                && self.posterior.is_alternative(self.index, effect)
        });
        let mut rivals: Vec<String> = others.map(|(effect, _)| (*effect).to_owned()).collect();
        let alike = self.unseparated.iter().filter(|effect| !own.contains(*effect));
        rivals.extend(alike.map(|effect| (*effect).to_owned()));
        rivals.sort_unstable();
        rivals.dedup();
        rivals
    }

    /// Its practical effects with their probabilities, the most probable first, where the cause is
    /// outside the catalogue with probability `outside`.
    pub fn probabilities(&self, outside: f64) -> Vec<(String, f64)> {
        let probability = |effect: &&String| {
            let class = class(effect);
            let mass = self.inclusion.get(class).copied().unwrap_or(0.0);
            let kept = if self.unseparated.contains(&class) { UNSEPARATED_SHARE } else { 1.0 };
            ((*effect).clone(), kept * (1.0 - outside) * mass.min(1.0))
        };
        let mut all: Vec<(String, f64)> = self.practical.iter().map(probability).collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        all
    }
}
