//! The answer: the data behind `--json` and the report.

pub mod additions;
pub(super) mod assembly;
pub(super) mod finding;
pub(super) mod open_questions;
pub mod quantities;
pub mod text;

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::{EffectId, ParameterValue};

use crate::audit::{Audit, Severity, Shift, Tier};
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::flights::input::DiagnosisInput;
use crate::diagnose::flights::preparation::{Channels, PreparedFlight};
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::next_flight::NextFlight;
use crate::diagnose::residual_analysis::map::ResidualMap;
use crate::diagnose::residual_analysis::unmodelled_force::UnmodelledForce;
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

/// The verdict in the JSON answer's `finding`, finer than the three words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FullVerdict {
    /// Effects of the catalogue, and no alternatives to them.
    Named,
    /// An effect of the catalogue whose equation is not quite the catalogue's: a part of the gap
    /// stays open.
    OtherLaw,
    /// One of several effects: these flights do not distinguish them.
    Ambiguous,
    /// Nothing beyond noise and tolerances, and these flights would have shown any effect.
    None,
    /// Nothing stands out, but these flights could not have shown some effects.
    NotTestable,
    /// The residual depends on how the vehicle flies, and no listed effect explains it.
    UnknownStructured,
    /// The residual depends on none of the recorded quantities.
    UnobservedDisturbance,
    /// The data are at fault, so there is no conclusion.
    DataFault,
}

/// The full verdict with its reasons.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Finding {
    /// The verdict.
    pub verdict: FullVerdict,
    /// The finding in a sentence or two.
    pub sentence: String,
    /// Why a gap counts as unexplained, where it does.
    pub because: Option<Unexplained>,
    /// The quantities that an unexplained gap depends on.
    pub depends_on: Vec<String>,
}

/// The audit's findings on a log.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct LogAnswer {
    /// File name without extension; the end of the path if another log has that name.
    pub name: String,
    /// The most that the log's channels can show.
    pub tier: Option<Tier>,
    /// Faults of the data that excluded the log.
    pub faults: Vec<String>,
    /// Problems of the data and the measurement above the level of a note, with remedies.
    pub findings: Vec<String>,
    /// Streams on another clock than the others: their times were shifted before any fit.
    pub shifts: Vec<Shift>,
    /// Effects that its channels cannot show.
    #[serde(skip)]
    pub untestable: Vec<Untestable>,
}

impl LogAnswer {
    /// The audit's findings, with the shifts of its streams and the effects that `flight` cannot show.
    pub fn of(audit: &Audit, flight: &Flight, shifts: Vec<Shift>) -> Self {
        let worth_a_word = audit.findings.iter().filter(|f| f.severity > Severity::Note);
        Self {
            name: audit.run.clone(),
            tier: audit.tier,
            faults: audit.faults().map(|finding| finding.description()).collect(),
            findings: worth_a_word.map(ToString::to_string).collect(),
            shifts,
            untestable: untestable::of(flight, &audit.channels),
        }
    }

    /// Whether faults excluded the log.
    pub fn is_faulty(&self) -> bool {
        !self.faults.is_empty()
    }
}

/// An effect of the answer, with its probability and numbers.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct EffectAnswer {
    /// Its id in the catalogue.
    #[schemars(with = "String")]
    pub id: EffectId,
    /// Probability that the effect acts on the vehicle, 0..1.
    pub probability: f64,
    /// Absolute values of all its parameters, by name.
    pub parameters: BTreeMap<&'static str, Parameter>,
    /// 90 % intervals of the fitted numbers, by parameter (component).
    pub intervals: BTreeMap<String, [f64; 2]>,
    /// Standard deviations of the fitted numbers from the fit alone. Only the intervals include the
    /// errors of the vehicle file and of an inexact law.
    pub deviations: BTreeMap<String, f64>,
}

/// The gap on the held-out flights.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Gap {
    /// Name of the metric. `mean` averages the errors of position, velocity and attitude at 0.5 and
    /// 1 s, each over its noise.
    pub metric: &'static str,
    /// With the vehicle file as shipped.
    pub before: f64,
    /// With the named effects; `with_file` tells whether with the file's numbers too.
    pub after: f64,
    /// Whether `after` includes the file's numbers: the effects alone do not shrink the gap, because
    /// errors of the file cancel them, and both together do.
    pub with_file: bool,
    /// The gap from noise alone. 1, the unit of all gaps here, is the floor from sensor noise in
    /// simulation; this is higher where a flexible learner cannot predict more.
    pub floor: f64,
    /// Scatter of the floor from noise alone.
    pub scatter: f64,
    /// (before - after) / (before - floor); missing where nothing is closable.
    pub closure: Option<f64>,
    /// With only the vehicle file's numbers, within their tolerances.
    pub nuisances_only: Option<f64>,
    /// With the named effects and the file's numbers.
    pub with_nuisances: Option<f64>,
    /// With the best explanation, and a flexible learner's corrections trained on its residuals.
    pub with_learner: Option<f64>,
    /// Errors by horizon and quantity: before, after, floor.
    pub errors: [Errors; 3],
    /// Noise of the reported state.
    pub noise: ReportNoise,
}

impl Gap {
    /// `gap` in units of the floor.
    pub fn times(&self, gap: f64) -> f64 {
        gap / self.floor.max(f64::MIN_POSITIVE)
    }

    /// The gap that stays open with the named effects, with or without nuisances, in units of the
    /// floor.
    pub fn open(&self) -> f64 {
        let left = self.with_nuisances.map_or(self.after, |with| with.min(self.after));
        self.times(left)
    }
}

/// A fitted set of effects.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct ExplanationAnswer {
    /// Ids of its effects.
    pub effects: Vec<String>,
    /// Evidence against the vehicle file within its tolerances, nats.
    pub evidence: f64,
    /// Its posterior mass, 0..1.
    pub mass: f64,
    /// Its fitted numbers, in the order of its effects.
    pub numbers: Vec<f64>,
    /// All parameters of its effects, by effect and name.
    #[schemars(with = "BTreeMap<String, BTreeMap<String, Parameter>>")]
    pub parameters: BTreeMap<String, BTreeMap<String, ParameterValue>>,
}

/// A flight of the diagnosis.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FlightAnswer {
    /// The flight's name.
    pub name: String,
    /// Whether it was held out of the fit.
    pub held_out: bool,
    /// Airborne time in use, s.
    pub seconds: f64,
    /// The channels of its log.
    pub channels: Channels,
    /// The gap as shipped on this flight alone; missing where no prediction window fits.
    #[serde(flatten)]
    pub over_noise: Option<OverNoise>,
}

impl FlightAnswer {
    /// Every flight of the input, with its gap from `gap`.
    pub fn all(
        input: &DiagnosisInput<'_>,
        gap: impl Fn(&PreparedFlight) -> Option<OverNoise>,
    ) -> Vec<Self> {
        let of = |flight: &PreparedFlight, held_out: bool| Self {
            name: flight.name.clone(),
            held_out,
            seconds: flight.seconds(),
            channels: flight.channels,
            over_noise: gap(flight),
        };
        let fitted = input.fitted.iter().map(|flight| of(flight, false));
        fitted.chain(input.held_out.iter().map(|flight| of(flight, true))).collect()
    }
}

/// The whole answer.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Answer {
    /// The verdict.
    pub verdict: Verdict,
    /// The effects, the most probable first.
    pub effects: Vec<EffectAnswer>,
    /// The gap; missing where no prediction window fits.
    pub gap: Option<Gap>,
    /// The held-out flights, flown again in simulation.
    pub closed_loop: Option<ClosedLoop>,
    /// Why no flight was flown again, where none was.
    pub closed_loop_missing: Option<String>,
    /// Effects that these flights do not distinguish from the named ones.
    #[schemars(with = "Vec<String>")]
    pub ambiguous_with: Vec<EffectId>,
    /// The full verdict with its reasons.
    pub finding: Finding,
    /// The audit's findings on each log.
    pub logs: Vec<LogAnswer>,
    /// The location of the gap.
    #[serde(rename = "where")]
    pub map: ResidualMap,
    /// Effects that these logs cannot show.
    pub not_testable: Vec<NotTestable>,
    /// The flight that would resolve what these logs cannot, if requested.
    pub next_flight: Option<NextFlight>,
    /// Force that nothing explains, with the file alone and with the best explanation.
    pub unmodelled_force: Option<[UnmodelledForce; 2]>,
    /// Shares of the squared gap on the held-out flights.
    pub attribution: Vec<Share>,
    /// Quality of the vehicle file: the scale of the tolerances that it does not state.
    pub file_scale: f64,
    /// The vehicle file's numbers that are off by one tolerance or more where the file alone
    /// explains the flights, the furthest off first.
    pub file_numbers: Vec<FileNumber>,
    /// Results of the twins without an effect; missing where none were flown.
    pub twins: Option<Twins>,
    /// The fitted sets of effects, the best first.
    pub explanations: Vec<ExplanationAnswer>,
    /// The flights that were used, held-out ones included.
    pub flights: Vec<FlightAnswer>,
    /// The law that explains what no effect does, if the search found one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<LawAnswer>,
}

/// An effect that these logs cannot show.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct NotTestable {
    /// Its id in the catalogue.
    #[schemars(with = "String")]
    pub id: EffectId,
    /// The reason, in words.
    pub reason: String,
}

impl Answer {
    /// The effects with a probability of a half or more, the most probable first.
    pub fn named(&self) -> impl Iterator<Item = &EffectAnswer> {
        self.effects.iter().filter(|effect| effect.probability >= NAMED)
    }

    /// Whether the named effects, or one of several, explain the gap.
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
        let sentence =
            format!("The data are faulty and support no conclusion: {}.", reasons.join(". "));
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
