//! `downwash demo`: the whole experiment on the simulated vehicle, in lockstep. It has effects that
//! its file does not say; flights are collected, a model is learned from them, the trajectory is
//! planned through it, and flown with and without the plan.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use sitl::effects::EffectSet;

use super::collect::gather;
use super::course::Course;
use super::demo_diagnose;
use super::plan::{PlanModel, plan_trajectory, planner, sha256_of};
use super::setup::{EffectiveVehicle, VehicleFile, built_in_trajectory};
use super::simulation::{Simulated, SimulatedFlight, Truth};
use super::train::{Trained, checkpoint_path, learn};
use super::{
    Exit, ExitContext, config, on_interrupt, print_json, print_text, say, summary, write_file,
};
use crate::cli::{
    CollectArgs, Contestant, DemoArgs, FeatureChoice, MethodChoice, SimulationArgs, TrainArgs,
};
use crate::config::Config;
use crate::learn::summary::TrainingSummary;
use crate::log::LogReader;
use crate::model::file::{ModelFile, ModelKind};
use crate::plan::Trajectory;
use crate::plan::planned::Plan;
use crate::plan::receding::RecedingReference;
use crate::plan::scp::{Status, Violation};
use crate::report::comparison::{Contender, Track};
use crate::report::experiment::{self, Experiment};
use crate::report::flight::{FlightReport, FlightSummary};
use crate::station::End;

/// The JSON of `demo`, and its summary.json.
#[derive(Serialize)]
struct DemoSummary {
    schema: &'static str,
    schema_version: u32,
    /// How the flights ended: done, or the first that did not.
    end: String,
    seed: u64,
    trajectory: String,
    /// Effects of the simulated vehicle that the daemon did not know.
    effects: EffectSet,
    /// Of the flights along the trajectory.
    simulated_s: f64,
    /// Wall time of those flights.
    wall_s: f64,
    real_time_factor: f64,
    /// Wall time of all there is: collecting, learning, planning, flying.
    total_wall_s: f64,
    /// The first flight.
    log: PathBuf,
    report: PathBuf,
    flight: FlightSummary,
    /// Length of the flights that the models were learned from, s.
    learned_from_s: Option<f64>,
    model: Option<PathBuf>,
    plans: Vec<PlanRow>,
    contenders: Vec<Contender>,
    logs: Vec<LogRow>,
}

/// One plan.
#[derive(Serialize)]
struct PlanRow {
    contender: &'static str,
    status: Status,
    cost: f64,
    violation: Violation,
    subproblems: usize,
    wall_s: f64,
    plan: PathBuf,
}

/// One flight's log.
#[derive(Serialize)]
struct LogRow {
    contender: &'static str,
    seed: u64,
    log: PathBuf,
}

/// What every stage works with.
struct Demo<'a> {
    args: &'a DemoArgs,
    config: Config,
    vehicle: VehicleFile,
    desired: Option<Trajectory>,
    simulation: SimulationArgs,
    truth: Truth,
    interrupted: Arc<AtomicBool>,
}

/// What was learned.
struct Learned {
    file: ModelFile,
    path: PathBuf,
    summary: TrainingSummary,
    seconds: f64,
}

pub(super) fn run(args: &DemoArgs) -> anyhow::Result<Exit> {
    if args.diagnose {
        return demo_diagnose::run(args);
    }
    let began = Instant::now();
    let config = config::load(args.config.as_deref(), vec![])?;
    let vehicle = match &args.vehicle {
        Some(path) => VehicleFile::load(path)?,
        None => VehicleFile::built_in()?,
    };
    let given = match &args.trajectory {
        Some(path) => Course::load(path, &vehicle, &config)?,
        None => Course::Desired(built_in_trajectory()?),
    };
    given.check(&vehicle, &config)?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let simulation = simulation(args)?;
    let demo = Demo {
        args,
        vehicle,
        desired: match &given {
            Course::Desired(trajectory) => Some(trajectory.clone()),
            Course::Planned(_) | Course::Receding { .. } => None,
        },
        truth: Truth::load(&simulation)?,
        simulation,
        config,
        interrupted: Arc::new(AtomicBool::new(false)),
    };
    on_interrupt(&demo.interrupted)?;
    let learned = if args.fly.iter().any(|contestant| contestant.model().is_some()) {
        match demo.learn()? {
            Ok(learned) => Some(learned),
            Err(exit) => return Ok(exit),
        }
    } else {
        None
    };
    let (mut courses, mut plans) = (Vec::new(), Vec::new());
    for contestant in &args.fly {
        let course = match (contestant.model(), &learned) {
            (Some(kind), Some(learned)) if *contestant == Contestant::Replanned => {
                demo.receding(kind, learned)?
            }
            (Some(kind), Some(learned)) => {
                let (plan, row) = demo.plan(*contestant, kind, learned)?;
                if demo.interrupted.load(Ordering::Relaxed) {
                    return Ok(Exit::Interrupted);
                }
                plans.push(row);
                Course::Planned(Arc::new(plan))
            }
            _ => given.clone(),
        };
        course.check(&demo.vehicle, &demo.config).context(contestant.name())?;
        courses.push((*contestant, course));
    }
    let Some(flown) = demo.fly(&courses)? else { return Ok(Exit::Interrupted) };
    demo.conclude(flown, learned, plans, began)
}

/// The simulated vehicle: as asked for; else, where a model is learned, with effects to learn.
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

/// The flights of a demo.
struct Flown {
    /// The first, whole.
    first: FlightReport,
    end: String,
    exit: Exit,
    logs: Vec<LogRow>,
    contenders: Vec<Contender>,
    simulated_s: f64,
    wall_s: f64,
}

impl Demo<'_> {
    /// Collects flights and learns from them; the exit code where that did not come to an end.
    fn learn(&self) -> anyhow::Result<Result<Learned, Exit>> {
        let args = self.args;
        let vehicle = args.out.join("vehicle.toml");
        write_file(&vehicle, self.vehicle.text.as_bytes())?;
        say(format_args!("collecting {:.0} s of flight", args.learn));
        let collect = CollectArgs {
            out: args.out.join("collected"),
            vehicle: None,
            connect: None,
            seconds: args.learn,
            combined: 0.0,
            seed: args.seed,
            simulation: self.simulation.clone(),
            jobs: None,
            list: false,
            write_trajectories: None,
            config: args.config.clone(),
            json: false,
        };
        let (collected, exit) = gather(&collect, &self.config, &self.vehicle)?;
        if exit != Exit::Ok {
            return Ok(Err(exit));
        }
        say(format_args!("learning from {} flights", collected.logs().len()));
        let path = args.out.join("model.safetensors");
        let train = TrainArgs {
            logs: collected.logs(),
            vehicle,
            out: path.clone(),
            report: Some(args.out.join("training")),
            mapping: None,
            features: FeatureChoice::Heading,
            method: MethodChoice::Adam,
            hidden: 100,
            passes: 100,
            regularization: vec![1e-6, 1e-5, 1e-4],
            window: vec![22.0, 60.0],
            seed: args.seed,
            threads: None,
            resume: checkpoint_path(&path).exists(),
            json: false,
        };
        let Some(Trained { summary, .. }) = learn(&train)? else {
            return Ok(Err(Exit::Interrupted));
        };
        let file = ModelFile::load(&path)?;
        Ok(Ok(Learned { file, path, summary, seconds: args.learn }))
    }

    /// Plans the trajectory through one of the models.
    fn plan(
        &self,
        contestant: Contestant,
        kind: ModelKind,
        learned: &Learned,
    ) -> anyhow::Result<(Plan, PlanRow)> {
        let desired =
            self.desired.as_ref().context("a plan is not planned again").or_exit(Exit::Usage)?;
        say(format_args!("planning through the {} model", kind.name()));
        let began = Instant::now();
        let through = PlanModel::learned(&learned.file, kind, &sha256_of(&learned.path)?)?;
        let plan = plan_trajectory(desired, &self.vehicle.params, &through, &self.config, &|_| {
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
        let goal =
            self.desired.clone().context("a plan is not planned again").or_exit(Exit::Usage)?;
        let through = PlanModel::learned(&learned.file, kind, &sha256_of(&learned.path)?)?;
        let (planner, answer) = planner(&self.vehicle.params, &through, &self.config)?;
        let settings = self.config.settings.plan.receding;
        let reference = RecedingReference::inline(goal.clone(), planner, answer, settings);
        Ok(Course::Receding { goal, reference: Arc::new(reference) })
    }

    /// Flies every course as often as asked; nothing where it was interrupted.
    fn fly(&self, courses: &[(Contestant, Course)]) -> anyhow::Result<Option<Flown>> {
        let args = self.args;
        let hover_thrust_n = EffectiveVehicle::new(&self.vehicle.params)
            .or_exit(Exit::Usage)?
            .hover
            .hover_thrust_n();
        let length: f64 = courses.iter().map(|(_, course)| course.duration()).sum();
        let progress = progress_bar(length * args.flights as f64);
        let mut flown = None;
        let mut before_s = 0.0;
        let began = Instant::now();
        let mut reading_s = 0.0;
        for (contestant, course) in courses {
            let mut tracks = Vec::new();
            for seed in args.seed..args.seed.saturating_add(args.flights) {
                if self.interrupted.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                let flight = SimulatedFlight {
                    config: &self.config,
                    vehicle: &self.vehicle,
                    airframe: &self.vehicle.params,
                    truth: &self.truth,
                    course,
                    run: &run_name(course, *contestant, seed, args),
                    seed,
                    extra: BTreeMap::from([("reference".to_owned(), contestant.name().to_owned())]),
                };
                let Simulated { end, log, simulated_s } = flight.fly(&args.out, |status| {
                    let along_s = status.progress.map_or(0.0, |(t, _)| t);
                    progress.set_position(((before_s + along_s) * 10.0) as u64);
                    progress.set_message(format!(
                        "{}: {}",
                        contestant.name(),
                        status.phase.map_or("connect", |phase| phase.name())
                    ));
                })?;
                before_s += course.duration();
                let reading = Instant::now();
                let report = report(&log)?;
                if let Some(desired) = &self.desired {
                    let reference = course.at_start().reference(hover_thrust_n);
                    let track = Track::new(&report, desired, reference.as_ref(), hover_thrust_n);
                    tracks.extend((!track.is_empty()).then_some(track));
                }
                reading_s += reading.elapsed().as_secs_f64();
                let (words, exit) = summary::end_in_words(Some(&end), None);
                if end != End::Done {
                    say(format_args!("{} did not end as planned: {words}", contestant.name()));
                }
                let all = flown.get_or_insert_with(|| Flown {
                    first: report,
                    end: words.clone(),
                    exit,
                    logs: Vec::new(),
                    contenders: Vec::new(),
                    simulated_s: 0.0,
                    wall_s: 0.0,
                });
                if all.exit == Exit::Ok {
                    (all.end, all.exit) = (words, exit);
                }
                all.simulated_s += simulated_s;
                all.logs.push(LogRow { contender: contestant.name(), seed, log });
            }
            if let Some(all) = &mut flown {
                all.contenders.extend(Contender::new(contestant.name(), tracks));
            }
        }
        progress.finish_and_clear();
        Ok(flown.map(|flown| Flown { wall_s: began.elapsed().as_secs_f64() - reading_s, ..flown }))
    }

    /// Writes the report and the summary.
    fn conclude(
        &self,
        flown: Flown,
        learned: Option<Learned>,
        plans: Vec<PlanRow>,
        began: Instant,
    ) -> anyhow::Result<Exit> {
        let args = self.args;
        let Flown { first, end, exit, logs, contenders, simulated_s, wall_s } = flown;
        let report_path = args.out.join("report.html");
        let html = if args.fly.len() > 1 {
            self.page(&contenders, learned.as_ref(), &plans, &logs)?
        } else {
            first.to_html()
        };
        write_file(&report_path, html.as_bytes())?;
        let summary = DemoSummary {
            schema: "downwash.demo",
            schema_version: 2,
            end,
            seed: args.seed,
            trajectory: self.desired.as_ref().map_or("plan", |desired| desired.name()).to_owned(),
            effects: self.truth.effects.clone(),
            simulated_s,
            wall_s,
            real_time_factor: simulated_s / wall_s,
            total_wall_s: began.elapsed().as_secs_f64(),
            log: logs.first().map(|row| row.log.clone()).unwrap_or_default(),
            report: report_path,
            flight: first.summary().clone(),
            learned_from_s: learned.as_ref().map(|learned| learned.seconds),
            model: learned.as_ref().map(|learned| learned.path.clone()),
            plans,
            contenders,
            logs,
        };
        let json = serde_json::to_vec_pretty(&summary).context("summary.json")?;
        write_file(&args.out.join("summary.json"), &json)?;
        if args.json {
            print_json(&summary)?;
        } else {
            print_text(&text(&summary))?;
        }
        Ok(exit)
    }

    /// The page of the experiment.
    fn page(
        &self,
        contenders: &[Contender],
        learned: Option<&Learned>,
        plans: &[PlanRow],
        logs: &[LogRow],
    ) -> anyhow::Result<String> {
        let mut files: Vec<(String, &Path)> = Vec::new();
        if let Some(learned) = learned {
            files.push(("model".to_owned(), &learned.path));
        }
        files.extend(
            plans.iter().map(|row| {
                (format!("plan through the {} model", row.contender), row.plan.as_path())
            }),
        );
        files.extend(
            logs.iter()
                .map(|row| (format!("{}, seed {}", row.contender, row.seed), row.log.as_path())),
        );
        let mut notes = vec![(
            "flights",
            "the bundled vehicle in lockstep, with the whole protocol; every controller has the same feedback, limits and rates".to_owned(),
        )];
        if let Some(learned) = learned {
            notes.push((
                "learning",
                format!("{:.0} s of flight without translation and yaw together", learned.seconds),
            ));
        }
        for row in plans {
            notes.push((
                row.contender,
                format!(
                    "plan: {}, {} subproblems in {:.2} s, largest defect {:.1e}",
                    row.status.in_words(),
                    row.subproblems,
                    row.wall_s,
                    row.violation.defect
                ),
            ));
        }
        let effects = self.truth.effects_text()?;
        Ok(experiment::html(&Experiment {
            trajectory: self.desired.as_ref().map_or("plan", |desired| desired.name()),
            vehicle: &self.vehicle.params.name,
            effects: if self.truth.effects.is_empty() { "no effects" } else { &effects },
            training: learned.map(|learned| &learned.summary),
            contenders,
            files: &files,
            notes: &notes,
        }))
    }
}

/// What a flight is called in its log and in the log's name.
fn run_name(course: &Course, contestant: Contestant, seed: u64, args: &DemoArgs) -> String {
    let mut name = course.name().to_owned();
    if args.fly.len() > 1 {
        name += &format!("-{}", contestant.name());
    }
    if args.flights > 1 {
        name += &format!("-{seed}");
    }
    name
}

/// What stdout shows.
fn text(summary: &DemoSummary) -> String {
    let mut text = if summary.contenders.len() > 1 {
        let heads = ["flights", "north", "east", "down", "3D", "most", "yaw/deg", "gain", "fb/%"];
        let heads = heads.map(|head| format!("{head:>9}")).concat();
        let mut table = format!("flights {}\n{:18}{heads}\n", summary.end, "position RMSE / m");
        let reference = summary.contenders.first().map_or(f64::NAN, |c| c.mean.rmse_3d_m);
        for contender in &summary.contenders {
            let mean = &contender.mean;
            let [n, e, d] = mean.rmse_ned_m;
            let lengths = [n, e, d, mean.rmse_3d_m, mean.max_3d_m].map(|v| format!("{v:9.4}"));
            table += &format!(
                "{:18}{:9}{}{:9.2}{:9.1}{:9.0}\n",
                contender.name,
                contender.flights.len(),
                lengths.concat(),
                mean.rmse_yaw_rad.to_degrees(),
                reference / mean.rmse_3d_m,
                100.0 * contender.share.feedback_share
            );
        }
        table
    } else {
        summary::flight_table(&summary.flight, &summary.end)
    };
    text += &format!(
        "simulated {:.1} s in {:.2} s: {:.0} times real time; {:.0} s in all\nreport  {}\nlog     {}\n",
        summary.simulated_s,
        summary.wall_s,
        summary.real_time_factor,
        summary.total_wall_s,
        summary.report.display(),
        summary.log.display()
    );
    text
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
