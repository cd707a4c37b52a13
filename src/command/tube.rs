//! `downwash tube`: calibrates and checks tubes around plans.

mod check;
mod ensemble;
mod flown;
mod shape;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

pub(super) use self::check::TubeCheck;
use self::ensemble::{Ensemble, Purpose};
use self::flown::{Flown, FlownGatherer};
use self::shape::{JudgedModel, tracking_loop};
use super::course::Course;
use super::logs::check_named;
use super::output::check_output;
use super::plan::{model_for, plan_trajectory};
use super::progress::count_bar;
use super::simulation::Truth;
use super::vehicle_file::VehicleFile;
use super::{
    Exit, ExitContext, Interruption, config, error_text, print_json, print_status, print_text,
    write_file,
};
use crate::cli::{SimulationArgs, TubeCommand, TubeFitArgs};
use crate::config::Config;
use crate::exam::draw::Draw;
use crate::plan::planned::Plan;
use crate::plan::tube::{Calibration, Shape, Tube, TubeError};
use crate::plan::{PositionSource, TimeLimit, Trajectory};

/// Number of simulated flights for the shape.
const SHAPE_FLIGHTS: u64 = 12;
/// One in this number of logs is used for the shape.
const SHAPE_SHARE: usize = 5;
/// Confidences whose widths the summary lists.
const CONFIDENCES: [f64; 4] = [0.5, 0.9, 0.95, 0.99];

pub(super) fn run(command: &TubeCommand, interruption: &Interruption) -> anyhow::Result<Exit> {
    match command {
        TubeCommand::Fit(args) => fit(args, &interruption.flag()),
        TubeCommand::Check(args) => check::run(args, &interruption.flag()),
    }
}

/// A calibrated tube: the JSON of `tube fit`.
#[derive(JsonSchema, Serialize)]
pub(super) struct TubeSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    vehicle: &'a str,
    /// Number of calibration flights.
    flights: usize,
    /// Number of these that ended early.
    ended_early: usize,
    /// Number of flights for the shape.
    shape_flights: usize,
    shape: &'a Shape,
    position: PositionSource,
    /// Number of calibration flights for each trajectory.
    missions: &'a BTreeMap<String, usize>,
    /// Ratio of the radius to the standard deviation, for each confidence.
    widths: Vec<Width>,
    tube: &'a Path,
}

#[derive(JsonSchema, Serialize)]
struct Width {
    confidence: f64,
    /// Ratio of the radius to the standard deviation; null if the flights do not support the
    /// confidence.
    multiplier: Option<f64>,
    /// Smallest number of calibration flights that supports the confidence.
    flights_needed: usize,
}

/// The shape of a tube and its calibration flights.
struct Gathered {
    shape: Shape,
    shape_flights: usize,
    /// The calibration flights.
    flights: Vec<Flown>,
}

fn fit(args: &TubeFitArgs, stop: &AtomicBool) -> anyhow::Result<Exit> {
    let given = [&args.model, &args.vehicle, &args.config].into_iter().flatten();
    let files = given.chain(&args.logs).chain(&args.along);
    check_output(&args.out, files.map(PathBuf::as_path))?;
    check_named(&args.logs, None)?;
    let SimulationArgs { sitl_config, effects, effect } = &args.simulation;
    let simulates = sitl_config.is_some() || effects.is_some() || !effect.is_empty();
    if simulates && args.along.is_empty() {
        return Err(anyhow!(
            "--effect, --effects, --sitl-config: expected --along, because they change simulated \
             flights only"
        ))
        .or_exit(Exit::Usage);
    }
    let config = config::load(args.config.as_deref(), vec![])?;
    let vehicle = VehicleFile::chosen(args.vehicle.as_deref(), &config.settings)?;
    let model = JudgedModel::new(&vehicle.params, args.model.as_deref(), args.kind)?;
    let gathered = if args.along.is_empty() {
        of_logs(args, &config, &vehicle, &model)?
    } else {
        simulated(args, &config, &vehicle, &model, stop)?
    };
    if stop.load(Ordering::Relaxed) {
        return Ok(Exit::Interrupted);
    }
    let Gathered { shape, shape_flights, flights } = gathered;
    let calibration = Calibration {
        vehicle: vehicle.params.clone(),
        model: model.note.clone(),
        position: position_of(&flights)?,
        flights: flights
            .into_iter()
            .map(|flown| {
                let score = flown.is_complete.then(|| shape.score(&flown.points)).flatten();
                (flown.mission, score)
            })
            .collect(),
    };
    let tube = Tube::new(shape, calibration);
    write_file(&args.out, tube.to_json().context("the tube")?.as_bytes())?;
    let summary = TubeSummary {
        schema: "downwash.tube.fit",
        schema_version: 1,
        vehicle: &tube.vehicle.name,
        flights: tube.flights,
        ended_early: tube.flights - tube.scores.len(),
        shape_flights,
        shape: &tube.shape,
        position: tube.position,
        missions: &tube.missions,
        widths: CONFIDENCES
            .map(|confidence| Width {
                confidence,
                multiplier: tube.radius(confidence).ok().map(|radius| radius.multiplier),
                flights_needed: crate::plan::tube::conformal::flights_needed(confidence),
            })
            .into(),
        tube: &args.out,
    };
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&summary.text())?;
    }
    if let Err(error @ TubeError::TooFew { .. }) = tube.radius(0.95) {
        print_status(format_args!("{error}"));
    }
    Ok(Exit::Ok)
}

/// The kind of position that all flights have.
fn position_of(flights: &[Flown]) -> anyhow::Result<PositionSource> {
    let Some(first) = flights.first() else {
        return Err(anyhow!("no flight is left to calibrate the tube on; add flights"))
            .or_exit(Exit::Usage);
    };
    if flights.iter().any(|flown| flown.position != first.position) {
        return Err(anyhow!(
            "some flights have the simulator's true position and some only the vehicle's estimate, and \
             their errors differ; make a tube for each kind"
        ))
        .or_exit(Exit::Usage);
    }
    Ok(first.position)
}

/// Flights from logs: the seed selects those for the shape, the others calibrate.
fn of_logs(
    args: &TubeFitArgs,
    config: &Config,
    vehicle: &VehicleFile,
    model: &JudgedModel,
) -> anyhow::Result<Gathered> {
    let mut logs = args.logs.clone();
    logs.sort();
    logs.dedup();
    Draw::new(args.seed, 0).shuffle(&mut logs);
    let (for_shape, rest) = logs.split_at(logs.len().div_ceil(SHAPE_SHARE));
    let feedback = tracking_loop(&vehicle.params, config)?;
    let shape = Shape { feedback, error: model.errors(for_shape)? };
    let read: Vec<anyhow::Result<Flown>> =
        rest.par_iter().map(|path| FlownGatherer::read(path)).collect();
    let mut flights = Vec::new();
    for (path, flown) in rest.iter().zip(read) {
        match flown {
            Ok(flown) => flights.push(flown),
            Err(error) => {
                print_status(format_args!("{}: left out: {}", path.display(), error_text(&error)));
            }
        }
    }
    Ok(Gathered { shape, shape_flights: for_shape.len(), flights })
}

/// Loads or makes the plans along which flights are simulated.
fn courses(
    args: &TubeFitArgs,
    config: &Config,
    vehicle: &VehicleFile,
) -> anyhow::Result<Vec<Course>> {
    let load = |path: &PathBuf| {
        let plan = if Plan::is_plan(path) {
            Plan::load(path).or_exit(Exit::Usage)?
        } else {
            let trajectory = Trajectory::load(path).or_exit(Exit::Usage)?;
            let plan_model = model_for(&vehicle.params, args.model.as_deref(), args.kind)?;
            print_status(format_args!("planning {}", trajectory.name()));
            let (began, limit) =
                (std::time::Instant::now(), TimeLimit::new(config.settings.plan.time_limit_s));
            plan_trajectory(&trajectory, &vehicle.params, &plan_model, config, &|_| {
                limit.is_over(began.elapsed())
            })?
        };
        let course = Course::Planned(Arc::new(plan));
        course.check(vehicle, config).with_context(|| path.display().to_string())?;
        Ok(course)
    };
    args.along.iter().map(load).collect()
}

/// Simulates flights along the courses, under random disturbances.
fn simulated(
    args: &TubeFitArgs,
    config: &Config,
    vehicle: &VehicleFile,
    model: &JudgedModel,
    stop: &AtomicBool,
) -> anyhow::Result<Gathered> {
    let base = Truth::load(&args.simulation, &vehicle.params)?;
    let courses = courses(args, config, vehicle)?;
    let ensemble = Ensemble { config, vehicle, base: &base, seed: args.seed };
    let count = u64::from(args.flights);
    let bar = count_bar(SHAPE_FLIGHTS + count);
    let done = AtomicU64::new(0);
    let fly = |purpose, number, folder: Option<&Path>| {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let flown = ensemble.fly(purpose, number, &courses, folder)?;
        bar.set_position(done.fetch_add(1, Ordering::Relaxed) + 1);
        anyhow::Ok(Some(flown))
    };
    let desk = Desk::new()?;
    let logged: Vec<_> = (0..SHAPE_FLIGHTS)
        .into_par_iter()
        .map(|number| fly(Purpose::Shape, number, Some(&desk.0.join(number.to_string()))))
        .collect::<anyhow::Result<_>>()?;
    let logs: Vec<PathBuf> = logged.into_iter().flatten().filter_map(|(_, log)| log).collect();
    let flights: Vec<_> = (0..count)
        .into_par_iter()
        .map(|number| fly(Purpose::Calibration, number, None))
        .collect::<anyhow::Result<_>>()?;
    bar.finish_and_clear();
    let feedback = tracking_loop(&vehicle.params, config)?;
    let shape = Shape { feedback, error: model.errors(&logs)? };
    let flights = flights.into_iter().flatten().map(|(flown, _)| flown).collect();
    Ok(Gathered { shape, shape_flights: logs.len(), flights })
}

/// A temporary folder for the logs of the shape.
struct Desk(PathBuf);

impl Desk {
    fn new() -> anyhow::Result<Self> {
        let folder = std::env::temp_dir().join(format!("downwash-tube-{}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self(folder))
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

impl TubeSummary<'_> {
    fn text(&self) -> String {
        let Shape { feedback, error } = self.shape;
        let axis = |name: &str, axis: &crate::plan::tube::error::AxisError| {
            format!(
                "{name:12}{:.3} m/s^2 at rest, {:.3} 1/s times the speed, correlation time {:.2} s\n",
                axis.at_rest_m_s2, axis.per_speed_s, axis.correlation_s
            )
        };
        let mut text = format!(
            "standard deviation of the model's error on {} flights\n{}{}\
             feedback    stiffness {:.2} and {:.2} 1/s^2, damping {:.2} and {:.2} 1/s\n\
             calibrated  on {} flights ({} ended early), with {}\n",
            self.shape_flights,
            axis("horizontal", &error.horizontal),
            axis("vertical", &error.vertical),
            feedback.stiffness_s2[0],
            feedback.stiffness_s2[1],
            feedback.damping_s[0],
            feedback.damping_s[1],
            self.flights,
            self.ended_early,
            self.position.text()
        );
        for Width { confidence, multiplier, flights_needed } in &self.widths {
            let width = match multiplier {
                Some(multiplier) => format!("{multiplier:.2} standard deviations"),
                None => format!("not supported: needs at least {flights_needed} flights"),
            };
            text += &format!("{:<12}{width}\n", format!("{:.0} %", 100.0 * confidence));
        }
        text + &format!("tube        {}\n", self.tube.display())
    }
}
