//! Which effects: every hypothesis alone, then more at once, then without each.
//!
//! Forward selection is greedy and can be misled by two effects that mask one another, so that all
//! pairs of the best single ones are tried as well; what is no longer needed is dropped again. A
//! hypothesis is taken up only if it raises the evidence on the flights of the fit *and* the
//! density of the flights that were held out.

use rayon::prelude::*;
use sitl::effects::EffectId;

use super::fit::{Fit, fit};
use super::gap::{Errors, improvement};
use super::hypothesis::{Catalogue, Hypothesis};
use super::law::acts_by_its_law;
use super::linearised::Linearised;
use super::observed::Observed;
use super::open_loop::Simulator;
use super::scored::{Scored, Windows};

/// Most effects at once.
pub const EFFECTS_MAX: usize = 3;
/// Share of its prior's width that a number must be known to for its effect to be testable.
pub(super) const TESTABLE: f64 = 0.5;
/// Hypotheses that are fitted in full after a screening.
const SURVIVORS: usize = 8;
/// Least gain of evidence in the linearised problem that is worth a fit, nats.
const SCREENED_MIN: f64 = 2.0;
/// Of the best, so many are tried until one is taken up.
const TRIED: usize = 4;
/// Single hypotheses whose pairs are all tried.
const PAIRED: usize = 4;

/// The nuisances are fitted again, with derivatives where they ended, at most so often, and as long
/// as that gains so much, nats.
const NULL_REFITS: usize = 3;
const NULL_GAIN_MIN: f64 = 1.0;

/// Least gain of evidence that is asked of an effect, whatever the twins say: posterior odds of
/// twenty thousand to one, for a model that is never quite right, nats.
pub const EVIDENCE_MIN: f64 = 10.0;
/// Evidence from which on there is no doubt that something acts, nats, and the standard errors by
/// which predictions must then be better.
pub(super) const BEYOND_DOUBT: f64 = 100.0;
const DEVIATIONS_MIN: f64 = 1.2;

/// What an effect that lacks a part of its own may be: flapping that turns nothing a drag, an inertia
/// that is off about yaw alone the rotors' torque there.
const PLAINER: [(EffectId, EffectId); 2] =
    [(EffectId::BladeFlapping, EffectId::RotorDrag), (EffectId::Inertia, EffectId::YawTorque)];

/// What is asked of a hypothesis before it is taken up.
#[derive(Clone, Debug)]
pub struct Thresholds {
    /// Least gain of evidence beyond chance of each hypothesis, nats.
    pub asked: Vec<f64>,
    /// Evidence that chance gives each hypothesis, nats.
    pub chance: Vec<f64>,
    /// Least gain of held-out density, nats.
    pub held_out: f64,
    /// Least gain of the open loop, in squares of its floor, and in its standard errors.
    pub open_loop: [f64; 2],
}

impl Default for Thresholds {
    /// The least that is asked, for want of twins.
    fn default() -> Self {
        Self { asked: Vec::new(), chance: Vec::new(), held_out: 1.0, open_loop: [0.05, 2.5] }
    }
}

impl Thresholds {
    /// Evidence that is asked of a hypothesis beyond chance, nats.
    pub fn asked_of(&self, hypothesis: usize) -> f64 {
        self.asked.get(hypothesis).copied().unwrap_or(EVIDENCE_MIN)
    }
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
    /// Whether simulators are driven by setpoints.
    pub setpoint_leg: bool,
    /// What is asked.
    pub thresholds: Thresholds,
    /// The open loop's floor, where it has windows.
    pub floor: Option<Errors>,
}

impl Selector<'_> {
    fn all_numbers(&self) -> Vec<usize> {
        (0..self.catalogue.numbers.len()).collect()
    }

    /// Scores a fit on what was held out.
    pub fn scored(&self, fit: Fit) -> Option<Scored> {
        let residuals = self.held_out.residuals(&fit.values)?;
        let noise = fit.noise(self.fitted.counts());
        let mut density = self.held_out.log_density(&residuals, &noise);
        let of_one = |h: &usize| self.thresholds.chance.get(*h).copied().unwrap_or(0.0);
        let chance: f64 = fit.hypotheses.iter().map(of_one).sum();
        // What chance gives, it gives to every flight.
        let size = |observed: &Observed<'_>| observed.counts().iter().sum::<f64>().max(1.0);
        let of_block =
            chance * size(self.held_out) / size(self.fitted) / density.len().max(1) as f64;
        density.iter_mut().for_each(|density| *density -= of_block);
        let evidence = fit.evidence - chance;
        Some(Scored::new(fit, evidence, density))
    }

    /// Nuisances alone, and the derivatives there.
    pub fn null(&self) -> Option<(Scored, Linearised)> {
        let numbers = self.all_numbers();
        let first = Linearised::new(self.fitted, &self.catalogue.expected(), &numbers)?;
        let mut null = fit(self.fitted, &first, &[], &[])?;
        let mut about = Linearised::new(self.fitted, &null.values, &numbers)?;
        // Where derivatives far from the start are others, a fit stops short; what it lacks, any
        // effect would seem to explain.
        for _ in 0..NULL_REFITS {
            let again = fit(self.fitted, &about, &[], &[])?;
            if null.cost - again.cost < NULL_GAIN_MIN {
                break;
            }
            about = Linearised::new(self.fitted, &again.values, &numbers)?;
            null = again;
        }
        Some((self.scored(null)?, about))
    }

    /// The sum of squares that nuisances and the hypothesis with the most evidence leave at each
    /// place in the linearised problem.
    pub fn least_power(&self, about: &Linearised) -> Option<Vec<f64>> {
        let (best, _) = *self.screen(about, &[]).first()?;
        let numbers = &self.hypothesis(best).numbers;
        Some(about.solve(self.catalogue, self.fitted.counts(), numbers)?.power)
    }

    /// The hypotheses by how much evidence each adds to `set` in the linearised problem, the
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
                let joint = numbers(&joint);
                let solution = about.solve_from(self.catalogue, counts, &joint, &base.values)?;
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
        let class = |h: usize| self.hypothesis(h).effect.class();
        set.iter().all(|h| class(*h) != class(hypothesis))
    }

    /// Fits a set in full. The active numbers start where `from` has them, and the newest
    /// hypothesis also at its own starts.
    fn fit_of(&self, about: &Linearised, set: &[usize], from: &[(usize, f64)]) -> Option<Scored> {
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
        self.scored(fit(self.fitted, about, set, &starts)?)
    }

    fn numbers_of(&self, scored: &Scored) -> Vec<(usize, f64)> {
        let set = scored.fit.hypotheses.iter();
        set.flat_map(|h| &self.hypothesis(*h).numbers)
            .map(|number| (*number, scored.fit.values[*number]))
            .collect()
    }

    /// Whether `more` is worth its additional effect.
    pub(super) fn accepts(&self, more: &Scored, less: &Scored) -> bool {
        let (gain, error) = more.gain_over(less);
        // Without an open loop to judge by, the flights held out must be clear by themselves.
        let clear = self.floor.is_some() || gain > error;
        let added = more.fit.hypotheses.iter().filter(|h| !less.fit.hypotheses.contains(h));
        let asked = added.map(|h| self.thresholds.asked_of(*h)).fold(EVIDENCE_MIN, f64::max);
        let evidence = more.evidence - less.evidence;
        // Flights held out that do not go where it acts say nothing about what is beyond doubt.
        let silent = evidence > BEYOND_DOUBT && gain.abs() < error;
        evidence > asked
            && (gain > self.thresholds.held_out || silent)
            && clear
            && acts_by_its_law(self.catalogue, &more.fit)
            && self.predicts_better(more, less)
    }

    /// Whether the effects of `more` make better predictions than those of `less`, by an amount
    /// that matters: in at least one quantity and horizon, and in no mean worse.
    ///
    /// Beyond doubt, less is asked: what acts seldom, like a vortex ring, makes few windows better;
    /// and of two effects that mask one another neither does by itself where the other lies within
    /// its tolerance, so that the nuisances may count on both sides.
    fn predicts_better(&self, more: &Scored, less: &Scored) -> bool {
        let Some(floor) = &self.floor else { return true };
        let is_beyond_doubt = more.evidence - less.evidence > BEYOND_DOUBT;
        let [least, deviations] = self.thresholds.open_loop;
        let deviations = if is_beyond_doubt { DEVIATIONS_MIN } else { deviations };
        let better = |nuisances: bool| {
            let (before, after) = (self.windows(less, nuisances), self.windows(more, nuisances));
            let gains = improvement(before, after, floor);
            let clear = |[gain, error]: &[f64; 2]| *gain > least && *gain > deviations * error;
            let sum: f64 = gains[1..].iter().flatten().map(|[gain, _]| gain).sum();
            sum > 0.0 && gains.iter().flatten().any(clear)
        };
        better(false) || is_beyond_doubt && better(true)
    }

    /// Open-loop errors of a fit's effects, with its nuisances or without.
    fn windows<'s>(&self, scored: &'s Scored, nuisances: bool) -> &'s Windows {
        scored.windows(nuisances, || {
            let named: Vec<EffectId> =
                scored.fit.hypotheses.iter().map(|h| self.hypothesis(*h).effect).collect();
            let which = (!nuisances).then_some(named.as_slice());
            let effects = self.catalogue.effects(&scored.fit.values, which);
            Simulator::new(&self.catalogue.vehicle, &effects, self.setpoint_leg)
                .map(|simulator| {
                    let simulator = simulator.guided();
                    let mut windows = simulator.windows(self.fitted.flights);
                    windows.extend(simulator.windows(self.held_out.flights));
                    windows
                })
                .unwrap_or_default()
        })
    }

    /// Hypotheses in addition to `set`, fitted together with it, the best first.
    fn additions(&self, about: &Linearised, set: &Scored, count: usize) -> Vec<Rival> {
        let from = self.numbers_of(set);
        let mut screened = self.screen(about, &set.fit.hypotheses);
        for (hypothesis, gain) in &mut screened {
            *gain -= self.thresholds.chance.get(*hypothesis).copied().unwrap_or(0.0);
        }
        screened.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
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
                Some(Rival { hypothesis: h, scored: self.fit_of(about, &joint, &from)? })
            })
            .collect();
        rivals.sort_by(|a, b| {
            b.scored.score().total_cmp(&a.scored.score()).then(a.hypothesis.cmp(&b.hypothesis))
        });
        rivals
    }

    /// The search from the null on, with the derivatives there.
    pub fn select(&self, null: Scored, about: &Linearised) -> Option<Selection> {
        let singles = self.additions(about, &null, SURVIVORS);
        let mut best = null.clone();
        if let Some(first) =
            singles.iter().take(TRIED).find(|rival| self.accepts(&rival.scored, &null))
        {
            best = first.scored.clone();
        }
        if !best.fit.hypotheses.is_empty() {
            let single = best.clone();
            for pair in self.pairs(about, &singles) {
                if pair.score() > best.score() && self.accepts(&pair, &single) {
                    best = pair;
                }
            }
            while best.fit.hypotheses.len() < EFFECTS_MAX {
                let about = Linearised::new(self.fitted, &best.fit.values, &self.all_numbers())?;
                let more = self.additions(&about, &best, SURVIVORS / 2);
                let taken =
                    more.into_iter().take(TRIED).find(|more| self.accepts(&more.scored, &best));
                match taken {
                    Some(more) => best = more.scored,
                    None => break,
                }
            }
        }
        let selection = self.pruned(about, null, singles, best)?;
        Some(self.by_law(about, selection))
    }

    /// The selection without its effect number `index`; with its [`PLAINER`] cause in its place, if
    /// that explains enough as well.
    pub fn dropping(
        &self,
        about: &Linearised,
        Selection { null, singles, best, places }: &Selection,
        index: usize,
    ) -> Option<Selection> {
        let (less, rivals) = places.get(index)?;
        let effect = self.hypothesis(*best.fit.hypotheses.get(index)?).effect;
        let plainer = PLAINER.iter().find(|(of, _)| *of == effect).map(|(_, plainer)| *plainer);
        let is_plainer = |rival: &&Rival| Some(self.hypothesis(rival.hypothesis).effect) == plainer;
        let next = rivals.iter().find(is_plainer).map_or(less, |rival| &rival.scored);
        self.pruned(about, null.clone(), singles.clone(), next.clone())
    }

    /// The selection of a set without what does not pay, and the rivals of what does.
    fn pruned(
        &self,
        about: &Linearised,
        null: Scored,
        singles: Vec<Rival>,
        mut best: Scored,
    ) -> Option<Selection> {
        // Without each: what no longer pays goes, the least first.
        loop {
            let without: Vec<Scored> = (0..best.fit.hypotheses.len())
                .map(|i| self.without(about, &best, i, &null))
                .collect::<Option<_>>()?;
            let least = without
                .iter()
                .filter(|less| !self.accepts(&best, less))
                .max_by(|a, b| a.score().total_cmp(&b.score()));
            match least {
                Some(less) => best = less.clone(),
                None => {
                    let places = without
                        .into_iter()
                        .map(|less| {
                            let mut rivals = if less.fit.hypotheses.is_empty() {
                                singles.clone()
                            } else {
                                self.rivals(&less)?
                            };
                            // Who would not have been taken up is no rival, and neither is who
                            // stands beside the effect rather than in its place.
                            rivals.retain(|rival| {
                                rival.scored.fit.hypotheses != best.fit.hypotheses
                                    && self.accepts(&rival.scored, &less)
                                    && !self.stands_beside(about, rival, &best)
                            });
                            Some((less, rivals))
                        })
                        .collect::<Option<_>>()?;
                    return Some(Selection { null, singles, best, places });
                }
            }
        }
    }

    /// The set without its hypothesis number `index`, fitted again.
    fn without(
        &self,
        about: &Linearised,
        set: &Scored,
        index: usize,
        null: &Scored,
    ) -> Option<Scored> {
        let mut rest = set.fit.hypotheses.clone();
        rest.remove(index);
        if rest.is_empty() {
            return Some(null.clone());
        }
        let mut from = self.numbers_of(set);
        let kept =
            |number: &usize| rest.iter().any(|h| self.hypothesis(*h).numbers.contains(number));
        from.retain(|(number, _)| kept(number));
        self.fit_of(about, &rest, &from)
    }

    /// Whether the set's effect that `rival` is put in the place of is wanted beside it as well.
    fn stands_beside(&self, about: &Linearised, rival: &Rival, set: &Scored) -> bool {
        if !self.joins(rival.hypothesis, &set.fit.hypotheses) {
            return false;
        }
        let mut from = self.numbers_of(&rival.scored);
        from.extend(self.numbers_of(set));
        let mut joint = set.fit.hypotheses.clone();
        joint.push(rival.hypothesis);
        let together = self.fit_of(about, &joint, &from);
        together.is_some_and(|both| self.accepts(&both, &rival.scored))
    }

    /// Hypotheses in addition to a set.
    fn rivals(&self, set: &Scored) -> Option<Vec<Rival>> {
        let about = Linearised::new(self.fitted, &set.fit.values, &self.all_numbers())?;
        Some(self.additions(&about, set, SURVIVORS / 2))
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
                self.fit_of(about, &[a.hypothesis, b.hypothesis], &from)
            })
            .collect()
    }
}
