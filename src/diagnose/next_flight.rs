//! The flight that tells rival explanations apart, or that shows what these logs cannot.
//!
//! Every manoeuvre of a library is flown in closed-loop simulation by a vehicle that each of the
//! live hypotheses is true of in turn. Each hypothesis is then refitted to that flight alone, with
//! every nuisance free: what the rivals can explain by other numbers counts for nothing (Atkinson
//! and Fedorov's T-optimality), and nothing is taken for granted of old flights, whose wind and
//! pack are not those of the new one. The manoeuvre whose least expected evidence against a rival
//! is the largest is the best; of those with plenty, and with half of what the best has, the
//! shortest.

mod live;
mod rehearsal;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

pub use self::live::{Live, OpenQuestions, typical};
use self::rehearsal::{Rehearsal, Stage};
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::simulate::flight_simulator::NotSimulated;
use crate::plan::FlightEnvelope;
use crate::plan::manoeuvres::{Manoeuvre, Room, library};

/// Evidence against every rival that is plenty: models are never quite right, so that it is far
/// beyond what simulation says is needed, nats.
const PLENTY: f64 = 100.0;
/// Share of the most telling manoeuvre's evidence that a shorter one must have to be preferred.
const COMPARABLE: f64 = 0.5;
/// Share of the simulated evidence that counts: channels share what models are not right about.
const INDEPENDENT: f64 = 0.25;
/// Evidence that makes an effect visible, nats.
const VISIBLE: f64 = 20.0;

/// What to choose from and how.
#[derive(Clone, Copy, Debug)]
pub struct Proposal<'a> {
    /// The simulator's vehicle.
    pub vehicle: &'a VehicleParams,
    /// Whether the diagnosis looks at the leg from setpoints to outputs.
    pub setpoint_leg: bool,
    /// Noise of the reports.
    pub noise: ReportNoise,
    /// Where the next flight may be.
    pub room: Room,
    /// What it may ask for.
    pub envelope: FlightEnvelope,
    /// Seed of the simulated flights.
    pub seed: u64,
}

/// The flight that is suggested.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NextFlight {
    /// The manoeuvre's name.
    pub manoeuvre: &'static str,
    /// Length of its trajectory, s.
    pub seconds: f64,
    /// Why it, in a sentence.
    pub why: String,
    /// What is expected of it, for each hypothesis that may be true.
    pub outlook: Vec<Outlook>,
    /// All manoeuvres that were tried, the best first.
    pub tried: Vec<Tried>,
    /// The trajectory file.
    #[serde(skip)]
    pub file: String,
}

/// What a manoeuvre is expected to say if a hypothesis is true.
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

/// A manoeuvre that was tried.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Tried {
    /// Its name.
    pub manoeuvre: &'static str,
    /// Length, s.
    pub seconds: f64,
    /// Least expected evidence of a truth against a rival, nats; none where it would break a limit.
    pub least_nats: Option<f64>,
}

/// The manoeuvre that best tells the hypotheses apart; `None` for fewer than two, or where none can
/// be flown.
///
/// # Errors
/// [`NotSimulated`].
pub fn separating(
    proposal: &Proposal<'_>,
    hypotheses: &[Live],
) -> Result<Option<NextFlight>, NotSimulated> {
    if hypotheses.len() < 2 {
        return Ok(None);
    }
    let stage = Stage::new(proposal, hypotheses)?;
    let truths: Vec<usize> = (0..hypotheses.len()).collect();
    let judged = judge(&stage, &library(&proposal.room, &proposal.envelope), &truths);
    Ok(choose(judged, hypotheses, PLENTY))
}

/// The manoeuvre that shows most of `effects`, each taken to act at its usual strength, against a
/// vehicle without it; `None` where none shows any.
///
/// # Errors
/// [`NotSimulated`].
pub fn showing(
    proposal: &Proposal<'_>,
    effects: &[Live],
) -> Result<Option<NextFlight>, NotSimulated> {
    let library = library(&proposal.room, &proposal.envelope);
    let mut shown: Vec<NextFlight> = Vec::new();
    for effect in effects {
        let hypotheses = [effect.clone(), Live::none(1.0 - effect.probability)];
        let stage = Stage::new(proposal, &hypotheses)?;
        let next = choose(judge(&stage, &library, &[0]), &hypotheses, VISIBLE);
        let is_shown = |next: &NextFlight| next.tried[0].least_nats >= Some(VISIBLE);
        shown.extend(next.filter(is_shown));
    }
    // The flight that the most of them would have; of equals, the first in the library.
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

/// The next flight after a diagnosis: where explanations are left open, the one that tells them
/// apart; else the one that shows most of what these logs cannot.
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

/// A manoeuvre with what it is expected to say for each truth; nothing where it breaks a limit.
struct Judged {
    manoeuvre: Manoeuvre,
    rehearsals: Option<Vec<Rehearsal>>,
}

impl Judged {
    /// Least evidence of a truth against one of its rivals, nats.
    fn least(&self) -> Option<f64> {
        let rehearsals = self.rehearsals.as_ref()?.iter();
        Some(rehearsals.map(Rehearsal::least).fold(f64::INFINITY, f64::min))
    }

    /// With enough evidence the shorter flight is the better one; without, the more telling.
    fn merit(&self, enough: f64) -> (u8, f64) {
        match self.least() {
            Some(nats) if nats >= enough => (2, -self.manoeuvre.trajectory.duration()),
            Some(nats) => (1, nats),
            None => (0, 0.0),
        }
    }
}

fn judge(stage: &Stage<'_>, library: &[Manoeuvre], truths: &[usize]) -> Vec<Judged> {
    library
        .par_iter()
        .map(|manoeuvre| {
            let rehearsals = truths.par_iter().map(|truth| stage.rehearse(manoeuvre, *truth));
            Judged { manoeuvre: manoeuvre.clone(), rehearsals: rehearsals.collect() }
        })
        .collect()
}

fn choose(mut judged: Vec<Judged>, hypotheses: &[Live], plenty: f64) -> Option<NextFlight> {
    let most = judged.iter().filter_map(Judged::least).fold(f64::NEG_INFINITY, f64::max);
    let enough = plenty.max(COMPARABLE * most);
    judged.sort_by(|a, b| {
        let (a, b) = (a.merit(enough), b.merit(enough));
        b.0.cmp(&a.0).then(b.1.total_cmp(&a.1))
    });
    let tried = judged
        .iter()
        .map(|judged| Tried {
            manoeuvre: judged.manoeuvre.name,
            seconds: judged.manoeuvre.trajectory.duration(),
            least_nats: judged.least(),
        })
        .collect();
    let Judged { manoeuvre, rehearsals } = judged.into_iter().next()?;
    Some(NextFlight {
        manoeuvre: manoeuvre.name,
        seconds: manoeuvre.trajectory.duration(),
        why: format!("because it {}", manoeuvre.purpose),
        outlook: rehearsals?.iter().map(|rehearsal| outlook(rehearsal, hypotheses)).collect(),
        tried,
        file: manoeuvre.text,
    })
}

fn outlook(rehearsal: &Rehearsal, hypotheses: &[Live]) -> Outlook {
    let truth = &hypotheses[rehearsal.truth];
    // Relative to the truth's own weight, fewer, for channels share noise.
    let others: f64 = rehearsal
        .evidence
        .iter()
        .map(|(rival, nats)| {
            let odds = hypotheses[*rival].probability / truth.probability.max(1e-9);
            odds * (-INDEPENDENT * nats).exp()
        })
        .sum();
    Outlook {
        truth: truth.names(),
        now: truth.probability,
        // A flight tells hypotheses apart; whether the catalogue has the cause it does not.
        expected: 1.0 / (1.0 + others),
        evidence: rehearsal
            .evidence
            .iter()
            .map(|(rival, nats)| RivalEvidence { rival: hypotheses[*rival].names(), nats: *nats })
            .collect(),
    }
}
