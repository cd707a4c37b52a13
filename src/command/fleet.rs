//! `downwash diagnose --fleet`: many vehicles of a type: the effects that they share, and those of
//! single ones.

mod row;
mod vehicles;

use std::collections::BTreeMap;
use std::io::{self, IsTerminal};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::json;
use vehicle::VehicleParams;

use self::row::{Done, Row};
use self::vehicles::{Given, vehicles};
use super::diagnose::{audited, parted};
use super::improved::{Additions, Form};
use super::logs::check_named;
use super::output::{check_output, create_report_folder, sha256};
use super::progress::count_bar;
use super::rows::{Folder, Header, Rows, interrupted};
use super::sweep::alone;
use super::vehicle_file::warn;
use super::{
    Exit, ExitContext, Interruption, error_text, print_json, print_status, print_text, write_file,
};
use crate::cli::{DiagnoseArgs, FailOnVerdict, Shard};
use crate::diagnose::answer::LogAnswer;
use crate::diagnose::fleet::answer::{FleetAnswer, State, VehicleAnswer, effects_of};
use crate::diagnose::fleet::shared::Fleet;
use crate::diagnose::fleet::survey::{Beside, Survey, scales, survey};
use crate::diagnose::fleet::text::{report, sentence};
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::pipeline::diagnose;
use crate::report::fleet::html;

/// Largest number of vehicles from which the scale of the file's tolerances is found.
const SAMPLE: usize = 6;
/// Largest number of twins of a vehicle: the fleet as a whole has many.
const TWINS_MAX: u32 = 8;
/// Stages: the scale of the tolerances, surveys beside ever more effects of the type, the vehicles' diagnoses.
const SCALES: usize = 0;
const SURVEYS: usize = 1;
const OWN: usize = 5;
const STAGES: usize = 6;

/// The answer as it is printed and written.
#[derive(JsonSchema, Serialize)]
pub(super) struct Told<'a> {
    schema: &'static str,
    schema_version: u32,
    #[serde(flatten)]
    answer: &'a FleetAnswer,
}

/// A diagnosis of a fleet.
pub struct FleetFinding {
    /// The answer.
    pub answer: FleetAnswer,
    vehicle: VehicleParams,
    fleet: Fleet,
}

/// A vehicle, read.
struct Read {
    given: Given,
    flights: Vec<PreparedFlight>,
    faults: Vec<String>,
    /// Why it has no flight.
    reasons: Vec<String>,
}

pub(super) fn run(
    args: &DiagnoseArgs,
    source: &Path,
    interruption: &Interruption,
) -> anyhow::Result<Exit> {
    let stop = interruption.flag();
    let bar = count_bar(0);
    let shows = io::stderr().is_terminal();
    let progress = |stage: &str, done: usize, of: usize| {
        if shows {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
        } else {
            print_status(format_args!("... {stage}: {done} of {of} vehicles"));
        }
    };
    let found = find(args, source, &stop, &progress);
    bar.finish_and_clear();
    match found? {
        Some(finding) => finding.print(args),
        None => Ok(interrupted(&args.rows)),
    }
}

/// Diagnoses a fleet; `None` if `stop` was set meanwhile. `progress` receives the name of the
/// stage, the number of vehicles done and the number of all.
///
/// # Errors
/// Files that cannot be read, a folder of other rows, or no vehicle with usable flights.
pub fn find(
    args: &DiagnoseArgs,
    source: &Path,
    stop: &Arc<AtomicBool>,
    progress: &(dyn Fn(&str, usize, usize) + Sync),
) -> anyhow::Result<Option<FleetFinding>> {
    let vehicle = VehicleParams::load(&args.vehicle).or_exit(Exit::Usage)?;
    warn(&args.vehicle, &vehicle);
    let given = vehicles(source).or_exit(Exit::Usage)?;
    let logs = || given.iter().flat_map(|given| &given.logs);
    check_named(logs(), args.mapping.as_deref())?;
    create_report_folder(args.report.as_deref())?;
    if let Some(out) = &args.out {
        check_output(out, logs().map(|log| log.as_path()))?;
    }
    let total = given.len();
    let header = Header {
        schema: "downwash.diagnose.fleet".to_owned(),
        schema_version: 1,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        manifest_sha256: fingerprint(args, &vehicle, &given)?,
        points: STAGES * total,
    };
    let folder = Folder::open(&args.rows, "fleet.json", &header).or_exit(Exit::Usage)?;
    let count = AtomicUsize::new(0);
    let read: Vec<Read> = given
        .into_par_iter()
        .with_max_len(1)
        .map(|given| {
            let read = read_one(given, args, &vehicle);
            progress("read", count.fetch_add(1, Ordering::Relaxed) + 1, total);
            read
        })
        .collect();
    let work = Work {
        args,
        vehicle: &vehicle,
        read: &read,
        rows: Mutex::new(folder.append(Shard { index: 1, count: 1 })?),
        done: folder.rows()?,
        stop,
        progress,
    };
    work.find()
}

/// Everything on which the rows depend.
fn fingerprint(
    args: &DiagnoseArgs,
    vehicle: &VehicleParams,
    given: &[Given],
) -> anyhow::Result<String> {
    let mut text = serde_json::to_string(vehicle).context("the vehicle file")?;
    text += &format!("\n{} {} {:?}\n", args.twins.min(TWINS_MAX), args.seed, args.without);
    for Given { name, logs } in given {
        for log in logs {
            let file = std::fs::metadata(log)
                .with_context(|| log.display().to_string())
                .or_exit(Exit::Usage)?;
            let of = log.file_name().unwrap_or_default().to_string_lossy();
            text += &format!("{name} {of} {}\n", file.len());
        }
    }
    Ok(sha256(text))
}

fn read_one(given: Given, args: &DiagnoseArgs, vehicle: &VehicleParams) -> Read {
    let logs = audited(&given.logs, args.mapping.as_deref(), vehicle);
    let mut read = Read { given, flights: Vec::new(), faults: Vec::new(), reasons: Vec::new() };
    for log in logs {
        let name = log.audit.as_ref().map_or("", |audit: &LogAnswer| audit.name.as_str());
        if let Some(audit) = log.audit.as_ref().filter(|audit| audit.is_faulty()) {
            read.faults.extend(audit.faults.iter().map(|fault| format!("{name}: {fault}")));
        }
        match log.flight {
            Ok(flight) => read.flights.push(flight),
            Err(error) => read.reasons.push(error_text(&error)),
        }
    }
    read
}

/// A fleet during its diagnosis.
struct Work<'a> {
    args: &'a DiagnoseArgs,
    vehicle: &'a VehicleParams,
    read: &'a [Read],
    rows: Mutex<Rows<Row>>,
    /// Rows of an earlier run.
    done: BTreeMap<usize, Row>,
    stop: &'a Arc<AtomicBool>,
    progress: &'a (dyn Fn(&str, usize, usize) + Sync),
}

impl Work<'_> {
    fn find(&self) -> anyhow::Result<Option<FleetFinding>> {
        let usable: Vec<usize> =
            (0..self.read.len()).filter(|v| !self.read[*v].flights.is_empty()).collect();
        if usable.is_empty() {
            // A few of many suffice to show what is wrong.
            let reasons = self.read.iter().flat_map(|read| &read.reasons).map(String::as_str);
            let reasons: Vec<&str> = reasons.take(3).collect();
            return Err(anyhow!("no vehicle has a log that can be used: {}", reasons.join("; ")))
                .or_exit(Exit::Usage);
        }
        let Some(scale) = self.scale(&usable)? else { return Ok(None) };
        let mut fleet = Fleet::default();
        let mut surveys: Vec<(usize, Survey)> = Vec::new();
        let mut round = 0;
        loop {
            let shared = fleet.shared.iter().map(|cause| (cause.key.clone(), cause.values()));
            let beside = Beside { scale, shared: shared.collect() };
            let what = format!("look {}", round + 1);
            let earlier = std::mem::take(&mut surveys);
            let Some(done) = self.stage(SURVEYS + round, &what, &usable, |vehicle| {
                let case = self.case(self.vehicle, &self.read[vehicle].flights, &[]);
                let known = earlier.iter().find(|(of, _)| *of == vehicle);
                let chance = known.map(|(_, survey)| survey.chance.as_slice());
                Ok(Done::Survey(Box::new(survey(&case, &self.settings(), &beside, chance)?)))
            })?
            else {
                return Ok(None);
            };
            surveys = done
                .into_iter()
                .filter_map(|(vehicle, done)| match done {
                    Done::Survey(survey) => Some((vehicle, *survey)),
                    _ => None,
                })
                .collect();
            let all: Vec<&Survey> = surveys.iter().map(|(_, survey)| survey).collect();
            round += 1;
            if !fleet.update(&all) || SURVEYS + round >= OWN {
                break;
            }
        }
        if surveys.is_empty() {
            return Err(anyhow!("no vehicle's flights hold anything to compare with"))
                .or_exit(Exit::Usage);
        }
        let Some(own) = self.own(&usable, &fleet)? else { return Ok(None) };
        let names: Vec<(&str, &Survey)> = surveys
            .iter()
            .map(|(vehicle, survey)| (self.read[*vehicle].given.name.as_str(), survey))
            .collect();
        let mut answer = FleetAnswer::new(&fleet, self.vehicle, &names, scale, own);
        answer.sentence = sentence(&answer);
        Ok(Some(FleetFinding { answer, vehicle: self.vehicle.clone(), fleet }))
    }

    fn settings(&self) -> Settings {
        let twins = self.args.twins.min(TWINS_MAX);
        Settings { seed: self.args.seed, twins, discover: false }
    }

    fn case<'b>(
        &'b self,
        vehicle: &'b VehicleParams,
        fitted: &'b [PreparedFlight],
        held_out: &'b [PreparedFlight],
    ) -> DiagnosisInput<'b> {
        let without = &self.args.without;
        DiagnosisInput { vehicle, fitted, held_out, blocked: false, without, stop: self.stop }
    }

    /// The scale of the tolerances that the file does not state, under which the flights of some
    /// vehicles are most likely together.
    fn scale(&self, usable: &[usize]) -> anyhow::Result<Option<f64>> {
        let step = usable.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<usize> = usable.iter().copied().step_by(step).collect();
        let done = self.stage(SCALES, "assessing the vehicle file", &sample, |vehicle| {
            let case = self.case(self.vehicle, &self.read[vehicle].flights, &[]);
            Ok(Done::Scales(scales(&case)?))
        })?;
        let Some(done) = done else { return Ok(None) };
        let mut sums: Vec<[f64; 2]> = Vec::new();
        for found in done.iter().filter_map(|(_, done)| match done {
            Done::Scales(found) => Some(found),
            _ => None,
        }) {
            for [scale, evidence] in found {
                match sums.iter_mut().find(|sum| sum[0] == *scale) {
                    Some(sum) => sum[1] += evidence,
                    None => sums.push([*scale, *evidence]),
                }
            }
        }
        let best = sums.iter().max_by(|a, b| a[1].total_cmp(&b[1]));
        Ok(Some(best.map_or(1.0, |best| best[0])))
    }

    /// Diagnoses what each vehicle has beyond its type.
    fn own(&self, usable: &[usize], fleet: &Fleet) -> anyhow::Result<Option<Vec<VehicleAnswer>>> {
        let mut of_type = self.vehicle.clone();
        let effects = effects_of(self.vehicle, &fleet.shared);
        of_type.modelled_effects = of_type.modelled_effects.overlay(&effects);
        let of_type = of_type.checked().or_exit(Exit::Failure)?;
        let done = self.stage(OWN, "each by itself", usable, |vehicle| {
            let Read { given, flights, faults, .. } = &self.read[vehicle];
            let (fitted, held_out) = parted(flights.clone())?;
            let case = self.case(&of_type, &fitted, &held_out);
            let found = diagnose(&case, &self.settings(), &|_| {})?;
            let answer = VehicleAnswer::of(&given.name, &found.answer, faults.clone());
            Ok(Done::Own(Box::new(answer)))
        })?;
        let Some(done) = done else { return Ok(None) };
        let mut done: BTreeMap<usize, Done> = done.into_iter().collect();
        let answers = self.read.iter().enumerate().map(|(vehicle, read)| {
            let name = &read.given.name;
            match done.remove(&vehicle) {
                Some(Done::Own(answer)) => *answer,
                Some(Done::Failed(reason)) => VehicleAnswer::unusable(name, reason, Vec::new()),
                _ => VehicleAnswer::unusable(name, read.reasons.join("; "), read.faults.clone()),
            }
        });
        Ok(Some(answers.collect()))
    }

    /// Runs a stage for these vehicles, in parallel for those without a row. `None` if interrupted.
    fn stage(
        &self,
        stage: usize,
        what: &str,
        vehicles: &[usize],
        work: impl Fn(usize) -> anyhow::Result<Done> + Sync,
    ) -> anyhow::Result<Option<Vec<(usize, Done)>>> {
        let count = AtomicUsize::new(0);
        let done: Vec<Option<(usize, Done)>> = vehicles
            .par_iter()
            .with_max_len(1)
            .map(|vehicle| {
                let number = stage * self.read.len() + vehicle;
                let done = match self.done.get(&number) {
                    Some(row) => row.done.clone(),
                    None if self.stop.load(Ordering::Relaxed) => return Ok(None),
                    None => {
                        let done = alone(|| work(*vehicle));
                        // An interrupted stage has no result.
                        if self.stop.load(Ordering::Relaxed) {
                            return Ok(None);
                        }
                        let done = done.unwrap_or_else(|error| Done::Failed(error_text(&error)));
                        let name = self.read[*vehicle].given.name.clone();
                        let row = Row { number, vehicle: name, done: done.clone() };
                        self.rows.lock().unwrap_or_else(PoisonError::into_inner).add(&row)?;
                        done
                    }
                };
                (self.progress)(what, count.fetch_add(1, Ordering::Relaxed) + 1, vehicles.len());
                Ok(Some((*vehicle, done)))
            })
            .collect::<anyhow::Result<_>>()?;
        Ok(done.into_iter().collect())
    }
}

impl FleetFinding {
    fn answer_document(&self) -> Told<'_> {
        Told { schema: "downwash.diagnose.fleet", schema_version: 1, answer: &self.answer }
    }

    /// The vehicle file of the type, with the shared effects.
    fn improved(&self, args: &DiagnoseArgs, out: &Path) -> anyhow::Result<String> {
        let text = vehicle::read(&args.vehicle)
            .with_context(|| format!("cannot read {}", args.vehicle.display()))
            .or_exit(Exit::Usage)?;
        let about = self.answer.shared.iter().map(|cause| {
            let spread: BTreeMap<&str, f64> =
                cause.numbers.iter().map(|number| (number.name.as_str(), number.spread)).collect();
            let about = json!({
                "vehicles": cause.vehicles,
                "probability": cause.probability,
                "probability_of_type": cause.of_type,
                "intervals_90": cause.intervals(),
                "spread_between_vehicles": spread,
            });
            (cause.id.clone(), about)
        });
        let effects = effects_of(&self.vehicle, &self.fleet.shared);
        let additions = Additions::found(&effects, about)?;
        additions.to_file(&text, &self.vehicle, [Form::of(&args.vehicle, &text), Form::of(out, "")])
    }

    fn print(&self, args: &DiagnoseArgs) -> anyhow::Result<Exit> {
        let Self { answer, vehicle, .. } = self;
        if let Some(folder) = &args.report {
            let page = html(answer, &vehicle.name);
            write_file(&folder.join("report.html"), page.as_bytes())?;
            let json =
                serde_json::to_string_pretty(&self.answer_document()).context("the answer")?;
            write_file(&folder.join("report.json"), json.as_bytes())?;
        }
        if let Some(out) = &args.out {
            write_file(out, self.improved(args, out)?.as_bytes())?;
        }
        if args.json {
            print_json(&self.answer_document())?;
        } else {
            print_text(&report(answer))?;
        }
        let has_effect =
            !(answer.shared.is_empty() && answer.groups.is_empty() && answer.open.is_empty())
                || answer.vehicles.iter().any(|vehicle| !vehicle.effects.is_empty());
        let is_odd =
            |vehicle: &VehicleAnswer| matches!(vehicle.state, State::Unknown | State::Faulty);
        let fails = match args.fail_on {
            Some(FailOnVerdict::Effect) => has_effect,
            Some(FailOnVerdict::Gap) => has_effect || answer.vehicles.iter().any(is_odd),
            Some(FailOnVerdict::Shared) => !answer.shared.is_empty(),
            None => false,
        };
        Ok(if fails { Exit::Check } else { Exit::Ok })
    }
}
