//! `downwash exam`: the blind check of the diagnosis, as a command.
//!
//! It flies all cases and then writes the key's hash. Only then does it diagnose each case, in a
//! separate process whose folder and environment hold only that case's files. The key stays in this
//! process until the last answer is in.

mod candidate;
mod decided;
mod edits;
mod fleets;
mod laws;
mod onsets;
mod practice;
mod questions;

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, IsTerminal};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use anyhow::{Context, anyhow};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use schemars::JsonSchema;
use serde::Serialize;

use self::candidate::EVIDENCE;
pub(super) use self::candidate::{Candidate, Flown, Sheet};
pub(super) use self::edits::EditsSummary;
pub(super) use self::fleets::FleetsSummary;
pub(super) use self::laws::LawsSummary;
pub(super) use self::onsets::OnsetsSummary;
pub(super) use self::practice::PracticeSummary;
pub(super) use self::questions::{Questions, settings};
use super::output::create_folder;
use super::{
    Exit, ExitContext, Interruption, error_text, print_json, print_status, print_text, write_file,
};
use crate::cli::ExamArgs;
use crate::exam::answer::GivenAnswer;
use crate::exam::case::Case;
use crate::exam::key::{Key, commitment, entropy};
use crate::exam::order::Order;
use crate::exam::score::Row;
use crate::exam::stored::StoredCase;
use crate::exam::summary::Summary;
use crate::report::exam;

/// The JSON of `exam`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(super) struct ExamSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    seed: u64,
    commitment: &'a str,
    /// Requested cases that were not diagnosed.
    left_out: usize,
    /// Wall time of the flights, and of the diagnoses, s.
    wall_s: [f64; 2],
    #[serde(flatten)]
    summary: &'a Summary,
    cases: &'a [Row],
}

/// What an exam of any kind leaves in its folder.
const OUTPUTS: [&str; 3] = ["cases", "answers", "summary.json"];

pub(super) fn run(args: &ExamArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    let seed = args.seed.unwrap_or_else(entropy);
    if args.practice.is_none() && args.decide.is_empty() && args.flights.is_empty() {
        print_status(format_args!("seed {seed}"));
    }
    if !args.decide.is_empty() {
        return decided::run(args);
    }
    let interrupted = interruption.flag();
    create_folder("--out", &args.out)?;
    // The processes that diagnose have other working directories.
    let out = args.out.canonicalize().with_context(|| args.out.display().to_string())?;
    if let Some(other) = OUTPUTS.iter().map(|name| out.join(name)).find(|path| path.exists()) {
        let (out, other) = (args.out.display(), other.display());
        let error = anyhow!("--out {out}: {other} is another exam's; give each its own folder");
        return Err(error).or_exit(Exit::Usage);
    }
    let jobs = args.jobs.or(thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
    let hall = Hall { args, out: &out, seed, jobs, interrupted: &interrupted };
    if let Some(set) = &args.practice {
        return practice::run(set, &hall);
    }
    if let Some(vehicle) = &args.vehicle {
        return edits::run(vehicle, &args.flights, &hall);
    }
    if let Some(count) = args.fleet {
        return fleets::run(args, count, &hall);
    }
    if let Some(count) = args.laws {
        return laws::run(args, count, &hall);
    }
    if let Some(count) = args.onsets {
        return onsets::run(args, count, &hall);
    }
    let orders = Questions::from(args).orders(seed)?;
    if orders.is_empty() {
        return Err(anyhow!("--cases, --nulls: expected at least one case, found none"))
            .or_exit(Exit::Usage);
    }
    if let Some(folder) = &args.evidence {
        create_folder("--evidence", folder)?;
    }
    let began = Instant::now();
    let flown = hall.fly(&orders)?;
    if flown.is_empty() {
        return Ok(if interrupted.load(Ordering::Relaxed) { Exit::Interrupted } else { Exit::Ok });
    }
    let entries = flown.iter().map(|case| (case.name.clone(), case.key.clone())).collect();
    let key = Key::new(seed, entries).bytes().context("the key")?;
    let hash = commitment(&key);
    write_file(&out.join("commitment.txt"), format!("{hash}  key.json\n").as_bytes())?;
    let flights_s = began.elapsed().as_secs_f64();
    let rows = hall.diagnose(&flown)?;
    write_file(&out.join("key.json"), &key)?;
    let summary = Summary::new(&rows);
    let wall_s = [flights_s, began.elapsed().as_secs_f64() - flights_s];
    let provenance = exam::Provenance { seed, commitment: &hash, wall_s };
    let exam_summary = ExamSummary {
        schema: "downwash.exam",
        schema_version: 1,
        seed,
        commitment: &hash,
        left_out: orders.len() - rows.len(),
        wall_s,
        summary: &summary,
        cases: &rows,
    };
    write_file(&out.join("report.html"), exam::html(&summary, &rows, &provenance).as_bytes())?;
    let exit = hall.conclude(&exam_summary, &exam::text(&summary, &rows))?;
    print_status(format_args!("report: {}", out.join("report.html").display()));
    let misses = exit == Exit::Ok && args.fail_on_miss && !summary.holds();
    Ok(if misses { Exit::Check } else { exit })
}

/// The settings of an exam that its steps share.
struct Hall<'a> {
    args: &'a ExamArgs,
    out: &'a Path,
    seed: u64,
    jobs: usize,
    interrupted: &'a AtomicBool,
}

impl Hall<'_> {
    /// Writes a summary, prints it or its text, and ends the exam.
    fn conclude(&self, summary: &impl Serialize, text: &str) -> anyhow::Result<Exit> {
        let json = serde_json::to_vec_pretty(summary).context("summary.json")?;
        write_file(&self.out.join("summary.json"), &json)?;
        if self.args.json {
            print_json(summary)?;
        } else {
            print_text(text)?;
        }
        Ok(if self.is_interrupted() { Exit::Interrupted } else { Exit::Ok })
    }

    /// Runs `work` for each of `count` cases in `jobs` threads, until done or interrupted. Returns
    /// the results in order.
    fn each<T: Send>(
        &self,
        count: usize,
        what: &'static str,
        work: impl Fn(usize) -> anyhow::Result<T> + Sync,
    ) -> anyhow::Result<Vec<T>> {
        // A bar shows only on a terminal.
        if !io::stderr().is_terminal() {
            print_status(format_args!("... {what} {count} cases"));
        }
        let progress = progress_bar(count as u64, what);
        let next = AtomicUsize::new(0);
        let done = Mutex::new(BTreeMap::new());
        let worker = || -> anyhow::Result<()> {
            while !self.is_interrupted() {
                let turn = next.fetch_add(1, Ordering::Relaxed);
                if turn >= count {
                    break;
                }
                let result = work(turn)?;
                progress.inc(1);
                if let Ok(mut done) = done.lock() {
                    done.insert(turn, result);
                }
            }
            Ok(())
        };
        thread::scope(|scope| {
            let workers: Vec<_> = (0..self.jobs.min(count)).map(|_| scope.spawn(worker)).collect();
            workers.into_iter().try_for_each(|worker| match worker.join() {
                Ok(result) => result,
                Err(panic) => std::panic::resume_unwind(panic),
            })
        })?;
        progress.finish_and_clear();
        Ok(done.into_inner().unwrap_or_default().into_values().collect())
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.out.join("cases").join(name)
    }

    fn fly(&self, orders: &[Order]) -> anyhow::Result<Vec<Flown>> {
        let args = self.args;
        let settings = settings(args.seconds, &args.strengths, args.exact)?;
        let flown = self.each(orders.len(), "flying", |number| {
            let name = format!("case_{number:03}");
            let case = match Case::fly(&settings, self.seed, number as u64, &name, &orders[number])
            {
                Ok(case) => case,
                Err(error) => {
                    print_status(format_args!("{name}: left out: {error}"));
                    return Ok(None);
                }
            };
            Flown::write(&name, case, &self.folder(&name)).map(Some)
        })?;
        Ok(flown.into_iter().flatten().collect())
    }

    fn diagnose(&self, flown: &[Flown]) -> anyhow::Result<Vec<Row>> {
        let rows = self.each(flown.len(), "diagnosing", |number| {
            let case = &flown[number];
            let began = Instant::now();
            let logs = case.logs();
            let sheet = Sheet {
                folder: &self.folder(&case.name),
                logs: &logs,
                holdout: &[],
                without: &case.key.without,
                evidence: self.args.evidence.is_some(),
            };
            let Some(given) = self.answer(&sheet, &case.name) else { return Ok(None) };
            let seconds = began.elapsed().as_secs_f64();
            let folder = self.folder(&case.name);
            let closed = given.as_ref().ok().and_then(|given| case.closed(&folder, given));
            if let Some(folder) = &self.args.evidence {
                let evidence = fs::read(self.folder(&case.name).join(EVIDENCE)).ok();
                let stored = StoredCase {
                    case: case.name.clone(),
                    key: case.key.clone(),
                    evidence: evidence.and_then(|bytes| serde_json::from_slice(&bytes).ok()),
                    answer: given.as_ref().cloned().map_err(error_text),
                    true_closure: closed,
                    seconds,
                };
                let path = folder.join(format!("{}.json", case.name));
                write_file(&path, &serde_json::to_vec(&stored).context("the evidence")?)?;
            }
            if !self.args.keep {
                let _ = fs::remove_dir_all(self.folder(&case.name));
            }
            let given = given.as_ref().map_err(error_text);
            let given = given.as_ref().map(|given| *given).map_err(String::as_str);
            Ok(Some(Row::new(&case.name, &case.key, given, closed, seconds)))
        })?;
        Ok(rows.into_iter().flatten().collect())
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    /// The answer to a case, also written to the folder of answers; `None` if interrupted.
    fn answer(&self, sheet: &Sheet<'_>, name: &str) -> Option<anyhow::Result<GivenAnswer>> {
        let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let threads = (cores / self.jobs).max(1);
        let candidate =
            Candidate { twins: self.args.twins, threads, interrupted: self.interrupted };
        let answer = candidate.answer(sheet).transpose()?;
        Some(answer.and_then(|bytes| {
            let answers = self.out.join("answers");
            fs::create_dir_all(&answers)
                .with_context(|| format!("cannot create the folder {}", answers.display()))?;
            write_file(&answers.join(format!("{name}.json")), &bytes)?;
            serde_json::from_slice(&bytes).context("its answer")
        }))
    }
}

/// An answer's effects with their probabilities and what they are not distinguished from, in words.
fn claim(probabilities: &[(String, f64)], ambiguous_with: &[String]) -> String {
    let named = probabilities.iter().filter(|(_, p)| *p >= 0.05);
    let mut parts: Vec<String> = named.map(|(id, p)| format!("{id} {p:.2}")).collect();
    if !ambiguous_with.is_empty() {
        parts.push(format!("or {}", ambiguous_with.join(", ")));
    }
    parts.join(", ")
}

fn progress_bar(length: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let template = "{msg} {bar:40} {pos}/{len} cases, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_message(what);
    bar
}
