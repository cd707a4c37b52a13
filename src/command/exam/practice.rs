//! `downwash exam --practice DIR`: the diagnosis on labelled flights of another origin, with the
//! answers and the grades of the set's own script. Nothing is fitted to them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, anyhow};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Hall, Sheet, claim};
use crate::command::{Exit, ExitContext, error_text, print_status};
use crate::exam::answer::GivenAnswer;

/// Paths of a set's scripts, relative to its folder. One set may use another's.
const BESIDE: [&str; 4] = [".", "../practice", "../practice-mismatch", "../practice-real"];

/// The parts of key.json that every set has.
#[derive(Debug, Default, Deserialize)]
struct PracticeKey {
    #[serde(default)]
    cases: BTreeMap<String, PracticeEntry>,
}

#[derive(Debug, Default, Deserialize)]
struct PracticeEntry {
    /// The label of a real flight, in words.
    #[serde(default)]
    truth: Option<String>,
    /// The label of a simulated flight.
    #[serde(default)]
    verdict: Option<String>,
    #[serde(default)]
    effects: Vec<PracticeEffect>,
    /// Flights to keep.
    #[serde(default)]
    holdout: Vec<String>,
    /// The right answers, in sets that accept alternatives.
    #[serde(default)]
    right: Option<Value>,
}

#[derive(Debug, Deserialize)]
struct PracticeEffect {
    id: String,
}

impl PracticeEntry {
    fn truth(&self) -> String {
        if let Some(truth) = &self.truth {
            return truth.clone();
        }
        let effects: Vec<&str> = self.effects.iter().map(|effect| effect.id.as_str()).collect();
        let verdict = self.verdict.as_deref().unwrap_or("-");
        if effects.is_empty() { verdict.to_owned() } else { effects.join(" + ") }
    }
}

/// A case of a set.
#[derive(Debug, PartialEq)]
struct PracticeCase {
    name: String,
    folder: PathBuf,
    /// The flights, in the order of their numbers.
    flights: Vec<String>,
    holdout: Vec<String>,
}

/// The result of a case.
#[derive(Debug, JsonSchema, Serialize)]
struct PracticeRow {
    case: String,
    truth: String,
    verdict: String,
    probabilities: Vec<(String, f64)>,
    ambiguous_with: Vec<String>,
    seconds: f64,
    /// The error.
    error: Option<String>,
}

/// The JSON of `exam --practice`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(in crate::command) struct PracticeSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    cases: &'a [PracticeRow],
    /// The grades of the set's script; null without one.
    scores: Option<Value>,
}

pub(super) fn run(set: &Path, hall: &Hall<'_>) -> anyhow::Result<Exit> {
    let set = set.canonicalize().with_context(|| set.display().to_string()).or_exit(Exit::Usage)?;
    let key_path = set.join("key.json");
    let key: PracticeKey = match fs::read(&key_path) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .with_context(|| key_path.display().to_string())
            .or_exit(Exit::Usage)?,
        Err(_) => PracticeKey::default(),
    };
    let cases = cases(&set, &key).or_exit(Exit::Usage)?;
    let rows = hall.each(cases.len(), "diagnosing", |number| {
        let case = &cases[number];
        let sheet = Sheet {
            folder: &case.folder,
            logs: &case.flights,
            holdout: &case.holdout,
            without: &[],
            evidence: false,
        };
        let began = Instant::now();
        let Some(given) = hall.answer(&sheet, &case.name) else { return Ok(None) };
        Ok(Some(row(case, &key, given, began.elapsed().as_secs_f64())))
    })?;
    let rows: Vec<PracticeRow> = rows.into_iter().flatten().collect();
    let graded = graded(&set, &key, &key_path, hall.out)?;
    let summary = PracticeSummary {
        schema: "downwash.exam.practice",
        schema_version: 1,
        cases: &rows,
        scores: graded.as_ref().map(|(_, scores)| scores.clone()),
    };
    let mut text: String = rows.iter().map(line).collect();
    if let Some((report, _)) = &graded {
        text += &format!("\n{report}");
    }
    hall.conclude(&summary, &text)
}

/// The folders of a set that hold a vehicle file.
fn cases(set: &Path, key: &PracticeKey) -> anyhow::Result<Vec<PracticeCase>> {
    let entries = fs::read_dir(set).with_context(|| set.display().to_string())?;
    let mut cases = Vec::new();
    for entry in entries {
        let folder = entry.with_context(|| set.display().to_string())?.path();
        let Some(name) = folder.file_name().and_then(|name| name.to_str()) else { continue };
        if !folder.join("vehicle.json").is_file() {
            continue;
        }
        let flights = flights(&folder)?;
        let kept = key.cases.get(name).map_or(&[][..], |entry| &entry.holdout);
        let mut holdout: Vec<String> =
            flights.iter().filter(|flight| kept.contains(flight)).cloned().collect();
        if holdout.is_empty() && flights.len() > 1 {
            holdout.extend(flights.last().cloned());
        }
        cases.push(PracticeCase { name: name.to_owned(), flights, holdout, folder });
    }
    if cases.is_empty() {
        return Err(anyhow!(
            "{}: expected folders that hold vehicle.json and flight_1.tlog, ..., found none",
            set.display()
        ));
    }
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(cases)
}

/// The flights (flight_1.tlog and so on), by number.
fn flights(folder: &Path) -> anyhow::Result<Vec<String>> {
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut flights = Vec::new();
    for entry in entries {
        let name = entry.with_context(|| folder.display().to_string())?.file_name();
        let Some(name) = name.to_str() else { continue };
        let number = name.strip_prefix("flight_").and_then(|rest| rest.strip_suffix(".tlog"));
        if let Some(number) = number.and_then(|number| number.parse::<u32>().ok()) {
            flights.push((number, name.to_owned()));
        }
    }
    if flights.is_empty() {
        return Err(anyhow!("{}: expected flight_1.tlog, ..., found none", folder.display()));
    }
    flights.sort_unstable();
    Ok(flights.into_iter().map(|(_, name)| name).collect())
}

fn row(
    case: &PracticeCase,
    key: &PracticeKey,
    given: anyhow::Result<GivenAnswer>,
    seconds: f64,
) -> PracticeRow {
    let truth = key.cases.get(&case.name).map_or_else(|| "-".to_owned(), PracticeEntry::truth);
    let row = PracticeRow {
        case: case.name.clone(),
        truth,
        verdict: "missing".to_owned(),
        probabilities: Vec::new(),
        ambiguous_with: Vec::new(),
        seconds,
        error: None,
    };
    match given {
        Ok(given) => PracticeRow {
            probabilities: given.probabilities(),
            verdict: given.verdict,
            ambiguous_with: given.ambiguous_with,
            ..row
        },
        Err(error) => PracticeRow { error: Some(error_text(&error)), ..row },
    }
}

fn line(row: &PracticeRow) -> String {
    let claim = match &row.error {
        Some(error) => error.clone(),
        None => claim(&row.probabilities, &row.ambiguous_with),
    };
    let PracticeRow { case, truth, verdict, seconds, .. } = row;
    format!("{case:26} {verdict:7} {claim:50} {seconds:5.0} s  truth: {truth}\n")
}

/// The set's own script's grades of the answers: its text and its JSON.
fn graded(
    set: &Path,
    key: &PracticeKey,
    key_path: &Path,
    out: &Path,
) -> anyhow::Result<Option<(String, Value)>> {
    let by_alternatives = key.cases.values().any(|entry| entry.right.is_some());
    let name = if by_alternatives { "score_real.py" } else { "score_exam.py" };
    let places = BESIDE.iter().map(|place| set.join(place).join(name));
    let Some(script) = places.into_iter().find(|path| path.is_file()) else {
        print_status(format_args!("not graded: no {name} in {} or beside it", set.display()));
        return Ok(None);
    };
    if key.cases.is_empty() {
        print_status(format_args!("not graded: {} has no cases", key_path.display()));
        return Ok(None);
    }
    let json = out.join("scores.json");
    let mut command = Command::new("python3");
    command.arg(&script).arg(out.join("answers")).arg(key_path).arg("--json").arg(&json);
    if !by_alternatives {
        command.arg("--rows");
    }
    let output = match command.output() {
        Ok(output) if output.status.success() => output,
        Ok(output) => {
            let errors = String::from_utf8_lossy(&output.stderr);
            let last = errors.lines().last().unwrap_or_default().to_owned();
            print_status(format_args!(
                "not graded: {} ended with {}: {last}",
                script.display(),
                output.status
            ));
            return Ok(None);
        }
        Err(error) => {
            print_status(format_args!(
                "not graded: cannot run python3 {}: {error}",
                script.display()
            ));
            return Ok(None);
        }
    };
    let bytes = fs::read(&json).with_context(|| json.display().to_string())?;
    let scores = serde_json::from_slice(&bytes).with_context(|| json.display().to_string())?;
    Ok(Some((String::from_utf8_lossy(&output.stdout).into_owned(), scores)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(name: &str, cases: &[(&str, &[u32])]) -> PathBuf {
        let set =
            std::env::temp_dir().join(format!("downwash-practice-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&set);
        for (case, flights) in cases {
            let folder = set.join(case);
            fs::create_dir_all(&folder).expect("a folder");
            fs::write(folder.join("vehicle.json"), "{}").expect("a file");
            for flight in *flights {
                fs::write(folder.join(format!("flight_{flight}.tlog")), "").expect("a file");
            }
        }
        set
    }

    #[test]
    fn highest_flight_is_held_out_unless_the_key_names_another() {
        let set = set("holdout", &[("case_01", &[10, 2, 1]), ("case_00", &[1, 2, 3])]);
        fs::create_dir_all(set.join("licences")).expect("a folder");
        let key = r#"{"cases":{"case_00":{"holdout":["flight_2.tlog"],"right":[]}}}"#;
        let key: PracticeKey = serde_json::from_str(key).expect("a key");
        let cases = cases(&set, &key).expect("two cases");
        let names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        assert_eq!(names, ["case_00", "case_01"]);
        assert_eq!(cases[0].holdout, ["flight_2.tlog"]);
        assert_eq!(cases[1].flights, ["flight_1.tlog", "flight_2.tlog", "flight_10.tlog"]);
        assert_eq!(cases[1].holdout, ["flight_10.tlog"]);
    }

    #[test]
    fn set_without_cases_or_flights_is_refused() {
        let empty = set("empty", &[]);
        fs::create_dir_all(&empty).expect("a folder");
        let refused = cases(&empty, &PracticeKey::default()).expect_err("nothing there");
        assert!(refused.to_string().contains("vehicle.json"), "{refused}");
        let bare = set("bare", &[("case_00", &[])]);
        let refused = cases(&bare, &PracticeKey::default()).expect_err("no flight");
        assert!(refused.to_string().contains("flight_1.tlog"), "{refused}");
    }

    #[test]
    fn truth_uses_the_wording_of_its_practice_set() {
        let of = |text: &str| serde_json::from_str::<PracticeEntry>(text).expect("one").truth();
        assert_eq!(of(r#"{"truth":"mass 5 g more","right":[]}"#), "mass 5 g more");
        assert_eq!(of(r#"{"verdict":"none","effects":[]}"#), "none");
        assert_eq!(
            of(r#"{"verdict":"effect","effects":[{"id":"wind"},{"id":"mass"}]}"#),
            "wind + mass"
        );
    }
}
