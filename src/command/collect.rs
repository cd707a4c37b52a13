//! `downwash collect`: a programme of flights that a model can be learned from, one log each.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::course::Course;
use super::demo::progress_bar;
use super::fly::{Flown, baud, endpoint, fly_once};
use super::setup::{VehicleFile, capability, required, run_info, station_settings};
use super::simulation::{SimulatedFlight, Truth};
use super::stop::StopSignals;
use super::{Exit, ExitContext, config, print_json, print_text, say, summary, write_file};
use crate::cli::CollectArgs;
use crate::config::Config;
use crate::log::LogReader;
use crate::log::info::{LogInfo, TrackingInfo};
use crate::plan::Feasibility;
use crate::plan::programme::{FlightKind, ProgrammeFlight, programme};
use crate::supervisor::EngagePolicy;

/// Charge of the simulated pack at the start of each flight, over the configured one: what sags
/// with the pack is seen from full to half empty.
const CHARGES: [f64; 4] = [1.0, 0.7, 0.85, 0.55];
/// Key of a log's metadata that says which flight of which programme it holds.
const FINGERPRINT: &str = "collect_flight";
/// A log is whole if it holds the trajectory but for so much, s.
const MISSING_MAX_S: f64 = 0.25;
/// How often signals are looked at while flights are simulated.
const WATCH_PERIOD: Duration = Duration::from_millis(50);
/// How long a signal is waited for before each flight with a vehicle.
const BETWEEN_FLIGHTS: Duration = Duration::from_millis(1);

/// The JSON of `collect`.
#[derive(Serialize)]
pub(super) struct CollectSummary {
    schema: &'static str,
    schema_version: u32,
    vehicle: String,
    simulated: bool,
    seed: u64,
    /// Length of the programme's trajectories, s.
    planned_s: f64,
    /// Length that whole or partial flights were tracked for, s.
    tracked_s: f64,
    /// Control ticks along trajectories.
    samples: u64,
    /// Time that this run took, s.
    wall_s: f64,
    flights: Vec<FlightRow>,
}

/// One flight of the programme.
#[derive(Clone, Serialize)]
struct FlightRow {
    name: String,
    kind: FlightKind,
    /// Length of the trajectory, s.
    planned_s: f64,
    /// The most that the trajectory asks for.
    demands: Feasibility,
    /// `planned`, `done`, `kept` (its log was there), or why it ended otherwise.
    end: String,
    /// Time along the trajectory, s.
    tracked_s: f64,
    /// Control ticks along the trajectory.
    samples: u64,
    tracking: Option<TrackingInfo>,
    log: Option<PathBuf>,
    #[serde(skip)]
    exit: Exit,
}

impl FlightRow {
    fn planned(flight: &ProgrammeFlight) -> Self {
        Self {
            name: flight.name.clone(),
            kind: flight.kind,
            planned_s: flight.trajectory.duration(),
            demands: flight.demands,
            end: "planned".to_owned(),
            tracked_s: 0.0,
            samples: 0,
            tracking: None,
            log: None,
            exit: Exit::Ok,
        }
    }

    /// A flight that was flown, with what its log says.
    fn flown(flight: &ProgrammeFlight, end: &str, exit: Exit, log: Option<&LogOf>) -> Self {
        let tracking = log.and_then(|log| log.tracking);
        Self {
            end: end.to_owned(),
            tracked_s: log.map_or(0.0, |log| log.tracked_s),
            samples: tracking.map_or(0, |tracking| tracking.ticks),
            tracking,
            log: log.map(|log| log.path.clone()),
            exit,
            ..Self::planned(flight)
        }
    }
}

pub(super) fn run(args: &CollectArgs) -> anyhow::Result<Exit> {
    let mut flags = Vec::new();
    if let Some(url) = &args.connect {
        flags.push(("--connect", "connect", toml::Value::String(url.clone())));
    }
    let config = config::load(args.config.as_deref(), flags)?;
    let vehicle = match (&args.vehicle, &args.connect) {
        (Some(path), _) => VehicleFile::load(path)?,
        (None, Some(_)) => {
            VehicleFile::load(&required(&config.settings.vehicle, "--vehicle", "vehicle")?)?
        }
        (None, None) => VehicleFile::built_in()?,
    };
    let (summary, exit) = gather(args, &config, &vehicle)?;
    if args.json {
        print_json(&summary)?
    } else {
        print_text(&table(&summary))?
    }
    Ok(exit)
}

/// Flies what of the programme has no whole log yet, or only lists it.
pub(super) fn gather(
    args: &CollectArgs,
    config: &Config,
    vehicle: &VehicleFile,
) -> anyhow::Result<(CollectSummary, Exit)> {
    let flights = programme(
        &config.settings.collect,
        &config.settings.envelope,
        &capability(&vehicle.params, &config.settings.control)?,
        args.seconds,
        args.combined,
        args.seed,
    )
    .or_exit(Exit::Usage)?;
    let started = Instant::now();
    let (rows, exit) = if let Some(folder) = &args.write_trajectories {
        for flight in &flights {
            fs::create_dir_all(folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
            write_file(&folder.join(format!("{}.toml", flight.name)), flight.text.as_bytes())?;
        }
        (flights.iter().map(FlightRow::planned).collect(), Exit::Ok)
    } else if args.list {
        (flights.iter().map(FlightRow::planned).collect(), Exit::Ok)
    } else {
        fly(args, config, vehicle, &flights)?
    };
    let summary = CollectSummary {
        schema: "downwash.collect",
        schema_version: 1,
        vehicle: vehicle.params.name.clone(),
        simulated: args.connect.is_none(),
        seed: args.seed,
        planned_s: rows.iter().map(|row| row.planned_s).sum(),
        tracked_s: rows.iter().map(|row| row.tracked_s).sum(),
        samples: rows.iter().map(|row| row.samples).sum(),
        wall_s: started.elapsed().as_secs_f64(),
        flights: rows,
    };
    Ok((summary, exit))
}

impl CollectSummary {
    /// The logs that were flown or kept.
    pub fn logs(&self) -> Vec<PathBuf> {
        self.flights.iter().filter_map(|flight| flight.log.clone()).collect()
    }
}

/// Flies what has no whole log yet. Every flight of the programme gets a row, and the worst end
/// the exit code.
fn fly(
    args: &CollectArgs,
    config: &Config,
    vehicle: &VehicleFile,
    flights: &[ProgrammeFlight],
) -> anyhow::Result<(Vec<FlightRow>, Exit)> {
    let mut signals = StopSignals::new()?;
    fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let truth = args.connect.is_none().then(|| Truth::load(&args.simulation)).transpose()?;
    let identity = Identity { config, vehicle, truth: truth.as_ref(), seed: args.seed };
    let logs = logs_of_flights(&args.out)?;
    let (mut rows, mut ahead) = (Vec::new(), Vec::new());
    for (index, flight) in flights.iter().enumerate() {
        let fingerprint = identity.fingerprint(flight)?;
        let whole = |log: &&LogOf| log.is_whole(flight.trajectory.duration());
        let here = || logs.get(&fingerprint).into_iter().flatten();
        if let Some(log) = here().find(whole) {
            rows.push(FlightRow::flown(flight, "kept", Exit::Ok, Some(log)));
            continue;
        }
        // A simulated flight that was cut short is the beginning of the one that replaces it.
        if truth.is_some() {
            for log in here() {
                fs::remove_file(&log.path)
                    .with_context(|| format!("cannot replace {}", log.path.display()))?;
            }
        }
        ahead.push((index, fingerprint));
        rows.push(FlightRow::planned(flight));
    }
    let length = ahead.iter().map(|(index, _)| flights[*index].trajectory.duration()).sum();
    let flown = match &truth {
        Some(truth) => {
            let simulator = Simulator {
                config,
                vehicle,
                truth,
                folder: &args.out,
                progress: progress_bar(length),
                stopping: AtomicBool::new(false),
            };
            let jobs = args.jobs.or(thread::available_parallelism().ok()).map_or(1, usize::from);
            let flown = simulator.fly_all(flights, &ahead, jobs, &mut signals);
            simulator.progress.finish_and_clear();
            flown?
        }
        None => fly_vehicle(&args.out, config, vehicle, flights, &ahead, &mut signals)?,
    };
    for (index, row) in flown {
        rows[index] = row;
    }
    let exit = rows.iter().map(|row| row.exit).max_by_key(|exit| gravity(*exit));
    Ok((rows, exit.unwrap_or(Exit::Ok)))
}

/// Which of several ends the exit code tells.
fn gravity(exit: Exit) -> u8 {
    match exit {
        Exit::Ok => 0,
        Exit::Aborted => 1,
        Exit::Refused => 2,
        Exit::Link => 3,
        Exit::Check | Exit::Usage | Exit::Failure | Exit::Model => 4,
        Exit::Interrupted => 5,
    }
}

/// What makes two flights the same.
struct Identity<'a> {
    config: &'a Config,
    vehicle: &'a VehicleFile,
    truth: Option<&'a Truth>,
    seed: u64,
}

impl Identity<'_> {
    /// A digest of everything that the flight depends on.
    fn fingerprint(&self, flight: &ProgrammeFlight) -> anyhow::Result<String> {
        let mut parts = vec![flight.name.clone(), flight.text.clone(), self.vehicle.text.clone()];
        match self.truth {
            Some(truth) => {
                parts.push(self.seed.to_string());
                parts.push(self.config.to_toml());
                parts.push(truth.effects_text()?);
                parts.push(toml::to_string(&truth.config).context("the SITL configuration")?);
            }
            // On another link or with other gains it still is this flight of this vehicle.
            None => parts.push("real".to_owned()),
        }
        let mut digest = Sha256::new();
        for part in &parts {
            digest.update((part.len() as u64).to_le_bytes());
            digest.update(part.as_bytes());
        }
        Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

/// What a log holds of a flight.
struct LogOf {
    path: PathBuf,
    finished: bool,
    tracked_s: f64,
    tracking: Option<TrackingInfo>,
}

impl LogOf {
    /// Reads a log.
    fn read(path: &Path) -> anyhow::Result<(Option<String>, Self)> {
        let mut reader = LogReader::open(path)?;
        let info = LogInfo::read(&mut reader)?;
        let track = info.phases.iter().filter(|phase| phase.name == "track");
        let log = Self {
            path: path.to_owned(),
            finished: info.finished && info.damaged == 0,
            // The empty sum of f64 is -0.
            tracked_s: track.fold(0.0, |sum, phase| sum + phase.duration_s),
            tracking: info.tracking,
        };
        Ok((info.run.get(FINGERPRINT).cloned(), log))
    }

    fn is_whole(&self, length_s: f64) -> bool {
        self.finished && self.tracked_s >= length_s - MISSING_MAX_S
    }
}

/// The logs in a folder that are of a programme's flights, by fingerprint, in order of their names.
fn logs_of_flights(folder: &Path) -> anyhow::Result<BTreeMap<String, Vec<LogOf>>> {
    let context = || format!("cannot read the folder {}", folder.display());
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).with_context(context)? {
        let path = entry.with_context(context)?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            paths.push(path);
        }
    }
    paths.sort();
    let mut logs: BTreeMap<String, Vec<LogOf>> = BTreeMap::new();
    let read: Vec<_> = paths.par_iter().map(|path| LogOf::read(path)).collect();
    for (path, read) in paths.iter().zip(read) {
        match read {
            Ok((Some(fingerprint), log)) => logs.entry(fingerprint).or_default().push(log),
            Ok((None, _)) => {}
            Err(error) => say(format_args!("{}: left alone: {error:#}", path.display())),
        }
    }
    Ok(logs)
}

/// Flies the simulated vehicle.
struct Simulator<'a> {
    config: &'a Config,
    vehicle: &'a VehicleFile,
    truth: &'a Truth,
    folder: &'a Path,
    progress: ProgressBar,
    /// No other flight begins.
    stopping: AtomicBool,
}

impl Simulator<'_> {
    /// Flies in `jobs` threads until all is flown or a signal asks for the end, which waits for
    /// the flights that are in the air. Each row comes with its flight's index.
    fn fly_all(
        &self,
        flights: &[ProgrammeFlight],
        ahead: &[(usize, String)],
        jobs: usize,
        signals: &mut StopSignals,
    ) -> anyhow::Result<Vec<(usize, FlightRow)>> {
        let next = AtomicUsize::new(0);
        let rows = Mutex::new(Vec::new());
        let worker = || -> anyhow::Result<()> {
            while !self.stopping.load(Ordering::Acquire) {
                let turn = next.fetch_add(1, Ordering::Relaxed);
                let Some((index, fingerprint)) = ahead.get(turn) else { break };
                let row = self.fly(&flights[*index], *index, fingerprint)?;
                if let Ok(mut rows) = rows.lock() {
                    rows.push((*index, row));
                }
            }
            Ok(())
        };
        thread::scope(|scope| {
            let workers: Vec<_> = (0..jobs.min(ahead.len())).map(|_| scope.spawn(worker)).collect();
            while !workers.iter().all(|worker| worker.is_finished()) {
                if signals.wait(WATCH_PERIOD).is_some() {
                    self.stopping.store(true, Ordering::Release);
                }
            }
            for worker in workers {
                match worker.join() {
                    Ok(result) => result?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            Ok::<_, anyhow::Error>(())
        })?;
        let mut rows = rows.into_inner().unwrap_or_default();
        rows.sort_by_key(|(index, _)| *index);
        if signals.first().is_some() {
            let flown: Vec<usize> = rows.iter().map(|(index, _)| *index).collect();
            for (index, _) in ahead.iter().filter(|(index, _)| !flown.contains(index)) {
                let row = FlightRow::planned(&flights[*index]);
                rows.push((*index, FlightRow { exit: Exit::Interrupted, ..row }));
            }
        }
        Ok(rows)
    }

    fn fly(
        &self,
        flight: &ProgrammeFlight,
        index: usize,
        fingerprint: &str,
    ) -> anyhow::Result<FlightRow> {
        let mut truth = self.truth.clone();
        truth.config.battery.charge *= CHARGES[index % CHARGES.len()];
        let mut extra = metadata(flight, fingerprint);
        extra.insert("battery_charge".to_owned(), truth.config.battery.charge.to_string());
        let simulated = SimulatedFlight {
            config: self.config,
            vehicle: self.vehicle,
            airframe: &self.vehicle.params,
            truth: &truth,
            course: &Course::Desired(flight.trajectory.clone()),
            run: &flight.name,
            seed: flight.seed,
            extra,
        };
        let mut shown = 0;
        let flown = simulated.fly(self.folder, |status| {
            let tenths = (status.progress.map_or(0.0, |(t, _)| t) * 10.0) as u64;
            self.progress.inc(tenths.saturating_sub(shown));
            shown = shown.max(tenths);
        });
        let flown = flown.with_context(|| flight.name.clone())?;
        self.progress.set_message(flight.name.clone());
        let (end, exit) = summary::end_in_words(Some(&flown.end), None);
        let (_, log) = LogOf::read(&flown.log)?;
        Ok(FlightRow::flown(flight, &end, exit, Some(&log)))
    }
}

/// What a flight's log says about its place in the programme.
fn metadata(flight: &ProgrammeFlight, fingerprint: &str) -> BTreeMap<String, String> {
    BTreeMap::from([
        (FINGERPRINT.to_owned(), fingerprint.to_owned()),
        ("collect_kind".to_owned(), flight.kind.name().to_owned()),
        ("trajectory".to_owned(), flight.text.clone()),
    ])
}

/// Flies a vehicle on a link, one flight after the other. A flight that ends otherwise than
/// planned ends the programme: somebody has to look at the vehicle first.
fn fly_vehicle(
    folder: &Path,
    config: &Config,
    vehicle: &VehicleFile,
    flights: &[ProgrammeFlight],
    ahead: &[(usize, String)],
    signals: &mut StopSignals,
) -> anyhow::Result<Vec<(usize, FlightRow)>> {
    let url = required(&config.settings.connect, "--connect", "connect")?;
    let mut rows = Vec::new();
    for (turn, (index, fingerprint)) in ahead.iter().enumerate() {
        let flight = &flights[*index];
        // What came after the last flight's end.
        if signals.wait(BETWEEN_FLIGHTS).is_some() {
            let row = FlightRow::planned(flight);
            rows.push((*index, FlightRow { exit: Exit::Interrupted, ..row }));
            break;
        }
        say(format_args!("flight {} of {}: {}", turn + 1, ahead.len(), flight.name));
        let endpoint = endpoint(&url)?;
        let settings = station_settings(
            config,
            vehicle,
            &Course::Desired(flight.trajectory.clone()),
            EngagePolicy::Command,
            baud(&endpoint),
        )?;
        let mut info = run_info(config, vehicle, &flight.name, false, None);
        info.extra = metadata(flight, fingerprint);
        let Flown { end, exit, log } = fly_once(settings, endpoint, folder, &info, None, signals)?;
        let log = log.as_deref().map(LogOf::read).transpose()?.map(|(_, log)| log);
        let log = log.ok_or_else(|| anyhow!("{}: its log was not written", flight.name))?;
        rows.push((*index, FlightRow::flown(flight, &end, exit, Some(&log))));
        if exit != Exit::Ok {
            say(format_args!("flight {}: {end}; run the command again to go on", flight.name));
            break;
        }
    }
    Ok(rows)
}

fn table(summary: &CollectSummary) -> String {
    let heads =
        ["planned/s", "tracked/s", "samples", "speed m/s", "tilt/deg", "yaw deg/s", "RMSE/m"];
    let heads = heads.map(|head| format!("{head:>10}")).concat();
    let mut text = format!("{:<28}{heads}  end\n", "flight");
    for row in &summary.flights {
        let rmse = row.tracking.map_or("-".to_owned(), |t| format!("{:.3}", t.rmse_3d_m));
        let demands = &row.demands;
        text += &format!(
            "{:<28}{:>10.1}{:>10.1}{:>10}{:>10.2}{:>10.1}{:>10.0}{rmse:>10}  {}\n",
            row.name,
            row.planned_s,
            row.tracked_s,
            row.samples,
            demands.speed_m_s,
            demands.tilt_deg,
            demands.yaw_rate_deg_s,
            row.end
        );
    }
    text += &format!(
        "{:<28}{:>10.1}{:>10.1}{:>10}  in {:.1} s\n",
        "all", summary.planned_s, summary.tracked_s, summary.samples, summary.wall_s
    );
    text
}
