//! `downwash exam --onsets COUNT`: how well the detector dates a change, live and from logs, and how often it
//! reports one where nothing changed.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;
use sitl::config::Autopilot;

use super::super::course::Course;
use super::super::diagnose::audited;
use super::super::simulate::Simulation;
use super::super::simulation::Truth;
use super::super::vehicle_file::VehicleFile;
use super::super::{Exit, ExitContext, configuration, error_text, print_status};
use super::Hall;
use crate::campaign::bench::set_up;
use crate::cli::ExamArgs;
use crate::diagnose::onset::changes;
use crate::exam::interval::Rate;
use crate::exam::onsets::{DETECTABLE, OnsetCase, Recorded};
use crate::health::Monitor;
use crate::log::record::Record;
use crate::log::sink::Listener;
use crate::onset::change::Change;
use crate::onset::columns::Cause;
use crate::onset::detector::Settings;
use crate::plan::Trajectory;

/// The detector finds a change that it dates within this of the true time, s.
const NEAR_S: f64 = 0.5;

/// The JSON of `exam --onsets`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(crate) struct OnsetsSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    seed: u64,
    /// The detector on logs.
    logs: Side,
    /// The detector in flight.
    live: Side,
    /// Wall time of the monitor over the time that it watched: its share of a core.
    monitor_share: f64,
    cases: &'a [OnsetRow],
}

/// The results of one way of detection.
#[derive(JsonSchema, Serialize)]
pub(crate) struct Side {
    /// Detectable changes that the detector dates within 0.5 s of the true time.
    found: Rate,
    /// Found ones whose likeliest cause is the true one.
    named: Rate,
    /// Found ones whose 90 % interval holds the true time.
    held: Rate,
    /// Changes that it reports where there is none: in flights without one, and away from the true one.
    false_onsets: usize,
    /// Flown time that was examined, h.
    hours: f64,
    /// False onsets an hour, with the 95 % interval of a Poisson count.
    false_per_hour: [f64; 3],
}

/// A flight.
#[derive(JsonSchema, Serialize)]
pub(crate) struct OnsetRow {
    name: String,
    vehicle: &'static str,
    autopilot: String,
    /// The effect that sets in; null without one.
    effect: Option<String>,
    cause: Option<Cause>,
    at_s: Option<f64>,
    /// How strongly it shows over the 5 s after it.
    ratio: Option<f64>,
    /// Time examined, s.
    seconds: f64,
    /// Wall time of the monitor, s.
    monitor_s: f64,
    logs: Vec<Change>,
    live: Vec<Change>,
}

pub(super) fn run(args: &ExamArgs, count: usize, hall: &Hall<'_>) -> anyhow::Result<Exit> {
    let rows = hall.each(count + args.nulls, "flying", |number| {
        let name = format!("case_{number:03}");
        match hall.flown_onset(&name, number as u64, number < count) {
            Ok(row) => Ok(Some(row)),
            Err(error) => {
                print_status(format_args!("{name}: left out: {}", error_text(&error)));
                Ok(None)
            }
        }
    })?;
    let rows: Vec<OnsetRow> = rows.into_iter().flatten().collect();
    let summary = OnsetsSummary {
        schema: "downwash.exam.onsets",
        schema_version: 1,
        seed: hall.seed,
        logs: side(&rows, |row| &row.logs),
        live: side(&rows, |row| &row.live),
        monitor_share: rows.iter().map(|row| row.monitor_s).sum::<f64>()
            / rows.iter().map(|row| row.seconds).sum::<f64>().max(1.0),
        cases: &rows,
    };
    hall.conclude(&summary, &text(&summary))
}

fn near<'a>(row: &OnsetRow, changes: &'a [Change]) -> Option<&'a Change> {
    let at = row.at_s?;
    changes.iter().find(|change| (change.at_s - at).abs() <= NEAR_S)
}

fn side(rows: &[OnsetRow], reported: impl Fn(&OnsetRow) -> &Vec<Change>) -> Side {
    let detectable =
        || rows.iter().filter(|row| row.ratio.is_some_and(|ratio| ratio >= DETECTABLE));
    let found = || detectable().filter_map(|row| Some((row, near(row, reported(row))?)));
    // A report next to a change that shows weakly, or that is dated late, is not false.
    let is_false = |row: &OnsetRow, change: &Change| {
        row.at_s.is_none_or(|at| change.at_s < at - NEAR_S || change.at_s > at + 10.0)
    };
    let false_onsets = rows
        .iter()
        .map(|row| reported(row).iter().filter(|change| is_false(row, change)).count())
        .sum();
    let hours = rows.iter().map(|row| row.seconds).sum::<f64>() / 3600.0;
    // The interval of a Poisson mean by Wilson and Hilferty's approximation of chi-squared.
    let bound =
        |count: f64, z: f64| count * (1.0 - 1.0 / (9.0 * count) + z / (3.0 * count.sqrt())).powi(3);
    let count = false_onsets as f64;
    let low = if false_onsets == 0 { 0.0 } else { bound(count, -1.96) };
    Side {
        found: Rate::of(detectable().map(|row| near(row, reported(row)).is_some())),
        named: Rate::of(found().map(|(row, change)| Some(change.cause) == row.cause)),
        held: Rate::of(found().map(|(row, change)| {
            let [low, high] = change.interval_s;
            row.at_s.is_some_and(|at| (low..=high).contains(&at))
        })),
        false_onsets,
        hours,
        false_per_hour: [count, low, bound(count + 1.0, 1.96)].map(|count| count / hours),
    }
}

impl Hall<'_> {
    fn flown_onset(&self, name: &str, number: u64, changes_: bool) -> anyhow::Result<OnsetRow> {
        let case = OnsetCase::draw(self.seed, number, changes_);
        let folder = self.folder(name);
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        let row = self.looked_at(name, &case, &folder);
        if !self.args.keep {
            let _ = fs::remove_dir_all(&folder);
        }
        row
    }

    fn looked_at(&self, name: &str, case: &OnsetCase, folder: &Path) -> anyhow::Result<OnsetRow> {
        let schedule = case.schedule()?;
        let mut vehicle = VehicleFile::load(Path::new(case.vehicle))?;
        if case.autopilot == Autopilot::Arducopter {
            vehicle = in_order_of_arducopter(&vehicle)?;
        }
        let config = configuration(None, &std::collections::BTreeMap::new())?;
        let trajectory = Trajectory::parse(&case.trajectory, Path::new("the case's trajectory"))
            .or_exit(Exit::Failure)?;
        let course = Course::Desired(trajectory);
        course.check(&vehicle, &config)?;
        let params = vehicle.params.clone();
        let simulation = Simulation {
            config,
            vehicle,
            course,
            truth: Truth {
                config: OnsetCase::configured(set_up(case.autopilot, 1.0)),
                effects: schedule.effects.clone(),
                onsets: schedule.onsets.clone(),
            },
            settings: std::collections::BTreeMap::new(),
            seed: case.seed,
        };
        let mut monitor = Monitor::new(&params, Settings::LIVE).or_exit(Exit::Failure)?;
        let mut recorded = Recorded::default();
        let mut monitored = Duration::ZERO;
        let (row, _) = simulation.fly_recorded(folder, |record| {
            let began = Instant::now();
            monitor.on_record(record);
            monitored += began.elapsed();
            if case.change.is_some() {
                keep(&mut recorded, &monitor, record);
            }
        })?;
        let log = row.log.context("no log")?;
        let prepared = audited(std::slice::from_ref(&log), None, &params);
        let flight = prepared.into_iter().next().context("no log was read")?.flight?;
        let seen = changes(&flight, &params, Settings::LOG).or_exit(Exit::Failure)?;
        let ratio = match &case.change {
            Some(_) => Some(recorded.strength(&params, &schedule)?),
            None => None,
        };
        Ok(OnsetRow {
            name: name.to_owned(),
            vehicle: case.vehicle,
            autopilot: format!("{:?}", case.autopilot).to_lowercase(),
            effect: case.change.as_ref().map(|change| change.effect.clone()),
            cause: case.change.as_ref().map(|change| change.cause),
            at_s: case.change.as_ref().map(|change| change.at_s),
            ratio,
            seconds: seen.seconds,
            monitor_s: monitored.as_secs_f64(),
            logs: seen.changes,
            live: monitor.take_changes().collect(),
        })
    }
}

/// The vehicle with its rotors in the order of ArduCopter's outputs: front right, rear left, front left,
/// rear right.
fn in_order_of_arducopter(vehicle: &VehicleFile) -> anyhow::Result<VehicleFile> {
    let mut params = vehicle.params.clone();
    let [front_right, rear_right, rear_left, front_left] = params.rotors;
    params.rotors = [front_right, rear_left, front_left, rear_right];
    let text = serde_json::to_string(&params).context("the vehicle file")?;
    VehicleFile::parse(&vehicle.name, text)
}

/// Keeps the samples from which the strength of a change follows.
fn keep(recorded: &mut Recorded, monitor: &Monitor, record: &Record) {
    let seconds = |stamp: &crate::log::record::Stamp| {
        stamp.vehicle.map(|vehicle| vehicle.as_us() as f64 * 1e-6)
    };
    match record {
        Record::Tick(tick) => {
            recorded.reports.extend(seconds(&tick.stamp).map(|time| (time, tick.state)));
        }
        Record::Truth { stamp, truth } => recorded
            .truth
            .extend(seconds(stamp).map(|time| (time, truth.state, truth.rotor_thrust))),
        Record::Motors { stamp, outputs } => {
            let shares = monitor.shares_of(*outputs);
            recorded.outputs.extend(seconds(stamp).zip(shares));
        }
        _ => {}
    }
}

fn text(summary: &OnsetsSummary<'_>) -> String {
    let mut text = format!(
        "{:9} {:9} {:10} {:>7} {:>7} {:>8} {:>8}  effect\n",
        "case", "vehicle", "autopilot", "ratio", "at/s", "logs", "live"
    );
    for row in summary.cases {
        let onset_text = |changes: &[Change]| match (row.at_s, near(row, changes), changes) {
            (_, _, []) => "-".to_owned(),
            (Some(at), Some(change), _) => format!("{:+.2}", change.at_s - at),
            (_, _, [first, ..]) => format!("{:.1}!", first.at_s),
        };
        text += &format!(
            "{:9} {:9} {:10} {:>7} {:>7} {:>8} {:>8}  {}\n",
            row.name,
            row.vehicle,
            row.autopilot,
            row.ratio.map_or("-".to_owned(), |ratio| format!("{ratio:.1}")),
            row.at_s.map_or("-".to_owned(), |at| format!("{at:.1}")),
            onset_text(&row.logs),
            onset_text(&row.live),
            row.effect.as_deref().unwrap_or("none"),
        );
    }
    for (what, side) in [("from logs", &summary.logs), ("live", &summary.live)] {
        for (of, rate) in [
            ("detectable changes found within 0.5 s", &side.found),
            ("of these, the right cause first", &side.named),
            ("of these, 90 % interval contains the time", &side.held),
        ] {
            let [low, high] = rate.interval.map(|end| 100.0 * end);
            text += &format!(
                "{what:10} {of:42} {} of {} (95 %: {low:.0} to {high:.0} %)\n",
                rate.count, rate.of
            );
        }
        let [rate, low, high] = side.false_per_hour;
        text += &format!(
            "{what:10} {:42} {} in {:.1} h: {rate:.3} per hour (95 %: {low:.3} to {high:.3})\n",
            "false onsets", side.false_onsets, side.hours
        );
    }
    text += &format!("the monitor uses {:.2} % of a core\n", 100.0 * summary.monitor_share);
    text
}
