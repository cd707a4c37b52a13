//! The results of the experiment: the summary, the report's page, and the text for stdout.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectSet;

use super::flights::{Flown, LogRow};
use super::{Demo, Learned};
use crate::command::{Exit, print_json, print_text, summary, write_file};
use crate::plan::iterate::Violation;
use crate::plan::scp::Status;
use crate::report::comparison::Contender;
use crate::report::experiment::{self, Experiment};
use crate::report::flight::FlightSummary;
use crate::report::text::smallness;

/// The JSON of `demo`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(in crate::command) struct DemoSummary {
    schema: &'static str,
    schema_version: u32,
    /// How the flights ended: `done`, or how the first other one did.
    end: String,
    seed: u64,
    trajectory: String,
    /// Effects of the simulated vehicle that the daemon did not know.
    #[schemars(
        with = "std::collections::BTreeMap<String, std::collections::BTreeMap<String, serde_json::Value>>"
    )]
    effects: EffectSet,
    /// Simulated time of the flights along the trajectory, s.
    simulated_s: f64,
    /// Wall time of those flights.
    wall_s: f64,
    real_time_factor: f64,
    /// Wall time of everything: collecting, learning, planning, flying.
    total_wall_s: f64,
    /// The first flight.
    log: PathBuf,
    report: PathBuf,
    flight: FlightSummary,
    /// Length of the flights from which the models were learned, s.
    learned_from_s: Option<f64>,
    model: Option<PathBuf>,
    plans: Vec<PlanRow>,
    contenders: Vec<Contender>,
    logs: Vec<LogRow>,
}

/// One plan.
#[derive(JsonSchema, Serialize)]
pub(super) struct PlanRow {
    pub contender: &'static str,
    pub status: Status,
    pub cost: f64,
    pub violation: Violation,
    pub subproblems: usize,
    pub wall_s: f64,
    pub plan: PathBuf,
}

impl Demo<'_> {
    /// Writes the report and the summary.
    pub(super) fn conclude(
        &self,
        flown: Flown,
        learned: Option<Learned>,
        plans: Vec<PlanRow>,
        began: Instant,
    ) -> anyhow::Result<Exit> {
        let args = self.args;
        let Flown { first, end, exit, logs, contenders, simulated_s, wall_s } = flown;
        let report_path = args.out.join("report.html");
        let html = if args.fly.len() * self.configs.len() > 1 {
            self.page(&contenders, learned.as_ref(), &plans, &logs)?
        } else {
            first.to_html()
        };
        write_file(&report_path, html.as_bytes())?;
        let summary = DemoSummary {
            schema: "downwash.demo",
            schema_version: 2,
            end,
            seed: args.seed,
            trajectory: self.desired.as_ref().map_or("plan", |desired| desired.name()).to_owned(),
            effects: self.truth.effects.clone(),
            simulated_s,
            wall_s,
            real_time_factor: simulated_s / wall_s,
            total_wall_s: began.elapsed().as_secs_f64(),
            log: logs.first().map(|row| row.log.clone()).unwrap_or_default(),
            report: report_path,
            flight: first.summary().clone(),
            learned_from_s: learned.as_ref().map(|learned| learned.seconds),
            model: learned.as_ref().map(|learned| learned.path.clone()),
            plans,
            contenders,
            logs,
        };
        let json = serde_json::to_vec_pretty(&summary).context("summary.json")?;
        write_file(&args.out.join("summary.json"), &json)?;
        if args.json {
            print_json(&summary)?;
        } else {
            print_text(&text(&summary))?;
        }
        Ok(exit)
    }

    /// The page of the experiment.
    fn page(
        &self,
        contenders: &[Contender],
        learned: Option<&Learned>,
        plans: &[PlanRow],
        logs: &[LogRow],
    ) -> anyhow::Result<String> {
        let mut files: Vec<(String, &Path)> = Vec::new();
        if let Some(learned) = learned {
            files.push(("model".to_owned(), &learned.path));
        }
        files.extend(
            plans.iter().map(|row| {
                (format!("plan through the {} model", row.contender), row.plan.as_path())
            }),
        );
        files.extend(
            logs.iter()
                .map(|row| (format!("{}, seed {}", row.contender, row.seed), row.log.as_path())),
        );
        let mut notes = vec![(
            "flights",
            "the bundled vehicle in lockstep, with the whole protocol; every row has the same \
             limits and rates and, unless it names its control law, the same feedback"
                .to_owned(),
        )];
        if let Some(learned) = learned {
            notes.push((
                "learning",
                format!("{:.0} s of flight without translation and yaw together", learned.seconds),
            ));
        }
        for row in plans {
            notes.push((
                row.contender,
                format!(
                    "plan: {}, {} subproblems in {:.2} s, largest defect {}",
                    row.status.text(),
                    row.subproblems,
                    row.wall_s,
                    smallness(row.violation.defect)
                ),
            ));
        }
        Ok(experiment::html(&Experiment {
            trajectory: self.desired.as_ref().map_or("plan", |desired| desired.name()),
            vehicle: &self.vehicle.params.name,
            effects: &self.truth.effects,
            training: learned.map(|learned| &learned.summary),
            contenders,
            files: &files,
            folder: &self.args.out,
            notes: &notes,
        }))
    }
}

/// The text for stdout.
fn text(summary: &DemoSummary) -> String {
    let mut text = if summary.contenders.len() > 1 {
        let heads = ["flights", "north", "east", "down", "3D", "max", "yaw/deg", "gain", "fb/%"];
        let heads = heads.map(|head| format!("{head:>9}")).concat();
        let mut table = format!("flights {}\n{:22}{heads}\n", summary.end, "position RMSE / m");
        let reference = summary.contenders.first().map_or(f64::NAN, |c| c.mean.rmse_3d_m);
        for contender in &summary.contenders {
            let mean = &contender.mean;
            let [n, e, d] = mean.rmse_ned_m;
            let lengths = [n, e, d, mean.rmse_3d_m, mean.max_3d_m].map(|v| format!("{v:9.4}"));
            table += &format!(
                "{:22}{:9}{}{:9.2}{:9.1}{:9.0}\n",
                contender.name,
                contender.flights.len(),
                lengths.concat(),
                mean.rmse_yaw_rad.to_degrees(),
                reference / mean.rmse_3d_m,
                100.0 * contender.share.feedback_share
            );
        }
        table
    } else {
        summary::flight_table(&summary.flight, &summary.end)
    };
    text += &format!(
        "simulated {:.1} s in {:.2} s: {:.0} times real time; {:.0} s in total\nreport  \
         {}\nlog     {}\n",
        summary.simulated_s,
        summary.wall_s,
        summary.real_time_factor,
        summary.total_wall_s,
        summary.report.display(),
        summary.log.display()
    );
    text
}
