//! `downwash demo`: the whole flight on the simulated vehicle, in lockstep.

use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use sitl::autopilot::Vehicle;
use sitl::config::SitlConfig;
use sitl::effects::EffectSet;

use super::setup::{
    EffectiveVehicle, VehicleFile, built_in_trajectory, checked_trajectory, run_info,
    station_settings,
};
use super::{Exit, ExitContext, config, print_json, print_text, say, summary};
use crate::cli::DemoArgs;
use crate::lockstep;
use crate::log::{LogReader, LogSink, LogWriter};
use crate::plan::Trajectory;
use crate::report::flight::{FlightReport, FlightSummary};
use crate::station::{End, Station};
use crate::supervisor::EngagePolicy;

/// Simulated time that connecting, take-off, the approach and landing may take beside the
/// trajectory, s.
const AROUND_S: f64 = 180.0;

/// The JSON of `demo`, and its summary.json.
#[derive(Serialize)]
struct DemoSummary {
    schema: &'static str,
    schema_version: u32,
    end: String,
    seed: u64,
    trajectory: String,
    /// Effects of the simulated vehicle that the daemon did not know.
    effects: Vec<String>,
    simulated_s: f64,
    wall_s: f64,
    real_time_factor: f64,
    log: PathBuf,
    report: PathBuf,
    flight: FlightSummary,
}

pub(super) fn run(args: &DemoArgs) -> anyhow::Result<Exit> {
    let config = config::load(args.config.as_deref(), vec![])?;
    let vehicle = match &args.vehicle {
        Some(path) => VehicleFile::load(path)?,
        None => VehicleFile::built_in()?,
    };
    let trajectory = match &args.trajectory {
        Some(path) => Trajectory::load(path).or_exit(Exit::Usage)?,
        None => built_in_trajectory()?,
    };
    let sitl_config = match &args.sitl_config {
        Some(path) => SitlConfig::load(path).or_exit(Exit::Usage)?,
        None => SitlConfig::default(),
    };
    let mut effects = EffectSet::new();
    for effect in &args.effect {
        effects.insert_argument(effect).or_exit(Exit::Usage)?;
    }
    let (trajectory, _) = checked_trajectory(trajectory, &vehicle.params, &config)?;
    let name = trajectory.name().to_owned();
    let limit_s = trajectory.duration() + AROUND_S;
    // Refuses a vehicle that cannot be controlled before anything is written.
    EffectiveVehicle::new(&vehicle.params)?;
    let mut simulated = Vehicle::new(vehicle.params.clone(), effects, sitl_config, args.seed)
        .or_exit(Exit::Usage)?;
    let settings = station_settings(&config, &vehicle, trajectory, EngagePolicy::Command, None)?;

    fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let info = run_info(&config, &vehicle, &name, true, Some(args.seed));
    let start = lockstep::host_time(0);
    let writer = LogWriter::create(&args.out, &info, start, Instant::now())?;
    let log_path = writer.path().to_owned();
    let mut sink = LogSink::direct(writer);
    let mut station = Station::new(settings, start);

    let progress = progress_bar(limit_s - AROUND_S);
    let wall = Instant::now();
    let end = lockstep::fly(
        &mut simulated,
        &mut station,
        limit_s,
        |record| sink.log(record),
        |station, _| {
            let status = station.status();
            progress.set_position((status.progress.map_or(0.0, |(t, _)| t) * 10.0) as u64);
            progress.set_message(status.phase.map_or("connect", |phase| phase.name()));
        },
    );
    let wall_s = wall.elapsed().as_secs_f64();
    progress.finish_and_clear();
    sink.finish()?;
    let end = end?;

    let simulated_s = simulated.now_us() as f64 * 1e-6;
    let report = report(&log_path)?;
    let report_path = args.out.join("report.html");
    write(&report_path, report.to_html().as_bytes())?;
    let (words, exit) = summary::end_in_words(Some(&end), None);
    let summary = DemoSummary {
        schema: "downwash.demo",
        schema_version: 1,
        end: words,
        seed: args.seed,
        trajectory: name,
        effects: args.effect.clone(),
        simulated_s,
        wall_s,
        real_time_factor: simulated_s / wall_s,
        log: log_path,
        report: report_path,
        flight: report.summary().clone(),
    };
    let json = serde_json::to_vec_pretty(&summary).context("summary.json")?;
    write(&args.out.join("summary.json"), &json)?;
    if args.json {
        print_json(&summary)?;
    } else {
        let table = summary::flight_table(&summary.flight, &summary.end);
        print_text(&format!(
            "{table}simulated {:.1} s in {:.2} s: {:.0} times real time\nreport  {}\nlog     {}\n",
            summary.simulated_s,
            summary.wall_s,
            summary.real_time_factor,
            summary.report.display(),
            summary.log.display()
        ))?;
    }
    if end != End::Done {
        say(format_args!("the flight did not end as planned: {}", summary.end));
    }
    Ok(exit)
}

/// The report on a log.
pub(super) fn report(log: &Path) -> anyhow::Result<FlightReport> {
    let mut reader = LogReader::open(log)?;
    Ok(FlightReport::read(&mut reader)?)
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let partial = path.with_extension("part");
    fs::write(&partial, bytes)
        .and_then(|()| fs::rename(&partial, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

fn progress_bar(length_s: f64) -> ProgressBar {
    let target = if std::io::stderr().is_terminal() {
        ProgressDrawTarget::stderr_with_hz(10)
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some((length_s * 10.0) as u64), target);
    let style = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
