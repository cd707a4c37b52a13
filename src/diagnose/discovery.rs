//! Discovery: searches for a formula that explains what the catalogue cannot.
//!
//! Terms of the [grammar](mod@terms) are numbers of the catalogue like any other. They are free
//! beside the vehicle file's numbers, in the same equations in weak form, with the same evidence.
//! They join one at a time, and each pays the price of the choice among all terms. Then each is
//! exchanged for any better one, and powers and lengths are refined. The result is one more
//! explanation, and the verdict treats it like the others.

pub mod law;
pub mod terms;

mod assessment;
mod description;

use rayon::prelude::*;
use vehicle::VehicleError;
use vehicle::effects::EffectSet;

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::term::{Factor, Term};
use crate::diagnose::context::DiagnosisContext;
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::discovery::terms::terms;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::flights::preparation::Channels;
use crate::diagnose::likelihood::fit::{Fit, fit_numbers};
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::explanations::Explanations;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::verdict::Decision;
use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::evidence::{Evidence, Gaps};
use crate::diagnose::verdict::posterior::{EVIDENCE_SHARE_MIN, OPEN_GAP, PREDICTION_SHARE_MIN};

/// Most terms of a law.
const TERMS_MAX: usize = 5;
/// Steps of the golden-section search for a shape; each keeps 0.62 of its range.
const SHAPE_STEPS: usize = 10;
/// Rounds in which every term may be exchanged.
const EXCHANGE_ROUNDS: usize = 2;

/// A law that was found.
pub(super) struct Discovered {
    /// The law as the answer describes it.
    pub answer: LawAnswer,
    /// The law and the effects that act beside it.
    pub effects: EffectSet,
}

/// Terms of a law beside the effects of an explanation.
#[derive(Clone)]
struct Draft {
    /// Indices of the hypotheses in the catalogue.
    beside: Vec<usize>,
    /// The terms with the widths of their priors.
    terms: Vec<(Term, f64)>,
    /// The fit to the flights for fitting.
    fit: Fit,
    /// Evidence lost by fitting the shapes, nats.
    shapes: f64,
    /// Standard deviations of the shapes.
    deviations: Vec<f64>,
    /// Evidence that each term adds to the others, nats.
    gains: Vec<f64>,
}

/// The gaps with a law, in units of the floor.
struct LawGaps {
    gaps: Gaps,
    /// The gap with the vehicle file's numbers, but without the law and the effects beside it.
    file: f64,
}

impl Draft {
    /// The catalogue with its terms, whose numbers come last.
    fn catalogue(&self, context: &DiagnosisContext<'_>) -> Catalogue {
        context.catalogue.with_terms(self.terms.clone())
    }

    /// The numbers with wide priors.
    fn active(&self, context: &DiagnosisContext<'_>) -> Vec<usize> {
        active(context.catalogue, &self.beside, self.terms.len())
    }
}

/// Numbers of hypotheses, and of terms, which follow the catalogue's own numbers.
fn active(catalogue: &Catalogue, beside: &[usize], terms: usize) -> Vec<usize> {
    let own = beside.iter().flat_map(|h| catalogue.hypotheses[*h].numbers.iter().copied());
    let first = catalogue.numbers.len();
    own.chain(first..first + terms).collect()
}

impl DiagnosisContext<'_> {
    /// The law that best explains the flights beside `found` and `evidence`; `None` where no term
    /// is worth its price.
    pub(super) fn discover(
        &self,
        found: &Explanations,
        evidence: &Evidence,
        decision: &Decision,
    ) -> Result<Option<Discovered>, DiagnoseError> {
        let library = terms(self.input.vehicle, self.channels());
        let price = (library.len() as f64).ln();
        let chosen = decision.explanation.checked_sub(1).and_then(|rank| found.sets.get(rank));
        let starts = std::iter::once(&found.file).chain(chosen);
        let best = found.best();
        let everything = self.simulator_of(best, &self.effects_of(best), true)?;
        let floor = |observed: &Observed<'_>| {
            let floor = everything.floor(observed.flights, &found.noise, self.settings.seed);
            floor.map(|floor| floor.errors)
        };
        let floors = [floor(&self.choosing), floor(&self.reported)];
        let floor_of_all = floor(&self.all);
        let mut drafts = Vec::new();
        for start in starts {
            let Some(draft) = self.draft(start, &library, price) else { continue };
            let draft = self.pruned(start, draft, floor_of_all.as_ref())?;
            let explanation = self.explanation(&draft, price);
            drafts.extend(explanation.map(|explanation| (draft, explanation)));
        }
        let best = drafts.into_iter().max_by(|a, b| a.1.score().total_cmp(&b.1.score()));
        let Some((draft, explanation)) = best else { return Ok(None) };
        self.assess(evidence, &floors, draft, &explanation).map(Some)
    }

    /// The channels that all logs hold.
    fn channels(&self) -> Channels {
        let all = |has: fn(&Channels) -> bool| self.input.fitted.iter().all(|f| has(&f.channels));
        Channels {
            velocity: all(|c| c.velocity),
            attitude: all(|c| c.attitude),
            body_rate: all(|c| c.body_rate),
            specific_force: all(|c| c.specific_force),
            outputs: all(|c| c.outputs),
            setpoint: all(|c| c.setpoint),
            voltage: all(|c| c.voltage),
            rotor_speed: all(|c| c.rotor_speed),
        }
    }

    /// Terms beside the effects of `start`, chosen on the flights for fitting.
    fn draft(&self, start: &Explanation, library: &[(Term, f64)], price: f64) -> Option<Draft> {
        let catalogue = self.catalogue.with_terms(library.to_vec());
        let observed = self.fitted.with_catalogue(&catalogue);
        let first = self.catalogue.numbers.len();
        let mut values = start.fit.values.clone();
        values.resize(catalogue.numbers.len(), 0.0);
        let numbers: Vec<usize> = (0..catalogue.numbers.len()).collect();
        let about = Linearised::new(&observed, &values, &numbers)?;
        let beside = start.fit.hypotheses.clone();
        let own = active(self.catalogue, &beside, 0);
        let evidence = |set: &[usize]| -> Option<f64> {
            let active: Vec<usize> =
                own.iter().copied().chain(set.iter().map(|t| first + t)).collect();
            Some(about.solve(&catalogue, observed.counts(), &active)?.evidence)
        };
        // The best term to add to a set, or to replace a removed one.
        let best_beside = |set: &[usize]| -> Option<(usize, f64)> {
            let others = (0..library.len()).into_par_iter().filter(|t| !set.contains(t));
            let with = others.filter_map(|term| {
                let joint: Vec<usize> = set.iter().copied().chain([term]).collect();
                Some((term, evidence(&joint)?))
            });
            with.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
        };
        let none = evidence(&[])?;
        let (mut set, mut now) = (Vec::new(), none);
        while set.len() < TERMS_MAX {
            let Some((term, with)) = best_beside(&set) else { break };
            // No law is exact to more than a share of its evidence, so a gain within that share is
            // no term.
            let least = price.max(Calibration::shipped().law * (now - none));
            if with - now < least {
                break;
            }
            set.push(term);
            now = with;
        }
        for _ in 0..EXCHANGE_ROUNDS {
            let before = now;
            for place in 0..set.len() {
                let mut others = set.clone();
                others.remove(place);
                if let Some((term, with)) = best_beside(&others)
                    && with > now
                {
                    others.insert(place, term);
                    (set, now) = (others, with);
                }
            }
            if now == before {
                break;
            }
        }
        if set.is_empty() {
            return None;
        }
        let terms = set.iter().map(|term| library[*term].clone()).collect();
        self.refined(start, terms)
    }

    /// Removes terms that change no prediction and carry little of the evidence, as the verdict
    /// does with effects. The predictions cover all flights except the held-out ones: the flight
    /// for choosing may not show what the others do.
    fn pruned(
        &self,
        start: &Explanation,
        mut draft: Draft,
        floor: Option<&Errors>,
    ) -> Result<Draft, DiagnoseError> {
        let square = |draft: &Draft| -> Result<Option<f64>, VehicleError> {
            let gaps = self.law_gaps(floor, &self.all, draft)?;
            Ok(gaps.map(|LawGaps { gaps, file }| {
                gaps.square() / (file * file - 1.0).max(2.0 * (OPEN_GAP * OPEN_GAP - 1.0))
            }))
        };
        while draft.terms.len() > 1 {
            let all = square(&draft)?;
            let total: f64 = draft.gains.iter().sum();
            let mut least: Option<(f64, Draft)> = None;
            for index in 0..draft.terms.len() {
                if draft.gains[index] > EVIDENCE_SHARE_MIN * total {
                    continue;
                }
                let mut terms = draft.terms.clone();
                terms.remove(index);
                let Some(less) = self.refined(start, terms) else { continue };
                let share = square(&less)?.zip(all).map_or(0.0, |(less, all)| less - all);
                if share < PREDICTION_SHARE_MIN
                    && least.as_ref().is_none_or(|(least, _)| share < *least)
                {
                    least = Some((share, less));
                }
            }
            match least {
                Some((_, less)) => draft = less,
                None => break,
            }
        }
        Ok(draft)
    }

    /// Refines the powers and lengths of the terms, and fits the result.
    fn refined(&self, start: &Explanation, mut terms: Vec<(Term, f64)>) -> Option<Draft> {
        let beside = &start.fit.hypotheses;
        let shaping = Shaping { context: self, start, about: self.nuisances(start)? };
        let (mut shapes, mut deviations) = (0.0, vec![0.0; terms.len()]);
        for index in 0..terms.len() {
            let Some((shape, [low, high])) = terms[index].0.factor.shape() else { continue };
            let unrefined = terms.clone();
            let with = |shape: f64| -> Option<f64> {
                let mut terms = unrefined.clone();
                terms[index].0.factor = terms[index].0.factor.shaped(shape);
                shaping.evidence(&terms)
            };
            let width = if shape < 1.0 { shape.abs().max(0.5) } else { 1.0 };
            let range = [(shape - width).max(low), (shape + width).min(high)];
            let Some((shape, top)) = golden_section_maximum(range, &with) else { continue };
            terms[index].0.factor = terms[index].0.factor.shaped(shape);
            // A fitted shape pays for the narrowing of its range, like any other number.
            let step = 0.02 * (high - low);
            let beside = with(shape - step).zip(with(shape + step));
            let bend = beside.map_or(0.0, |(a, b)| (2.0 * top - a - b) / (step * step));
            let deviation = if bend > 0.0 { bend.powf(-0.5) } else { high - low };
            let narrowed = (deviation * std::f64::consts::TAU.sqrt() / (high - low)).min(1.0).ln();
            // A plain factor needs no shape.
            let plain = |factor: Factor| -> Option<(f64, Factor)> {
                let mut terms = terms.clone();
                terms[index].0.factor = factor;
                Some((shaping.evidence(&terms)?, factor))
            };
            let simpler = match terms[index].0.factor {
                Factor::Power(quantity, _) => vec![Factor::One, Factor::Quantity(quantity)],
                _ => Vec::new(),
            };
            let simpler = simpler.into_iter().filter_map(plain).max_by(|a, b| a.0.total_cmp(&b.0));
            match simpler {
                Some((evidence, factor)) if evidence > top + narrowed => {
                    terms[index].0.factor = factor;
                }
                _ => {
                    shapes += narrowed;
                    deviations[index] = deviation;
                }
            }
        }
        let mut refined: Vec<_> = terms.into_iter().zip(deviations).collect();
        refined.dedup_by(|(a, _), (b, _)| a.0 == b.0);
        let (terms, deviations): (Vec<_>, Vec<_>) = refined.into_iter().unzip();
        let gains = (0..terms.len())
            .map(|index| {
                let mut less = terms.clone();
                less.remove(index);
                Some(shaping.evidence(&terms)? - shaping.evidence(&less)?)
            })
            .collect::<Option<Vec<f64>>>()?;
        let fit = self.fitted_terms(&self.fitted, &start.fit, beside, &terms)?;
        Some(Draft { beside: beside.clone(), terms, fit, shapes, deviations, gains })
    }

    /// Derivatives by all of the catalogue's numbers at an explanation's values.
    fn nuisances(&self, start: &Explanation) -> Option<Linearised> {
        let numbers: Vec<usize> = (0..self.catalogue.numbers.len()).collect();
        Linearised::new(&self.fitted, &start.fit.values, &numbers)
    }

    /// Fits terms beside hypotheses to flights without linearisation. The other numbers start at
    /// their values in `from`.
    fn fitted_terms(
        &self,
        flights: &Observed<'_>,
        from: &Fit,
        beside: &[usize],
        terms: &[(Term, f64)],
    ) -> Option<Fit> {
        let catalogue = self.catalogue.with_terms(terms.to_vec());
        let observed = flights.with_catalogue(&catalogue);
        let active = active(self.catalogue, beside, terms.len());
        let mut values = from.values.clone();
        values.resize(catalogue.numbers.len(), 0.0);
        let numbers: Vec<usize> = (0..catalogue.numbers.len()).collect();
        let about = Linearised::new(&observed, &values, &numbers)?;
        let linear = about.solve(&catalogue, observed.counts(), &active)?;
        let start = active.iter().map(|number| (*number, linear.values[*number])).collect();
        fit_numbers(&observed, &about, beside, &active, &[start])
    }

    /// A draft as an explanation, which pays the price of choosing its terms.
    fn explanation(&self, draft: &Draft, price: f64) -> Option<Explanation> {
        let catalogue = draft.catalogue(self);
        let [fitted, choosing] =
            [&self.fitted, &self.choosing].map(|observed| observed.with_catalogue(&catalogue));
        let chance = price * draft.terms.len() as f64 - draft.shapes;
        Explanation::new(draft.fit.clone(), chance, &fitted, &choosing)
    }
}

/// The evidence of terms in other shapes, with derivatives computed once.
struct Shaping<'a> {
    context: &'a DiagnosisContext<'a>,
    start: &'a Explanation,
    about: Linearised,
}

impl Shaping<'_> {
    /// Log evidence of terms beside the explanation, in the linearised problem, nats.
    fn evidence(&self, terms: &[(Term, f64)]) -> Option<f64> {
        let Self { context, start, about } = self;
        let catalogue = context.catalogue.with_terms(terms.to_vec());
        let observed = context.fitted.with_catalogue(&catalogue);
        let mut values = start.fit.values.clone();
        values.resize(catalogue.numbers.len(), 0.0);
        let base = observed.residuals(&values)?;
        let first = context.catalogue.numbers.len();
        let added: Vec<usize> = (first..catalogue.numbers.len()).collect();
        let columns = observed.columns(&values, &base, &added);
        let keep: Vec<usize> = (0..first).collect();
        let about = about.with(&observed, &values, &base, &keep, &columns);
        let active = active(context.catalogue, &start.fit.hypotheses, terms.len());
        Some(about.solve(&catalogue, observed.counts(), &active)?.evidence)
    }
}

/// The maximum of a function of one number and its position, by golden sections.
fn golden_section_maximum(range: [f64; 2], of: &dyn Fn(f64) -> Option<f64>) -> Option<(f64, f64)> {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let [mut low, mut high] = range;
    let mut a = (high - GOLDEN * (high - low), 0.0);
    let mut b = (low + GOLDEN * (high - low), 0.0);
    (a.1, b.1) = (of(a.0)?, of(b.0)?);
    for _ in 0..SHAPE_STEPS {
        if a.1 > b.1 {
            (high, b) = (b.0, a);
            a.0 = high - GOLDEN * (high - low);
            a.1 = of(a.0)?;
        } else {
            (low, a) = (a.0, b);
            b.0 = low + GOLDEN * (high - low);
            b.1 = of(b.0)?;
        }
    }
    Some(if a.1 > b.1 { a } else { b })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_section_search_finds_the_maximum() {
        let (at, top) =
            golden_section_maximum([-1.0, 3.0], &|x| Some(5.0 - (x - 1.3).powi(2))).unwrap();
        assert!((at - 1.3).abs() < 0.02 && (top - 5.0).abs() < 1e-3, "{at} {top}");
        assert!(golden_section_maximum([0.0, 1.0], &|_| None).is_none());
    }
}
