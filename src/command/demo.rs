//! `downwash demo`: the whole flight on the simulated vehicle, in lockstep.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use sitl::effects::EffectSet;

use super::setup::{VehicleFile, built_in_trajectory, checked_trajectory};
use super::simulation::{Simulated, SimulatedFlight, Truth};
use super::{Exit, ExitContext, config, print_json, print_text, say, summary, write_file};
use crate::cli::DemoArgs;
use crate::log::LogReader;
use crate::plan::Trajectory;
use crate::report::flight::{FlightReport, FlightSummary};
use crate::station::End;

/// The JSON of `demo`, and its summary.json.
#[derive(Serialize)]
struct DemoSummary {
    schema: &'static str,
    schema_version: u32,
    end: String,
    seed: u64,
    trajectory: String,
    /// Effects of the simulated vehicle that the daemon did not know.
    effects: EffectSet,
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
    let truth = Truth::load(&args.simulation)?;
    let (trajectory, _) = checked_trajectory(trajectory, &vehicle.params, &config)?;
    let name = trajectory.name().to_owned();
    let progress = progress_bar(trajectory.duration());
    let flight = SimulatedFlight {
        config: &config,
        vehicle: &vehicle,
        truth: &truth,
        trajectory,
        run: &name,
        seed: args.seed,
        extra: BTreeMap::new(),
    };
    let wall = Instant::now();
    let flown = flight.fly(&args.out, |status| {
        progress.set_position((status.progress.map_or(0.0, |(t, _)| t) * 10.0) as u64);
        progress.set_message(status.phase.map_or("connect", |phase| phase.name()));
    });
    let wall_s = wall.elapsed().as_secs_f64();
    progress.finish_and_clear();
    let Simulated { end, log, simulated_s } = flown?;

    let report = report(&log)?;
    let report_path = args.out.join("report.html");
    write_file(&report_path, report.to_html().as_bytes())?;
    let (words, exit) = summary::end_in_words(Some(&end), None);
    let summary = DemoSummary {
        schema: "downwash.demo",
        schema_version: 1,
        end: words,
        seed: args.seed,
        trajectory: name,
        effects: truth.effects,
        simulated_s,
        wall_s,
        real_time_factor: simulated_s / wall_s,
        log,
        report: report_path,
        flight: report.summary().clone(),
    };
    let json = serde_json::to_vec_pretty(&summary).context("summary.json")?;
    write_file(&args.out.join("summary.json"), &json)?;
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

/// A bar over so many seconds of trajectory, in tenths; nothing where stderr is no terminal.
pub(super) fn progress_bar(length_s: f64) -> ProgressBar {
    let target = if std::io::stderr().is_terminal() {
        ProgressDrawTarget::stderr_with_hz(10)
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some((length_s * 10.0) as u64), target);
    let style = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
