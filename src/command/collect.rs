//! `downwash collect`: a programme of flights that a model can be learned from, one log each.

mod kept;
mod on_link;
mod simulated;

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::Instant;

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;

use self::kept::{Identity, LogOf, logs_of_flights};
use self::on_link::fly_vehicle;
use self::simulated::Simulator;
use super::fly::system_flag;
use super::output::create_folder;
use super::progress::flight_bar;
use super::setup::{capability, required};
use super::simulation::Truth;
use super::stop::StopSignals;
use super::vehicle_file::VehicleFile;
use super::{
    Exit, ExitContext, Interruption, config, print_json, print_status, print_text, write_file,
};
use crate::cli::CollectArgs;
use crate::config::Config;
use crate::log::info::TrackingInfo;
use crate::plan::Feasibility;
use crate::plan::programme::{FlightKind, ProgrammeFlight, programme};

/// The JSON of `collect`.
#[derive(JsonSchema, Serialize)]
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
#[derive(Clone, JsonSchema, Serialize)]
struct FlightRow {
    name: String,
    kind: FlightKind,
    /// Length of the trajectory, s.
    planned_s: f64,
    /// The greatest demands of the trajectory.
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

    /// The row of a flight, with the results in its log.
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

pub(super) fn run(args: &CollectArgs, preparation: Interruption) -> anyhow::Result<Exit> {
    let mut flags = Vec::new();
    if let Some(url) = &args.connect {
        flags.push(("--connect", "connect", toml::Value::String(url.clone())));
    }
    flags.extend(system_flag(args.system));
    let config = config::load(args.config.as_deref(), flags)?;
    let vehicle = match (&args.vehicle, &args.connect) {
        (Some(path), _) => VehicleFile::load(path)?,
        (None, Some(_)) => {
            VehicleFile::load(&required(&config.settings.vehicle, "--vehicle", "vehicle")?)?
        }
        (None, None) => VehicleFile::chosen(None, &config.settings)?,
    };
    let (summary, exit) = gather(args, &config, &vehicle, Some(preparation))?;
    if args.json {
        print_json(&summary)?
    } else {
        print_text(&table(&summary))?
    }
    Ok(exit)
}

/// Flies the flights of the programme that have no complete log yet, or only lists the programme.
/// `preparation` ends the program until the first flight; without it the caller checks the signals.
pub(super) fn gather(
    args: &CollectArgs,
    config: &Config,
    vehicle: &VehicleFile,
    preparation: Option<Interruption>,
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
        create_folder("--write-trajectories", folder)?;
        for flight in &flights {
            write_file(&folder.join(format!("{}.toml", flight.name)), flight.text.as_bytes())?;
        }
        (flights.iter().map(FlightRow::planned).collect(), Exit::Ok)
    } else if args.list {
        (flights.iter().map(FlightRow::planned).collect(), Exit::Ok)
    } else {
        fly(args, config, vehicle, &flights, preparation)?
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
    /// The new and the kept logs.
    pub fn logs(&self) -> Vec<PathBuf> {
        self.flights.iter().filter_map(|flight| flight.log.clone()).collect()
    }

    /// The flights that did not end as planned, in words.
    pub fn troubles(&self) -> impl Iterator<Item = String> + '_ {
        let ended = |row: &&FlightRow| !matches!(row.exit, Exit::Ok | Exit::Interrupted);
        self.flights.iter().filter(ended).map(|row| format!("flight {}: {}", row.name, row.end))
    }
}

/// Flies the flights without a complete log. Every flight of the programme gets a row; the worst
/// end determines the exit code.
fn fly(
    args: &CollectArgs,
    config: &Config,
    vehicle: &VehicleFile,
    flights: &[ProgrammeFlight],
    preparation: Option<Interruption>,
) -> anyhow::Result<(Vec<FlightRow>, Exit)> {
    let mut signals = StopSignals::after(preparation)?;
    create_folder("--out", &args.out)?;
    let truth = args.connect.is_none().then(|| Truth::load(&args.simulation, &vehicle.params));
    let truth = truth.transpose()?;
    let identity = Identity { config, vehicle, truth: truth.as_ref(), seed: args.seed };
    let logs = logs_of_flights(&args.out)?;
    let own = flights.iter().map(|flight| identity.fingerprint(flight));
    let own: Vec<String> = own.collect::<Result<_, _>>()?;
    let strange = logs.iter().filter(|(of, _)| !own.contains(of)).map(|(_, logs)| logs.len());
    let strange: usize = strange.sum();
    if strange > 0 {
        let (logs, are, them) =
            if strange == 1 { ("log", "is", "it") } else { ("logs", "are", "them") };
        print_status(format_args!(
            "{}: {strange} {logs} of another programme, vehicle or truth {are} there too; training \
             on the whole folder includes {them}",
            args.out.display()
        ));
    }
    let (mut rows, mut ahead) = (Vec::new(), Vec::new());
    for (index, (flight, fingerprint)) in flights.iter().zip(own).enumerate() {
        let is_complete = |log: &&LogOf| log.is_complete(flight.trajectory.duration());
        let here = || logs.get(&fingerprint).into_iter().flatten();
        if let Some(log) = here().find(is_complete) {
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
                progress: flight_bar(length),
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

/// Rank of an end: the highest of several determines the exit code.
fn gravity(exit: Exit) -> u8 {
    match exit {
        Exit::Ok => 0,
        Exit::Aborted => 1,
        Exit::Refused => 2,
        Exit::Link => 3,
        Exit::Check | Exit::Usage | Exit::Failure | Exit::NoPlan => 4,
        Exit::Interrupted => 5,
    }
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
