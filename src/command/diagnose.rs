//! `downwash diagnose`: locates the gap, names the effect that causes it, and says how far it
//! shrinks.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::effects::{EffectSet, EstimatorLatency};

use super::improved::{Additions, Form};
use super::logs::{check_named, listed, open_for};
use super::output::{check_output, create_report_folder, is_same_file};
use super::patience::Patience;
use super::setup::capability;
use super::vehicle_file::warn;
use super::{
    Exit, ExitContext, config, error_text, print_json, print_status, print_text, write_file,
};
use crate::audit::{Audit, UnusableSpan, align};
use crate::cli::{DiagnoseArgs, FailOnVerdict};
use crate::diagnose::answer::text::report;
use crate::diagnose::answer::{Answer, LogAnswer};
use crate::diagnose::flights::input::{DiagnosisInput, Settings};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::rotor_order;
use crate::diagnose::next_flight::{NextFlight, Proposal, next_flight};
use crate::diagnose::onset::{OnsetReport, changes};
use crate::diagnose::pipeline::{Diagnosis, diagnose};
use crate::diagnose::verdict::Verdict;
use crate::learn::commands::Onboard;
use crate::log::import::{Flight, tell_apart};
use crate::onset::detector as onset;
use crate::plan::manoeuvres::Room;
use crate::report::onset::SeenFlight;

/// The answer as it is printed and written.
#[derive(JsonSchema, Serialize)]
pub(super) struct Told<'a> {
    schema: &'static str,
    schema_version: u32,
    #[serde(flatten)]
    answer: &'a Answer,
}

/// A diagnosis and its inputs.
pub struct Finding {
    args: DiagnoseArgs,
    vehicle: VehicleParams,
    /// The answer.
    pub answer: Answer,
    effects: EffectSet,
    /// What the change detector saw of each flight, for the report.
    seen: Vec<(String, OnsetReport)>,
}

/// Guard between the halves of a single flight, s.
const GUARD_S: f64 = 2.0;

pub(super) fn run(args: &DiagnoseArgs) -> anyhow::Result<Exit> {
    if args.fail_on == Some(FailOnVerdict::Shared) {
        return Err(anyhow!("--fail-on shared: expected --fleet")).or_exit(Exit::Usage);
    }
    // An interruption ends the whole process.
    let never = Arc::default();
    find(args, &never, &|stage| print_status(format_args!("... {stage}")))?.print()
}

/// The logs of the flags, the new ones last.
fn paths(args: &DiagnoseArgs) -> Vec<PathBuf> {
    let mut paths = args.logs.clone();
    for path in &args.holdout {
        if !is_among(path, &paths) {
            paths.push(path.clone());
        }
    }
    paths.retain(|path| !is_among(path, &args.new));
    paths.extend(args.new.iter().cloned());
    paths
}

/// Whether `path` is one of `files`, however it is written: `--holdout ./a.ulg` names `a.ulg`.
fn is_among(path: &Path, files: &[PathBuf]) -> bool {
    files.iter().any(|file| file == path || is_same_file(file, path))
}

/// Usable flights by their use, and the audits of all logs.
struct Sorted {
    fitted: Vec<PreparedFlight>,
    held_out: Vec<PreparedFlight>,
    new: Vec<PreparedFlight>,
    logs: Vec<LogAnswer>,
}

/// Reads logs, and reports those that are left out.
fn sorted(args: &DiagnoseArgs, paths: &[PathBuf], vehicle: &VehicleParams) -> Sorted {
    let read = audited(paths, args.mapping.as_deref(), vehicle);
    let mut sorted =
        Sorted { fitted: Vec::new(), held_out: Vec::new(), new: Vec::new(), logs: Vec::new() };
    for (path, log) in paths.iter().zip(read) {
        match log.flight {
            Ok(flight) if is_among(path, &args.new) => sorted.new.push(flight),
            Ok(flight) if is_among(path, &args.holdout) => sorted.held_out.push(flight),
            Ok(flight) => sorted.fitted.push(flight),
            Err(error) => {
                print_status(format_args!("{}: left out: {}", path.display(), error_text(&error)))
            }
        }
        sorted.logs.extend(log.audit);
    }
    sorted
}

/// Diagnoses, and writes the files that do not depend on the answer's form: the next flight and the
/// evidence. `progress` receives the name of each stage as it begins. Once `stop` is set, the work
/// ends soon, without a finding.
///
/// # Errors
/// Files that cannot be read, or logs without data to compare with.
pub fn find(
    args: &DiagnoseArgs,
    stop: &Arc<AtomicBool>,
    progress: &dyn Fn(&str),
) -> anyhow::Result<Finding> {
    let vehicle = VehicleParams::load(&args.vehicle).or_exit(Exit::Usage)?;
    // Errors that would come after the work are found before it. Other outputs may go into the
    // report's folder.
    let logs = || args.logs.iter().chain(&args.holdout).chain(&args.new);
    check_named(logs(), args.mapping.as_deref())?;
    create_report_folder(args.report.as_deref())?;
    let outputs = [&args.out, &args.law, &args.next_flight, &args.evidence];
    for out in outputs.into_iter().flatten() {
        check_output(out, logs().map(PathBuf::as_path))?;
    }
    warn(&args.vehicle, &vehicle);
    let proposing = match (&args.next_flight, &args.config) {
        (None, None) => None,
        _ => Some(config::load(args.config.as_deref(), vec![])?.settings),
    };
    let paths = paths(args);
    let Sorted { mut fitted, mut held_out, mut new, logs } = sorted(args, &paths, &vehicle);
    if held_out.is_empty() && !args.holdout.is_empty() {
        print_status(format_args!(
            "--holdout: none of its logs can be used; other flights are held out"
        ));
    }
    if fitted.is_empty() {
        fitted.append(&mut new);
    }
    if fitted.is_empty() && held_out.is_empty() && logs.iter().any(LogAnswer::is_faulty) {
        let answer = Answer::data_fault(logs);
        let (effects, seen) = (EffectSet::new(), Vec::new());
        return Ok(Finding { args: args.clone(), vehicle, answer, effects, seen });
    }
    if fitted.is_empty() && held_out.is_empty() {
        return Err(anyhow!("none of the logs can be used: {}", listed(&paths)))
            .or_exit(Exit::Usage);
    }
    let mut seen = Vec::new();
    if args.report.is_some() {
        progress("when something changed");
        for flight in fitted.iter().chain(&held_out).chain(&new) {
            let of_flight = changes(flight, &vehicle, onset::Settings::LOG).or_exit(Exit::Usage)?;
            seen.push((flight.name.clone(), of_flight));
        }
    }
    let blocked = held_out.is_empty() && fitted.len() == 1 || fitted.is_empty();
    if fitted.is_empty() {
        fitted = std::mem::take(&mut held_out);
    }
    if held_out.is_empty() {
        if blocked {
            print_status(format_args!(
                "one flight: its second part is held out, {GUARD_S} s after the first"
            ));
        }
        (fitted, held_out) = parted(fitted).with_context(|| listed(&paths)).or_exit(Exit::Usage)?;
    }
    fitted.append(&mut new);
    let case = DiagnosisInput {
        vehicle: &vehicle,
        fitted: &fitted,
        held_out: &held_out,
        blocked,
        without: &args.without,
        stop,
    };
    let settings = Settings { seed: args.seed, twins: args.twins, discover: args.discover };
    let mut diagnosis = diagnose(&case, &settings, progress)
        .with_context(|| listed(&paths))
        .or_exit(Exit::Usage)?;
    if let Some((path, proposing)) = args.next_flight.as_ref().zip(proposing) {
        progress("which flight next");
        let next = propose(args, &proposing, &vehicle, &diagnosis)?;
        match &next {
            Some(next) => write_file(path, next.file.as_bytes())?,
            None => print_status(format_args!(
                "no next flight is needed, or none would add information"
            )),
        }
        diagnosis.answer.next_flight = next;
    }
    if let Some(path) = &args.evidence {
        let evidence = serde_json::to_vec(&diagnosis.evidence).context("the evidence")?;
        write_file(path, &evidence)?;
    }
    diagnosis.answer.add_logs(logs);
    let (answer, effects) = (diagnosis.answer, diagnosis.effects);
    Ok(Finding { args: args.clone(), vehicle, answer, effects, seen })
}

impl Finding {
    /// The answer as `--json` prints it.
    ///
    /// # Errors
    /// Of writing JSON; none is known.
    pub fn to_json(&self) -> anyhow::Result<String> {
        serde_json::to_string_pretty(&self.answer_document()).context("the answer")
    }

    /// The report, one page.
    pub fn to_html(&self) -> String {
        let seen: Vec<SeenFlight<'_>> =
            self.seen.iter().map(|(log, seen)| SeenFlight { log, seen }).collect();
        crate::report::diagnosis::html(&self.answer, &self.vehicle.name, &seen)
    }

    /// The answer in words.
    pub fn to_text(&self) -> String {
        report(&self.answer)
    }

    /// An effects file with the named law and the effects beside it; `None` without a law.
    ///
    /// # Errors
    /// Of writing TOML; none is known.
    pub fn law(&self) -> anyhow::Result<Option<String>> {
        let is_named = self.answer.law.as_ref().is_some_and(|law| law.named);
        is_named.then(|| toml::to_string(&self.effects).context("the law")).transpose()
    }

    /// The vehicle file with the effects found, in the form of a file named `out`.
    ///
    /// # Errors
    /// The vehicle file is gone, or cannot be written in this form.
    pub fn improved(&self, out: &Path) -> anyhow::Result<String> {
        let Self { args, vehicle, answer, effects, .. } = self;
        let text = vehicle::read(&args.vehicle)
            .with_context(|| format!("cannot read {}", args.vehicle.display()))
            .or_exit(Exit::Usage)?;
        let logs = args.logs.iter().chain(&args.holdout).chain(&args.new);
        let names = logs.filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
        let names: BTreeSet<String> = names.collect();
        let additions = Additions::new(effects, answer, &Vec::from_iter(names))?;
        let forms = [Form::of(&args.vehicle, &text), Form::of(out, "")];
        additions.to_file(&text, vehicle, forms)
    }

    fn answer_document(&self) -> Told<'_> {
        Told { schema: "downwash.diagnose", schema_version: 2, answer: &self.answer }
    }

    /// Writes the requested files, and prints the answer.
    fn print(&self) -> anyhow::Result<Exit> {
        let Self { args, answer, .. } = self;
        if let Some(folder) = &args.report {
            write_file(&folder.join("report.html"), self.to_html().as_bytes())?;
            write_file(&folder.join("report.json"), self.to_json()?.as_bytes())?;
        }
        if let Some(out) = &args.out {
            write_file(out, self.improved(out)?.as_bytes())?;
        }
        if let Some(path) = &args.law {
            match self.law()? {
                Some(law) => write_file(path, law.as_bytes())?,
                None => print_status(format_args!(
                    "{}: not written, because no law is named",
                    path.display()
                )),
            }
        }
        if args.json {
            print_json(&self.answer_document())?;
        } else {
            print_text(&self.to_text())?;
        }
        Ok(match args.fail_on {
            Some(FailOnVerdict::Effect) if answer.verdict == Verdict::Effect => Exit::Check,
            Some(FailOnVerdict::Gap) if answer.verdict != Verdict::None => Exit::Check,
            _ => Exit::Ok,
        })
    }
}

/// The flight that would decide what the logs leave open.
fn propose(
    args: &DiagnoseArgs,
    settings: &crate::config::Settings,
    vehicle: &VehicleParams,
    diagnosis: &Diagnosis,
) -> anyhow::Result<Option<NextFlight>> {
    let capability = capability(vehicle, &settings.control)?;
    let proposal = Proposal {
        vehicle,
        setpoint_leg: diagnosis.setpoint_leg,
        noise: diagnosis.noise,
        room: Room::new(&settings.collect, &settings.envelope, &capability),
        envelope: settings.envelope,
        seed: args.seed,
    };
    next_flight(&proposal, &diagnosis.open).or_exit(Exit::Usage)
}

/// A log and its audit.
pub(super) struct AuditedLog {
    /// The flight, ready for the diagnosis, or why it is not.
    pub flight: anyhow::Result<PreparedFlight>,
    pub audit: Option<LogAnswer>,
}

/// Reads logs and audits them together. Leaves out faulty logs, and the unusable times of the
/// others.
pub(super) fn audited(
    paths: &[PathBuf],
    mapping: Option<&Path>,
    vehicle: &VehicleParams,
) -> Vec<AuditedLog> {
    let _patience = Patience::with("reading and auditing the logs".to_owned());
    let open = |path: &PathBuf| {
        let mut flight = open_for(path, mapping, vehicle)?;
        if Onboard::new(vehicle)?.complete_outputs(&mut flight, vehicle.command_delay_s) {
            print_status(format_args!(
                "{}: motor outputs are not logged; computing them from the setpoints with the \
                 vehicle file's attitude_pd",
                path.display()
            ));
        }
        Ok(flight)
    };
    let read: Vec<anyhow::Result<Flight>> = paths.par_iter().map(open).collect();
    let mut refused = Vec::new();
    let mut flights = Vec::new();
    for (index, flight) in read.into_iter().enumerate() {
        match flight {
            Ok(flight) => flights.push(flight),
            Err(error) => refused.push((index, error)),
        }
    }
    let origins = flights.iter_mut().map(|flight| &mut flight.origin);
    tell_apart(origins.map(|origin| (&mut origin.run, origin.path.as_path())));
    let mut audits = Audit::of_all(&flights);
    rotor_order::check(&mut audits, vehicle);
    let latency = vehicle.modelled_effects.get::<EstimatorLatency>();
    let shifts = align(&mut flights, &mut audits, latency.map_or(0.0, |latency| latency.latency_s));
    for (flight, shifts) in flights.iter().zip(&shifts).filter(|(_, shifts)| !shifts.is_empty()) {
        let each: Vec<String> = shifts.iter().map(ToString::to_string).collect();
        print_status(format_args!(
            "{}: streams are on different clocks; shifting {}",
            flight.origin.path.display(),
            each.join(", ")
        ));
    }
    let mut logs: Vec<AuditedLog> = flights
        .into_par_iter()
        .zip(audits)
        .zip(shifts)
        .map(|((flight, audit), shifts)| AuditedLog {
            audit: Some(LogAnswer::of(&audit, &flight, shifts)),
            flight: prepare(flight, &audit, vehicle),
        })
        .collect();
    for (index, error) in refused {
        logs.insert(index, AuditedLog { flight: Err(error), audit: None });
    }
    logs
}

fn prepare(
    flight: Flight,
    audit: &Audit,
    vehicle: &VehicleParams,
) -> anyhow::Result<PreparedFlight> {
    if let Some(fault) = audit.faults().next() {
        return Err(anyhow!("{fault}"));
    }
    let flight = PreparedFlight::new(flight, vehicle)?;
    // Setpoints may pause if the outputs drive the plant.
    let concerns = |span: &&UnusableSpan| span.stream != "setpoint" || flight.channels.setpoint;
    let times = audit.unusable.iter().filter(concerns).map(|span| span.from_s..span.to_s);
    let times: Vec<_> = times.collect();
    Ok(flight.excluding(&times)?)
}

/// The flights to fit and the held-out one: the last flight, or the second part of a single one.
///
/// # Errors
/// No flight, or a single one that is too short for two parts.
pub(super) fn parted(
    mut flights: Vec<PreparedFlight>,
) -> anyhow::Result<(Vec<PreparedFlight>, Vec<PreparedFlight>)> {
    match flights.as_slice() {
        [only] => halves(only),
        _ => {
            let last = flights.pop().context("no flight")?;
            Ok((flights, vec![last]))
        }
    }
}

/// The first and the last part of one flight, with a guard between.
fn halves(flight: &PreparedFlight) -> anyhow::Result<(Vec<PreparedFlight>, Vec<PreparedFlight>)> {
    let (first, second) = flight.split(GUARD_S).ok_or_else(|| {
        anyhow!("{}: too short to hold out a part of it; give another flight", flight.name)
    })?;
    Ok((vec![first], vec![second]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holdout_names_a_log_however_its_path_is_written() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let (log, other) = (root.join("Cargo.toml"), root.join("README.md"));
        let mut args = DiagnoseArgs::new(vec![log.clone(), other.clone()], PathBuf::new());
        args.holdout = vec![root.join("src/../README.md")];
        assert_eq!(paths(&args), [log.clone(), other.clone()]);
        assert!(is_among(&other, &args.holdout) && !is_among(&log, &args.holdout));
        args.new = vec![root.join("src/../Cargo.toml")];
        assert_eq!(paths(&args), [other, root.join("src/../Cargo.toml")]);
    }
}
