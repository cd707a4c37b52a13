//! `downwash schema`: JSON Schemas of the commands' JSON output.

use anyhow::anyhow;
use schemars::generate::SchemaSettings;
use schemars::transform::{Transform, transform_subschemas};
use schemars::{JsonSchema, Schema};
use serde_json::{Value, json};

use super::{
    Exit, ExitContext, audit, campaign, collect, config, demo, demo_diagnose, diagnose, doctor,
};
use super::{
    exam, fleet, fly, import, inspect, mocap, model, onset, plan, simulate, sweep, tube, vehicle,
};
use super::{print_json, print_text};
use crate::cli::SchemaArgs;
use crate::learn::summary::TrainingSummary;
use crate::log::info::LogInfo;
use crate::report::flight::FlightSummary;
use crate::report::recording::RecordingSummary;
use crate::report::side_by_side::Comparison;
use crate::service::ServiceStatus;

/// The output of a command.
pub(super) struct Output {
    /// The value of its key `schema`; output without this key is found by this name.
    name: &'static str,
    /// The command that prints it.
    command: &'static str,
    make: fn() -> Schema,
}

/// All outputs, in the order of the reference.
pub(super) const OUTPUTS: [Output; 43] = [
    Output::new::<campaign::CampaignSummary>("downwash.campaign", "campaign --json"),
    Output::new::<campaign::CampaignFlight>(
        "downwash.campaign.flight",
        "campaign --script FILE --json, a line of rows-*.jsonl for each flight",
    ),
    Output::new::<collect::CollectSummary>("downwash.collect", "collect --json"),
    Output::new::<Comparison>("downwash.compare", "compare --json"),
    Output::new::<config::Report<'_>>("downwash.config", "config --json"),
    Output::new::<demo::DemoSummary>("downwash.demo", "demo --json"),
    Output::new::<demo_diagnose::RepairSummary>("downwash.demo.diagnose", "demo --diagnose --json"),
    Output::new::<diagnose::Told<'_>>("downwash.diagnose", "diagnose --json"),
    Output::new::<fleet::Told<'_>>("downwash.diagnose.fleet", "diagnose --fleet --json"),
    Output::new::<sweep::DiagnosisRow>(
        "downwash.diagnose.row",
        "sweep of diagnose, the row of each point",
    ),
    Output::new::<doctor::Answer<'_>>("downwash.doctor", "doctor --json"),
    Output::new::<exam::ExamSummary<'_>>("downwash.exam", "exam --json"),
    Output::new::<sweep::ExamRow>("downwash.exam.case", "sweep of exam, the row of each case"),
    Output::new::<exam::EditsSummary<'_>>("downwash.exam.edits", "exam --flights LOG --json"),
    Output::new::<exam::FleetsSummary<'_>>("downwash.exam.fleets", "exam --fleet COUNT --json"),
    Output::new::<exam::LawsSummary<'_>>("downwash.exam.laws", "exam --laws COUNT --json"),
    Output::new::<exam::OnsetsSummary<'_>>("downwash.exam.onsets", "exam --onsets COUNT --json"),
    Output::new::<exam::PracticeSummary<'_>>(
        "downwash.exam.practice",
        "exam --practice DIR --json",
    ),
    Output::new::<fly::FlySummary>("downwash.fly", "fly --json"),
    Output::new::<fly::CheckSummary>("downwash.check", "fly --check --json"),
    Output::new::<inspect::Report>("downwash.inspect", "inspect --json"),
    Output::new::<audit::AuditSummary>("downwash.log.audit", "log audit --json"),
    Output::new::<import::Summary>("downwash.log.import", "log import --json"),
    Output::new::<LogInfo>("downwash.log.info", "log info --json, a line for each file"),
    Output::new::<FlightSummary>("downwash.report.flight", "log report --json"),
    Output::new::<RecordingSummary>(
        "downwash.report.recording",
        "log report --json, of a log of another program",
    ),
    Output::new::<mocap::MocapSummary>("downwash.mocap", "mocap --json"),
    Output::new::<model::EvaluationSummary>("downwash.model_eval", "model eval --json"),
    Output::new::<model::Info<'_>>("downwash.model_info", "model info --json"),
    Output::new::<plan::PlanSummary<'_>>("downwash.plan.summary", "plan --json"),
    Output::new::<onset::OnsetAnswer>("downwash.onset", "onset --json"),
    Output::new::<simulate::Row>("downwash.simulate", "simulate --json"),
    Output::new::<ServiceStatus>(
        "downwash.status",
        "fly --metrics and daemon --metrics at GET /status",
    ),
    Output::new::<sweep::ExamSweepSummary>("downwash.sweep.exam", "sweep of exam, summary.json"),
    Output::new::<sweep::SweepSummary>("downwash.sweep.summary", "sweep --json"),
    Output::new::<sweep::Listed>(
        "downwash.sweep.point",
        "sweep --list --json, a line for each point",
    ),
    Output::new::<sweep::Line>(
        "downwash.sweep.row",
        "sweep, a line of rows-*.jsonl for each point",
    ),
    Output::new::<TrainingSummary>("downwash.training", "train --json"),
    Output::new::<tube::TubeCheck>("downwash.tube.check", "tube check --json"),
    Output::new::<tube::TubeSummary<'_>>("downwash.tube.fit", "tube fit --json"),
    Output::new::<vehicle::Checked<'_>>("downwash.vehicle.check", "vehicle check --json"),
    Output::new::<vehicle::Made>("downwash.vehicle.init", "vehicle init --json"),
    Output::new::<vehicle::Listed>("downwash.vehicle.list", "vehicle list --json"),
];

impl Output {
    const fn new<T: JsonSchema>(name: &'static str, command: &'static str) -> Self {
        Self { name, command, make: schema_of::<T> }
    }

    pub(super) fn name(&self) -> &'static str {
        self.name
    }

    pub(super) fn command(&self) -> &'static str {
        self.command
    }

    pub(super) fn schema(&self) -> Value {
        let mut schema = (self.make)();
        schema.insert("$id".to_owned(), json!(self.name));
        schema.insert("title".to_owned(), json!(self.name));
        schema
            .insert("$comment".to_owned(), json!(format!("printed by downwash {}", self.command)));
        schema.to_value()
    }
}

fn schema_of<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.with_transform(NumbersMayBeNull).into_generator().into_root_schema_for::<T>()
}

/// JSON has no non-finite numbers; they are written as null.
#[derive(Clone, Debug)]
struct NumbersMayBeNull;

impl Transform for NumbersMayBeNull {
    fn transform(&mut self, schema: &mut Schema) {
        if schema.get("type") == Some(&json!("number")) {
            schema.insert("type".to_owned(), json!(["number", "null"]));
        }
        // The names that Rust gives them.
        if schema.get("format").is_some() {
            schema.remove("format");
        }
        transform_subschemas(self, schema);
    }
}

pub(super) fn run(args: &SchemaArgs) -> anyhow::Result<Exit> {
    if let Some(name) = &args.name {
        let found = OUTPUTS.iter().find(|output| output.name == name);
        let names = || OUTPUTS.iter().map(|output| output.name).collect::<Vec<_>>().join(", ");
        let output = found
            .ok_or_else(|| anyhow!("schema {name:?} does not exist; expected one of {}", names()))
            .or_exit(Exit::Usage)?;
        print_text(&(serde_json::to_string_pretty(&output.schema())? + "\n"))?;
    } else if args.json {
        let all = OUTPUTS.iter().map(|output| (output.name.to_owned(), output.schema()));
        print_json(&all.collect::<serde_json::Map<String, Value>>())?;
    } else {
        let width = OUTPUTS.iter().map(|output| output.name.len()).max().unwrap_or(0);
        let line = |output: &Output| format!("{:<width$}  {}\n", output.name, output.command);
        print_text(&OUTPUTS.iter().map(line).collect::<String>())?;
    }
    Ok(Exit::Ok)
}
