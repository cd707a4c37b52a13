//! The search: which sets of effects are worth a fit.
//!
//! Every hypothesis is screened in the linearised problem, and the best are fitted. Then come all
//! pairs of the best, since two effects may mask each other, and additions to the best set. The
//! search makes no judgement: every fitted set goes into the evidence.

pub(super) mod explanation;
pub mod explanations;
pub(super) mod rotation_prediction;
pub(super) mod scale;
pub mod twins;

use rayon::prelude::*;

use crate::diagnose::catalogue::hypothesis::{Catalogue, Hypothesis};
use crate::diagnose::likelihood::fit::{Fit, fit};
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::explanation::Explanation;

/// Most effects in a set.
const EFFECTS_MAX: usize = 3;
/// Hypotheses that are fitted in full after a screening: alone, and beside others.
const SURVIVORS: usize = 8;
const SURVIVORS_BESIDE: usize = 4;
/// Single hypotheses whose pairs are all fitted.
const PAIRED: usize = 5;
/// Least gain of evidence that justifies a fit, nats.
const GAIN_MIN: f64 = 1.0;
/// Most refits of the file's numbers, each with derivatives at the previous result.
const REFITS: usize = 3;

/// The flights to explain and the catalogue to explain them with.
#[derive(Debug)]
pub struct Search<'a> {
    /// Flights for fitting.
    pub fitted: &'a Observed<'a>,
    /// Flights for choosing.
    pub choosing: &'a Observed<'a>,
    /// The catalogue that the hypotheses come from.
    pub catalogue: &'a Catalogue,
    /// Evidence that chance gives each hypothesis, nats.
    pub chance: Vec<f64>,
}

impl<'a> Search<'a> {
    /// A search without evidence by chance and without separate flights for choosing.
    pub fn without_chance(fitted: &'a Observed<'a>, catalogue: &'a Catalogue) -> Self {
        Self { fitted, choosing: fitted, catalogue, chance: Vec::new() }
    }

    /// Indices of all numbers of the catalogue.
    pub(in crate::diagnose) fn numbers(&self) -> Vec<usize> {
        (0..self.catalogue.numbers.len()).collect()
    }

    fn hypothesis(&self, index: usize) -> &Hypothesis {
        &self.catalogue.hypotheses[index]
    }

    /// The explanation of a fit, less the evidence that chance gives its hypotheses.
    fn explanation(&self, fit: Fit) -> Option<Explanation> {
        let chance = fit.hypotheses.iter().map(|h| self.chance.get(*h).copied().unwrap_or(0.0));
        let chance = chance.sum();
        Explanation::new(fit, chance, self.fitted, self.choosing)
    }

    /// The fit of the vehicle file's numbers within their tolerances, and the derivatives there.
    pub fn file(&self) -> Option<(Explanation, Linearised)> {
        let nuisances: Vec<usize> = self.catalogue.nuisances().collect();
        let refitted = |values: &[f64]| {
            let about = Linearised::new(self.fitted, values, &nuisances)?;
            fit(self.fitted, &about, &[], &[])
        };
        let mut best = refitted(&self.catalogue.expected())?;
        // A fit stops short where derivatives change far from its start, and any effect would then
        // seem to explain the rest.
        for _ in 0..REFITS {
            let again = refitted(&best.values)?;
            if best.cost - again.cost < GAIN_MIN {
                break;
            }
            best = again;
        }
        let about = Linearised::new(self.fitted, &best.values, &self.numbers())?;
        Some((self.explanation(best)?, about))
    }

    /// The sums of squares in each bin that the file's numbers leave with each hypothesis that adds
    /// evidence, in the linearised problem; that with the most evidence first.
    pub fn powers<'b>(&'b self, about: &'b Linearised) -> impl Iterator<Item = Vec<f64>> + 'b {
        let screened = self.screen(about, &[]).into_iter();
        let gaining = screened.take_while(|(_, gain)| *gain > GAIN_MIN);
        gaining.filter_map(|(h, _)| {
            let numbers = &self.hypothesis(h).numbers;
            Some(about.solve(self.catalogue, self.fitted.counts(), numbers)?.power)
        })
    }

    /// The hypotheses with the evidence that each adds to `set` in the linearised problem, the best
    /// first.
    pub fn screen(&self, about: &Linearised, set: &[usize]) -> Vec<(usize, f64)> {
        let counts = self.fitted.counts();
        let numbers = |set: &[usize]| -> Vec<usize> {
            set.iter().flat_map(|h| self.hypothesis(*h).numbers.iter().copied()).collect()
        };
        let Some(base) = about.solve(self.catalogue, counts, &numbers(set)) else {
            return Vec::new();
        };
        let mut gains: Vec<(usize, f64)> = (0..self.catalogue.hypotheses.len())
            .into_par_iter()
            .filter(|h| self.joins(*h, set))
            .filter_map(|h| {
                let mut joint = set.to_vec();
                joint.push(h);
                let joint = numbers(&joint);
                let solution = about.solve_from(self.catalogue, counts, &joint, &base.values)?;
                Some((h, solution.evidence - base.evidence))
            })
            .collect();
        gains.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        gains
    }

    /// Whether a hypothesis can join a set: effects that act alike occur once, such as mass and
    /// thrust_scale.
    pub(in crate::diagnose) fn joins(&self, hypothesis: usize, set: &[usize]) -> bool {
        let class = |h: usize| self.hypothesis(h).effect.class();
        set.iter().all(|h| class(*h) != class(hypothesis))
    }

    /// As [`fitted_from`](Self::fitted_from), as an explanation.
    fn fit_of(
        &self,
        about: &Linearised,
        set: &[usize],
        from: &[(usize, f64)],
    ) -> Option<Explanation> {
        self.explanation(self.fitted_from(about, set, from)?)
    }

    /// Fits a set. The active numbers start at their values in `from`; the newest hypothesis also
    /// starts at each of its own starts.
    pub(in crate::diagnose) fn fitted_from(
        &self,
        about: &Linearised,
        set: &[usize],
        from: &[(usize, f64)],
    ) -> Option<Fit> {
        let newest = self.hypothesis(*set.last()?);
        let starts: Vec<Vec<(usize, f64)>> = newest
            .starts
            .iter()
            .cloned()
            .chain(std::iter::once(Vec::new()))
            .map(|mut start| {
                start.extend(from.iter().copied());
                start
            })
            .collect();
        fit(self.fitted, about, set, &starts)
    }

    /// The fitted numbers of an explanation's hypotheses, by their index.
    fn numbers_of(&self, explanation: &Explanation) -> Vec<(usize, f64)> {
        let active = explanation.fit.active(self.catalogue);
        active.into_iter().map(|number| (number, explanation.fit.values[number])).collect()
    }

    /// Fits of `set` with one more hypothesis each, the best first.
    fn additions(&self, about: &Linearised, set: &Explanation, count: usize) -> Vec<Explanation> {
        let from = self.numbers_of(set);
        let mut screened = self.screen(about, &set.fit.hypotheses);
        for (hypothesis, gain) in &mut screened {
            *gain -= self.chance.get(*hypothesis).copied().unwrap_or(0.0);
        }
        screened.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        // Alone, a hypothesis with several starts is always fitted: the linearisation may miss it.
        let is_worth_a_fit = |rank: usize, h: usize, gain: f64| {
            let is_alone = set.fit.hypotheses.is_empty();
            rank < count && gain > GAIN_MIN || is_alone && self.hypothesis(h).starts.len() > 1
        };
        let mut found: Vec<Explanation> = screened
            .into_par_iter()
            .enumerate()
            .filter(|(rank, (h, gain))| is_worth_a_fit(*rank, *h, *gain))
            .filter_map(|(_, (h, _))| {
                let mut joint = set.fit.hypotheses.clone();
                joint.push(h);
                self.fit_of(about, &joint, &from)
            })
            .collect();
        sort_by_score(&mut found);
        found
    }

    /// Fits of all pairs of the best single hypotheses.
    fn pairs(&self, about: &Linearised, singles: &[Explanation]) -> Vec<Explanation> {
        let top = &singles[..singles.len().min(PAIRED)];
        let pairs: Vec<(&Explanation, &Explanation)> = top
            .iter()
            .enumerate()
            .flat_map(|(i, a)| top[i + 1..].iter().map(move |b| (a, b)))
            .filter(|(a, b)| self.joins(b.fit.hypotheses[0], &a.fit.hypotheses))
            .collect();
        let fitted = pairs.into_par_iter().filter_map(|(a, b)| {
            let mut from = self.numbers_of(a);
            from.extend(self.numbers_of(b));
            self.fit_of(about, &[a.fit.hypotheses[0], b.fit.hypotheses[0]], &from)
        });
        fitted.collect()
    }

    /// Every set that is worth a fit, besides the file's numbers alone. `about` holds the
    /// derivatives there.
    pub fn explanations(&self, file: &Explanation, about: &Linearised) -> Vec<Explanation> {
        let singles = self.additions(about, file, SURVIVORS);
        let mut all = singles.clone();
        all.extend(self.pairs(about, &singles));
        for size in 1..EFFECTS_MAX {
            let of_size = all.iter().filter(|e| e.fit.hypotheses.len() == size);
            let Some(best) = of_size.max_by(|a, b| a.score().total_cmp(&b.score())).cloned() else {
                break;
            };
            let Some(about) = Linearised::new(self.fitted, &best.fit.values, &self.numbers())
            else {
                break;
            };
            let set = |e: &Explanation| {
                let mut set = e.fit.hypotheses.clone();
                set.sort_unstable();
                set
            };
            for more in self.additions(&about, &best, SURVIVORS_BESIDE) {
                match all.iter_mut().find(|old| set(old) == set(&more)) {
                    Some(old) if old.score() < more.score() => *old = more,
                    Some(_) => {}
                    None => all.push(more),
                }
            }
        }
        sort_by_score(&mut all);
        all
    }
}

/// Sorts by score, the best first.
fn sort_by_score(explanations: &mut [Explanation]) {
    explanations.sort_by(|a, b| {
        b.score().total_cmp(&a.score()).then(a.fit.hypotheses.cmp(&b.fit.hypotheses))
    });
}
