//! Which effects: every hypothesis alone, then more at once, then without each.
//!
//! Forward selection is greedy and can be misled by two effects that mask one another, so that all
//! pairs of the best single ones are tried as well; what is no longer needed is dropped again. A
//! hypothesis is taken up only if it raises the evidence on the flights of the fit *and* the
//! density of the flights that were held out.

use rayon::prelude::*;
use sitl::effects::EffectId;

use super::fit::{Fit, Linearised, Observed, fit};
use super::hypothesis::{Catalogue, Hypothesis};

/// Most effects at once.
pub const EFFECTS_MAX: usize = 3;
/// Hypotheses that are fitted in full after a screening.
const SURVIVORS: usize = 8;
/// Least gain of evidence in the linearised problem that is worth a fit, nats.
const SCREENED_MIN: f64 = 2.0;
/// Single hypotheses whose pairs are all tried.
const PAIRED: usize = 4;

/// A fit with its score on the flights that were held out.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The fit.
    pub fit: Fit,
    /// Log density of each block held out, nats.
    pub density: Vec<f64>,
}

impl Scored {
    /// How much likelier it makes the flights held out than `other`: nats, and the standard error
    /// by the scatter between blocks.
    pub fn gain_over(&self, other: &Scored) -> (f64, f64) {
        let gains: Vec<f64> = self.density.iter().zip(&other.density).map(|(a, b)| a - b).collect();
        let n = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / n.max(1.0);
        let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        (mean * n, (variance * n).sqrt())
    }

    /// Evidence and held-out density together.
    pub fn score(&self) -> f64 {
        self.fit.evidence + self.density.iter().sum::<f64>()
    }
}

/// What is asked of a hypothesis before it is taken up.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Least gain of evidence, nats.
    pub evidence: f64,
    /// Least gain of held-out density, nats.
    pub held_out: f64,
}

/// How a hypothesis fared against the others in its place.
#[derive(Clone, Debug)]
pub struct Rival {
    /// Index of the hypothesis.
    pub hypothesis: usize,
    /// With the rest of the set.
    pub scored: Scored,
}

/// The outcome.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Nuisances alone.
    pub null: Scored,
    /// Each hypothesis alone, the best first.
    pub singles: Vec<Rival>,
    /// The chosen set; the null where nothing was chosen.
    pub best: Scored,
    /// For each hypothesis of the set: the set without it, and those that were tried in its place.
    pub places: Vec<(Scored, Vec<Rival>)>,
}

/// The search.
#[derive(Debug)]
pub struct Selector<'a> {
    /// Flights of the fit.
    pub fitted: &'a Observed<'a>,
    /// Flights held out.
    pub held_out: &'a Observed<'a>,
    /// The catalogue.
    pub catalogue: &'a Catalogue,
    /// What is asked.
    pub thresholds: Thresholds,
}

impl Selector<'_> {
    fn all_numbers(&self) -> Vec<usize> {
        (0..self.catalogue.numbers.len()).collect()
    }

    /// Scores a fit on what was held out.
    pub fn scored(&self, fit: Fit) -> Option<Scored> {
        let residuals = self.held_out.residuals(&fit.values)?;
        let noise = fit.noise(self.fitted.counts());
        let density = self.held_out.log_density(&residuals, &noise);
        Some(Scored { fit, density })
    }

    /// Nuisances alone, and the derivatives there.
    pub fn null(&self) -> Option<(Scored, Linearised)> {
        let numbers = self.all_numbers();
        let first = Linearised::new(self.fitted, &self.catalogue.references(), &numbers)?;
        let null = fit(self.fitted, &first, &[], &[])?;
        let about = Linearised::new(self.fitted, &null.values, &numbers)?;
        Some((self.scored(null)?, about))
    }

    /// The hypotheses by how much evidence each adds to `active` in the linearised problem, the
    /// best first.
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
                let solution = about.solve(self.catalogue, counts, &numbers(&joint))?;
                Some((h, solution.evidence - base.evidence))
            })
            .collect();
        gains.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        gains
    }

    fn hypothesis(&self, index: usize) -> &Hypothesis {
        &self.catalogue.hypotheses[index]
    }

    /// Whether a hypothesis can join a set: each effect once, and one of mass and thrust_scale.
    fn joins(&self, hypothesis: usize, set: &[usize]) -> bool {
        let class = |h: usize| match self.hypothesis(h).effect {
            EffectId::Mass => EffectId::ThrustScale,
            effect => effect,
        };
        set.iter().all(|h| class(*h) != class(hypothesis))
    }

    /// Fits a set in full. The active numbers start where `from` has them, and the newest
    /// hypothesis also at its own starts.
    fn fitted(&self, about: &Linearised, set: &[usize], from: &[(usize, f64)]) -> Option<Scored> {
        let newest = self.hypothesis(*set.last()?);
        let starts: Vec<Vec<(usize, f64)>> = newest
            .starts
            .iter()
            .map(|start| newest.numbers.iter().copied().zip(start.iter().copied()).collect())
            .chain(std::iter::once(Vec::new()))
            .map(|mut start: Vec<(usize, f64)>| {
                start.extend(from.iter().copied());
                start
            })
            .collect();
        self.scored(fit(self.fitted, about, set, &starts)?)
    }

    fn numbers_of(&self, scored: &Scored) -> Vec<(usize, f64)> {
        let set = scored.fit.hypotheses.iter();
        set.flat_map(|h| &self.hypothesis(*h).numbers)
            .map(|number| (*number, scored.fit.values[*number]))
            .collect()
    }

    /// Whether `more` is worth its additional effect.
    fn accepts(&self, more: &Scored, less: &Scored) -> bool {
        let (gain, _) = more.gain_over(less);
        more.fit.evidence - less.fit.evidence > self.thresholds.evidence
            && gain > self.thresholds.held_out
    }

    /// Hypotheses in addition to `set`, fitted together with it, the best first.
    fn additions(&self, about: &Linearised, set: &Scored, count: usize) -> Vec<Rival> {
        let from = self.numbers_of(set);
        let screened = self.screen(about, &set.fit.hypotheses);
        let mut rivals: Vec<Rival> = screened
            .into_par_iter()
            .enumerate()
            // Alone, what the linearisation may not see at all is fitted as well.
            .filter(|(rank, (h, gain))| {
                let starts = set.fit.hypotheses.is_empty() && self.hypothesis(*h).starts.len() > 1;
                *rank < count && *gain > SCREENED_MIN || starts
            })
            .filter_map(|(_, (h, _))| {
                let mut joint = set.fit.hypotheses.clone();
                joint.push(h);
                Some(Rival { hypothesis: h, scored: self.fitted(about, &joint, &from)? })
            })
            .collect();
        rivals.sort_by(|a, b| {
            b.scored.score().total_cmp(&a.scored.score()).then(a.hypothesis.cmp(&b.hypothesis))
        });
        rivals
    }

    /// The search from the null on.
    pub fn select(&self) -> Option<Selection> {
        let (null, about) = self.null()?;
        let singles = self.additions(&about, &null, SURVIVORS);
        let mut best = null.clone();
        if let Some(first) = singles.first()
            && self.accepts(&first.scored, &null)
        {
            best = first.scored.clone();
        }
        if !best.fit.hypotheses.is_empty() {
            for pair in self.pairs(&about, &singles) {
                if pair.score() > best.score() && self.accepts(&pair, &singles[0].scored) {
                    best = pair;
                }
            }
            while best.fit.hypotheses.len() < EFFECTS_MAX {
                let about = Linearised::new(self.fitted, &best.fit.values, &self.all_numbers())?;
                let more = self.additions(&about, &best, SURVIVORS / 2);
                match more.into_iter().next() {
                    Some(more) if self.accepts(&more.scored, &best) => best = more.scored,
                    _ => break,
                }
            }
        }
        let mut places = Vec::new();
        // Without each: what no longer pays goes, and the rest is looked at again.
        'pruned: loop {
            places.clear();
            for i in 0..best.fit.hypotheses.len() {
                let mut rest = best.fit.hypotheses.clone();
                rest.remove(i);
                let without = if rest.is_empty() {
                    null.clone()
                } else {
                    let from = self.numbers_of(&best);
                    self.fitted(&about, &rest, &from)?
                };
                if !self.accepts(&best, &without) {
                    best = without;
                    continue 'pruned;
                }
                let rivals = if rest.is_empty() {
                    singles.clone()
                } else {
                    let numbers = self.all_numbers();
                    let about = Linearised::new(self.fitted, &without.fit.values, &numbers)?;
                    self.additions(&about, &without, SURVIVORS / 2)
                };
                places.push((without, rivals));
            }
            break;
        }
        Some(Selection { null, singles, best, places })
    }

    /// All pairs of the best single hypotheses, fitted together.
    fn pairs(&self, about: &Linearised, singles: &[Rival]) -> Vec<Scored> {
        let top = &singles[..singles.len().min(PAIRED)];
        let pairs: Vec<(&Rival, &Rival)> = top
            .iter()
            .enumerate()
            .flat_map(|(i, a)| top[i + 1..].iter().map(move |b| (a, b)))
            .filter(|(a, b)| self.joins(a.hypothesis, &[b.hypothesis]))
            .collect();
        pairs
            .into_par_iter()
            .filter_map(|(a, b)| {
                let mut from = self.numbers_of(&a.scored);
                from.extend(self.numbers_of(&b.scored));
                self.fitted(about, &[a.hypothesis, b.hypothesis], &from)
            })
            .collect()
    }
}
impl Selector<'_> {
    pub fn debug(&self, s: &Selection) {
        use super::residuals::{CHANNELS, CHANNEL_NAMES};
        use super::spectrum::BANDS;
        let nb = BANDS.len();
        for (name, sc) in [("null", &s.null), ("single", &s.singles[0].scored), ("best", &s.best)] {
            let h = self.held_out.residuals(&sc.fit.values).unwrap();
            let hp = self.held_out.power(&h);
            let (tn, hn) = (self.fitted.counts(), self.held_out.counts());
            eprintln!("== {name} {:?}", sc.fit.hypotheses.iter().map(|h| self.catalogue.hypotheses[*h].effect.name()).collect::<Vec<_>>());
            for (i, n) in self.catalogue.numbers.iter().enumerate() {
                let off = sc.fit.values[i] - n.reference;
                if off.abs() > 1e-12 { eprintln!("   {:?} {:.5} off {:.5} ({:.2} tol) sd {:.5}", n.target, sc.fit.values[i], off, off / n.tolerance, sc.fit.deviation[i]); }
            }
            for c in 0..CHANNELS {
                let t: Vec<String> = (0..nb).map(|b| { let p = c * nb + b; format!("{:8.2e}/{:5.2}", (sc.fit.power[p] / tn[p]).sqrt(), ((hp[p] / hn[p]) / (sc.fit.power[p] / tn[p])).sqrt()) }).collect();
                eprintln!("   {:26} {}", CHANNEL_NAMES[c], t.join(" "));
            }
        }
    }
}
