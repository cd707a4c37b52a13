//! Proposes the flight that separates rival explanations, or shows what these logs cannot.
//!
//! For each live hypothesis in turn, a vehicle of which it is true flies every manoeuvre of a
//! library in closed-loop simulation. Each hypothesis is then fitted to that flight alone, with
//! every nuisance free, so evidence that rivals can explain by other numbers does not count
//! (Atkinson and Fedorov's T-optimality). Old flights are not part of the fit: their wind and pack
//! differ from the new one's. The best manoeuvre has the largest worst-case evidence against a
//! rival. Among those with plenty of it, and with half of the best one's, the shortest wins.

mod live_hypothesis;
mod rehearsal;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

pub use self::live_hypothesis::{LiveHypothesis, OpenQuestions, typical};
use self::rehearsal::{Rehearsal, Rehearsals};
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::simulate::flight_simulator::NotSimulated;
use crate::plan::FlightEnvelope;
use crate::plan::manoeuvres::{Manoeuvre, Room, library};

/// Plenty of evidence against every rival, nats. It is far beyond the need in simulation, because
/// models are never quite right.
const AMPLE_EVIDENCE: f64 = 100.0;
/// A shorter manoeuvre wins with this share of the best one's evidence.
const COMPARABLE_SHARE: f64 = 0.5;
/// Share of the simulated evidence that counts: model errors are common to the channels.
const INDEPENDENT_SHARE: f64 = 0.25;
/// Least evidence for an effect to be visible, nats.
const VISIBLE_EVIDENCE_MIN: f64 = 20.0;

/// The constraints of a proposal.
#[derive(Clone, Copy, Debug)]
pub struct Proposal<'a> {
    /// The vehicle as shipped.
    pub vehicle: &'a VehicleParams,
    /// Whether the diagnosis compares the leg from setpoints to outputs.
    pub setpoint_leg: bool,
    /// Noise of the reported state.
    pub noise: ReportNoise,
    /// Space of the next flight.
    pub room: Room,
    /// Limits of its motion.
    pub envelope: FlightEnvelope,
    /// Seed of the simulated flights.
    pub seed: u64,
}

/// The proposed flight.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NextFlight {
    /// The manoeuvre's name.
    pub manoeuvre: &'static str,
    /// Length of its trajectory, s.
    pub seconds: f64,
    /// The reason for it, in a sentence.
    pub why: String,
    /// The expected result, for each hypothesis that may be true.
    pub outlook: Vec<Outlook>,
    /// All manoeuvres that were tried, the best first.
    pub tried: Vec<Tried>,
    /// Contents of the trajectory file.
    #[serde(skip)]
    pub file: String,
}

/// The expected result of a manoeuvre if a hypothesis is true.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Outlook {
    /// Effects of the hypothesis; empty for none.
    pub truth: Vec<&'static str>,
    /// Its probability now.
    pub now: f64,
    /// Its probability after the flight, if it is true.
    pub expected: f64,
    /// Expected log evidence for it against each rival, nats.
    pub evidence: Vec<RivalEvidence>,
}

/// Evidence against one rival.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct RivalEvidence {
    /// The rival's effects; empty for none.
    pub rival: Vec<&'static str>,
    /// Log evidence, nats.
    pub nats: f64,
}

/// A manoeuvre of the library that was tried.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Tried {
    /// Its name.
    pub manoeuvre: &'static str,
    /// Length of its trajectory, s.
    pub seconds: f64,
    /// Least expected evidence of a truth against a rival, nats; missing where it breaks a limit.
    pub least_nats: Option<f64>,
}

/// The manoeuvre that best separates the hypotheses; `None` for fewer than two, or where none can
/// be flown.
///
/// # Errors
/// [`NotSimulated`].
pub fn separating(
    proposal: &Proposal<'_>,
    hypotheses: &[LiveHypothesis],
) -> Result<Option<NextFlight>, NotSimulated> {
    if hypotheses.len() < 2 {
        return Ok(None);
    }
    let rehearsals = Rehearsals::new(proposal, hypotheses)?;
    let truths: Vec<usize> = (0..hypotheses.len()).collect();
    let assessed = assess(&rehearsals, &library(&proposal.room, &proposal.envelope), &truths);
    Ok(choose(assessed, hypotheses, AMPLE_EVIDENCE))
}

/// The manoeuvre that shows the most of `effects`, each at its typical strength, against a vehicle
/// without it; `None` where none shows any.
///
/// # Errors
/// [`NotSimulated`].
pub fn showing(
    proposal: &Proposal<'_>,
    effects: &[LiveHypothesis],
) -> Result<Option<NextFlight>, NotSimulated> {
    let library = library(&proposal.room, &proposal.envelope);
    let mut shown: Vec<NextFlight> = Vec::new();
    for effect in effects {
        let hypotheses = [effect.clone(), LiveHypothesis::none(1.0 - effect.probability)];
        let rehearsals = Rehearsals::new(proposal, &hypotheses)?;
        let next = choose(assess(&rehearsals, &library, &[0]), &hypotheses, VISIBLE_EVIDENCE_MIN);
        let is_shown = |next: &NextFlight| next.tried[0].least_nats >= Some(VISIBLE_EVIDENCE_MIN);
        shown.extend(next.filter(is_shown));
    }
    // The choice of most effects; of equals, the first in the library.
    let votes = |name: &str| shown.iter().filter(|next| next.manoeuvre == name).count();
    let place = |name: &str| library.iter().position(|manoeuvre| manoeuvre.name == name);
    let most = shown
        .iter()
        .max_by_key(|next| (votes(next.manoeuvre), std::cmp::Reverse(place(next.manoeuvre))));
    Ok(most.map(|most| {
        let same = shown.iter().filter(|next| next.manoeuvre == most.manoeuvre);
        let outlook = same.flat_map(|next| next.outlook.iter().cloned()).collect();
        NextFlight { outlook, ..most.clone() }
    }))
}

/// The next flight after a diagnosis: one that separates open explanations, else one that shows the
/// most of what these logs cannot.
///
/// # Errors
/// [`NotSimulated`].
pub fn next_flight(
    proposal: &Proposal<'_>,
    open: &OpenQuestions,
) -> Result<Option<NextFlight>, NotSimulated> {
    match separating(proposal, &open.explanations)? {
        Some(next) => Ok(Some(next)),
        None => showing(proposal, &open.untested),
    }
}

/// A manoeuvre with its expected result for each truth; `None` where it breaks a limit.
struct AssessedManoeuvre {
    manoeuvre: Manoeuvre,
    rehearsals: Option<Vec<Rehearsal>>,
}

impl AssessedManoeuvre {
    /// Least evidence of a truth against one of its rivals, nats.
    fn least(&self) -> Option<f64> {
        let rehearsals = self.rehearsals.as_ref()?.iter();
        Some(rehearsals.map(Rehearsal::least).fold(f64::INFINITY, f64::min))
    }

    /// With enough evidence the shorter flight is better; without, the one with more evidence.
    fn merit(&self, enough: f64) -> (u8, f64) {
        match self.least() {
            Some(nats) if nats >= enough => (2, -self.manoeuvre.trajectory.duration()),
            Some(nats) => (1, nats),
            None => (0, 0.0),
        }
    }
}

/// Each manoeuvre of the library, rehearsed with each of `truths` (indices of hypotheses) true.
fn assess(
    rehearsals: &Rehearsals<'_>,
    library: &[Manoeuvre],
    truths: &[usize],
) -> Vec<AssessedManoeuvre> {
    library
        .par_iter()
        .map(|manoeuvre| {
            let rehearsals = truths.par_iter().map(|truth| rehearsals.rehearse(manoeuvre, *truth));
            AssessedManoeuvre { manoeuvre: manoeuvre.clone(), rehearsals: rehearsals.collect() }
        })
        .collect()
}

/// The shortest manoeuvre with enough evidence, at least `plenty` (nats) and [`COMPARABLE_SHARE`] of
/// the most; where none has enough, the one with the most. `None` without a manoeuvre.
fn choose(
    mut assessed: Vec<AssessedManoeuvre>,
    hypotheses: &[LiveHypothesis],
    plenty: f64,
) -> Option<NextFlight> {
    let most =
        assessed.iter().filter_map(AssessedManoeuvre::least).fold(f64::NEG_INFINITY, f64::max);
    let enough = plenty.max(COMPARABLE_SHARE * most);
    assessed.sort_by(|a, b| {
        let (a, b) = (a.merit(enough), b.merit(enough));
        b.0.cmp(&a.0).then(b.1.total_cmp(&a.1))
    });
    let tried = assessed
        .iter()
        .map(|assessed| Tried {
            manoeuvre: assessed.manoeuvre.name,
            seconds: assessed.manoeuvre.trajectory.duration(),
            least_nats: assessed.least(),
        })
        .collect();
    let AssessedManoeuvre { manoeuvre, rehearsals } = assessed.into_iter().next()?;
    Some(NextFlight {
        manoeuvre: manoeuvre.name,
        seconds: manoeuvre.trajectory.duration(),
        why: format!("because it {}", manoeuvre.purpose),
        outlook: rehearsals?.iter().map(|rehearsal| outlook(rehearsal, hypotheses)).collect(),
        tried,
        file: manoeuvre.text,
    })
}

/// The probabilities that a rehearsed flight leads to if its hypothesis is true.
fn outlook(rehearsal: &Rehearsal, hypotheses: &[LiveHypothesis]) -> Outlook {
    let truth = &hypotheses[rehearsal.truth];
    // Odds relative to the truth. The evidence is reduced because channels share noise.
    let others: f64 = rehearsal
        .evidence
        .iter()
        .map(|(rival, nats)| {
            let odds = hypotheses[*rival].probability / truth.probability.max(1e-9);
            odds * (-INDEPENDENT_SHARE * nats).exp()
        })
        .sum();
    Outlook {
        truth: truth.names(),
        now: truth.probability,
        // A flight separates hypotheses, but cannot show whether the catalogue has the cause.
        expected: 1.0 / (1.0 + others),
        evidence: rehearsal
            .evidence
            .iter()
            .map(|(rival, nats)| RivalEvidence { rival: hypotheses[*rival].names(), nats: *nats })
            .collect(),
    }
}
