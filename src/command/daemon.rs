//! `downwash daemon`: flies whenever the pilot hands the vehicle over.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;

use super::audience::Audience;
use super::course::Course;
use super::fly::{print_tlog_loss, tee, watch};
use super::output::create_folder;
use super::setup::endpoint;
use super::setup::{required, run_info, station_settings};
use super::signing_state::SigningState;
use super::stop::{Stop, StopSignals};
use super::vehicle_file::VehicleFile;
use super::{Exit, Interruption, config, print_status, summary};
use crate::cli::DaemonArgs;
use crate::daemon::{self, HostClock, Outlets};
use crate::link::connection::Connection;
use crate::log::{LogSink, LogWriter};
use crate::station::Station;
use crate::supervisor::EngagePolicy;

pub(super) fn run(args: &DaemonArgs, preparation: Interruption) -> anyhow::Result<Exit> {
    let config = config::load(Some(&args.config), vec![])?;
    let settings = &config.settings;
    let vehicle = VehicleFile::load(&required(&settings.vehicle, "vehicle", "vehicle")?)?;
    let endpoint = endpoint(&required(&settings.connect, "connect", "connect")?)?;
    let file = required(&settings.trajectory, "trajectory", "trajectory")?;
    let course = Course::load(&file, &vehicle, &config)?;
    let name = course.name().to_owned();
    let policy = EngagePolicy::PilotSwitch;
    let mut station_settings =
        station_settings(&config, &vehicle, &course, policy, Some(&endpoint))?;
    let signing = SigningState::open(&settings.link.signing)?;
    station_settings.session.signing = signing.as_ref().map(SigningState::settings);

    let mut signals = StopSignals::after(Some(preparation))?;
    let clock = HostClock::start();
    let log_dir = settings.log_dir.clone().unwrap_or_else(|| PathBuf::from("."));
    create_folder("log_dir", &log_dir)?;
    let info = run_info(&config, &vehicle, &name, false, None);
    let mut audience = Audience::start_for_flight(&args.view, &config, &info, &course)?
        .monitored(&vehicle.params, &config)?
        .forwarding(&args.forward, &config)?
        .served(&args.service)?
        .on_screen(args.tui, &info)?;
    let open = move |start| LogWriter::create(&log_dir, &info, start, Instant::now());
    let sink = LogSink::per_flight(Box::new(open), audience.take_listeners())
        .context("cannot start the log's thread")?;
    let tee = args.tlog.as_deref().map(tee).transpose()?;
    let station = Station::new(station_settings, clock.now());
    let outlets =
        Outlets { tee, sink, guests: audience.take_guests(), changes: audience.take_changes() };
    let running = daemon::start(station, clock, Connection::new(endpoint), outlets)
        .context("cannot start the control thread")?;
    let finished = watch(running, clock, &mut audience, &mut signals);
    print_tlog_loss(finished.tlog);
    if let Err(error) = finished.log {
        print_status(format_args!("{error}"));
    }
    let (end, exit) = match signals.first() {
        // A service manager stops a service with SIGTERM; nothing failed.
        Some(Stop::Terminate) => ("stopped".to_owned(), Exit::Ok),
        stop => summary::end_text(finished.end.as_ref(), stop),
    };
    print_status(format_args!("daemon {end}"));
    Ok(exit)
}
