//! What trained models are worth: on the parts of a training, and on any other flights.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sitl::vehicle::VehicleError;

use super::commands::Onboard;
use super::dataset::{ObservedFlight, Row};
use super::evaluation::{HORIZONS_S, MultiStep, OneStep, Predictor, multi_step, window_starts};
use super::identify;
use super::prediction::{Baseline, RecordedInputs};
use super::procedure::{TrainError, Watch};
use super::split::Part;
use super::summary::{MultiStepSummary, OneStepSummary, Series};
use super::training_set::TrainingSet;
use crate::model::file::{ModelFile, ModelKind};
use crate::model::{ACCELERATIONS, Model};

/// Length of the pieces over which observed and predicted are drawn, s.
const SERIES_S: f64 = 10.0;
/// Accelerations that are drawn: the paper's, east and roll.
const SERIES: [usize; 2] = [1, 3];

/// Errors of a model file on logs that it may never have seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Rows.
    pub rows: usize,
    /// Errors of each model's accelerations, over the variance of the labels that it was trained on.
    pub one_step: Vec<EvaluatedModel>,
    /// Open-loop errors: models, then baselines.
    pub multi_step: Vec<MultiStepSummary>,
}

/// Errors of a model's accelerations on one set of logs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluatedModel {
    /// The model.
    pub model: ModelKind,
    /// Against the labels.
    pub labels: Option<OneStep>,
    /// Against the simulator's truth.
    pub truth: Option<OneStep>,
}

/// Judges a model file on flights.
///
/// # Errors
/// Physics that the file's vehicle does not allow.
pub fn evaluate(
    file: &ModelFile,
    onboard: &Onboard,
    flights: &mut [ObservedFlight],
    watch: &mut dyn Watch,
) -> Result<Evaluation, VehicleError> {
    for flight in flights.iter_mut() {
        align(file, onboard, flight);
    }
    let flights: &[ObservedFlight] = flights;
    watch.stage("errors", 8);
    let source = file.acceleration;
    let rows: Vec<Row> =
        flights.iter().flat_map(|f| f.rows(onboard, &file.actuation, source)).collect();
    let rows: Vec<&Row> = rows.iter().collect();
    let mut models = Vec::new();
    for kind in ModelKind::ALL {
        models.push((kind, file.model(kind)?));
    }
    let deviation = file.deviation;
    let one_step = models
        .iter()
        .map(|(kind, model)| {
            watch.step("one step");
            EvaluatedModel {
                model: *kind,
                labels: OneStep::of(model.as_ref(), &rows, &deviation, |row| Some(row.label)),
                truth: OneStep::of(model.as_ref(), &rows, &deviation, |row| row.truth),
            }
        })
        .collect();
    let windows: Vec<_> = flights
        .iter()
        .map(|flight| {
            let inputs = RecordedInputs::new(flight, onboard, &file.actuation);
            (inputs, window_starts(&flight.segments.spans))
        })
        .collect();
    Ok(Evaluation { rows: rows.len(), one_step, multi_step: compare(&windows, &models, watch) })
}

/// Ties a flight's motor outputs to its other streams as the training's were.
pub fn align(file: &ModelFile, onboard: &Onboard, flight: &mut ObservedFlight) {
    let (actuation, source) = (&file.actuation, file.acceleration);
    identify::align_commands(flight, onboard, actuation, source, file.vehicle.gravity);
}

/// What the parts of a training say of its models.
pub(super) struct Judgement {
    pub preferred: ModelKind,
    pub one_step: Vec<OneStepSummary>,
    pub multi_step: Vec<MultiStepSummary>,
    pub series: Vec<Series>,
}

/// Judges the models of `file` on the parts of `dataset`.
pub(super) fn judge(
    dataset: &TrainingSet<'_>,
    file: &ModelFile,
    parts: &[Vec<&Row>; 3],
    deviation: &[f64; ACCELERATIONS],
    watch: &mut dyn Watch,
) -> Result<Judgement, TrainError> {
    let mut models = Vec::new();
    for kind in ModelKind::ALL {
        models.push((kind, file.model(kind)?));
    }
    let mut one_step = Vec::new();
    for (kind, model) in &models {
        let errors = |truth: bool| {
            parts.each_ref().map(|rows| {
                OneStep::of(model.as_ref(), rows, deviation, |row| {
                    if truth { row.truth } else { Some(row.label) }
                })
            })
        };
        one_step.push(OneStepSummary { model: *kind, labels: errors(false), truth: errors(true) });
        watch.step("one step");
    }
    let windows = dataset.windows(Part::Validation, &dataset.actuation);
    let mut preferred = (f64::INFINITY, ModelKind::Hybrid);
    for (kind, model) in &models {
        let score = score(&windows, &Predictor::Model(model.as_ref()));
        if score < preferred.0 {
            preferred = (score, *kind);
        }
        watch.step("validation windows");
    }
    let windows = dataset.windows(Part::Test, &dataset.actuation);
    let multi_step = compare(&windows, &models, watch);
    let series = series(dataset, &models);
    Ok(Judgement { preferred: preferred.1, one_step, multi_step, series })
}

/// Errors at the middle horizons over those of holding the state, summed: lower is better.
pub(super) fn score(windows: &[(RecordedInputs<'_>, Vec<f64>)], predictor: &Predictor<'_>) -> f64 {
    let hold = multi_step(windows, &Predictor::Baseline(Baseline::Hold));
    match (multi_step(windows, predictor), hold) {
        (Some((errors, _)), Some((hold, _))) => relative(&errors, &hold),
        _ => f64::INFINITY,
    }
}

/// Sum of errors at the middle horizons, over those of `hold`.
fn relative(errors: &MultiStep, hold: &MultiStep) -> f64 {
    let mut sum = 0.0;
    for (a, b) in errors[1..3].iter().zip(&hold[1..3]) {
        sum += a.position_m / b.position_m.max(1e-9)
            + a.velocity_m_s / b.velocity_m_s.max(1e-9)
            + a.attitude_rad / b.attitude_rad.max(1e-9)
            + a.rate_rad_s / b.rate_rad_s.max(1e-9);
    }
    sum
}

/// Open-loop errors of models and baselines over the same windows.
fn compare(
    windows: &[(RecordedInputs<'_>, Vec<f64>)],
    models: &[(ModelKind, Box<dyn Model>)],
    watch: &mut dyn Watch,
) -> Vec<MultiStepSummary> {
    let mut predictors: Vec<(&str, Predictor<'_>)> = Vec::new();
    for (kind, model) in models {
        predictors.push((kind.name(), Predictor::Model(model.as_ref())));
    }
    predictors.push(("hold", Predictor::Baseline(Baseline::Hold)));
    predictors.push(("constant velocity", Predictor::Baseline(Baseline::ConstantVelocity)));
    predictors
        .into_iter()
        .filter_map(|(name, predictor)| {
            let found = multi_step(windows, &predictor);
            watch.step("test windows");
            let (errors, windows) = found?;
            let (predictor, horizons_s) = (name.to_owned(), HORIZONS_S.to_vec());
            Some(MultiStepSummary { predictor, errors, horizons_s, windows })
        })
        .collect()
}

/// Observed and predicted over time, from the longest block of the test part.
fn series(dataset: &TrainingSet<'_>, models: &[(ModelKind, Box<dyn Model>)]) -> Vec<Series> {
    let blocks = (0..dataset.flights.len())
        .flat_map(|index| dataset.spans(index, Part::Test).into_iter().map(move |s| (index, s)));
    // The flight in which the angular acceleration moves most shows most.
    let lively = |(index, span): &(usize, Range<f64>)| {
        let rows = dataset.rows[*index].iter().filter(|row| span.contains(&row.time));
        moments(rows.map(|row| row.label[3])).1
    };
    let Some((index, span)) = blocks.max_by(|a, b| lively(a).total_cmp(&lively(b))) else {
        return Vec::new();
    };
    let start = 0.5 * (span.start + span.end - SERIES_S).max(2.0 * span.start);
    let rows: Vec<&Row> = dataset.rows[index]
        .iter()
        .filter(|row| row.time >= start && row.time < (start + SERIES_S).min(span.end))
        .collect();
    let run = &dataset.flights[index].flight.origin.run;
    SERIES
        .into_iter()
        .map(|acceleration| Series {
            run: run.clone(),
            acceleration,
            time_s: rows.iter().map(|row| row.time - start).collect(),
            observed: rows.iter().map(|row| row.label[acceleration]).collect(),
            predicted: models
                .iter()
                .map(|(_, model)| {
                    rows.iter().map(|row| model.accelerations(&row.point)[acceleration]).collect()
                })
                .collect(),
        })
        .collect()
}

/// Deviation of each label.
pub(super) fn deviation(rows: &[&Row]) -> [f64; ACCELERATIONS] {
    std::array::from_fn(|i| {
        let (_, deviation) = moments(rows.iter().map(|row| row.label[i]));
        deviation.max(1e-9)
    })
}

/// Mean and standard deviation.
fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    (mean, variance.sqrt())
}

/// Labels against the simulator's truth.
pub(super) fn label_error(rows: &[&Row], deviation: &[f64; ACCELERATIONS]) -> Option<OneStep> {
    OneStep::of_values(rows, deviation, |row| row.truth.map(|truth| (row.label, truth)))
}
