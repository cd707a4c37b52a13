//! `downwash sweep`: many flights, diagnoses or cases of an exam, on any number of workers, into one
//! table.

mod axis;
mod case_files;
mod diagnosis;
mod exam_inputs;
mod examination;
mod line;
mod manifest;
mod named_files;
mod pattern;
mod simulation;
mod subject;
mod table;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Instant;

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

pub(super) use self::diagnosis::DiagnosisRow;
pub(super) use self::examination::{ExamRow, ExamSweepSummary};
pub(super) use self::line::Line;
use self::manifest::{Manifest, Point};
use self::subject::Subject;
use super::progress::count_bar;
use super::rows::{Folder, Header, Rows, interrupted};
use super::{Exit, ExitContext, Interruption, error_text, print_json, print_status, print_text};
use crate::cli::{Shard, SweepArgs};

/// The result of a sweep: the JSON of `sweep`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SweepSummary {
    schema: &'static str,
    schema_version: u32,
    /// Hash of the manifest and the files that it names.
    manifest_sha256: String,
    version: &'static str,
    /// Points of the whole sweep.
    points: usize,
    /// Points that have a row, of all shards.
    done: usize,
    /// Points among these that could not be flown or diagnosed.
    failures: usize,
    /// Flights among these that did not end as planned.
    ended_early: usize,
    /// The table; null while rows are missing.
    pub table: Option<PathBuf>,
}

/// A point of `--list`.
#[derive(JsonSchema, Serialize)]
pub(super) struct Listed {
    point: usize,
    seed: u64,
    /// The number of the case among the seed's, for an exam; else 0.
    case: usize,
    #[schemars(with = "std::collections::BTreeMap<String, serde_json::Value>")]
    inputs: std::collections::BTreeMap<String, toml::Value>,
}

/// The part of a sweep that this worker does.
pub struct Sweep<'a> {
    /// The manifest's file.
    pub manifest: &'a Path,
    /// The folder of the rows.
    pub out: &'a Path,
    /// This worker's shard.
    pub shard: Shard,
}

pub(super) fn run(args: &SweepArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    let manifest = load(&args.manifest)?;
    if args.list {
        return list(&manifest, args);
    }
    if let Some(jobs) = args.jobs {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(jobs.into());
        builder.build_global().context("threads")?;
    }
    let began = Instant::now();
    let stop = interruption.flag();
    let sweep = Sweep { manifest: &args.manifest, out: &args.out, shard: args.shard };
    let bar = count_bar(0);
    let summary = sweep.run(&stop, &|done, of| {
        bar.set_length(of);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    print_status(format_args!("{:.1} s", began.elapsed().as_secs_f64()));
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&text(&summary, manifest.subject()))?;
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(interrupted(&args.out));
    }
    Ok(Exit::Ok)
}

/// Reads a manifest and checks its settings.
fn load(path: &Path) -> anyhow::Result<Manifest> {
    let manifest = Manifest::load(path).or_exit(Exit::Usage)?;
    if manifest.subject() == Subject::Simulate {
        let checked = simulation::check(&manifest);
        checked.with_context(|| format!("manifest {}", path.display())).or_exit(Exit::Usage)?;
    }
    Ok(manifest)
}

impl Sweep<'_> {
    /// Does the shard's missing points in this thread pool, and writes the table once every point
    /// has a row. `progress` receives the number of the shard's points done, and of all its points.
    ///
    /// # Errors
    /// The manifest is refused, or the folder cannot be written to or belongs to another sweep.
    pub fn run(
        &self,
        stop: &Arc<AtomicBool>,
        progress: &(dyn Fn(u64, u64) + Sync),
    ) -> anyhow::Result<SweepSummary> {
        let manifest = load(self.manifest)?;
        let header = Header {
            schema: "downwash.sweep".to_owned(),
            schema_version: 1,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            manifest_sha256: manifest.sha256.clone(),
            points: manifest.points,
        };
        let folder = Folder::open(self.out, "sweep.json", &header).or_exit(Exit::Usage)?;
        let done = folder.done()?;
        let own = || (0..manifest.points).filter(|point| self.shard.has(*point));
        let missing: Vec<usize> = own().filter(|point| !done.contains(point)).collect();
        let of = own().count() as u64;
        let rows = Mutex::new((folder.append(self.shard)?, of - missing.len() as u64));
        // The missing points in order, so that the first rows come first.
        missing.par_iter().with_max_len(1).try_for_each(|index| {
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let line = done_at(&manifest, *index, stop);
            // An interrupted point has no row.
            if line.failure.is_some() && stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let mut rows = rows.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let (file, flown): &mut (Rows<Line>, u64) = &mut rows;
            *flown += 1;
            progress(*flown, of);
            file.add(&line)
        })?;
        conclude(&folder, &manifest, &self.out.join("table.csv"))
    }
}

/// The row of a point.
fn done_at(manifest: &Manifest, index: usize, stop: &Arc<AtomicBool>) -> Line {
    let point = manifest.point(index);
    let (row, failure) = match row(manifest, index, &point, stop) {
        Ok(row) => (Some(row), None),
        Err(error) => (None, Some(error_text(&error))),
    };
    let inputs = point.varied.into_iter();
    let inputs =
        inputs.map(|(path, value)| (path, serde_json::to_value(value).unwrap_or_default()));
    Line { index, inputs: inputs.collect(), failure, row }
}

fn row(
    manifest: &Manifest,
    index: usize,
    point: &Point,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<Value> {
    Ok(match manifest.subject() {
        Subject::Simulate => serde_json::to_value(simulation::row(manifest, point)?)?,
        Subject::Diagnose => {
            serde_json::to_value(alone(|| diagnosis::row(manifest, point, stop))?)?
        }
        Subject::Exam => {
            serde_json::to_value(alone(|| examination::row(manifest, (index, point), stop))?)?
        }
    })
}

/// Stack of a thread that diagnoses, bytes: that of a main thread.
const STACK: usize = 8 << 20;

/// Runs `work` in its own thread, in which its parallel parts stay. A pool's worker that waits for
/// them would otherwise begin another point inside this one.
pub(super) fn alone<T: Send>(work: impl FnOnce() -> anyhow::Result<T> + Send) -> anyhow::Result<T> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).stack_size(STACK);
    let pool = pool.build().context("threads")?;
    thread::scope(|scope| {
        let done = scope.spawn(|| pool.install(work)).join();
        done.unwrap_or_else(|_| Err(anyhow!("internal error, please report it")))
    })
}

/// Counts the rows, and writes the table if none is missing.
fn conclude(
    folder: &Folder<Line>,
    manifest: &Manifest,
    csv: &Path,
) -> anyhow::Result<SweepSummary> {
    let rows = folder.rows()?;
    let ended_early = |line: &&Line| {
        let end = line.row.as_ref().and_then(|row| row.get("end")?.as_str());
        end.is_some_and(|end| end != "done")
    };
    let mut table = None;
    if rows.len() == manifest.points {
        let seed_of = |index| manifest.point(index).seed;
        Folder::<Line>::replace(csv, &table::csv(&rows, seed_of)?)?;
        table = Some(csv.to_owned());
        if manifest.subject() == Subject::Exam {
            let scored = rows.values().filter_map(|line| line.row.as_ref());
            let summary = examination::summary(manifest, scored)?;
            let text = serde_json::to_vec_pretty(&summary).context("summary.json")?;
            Folder::<Line>::replace(&csv.with_file_name("summary.json"), &text)?;
        }
    }
    Ok(SweepSummary {
        schema: "downwash.sweep.summary",
        schema_version: 1,
        manifest_sha256: manifest.sha256.clone(),
        version: env!("CARGO_PKG_VERSION"),
        points: manifest.points,
        done: rows.len(),
        failures: rows.values().filter(|line| line.failure.is_some()).count(),
        ended_early: rows.values().filter(ended_early).count(),
        table,
    })
}

/// Prints the points of the shard.
fn list(manifest: &Manifest, args: &SweepArgs) -> anyhow::Result<Exit> {
    for point in (0..manifest.points).filter(|point| args.shard.has(*point)) {
        let Point { varied, seed, case } = manifest.point(point);
        if args.json {
            print_json(&Listed { point, seed, case, inputs: varied })?;
        } else {
            let inputs = varied.iter().map(|(path, value)| format!("  {path} = {value}"));
            let inputs: String = inputs.collect();
            let case = match manifest.subject() {
                Subject::Exam => format!("  case {case}"),
                Subject::Simulate | Subject::Diagnose => String::new(),
            };
            print_text(&format!("{point}  seed {seed}{case}{inputs}\n"))?;
        }
    }
    Ok(Exit::Ok)
}

fn text(summary: &SweepSummary, subject: Subject) -> String {
    let SweepSummary { points, done, failures, ended_early, table, .. } = summary;
    let mut text = match subject {
        Subject::Simulate => format!(
            "{done} of {points} points: {failures} could not be flown, {ended_early} flights ended \
             early\n"
        ),
        Subject::Diagnose => {
            format!("{done} of {points} points: {failures} could not be diagnosed\n")
        }
        Subject::Exam => format!("{done} of {points} cases: {failures} could not be flown\n"),
    };
    if let Some(table) = table {
        text += &format!("table   {}\n", table.display());
    }
    text
}
