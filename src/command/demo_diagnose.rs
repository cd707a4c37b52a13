//! `downwash demo --diagnose`: the whole loop in one command. The simulated vehicle has an effect
//! that its file does not state. The diagnosis finds it from a short programme of flights; then the
//! trajectory is planned and flown with the shipped file and with the improved one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, anyhow};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

use super::collect::gather;
use super::course::Course;
use super::improved::{Additions, Form};
use super::logs::open_for;
use super::output::create_folder;
use super::plan::{PlanModel, plan_trajectory};
use super::setup::built_in_trajectory;
use super::simulation::{Simulated, SimulatedFlight, Truth};
use super::vehicle_file::VehicleFile;
use super::{
    Exit, ExitContext, Interruption, config, print_json, print_status, print_text, summary,
    write_file,
};
use crate::cli::{CollectArgs, DemoArgs, SimulationArgs};
use crate::config::Config;
use crate::diagnose::answer::Answer;
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::next_flight::typical;
use crate::diagnose::pipeline::{Diagnosis, diagnose};
use crate::diagnose::simulate::gap::Floor;
use crate::diagnose::simulate::open_loop::Simulator;
use crate::offboard::EffectiveVehicle;
use crate::plan::Trajectory;
use crate::report::comparison::{Contender, Track};
use crate::report::repair::{self, Repair};
use crate::report::text::effects;
use crate::station::End;

/// Candidates for the hidden effect: those that the programme shows and that matter along the
/// trajectory. Wind needs a drag in the vehicle file, and the flights stay clear of the floor and
/// of their own wake.
const DRAWN: [EffectId; 13] = [
    EffectId::ThrustScale,
    EffectId::Mass,
    EffectId::ThrustCurve,
    EffectId::BatterySag,
    EffectId::RotorLoss,
    EffectId::MotorLag,
    EffectId::RotorDrag,
    EffectId::BladeFlapping,
    EffectId::Inertia,
    EffectId::ComOffset,
    EffectId::YawTorque,
    EffectId::AttitudeTrim,
    EffectId::PdGain,
];
/// Range of the drawn effect's size, over the usual one.
const STRENGTH: [f64; 2] = [0.5, 1.0];
/// Number of twins, which show how large chance makes the evidence.
const TWINS: u32 = 40;

/// The JSON of `demo --diagnose`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(super) struct RepairSummary {
    schema: &'static str,
    schema_version: u32,
    /// How the flights ended: `done`, or how the first other one did.
    end: String,
    seed: u64,
    trajectory: String,
    /// Effects of the simulated vehicle that the vehicle file does not state.
    #[schemars(
        with = "std::collections::BTreeMap<String, std::collections::BTreeMap<String, serde_json::Value>>"
    )]
    hidden: EffectSet,
    /// Effects that the diagnosis found.
    #[schemars(
        with = "std::collections::BTreeMap<String, std::collections::BTreeMap<String, serde_json::Value>>"
    )]
    found: EffectSet,
    finding: String,
    excited_s: f64,
    /// The gap on the flights along the trajectory, in units of the noise.
    gap: Option<RepairedGap>,
    /// The shipped file, then the improved one.
    contenders: Vec<Contender>,
    improved: PathBuf,
    report: PathBuf,
    logs: Vec<PathBuf>,
    /// Wall time of the diagnosis alone, and of everything.
    diagnosis_wall_s: f64,
    total_wall_s: f64,
}

/// A gap before and after.
#[derive(Clone, Copy, JsonSchema, Serialize)]
struct RepairedGap {
    before: f64,
    after: f64,
    floor: f64,
}

/// The inputs of every stage.
struct Loop<'a> {
    args: &'a DemoArgs,
    config: Config,
    shipped: VehicleFile,
    desired: Trajectory,
    simulation: SimulationArgs,
    truth: Truth,
    interrupted: Arc<AtomicBool>,
}

/// Flights of one contender.
struct Flown {
    contender: Option<Contender>,
    logs: Vec<PathBuf>,
    end: String,
    exit: Exit,
}

pub(super) fn run(args: &DemoArgs, interruption: &Interruption) -> anyhow::Result<Exit> {
    let began = Instant::now();
    let config = config::load(args.config.as_deref(), vec![])?;
    let shipped = match &args.vehicle {
        Some(path) => VehicleFile::load(path)?,
        None => VehicleFile::built_in()?,
    };
    let desired = match &args.trajectory {
        Some(path) => Trajectory::load(path).or_exit(Exit::Usage)?,
        None => built_in_trajectory()?,
    };
    Course::Desired(desired.clone()).check(&shipped, &config)?;
    create_folder("--out", &args.out)?;
    let simulation = hide(args, &shipped.params)?;
    let closed = Loop {
        truth: Truth::load(&simulation, &shipped.params)?,
        args,
        config,
        shipped,
        desired,
        simulation,
        interrupted: interruption.flag(),
    };
    closed.run(began)
}

/// The simulated vehicle: with the requested effects; without any, with an effect drawn from the
/// seed.
fn hide(args: &DemoArgs, vehicle: &VehicleParams) -> anyhow::Result<SimulationArgs> {
    let mut simulation = args.simulation.clone();
    if simulation.effects.is_none() && simulation.effect.is_empty() {
        let mut rng = Pcg64Mcg::seed_from_u64(args.seed);
        let catalogue = Catalogue::new(vehicle, true);
        let strength = rng.random_range(STRENGTH[0]..STRENGTH[1]);
        let drawn = DRAWN.choose(&mut rng).copied();
        let hidden = drawn
            .and_then(|effect| typical(&catalogue, effect, strength))
            .with_context(|| format!("no effect can be drawn for {}", vehicle.name))?;
        let path = args.out.join("hidden.toml");
        let text = toml::to_string(&hidden.effects).context("the hidden effect")?;
        write_file(&path, text.as_bytes())?;
        simulation.effects = Some(path);
    }
    Ok(simulation)
}

impl Loop<'_> {
    fn run(self, began: Instant) -> anyhow::Result<Exit> {
        let args = self.args;
        let logs = match self.excite()? {
            Ok(logs) => logs,
            Err(exit) => return Ok(exit),
        };
        print_status(format_args!("diagnosing {} flights", logs.len()));
        let diagnosing = Instant::now();
        let diagnosis = self.diagnose(&logs)?;
        let diagnosis_wall_s = diagnosing.elapsed().as_secs_f64();
        let improved = self.improve(&diagnosis)?;
        let (mut flown, mut plans) = (Vec::new(), Vec::new());
        for (name, vehicle) in [("as shipped", &self.shipped), ("improved", &improved)] {
            if self.interrupted.load(Ordering::Relaxed) {
                return Ok(Exit::Interrupted);
            }
            let (course, path) = self.plan(name, vehicle)?;
            plans.push((format!("plan, {name}"), path));
            flown.push(self.fly(name, vehicle, &course)?);
        }
        let logs: Vec<PathBuf> = flown.iter().flat_map(|flown| flown.logs.clone()).collect();
        let gap = self.gap(&logs, &improved.params, &diagnosis)?;
        let worst = flown.iter().find(|flown| flown.exit != Exit::Ok).or(flown.first());
        let (end, exit) = worst.map_or((String::new(), Exit::Failure), |w| (w.end.clone(), w.exit));
        let contenders: Vec<Contender> =
            flown.into_iter().filter_map(|flown| flown.contender).collect();
        let answer = &diagnosis.answer;
        let summary = RepairSummary {
            schema: "downwash.demo.diagnose",
            schema_version: 1,
            end,
            seed: args.seed,
            trajectory: self.desired.name().to_owned(),
            hidden: self.truth.effects.clone(),
            found: diagnosis.effects.clone(),
            finding: answer.finding.sentence.clone(),
            excited_s: answer.flights.iter().map(|flight| flight.seconds).sum(),
            gap,
            contenders,
            improved: args.out.join(IMPROVED),
            report: args.out.join("report.html"),
            logs,
            diagnosis_wall_s,
            total_wall_s: began.elapsed().as_secs_f64(),
        };
        self.conclude(&summary, &plans, answer)?;
        Ok(exit)
    }

    /// Flies the programme that shows effects. Returns the exit code, and reports the flight, if
    /// one did not end as planned.
    fn excite(&self) -> anyhow::Result<Result<Vec<PathBuf>, Exit>> {
        let args = self.args;
        print_status(format_args!("flying {:.0} s to see its effect", args.excite));
        let out = args.out.join("excited");
        let collect = CollectArgs {
            config: args.config.clone(),
            ..CollectArgs::simulated(out, args.excite, args.seed, self.simulation.clone())
        };
        let (collected, exit) = gather(&collect, &self.config, &self.shipped, None)?;
        for trouble in collected.troubles() {
            print_status(format_args!("{trouble}"));
        }
        if exit == Exit::Interrupted {
            print_status(format_args!(
                "interrupted: the flights so far are in {}",
                args.out.display()
            ));
        }
        Ok(if exit == Exit::Ok { Ok(collected.logs()) } else { Err(exit) })
    }

    fn prepare(&self, logs: &[PathBuf]) -> anyhow::Result<Vec<PreparedFlight>> {
        let vehicle = &self.shipped.params;
        let read = |path: &PathBuf| -> anyhow::Result<PreparedFlight> {
            let flight = open_for(path, None, vehicle)?;
            PreparedFlight::new(flight, vehicle).with_context(|| path.display().to_string())
        };
        logs.par_iter().map(read).collect()
    }

    fn diagnose(&self, logs: &[PathBuf]) -> anyhow::Result<Diagnosis> {
        let mut fitted = self.prepare(logs)?;
        let held_out: Vec<PreparedFlight> = fitted.pop().into_iter().collect();
        if fitted.is_empty() {
            return Err(anyhow!(
                "one flight is not enough to find an effect and check it; raise --excite"
            ))
            .or_exit(Exit::Usage);
        }
        let case = DiagnosisInput {
            vehicle: &self.shipped.params,
            fitted: &fitted,
            held_out: &held_out,
            blocked: false,
            without: &[],
            stop: &self.interrupted,
        };
        let settings = Settings {
            seed: self.args.seed,
            twins: TWINS,
            discover: !self.truth.effects.laws().is_empty(),
        };
        let diagnosis =
            diagnose(&case, &settings, &|stage| print_status(format_args!("... {stage}")))
                .or_exit(Exit::Usage)?;
        print_status(format_args!("{}", diagnosis.answer.finding.sentence));
        Ok(diagnosis)
    }

    /// Writes the vehicle file with the effects found.
    fn improve(&self, diagnosis: &Diagnosis) -> anyhow::Result<VehicleFile> {
        let logs: Vec<String> =
            diagnosis.answer.flights.iter().map(|flight| flight.name.clone()).collect();
        let additions = Additions::new(&diagnosis.effects, &diagnosis.answer, &logs)?;
        let VehicleFile { text, params, .. } = &self.shipped;
        let path = self.args.out.join(IMPROVED);
        let forms = [Form::of(Path::new(&self.shipped.name), text), Form::Toml];
        let text = additions.to_file(text, params, forms)?;
        write_file(&path, text.as_bytes())?;
        VehicleFile::load(&path)
    }

    /// The trajectory, planned through the physics of a vehicle file.
    fn plan(&self, name: &str, vehicle: &VehicleFile) -> anyhow::Result<(Course, PathBuf)> {
        print_status(format_args!("planning with the vehicle file {name}"));
        let plan_model = PlanModel::nominal(&vehicle.params)?;
        let plan =
            plan_trajectory(&self.desired, &vehicle.params, &plan_model, &self.config, &|_| {
                self.interrupted.load(Ordering::Relaxed)
            })?;
        let path = self.args.out.join(format!("plan-{}.json", name.replace(' ', "-")));
        write_file(&path, plan.to_json().context("the plan")?.as_bytes())?;
        let course = Course::Planned(Arc::new(plan));
        course.check(vehicle, &self.config).with_context(|| format!("the plan {name}"))?;
        Ok((course, path))
    }

    /// Flies a course with every seed. The daemon has `vehicle`'s file; the firmware and the true
    /// vehicle stay the same.
    fn fly(&self, name: &str, vehicle: &VehicleFile, course: &Course) -> anyhow::Result<Flown> {
        let args = self.args;
        let effective = EffectiveVehicle::new(&vehicle.params).or_exit(Exit::Usage)?;
        let hover_thrust_n = effective.hover.hover_thrust_n();
        let (mut tracks, mut logs) = (Vec::new(), Vec::new());
        let mut ended: Option<(String, Exit)> = None;
        for seed in args.seed..args.seed.saturating_add(args.flights) {
            let flight = SimulatedFlight {
                config: &self.config,
                vehicle,
                airframe: &self.shipped.params,
                truth: &self.truth,
                course,
                run: &format!("{}-{}-{seed}", course.name(), name.replace(' ', "-")),
                seed,
                extra: BTreeMap::from([("reference".to_owned(), name.to_owned())]),
            };
            let Simulated { end, log, .. } = flight.fly(&args.out, |_| {})?;
            let report = summary::report_on(&log)?;
            let reference = course.at_start().reference(hover_thrust_n);
            let track = Track::new(&report, &self.desired, reference.as_ref(), hover_thrust_n);
            tracks.extend((!track.is_empty()).then_some(track));
            logs.push(log);
            let (text, exit) = summary::end_text(Some(&end), None);
            if end != End::Done {
                print_status(format_args!("{name} did not end as planned: {text}"));
            }
            if ended.as_ref().is_none_or(|(_, worst)| *worst == Exit::Ok) {
                ended = Some((text, exit));
            }
        }
        let (end, exit) = ended.unwrap_or_else(|| ("not flown".to_owned(), Exit::Failure));
        Ok(Flown { contender: Contender::new(name, tracks), logs, end, exit })
    }

    /// The gap of both simulators on the flights along the trajectory, none of which was fitted.
    fn gap(
        &self,
        logs: &[PathBuf],
        improved: &VehicleParams,
        diagnosis: &Diagnosis,
    ) -> anyhow::Result<Option<RepairedGap>> {
        let read = |path: &PathBuf| -> anyhow::Result<PreparedFlight> {
            let flight = crate::log::import::open(path, None)?;
            Ok(PreparedFlight::new(flight, &self.shipped.params)?)
        };
        let flights: Vec<PreparedFlight> =
            logs.par_iter().map(read).collect::<anyhow::Result<_>>()?;
        let simulator = |vehicle| Simulator::new(vehicle, &EffectSet::new(), true);
        let (shipped, improved) = (simulator(&self.shipped.params)?, simulator(improved)?);
        let noise: &ReportNoise = &diagnosis.noise;
        let errors = shipped.errors(&flights).zip(improved.errors(&flights)).zip(improved.floor(
            &flights,
            noise,
            self.args.seed,
        ));
        Ok(errors.map(|((before, after), Floor { errors: floor, .. })| RepairedGap {
            before: before.mean_over(&floor),
            after: after.mean_over(&floor),
            floor: floor.mean_over(&floor),
        }))
    }

    /// Writes the reports and the summary.
    fn conclude(
        &self,
        summary: &RepairSummary,
        plans: &[(String, PathBuf)],
        answer: &Answer,
    ) -> anyhow::Result<()> {
        let args = self.args;
        let diagnosis = args.out.join("diagnosis.html");
        let page = crate::report::diagnosis::html(answer, &self.shipped.params.name, &[]);
        write_file(&diagnosis, page.as_bytes())?;
        let json = serde_json::to_vec_pretty(answer).context("diagnosis.json")?;
        write_file(&args.out.join("diagnosis.json"), &json)?;
        let mut files: Vec<(String, &Path)> = vec![
            ("the diagnosis".to_owned(), diagnosis.as_path()),
            ("improved vehicle file".to_owned(), summary.improved.as_path()),
        ];
        files.extend(plans.iter().map(|(what, path)| (what.clone(), path.as_path())));
        let of = |index: usize| {
            let flights = summary.logs.len() / 2;
            if index < flights { "flight as shipped" } else { "flight improved" }
        };
        let logs = summary.logs.iter().enumerate();
        files.extend(logs.map(|(index, log)| (of(index).to_owned(), log.as_path())));
        let notes = [
            (
                "flights",
                "the bundled vehicle in lockstep, with the whole protocol; the same feedback, \
                 limits and rates, with gains from each vehicle file"
                    .to_owned(),
            ),
            (
                "diagnosis",
                format!(
                    "{:.0} s of flight in {:.1} s, {TWINS} twins without an effect",
                    summary.excited_s, summary.diagnosis_wall_s
                ),
            ),
        ];
        let html = repair::html(&Repair {
            trajectory: &summary.trajectory,
            vehicle: &self.shipped.params.name,
            hidden: &self.truth.effects,
            finding: &summary.finding,
            gap: summary.gap.map(|gap| [gap.before, gap.after, gap.floor]),
            contenders: &summary.contenders,
            files: &files,
            folder: &args.out,
            notes: &notes,
        });
        write_file(&summary.report, html.as_bytes())?;
        let json = serde_json::to_vec_pretty(summary).context("summary.json")?;
        write_file(&args.out.join("summary.json"), &json)?;
        if args.json { print_json(summary) } else { print_text(&text(summary)) }
    }
}

/// Name of the improved vehicle file.
const IMPROVED: &str = "improved.toml";

/// The text for stdout.
fn text(summary: &RepairSummary) -> String {
    let hidden = effects(&summary.hidden);
    let mut text =
        format!("flights {}\nhidden  {hidden}\nfound   {}\n", summary.end, summary.finding);
    text += &format!("{:26}{:>12}{:>12}\n", "", "as shipped", "improved");
    if let Some(RepairedGap { before, after, .. }) = summary.gap {
        text += &format!("{:26}{before:12.2}{after:12.2}\n", "gap / noise");
    }
    let mut row = |name: &str, value: fn(&Contender) -> f64, decimals: usize| {
        let cells: String = summary
            .contenders
            .iter()
            .map(|contender| format!("{:12.decimals$}", value(contender)))
            .collect();
        text += &format!("{name:26}{cells}\n");
    };
    row("position RMSE / m", |c| c.mean.rmse_3d_m, 4);
    row("greatest error / m", |c| c.mean.max_3d_m, 4);
    row("yaw RMSE / deg", |c| c.mean.rmse_yaw_rad.to_degrees(), 2);
    row("feedback's share / %", |c| 100.0 * c.share.feedback_share, 0);
    text += &format!(
        "diagnosed {:.0} s of flight in {:.1} s; {:.0} s in total\nreport  {}\nvehicle {}\n",
        summary.excited_s,
        summary.diagnosis_wall_s,
        summary.total_wall_s,
        summary.report.display(),
        summary.improved.display()
    );
    text
}
