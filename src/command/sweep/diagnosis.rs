//! A point that is a diagnosis.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::effects::EffectId;

use super::case_files::CaseFiles;
use super::manifest::{Manifest, Point};
use crate::cli::DiagnoseArgs;
use crate::command::diagnose::find;
use crate::diagnose::answer::{Answer, FullVerdict};
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::parameter::Parameter;

/// The inputs as the manifest gives them: flags of `diagnose`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    /// A folder with a vehicle file and logs.
    case: Option<String>,
    vehicle: Option<String>,
    logs: Option<Names>,
    holdout: Option<Names>,
    mapping: Option<String>,
    twins: Option<u32>,
    #[serde(default)]
    without: Vec<String>,
    #[serde(default)]
    discover: bool,
}

/// One name, or several.
#[derive(Deserialize)]
#[serde(untagged)]
enum Names {
    One(String),
    Several(Vec<String>),
}

/// A diagnosis as one row.
#[derive(Debug, JsonSchema, Serialize)]
pub struct DiagnosisRow {
    /// `downwash.diagnose.row`.
    schema: &'static str,
    /// Version of this JSON.
    schema_version: u32,
    /// Version of the program.
    version: &'static str,
    /// Flights of the diagnosis.
    flights: usize,
    /// Logs with faulty data.
    faulty_logs: usize,
    /// The verdict.
    verdict: Verdict,
    /// The full verdict.
    full_verdict: FullVerdict,
    /// The named effects, with their probabilities and the vehicle's values.
    effects: BTreeMap<&'static str, NamedEffect>,
    /// Effects that cannot be told from the named ones.
    ambiguous_with: Vec<&'static str>,
    /// The gap of the vehicle file on the held-out flights, in units of the noise.
    gap_before: Option<f64>,
    /// The same gap with the named effects.
    gap_after: Option<f64>,
    /// The closed share of the closable gap.
    closure: Option<f64>,
    /// Whether a law is named; null without a search for one.
    law_named: Option<bool>,
    /// The verdict in a sentence or two.
    sentence: String,
}

/// A named effect.
#[derive(Debug, JsonSchema, Serialize)]
struct NamedEffect {
    probability: f64,
    #[serde(flatten)]
    parameters: BTreeMap<&'static str, Parameter>,
}

/// The arguments of `diagnose` at a point.
fn arguments(manifest: &Manifest, point: &Point) -> anyhow::Result<DiagnoseArgs> {
    let given: Given = manifest.inputs(point)?;
    let case = given.case.as_ref().map(|case| {
        let folder = manifest.files().resolved(case);
        CaseFiles::in_folder(&folder).with_context(|| folder.display().to_string())
    });
    let case = case.transpose()?;
    let named = |names: Names| {
        let names = match names {
            Names::One(name) => vec![name],
            Names::Several(names) => names,
        };
        names.iter().flat_map(|name| manifest.files().fitting(name)).collect::<Vec<PathBuf>>()
    };
    let vehicle = given.vehicle.map(|file| manifest.files().resolved(&file));
    let Some(vehicle) = vehicle.or_else(|| case.as_ref().map(|case| case.vehicle.clone())) else {
        bail!("expected a case, or a vehicle and logs");
    };
    let logs = given.logs.map(named).or_else(|| case.map(|case| case.logs)).unwrap_or_default();
    if logs.is_empty() {
        bail!("expected at least one log");
    }
    let mut args = DiagnoseArgs::new(logs, vehicle);
    args.holdout = given.holdout.map(named).unwrap_or_default();
    args.mapping = given.mapping.map(|file| manifest.files().resolved(&file));
    args.twins = given.twins.unwrap_or(args.twins);
    let without = given.without.iter().map(|id| EffectId::from_str(id));
    args.without = without.collect::<Result<_, _>>().context("without")?;
    args.discover = given.discover;
    args.seed = point.seed;
    Ok(args)
}

/// Diagnoses. Once `stop` is set, the work ends early, with any outcome.
pub(super) fn row(
    manifest: &Manifest,
    point: &Point,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<DiagnosisRow> {
    let args = arguments(manifest, point)?;
    Ok(DiagnosisRow::of(&find(&args, stop, &|_| {})?.answer))
}

impl DiagnosisRow {
    fn of(answer: &Answer) -> Self {
        let named = answer.named().map(|effect| {
            let parameters = effect.parameters.clone();
            (effect.id.name(), NamedEffect { probability: effect.probability, parameters })
        });
        let gap = answer.gap.as_ref();
        Self {
            schema: "downwash.diagnose.row",
            schema_version: 1,
            version: env!("CARGO_PKG_VERSION"),
            flights: answer.flights.len(),
            faulty_logs: answer.logs.iter().filter(|log| log.is_faulty()).count(),
            verdict: answer.verdict,
            full_verdict: answer.finding.verdict,
            effects: named.collect(),
            ambiguous_with: answer.ambiguous_with.iter().map(|id| id.name()).collect(),
            gap_before: gap.map(|gap| gap.before),
            gap_after: gap.map(|gap| gap.after),
            closure: gap.and_then(|gap| gap.closure),
            law_named: answer.law.as_ref().map(|law| law.named),
            sentence: answer.finding.sentence.clone(),
        }
    }
}
