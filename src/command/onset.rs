//! `downwash onset`: when something of the vehicle changed.

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

use super::diagnose::audited;
use super::logs::{check_named, listed};
use super::output::create_report_folder;
use super::patience::Patience;
use super::vehicle_file::warn;
use super::{Exit, ExitContext, error_text, print_json, print_status, print_text, write_file};
use crate::cli::OnsetArgs;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::onset::{OnsetReport, changes};
use crate::onset::change::Change;
use crate::onset::detector::Settings;
use crate::onset::history::{Step, of_flight, steps};
use crate::onset::text::{line, step_line};
use crate::report::onset::SeenFlight;

/// The JSON of `onset`.
#[derive(JsonSchema, Serialize)]
pub(super) struct OnsetAnswer {
    schema: &'static str,
    schema_version: u32,
    vehicle: String,
    /// Least evidence for which the detector reports a change, nats.
    bound: f64,
    flights: Vec<FlightAnswer>,
    /// Changes between flights, in the order of the arguments.
    steps: Vec<Step>,
}

/// One flight.
#[derive(JsonSchema, Serialize)]
pub(super) struct FlightAnswer {
    log: String,
    /// Examined airborne time, s.
    seconds: f64,
    /// Changes in it, in the order of time.
    changes: Vec<Change>,
}

/// The changes, and the samples that show them.
pub struct Changes {
    answer: OnsetAnswer,
    seen: Vec<OnsetReport>,
    bound: f64,
}

pub(super) fn run(args: &OnsetArgs) -> anyhow::Result<Exit> {
    let _patience = Patience::with("looking for changes in the logs".to_owned());
    create_report_folder(args.report.as_deref())?;
    let found = changed(args)?;
    if let Some(folder) = &args.report {
        write_file(&folder.join("report.html"), found.to_html().as_bytes())?;
        let json = serde_json::to_vec_pretty(&found.answer).context("report.json")?;
        write_file(&folder.join("report.json"), &json)?;
    }
    let answer = &found.answer;
    if args.json {
        print_json(answer)?;
    } else {
        print_text(&found.to_text())?;
    }
    let has_changed =
        !answer.steps.is_empty() || answer.flights.iter().any(|flight| !flight.changes.is_empty());
    Ok(if args.fail_on_change && has_changed { Exit::Check } else { Exit::Ok })
}

/// Finds when something of the vehicle changed, within flights and between them.
///
/// # Errors
/// Files that cannot be read, or logs without data to compare with.
pub fn changed(args: &OnsetArgs) -> anyhow::Result<Changes> {
    let vehicle = VehicleParams::load(&args.vehicle).or_exit(Exit::Usage)?;
    warn(&args.vehicle, &vehicle);
    check_named(&args.logs, args.mapping.as_deref())?;
    let settings = Settings { false_alarm_h: args.false_alarm_h, ..Settings::LOG };
    let mut flights: Vec<(String, PreparedFlight)> = Vec::new();
    for (path, log) in args.logs.iter().zip(audited(&args.logs, args.mapping.as_deref(), &vehicle))
    {
        match log.flight {
            Ok(flight) => flights.push((path.display().to_string(), flight)),
            Err(error) => {
                print_status(format_args!("{}: left out: {}", path.display(), error_text(&error)))
            }
        }
    }
    if flights.is_empty() {
        return Err(anyhow!("none of the logs can be used: {}", listed(&args.logs)))
            .or_exit(Exit::Usage);
    }
    let seen: Result<Vec<OnsetReport>, _> =
        flights.par_iter().map(|(_, flight)| changes(flight, &vehicle, settings)).collect();
    let seen = seen.or_exit(Exit::Usage)?;
    // A flight too short to examine shows nothing of the vehicle.
    let dated: Vec<_> = seen.iter().map(|seen| of_flight(&seen.present)).collect();
    let known: Vec<usize> = (0..dated.len()).filter(|index| dated[*index].is_some()).collect();
    let values: Vec<_> = dated.into_iter().flatten().collect();
    let mut steps = steps(&values);
    steps.iter_mut().for_each(|step| step.from = known[step.from]);
    let answer = OnsetAnswer {
        steps,
        schema: "downwash.onset",
        schema_version: 1,
        vehicle: vehicle.name.clone(),
        bound: settings.bound(),
        flights: flights
            .iter()
            .zip(&seen)
            .map(|((log, _), seen)| FlightAnswer {
                log: log.clone(),
                seconds: seen.seconds,
                changes: seen.changes.clone(),
            })
            .collect(),
    };
    Ok(Changes { answer, seen, bound: settings.bound() })
}

impl Changes {
    /// The answer as `--json` prints it.
    ///
    /// # Errors
    /// Of writing JSON; none is known.
    pub fn to_json(&self) -> anyhow::Result<String> {
        serde_json::to_string(&self.answer).context("the answer")
    }

    /// The report, one page.
    pub fn to_html(&self) -> String {
        let Self { answer, seen, bound } = self;
        let logs = answer.flights.iter().map(|flight| &flight.log);
        let shown: Vec<SeenFlight<'_>> =
            logs.zip(seen).map(|(log, seen)| SeenFlight { log, seen }).collect();
        crate::report::onset::html(&answer.vehicle, *bound, &shown, &answer.steps)
    }

    /// The answer in words.
    pub fn to_text(&self) -> String {
        text(&self.answer)
    }
}

fn text(answer: &OnsetAnswer) -> String {
    let mut text = String::new();
    for flight in &answer.flights {
        text += &format!("{} ({:.0} s in the air)\n", flight.log, flight.seconds);
        if flight.changes.is_empty() {
            text += "    nothing changed\n";
        }
        for change in &flight.changes {
            text += &format!("    {}\n", line(change));
        }
    }
    for step in &answer.steps {
        text += &format!("{}\n", step_line(step));
    }
    text
}
