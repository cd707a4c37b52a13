//! The answer: what `--json` prints and the report shows.

pub mod additions;
pub(super) mod assembly;
pub(super) mod open_questions;
pub mod words;

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectId;

use crate::audit::{Audit, Severity, Tier};
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::flights::case::Case;
use crate::diagnose::flights::preparation::{Channels, PreparedFlight};
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::next_flight::NextFlight;
use crate::diagnose::remainder::leftover::UnmodelledForce;
use crate::diagnose::remainder::map::ResidualMap;
use crate::diagnose::search::twins::Twins;
use crate::diagnose::simulate::gap::{Errors, OverNoise};
use crate::diagnose::simulate::reflight::ClosedLoop;
use crate::diagnose::verdict::Unexplained;
use crate::diagnose::verdict::attribution::Share;
use crate::diagnose::verdict::evidence::FileNumber;
use crate::diagnose::verdict::parameter::Parameter;
use crate::diagnose::verdict::untestable::{self, Untestable};
use crate::diagnose::verdict::{NAMED, Verdict};
use crate::log::import::Flight;

/// The full verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FullVerdict {
    /// Effects of the catalogue, and no others in their place.
    Named,
    /// An effect of the catalogue, by another law than the catalogue's: the evidence that no other
    /// effect touches shows it, and the gap stays open.
    OtherLaw,
    /// One of several effects: these flights do not tell which.
    Ambiguous,
    /// Nothing beyond noise and tolerances, and these flights would have shown it.
    None,
    /// Nothing stands out, but some effects could not have shown.
    NotTestable,
    /// What is left depends on how the vehicle flies, and no listed effect explains it.
    UnknownStructured,
    /// Something acts that the logs do not show.
    UnobservedDisturbance,
    /// The data are at fault: nothing was concluded.
    DataFault,
}

/// The full verdict with its reasons.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Finding {
    /// The verdict.
    pub verdict: FullVerdict,
    /// In a sentence or two.
    pub sentence: String,
    /// Why what was seen counts as unexplained, where it does.
    pub because: Option<Unexplained>,
    /// What a gap that nothing explains depends on.
    pub depends_on: Vec<String>,
}

/// What the audit found in a log.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LogAnswer {
    /// Its name.
    pub name: String,
    /// What was logged, as far as it decides what can be told.
    pub tier: Option<Tier>,
    /// Faults of the data for which it was left out.
    pub faults: Vec<String>,
    /// What is at fault in the data and in the measurement, and what to do about it.
    pub findings: Vec<String>,
    /// Effects that its channels cannot show.
    #[serde(skip)]
    pub untestable: Vec<Untestable>,
}

impl LogAnswer {
    /// What an audit found, and what its flight cannot show.
    pub fn of(audit: &Audit, flight: &Flight) -> Self {
        let worth_a_word = audit.findings.iter().filter(|f| f.severity > Severity::Note);
        Self {
            name: audit.run.clone(),
            tier: audit.tier,
            faults: audit.faults().map(|finding| finding.what.clone()).collect(),
            findings: worth_a_word.map(ToString::to_string).collect(),
            untestable: untestable::of(flight, &audit.channels),
        }
    }

    /// Whether the log was left out as faulty.
    pub fn is_faulty(&self) -> bool {
        !self.faults.is_empty()
    }
}

/// An effect with its probability.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct EffectAnswer {
    /// Its id.
    #[schemars(with = "String")]
    pub id: EffectId,
    /// Probability that the vehicle has it, 0..1.
    pub probability: f64,
    /// The vehicle's true values, absolute.
    pub parameters: BTreeMap<&'static str, Parameter>,
    /// 90 % intervals of the fitted numbers, by parameter (component).
    pub intervals: BTreeMap<String, [f64; 2]>,
    /// Standard deviations of the fitted numbers, as the fit has them: what the vehicle file and an
    /// inexact law add is in the intervals only.
    pub deviations: BTreeMap<String, f64>,
}

/// The gap on the flights held out.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Gap {
    /// `mean`: of position, velocity and attitude at 0.5 and 1 s, each over its noise.
    pub metric: &'static str,
    /// With the vehicle file as shipped.
    pub before: f64,
    /// With the named effects.
    pub after: f64,
    /// What noise alone leaves. 1, the unit of all gaps here, is what the sensors' noise leaves in
    /// simulation; the floor is higher where a flexible learner finds no way to predict more.
    pub floor: f64,
    /// By how much noise alone scatters what it leaves.
    pub scatter: f64,
    /// (before - after) / (before - floor), where there is a gap.
    pub closure: Option<f64>,
    /// With the vehicle file's numbers within their tolerances alone.
    pub nuisances_only: Option<f64>,
    /// With the named effects and the nuisances.
    pub with_nuisances: Option<f64>,
    /// As shipped with what a flexible learner adds that was taught on the flights of the fit.
    pub with_learner: Option<f64>,
    /// Errors by horizon and quantity: before, after, floor.
    pub errors: [Errors; 3],
    /// Noise of the reports.
    pub noise: ReportNoise,
}

impl Gap {
    /// A gap in units of what noise alone leaves.
    pub fn times(&self, gap: f64) -> f64 {
        gap / self.floor.max(f64::MIN_POSITIVE)
    }

    /// What stays open with the named effects, with or without nuisances, in units of the noise.
    pub fn open(&self) -> f64 {
        let left = self.with_nuisances.map_or(self.after, |with| with.min(self.after));
        self.times(left)
    }
}

/// A set of effects as it fared.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct ExplanationAnswer {
    /// Its effects.
    pub effects: Vec<String>,
    /// Evidence over the vehicle file within its tolerances, nats.
    pub evidence: f64,
    /// Its posterior mass, 0..1.
    pub mass: f64,
    /// Fitted numbers.
    pub numbers: Vec<f64>,
}

/// A flight of the diagnosis.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FlightAnswer {
    /// Name.
    pub name: String,
    /// Whether it was held out of the fit.
    pub held_out: bool,
    /// Airborne time used, s.
    pub seconds: f64,
    /// What its log holds.
    pub channels: Channels,
    /// The gap of the simulator as shipped on this flight alone; missing where no window can start.
    #[serde(flatten)]
    pub over_noise: Option<OverNoise>,
}

impl FlightAnswer {
    /// Every flight of a case, with the gap of each as `gap` has it.
    pub fn all(case: &Case<'_>, gap: impl Fn(&PreparedFlight) -> Option<OverNoise>) -> Vec<Self> {
        let of = |flight: &PreparedFlight, held_out: bool| Self {
            name: flight.name.clone(),
            held_out,
            seconds: flight.seconds(),
            channels: flight.channels,
            over_noise: gap(flight),
        };
        let fitted = case.fitted.iter().map(|flight| of(flight, false));
        fitted.chain(case.held_out.iter().map(|flight| of(flight, true))).collect()
    }
}

/// The whole answer.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Answer {
    /// The verdict.
    pub verdict: Verdict,
    /// The effects, the most probable first.
    pub effects: Vec<EffectAnswer>,
    /// The gap; missing where no window can start.
    pub gap: Option<Gap>,
    /// The flights held out, flown again in simulation.
    pub closed_loop: Option<ClosedLoop>,
    /// Why they were not, where they were not.
    pub closed_loop_missing: Option<String>,
    /// Effects that cannot be told from the named ones.
    #[schemars(with = "Vec<String>")]
    pub ambiguous_with: Vec<EffectId>,
    /// The full verdict.
    pub finding: Finding,
    /// What the audit found in each log.
    pub logs: Vec<LogAnswer>,
    /// Where the gap lies.
    #[serde(rename = "where")]
    pub map: ResidualMap,
    /// Effects that these logs cannot show.
    pub not_testable: Vec<NotTestable>,
    /// The flight that would tell what these logs cannot, where it was asked for.
    pub next_flight: Option<NextFlight>,
    /// Force that nothing explains, before and after.
    pub unmodelled_force: Option<[UnmodelledForce; 2]>,
    /// Shares of the squared gap on the flights held out.
    pub attribution: Vec<Share>,
    /// How good the vehicle file is: the scale of the tolerances that it does not state.
    pub file_scale: f64,
    /// Numbers of the vehicle file that are off by one tolerance or more where the file alone
    /// explains the flights best, the furthest off first.
    pub file_numbers: Vec<FileNumber>,
    /// Flights simulated without an effect.
    pub twins: Option<Twins>,
    /// What was fitted, the best first.
    pub explanations: Vec<ExplanationAnswer>,
    /// The flights.
    pub flights: Vec<FlightAnswer>,
    /// The law that explains what no effect does, where the search found one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<LawAnswer>,
}

/// An effect that cannot be tested, and why.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NotTestable {
    /// Its id.
    #[schemars(with = "String")]
    pub id: EffectId,
    /// Why.
    pub reason: String,
}

impl Answer {
    /// The effects that are named, the most probable first.
    pub fn named(&self) -> impl Iterator<Item = &EffectAnswer> {
        self.effects.iter().filter(|effect| effect.probability >= NAMED)
    }

    /// Whether effects were named that explain the gap.
    pub fn explains(&self) -> bool {
        matches!(self.finding.verdict, FullVerdict::Named | FullVerdict::Ambiguous)
    }

    /// The answer where every log is at fault.
    pub fn data_fault(logs: Vec<LogAnswer>) -> Self {
        let reasons: Vec<String> = logs
            .iter()
            .filter(|log| log.is_faulty())
            .map(|log| format!("{}: {}", log.name, log.faults.join("; ")))
            .collect();
        let sentence = format!(
            "The data are at fault, and nothing was concluded from them: {}.",
            reasons.join(". ")
        );
        Self {
            verdict: Verdict::Unknown,
            effects: Vec::new(),
            gap: None,
            closed_loop: None,
            closed_loop_missing: None,
            ambiguous_with: Vec::new(),
            finding: Finding {
                verdict: FullVerdict::DataFault,
                sentence,
                because: None,
                depends_on: Vec::new(),
            },
            logs,
            map: ResidualMap::default(),
            not_testable: Vec::new(),
            next_flight: None,
            unmodelled_force: None,
            attribution: Vec::new(),
            file_scale: 1.0,
            file_numbers: Vec::new(),
            twins: None,
            explanations: Vec::new(),
            flights: Vec::new(),
            law: None,
        }
    }
}
