//! `downwash fly`: one flight, from preflight to landing.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;
use wire::Endpoint;

use super::audience::Audience;
use super::course::Course;
use super::goal_file::GoalFile;
use super::lap_course::{Clock, lap_course};
use super::output::create_folder;
use super::setup::{endpoint, law_flag, path_flag, required, run_info, station_settings};
use super::signing_state::SigningState;
use super::stop::StopSignals;
use super::vehicle_file::VehicleFile;
use super::{
    Exit, ExitContext, Interruption, config, plan, print_json, print_status, print_text, summary,
};
use crate::cli::FlyArgs;
use crate::config::Config;
use crate::daemon::{self, Finished, HostClock, Outlets, Running};
use crate::lap_learning::LapLearner;
use crate::link::connection::Connection;
use crate::link::tee::TeeThread;
use crate::log::partial::is_special;
use crate::log::writer::{LogError, create_numbered};
use crate::log::{LogSink, LogWriter, RunInfo};
use crate::plan::Trajectory;
use crate::plan::receding::RecedingReference;
use crate::report::flight::FlightSummary;
use crate::station::{Station, StationSettings};
use crate::supervisor::EngagePolicy;

/// Period of the status line, and of checks for signals.
const WATCH_PERIOD: Duration = Duration::from_millis(100);

/// The JSON of `fly`.
#[derive(JsonSchema, Serialize)]
pub(super) struct FlySummary {
    schema: &'static str,
    schema_version: u32,
    end: String,
    trajectory: String,
    log: Option<PathBuf>,
    flight: Option<FlightSummary>,
}

pub(super) fn run(args: &FlyArgs, preparation: Interruption) -> anyhow::Result<Exit> {
    let mut flags = Vec::new();
    flags.extend(path_flag("--vehicle", "vehicle", &args.vehicle));
    flags.extend(path_flag("--log-dir", "log_dir", &args.log_dir));
    flags.extend(args.law.map(law_flag));
    if args.take_over {
        let key = "offboard.supervisor.take_over";
        flags.push(("--take-over", key, toml::Value::Boolean(true)));
    }
    if let Some(url) = &args.connect {
        flags.push(("--connect", "connect", toml::Value::String(url.clone())));
    }
    flags.extend(system_flag(args.system));
    let config = config::load(args.config.as_deref(), flags)?;
    let settings = &config.settings;
    let vehicle = VehicleFile::load(&required(&settings.vehicle, "--vehicle", "vehicle")?)?;
    let endpoint = endpoint(&required(&settings.connect, "--connect", "connect")?)?;
    let (mut learner, mut _goal_file) = (None, None);
    let course = if args.learning.learn.is_some() {
        let (course, own) = learned(args, &vehicle, &config)?;
        learner = Some(own);
        course
    } else if args.replan {
        let (course, file) = replanned(args, &vehicle, &config)?;
        _goal_file = Some(file);
        course
    } else {
        Course::load(&args.trajectory, &vehicle, &config)?
    };
    let name = course.name().to_owned();
    let policy = EngagePolicy::Command;
    let mut station_settings =
        station_settings(&config, &vehicle, &course, policy, Some(&endpoint))?;
    let signing = SigningState::open(&settings.link.signing)?;
    station_settings.session.signing = signing.as_ref().map(SigningState::settings);

    if args.check {
        let signals = StopSignals::after(Some(preparation))?;
        return check(station_settings, endpoint, signals, args.json);
    }
    let log_dir = settings.log_dir.clone().unwrap_or_else(|| PathBuf::from("."));
    create_folder("--log-dir", &log_dir)?;
    let info = run_info(&config, &vehicle, &name, false, None);
    let tee = args.tlog.as_deref().map(tee).transpose()?;
    let mut signals = StopSignals::after(Some(preparation))?;
    let audience = Audience::start_for_flight(&args.view, &config, &info, &course)?
        .forwarding(&args.forward, &config)?;
    let audience = audience.monitored(&vehicle.params, &config)?.learning(learner)?;
    let audience = audience.served(&args.service)?.on_screen(args.tui, &info)?;
    let run = Run { settings: station_settings, endpoint, tee, audience };
    let Flown { end, exit, log } = run.fly(&log_dir, &info, &mut signals)?;
    let flight =
        log.as_deref().map(summary::report_on).transpose()?.map(|report| report.summary().clone());
    if exit != Exit::Ok {
        print_status(format_args!("flight {end}"));
    }
    if args.json {
        print_json(&FlySummary {
            schema: "downwash.fly",
            schema_version: 1,
            end,
            trajectory: name,
            log,
            flight,
        })?;
    } else {
        let table = flight.map(|flight| summary::flight_table(&flight, &end)).unwrap_or_default();
        let log = log.map(|log| format!("log     {}\n", log.display())).unwrap_or_default();
        print_text(&format!("{table}{log}"))?;
    }
    Ok(exit)
}

/// Time for the checks before a flight, s.
const CHECK_LIMIT_S: f64 = 10.0;

/// The JSON of `fly --check`.
#[derive(JsonSchema, Serialize)]
pub(super) struct CheckSummary {
    schema: &'static str,
    schema_version: u32,
    end: String,
}

/// The checks before a flight, and no flight.
fn check(
    mut settings: StationSettings,
    endpoint: Endpoint,
    mut signals: StopSignals,
    json: bool,
) -> anyhow::Result<Exit> {
    settings.offboard.supervisor.ready_timeout_s = CHECK_LIMIT_S;
    let clock = HostClock::start();
    // A log begins with a flight, and a check flies none.
    let none = |_| {
        Err(LogError::Create { path: PathBuf::new(), source: io::ErrorKind::Unsupported.into() })
    };
    let sink =
        LogSink::per_flight(Box::new(none), Vec::new()).context("cannot start the log's thread")?;
    let station = Station::new(settings, clock.now()).checking();
    let outlets = Outlets { tee: None, sink, guests: None, changes: None };
    let running = daemon::start(station, clock, Connection::new(endpoint), outlets)
        .context("cannot start the control thread")?;
    let finished = watch(running, clock, &mut Audience::default(), &mut signals);
    let (end, exit) = summary::end_text(finished.end.as_ref(), signals.first());
    if json {
        print_json(&CheckSummary { schema: "downwash.check", schema_version: 1, end })?;
    } else {
        print_text(&format!("{end}\n"))?;
    }
    Ok(exit)
}

/// Makes laps of the trajectory, planned in flight, and their learner.
fn learned(
    args: &FlyArgs,
    vehicle: &VehicleFile,
    config: &Config,
) -> anyhow::Result<(Course, LapLearner)> {
    let lap = Trajectory::load(&args.trajectory).or_exit(Exit::Usage)?;
    let plan_model = plan::model_for(&vehicle.params, args.model.as_deref(), args.kind)?;
    lap_course(&args.learning, lap, &plan_model, vehicle, config, Clock::Wall)
}

/// The trajectory as a goal that is replanned in flight and that changes of its file move.
fn replanned(
    args: &FlyArgs,
    vehicle: &VehicleFile,
    config: &Config,
) -> anyhow::Result<(Course, GoalFile)> {
    let goal = Trajectory::load(&args.trajectory).or_exit(Exit::Usage)?;
    let plan_model = plan::model_for(&vehicle.params, args.model.as_deref(), args.kind)?;
    let (planner, answer) = plan::planner(&vehicle.params, &plan_model, config)?;
    let is_own_loop = vehicle.params.attitude_pd.is_none();
    let settings = config.settings.plan.receding.for_loop(is_own_loop);
    let reference = RecedingReference::threaded(goal.clone(), planner, answer, settings)
        .context("cannot start the planning thread")?;
    let file = GoalFile::watch(
        &args.trajectory,
        reference.goal(),
        config.settings.envelope,
        vehicle.params.gravity,
    )?;
    let course = Course::Receding { goal, reference: Arc::new(reference) };
    course.check(vehicle, config)?;
    Ok((course, file))
}

/// How a flight went.
pub(super) struct Flown {
    /// The end in words.
    pub end: String,
    pub exit: Exit,
    /// The log, if it could be written.
    pub log: Option<PathBuf>,
}

/// The parts of one flight on a link.
pub(super) struct Run {
    pub settings: StationSettings,
    pub endpoint: Endpoint,
    pub tee: Option<TeeThread>,
    pub audience: Audience,
}

impl Run {
    /// One flight in real time, from preflight to landing.
    pub fn fly(
        self,
        log_dir: &Path,
        info: &RunInfo,
        signals: &mut StopSignals,
    ) -> anyhow::Result<Flown> {
        let Self { settings, endpoint, tee, mut audience } = self;
        let clock = HostClock::start();
        let writer = LogWriter::create(log_dir, info, clock.now(), Instant::now())?;
        let path = writer.path().to_owned();
        let sink = LogSink::threaded(writer, audience.take_listeners())?;
        let station = Station::new(settings, clock.now());
        let outlets =
            Outlets { tee, sink, guests: audience.take_guests(), changes: audience.take_changes() };
        let running = daemon::start(station, clock, Connection::new(endpoint), outlets)
            .context("cannot start the control thread")?;
        let finished = watch(running, clock, &mut audience, signals);
        print_tlog_loss(finished.tlog);
        let (end, exit) = summary::end_text(finished.end.as_ref(), signals.first());
        match finished.log {
            Ok(_) => Ok(Flown { end, exit, log: Some(path) }),
            Err(error) => {
                print_status(format_args!(
                    "{error}; {} holds what was written until then",
                    path.display()
                ));
                // A flight without its log is no success.
                let exit = if exit == Exit::Ok { Exit::Failure } else { exit };
                Ok(Flown { end, exit, log: None })
            }
        }
    }
}

/// Shows the status and waits for the end. The first Ctrl-C or SIGTERM requests a landing, the
/// second ends the stream.
pub(super) fn watch(
    running: Running,
    clock: HostClock,
    audience: &mut Audience,
    signals: &mut StopSignals,
) -> Finished {
    audience.begin();
    let mut stopping = false;
    while !running.is_done() {
        let key = audience.show(clock.now(), &running.status());
        key.into_iter().for_each(|stop| signals.request(stop));
        if signals.wait(WATCH_PERIOD).or(key).is_some() {
            if !stopping {
                tracing::warn!(
                    "stopping: a vehicle in flight lands; stop again to drop the stream at once"
                );
            }
            stopping = true;
            running.stop();
        }
    }
    audience.finish();
    running.join()
}

/// The system id of a vehicle as a configuration layer.
pub(super) fn system_flag(system: Option<u8>) -> Option<(&'static str, &'static str, toml::Value)> {
    system.map(|id| ("--system", "link.vehicle_system", toml::Value::Integer(id.into())))
}

/// Reports frames that a telemetry log lacks.
pub(super) fn print_tlog_loss(tlog: Option<io::Result<u64>>) {
    match tlog {
        None | Some(Ok(0)) => {}
        Some(Ok(dropped)) => print_status(format_args!(
            "the telemetry log lacks {dropped} messages: the disk was slower than the link"
        )),
        Some(Err(error)) => print_status(format_args!("the telemetry log ends early: {error}")),
    }
}

/// Opens the .tlog for every byte of the link. An existing log is kept, and the new one is beside
/// it; a device or a pipe is written to as it is.
pub(super) fn tee(path: &Path) -> anyhow::Result<TeeThread> {
    let created = match is_special(path) {
        true => File::create(path).map(|file| (file, path.to_owned())),
        false => create_numbered(path),
    };
    let (file, at) = created
        .with_context(|| format!("cannot create the telemetry log {}", path.display()))
        .or_exit(Exit::Usage)?;
    if at != path {
        print_status(format_args!("{} already exists: writing {}", path.display(), at.display()));
    }
    TeeThread::start(BufWriter::new(file)).context("cannot start the telemetry log's thread")
}
