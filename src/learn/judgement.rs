//! Evaluation of trained models, on the parts of a training and on any other flights.

use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::VehicleError;

use super::commands::Onboard;
use super::comparison::{HOLD, Models, compare, summaries};
use super::dataset::{ObservedFlight, Row};
use super::error::TrainError;
use super::error_ratio::{AS_HOLDING, ratios, relative};
use super::evaluation::{FlightWindows, MultiStep, OneStep, window_starts};
use super::identify;
use super::networks::Watch;
use super::prediction::RecordedInputs;
use super::preference::preferred;
use super::split::Part;
use super::summary::{MultiStepSummary, OneStepSummary, Series, TrainingSummary};
use super::training_set::TrainingSet;
use crate::model::file::{ModelFile, ModelKind};
use crate::model::{ACCELERATIONS, Model};

/// Length of the plotted series of observed and predicted values, s.
const SERIES_S: f64 = 10.0;
/// Accelerations that are plotted: the paper's, east and roll.
const SERIES: [usize; 2] = [1, 3];

/// Errors of a model file on logs, which it may never have seen.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Evaluation {
    /// Number of rows.
    pub rows: usize,
    /// Errors of each model's accelerations, relative to the variance of its training labels.
    pub one_step: Vec<EvaluatedModel>,
    /// Open-loop errors: models, then baselines.
    pub multi_step: Vec<MultiStepSummary>,
}

/// Errors of a model's accelerations on one set of logs.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct EvaluatedModel {
    /// The model.
    pub model: ModelKind,
    /// Against the labels.
    pub labels: Option<OneStep>,
    /// Against the simulator's truth.
    pub truth: Option<OneStep>,
}

/// Evaluates a model file on flights.
///
/// # Errors
/// The file's vehicle does not allow the physics.
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
    let models = models(file)?;
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
        .map(|flight| FlightWindows {
            inputs: RecordedInputs::new(flight, onboard, &file.actuation),
            starts: window_starts(&flight.segments.spans),
        })
        .collect();
    let multi_step = summaries(&compare(&windows, &models, watch));
    Ok(Evaluation { rows: rows.len(), one_step, multi_step })
}

fn models(file: &ModelFile) -> Result<Models, VehicleError> {
    ModelKind::ALL.into_iter().map(|kind| Ok((kind, file.model(kind)?))).collect()
}

/// Aligns a flight's motor outputs with its other streams, as in the training.
pub fn align(file: &ModelFile, onboard: &Onboard, flight: &mut ObservedFlight) {
    let (actuation, source) = (&file.actuation, file.acceleration);
    identify::align_commands(flight, onboard, actuation, source, file.vehicle.gravity);
}

/// The results of a training's models on its parts.
pub(super) struct Judgement {
    pub preferred: ModelKind,
    pub one_step: Vec<OneStepSummary>,
    pub validation: Vec<MultiStepSummary>,
    pub multi_step: Vec<MultiStepSummary>,
    pub series: Vec<Series>,
}

/// Evaluates the models of `file` on the parts of `dataset`.
pub(super) fn judge(
    dataset: &TrainingSet<'_>,
    file: &ModelFile,
    parts: &[Vec<&Row>; 3],
    deviation: &[f64; ACCELERATIONS],
    watch: &mut dyn Watch,
) -> Result<Judgement, TrainError> {
    let models = models(file)?;
    let mut one_step = Vec::new();
    for (kind, model) in &models {
        let model_errors = |measured: fn(&Row) -> Option<[f64; ACCELERATIONS]>| {
            parts.each_ref().map(|rows| OneStep::of(model.as_ref(), rows, deviation, measured))
        };
        one_step.push(OneStepSummary {
            model: *kind,
            labels: model_errors(|row| Some(row.label)),
            truth: model_errors(|row| row.truth),
        });
        watch.step("one step");
    }
    let windows = dataset.windows(Part::Validation, &dataset.actuation);
    let validation = compare(&windows, &models, watch);
    let preferred = preferred(&validation, dataset.split.kind);
    let validation = summaries(&validation);
    let windows = dataset.windows(Part::Test, &dataset.actuation);
    let multi_step = summaries(&compare(&windows, &models, watch));
    let series = series(dataset, &models);
    Ok(Judgement { preferred, one_step, validation, multi_step, series })
}

/// The errors of a model, and those of holding the state.
fn against_hold(
    summaries: &[MultiStepSummary],
    kind: ModelKind,
) -> Option<(&MultiStep, &MultiStep)> {
    let errors = |name: &str| {
        let found = summaries.iter().find(|summary| summary.predictor == name);
        found.map(|summary| &summary.errors)
    };
    errors(kind.name()).zip(errors(HOLD))
}

/// Open-loop results of all models on the validation part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Whether every model has smaller errors than holding the state, in every quantity, at the
    /// middle horizons.
    pub settled: bool,
    /// Sum of the models' errors relative to those of holding the state; lower is better, infinite
    /// if they are unknown or not finite.
    pub score: f64,
    /// The result of the best model.
    pub best: Best,
}

/// The result of the best of several models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Best {
    /// There is no window to evaluate on.
    NotJudged,
    /// No model has finite errors.
    NotFinite,
    /// Its errors are at least those of holding the state.
    NoBetterThanHolding,
    /// Its errors are smaller than those of holding the state.
    Better,
}

impl Best {
    /// Why no model is usable, if none is.
    pub fn reason(self) -> Option<&'static str> {
        match self {
            Self::NotJudged => Some("the validation part has no second without a gap"),
            Self::NotFinite => Some("no model predicts finite states on the validation flights"),
            Self::NoBetterThanHolding => {
                Some("no model predicts the validation flights better than holding the state does")
            }
            Self::Better => None,
        }
    }
}

impl Standing {
    /// Whether to prefer these models to those of `other`, which were found before: one model with
    /// non-finite errors among good ones spoils the score, but is not the one that is used.
    pub fn beats(&self, other: &Self) -> bool {
        let can_be_used = |standing: &Self| standing.best != Best::NotFinite;
        match (can_be_used(self), can_be_used(other)) {
            (true, false) => true,
            (false, true) => false,
            _ => self.score < other.score,
        }
    }
}

/// The standing of a training's models.
pub fn standing(summary: &TrainingSummary) -> Standing {
    standing_of(&summary.validation)
}

fn standing_of(validation: &[MultiStepSummary]) -> Standing {
    let mut standing = Standing { settled: true, score: 0.0, best: Best::NotJudged };
    let mut least: Option<f64> = None;
    for kind in ModelKind::ALL {
        match against_hold(validation, kind) {
            Some((errors, hold)) => {
                standing.settled &= ratios(errors, hold).all(|ratio| ratio < 1.0);
                let score = relative(errors, hold);
                standing.score += score;
                least = Some(least.map_or(score, |least| least.min(score)));
            }
            // Without an evaluation, no improvement can be detected.
            None => standing.score = f64::INFINITY,
        }
    }
    standing.best = match least {
        None => Best::NotJudged,
        Some(score) if !score.is_finite() => Best::NotFinite,
        Some(score) if score >= AS_HOLDING => Best::NoBetterThanHolding,
        Some(_) => Best::Better,
    };
    standing
}

/// Observed and predicted values over time, from the block of the test part with the most varied
/// roll acceleration.
fn series(dataset: &TrainingSet<'_>, models: &[(ModelKind, Box<dyn Model>)]) -> Vec<Series> {
    let blocks = (0..dataset.flights.len())
        .flat_map(|index| dataset.spans(index, Part::Test).into_iter().map(move |s| (index, s)));
    // The block in which the angular acceleration varies most shows most.
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

/// Standard deviation of each label.
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

/// Errors of the labels against the simulator's truth.
pub(super) fn label_error(rows: &[&Row], deviation: &[f64; ACCELERATIONS]) -> Option<OneStep> {
    OneStep::of_values(rows, deviation, |row| row.truth.map(|truth| (row.label, truth)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::evaluation::{HORIZONS_S, StateError};

    /// The same error in every quantity, at every horizon.
    fn summary(predictor: &str, error: f64) -> MultiStepSummary {
        let state = StateError {
            position_m: error,
            velocity_m_s: error,
            attitude_rad: error,
            rate_rad_s: error,
        };
        MultiStepSummary {
            predictor: predictor.to_owned(),
            errors: [state; HORIZONS_S.len()],
            horizons_s: HORIZONS_S.to_vec(),
            windows: 1,
        }
    }

    #[test]
    fn window_with_any_finite_model_beats_one_with_none() {
        let seen = |net, physics, hybrid| {
            let models = [("net", net), ("physics", physics), ("hybrid", hybrid), (HOLD, 1.0)];
            standing_of(&models.map(|(name, error)| summary(name, error)))
        };
        let none = seen(f64::NAN, f64::NAN, f64::INFINITY);
        let two = seen(f64::NAN, 0.5, 0.6);
        assert_eq!((none.best, two.best), (Best::NotFinite, Best::Better));
        assert_eq!((none.score, two.score), (f64::INFINITY, f64::INFINITY));
        assert!(two.beats(&none) && !none.beats(&two));
        // Otherwise the earlier one stays, unless its score is higher.
        assert!(!none.beats(&none) && !two.beats(&two));
        let all = seen(0.9, 0.5, 0.6);
        assert!(all.beats(&two) && !two.beats(&all) && all.beats(&none) && !none.beats(&all));
        assert_eq!(seen(1.0, 1.0, 1.0).best, Best::NoBetterThanHolding);
        let unjudged = standing_of(&[]);
        assert_eq!(unjudged.best, Best::NotJudged);
        assert!(unjudged.beats(&none) && !none.beats(&unjudged) && all.beats(&unjudged));
    }

    #[test]
    fn non_finite_errors_round_trip_through_json() {
        for written in [summary("net", f64::NAN), summary("net", f64::INFINITY)] {
            let text = serde_json::to_string(&written).expect("JSON");
            let read: MultiStepSummary = serde_json::from_str(&text).expect("a summary");
            assert_eq!(read, summary("net", f64::INFINITY));
        }
        let one_step = OneStep { each: [f64::NAN; 6], linear: f64::NAN, angular: 1.0, rows: 3 };
        let text = serde_json::to_string(&one_step).expect("JSON");
        let read: OneStep = serde_json::from_str(&text).expect("errors");
        assert_eq!(
            (read.each, read.linear, read.angular),
            ([f64::INFINITY; 6], f64::INFINITY, 1.0)
        );
    }
}
