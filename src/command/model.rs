//! `downwash model`: the content of a model file, its errors, and its predictions.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

use super::logs::{Logs, check_named, listed};
use super::output::{Output, check_output};
use super::progress::StageBar;
use super::vehicle_file::warn;
use super::{Exit, ExitContext, print_json, print_status, print_text, write_file};
use crate::cli::ModelCommand;
use crate::learn::commands::Onboard;
use crate::learn::dataset::{ObservedFlight, WindowSettings};
use crate::learn::evaluation::{ACCELERATION_NAMES, OneStep};
use crate::learn::judgement::{Best, Evaluation, align, evaluate, standing};
use crate::learn::networks::Watch;
use crate::learn::prediction::RecordedInputs;
use crate::learn::summary::{MultiStepSummary, RefusedLog, TrainingSummary};
use crate::model::file::{ModelFile, ModelKind};
use crate::model::onnx;

/// Rate of the grid for a log that is no table, Hz.
const SAMPLE_RATE_HZ: f64 = 100.0;
/// Longest horizon, s: beyond it, open loop means nothing.
const HORIZON_MAX_S: f64 = 30.0;

pub(super) fn run(command: ModelCommand) -> anyhow::Result<Exit> {
    match command {
        ModelCommand::Info { file, model, json } => info(&either(file, model)?, json),
        ModelCommand::Eval { logs, model, vehicle, mapping, json } => {
            eval(&model, &logs, vehicle.as_deref(), mapping.as_deref(), json)
        }
        ModelCommand::Predict { log, model, horizon, kind, vehicle, mapping, out } => {
            if let Some(out) = &out {
                let given = [vehicle.as_deref(), mapping.as_deref()];
                let inputs = [log.as_path(), model.as_path()];
                check_output(out, inputs.into_iter().chain(given.into_iter().flatten()))?;
            }
            check_named([&log], mapping.as_deref())?;
            let file = load(&model, vehicle.as_deref())?;
            predict(&file, &log, mapping.as_deref(), horizon, kind, out.as_deref())
        }
        ModelCommand::Export { file, model, out, kind } => {
            let path = either(file, model)?;
            check_output(&out, [path.as_path()])?;
            let model = load(&path, None)?;
            write_file(&out, &onnx::encode(&model, kind))?;
            print_text(&format!("{}\n", out.display()))?;
            Ok(Exit::Ok)
        }
    }
}

fn either(file: Option<PathBuf>, flag: Option<PathBuf>) -> anyhow::Result<PathBuf> {
    file.or(flag)
        .ok_or_else(|| anyhow!("expected a model file, found none: give FILE or --model"))
        .or_exit(Exit::Usage)
}

/// Reads a model file, for this vehicle if one is named.
fn load(path: &Path, vehicle: Option<&Path>) -> anyhow::Result<ModelFile> {
    let file = ModelFile::load(path).or_exit(Exit::Usage)?;
    if let Some(vehicle) = vehicle {
        let name = vehicle;
        let vehicle = VehicleParams::load(name).or_exit(Exit::Usage)?;
        warn(name, &vehicle);
        file.check_vehicle(&vehicle, path).or_exit(Exit::Usage)?;
    }
    Ok(file)
}

/// The content of a model file: the JSON of `model info`.
#[derive(JsonSchema, Serialize)]
pub struct Info<'a> {
    schema: &'static str,
    schema_version: u32,
    vehicle: &'a str,
    features: [Vec<&'static str>; 2],
    hidden: [usize; 2],
    preferred: ModelKind,
    actuation: &'a crate::model::actuation::Actuation,
    physics: &'a crate::model::physics::PhysicsParameters,
    training: &'a serde_json::Value,
}

impl<'a> Info<'a> {
    /// SHA-256 of this file.
    pub fn of(file: &'a ModelFile) -> Self {
        Self {
            schema: "downwash.model_info",
            schema_version: 1,
            vehicle: &file.vehicle.name,
            features: crate::model::features::Head::BOTH.map(|head| file.net.features.names(head)),
            hidden: [file.net.linear.mlp.hidden, file.net.angular.mlp.hidden],
            preferred: file.preferred,
            actuation: &file.actuation,
            physics: &file.physics,
            training: &file.training,
        }
    }
}

fn info(path: &Path, json: bool) -> anyhow::Result<Exit> {
    let file = load(path, None)?;
    if json {
        print_json(&Info::of(&file))?;
        return Ok(Exit::Ok);
    }
    let summary: TrainingSummary = serde_json::from_value(file.training.clone())
        .context("cannot read how the model was trained")?;
    print_text(&summary_text(&summary))?;
    Ok(Exit::Ok)
}

/// The errors of a model on logs: the JSON of `model eval`.
#[derive(JsonSchema, Serialize)]
pub struct EvaluationSummary {
    schema: &'static str,
    schema_version: u32,
    model: PathBuf,
    /// The used logs, by their paths as given.
    logs: Vec<String>,
    refused: Vec<RefusedLog>,
    /// The errors.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// Judges the model file at `path` on logs of its vehicle.
///
/// # Errors
/// No log is usable.
pub fn evaluated(
    path: &Path,
    logs: &[PathBuf],
    vehicle: Option<&Path>,
    mapping: Option<&Path>,
) -> anyhow::Result<EvaluationSummary> {
    let file = load(path, vehicle)?;
    check_named(logs, mapping)?;
    let onboard = Onboard::new(&file.vehicle).or_exit(Exit::Usage)?;
    let windows = windows_of(&file);
    let names = listed(logs);
    let mut bar = StageBar::new(Arc::default());
    bar.stage("logs", logs.len() as u64);
    let mut logs = Logs::read(logs, mapping, &file.vehicle, &onboard, &windows, |_| bar.step(""));
    if logs.flights.is_empty() {
        bar.clear();
        return Err(anyhow!("none of the logs can be used: {}", names)).or_exit(Exit::Usage);
    }
    let evaluation = evaluate(&file, &onboard, &mut logs.flights, &mut bar);
    bar.clear();
    Ok(EvaluationSummary {
        schema: "downwash.model_eval",
        schema_version: 1,
        model: path.to_owned(),
        logs: logs.flights.iter().map(|f| f.flight.origin.path.display().to_string()).collect(),
        refused: logs.refused,
        evaluation: evaluation.or_exit(Exit::Usage)?,
    })
}

fn eval(
    path: &Path,
    logs: &[PathBuf],
    vehicle: Option<&Path>,
    mapping: Option<&Path>,
    json: bool,
) -> anyhow::Result<Exit> {
    let summary = evaluated(path, logs, vehicle, mapping)?;
    if json {
        print_json(&summary)?;
    } else {
        let evaluation = &summary.evaluation;
        let mut text = one_step_head();
        for errors in &evaluation.one_step {
            text += &one_step_line(errors.model.name(), "labels", errors.labels.as_ref());
            text += &one_step_line(errors.model.name(), "truth", errors.truth.as_ref());
        }
        text += &multi_step_table(&evaluation.multi_step);
        print_text(&text)?;
    }
    Ok(Exit::Ok)
}

/// The windows with which the model was trained.
fn windows_of(file: &ModelFile) -> WindowSettings {
    let half = file.training.pointer("/settings/window_half_s").and_then(|v| v.as_f64());
    let default = WindowSettings::default();
    WindowSettings { half_s: half.unwrap_or(default.half_s), ..default }
}

fn predict(
    file: &ModelFile,
    log: &Path,
    mapping: Option<&Path>,
    horizon: f64,
    kind: Option<ModelKind>,
    out: Option<&Path>,
) -> anyhow::Result<Exit> {
    if !(horizon.is_finite() && horizon > 0.0 && horizon <= HORIZON_MAX_S) {
        let error = anyhow!(
            "--horizon: expected more than 0 and at most {HORIZON_MAX_S} s, found {horizon}"
        );
        return Err(error).or_exit(Exit::Usage);
    }
    let onboard = Onboard::new(&file.vehicle).or_exit(Exit::Usage)?;
    let mut logs =
        Logs::read(&[log.to_owned()], mapping, &file.vehicle, &onboard, &windows_of(file), |_| {});
    let Some(observed) = logs.flights.first_mut() else {
        let reason = logs.refused.first().map_or("", |refused| refused.reason.as_str());
        return Err(anyhow!("{}: {reason}", log.display())).or_exit(Exit::Usage);
    };
    align(file, &onboard, observed);
    let model = file.model(kind.unwrap_or(file.preferred)).or_exit(Exit::Usage)?;
    let inputs = RecordedInputs::new(observed, &onboard, &file.actuation);
    let samples = Samples::of(observed);
    let period = samples.period();
    let steps = (horizon / period).round().max(1.0) as usize;

    let mut sink = Output::to(out)?;
    let run = &observed.flight.origin.run;
    writeln!(sink, "run,start,h,x,y,z,vx,vy,vz,qw,qx,qy,qz,wx,wy,wz").context("predictions")?;
    let mut written = 0_u64;
    // Pieces keep memory small and the order of the file.
    let starts: Vec<usize> = (0..samples.times.len()).collect();
    for piece in starts.chunks(512) {
        let texts: Vec<String> = piece
            .par_iter()
            .map(|start| {
                let horizons = samples.ahead(*start, steps);
                let (number, time) = samples.times[*start];
                rows(&inputs, model.as_ref(), run, number, time, &horizons)
            })
            .collect();
        for text in texts {
            written += text.lines().count() as u64;
            sink.write_all(text.as_bytes()).context("predictions")?;
        }
    }
    sink.finish()?;
    print_status(format_args!(
        "{}: {written} predictions, {steps} samples of {:.1} ms ahead",
        log.display(),
        1e3 * period
    ));
    Ok(Exit::Ok)
}

/// The predictions from one start, as rows of the CSV.
fn rows(
    inputs: &RecordedInputs<'_>,
    model: &dyn crate::model::Model,
    run: &str,
    start: usize,
    time: f64,
    horizons: &[f64],
) -> String {
    let mut text = String::new();
    let Some(state) = inputs.reported(time) else { return text };
    let Some(predicted) = inputs.predict(model, time, state, horizons) else { return text };
    for (step, state) in predicted.iter().enumerate() {
        let [x, y, z] = state.position.to_array();
        let [vx, vy, vz] = state.velocity.to_array();
        let q = state.attitude;
        let [wx, wy, wz] = state.body_rate.to_array();
        text += &format!(
            "{run},{start},{},{x:.6},{y:.6},{z:.6},{vx:.6},{vy:.6},{vz:.6},\
             {:.7},{:.7},{:.7},{:.7},{wx:.6},{wy:.6},{wz:.6}\n",
            step + 1,
            q.w,
            q.x,
            q.y,
            q.z
        );
    }
    text
}

/// The starts of the predictions, with their numbers: the rows of a table, or else a 100 Hz grid
/// over the flight's unbroken parts.
struct Samples {
    times: Vec<(usize, f64)>,
}

impl Samples {
    fn of(observed: &ObservedFlight) -> Self {
        if let Some(rows) = &observed.flight.rows {
            return Self { times: rows.iter().copied().enumerate().collect() };
        }
        let spans = observed.recorded().into_iter().map(|span| {
            let grid = |time: f64| time * SAMPLE_RATE_HZ;
            grid(span.start).ceil() as i64..=grid(span.end).floor() as i64
        });
        let spans: Vec<_> = spans.collect();
        let first = spans.first().map_or(0, |span| *span.start());
        let samples = spans.into_iter().flatten();
        let times = samples.map(|k| ((k - first) as usize, k as f64 / SAMPLE_RATE_HZ));
        Self { times: times.collect() }
    }

    /// Times from a sample to the next `steps` after it. A horizon ends with the recording, or
    /// where open loop means nothing. On the grid, it also ends where the recording pauses; the
    /// rows of a table count on.
    fn ahead(&self, start: usize, steps: usize) -> Vec<f64> {
        let Some(((number, time), later)) = self.times.get(start..).and_then(<[_]>::split_first)
        else {
            return Vec::new();
        };
        let next = later.iter().take(steps).zip(1..).take_while(|((other, at), ahead)| {
            other - number == *ahead && at - time <= HORIZON_MAX_S
        });
        next.map(|((_, at), _)| at - time).collect()
    }

    /// Median time between samples, s.
    fn period(&self) -> f64 {
        let mut gaps: Vec<f64> = self.times.windows(2).map(|pair| pair[1].1 - pair[0].1).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(1.0 / SAMPLE_RATE_HZ)
    }
}

/// The results of a training, for people.
pub(super) fn summary_text(summary: &TrainingSummary) -> String {
    let [training, validation, test] = summary.data.rows;
    let seconds: f64 = summary.data.logs.iter().map(|log| log.usable_s).sum();
    let mut text = format!(
        "vehicle {}: {} logs, {seconds:.0} s of flight; rows {training} training, {validation} \
         validation, {test} test\n",
        summary.vehicle,
        summary.data.logs.len()
    );
    for refused in &summary.data.refused {
        text += &format!("left out {}: {}\n", refused.path.display(), refused.reason);
    }
    let a = &summary.actuation;
    text += &format!(
        "actuation: delay {:.1} ms, lag {:.1} ms, thrust as voltage to the power {:.2}{}\n",
        1e3 * a.delay_s,
        1e3 * a.lag_s,
        a.voltage_exponent,
        a.balance_s.map_or(String::new(), |time| format!(", moments balanced over {time} s"))
    );
    text += &format!(
        "labels: linear acceleration from the {}, bandwidth {:.1} Hz\n",
        summary.data.acceleration.name(),
        summary.data.label_bandwidth_hz
    );
    text += &one_step_head();
    text += &one_step_line("labels", "truth", summary.data.label_error.as_ref());
    for errors in &summary.one_step {
        let name = errors.model.name();
        for (part, index) in [("training", 0), ("validation", 1), ("test", 2)] {
            text += &one_step_line(name, part, errors.labels[index].as_ref());
        }
        text += &one_step_line(name, "test, truth", errors.truth[2].as_ref());
    }
    text += &multi_step_table(&summary.multi_step);
    text + &best_text(standing(summary).best, summary.preferred)
}

/// How the default model compares.
fn best_text(best: Best, preferred: ModelKind) -> String {
    let reason = best.reason().unwrap_or_default();
    let preferred = preferred.name();
    match best {
        Best::NotJudged => format!("not judged: {reason}; using {preferred}\n"),
        Best::NotFinite => format!("none can be used: {reason}\n"),
        Best::NoBetterThanHolding => format!("none is good: {reason}; using {preferred}\n"),
        Best::Better => format!("best on validation: {preferred}\n"),
    }
}

fn one_step_head() -> String {
    let each = ACCELERATION_NAMES.map(|name| format!("{name:>9}")).concat();
    format!("normalised MSE        {:>9}{:>9} {each}\n", "linear", "angular")
}

fn one_step_line(name: &str, part: &str, errors: Option<&OneStep>) -> String {
    let Some(errors) = errors else { return String::new() };
    let each = errors.each.map(|e| format!("{e:9.4}")).concat();
    format!("  {name:8} {part:11}{:9.4}{:9.4} {each}\n", errors.linear, errors.angular)
}

fn multi_step_table(summaries: &[MultiStepSummary]) -> String {
    let Some(first) = summaries.first() else { return String::new() };
    let mut text = format!("open loop, {} windows (RMS)\n", first.windows);
    text += &format!(
        "  {:18}{:>8}{:>12}{:>14}{:>14}{:>14}\n",
        "", "horizon", "position/m", "velocity/m/s", "attitude/rad", "rate/rad/s"
    );
    for (index, horizon) in first.horizons_s.iter().enumerate() {
        for summary in summaries {
            let e = &summary.errors[index];
            text += &format!(
                "  {:18}{horizon:>6} s{:12.4}{:14.4}{:14.4}{:14.4}\n",
                summary.predictor, e.position_m, e.velocity_m_s, e.attitude_rad, e.rate_rad_s
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_model_better_than_holding_is_called_best() {
        let words = |best| best_text(best, ModelKind::Hybrid);
        assert_eq!(words(Best::Better), "best on validation: hybrid\n");
        let poor = words(Best::NoBetterThanHolding);
        assert!(
            poor.starts_with("none is good: no model predicts the validation flights better"),
            "{poor}"
        );
        assert!(poor.ends_with("; using hybrid\n"), "{poor}");
    }
}
