//! A point that is a case of an exam.
//!
//! A worker flies each case, lets a process diagnose it from its files alone, and scores the
//! answer. The seed determines the key, so the worker need not commit to one beforehand.

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, bail};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::exam_inputs::Given;
use super::manifest::{Manifest, Point};
use crate::command::error_text;
use crate::command::exam::{Candidate, Flown, Sheet, settings};
use crate::exam::answer::GivenAnswer;
use crate::exam::case::Case;
use crate::exam::score;
use crate::exam::summary::Summary;

/// A case of an exam and its result.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ExamRow {
    /// `downwash.exam.case`.
    schema: &'static str,
    /// Version of this JSON.
    schema_version: u32,
    /// Version of the program.
    version: &'static str,
    /// Seed of its exam.
    seed: u64,
    #[serde(flatten)]
    row: score::Row,
}

/// The results of all cases together: the file summary.json of a sweep of an exam.
#[derive(JsonSchema, Serialize)]
pub struct ExamSweepSummary {
    schema: &'static str,
    schema_version: u32,
    version: &'static str,
    manifest_sha256: String,
    /// Cases that were flown and scored.
    cases: usize,
    #[serde(flatten)]
    summary: Summary,
}

/// A folder that is removed when dropped.
struct Desk(PathBuf);

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Flies and diagnoses a case, and scores the answer.
pub(super) fn row(
    manifest: &Manifest,
    (index, point): (usize, &Point),
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<ExamRow> {
    let given: Given = manifest.inputs(point)?;
    let settings = settings(given.seconds, &given.strengths, given.exact)?;
    let orders = given.questions().orders(point.seed)?;
    let order = orders.get(point.case).context("a case beyond the last")?;
    let name = format!("case_{:03}", point.case);
    let case = Case::fly(&settings, point.seed, point.case as u64, &name, order)?;
    let unique = format!("downwash-exam-{}-{index}", std::process::id());
    let desk = Desk(std::env::temp_dir().join(unique));
    let flown = Flown::write(&name, case, &desk.0)?;
    let candidate = Candidate { twins: given.twins, threads: 1, interrupted: stop };
    let logs = flown.logs();
    let sheet = Sheet {
        folder: &desk.0,
        logs: &logs,
        holdout: &[],
        without: &flown.key.without,
        evidence: false,
    };
    let began = Instant::now();
    let answer = candidate.answer(&sheet);
    let seconds = began.elapsed().as_secs_f64();
    // A missing answer counts as wrong.
    let given = match answer {
        Ok(None) => bail!("interrupted"),
        Ok(Some(bytes)) => serde_json::from_slice::<GivenAnswer>(&bytes).context("its answer"),
        Err(error) => Err(error),
    };
    let closed = given.as_ref().ok().and_then(|given| flown.closed(&desk.0, given));
    let given = given.as_ref().map_err(error_text);
    let given = given.as_ref().map(|given| *given).map_err(String::as_str);
    Ok(ExamRow {
        schema: "downwash.exam.case",
        schema_version: 1,
        version: env!("CARGO_PKG_VERSION"),
        seed: point.seed,
        row: score::Row::new(&name, &flown.key, given, closed, seconds),
    })
}

/// The results of all cases together.
///
/// # Errors
/// A row is invalid.
pub(super) fn summary<'a>(
    manifest: &Manifest,
    rows: impl Iterator<Item = &'a serde_json::Value>,
) -> anyhow::Result<ExamSweepSummary> {
    let rows: Result<Vec<score::Row>, _> = rows.map(score::Row::deserialize).collect();
    let rows = rows.context("the rows")?;
    Ok(ExamSweepSummary {
        schema: "downwash.sweep.exam",
        schema_version: 1,
        version: env!("CARGO_PKG_VERSION"),
        manifest_sha256: manifest.sha256.clone(),
        cases: rows.len(),
        // The time differs between machines.
        summary: Summary { seconds: None, ..Summary::new(&rows) },
    })
}
