//! `downwash log audit`: what is wrong with logs before any physics.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

use super::logs::check_named;
use super::{Exit, ExitContext, print_json, print_status, print_text};
use crate::audit::{Agreement, Audit, Estimate, Severity};
use crate::cli::FailOnFinding;
use crate::diagnose::verdict::untestable::{self, Untestable};
use crate::log::import::{self, Flight, ImportError};

/// The findings on logs: the JSON of `log audit`.
#[derive(JsonSchema, Serialize)]
pub struct AuditSummary {
    schema: &'static str,
    schema_version: u32,
    logs: Vec<Log>,
}

/// The findings on one log, and the effects that it cannot show.
#[derive(JsonSchema, Serialize)]
struct Log {
    #[serde(flatten)]
    audit: Audit,
    untestable: Vec<Untestable>,
}

/// Audits logs together, and reports those that cannot be read.
pub fn audit(files: &[PathBuf], mapping: Option<&Path>) -> (AuditSummary, Vec<ImportError>) {
    let opened: Vec<Result<Flight, ImportError>> =
        files.par_iter().map(|file| import::open_among(file, mapping)).collect();
    let (mut flights, mut refused) = (Vec::new(), Vec::new());
    for opened in opened {
        match opened {
            Ok(flight) => flights.push(flight),
            Err(error) => refused.push(error),
        }
    }
    let audits = Audit::of_all(&flights);
    let logs: Vec<Log> = audits
        .into_iter()
        .zip(&flights)
        .map(|(audit, flight)| {
            let untestable = untestable::of(flight, &audit.channels);
            Log { audit, untestable }
        })
        .collect();
    (AuditSummary { schema: "downwash.log.audit", schema_version: 2, logs }, refused)
}

pub(super) fn run(
    files: &[PathBuf],
    mapping: Option<&Path>,
    fail_on: Option<FailOnFinding>,
    json: bool,
) -> anyhow::Result<Exit> {
    check_named([], mapping)?;
    let (summary, mut refused) = audit(files, mapping);
    let logs = &summary.logs;
    // A file that is no log does not stop the audit of the others.
    let last = refused.pop();
    refused.iter().for_each(|error| print_status(format_args!("{error}")));
    if logs.is_empty() {
        return last.map_or(Ok(()), Err).or_exit(Exit::Usage).map(|()| Exit::Ok);
    }
    let limit = fail_on.map(|limit| match limit {
        FailOnFinding::Fault => Severity::Fault,
        FailOnFinding::Measurement => Severity::Measurement,
    });
    let is_failed = |log: &Log| {
        limit.is_some_and(|limit| log.audit.findings.iter().any(|f| f.severity >= limit))
    };
    let exit = if logs.iter().any(is_failed) { Exit::Check } else { Exit::Ok };
    if json {
        print_json(&summary)?;
    } else {
        print_text(&logs.iter().map(text).collect::<Vec<_>>().join("\n"))?;
    }
    last.map_or(Ok(()), Err).or_exit(Exit::Usage)?;
    Ok(exit)
}

fn text(log: &Log) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = print(log, &mut text);
    text
}

fn print(Log { audit, untestable }: &Log, out: &mut String) -> std::fmt::Result {
    writeln!(out, "{}: {} log", audit.file, audit.format)?;
    match audit.tier {
        Some(tier) => writeln!(out, "  tier {tier}")?,
        None => writeln!(out, "  no tier: position, velocity and attitude are not all logged")?,
    }
    for timing in &audit.streams {
        writeln!(
            out,
            "  {:<15} {:>7} samples at {:>6.1} Hz, longest gap {:.3} s, {:.1} % missing",
            timing.stream,
            timing.samples,
            timing.rate_hz,
            timing.longest_gap_s.unwrap_or(0.0),
            100.0 * timing.lost
        )?;
    }
    let kinematics = &audit.kinematics;
    agreement(out, "attitude against gyro", kinematics.attitude.as_ref(), "rad/s")?;
    agreement(out, "position against velocity", kinematics.position.as_ref(), "m/s")?;
    agreement(out, "velocity against accelerometer", kinematics.velocity.as_ref(), "m/s^2")?;
    if let Some(lean) = &kinematics.lean {
        agreement(out, "velocity against lean", Some(lean), "m/s^2")?;
    }
    if let Some(setpoint) = &kinematics.setpoint {
        agreement(out, "attitude against setpoint", Some(setpoint), "rad")?;
    }
    if let Some(rate) = audit.rates.outputs_hz {
        writeln!(out, "  new motor outputs at {rate:.1} Hz")?;
    }
    for finding in &audit.findings {
        writeln!(out, "  {finding}")?;
    }
    if audit.findings.is_empty() {
        writeln!(out, "  nothing found")?;
    }
    for Untestable { effect, reason } in untestable {
        writeln!(out, "  cannot show {effect}: {reason}")?;
    }
    Ok(())
}

fn agreement(
    out: &mut String,
    name: &str,
    agreement: Option<&Agreement>,
    unit: &str,
) -> std::fmt::Result {
    let Some(agreement) = agreement else {
        return writeln!(out, "  {name}: not shown by this log");
    };
    let Agreement { delay_s, rotation_rad, scale, bias, explained, .. } = agreement;
    write!(out, "  {name}: {:+.1} +- {:.1} ms", 1e3 * delay_s.value, 1e3 * delay_s.half_width)?;
    let numbers = |of: &[Option<Estimate>; 3], precise: usize, factor: f64| {
        let number = |of: &Option<Estimate>| match of {
            Some(estimate) => format!("{:+.precise$}", factor * estimate.value),
            None => "not shown".to_owned(),
        };
        of.each_ref().map(number).join(", ")
    };
    writeln!(
        out,
        ", turned ({}) deg, scale ({}), bias ({}) {unit}, {:.1} % explained",
        numbers(rotation_rad, 2, 1f64.to_degrees()),
        numbers(scale, 3, 1.0),
        numbers(bias, 3, 1.0),
        100.0 * explained
    )
}
