//! `downwash plan`: a feasible reference near a desired trajectory, by a model; or the fastest way
//! through a course.

mod fastest;
mod summary;
mod tubed;

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, anyhow};
use indicatif::{ProgressBar, ProgressStyle};
use vehicle::VehicleParams;
use vehicle::effects::BatterySag;

pub use self::fastest::Fastest;
pub(super) use self::summary::PlanSummary;
use self::summary::Searched;
use self::tubed::ChosenTube;
use super::output::{check_output, create_report_folder, sha256};
use super::sent_thrust::behind_the_map;
use super::vehicle_file::VehicleFile;
use super::vehicle_file::refuse_grounded;
use super::{
    Exit, ExitContext, Interruption, config, print_json, print_status, print_text, write_file,
};
use crate::cli::PlanArgs;
use crate::config::{Config, Settings};
use crate::model::Model;
use crate::model::actuation::Actuation;
use crate::model::file::{ModelFile, ModelKind};
use crate::model::physics::{PhysicsModel, PhysicsParameters};
use crate::offboard::EffectiveVehicle;
use crate::plan::keep_out::KeepOut;
use crate::plan::planned::{Answer, Found, Plan, PlannedThrough};
use crate::plan::planner::{PlannedVehicle, Planner};
use crate::plan::scp::{Record, Status};
use crate::plan::time_optimal::{NoWay, Stop, Task};
use crate::plan::{TimeLimit, Trajectory, TrajectoryFile};
use crate::report::plan as page;

/// A model to plan with, and what a plan's file states about it.
pub struct PlanModel {
    model: Arc<dyn Model>,
    note: PlannedThrough,
    /// Delay and lag from a setpoint to its effect, s.
    delay_s: f64,
    lag_s: f64,
    voltage_exponent: f64,
}

impl PlanModel {
    /// The vehicle file's own physics.
    ///
    /// # Errors
    /// The vehicle with its effects is invalid.
    pub fn nominal(vehicle: &VehicleParams) -> anyhow::Result<Self> {
        let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
        let model =
            PhysicsModel::new(vehicle, &PhysicsParameters::default()).or_exit(Exit::Usage)?;
        Ok(Self {
            model: behind_the_map(Arc::new(model), vehicle, &effective).or_exit(Exit::Usage)?,
            note: PlannedThrough::nominal(),
            delay_s: effective.actuation.command_delay_s,
            lag_s: effective.actuation.motor_time_constant_s,
            voltage_exponent: vehicle
                .modelled_effects
                .get::<BatterySag>()
                .map_or(0.0, |sag| sag.exponent),
        })
    }

    /// One of a model file's models; `sha256` is the file's.
    ///
    /// # Errors
    /// The file lacks a part of the model.
    pub fn learned(file: &ModelFile, kind: ModelKind, sha256: &str) -> anyhow::Result<Self> {
        let model = file.model(kind).or_exit(Exit::Usage)?.into();
        let note = PlannedThrough { kind: kind.name().to_owned(), sha256: Some(sha256.to_owned()) };
        Self::of(model, &file.actuation, &file.vehicle, note)
    }

    /// Whether this is the vehicle file's own physics.
    pub(super) fn is_nominal(&self) -> bool {
        self.note.is_nominal()
    }

    /// Makes a planning model from learned accelerations and the learned rotors' response.
    ///
    /// # Errors
    /// The vehicle with its effects is invalid.
    pub fn of(
        model: Arc<dyn Model>,
        actuation: &Actuation,
        vehicle: &VehicleParams,
        note: PlannedThrough,
    ) -> anyhow::Result<Self> {
        let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
        Ok(Self {
            model: behind_the_map(model, vehicle, &effective).or_exit(Exit::Usage)?,
            note,
            delay_s: actuation.delay_s,
            lag_s: actuation.lag_s,
            voltage_exponent: actuation.voltage_exponent,
        })
    }
}

/// The model of a file; without a file, the vehicle's own physics.
pub(super) fn model_for(
    vehicle: &VehicleParams,
    model: Option<&Path>,
    kind: Option<ModelKind>,
) -> anyhow::Result<PlanModel> {
    let Some(path) = model else { return PlanModel::nominal(vehicle) };
    let file = ModelFile::load(path).or_exit(Exit::Usage)?;
    file.check_vehicle(vehicle, path).or_exit(Exit::Usage)?;
    PlanModel::learned(&file, kind.unwrap_or(file.preferred), &sha256_of(path)?)
}

/// SHA-256 of a file, in hexadecimal.
///
/// # Errors
/// A file that cannot be read.
pub fn sha256_of(path: &Path) -> anyhow::Result<String> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(sha256(bytes))
}

/// The planner for a vehicle, and the vehicle's response to the plans' inputs.
pub(super) fn planner(
    vehicle: &VehicleParams,
    plan_model: &PlanModel,
    config: &Config,
) -> anyhow::Result<(Planner, Answer)> {
    let effective = EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?;
    let attitude_pd = effective
        .attitude_pd
        .ok_or_else(|| {
            anyhow!(
                "vehicle {}: a plan needs the on-board attitude loop, and the file has neither \
                 attitude_cascade, which `downwash vehicle init --connect` reads from the \
                 autopilot, nor attitude_pd; add one of them, or fly the trajectory without a plan",
                vehicle.name
            )
        })
        .or_exit(Exit::Usage)?;
    let planned = PlannedVehicle {
        body: effective.body(),
        attitude_pd,
        limits: config.settings.offboard.limits,
    };
    let settings = config.settings.plan.clone();
    let receding = settings.receding.for_loop(!effective.is_pd);
    let planner = Planner::new(Arc::clone(&plan_model.model), planned, settings)
        .or_exit(Exit::Usage)?
        .cautious(&receding);
    let answer = Answer {
        delay_s: plan_model.delay_s,
        lag_s: plan_model.lag_s,
        voltage_exponent: plan_model.voltage_exponent,
        attitude_pd,
    };
    Ok((planner, answer))
}

/// Plans a trajectory for a vehicle. `watch` receives the subproblems, and can end the search.
///
/// # Errors
/// The vehicle has no known on-board loop, or the trajectory cannot be planned.
pub fn plan_trajectory(
    trajectory: &Trajectory,
    vehicle: &VehicleParams,
    plan_model: &PlanModel,
    config: &Config,
    watch: &dyn Fn(&[Record]) -> bool,
) -> anyhow::Result<Plan> {
    plan_within(trajectory, vehicle, plan_model, config, None, watch)
}

/// As [`plan_trajectory`], with the tube's radius as the margin to keep-out regions.
fn plan_within(
    trajectory: &Trajectory,
    vehicle: &VehicleParams,
    plan_model: &PlanModel,
    config: &Config,
    tube: Option<&ChosenTube>,
    watch: &dyn Fn(&[Record]) -> bool,
) -> anyhow::Result<Plan> {
    let (planner, answer) = planner(vehicle, plan_model, config)?;
    let desire = planner.desire(trajectory).or_exit(Exit::Usage)?;
    let start = planner.at_rest(&desire.states[0]);
    let regions = config.settings.plan.keep_out.iter().map(|region| KeepOut::from(*region));
    let place = [start[0], start[1], start[2]];
    if let Some(region) =
        regions.into_iter().position(|region| region.depth_between(place, place) > 0.0)
    {
        let place = format!("the start of {}", trajectory.name());
        return Err(NoWay::KeptOut { place, region }).or_exit(Exit::Usage);
    }
    let (outcome, tube) = match tube {
        Some(tube) => tube.plan(&planner, &desire, start, watch)?,
        None => (planner.plan(&desire, start, None, watch), None),
    };
    let found = Found {
        trajectory: trajectory.name().to_owned(),
        vehicle: vehicle.name.clone(),
        body: EffectiveVehicle::new(vehicle).or_exit(Exit::Usage)?.body(),
        model: plan_model.note.clone(),
        period_s: planner.period_s(),
        answer,
        desired: desire.states,
    };
    Ok(Plan::new(found, outcome).with_tube(tube))
}

/// Plans the fastest way through a course for a vehicle, by its own physics.
///
/// # Errors
/// The vehicle has no known on-board loop, or no way leads through the course.
pub fn plan_fastest(
    task: &Task,
    vehicle: &VehicleParams,
    config: &Config,
    stop: Stop<'_>,
) -> anyhow::Result<(Plan, Fastest)> {
    fastest::plan(task, vehicle, config, stop)
}

/// Share of the time limit after which the search for the fastest way ends.
pub const SEARCH_SHARE: f64 = 0.6;
/// Share of the time limit after which the closing part of that search ends.
pub const CLOSING_SHARE: f64 = 0.9;

/// Checks the clock and Ctrl-C between subproblems, and shows the progress of a search.
struct Watch {
    began: Instant,
    limit: TimeLimit,
    limit_s: f64,
    is_late: Cell<bool>,
    interrupted: Arc<AtomicBool>,
    bar: ProgressBar,
}

impl Watch {
    fn begin(config: &Config, interruption: &Interruption) -> Self {
        let bar = ProgressBar::new_spinner();
        let style = ProgressStyle::with_template("{spinner} {pos} subproblems  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
        Self {
            began: Instant::now(),
            limit: TimeLimit::new(config.settings.plan.time_limit_s),
            limit_s: config.settings.plan.time_limit_s,
            is_late: Cell::new(false),
            interrupted: interruption.flag(),
            bar,
        }
    }

    /// Whether a share of the time limit has passed.
    fn is_spent(&self, share: f64) -> bool {
        let is_spent = self.began.elapsed().as_secs_f64() > share * self.limit_s;
        self.is_late.set(self.is_late.get() || is_spent);
        is_spent
    }

    /// Whether the search must end before its next subproblem.
    fn is_over(&self, records: &[Record]) -> bool {
        self.bar.set_position(records.len() as u64);
        if let Some(record) = records.last() {
            self.bar.set_message(format!("cost {:.4}", record.cost));
        }
        self.is_late.set(self.limit.is_over(self.began.elapsed()));
        self.interrupted.load(Ordering::Relaxed) || self.is_late.get()
    }
}

/// The vehicle of the flags, of the model file, of the settings, or the built-in one.
fn vehicle_of(args: &PlanArgs, settings: &Settings) -> anyhow::Result<VehicleParams> {
    Ok(match (&args.vehicle, &args.model) {
        (Some(path), _) => {
            let vehicle = VehicleParams::load(path).or_exit(Exit::Usage)?;
            refuse_grounded(&path.display().to_string(), &vehicle)?;
            vehicle
        }
        (None, Some(model)) => ModelFile::load(model).or_exit(Exit::Usage)?.vehicle,
        (None, None) => VehicleFile::chosen(None, settings)?.params,
    })
}

/// Plans near a desired trajectory, with a tube if the flags name one.
fn search_near(
    trajectory: &Trajectory,
    args: &PlanArgs,
    vehicle: &VehicleParams,
    config: &Config,
    watch: &Watch,
) -> anyhow::Result<Plan> {
    let plan_model = model_for(vehicle, args.model.as_deref(), args.kind)?;
    print_status(format_args!(
        "planning {} ({:.1} s) through the {} model",
        trajectory.name(),
        trajectory.duration(),
        plan_model.note.kind
    ));
    let load = |path| ChosenTube::load(path, args.confidence, args.keep_out_confidence);
    let tube = args.tube.as_deref().map(load).transpose()?;
    if let Some(tube) = &tube {
        tube.check(vehicle, &plan_model.note)?;
    }
    let watched = |records: &[Record]| watch.is_over(records);
    plan_within(trajectory, vehicle, &plan_model, config, tube.as_ref(), &watched)
}

/// Plans the fastest way through a course, without a tube and by the vehicle file's physics.
fn search_fastest(
    task: &Task,
    args: &PlanArgs,
    vehicle: &VehicleParams,
    config: &Config,
    watch: &Watch,
) -> anyhow::Result<(Plan, Fastest)> {
    if let Some(tube) = &args.tube {
        return Err(anyhow!(
            "{}: a fastest flight cannot have a tube; omit --tube {}, or plan a trajectory with \
             times",
            args.trajectory.display(),
            tube.display()
        ))
        .or_exit(Exit::Usage);
    }
    if let Some(model) = &args.model {
        return Err(anyhow!(
            "{}: a fastest plan uses the vehicle file's own physics; omit --model {}",
            args.trajectory.display(),
            model.display()
        ))
        .or_exit(Exit::Usage);
    }
    print_status(format_args!(
        "planning the fastest trajectory through {} passages",
        task.passages.len()
    ));
    let stop = Stop {
        search: &|records| watch.is_over(records) || watch.is_spent(SEARCH_SHARE),
        closing: &|_| watch.is_spent(CLOSING_SHARE),
    };
    fastest::plan(task, vehicle, config, stop)
}

pub(super) fn run(args: &PlanArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    // Other outputs may go into the report's folder.
    create_report_folder(args.report.as_deref())?;
    let given = [&args.model, &args.vehicle, &args.config, &args.tube].into_iter().flatten();
    check_output(&args.out, given.chain([&args.trajectory]).map(PathBuf::as_path))?;
    let mut config = config::load(args.config.as_deref(), vec![])?;
    if let Some(solver) = args.solver {
        config.settings.plan.solver = solver;
    }
    if let Some(limit) = args.time_limit {
        config.settings.plan.time_limit_s = limit;
    }
    let vehicle = vehicle_of(args, &config.settings)?;
    let watch = Watch::begin(&config, interruption);
    let (plan, fastest) = match TrajectoryFile::load(&args.trajectory).or_exit(Exit::Usage)? {
        TrajectoryFile::Desired(trajectory) => {
            (search_near(&trajectory, args, &vehicle, &config, &watch)?, None)
        }
        TrajectoryFile::Task(task) => {
            let (plan, fastest) = search_fastest(&task, args, &vehicle, &config, &watch)?;
            (plan, Some(fastest))
        }
    };
    watch.bar.finish_and_clear();
    let (interrupted, is_late) = (Arc::clone(&watch.interrupted), watch.is_late.get());
    let wall_s = watch.began.elapsed().as_secs_f64();

    let EffectiveVehicle { hover, .. } = EffectiveVehicle::new(&vehicle).or_exit(Exit::Usage)?;
    let demands = config.settings.envelope.check_plan(&plan, hover.mass_kg, hover.gravity);
    write_file(&args.out, plan.to_json().context("the plan")?.as_bytes())?;
    let searched = Searched { plan: &plan, fastest, wall_s };
    let summary = PlanSummary::new(searched, demands, &args.out);
    if let Some(folder) = &args.report {
        let limits = &config.settings.offboard.limits;
        let html = page::html(&plan, summary.not_flyable.as_deref(), limits);
        write_file(&folder.join("report.html"), html.as_bytes())?;
        let json = serde_json::to_vec_pretty(&summary).context("report.json")?;
        write_file(&folder.join("report.json"), &json)?;
    }
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&summary.text(&plan))?;
    }
    if is_late && plan.status == Status::Stopped {
        print_status(format_args!(
            "the search ended at its limit of {} s, and this is its best plan so far; to give it \
             more time, use --time-limit SECONDS or [plan] time_limit_s",
            config.settings.plan.time_limit_s
        ));
    }
    if let Some(reason) = &summary.not_flyable {
        print_status(format_args!("this plan cannot be flown: {reason}"));
        if [ModelKind::Net, ModelKind::Hybrid]
            .map(ModelKind::name)
            .contains(&plan.model.kind.as_str())
        {
            print_status(format_args!(
                "a plan may lead where the model's networks have seen little: try --kind physics"
            ));
        }
    }
    Ok(match (interrupted.load(Ordering::Relaxed), &summary.not_flyable) {
        (true, _) => Exit::Interrupted,
        (false, Some(_)) => Exit::NoPlan,
        (false, None) => Exit::Ok,
    })
}
