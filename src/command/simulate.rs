//! `downwash simulate`: one flight of the simulated vehicle in lockstep, as one row of numbers. A
//! sweep repeats it.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::anyhow;
use schemars::JsonSchema;
use serde::Serialize;
use sitl::config::SitlConfig;
use toml::{Table, Value};
use vehicle::effects::{EffectSet, Onset, Schedule};

use super::audience::Audience;
use super::course::Course;
use super::lap_course::simulated;
use super::output::create_folder;
use super::progress::flight_bar;
use super::setup::{built_in_trajectory, run_info};
use super::simulation::{Simulated, SimulatedFlight, Truth, requested_effects};
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext, config, print_json, print_status, print_text, summary, write_file};
use crate::cli::{SimulateArgs, ViewArgs};
use crate::config::Config;
use crate::lap_learning::Lap;
use crate::lockstep;
use crate::log::record::Record;
use crate::report::metrics::{Metrics, MetricsGatherer};
use crate::station::Status;

/// The inputs of a simulated flight, as a person writes them.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// Vehicle file, or the name of a shipped one; none takes the built-in nano quadrotor.
    pub vehicle: Option<PathBuf>,
    /// Trajectory file, the name of a shipped one, or a plan; none takes the built-in sinusoid-yaw.
    pub trajectory: Option<PathBuf>,
    /// Effects of the simulated vehicle that the controller does not know.
    pub effects: EffectSet,
    /// Effects that set in later.
    pub onsets: Vec<Onset>,
    /// The simulated vehicle's own configuration.
    pub sitl_config: Option<PathBuf>,
    /// Configuration file.
    pub config: Option<PathBuf>,
    /// Settings that override it, by their dotted paths.
    pub settings: BTreeMap<String, Value>,
    /// Seed of noise, delays and gusts.
    pub seed: u64,
}

/// One simulated flight, read and checked.
#[derive(Clone)]
pub struct Simulation {
    /// Settings of controller, planner and limits.
    pub config: Config,
    /// The vehicle as the controller assumes it.
    pub vehicle: VehicleFile,
    /// The course to follow.
    pub course: Course,
    /// The true vehicle, as far as it differs from its file.
    pub truth: Truth,
    /// Settings besides those of files, for the row.
    pub settings: BTreeMap<String, Value>,
    /// Seed of noise, delays and gusts.
    pub seed: u64,
}

/// A simulated flight as one row: the JSON of `simulate`.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Row {
    /// `downwash.simulate`.
    pub schema: &'static str,
    /// Version of this JSON.
    pub schema_version: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The vehicle's name.
    pub vehicle: String,
    /// The trajectory's name.
    pub trajectory: String,
    /// Effects of the vehicle that the controller did not know.
    #[schemars(
        with = "std::collections::BTreeMap<String, std::collections::BTreeMap<String, serde_json::Value>>"
    )]
    pub effects: EffectSet,
    /// Effects that set in later, each with its time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(with = "Vec<serde_json::Value>")]
    pub onsets: Vec<Onset>,
    /// Settings besides those of files.
    #[schemars(with = "std::collections::BTreeMap<String, serde_json::Value>")]
    pub settings: BTreeMap<String, Value>,
    /// Seed of noise, delays and gusts.
    pub seed: u64,
    /// How it ended: `done`, or why not.
    pub end: String,
    /// The exit code of that end.
    pub exit: u8,
    /// From connecting to disarming, s.
    pub simulated_s: f64,
    /// The numbers.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// The laps of a flight with `--learn`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub laps: Vec<Lap>,
    /// The log, if one was kept.
    pub log: Option<PathBuf>,
    /// The report, if one was made.
    pub report: Option<PathBuf>,
}

pub(super) fn run(args: &SimulateArgs) -> anyhow::Result<Exit> {
    let began = Instant::now();
    let Schedule { effects, onsets } = requested_effects(&args.simulation)?;
    let mut simulation = Simulation::load(&Inputs {
        vehicle: args.vehicle.clone(),
        trajectory: args.trajectory.clone(),
        effects,
        onsets,
        sitl_config: args.simulation.sitl_config.clone(),
        config: args.config.clone(),
        settings: settings(&args.set)?,
        seed: args.seed,
    })?;
    simulation.truth.warn(&simulation.vehicle.params);
    let bar = flight_bar(simulation.course.duration());
    let watch = |status: &Status| {
        bar.set_position((status.progress.map_or(0.0, |(t, _)| t) * 10.0) as u64);
    };
    let folder = (!args.no_log).then_some(args.out.as_path());
    folder.map_or(Ok(()), |folder| create_folder("--out", folder))?;
    let mut learner = None;
    if args.learning.learn.is_some() {
        let Simulation { course, vehicle, config, .. } = &simulation;
        let (laps, own) = simulated(&args.learning, course, vehicle, config)?;
        (simulation.course, learner) = (laps, Some(own));
    }
    let learn = |record: &Record| {
        let learner = learner.as_mut()?;
        learner.on_record(record);
        let event = learner.take_event()?;
        if let Record::Event { text, .. } = &event {
            print_status(format_args!("{text}"));
        }
        Some(event)
    };
    let (mut row, exit) = if args.view.view.is_some() {
        simulation.fly_seen(folder, &args.view, learn, watch)?
    } else {
        simulation.fly_with(folder, learn, watch)?
    };
    for onset in simulation.truth.onsets.iter().filter(|onset| onset.at_s > row.simulated_s) {
        let names: Vec<&str> = onset.effects.iter().map(|(id, _)| id.name()).collect();
        print_status(format_args!(
            "warning: the flight ended at {:.1} s, before the onset of {} at {:.1} s",
            row.simulated_s,
            names.join(", "),
            onset.at_s
        ));
    }
    row.laps = learner.map(|learner| learner.laps().to_vec()).unwrap_or_default();
    bar.finish_and_clear();
    if let Some(log) = row.log.as_ref().filter(|_| !args.no_report) {
        let path = log.with_extension("html");
        write_file(&path, summary::report_on(log)?.to_html().as_bytes())?;
        row.report = Some(path);
    }
    if args.json {
        print_json(&row)?;
    } else {
        print_text(&text(&row))?;
    }
    let wall_s = began.elapsed().as_secs_f64();
    print_status(format_args!(
        "simulated {:.1} s in {wall_s:.2} s: {:.0} times real time",
        row.simulated_s,
        row.simulated_s / wall_s
    ));
    Ok(exit)
}

impl Simulation {
    /// Reads the inputs, and checks that the flight is possible.
    ///
    /// # Errors
    /// A file or setting is missing or wrong, or the trajectory is outside the envelope.
    pub fn load(inputs: &Inputs) -> anyhow::Result<Self> {
        let config = configuration(inputs.config.as_deref(), &inputs.settings)?;
        let settings = &config.settings;
        let vehicle = VehicleFile::chosen(inputs.vehicle.as_deref(), settings)?;
        let course = match inputs.trajectory.as_ref().or(settings.trajectory.as_ref()) {
            Some(path) => Course::load(path, &vehicle, &config)?,
            None => Course::Desired(built_in_trajectory()?),
        };
        course.check(&vehicle, &config)?;
        let truth = Truth {
            config: match &inputs.sitl_config {
                Some(path) => SitlConfig::load(path).or_exit(Exit::Usage)?,
                None => SitlConfig::default(),
            },
            effects: inputs.effects.clone(),
            onsets: inputs.onsets.clone(),
        };
        let settings = inputs.settings.clone();
        Ok(Self { config, vehicle, course, truth, settings, seed: inputs.seed })
    }

    /// Flies without a log. `watch` sees the status about every 10 ms of simulated time.
    ///
    /// # Errors
    /// The vehicle cannot be simulated, or the flight does not end.
    pub fn fly(&self, watch: impl FnMut(&Status)) -> anyhow::Result<(Row, Exit)> {
        self.fly_with(None, |_| None, watch)
    }

    /// Flies, and writes a log into `folder`.
    ///
    /// # Errors
    /// As [`fly`](Self::fly), or the log cannot be written.
    pub fn fly_logged(
        &self,
        folder: &Path,
        watch: impl FnMut(&Status),
    ) -> anyhow::Result<(Row, Exit)> {
        self.fly_with(Some(folder), |_| None, watch)
    }

    /// Flies, and writes a log into `folder`; `on_record` receives each record.
    ///
    /// # Errors
    /// As [`fly_logged`](Self::fly_logged).
    pub fn fly_recorded(
        &self,
        folder: &Path,
        mut on_record: impl FnMut(&Record),
    ) -> anyhow::Result<(Row, Exit)> {
        let on_record = |record: &Record| {
            on_record(record);
            None
        };
        self.fly_with(Some(folder), on_record, |_| {})
    }

    /// Flies, with a log if `folder` is given. `on_record` receives each record and may add one.
    fn fly_with(
        &self,
        folder: Option<&Path>,
        mut on_record: impl FnMut(&Record) -> Option<Record>,
        watch: impl FnMut(&Status),
    ) -> anyhow::Result<(Row, Exit)> {
        let mut gatherer = MetricsGatherer::default();
        let mut take = |record: &Record| {
            gatherer.add(record);
            on_record(record)
        };
        let (end, simulated_s, log) = match folder {
            Some(folder) => {
                let Simulated { end, simulated_s, log } =
                    self.flight().fly_logged(folder, take, watch)?;
                (end, simulated_s, Some(log))
            }
            None => {
                let (end, simulated_s) =
                    self.flight().fly_unlogged(|record| drop(take(&record)), watch)?;
                (end, simulated_s, None)
            }
        };
        let (row, exit) = self.row(&end, simulated_s, &gatherer);
        Ok((Row { log, ..row }, exit))
    }

    /// Flies in real time, in a live view.
    fn fly_seen(
        &self,
        folder: Option<&Path>,
        view: &ViewArgs,
        mut on_record: impl FnMut(&Record) -> Option<Record>,
        mut watch: impl FnMut(&Status),
    ) -> anyhow::Result<(Row, Exit)> {
        let info = run_info(&self.config, &self.vehicle, self.course.name(), true, Some(self.seed));
        let mut audience = Audience::start(view, &self.config, &info, &self.course)?;
        let mut listeners = audience.take_listeners();
        let (began, start) = (Instant::now(), lockstep::host_time(0));
        let now = Cell::new(start);
        let on_record = |record: &Record| {
            let more = on_record(record);
            listeners.iter_mut().for_each(|listener| listener.on_record(record));
            // The simulated vehicle has a status every 10 ms.
            if let Record::Truth { stamp, .. } = record {
                now.set(stamp.host);
                let due = began + stamp.host.since(start);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            more
        };
        self.fly_with(folder, on_record, |status| {
            let _ = audience.show(now.get(), status);
            watch(status);
        })
    }

    fn flight(&self) -> SimulatedFlight<'_> {
        SimulatedFlight {
            config: &self.config,
            vehicle: &self.vehicle,
            airframe: &self.vehicle.params,
            truth: &self.truth,
            course: &self.course,
            run: self.course.name(),
            seed: self.seed,
            extra: BTreeMap::new(),
        }
    }

    fn row(
        &self,
        end: &crate::station::End,
        simulated_s: f64,
        gatherer: &MetricsGatherer,
    ) -> (Row, Exit) {
        let (text, exit) = summary::end_text(Some(end), None);
        let row = Row {
            schema: "downwash.simulate",
            schema_version: 1,
            version: env!("CARGO_PKG_VERSION"),
            vehicle: self.vehicle.params.name.clone(),
            trajectory: self.course.name().to_owned(),
            effects: self.truth.effects.clone(),
            onsets: self.truth.onsets.clone(),
            settings: self.settings.clone(),
            seed: self.seed,
            end: text,
            exit: exit.code(),
            simulated_s,
            metrics: gatherer.metrics(self.config.settings.control.rate_hz),
            laps: Vec::new(),
            log: None,
            report: None,
        };
        (row, exit)
    }
}

/// A configuration with settings over its file, by their dotted paths.
///
/// # Errors
/// A file or setting is missing, unknown or impossible.
pub fn configuration(
    file: Option<&Path>,
    settings: &BTreeMap<String, Value>,
) -> anyhow::Result<Config> {
    let flags = settings.iter().map(|(path, value)| ("--set", path.as_str(), value.clone()));
    config::load(file, flags.collect())
}

/// Reads `KEY=VALUE`, the value as TOML if possible, or else as a string.
fn settings(given: &[String]) -> anyhow::Result<BTreeMap<String, Value>> {
    let setting = |text: &String| -> anyhow::Result<(String, Value)> {
        let (key, value) = text
            .split_once('=')
            .ok_or_else(|| anyhow!("--set: expected KEY=VALUE, found {text:?}"))
            .or_exit(Exit::Usage)?;
        let value = value.trim();
        // Parsing the value alone would read a dotted word as a table's header.
        let read = format!("value = {value}").parse::<Table>().ok();
        let read = read.and_then(|mut table| table.remove("value"));
        Ok((key.trim().to_owned(), read.unwrap_or_else(|| Value::String(value.to_owned()))))
    };
    let mut settings = BTreeMap::new();
    for text in given {
        let (key, value) = setting(text)?;
        if settings.insert(key.clone(), value).is_some() {
            return Err(anyhow!("--set: {key} is given twice; give it once")).or_exit(Exit::Usage);
        }
    }
    Ok(settings)
}

/// The text for stdout.
fn text(row: &Row) -> String {
    let metrics = &row.metrics;
    let mut text = format!("flight  {}\n", row.end);
    let mut line = |name: &str, value: Option<f64>, unit: &str| {
        if let Some(value) = value {
            text += &format!("{name:26}{value:10.4} {unit}\n");
        }
    };
    line("position RMSE north", metrics.position_rmse_north_m, "m");
    line("position RMSE east", metrics.position_rmse_east_m, "m");
    line("position RMSE down", metrics.position_rmse_down_m, "m");
    line("position RMSE", metrics.position_rmse_m, "m");
    line("farthest", metrics.position_max_m, "m");
    line("true position RMSE", metrics.true_position_rmse_m, "m");
    line("yaw RMSE", metrics.yaw_rmse_rad, "rad");
    line("greatest tilt", Some(metrics.tilt_max_rad), "rad");
    for (name, path) in [("log", &row.log), ("report", &row.report)] {
        if let Some(path) = path {
            text += &format!("{name:8}{}\n", path.display());
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setting_is_parsed_as_toml_or_taken_as_string() -> anyhow::Result<()> {
        let given = ["control.thrust=0.5", "control.position_m = [1, 2.5, 3]", "control.law=lqr"];
        let read = settings(&given.map(str::to_owned))?;
        assert_eq!(read["control.thrust"], Value::Float(0.5));
        assert_eq!(read["control.position_m"].as_array().map(Vec::len), Some(3));
        assert_eq!(read["control.law"], Value::String("lqr".to_owned()));
        assert!(settings(&["control.thrust".to_owned()]).is_err());
        Ok(())
    }

    #[test]
    fn writing_a_log_leaves_the_row_unchanged() -> anyhow::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-simulate-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let trajectory = folder.join("short.toml");
        std::fs::write(&trajectory, "family = 'hover'\naltitude_m = 1.0\nduration_s = 2.0\n")?;
        let mut effects = EffectSet::new();
        effects.insert_argument("wind:north_m_s=2")?;
        let inputs = Inputs { trajectory: Some(trajectory), effects, seed: 7, ..Inputs::default() };
        let simulation = Simulation::load(&inputs)?;
        let (unlogged, exit) = simulation.fly(|_| {})?;
        let (logged, _) = simulation.fly_logged(&folder, |_| {})?;
        let kept = logged.log.as_deref().is_some_and(Path::exists);
        let from_log = summary::report_on(logged.log.as_deref().unwrap_or(Path::new("")))?;
        std::fs::remove_dir_all(&folder)?;
        assert_eq!(exit, Exit::Ok);
        assert!(kept);
        assert_eq!(unlogged.metrics, logged.metrics);
        // The log's reader finds the same errors.
        let tracking = from_log.summary().tracking.unwrap_or_default();
        let rmse = unlogged.metrics.position_rmse_m.unwrap_or_default();
        assert!((tracking.rmse_3d_m - rmse).abs() < 1e-9, "{tracking:?} {rmse}");
        assert_eq!(unlogged.metrics.ticks, from_log.summary().control.ticks);
        Ok(())
    }
}
