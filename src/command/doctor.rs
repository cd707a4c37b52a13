//! `downwash doctor`: what a vehicle sends, and whether it can be flown, without changing it.

mod findings;
mod observed;

use std::time::Duration;

use anyhow::ensure;
use schemars::JsonSchema;
use serde::Serialize;

use self::findings::{Finding, Weight, findings};
use self::observed::{Observed, Report};
use super::listen::Listener;
use super::{Exit, ExitContext, print_json, print_status, print_text};
use crate::cli::DoctorArgs;

/// Listening time, s: for AUTOPILOT_VERSION, then parameters, then rates.
const SECONDS: f64 = 8.0;
const STEP: Duration = Duration::from_millis(250);

/// The JSON of `doctor`.
#[derive(JsonSchema, Serialize)]
pub(super) struct Answer<'a> {
    schema: &'static str,
    schema_version: u32,
    verdict: &'static str,
    findings: &'a [Finding],
    report: &'a Report,
}

pub(super) fn run(args: &DoctorArgs) -> anyhow::Result<Exit> {
    let seconds = args.listen.seconds.unwrap_or(SECONDS);
    let checked = || -> anyhow::Result<()> {
        ensure!(
            (1.0..=3600.0).contains(&seconds),
            "--seconds: expected 1 to 3600, found {seconds}"
        );
        Ok(())
    };
    checked().or_exit(Exit::Usage)?;
    let mut listener = Listener::open(&args.listen, args.rates)?;
    print_status(format_args!("listening on {} for {seconds} s", listener.endpoint));
    let started = listener.clock.now();
    let mut observed = Observed::new(&listener.config);
    while listener.clock.now().since(started).as_secs_f64() < seconds {
        listener.listen(STEP, |_, delivery| observed.take(delivery));
        observed.follow(&mut listener);
    }
    let now = listener.clock.now();
    let report = observed.report(&listener, now.since(started).as_secs_f64());
    let (findings, verdict, exit) = if listener.session.vehicle().is_none() {
        let finding = Finding::new(Weight::Refuses, "vehicle", listener.silence(now));
        (vec![finding], "no vehicle", Exit::Link)
    } else {
        let found = findings(&report, &observed, &listener, args.rates);
        let is_refused = found.iter().any(|finding| finding.weight == Weight::Refuses);
        match is_refused {
            true => (found, "refused", Exit::Refused),
            false => (found, "can be flown", Exit::Ok),
        }
    };
    if args.listen.json {
        print_json(&Answer {
            schema: "downwash.doctor",
            schema_version: 1,
            verdict,
            findings: &findings,
            report: &report,
        })?;
    } else {
        let mut text = report.to_string();
        for finding in &findings {
            text += &format!("{finding}\n");
        }
        text += &format!("verdict    {verdict}\n");
        print_text(&text)?;
    }
    Ok(exit)
}
