//! `downwash exam`: the blind check of the diagnosis, as a command.
//!
//! Everything is flown first; the key's hash is written then, and only then is each case diagnosed,
//! by a process of its own whose folder and environment hold nothing but that case's files. The
//! key stays in this process until the last answer is in.

mod decided;
mod laws;
mod onsets;
mod practice;

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, IsTerminal, Read};
use std::num::NonZeroUsize;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

pub(super) use self::laws::LawsSummary;
pub(super) use self::onsets::OnsetsSummary;
pub(super) use self::practice::PracticeSummary;
use super::logs::open_for;
use super::{Exit, ExitContext, Interruption, in_words, print_json, print_text, say, write_file};
use crate::cli::ExamArgs;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::exam::answer::Given;
use crate::exam::case::Case;
use crate::exam::closure::closure;
use crate::exam::draw::Draw;
use crate::exam::key::{Key, KeyEntry, commitment, entropy};
use crate::exam::order::{Kind, Order, RoundTrip, Settings};
use crate::exam::score::Row;
use crate::exam::stored::StoredCase;
use crate::exam::summary::Summary;
use crate::exam::world::World;
use crate::report::exam;

/// Stream of the exam's seed that the kinds and their order are drawn from.
const ORDER: u64 = 0;
/// Cases with something to find, where nothing else is asked for.
const CASES: usize = 60;
/// Where a diagnosis leaves its evidence.
const EVIDENCE: &str = "evidence.json";
/// The vehicles of a round trip.
const SHIPPED: [&str; 2] = [
    include_str!("../../config/vehicles/crazyflie.toml"),
    include_str!("../../config/vehicles/quad1200.toml"),
];

/// The JSON of `exam`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(super) struct ExamSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    seed: u64,
    commitment: &'a str,
    /// Cases that were asked for and were not diagnosed.
    left_out: usize,
    /// Wall time of the flights, and of the diagnoses, s.
    wall_s: [f64; 2],
    #[serde(flatten)]
    summary: &'a Summary,
    cases: &'a [Row],
}

/// A case whose logs are on disk, with what stays in memory.
struct Flown {
    name: String,
    known: VehicleParams,
    truth: EffectSet,
    key: KeyEntry,
    noise: ReportNoise,
    logs: usize,
}

pub(super) fn run(args: &ExamArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    let seed = args.seed.unwrap_or_else(entropy);
    if args.practice.is_none() && args.decide.is_empty() {
        say(format_args!("seed {seed}"));
    }
    if !args.decide.is_empty() {
        return decided::run(args);
    }
    let interrupted = interruption.flag();
    fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    // The processes that diagnose have other working directories.
    let out = args.out.canonicalize().with_context(|| args.out.display().to_string())?;
    let jobs = args.jobs.or(thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
    let hall = Hall { args, out: &out, seed, jobs, interrupted: &interrupted };
    if let Some(set) = &args.practice {
        return practice::run(set, &hall);
    }
    if let Some(count) = args.laws {
        return laws::run(args, count, &hall);
    }
    if let Some(count) = args.onsets {
        return onsets::run(args, count, &hall);
    }
    let orders = orders(args, seed)?;
    if orders.is_empty() {
        return Err(anyhow!("--cases, --nulls: expected at least one case, found none"))
            .or_exit(Exit::Usage);
    }
    if let Some(folder) = &args.evidence {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
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
    let whole = ExamSummary {
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
    let exit = hall.conclude(&whole, &exam::text(&summary, &rows))?;
    say(format_args!("report: {}", out.join("report.html").display()));
    let misses = exit == Exit::Ok && args.fail_on_miss && !summary.holds();
    Ok(if misses { Exit::Check } else { exit })
}

/// What each case asks, in an order that its name gives nothing away of.
fn orders(args: &ExamArgs, seed: u64) -> anyhow::Result<Vec<Order>> {
    let mut draw = Draw::new(seed, ORDER);
    let mut orders = if args.round_trip {
        let vehicles: Vec<VehicleParams> = SHIPPED
            .iter()
            .map(|text| VehicleParams::from_toml_str(text))
            .collect::<Result<_, _>>()
            .context("a built-in vehicle")?;
        RoundTrip::all(&vehicles)
    } else {
        kinds(args).into_iter().map(Order::from).collect()
    };
    draw.shuffle(&mut orders);
    if args.round_trip {
        orders.truncate(args.cases.unwrap_or(usize::MAX));
    }
    Ok(orders)
}

fn kinds(args: &ExamArgs) -> Vec<Kind> {
    let wanted: Vec<(Kind, f64)> = Kind::SHARES
        .into_iter()
        .filter(|(kind, _)| args.kinds.is_empty() || args.kinds.contains(kind))
        .collect();
    let total: f64 = wanted.iter().map(|(_, share)| share).sum();
    let count = args.cases.unwrap_or(CASES) as f64;
    let mut kinds = vec![Kind::Null; args.nulls];
    let (mut due, mut before) = (0.0, 0);
    for (kind, share) in wanted {
        due += share / total * count;
        let upto = f64::round(due) as usize;
        kinds.extend(std::iter::repeat_n(kind, upto - before));
        before = upto;
    }
    kinds
}

/// How often it is looked whether a diagnosis has ended, or the exam is to.
const ENDED_PERIOD: Duration = Duration::from_millis(20);

/// What a diagnosis is given of a case.
struct Sheet<'a> {
    /// Where the vehicle file and the logs are.
    folder: &'a Path,
    logs: &'a [String],
    /// Those of them to keep; none for the last.
    holdout: &'a [String],
    /// Effects that it is to do without.
    without: &'a [String],
    /// Whether it leaves its evidence in the folder.
    evidence: bool,
}

/// Where an exam is held.
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

    /// Does `work` for each of `count` in `jobs` threads, until done or interrupted; what it gives
    /// in order.
    fn each<T: Send>(
        &self,
        count: usize,
        what: &'static str,
        work: impl Fn(usize) -> anyhow::Result<T> + Sync,
    ) -> anyhow::Result<Vec<T>> {
        // A bar shows only on a terminal.
        if !io::stderr().is_terminal() {
            say(format_args!("... {what} {count} cases"));
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
        let ratios = match self.args.strengths.as_slice() {
            &[least, most] if least > 0.0 && most >= least => [least, most],
            other => {
                return Err(anyhow!("--strengths: expected two ratios above 0, found {other:?}"))
                    .or_exit(Exit::Usage);
            }
        };
        let world = if self.args.exact { World::Exact } else { World::Builders };
        let settings =
            Settings { seconds: self.args.seconds, ratios, world, ..Settings::default() };
        let cases = self.out.join("cases");
        if cases.exists() {
            bail!("{} exists already: give an exam an --out of its own", cases.display());
        }
        let flown = self.each(orders.len(), "flying", |number| {
            let name = format!("case_{number:03}");
            let case = match Case::fly(&settings, self.seed, number as u64, &name, &orders[number])
            {
                Ok(case) => case,
                Err(error) => {
                    say(format_args!("{name}: left out: {error}"));
                    return Ok(None);
                }
            };
            let folder = self.folder(&name);
            fs::create_dir_all(&folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
            let vehicle = serde_json::to_vec_pretty(&case.nominal).context("vehicle.json")?;
            write_file(&folder.join("vehicle.json"), &vehicle)?;
            for (log, bytes) in log_names(case.logs.len()).zip(&case.logs) {
                write_file(&folder.join(log), bytes)?;
            }
            Ok(Some(Flown {
                name,
                known: case.known,
                truth: case.truth,
                key: case.key,
                noise: case.noise,
                logs: case.logs.len(),
            }))
        })?;
        Ok(flown.into_iter().flatten().collect())
    }

    fn diagnose(&self, flown: &[Flown]) -> anyhow::Result<Vec<Row>> {
        let answers = self.out.join("answers");
        fs::create_dir_all(&answers)
            .with_context(|| format!("cannot create the folder {}", answers.display()))?;
        let rows = self.each(flown.len(), "diagnosing", |number| {
            let case = &flown[number];
            let began = Instant::now();
            let logs: Vec<String> = log_names(case.logs).collect();
            let sheet = Sheet {
                folder: &self.folder(&case.name),
                logs: &logs,
                holdout: &[],
                without: &case.key.without,
                evidence: self.args.evidence.is_some(),
            };
            let Some(answer) = self.answer(&sheet).transpose() else { return Ok(None) };
            let seconds = began.elapsed().as_secs_f64();
            let given = answer.and_then(|bytes| {
                write_file(&answers.join(format!("{}.json", case.name)), &bytes)?;
                serde_json::from_slice::<Given>(&bytes).context("its answer")
            });
            let closed = given.as_ref().ok().and_then(|given| self.closed(case, given));
            if let Some(folder) = &self.args.evidence {
                let evidence = fs::read(self.folder(&case.name).join(EVIDENCE)).ok();
                let stored = StoredCase {
                    case: case.name.clone(),
                    key: case.key.clone(),
                    evidence: evidence.and_then(|bytes| serde_json::from_slice(&bytes).ok()),
                    answer: given.as_ref().cloned().map_err(in_words),
                    true_closure: closed,
                    seconds,
                };
                let path = folder.join(format!("{}.json", case.name));
                write_file(&path, &serde_json::to_vec(&stored).context("the evidence")?)?;
            }
            if !self.args.keep {
                let _ = fs::remove_dir_all(self.folder(&case.name));
            }
            let given = given.as_ref().map_err(in_words);
            let given = given.as_ref().map(|given| *given).map_err(String::as_str);
            Ok(Some(Row::new(&case.name, &case.key, given, closed, seconds)))
        })?;
        Ok(rows.into_iter().flatten().collect())
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    /// What a process that sees nothing but the case's files answers; `None` where it was
    /// interrupted.
    fn answer(&self, sheet: &Sheet<'_>) -> anyhow::Result<Option<Vec<u8>>> {
        let program = super::program()?;
        let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let mut command = Command::new(program);
        command
            .env_clear()
            .env("RAYON_NUM_THREADS", (cores / self.jobs).max(1).to_string())
            .current_dir(sheet.folder)
            // Ctrl-C is for this process, which ends the others.
            .process_group(0)
            .args(["diagnose", "--json", "--vehicle", "vehicle.json"])
            .args(sheet.logs);
        for log in sheet.holdout {
            command.args(["--holdout", log]);
        }
        if let Some(twins) = self.args.twins {
            command.args(["--twins", &twins.to_string()]);
        }
        if sheet.evidence {
            command.args(["--evidence", EVIDENCE]);
        }
        for effect in sheet.without {
            command.args(["--without", effect]);
        }
        let output = self.output(&mut command).context("cannot run the diagnosis")?;
        let Some(output) = output else { return Ok(None) };
        if !output.status.success() {
            let errors = String::from_utf8_lossy(&output.stderr);
            let last = errors.lines().last().unwrap_or_default();
            return Err(anyhow!("the diagnosis ended with {}: {last}", output.status));
        }
        Ok(Some(output.stdout))
    }

    /// Runs a process to its end; `None` where it was interrupted, and killed.
    fn output(&self, command: &mut Command) -> io::Result<Option<Output>> {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut process = command.spawn()?;
        let (stdout, stderr) = (process.stdout.take(), process.stderr.take());
        thread::scope(|scope| {
            let stdout = scope.spawn(|| read_all(stdout));
            let stderr = scope.spawn(|| read_all(stderr));
            let status = loop {
                if let Some(status) = process.try_wait()? {
                    break Some(status);
                }
                if self.is_interrupted() {
                    process.kill()?;
                    process.wait()?;
                    break None;
                }
                thread::sleep(ENDED_PERIOD);
            };
            let joined = |pipe: thread::ScopedJoinHandle<'_, io::Result<Vec<u8>>>| match pipe.join()
            {
                Ok(bytes) => bytes,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            let (stdout, stderr) = (joined(stdout)?, joined(stderr)?);
            Ok(status.map(|status| Output { status, stdout, stderr }))
        })
    }

    /// What the answer truly closes of the effects' own gap on the flight held out, were what is off
    /// the file known: of what it names, that which is there. Of an answer that names nothing, or
    /// where the truth is outside of the catalogue, nothing can be said.
    fn closed(&self, case: &Flown, given: &Given) -> Option<f64> {
        let last = log_names(case.logs).last()?;
        if case.truth.is_empty() || given.verdict != "effect" {
            return None;
        }
        let flight = open_for(&self.folder(&case.name).join(last), None, &case.known).ok()?;
        let held_out = [PreparedFlight::new(flight, &case.known).ok()?];
        let is_there =
            |id: EffectId| case.truth.iter().any(|(true_id, _)| true_id.class() == id.class());
        let mut answer = given.effect_set();
        EffectId::ALL.into_iter().filter(|id| !is_there(*id)).for_each(|id| answer.remove(id));
        closure(&case.known, &case.truth, &answer, &held_out, &case.noise).ok()?
    }
}

fn read_all(pipe: Option<impl Read>) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        pipe.read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}

fn log_names(count: usize) -> impl Iterator<Item = String> {
    (1..=count).map(|number| format!("flight_{number}.tlog"))
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
