//! `downwash campaign`: many simulated flights under random faults, and the rules that they broke.

mod kit;
mod real_time;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::Context;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::bounded;

use self::kit::kit;
use super::progress::count_bar;
use super::rows::{Folder, Header, Numbered, Rows, interrupted};
use super::{
    Exit, ExitContext, Interruption, error_text, print_json, print_status, print_text, write_file,
};
use crate::campaign::bench;
use crate::campaign::coverage::Coverage;
use crate::campaign::draw;
use crate::campaign::judge::{Ending, Violation};
use crate::campaign::kit::Flown;
use crate::campaign::script::Script;
use crate::campaign::shrink::shrunk;
use crate::cli::CampaignArgs;

/// Flights at once in real time, where a flight waits more than it computes.
const REAL_TIME_JOBS: usize = 10;
/// Number of failing flights that are shrunk; the others wait for the next run.
const SHRUNK_MAX: usize = 10;

/// A flight of a campaign: the JSON of `campaign --script`, and a line of its rows.
#[derive(Clone, Debug, JsonSchema, Deserialize, Serialize)]
pub struct CampaignFlight {
    /// Its number.
    pub index: usize,
    /// Why it could not be flown.
    pub failure: Option<String>,
    /// How it ended, according to the station.
    pub end: String,
    /// Who had the vehicle at the end; null where the flight had none.
    pub ending: Option<Ending>,
    /// Rules that did not hold, each once.
    pub violations: Vec<Violation>,
    /// Number of setpoints that were sent.
    pub setpoints: u64,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// CRC-32 of every byte in both directions: the same script gives the same. 0 in real time.
    pub digest: u32,
    /// Pairs of a flight state and a fault that acted in it.
    pub coverage: Vec<(String, String)>,
}

impl CampaignFlight {
    fn of(index: usize, flown: Flown) -> Self {
        let pairs = flown.coverage.pairs();
        Self {
            index,
            failure: None,
            end: flown.end,
            ending: flown.ending,
            violations: flown.violations,
            setpoints: flown.setpoints,
            simulated_s: flown.simulated_s,
            digest: flown.digest,
            coverage: pairs.map(|(state, fault, _)| (state.to_owned(), fault.to_owned())).collect(),
        }
    }

    /// The row of a flight that could not be flown.
    fn not_flown(index: usize, error: &anyhow::Error) -> Self {
        Self {
            index,
            failure: Some(error_text(error)),
            end: String::new(),
            ending: None,
            violations: Vec::new(),
            setpoints: 0,
            simulated_s: 0.0,
            digest: 0,
            coverage: Vec::new(),
        }
    }
}

impl Numbered for CampaignFlight {
    fn number(&self) -> usize {
        self.index
    }
}

/// Flights in which a fault acted in a state of the flight.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Covered {
    /// The state.
    state: String,
    /// The fault.
    fault: String,
    /// Number of flights.
    flights: u64,
}

/// A flight that failed.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Failed {
    /// Its number.
    index: usize,
    /// The rules that it broke.
    violations: Vec<Violation>,
    /// Why it could not be flown.
    failure: Option<String>,
    /// The shortest script that breaks the first rule too.
    script: Option<PathBuf>,
}

/// The result of a campaign: the JSON of `campaign`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct CampaignSummary {
    schema: &'static str,
    schema_version: u32,
    version: &'static str,
    /// Seed of the campaign.
    seed: u64,
    /// Whether the station was a process on a socket, in real time.
    real_time: bool,
    /// Flights of the whole campaign.
    flights: usize,
    /// Flights that were flown, by all shards.
    done: usize,
    /// Setpoints that were judged.
    setpoints: u64,
    /// Simulated time of all flights, h.
    simulated_h: f64,
    /// Flights that broke a rule or could not be flown.
    failed: Vec<Failed>,
    /// How the flights ended, according to the simulated vehicle's true state.
    endings: BTreeMap<String, usize>,
    /// Upper bound, with 95 % confidence, on the share of such flights that fail, by the rule of
    /// three; null where some failed.
    bound_95: Option<f64>,
    /// Flight states in which faults acted.
    coverage: Vec<Covered>,
}

pub(super) fn run(args: &CampaignArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    if let Some(number) = args.draw {
        print_text(&(script_text(&draw::script(args.seed, number))? + "\n"))?;
        return Ok(Exit::Ok);
    }
    let stop = interruption.flag();
    if let Some(path) = &args.script {
        return replay(path, args, &stop);
    }
    let jobs = args.jobs.map(usize::from).or(args.real_time.then_some(REAL_TIME_JOBS));
    if let Some(jobs) = jobs {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(jobs);
        builder.build_global().context("threads")?;
    }
    let began = Instant::now();
    let campaign = Campaign { args, folder: open(args).or_exit(Exit::Usage)? };
    let flown = campaign.fly(&stop)?;
    let summary = campaign.summary(&stop)?;
    let wall_s = began.elapsed().as_secs_f64();
    print_status(format_args!(
        "{flown} flights in {wall_s:.1} s: {:.1} a second",
        flown as f64 / wall_s
    ));
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&text(&summary))?;
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(interrupted(&args.out));
    }
    Ok(if summary.failed.is_empty() { Exit::Ok } else { Exit::Check })
}

fn script_text(script: &Script) -> anyhow::Result<String> {
    serde_json::to_string_pretty(script).context("the script")
}

fn replay(path: &Path, args: &CampaignArgs, stop: &AtomicBool) -> anyhow::Result<Exit> {
    let text = bounded::read_to_string(path, bounded::WRITTEN_MAX)
        .with_context(|| format!("cannot read the fault script {}", path.display()))
        .or_exit(Exit::Usage)?;
    let script =
        Script::parse(&text).with_context(|| path.display().to_string()).or_exit(Exit::Usage)?;
    let flight = if args.real_time {
        CampaignFlight::of(0, real_time::flown(&script, &args.out.join("script"), stop)?)
    } else {
        flown(0, &script).or_exit(Exit::Usage)?
    };
    if args.json {
        print_json(&flight)?;
    } else {
        let ending = flight.ending.map_or("none".to_owned(), ending_name);
        let mut text = format!(
            "ended   {ending}: {}\nflown   {:.1} s, {} setpoints, digest {:08x}\n",
            flight.end, flight.simulated_s, flight.setpoints, flight.digest
        );
        text += &violations_text(&flight.violations);
        print_text(&text)?;
    }
    Ok(if flight.violations.is_empty() { Exit::Ok } else { Exit::Check })
}

fn open(args: &CampaignArgs) -> anyhow::Result<Folder<CampaignFlight>> {
    let header = Header {
        schema: "downwash.campaign".to_owned(),
        schema_version: 1,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        manifest_sha256: format!(
            "seed {}{}",
            args.seed,
            if args.real_time { " in real time" } else { "" }
        ),
        points: args.flights,
    };
    Folder::open(&args.out, "campaign.json", &header)
}

/// Flies one script in lockstep.
fn flown(index: usize, script: &Script) -> anyhow::Result<CampaignFlight> {
    Ok(CampaignFlight::of(index, bench::fly(script, &kit(script)?)?))
}

struct Campaign<'a> {
    args: &'a CampaignArgs,
    folder: Folder<CampaignFlight>,
}

impl Campaign<'_> {
    /// A flight; `None` where it was interrupted.
    fn flight(&self, index: usize, stop: &AtomicBool) -> Option<CampaignFlight> {
        let script = draw::script(self.args.seed, index as u64);
        let flight = if self.args.real_time {
            let folder = self.args.out.join(format!("flight-{index}"));
            real_time::flown(&script, &folder, stop).map(|flown| CampaignFlight::of(index, flown))
        } else {
            flown(index, &script)
        };
        if flight.is_err() && stop.load(Ordering::Relaxed) {
            return None;
        }
        Some(flight.unwrap_or_else(|error| CampaignFlight::not_flown(index, &error)))
    }

    /// Flies the shard's missing flights; returns how many it flew.
    fn fly(&self, stop: &AtomicBool) -> anyhow::Result<usize> {
        let done = self.folder.done()?;
        let own = (0..self.args.flights).filter(|index| self.args.shard.has(*index));
        let missing: Vec<usize> = own.filter(|index| !done.contains(index)).collect();
        let bar = count_bar(missing.len() as u64);
        let rows = Mutex::new((self.folder.append(self.args.shard)?, 0));
        missing.par_iter().with_max_len(1).try_for_each(|index| {
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let Some(flight) = self.flight(*index, stop) else { return Ok(()) };
            let mut rows = rows.lock().unwrap_or_else(PoisonError::into_inner);
            let (file, flown): &mut (Rows<CampaignFlight>, usize) = &mut rows;
            *flown += 1;
            bar.set_position(*flown as u64);
            file.add(&flight)
        })?;
        bar.finish_and_clear();
        Ok(rows.into_inner().unwrap_or_else(PoisonError::into_inner).1)
    }

    fn summary(&self, stop: &AtomicBool) -> anyhow::Result<CampaignSummary> {
        let rows = self.folder.rows()?;
        let mut endings = BTreeMap::new();
        let mut coverage = Coverage::default();
        let mut failed = Vec::new();
        for row in rows.values() {
            let name = row.ending.map_or("none".to_owned(), ending_name);
            *endings.entry(name).or_default() += 1;
            let pairs = row.coverage.iter().cloned();
            coverage.add(&Coverage::of(pairs.map(|(state, fault)| (state, fault, 1))));
            if row.violations.is_empty() && row.failure.is_none() {
                continue;
            }
            let is_shrunk = failed.len() < SHRUNK_MAX && !stop.load(Ordering::Relaxed);
            failed.push(Failed {
                index: row.index,
                violations: row.violations.clone(),
                failure: row.failure.clone(),
                script: if is_shrunk { self.shrunk(row)? } else { None },
            });
        }
        let is_clean = failed.is_empty() && !rows.is_empty();
        let covered = coverage.pairs().map(|(state, fault, flights)| Covered {
            state: state.to_owned(),
            fault: fault.to_owned(),
            flights,
        });
        Ok(CampaignSummary {
            schema: "downwash.campaign",
            schema_version: 1,
            version: env!("CARGO_PKG_VERSION"),
            seed: self.args.seed,
            real_time: self.args.real_time,
            flights: self.args.flights,
            done: rows.len(),
            setpoints: rows.values().map(|row| row.setpoints).sum(),
            simulated_h: rows.values().map(|row| row.simulated_s).sum::<f64>() / 3600.0,
            endings,
            bound_95: is_clean.then(|| 3.0 / rows.len() as f64),
            failed,
            coverage: covered.collect(),
        })
    }

    /// Writes the shortest script that fails as this flight did.
    fn shrunk(&self, row: &CampaignFlight) -> anyhow::Result<Option<PathBuf>> {
        let Some(first) = row.violations.first().filter(|_| !self.args.real_time) else {
            return Ok(None);
        };
        let path = self.args.out.join(format!("failed-{}.json", row.index));
        if !path.exists() {
            let drawn = draw::script(self.args.seed, row.index as u64);
            let fails = |script: &Script| {
                let again = flown(row.index, script);
                again.is_ok_and(|it| it.violations.iter().any(|found| found.rule == first.rule))
            };
            write_file(&path, (script_text(&shrunk(&drawn, fails))? + "\n").as_bytes())?;
        }
        Ok(Some(path))
    }
}

fn ending_name(ending: Ending) -> String {
    serde_json::to_value(ending)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

fn violations_text(violations: &[Violation]) -> String {
    let line = |it: &Violation| format!("broken  {:?} at {:.3} s: {}\n", it.rule, it.at_s, it.what);
    violations.iter().map(line).collect()
}

/// The text for stdout.
fn text(summary: &CampaignSummary) -> String {
    let CampaignSummary { seed, flights, done, setpoints, simulated_h, failed, .. } = summary;
    let is_real_time = &summary.real_time;
    let mut text = format!(
        "{done} of {flights} flights of seed {seed}, {simulated_h:.1} h, {setpoints} setpoints: \
         {} failed\n",
        failed.len()
    );
    for (ending, count) in &summary.endings {
        text += &format!("{ending:12}{count:8}\n");
    }
    if let Some(bound) = summary.bound_95 {
        text += &format!("with 95 % confidence fewer than 1 in {:.0} fail\n", 1.0 / bound);
    }
    text += &coverage_text(&summary.coverage);
    for flight in failed {
        text += &format!("flight {} of seed {seed}:\n", flight.index);
        text += &flight.failure.iter().map(|why| format!("        {why}\n")).collect::<String>();
        text += &violations_text(&flight.violations);
        if let Some(script) = &flight.script {
            text += &format!("shrunk  downwash campaign --script {}\n", script.display());
        }
        let index = flight.index;
        text += &format!(
            "again   downwash campaign --seed {seed} --draw {index} > script.json && downwash \
             campaign --script script.json{}\n",
            if *is_real_time { " --real-time" } else { "" }
        );
    }
    text
}

/// Flights by fault, a row, and state of the flight, a column.
fn coverage_text(coverage: &[Covered]) -> String {
    let mut states: Vec<&str> = coverage.iter().map(|it| it.state.as_str()).collect();
    states.sort_unstable();
    states.dedup();
    let mut faults: Vec<&str> = coverage.iter().map(|it| it.fault.as_str()).collect();
    faults.sort_unstable();
    faults.dedup();
    let mut text = format!("{:16}", "");
    for state in &states {
        text += &format!("{:>9}", state.chars().take(8).collect::<String>());
    }
    text.push('\n');
    for fault in faults {
        text += &format!("{fault:16}");
        for state in &states {
            let flights = coverage.iter().find(|it| it.state == *state && it.fault == fault);
            text += &format!("{:>9}", flights.map_or(0, |it| it.flights));
        }
        text.push('\n');
    }
    text
}
