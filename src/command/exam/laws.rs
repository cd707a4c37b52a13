//! `downwash exam --laws COUNT`: how well the diagnosis finds laws outside the catalogue.

use std::fs;
use std::sync::Arc;

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectSet;

use super::super::diagnose::find;
use super::super::logs::open_for;
use super::super::{Exit, ExitContext, error_text, print_status, write_file};
use super::Hall;
use super::candidate::log_names;
use crate::cli::ExamArgs;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::exam::closure::closure;
use crate::exam::interval::Rate;
use crate::exam::laws::{LawCase, variables};
use crate::exam::order::Settings;
use crate::exam::world::World;

/// Share of the closable gap that a law must close.
const CLOSED: f64 = 0.8;

/// The JSON of `exam --laws`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(crate) struct LawsSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    seed: u64,
    /// Laws that close most of the closable gap on another mission, of those with a gap there. A
    /// law that is not named closes nothing.
    closed: Rate,
    /// Named laws, of those with a gap.
    named: Rate,
    /// Named laws that depend on the same quantities as the true one.
    variables: Rate,
    /// Named laws where there is none.
    invented: Rate,
    cases: &'a [LawRow],
}

/// A case.
#[derive(JsonSchema, Serialize)]
pub(crate) struct LawRow {
    name: String,
    /// Kind of the true law; null without one.
    kind: Option<&'static str>,
    /// The verdict by the catalogue alone.
    verdict: String,
    named: bool,
    because: Option<String>,
    /// The quantities on which the found law depends, named or not.
    variables: Vec<&'static str>,
    /// Whether the true law depends on the same.
    variables_right: Option<bool>,
    /// Share of the closable gap on the other mission that the named law closes, if the file's
    /// numbers are right; missing without a gap.
    closure: Option<f64>,
    /// The terms found.
    terms: Vec<String>,
    seconds: f64,
}

pub(super) fn run(args: &ExamArgs, count: usize, hall: &Hall<'_>) -> anyhow::Result<Exit> {
    let world = if args.exact { World::Exact } else { World::Builders };
    let settings = Settings { seconds: args.seconds, world, ..Settings::default() };
    let total = count + args.nulls;
    let rows = hall.each(total, "searching laws of", |number| {
        let began = std::time::Instant::now();
        let case = match LawCase::fly(&settings, hall.seed, number as u64, number < count) {
            Ok(case) => case,
            Err(error) => {
                print_status(format_args!("case {number}: left out: {error}"));
                return Ok(None);
            }
        };
        let row = hall.searched(&format!("case_{number:03}"), &case);
        let mut row = match row {
            Ok(row) => row,
            Err(error) => {
                print_status(format_args!("case {number}: left out: {}", error_text(&error)));
                return Ok(None);
            }
        };
        row.seconds = began.elapsed().as_secs_f64();
        Ok(Some(row))
    })?;
    let rows: Vec<LawRow> = rows.into_iter().flatten().collect();
    let has_gap = || rows.iter().filter(|row| row.closure.is_some());
    let named = || has_gap().filter(|row| row.named);
    let summary = LawsSummary {
        schema: "downwash.exam.laws",
        schema_version: 1,
        seed: hall.seed,
        closed: Rate::of(has_gap().map(|row| row.closure.is_some_and(|c| c >= CLOSED))),
        named: Rate::of(has_gap().map(|row| row.named)),
        variables: Rate::of(named().filter_map(|row| row.variables_right)),
        invented: Rate::of(rows.iter().filter(|row| row.kind.is_none()).map(|row| row.named)),
        cases: &rows,
    };
    hall.conclude(&summary, &text(&summary))
}

impl Hall<'_> {
    /// Searches a law on a case's flights, and evaluates it on the other mission.
    fn searched(&self, name: &str, case: &LawCase) -> anyhow::Result<LawRow> {
        let folder = self.folder(name);
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        let vehicle = folder.join("vehicle.json");
        let file = serde_json::to_vec_pretty(&case.nominal).context("vehicle.json")?;
        write_file(&vehicle, &file)?;
        let all = case.logs.iter().chain(&case.mission);
        let mut paths = Vec::new();
        for (log, bytes) in log_names(case.logs.len() + case.mission.len()).zip(all) {
            let path = folder.join(log);
            write_file(&path, bytes)?;
            paths.push(path);
        }
        let mission = paths.split_off(case.logs.len());
        let mut diagnose = crate::cli::DiagnoseArgs::new(paths, vehicle);
        diagnose.discover = true;
        diagnose.twins = self.args.twins.unwrap_or(diagnose.twins);
        let finding = find(&diagnose, &Arc::default(), &|_| {})?;
        let law = finding.answer.law.as_ref();
        let named = law.is_some_and(|law| law.named);
        let found = law.map_or(Vec::new(), |law| variables(law.depends_on.iter().copied()));
        let closure = match &case.law {
            None => None,
            Some(_) => {
                let read = |path: &std::path::PathBuf| -> anyhow::Result<PreparedFlight> {
                    Ok(PreparedFlight::new(open_for(path, None, &case.known)?, &case.known)?)
                };
                let mission = mission.iter().map(read).collect::<anyhow::Result<Vec<_>>>()?;
                let mut answer = EffectSet::new();
                if let Some(law) = law.filter(|law| law.named) {
                    answer.insert_law(law.law.clone())?;
                }
                closure(&case.known, &case.truth, &answer, &mission, &case.noise)
                    .or_exit(Exit::Failure)?
            }
        };
        if !self.args.keep {
            let _ = fs::remove_dir_all(&folder);
        }
        Ok(LawRow {
            name: name.to_owned(),
            kind: case.law.as_ref().map(|law| law.kind),
            verdict: finding.answer.verdict.name().to_owned(),
            named,
            because: law.and_then(|law| law.because.clone()),
            variables_right: case.law.as_ref().map(|law| found == law.variables),
            variables: found,
            closure,
            terms: law
                .map_or(Vec::new(), |law| law.terms.iter().map(|term| term.term.clone()).collect()),
            seconds: 0.0,
        })
    }
}

fn text(summary: &LawsSummary<'_>) -> String {
    let mut text =
        format!("{:9} {:34} {:8} {:>8}  law\n", "case", "true law", "verdict", "closure");
    for row in summary.cases {
        let closure =
            row.closure.map_or("-".to_owned(), |closure| format!("{:.0} %", 100.0 * closure));
        let named = if row.named { "" } else { "not named: " };
        text += &format!(
            "{:9} {:34} {:8} {closure:>8}  {named}{}\n",
            row.name,
            row.kind.unwrap_or("none"),
            row.verdict,
            row.terms.join(" | ")
        );
    }
    for (what, rate) in [
        ("close 80 % of the closable gap on another mission", summary.closed),
        ("named", summary.named),
        ("named laws with the right variables", summary.variables),
        ("laws invented in nulls", summary.invented),
    ] {
        let [low, high] = rate.interval.map(|end| 100.0 * end);
        text +=
            &format!("{what:52} {} of {} (95 %: {low:.0} to {high:.0} %)\n", rate.count, rate.of);
    }
    text
}
