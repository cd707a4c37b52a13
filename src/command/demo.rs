//! `downwash demo`: the whole experiment on the simulated vehicle, in lockstep. The vehicle has
//! effects that its file does not state. The command collects flights, learns a model from them,
//! plans the trajectory through it, and flies with and without the plan.

mod flights;
mod outcome;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Context;

pub(super) use self::outcome::DemoSummary;
use self::outcome::PlanRow;
use super::collect::gather;
use super::course::Course;
use super::demo_diagnose;
use super::output::create_folder;
use super::plan::{PlanModel, plan_trajectory, planner, sha256_of};
use super::setup::{built_in_trajectory, law_flag};
use super::simulation::Truth;
use super::train::{Learning, Resume, learn};
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext, Interruption, config, print_status, write_file};
use crate::cli::{CollectArgs, Contestant, DemoArgs, SimulationArgs, TrainArgs};
use crate::config::Config;
use crate::learn::summary::TrainingSummary;
use crate::model::file::{ModelFile, ModelKind};
use crate::plan::Trajectory;
use crate::plan::planned::Plan;
use crate::plan::receding::RecedingReference;

/// The inputs of every stage.
struct Demo<'a> {
    args: &'a DemoArgs,
    config: Config,
    /// The configuration of each law that flies.
    configs: Vec<Config>,
    vehicle: VehicleFile,
    desired: Option<Trajectory>,
    simulation: SimulationArgs,
    truth: Truth,
    interrupted: Arc<AtomicBool>,
}

/// The learned models.
struct Learned {
    file: ModelFile,
    path: PathBuf,
    summary: TrainingSummary,
    seconds: f64,
}

pub(super) fn run(args: &DemoArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    if args.diagnose {
        return demo_diagnose::run(args, interruption);
    }
    let began = Instant::now();
    let file = args.config.as_deref();
    let config = config::load(file, vec![])?;
    let configs = match args.law.as_slice() {
        [] => vec![config.clone()],
        laws => {
            let configs = laws.iter().map(|law| config::load(file, vec![law_flag(*law)]));
            configs.collect::<anyhow::Result<_>>()?
        }
    };
    let vehicle = match &args.vehicle {
        Some(path) => VehicleFile::load(path)?,
        None => VehicleFile::built_in()?,
    };
    let given = match &args.trajectory {
        Some(path) => Course::load(path, &vehicle, &config)?,
        None => Course::Desired(built_in_trajectory()?),
    };
    given.check(&vehicle, &config)?;
    create_folder("--out", &args.out)?;
    let simulation = simulation(args)?;
    let truth = Truth::load(&simulation, &vehicle.params)?;
    let demo = Demo {
        args,
        vehicle,
        desired: match &given {
            Course::Desired(trajectory) => Some(trajectory.clone()),
            Course::Planned(_) | Course::Receding { .. } => None,
        },
        truth,
        simulation,
        config,
        configs,
        interrupted: interruption.flag(),
    };
    let exit = demo.run(given, began)?;
    if exit == Exit::Interrupted {
        print_status(format_args!(
            "run the same command again to continue with the complete flights in {}",
            args.out.display()
        ));
    }
    Ok(exit)
}

/// The simulated vehicle: with the requested effects; without any, and if a model is learned, with
/// effects to learn.
fn simulation(args: &DemoArgs) -> anyhow::Result<SimulationArgs> {
    let mut simulation = args.simulation.clone();
    let learns = args.fly.iter().any(|contestant| contestant.model().is_some());
    if learns && simulation.effects.is_none() && simulation.effect.is_empty() {
        let path = args.out.join("effects.toml");
        write_file(&path, include_bytes!("../../config/effects-realistic.toml"))?;
        simulation.effects = Some(path);
    }
    Ok(simulation)
}

impl Demo<'_> {
    /// Runs every stage, one after the other. `given` is the course that is flown without a plan.
    fn run(&self, given: Course, began: Instant) -> anyhow::Result<Exit> {
        let learned = if self.args.fly.iter().any(|contestant| contestant.model().is_some()) {
            match self.learn()? {
                Ok(learned) => Some(learned),
                Err(exit) => return Ok(exit),
            }
        } else {
            None
        };
        let (mut courses, mut plans) = (Vec::new(), Vec::new());
        for contestant in &self.args.fly {
            let course = match (contestant.model(), &learned) {
                (Some(kind), Some(learned)) if *contestant == Contestant::Replanned => {
                    self.receding(kind, learned)?
                }
                (Some(kind), Some(learned)) => {
                    let (plan, row) = self.plan(*contestant, kind, learned)?;
                    if self.interrupted.load(Ordering::Relaxed) {
                        return Ok(Exit::Interrupted);
                    }
                    plans.push(row);
                    Course::Planned(Arc::new(plan))
                }
                _ => given.clone(),
            };
            course.check(&self.vehicle, &self.config).context(contestant.name())?;
            courses.push((*contestant, course));
        }
        let Some(flown) = self.fly(&courses)? else { return Ok(Exit::Interrupted) };
        self.conclude(flown, learned, plans, began)
    }

    /// Collects flights and learns from them; returns the exit code if that ended early.
    fn learn(&self) -> anyhow::Result<Result<Learned, Exit>> {
        let args = self.args;
        let vehicle = args.out.join("vehicle.toml");
        write_file(&vehicle, self.vehicle.text.as_bytes())?;
        print_status(format_args!("collecting {:.0} s of flight", args.learn));
        let out = args.out.join("collected");
        let collect = CollectArgs {
            config: args.config.clone(),
            ..CollectArgs::simulated(out, args.learn, args.seed, self.simulation.clone())
        };
        let (collected, exit) = gather(&collect, &self.config, &self.vehicle, None)?;
        if exit != Exit::Ok {
            for trouble in collected.troubles() {
                print_status(format_args!("{trouble}"));
            }
            return Ok(Err(exit));
        }
        print_status(format_args!("learning from {} flights", collected.logs().len()));
        let path = args.out.join("model.safetensors");
        let train = TrainArgs {
            report: Some(args.out.join("training")),
            seed: args.seed,
            ..TrainArgs::new(collected.logs(), vehicle, path.clone())
        };
        let Learning::Done(trained) = learn(&train, Resume::IfItBelongs, &self.interrupted)? else {
            return Ok(Err(Exit::Interrupted));
        };
        let file = ModelFile::load(&path)?;
        Ok(Ok(Learned { file, path, summary: trained.summary, seconds: args.learn }))
    }

    /// Plans the trajectory through one of the models.
    fn plan(
        &self,
        contestant: Contestant,
        kind: ModelKind,
        learned: &Learned,
    ) -> anyhow::Result<(Plan, PlanRow)> {
        let desired = self
            .desired
            .as_ref()
            .context("a plan cannot be planned again; give a trajectory")
            .or_exit(Exit::Usage)?;
        print_status(format_args!("planning through the {} model", kind.name()));
        let began = Instant::now();
        let plan_model = PlanModel::learned(&learned.file, kind, &sha256_of(&learned.path)?)?;
        let plan =
            plan_trajectory(desired, &self.vehicle.params, &plan_model, &self.config, &|_| {
                self.interrupted.load(Ordering::Relaxed)
            })?;
        let wall_s = began.elapsed().as_secs_f64();
        let path = self.args.out.join(format!("plan-{}.json", contestant.name()));
        write_file(&path, plan.to_json().context("the plan")?.as_bytes())?;
        let row = PlanRow {
            contender: contestant.name(),
            status: plan.status,
            cost: plan.cost,
            violation: plan.violation,
            subproblems: plan.records.len(),
            wall_s,
            plan: path,
        };
        Ok((plan, row))
    }

    /// Plans the trajectory in flight, on the virtual clock.
    fn receding(&self, kind: ModelKind, learned: &Learned) -> anyhow::Result<Course> {
        let goal = self
            .desired
            .clone()
            .context("a plan cannot be planned again; give a trajectory")
            .or_exit(Exit::Usage)?;
        let plan_model = PlanModel::learned(&learned.file, kind, &sha256_of(&learned.path)?)?;
        let (planner, answer) = planner(&self.vehicle.params, &plan_model, &self.config)?;
        let settings = self.config.settings.plan.receding.for_loop(false);
        let reference = RecedingReference::inline(goal.clone(), planner, answer, settings);
        Ok(Course::Receding { goal, reference: Arc::new(reference) })
    }
}
