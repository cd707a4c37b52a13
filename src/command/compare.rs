//! `downwash compare`: flights in two groups, side by side.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use rayon::prelude::*;
use serde_json::Value;

use super::logs::check_named;
use super::output::check_output;
use super::patience::Patience;
use super::plan::sha256_of;
use super::{Exit, ExitContext, print_json, print_status, print_text, write_file};
use crate::cli::{AlignChoice, CompareArgs, PairChoice};
use crate::log::LogReader;
use crate::log::import::{self, Flight, tell_apart};
use crate::report::side_by_side::{Alignment, Comparison, Entry, Outcome, Pairing};
use crate::report::{FlightReport, Recording};
use crate::vehicle_check::other_vehicle;

/// Facts of a run that do not distinguish groups: they differ in every flight, or in none.
const NO_FACTS: [&str; 4] = ["run", "frames", "units", "log_version"];

pub(super) fn run(args: &CompareArgs) -> anyhow::Result<Exit> {
    let _patience = Patience::with("reading and comparing the flights".to_owned());
    let inputs = || args.a.iter().chain(&args.b).map(PathBuf::as_path);
    check_output(&args.out, inputs().chain(args.mapping.as_deref()))?;
    let Compared { comparison, html } = compared(args)?;
    write_file(&args.out, html.as_bytes())?;
    if args.json {
        print_json(&comparison)?;
    } else {
        print_text(&format!("{}\n{}\n", comparison.sentence, args.out.display()))?;
    }
    if args.baseline && comparison.outcome == Outcome::Undecided {
        let error = anyhow!("--baseline cannot be decided: {}", comparison.sentence);
        return Err(error).or_exit(Exit::Usage);
    }
    let failed = args.baseline && comparison.outcome == Outcome::Worse;
    Ok(if failed { Exit::Check } else { Exit::Ok })
}

/// A comparison with its page.
#[derive(Debug)]
pub struct Compared {
    /// The differences and their sizes.
    pub comparison: Comparison,
    /// The page, one file without references to others.
    pub html: String,
}

/// Compares the flights that `args` names; its output and its baseline are the caller's.
///
/// # Errors
/// A log that cannot be read; a group with one file twice; pairs in order of groups that differ in
/// size.
pub fn compared(args: &CompareArgs) -> anyhow::Result<Compared> {
    let mapping = args.mapping.as_deref();
    let read = |logs: &[PathBuf]| -> anyhow::Result<Vec<Entry>> {
        logs.par_iter().map(|log| entry(log, mapping)).collect()
    };
    let is_option = |log: &&PathBuf| log.to_string_lossy().starts_with('-') && !log.exists();
    if let Some(option) = args.b.iter().find(is_option) {
        let option = option.display();
        let error = anyhow!(
            "{option}: no such log; all that follows `--` is a log of B: give {option} before `--`"
        );
        return Err(error).or_exit(Exit::Usage);
    }
    check_named(args.a.iter().chain(&args.b), mapping)?;
    refuse_copies(&args.a)?;
    refuse_copies(&args.b)?;
    let (mut a, mut b) = (read(&args.a)?, read(&args.b)?);
    let entries = a.iter_mut().chain(&mut b);
    tell_apart(entries.map(|entry| (&mut entry.name, Path::new(&entry.log))));
    let (a, b): (Vec<&Entry>, Vec<&Entry>) = (a.iter().collect(), b.iter().collect());
    let alignment = match args.align {
        AlignChoice::Time => Alignment::Time,
        AlignChoice::Position => Alignment::Position,
        AlignChoice::Phase => Alignment::Phase,
    };
    let pairing = match args.pair {
        PairChoice::Auto => Pairing::Auto,
        PairChoice::Order if a.len() != b.len() => {
            let (a, b) = (a.len(), b.len());
            let error =
                anyhow!("--pair order: A has {a} flights and B has {b}; give the same number");
            return Err(error).or_exit(Exit::Usage);
        }
        PairChoice::Order => Pairing::Order,
        PairChoice::None => Pairing::None,
    };
    let comparison = Comparison::new(&a, &b, alignment, pairing);
    let html = comparison.to_html(&a, &b);
    Ok(Compared { comparison, html })
}

/// Refuses a group that holds one file twice. The test takes the flights of a group for
/// independent: copies have no spread, so any difference would count as proven. A file may be in
/// both groups: simulated flights of two versions that behave alike are equal.
fn refuse_copies(logs: &[PathBuf]) -> anyhow::Result<()> {
    let hashes: anyhow::Result<Vec<String>> = logs.par_iter().map(|log| sha256_of(log)).collect();
    let mut seen: BTreeMap<String, &Path> = BTreeMap::new();
    for (log, hash) in logs.iter().zip(hashes.or_exit(Exit::Usage)?) {
        if let Some(twin) = seen.insert(hash, log) {
            let (log, twin) = (log.display(), twin.display());
            let error = anyhow!("{log}: the same file as {twin}; leave one of them out");
            return Err(error).or_exit(Exit::Usage);
        }
    }
    Ok(())
}

/// Reads a flight for a comparison: along its trajectory where it is one of this program's.
///
/// # Errors
/// The file is no flight log, or no quadrotor's.
pub fn entry(log: &Path, mapping: Option<&Path>) -> anyhow::Result<Entry> {
    let own = LogReader::open(log).ok().and_then(|mut reader| {
        let report = FlightReport::read(&mut reader).ok()?;
        if !report.summary().log_finished {
            let log = log.display();
            print_status(format_args!("{log}: unfinished log, comparing its complete part"));
        }
        let mut facts = run_facts(&report.summary().run);
        for attachment in reader.attachments() {
            let text = String::from_utf8_lossy(&attachment.data);
            let prefix = if attachment.name == "config.toml" { "setting" } else { "vehicle file" };
            facts.extend(flattened(prefix, &text));
        }
        Some((report, facts))
    });
    let flight = import::open_among(log, mapping);
    let is_own = own.is_some();
    if let Some((report, facts)) = own {
        let recording = flight.as_ref().ok().map(|flight| Recording::new(flight.clone()));
        if let Some(entry) = Entry::own(log, &report, recording.as_ref(), facts) {
            return Ok(entry);
        }
    }
    let flight = flight.or_exit(Exit::Usage)?;
    if let Some(kind) = other_vehicle(&flight.facts) {
        let log = log.display();
        let error = anyhow!("{log}: the log is of {kind}; only quadrotors are compared");
        return Err(error).or_exit(Exit::Usage);
    }
    if is_own {
        print_status(format_args!(
            "{}: no trajectory was followed; comparing the whole flight",
            log.display()
        ));
    }
    let facts = recorded_facts(&flight);
    Ok(Entry::recorded(log, &Recording::new(flight), facts))
}

/// The facts that a log of this program states about its flight.
fn run_facts(run: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let kept = run.iter().filter(|(key, _)| !NO_FACTS.contains(&key.as_str()));
    let mut facts: BTreeMap<String, String> =
        kept.map(|(key, value)| (key.clone(), value.clone())).collect();
    // Flights along one trajectory form pairs.
    if let Some(trajectory) = run.get("run") {
        facts.insert("trajectory".to_owned(), trajectory.clone());
    }
    facts
}

/// The facts that another program's log states about its vehicle.
fn recorded_facts(flight: &Flight) -> BTreeMap<String, String> {
    let mut facts = BTreeMap::from([("format".to_owned(), flight.origin.format.to_owned())]);
    let stated = &flight.facts;
    let texts = [("autopilot", &stated.autopilot), ("frame", &stated.frame)];
    facts.extend(
        texts.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value.clone()?))),
    );
    facts.extend(stated.motors.map(|motors| ("motors".to_owned(), motors.to_string())));
    let parameters = stated.parameters.iter();
    facts.extend(parameters.map(|(key, value)| (format!("parameter {key}"), value.to_string())));
    if let Some(text) = &flight.vehicle_file {
        facts.extend(flattened("vehicle file", text));
    }
    facts
}

/// The values of a TOML or JSON file by their paths; empty for any other file.
fn flattened(prefix: &str, text: &str) -> BTreeMap<String, String> {
    let json = serde_json::from_str::<Value>(text).ok();
    let value = json.or_else(|| toml::from_str::<Value>(text).ok());
    let mut facts = BTreeMap::new();
    if let Some(value) = value {
        flatten(prefix.to_owned(), &value, &mut facts);
    }
    facts
}

fn flatten(path: String, value: &Value, facts: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(table) => {
            for (key, value) in table {
                // Provenance does not change a number.
                if key != "provenance" && key != "notes" {
                    flatten(format!("{path}.{key}"), value, facts);
                }
            }
        }
        Value::Array(values) if values.iter().any(Value::is_object) => {
            for (number, value) in values.iter().enumerate() {
                flatten(format!("{path}.{}", number + 1), value, facts);
            }
        }
        Value::String(text) => {
            facts.insert(path, text.clone());
        }
        other => {
            facts.insert(path, other.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_flattened_to_key_value_pairs() {
        let facts = flattened("setting", "a = 1\n[b]\nc = \"x\"\n[[b.d]]\ne = [1, 2]\n");
        let expected = [("setting.a", "1"), ("setting.b.c", "x"), ("setting.b.d.1.e", "[1,2]")];
        let found: Vec<(&str, &str)> =
            facts.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect();
        assert_eq!(found, expected);
        assert!(flattened("x", "{{{").is_empty());
    }
}
