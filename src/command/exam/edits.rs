//! `downwash exam --flights LOG...`: the diagnosis on a vehicle's own flights, each time with one
//! error put into the vehicle file.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow};
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectId;

use super::{Hall, Sheet, claim};
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Exit, ExitContext, error_text, write_file};
use crate::exam::answer::{GivenAnswer, NAMED};
use crate::exam::edit::{EditedVehicle, edited};

/// How an answer fares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::command) enum EditGrade {
    /// Names the error first; without an error, finds none.
    Found,
    /// Names it beside others, or among those that the flights do not distinguish.
    Listed,
    /// Says that these flights cannot show it.
    NotTestable,
    /// Does not find it.
    Missed,
    /// Names something else.
    Wrong,
    /// The diagnosis failed.
    Failed,
}

impl EditGrade {
    const ALL: [Self; 6] =
        [Self::Found, Self::Listed, Self::NotTestable, Self::Missed, Self::Wrong, Self::Failed];

    fn words(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Listed => "listed",
            Self::NotTestable => "not testable, as it says",
            Self::Missed => "missed",
            Self::Wrong => "wrong",
            Self::Failed => "failed",
        }
    }
}

/// The answer to one error.
#[derive(Debug, JsonSchema, Serialize)]
struct EditRow {
    /// Name of the error; its folder in `cases`.
    case: String,
    /// What is wrong in the vehicle file; `none` for the file as it is.
    error: String,
    /// Effects of which each explains the error.
    expected: Vec<String>,
    grade: EditGrade,
    verdict: String,
    probabilities: Vec<(String, f64)>,
    ambiguous_with: Vec<String>,
    seconds: f64,
    /// Why the diagnosis failed.
    failure: Option<String>,
}

/// The JSON of `exam --flights`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(in crate::command) struct EditsSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    /// The vehicle file.
    vehicle: &'a str,
    cases: &'a [EditRow],
}

pub(super) fn run(vehicle: &Path, flights: &[PathBuf], hall: &Hall<'_>) -> anyhow::Result<Exit> {
    let file = VehicleFile::load(vehicle)?;
    let logs = absolute("--flights", flights)?;
    let holdout = absolute("--holdout", &hall.args.holdout)?;
    let edited = edited(&file.params);
    let rows = hall.each(edited.len(), "diagnosing", |number| {
        let one = &edited[number];
        let folder = hall.folder(one.id);
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        let vehicle = serde_json::to_vec_pretty(&one.vehicle).context("vehicle.json")?;
        write_file(&folder.join("vehicle.json"), &vehicle)?;
        let sheet = Sheet {
            folder: &folder,
            logs: &logs,
            holdout: &holdout,
            without: &[],
            evidence: false,
        };
        let began = Instant::now();
        let Some(given) = hall.answer(&sheet, one.id) else { return Ok(None) };
        Ok(Some(row(one, given, began.elapsed().as_secs_f64())))
    })?;
    let rows: Vec<EditRow> = rows.into_iter().flatten().collect();
    let summary = EditsSummary {
        schema: "downwash.exam.edits",
        schema_version: 1,
        vehicle: &file.name,
        cases: &rows,
    };
    hall.conclude(&summary, &text(&rows))
}

/// The paths of logs from any working directory.
fn absolute(flag: &str, logs: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let of_one = |log: &PathBuf| {
        let path = log.canonicalize().with_context(|| format!("{flag} {}", log.display()))?;
        let path = path.into_os_string().into_string();
        path.map_err(|path| anyhow!("{flag} {}: expected a name in UTF-8", path.display()))
    };
    logs.iter().map(of_one).collect::<anyhow::Result<_>>().or_exit(Exit::Usage)
}

/// Whether an effect, or one that acts alike, is expected.
fn is_expected(edited: &EditedVehicle, effect: &str) -> bool {
    let class = effect.parse::<EffectId>().map(EffectId::class);
    class.is_ok_and(|class| edited.expected.iter().any(|expected| expected.class() == class))
}

fn grade(edited: &EditedVehicle, given: &GivenAnswer) -> EditGrade {
    if edited.expected.is_empty() {
        return match given.verdict.as_str() {
            "none" => EditGrade::Found,
            "effect" => EditGrade::Wrong,
            _ => EditGrade::Missed,
        };
    }
    let probabilities = given.probabilities();
    let is_first = probabilities.first().is_some_and(|(id, _)| is_expected(edited, id));
    let is_named = |(id, p): &(String, f64)| *p >= NAMED && is_expected(edited, id);
    let is_listed = probabilities.iter().any(is_named)
        || given.ambiguous_with.iter().any(|id| is_expected(edited, id));
    let is_not_testable = given.not_testable.iter().any(|effect| is_expected(edited, &effect.id));
    match (given.verdict == "effect", is_first) {
        (true, true) => EditGrade::Found,
        (true, false) if is_listed => EditGrade::Listed,
        (true, false) => EditGrade::Wrong,
        (false, _) if is_not_testable => EditGrade::NotTestable,
        (false, _) => EditGrade::Missed,
    }
}

fn row(edited: &EditedVehicle, given: anyhow::Result<GivenAnswer>, seconds: f64) -> EditRow {
    let row = EditRow {
        case: edited.id.to_owned(),
        error: edited.error.to_owned(),
        expected: edited.expected.iter().map(|effect| effect.name().to_owned()).collect(),
        grade: EditGrade::Failed,
        verdict: "missing".to_owned(),
        probabilities: Vec::new(),
        ambiguous_with: Vec::new(),
        seconds,
        failure: None,
    };
    match given {
        Ok(given) => EditRow {
            grade: grade(edited, &given),
            probabilities: given.probabilities(),
            verdict: given.verdict,
            ambiguous_with: given.ambiguous_with,
            ..row
        },
        Err(error) => EditRow { failure: Some(error_text(&error)), ..row },
    }
}

fn text(rows: &[EditRow]) -> String {
    let mut text = String::new();
    for row in rows {
        let answer = match &row.failure {
            Some(failure) => failure.clone(),
            None => {
                let claim = claim(&row.probabilities, &row.ambiguous_with);
                format!("{} {claim}", row.verdict).trim_end().to_owned()
            }
        };
        text += &format!("{}\n    {}: {answer}\n", row.error, row.grade.words());
    }
    let wrong = || rows.iter().filter(|row| !row.expected.is_empty());
    let count = |grade| match wrong().filter(|row| row.grade == grade).count() {
        0 => None,
        count => Some(format!("{count} {}", grade.words())),
    };
    let counts: Vec<String> = EditGrade::ALL.into_iter().filter_map(count).collect();
    text + &format!("{} errors: {}\n", wrong().count(), counts.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(json: &str) -> GivenAnswer {
        serde_json::from_str(json).expect("an answer")
    }

    #[test]
    fn answers_are_graded_by_what_they_claim() {
        let vehicle = include_str!("../../../config/vehicles/crazyflie.toml");
        let vehicle = vehicle::VehicleParams::from_toml_str(vehicle).expect("a vehicle file");
        let edited = edited(&vehicle);
        let of = |id: &str, json: &str| {
            let one = edited.iter().find(|one| one.id == id).expect("the error");
            grade(one, &given(json))
        };
        let none = r#"{"verdict": "none"}"#;
        let wind = r#"{"verdict": "effect", "effects": [{"id": "wind", "probability": 0.9}]}"#;
        assert_eq!(of("unchanged", none), EditGrade::Found);
        assert_eq!(of("unchanged", r#"{"verdict": "unknown"}"#), EditGrade::Missed);
        assert_eq!(of("unchanged", wind), EditGrade::Wrong);
        assert_eq!(of("inertia", none), EditGrade::Missed);
        assert_eq!(of("inertia", wind), EditGrade::Wrong);
        let says_so = r#"{"verdict": "none", "not_testable": [{"id": "inertia"}]}"#;
        assert_eq!(of("inertia", says_so), EditGrade::NotTestable);
        let beside = r#"{"verdict": "effect", "effects": [{"id": "wind", "probability": 0.9}],
            "ambiguous_with": ["inertia"]}"#;
        assert_eq!(of("inertia", beside), EditGrade::Listed);
        // A thrust scale acts like a mass.
        let scale =
            r#"{"verdict": "effect", "effects": [{"id": "thrust_scale", "probability": 0.9}]}"#;
        assert_eq!(of("mass", scale), EditGrade::Found);
    }
}
