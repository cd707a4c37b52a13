//! The blind exam, end to end on a few cases: the opened key matches its commitment, and each case
//! is diagnosed and scored.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use downwash::exam::case::Case;
use downwash::exam::key::{Key, commitment};
use downwash::exam::order::{Kind, Order, Settings};
use downwash::exam::world::World;
use serde_json::Value;

/// A folder of the test's own, which does not exist yet.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("exam").join(name);
    let _ = fs::remove_dir_all(&path);
    path
}

fn exam(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
    command.args(["exam", "--json", "--seconds", "12", "--twins", "0", "--out"]).arg(folder);
    command.args(arguments).output().expect("the command runs")
}

fn summary(output: &Output) -> Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"))
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs::read_dir(folder).expect("the folder");
    entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into()).collect()
}

#[test]
fn every_case_is_answered_and_the_key_matches_its_commitment() {
    let out = folder("drawn");
    let stored = out.join("evidence");
    let stored = stored.to_str().expect("a name");
    let mut arguments = vec!["--cases", "2", "--nulls", "1", "--kinds", "single", "--seed", "5"];
    arguments.extend(["--evidence", stored]);
    let decided = |out: &Path| summary(&exam(out, &["--decide", stored]));
    let summary = summary(&exam(&out, &arguments));
    let key = fs::read(out.join("key.json")).expect("the key");
    let committed = fs::read_to_string(out.join("commitment.txt")).expect("the commitment");
    assert_eq!(committed.split_whitespace().next(), Some(commitment(&key).as_str()));
    assert_eq!(summary["commitment"], commitment(&key).as_str());

    let key: Key = serde_json::from_slice(&key).expect("a key");
    let kinds: Vec<Kind> = key.cases.values().map(|case| case.kind).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == Kind::Null).count(), 1);
    assert_eq!(kinds.iter().filter(|kind| **kind == Kind::Single).count(), 2);
    let answers = ["case_000.json", "case_001.json", "case_002.json"].map(str::to_owned);
    assert_eq!(names(&out.join("answers")), BTreeSet::from(answers));
    // Logs are deleted once diagnosed.
    assert!(names(&out.join("cases")).is_empty());
    let rows = summary["cases"].as_array().expect("rows");
    assert_eq!(rows.len(), 3);
    assert!(rows.iter().all(|row| row["verdict"] != "missing"), "{rows:?}");
    let page = fs::read_to_string(out.join("report.html")).expect("the report");
    assert!(page.contains(&commitment(&fs::read(out.join("key.json")).expect("the key"))));

    // Deciding again from the stored evidence gives the same verdicts.
    let anew = decided(&out);
    let verdicts = |rows: &[Value]| -> Vec<Value> {
        rows.iter()
            .map(|row| serde_json::json!([row["case"], row["verdict"], row["brier"]]))
            .collect()
    };
    assert_eq!(verdicts(anew.as_array().expect("rows")), verdicts(rows));

    let again = exam(&out, &arguments);
    assert!(!again.status.success(), "a used folder is refused");
}

#[test]
#[ignore = "long: tests/run --all"]
fn round_trip_identifies_its_effect() {
    let out = folder("round-trip");
    let summary = summary(&exam(&out, &["--round-trip", "--cases", "1", "--seed", "4", "--keep"]));
    let row = &summary["cases"][0];
    assert_eq!(row["kind"], "round-trip");
    assert_eq!(row["verdict"], "effect", "{row}");
    assert_eq!(row["top_right"], true, "{row}");
    let kept = names(&out.join("cases/case_000"));
    assert!(kept.contains("vehicle.json") && kept.contains("flight_4.tlog"), "{kept:?}");
}

/// A scoring script as supplied with a set of practice flights.
const SCRIPT: &str = r#"import json, os, sys
answers, key, out = sys.argv[1], sys.argv[2], sys.argv[sys.argv.index("--json") + 1]
with open(key) as f:
    cases = json.load(f)["cases"]
right = [json.load(open(os.path.join(answers, n + ".json")))["verdict"] == c["verdict"] for n, c in cases.items()]
print("graded", len(right))
with open(out, "w") as f:
    json.dump({"right": sum(right)}, f)
"#;

#[test]
fn practice_flights_are_diagnosed_and_graded_by_their_script() {
    let made = folder("practice-made");
    let arguments = ["--round-trip", "--cases", "1", "--seed", "4", "--keep"];
    summary(&exam(&made, &arguments));
    let set = made.join("cases");
    fs::write(set.join("score_exam.py"), SCRIPT).expect("a script");
    let key = r#"{"cases":{"case_000":{"verdict":"effect","effects":[{"id":"wind"}]}}}"#;
    fs::write(set.join("key.json"), key).expect("a key");
    let out = folder("practice");
    let summary = summary(&exam(&out, &["--practice", set.to_str().expect("a name")]));
    assert_eq!(summary["schema"], "downwash.exam.practice");
    assert_eq!(summary["cases"][0]["truth"], "wind");
    assert_eq!(summary["cases"][0]["verdict"], "effect");
    assert_eq!(summary["scores"]["right"], 1);
    assert_eq!(names(&out.join("answers")), BTreeSet::from(["case_000.json".to_owned()]));
    let text = Command::new(env!("CARGO_BIN_EXE_downwash"))
        .args(["exam", "--twins", "0", "--practice"])
        .arg(&set)
        .arg("--out")
        .arg(folder("practice-told"))
        .output()
        .expect("the command runs");
    let text = String::from_utf8_lossy(&text.stdout);
    assert!(text.contains("truth: wind") && text.contains("graded 1"), "{text}");
}

#[test]
fn errors_of_a_vehicle_file_are_found_in_its_own_flights() {
    let made = folder("edits-made");
    let healthy = ["--cases", "0", "--nulls", "1", "--exact", "--seed", "4", "--keep"];
    summary(&exam(&made, &healthy));
    let case = made.join("cases/case_000");
    let path = |name: &str| case.join(name).to_str().expect("a name").to_owned();
    let logs: Vec<String> = names(&case)
        .into_iter()
        .filter(|name| name.ends_with(".tlog"))
        .take(2)
        .map(|name| path(&name))
        .collect();
    let vehicle = path("vehicle.json");
    let mut arguments = vec!["--vehicle", &vehicle, "--flights"];
    arguments.extend(logs.iter().map(String::as_str));
    let out = folder("edits");
    let summary = summary(&exam(&out, &arguments));
    assert_eq!(summary["schema"], "downwash.exam.edits");
    let rows = summary["cases"].as_array().expect("rows");
    let grade = |case: &str| {
        let row = rows.iter().find(|row| row["case"] == case).expect("the error");
        row["grade"].as_str().expect("a grade")
    };
    for case in ["unchanged", "mass", "thrust", "rotor", "delay", "gains"] {
        assert_eq!(grade(case), "found", "{case}: {rows:?}");
    }
    assert!(rows.iter().all(|row| row["grade"] != "failed"), "{rows:?}");

    let lost = ["--vehicle", &vehicle, "--flights", "lost.tlog"];
    let lost = exam(&folder("edits-lost"), &lost);
    assert_eq!(lost.status.code(), Some(2));
    let error = String::from_utf8_lossy(&lost.stderr);
    assert!(error.contains("--flights lost.tlog"), "{error}");
}

#[test]
fn same_seed_gives_the_same_case() {
    for world in [World::Exact, World::Builders] {
        let settings = Settings { flights: 2, seconds: 6.0, world, ..Settings::default() };
        for kind in [Kind::Null, Kind::Single, Kind::Foreign, Kind::OtherLaw, Kind::Trap] {
            let fly = |number| {
                Case::fly(&settings, 9, number, "case", &Order::from(kind)).expect("a case")
            };
            let (one, same, other) = (fly(1), fly(1), fly(2));
            assert_eq!(one.key, same.key, "{kind:?}");
            assert_eq!(one.logs, same.logs);
            assert_ne!(one.nominal, other.nominal);
        }
    }
}
