//! The report of a training: the data, the fit, the errors. Its JSON is a stable format.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::evaluation::{MultiStep, OneStep};
use super::not_finite;
use super::split::{Part, SplitKind};
use super::training::Method;
use crate::model::ACCELERATIONS;
use crate::model::actuation::Actuation;
use crate::model::features::Features;
use crate::model::file::{AccelerationSource, ModelKind};
use crate::model::physics::PhysicsParameters;

/// The complete report of one training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct TrainingSummary {
    /// `downwash.training`.
    pub schema: String,
    /// Version of this format.
    pub schema_version: u32,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The requested settings.
    pub settings: TrainSettings,
    /// The data.
    pub data: DataSummary,
    /// The rotors' response, identified on the training flights.
    pub actuation: Actuation,
    /// The fitted physics.
    pub physics: PhysicsParameters,
    /// Whether the net was corrected on its open-loop predictions.
    #[serde(default)]
    pub net_corrected: bool,
    /// Every training of a network.
    pub curves: Vec<LearningCurve>,
    /// The model with the smallest errors on the validation rows.
    pub preferred: ModelKind,
    /// Errors of each model, in the order net, physics, hybrid.
    pub one_step: Vec<OneStepSummary>,
    /// Open-loop errors on validation windows, which decide the selection: models, then baselines.
    pub validation: Vec<MultiStepSummary>,
    /// Open-loop errors on the test rows: models, then baselines.
    pub multi_step: Vec<MultiStepSummary>,
    /// Observed and predicted values over time, from a test flight.
    pub series: Vec<Series>,
}

/// Settings of a training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct TrainSettings {
    /// The networks' input features.
    pub features: Features,
    /// Hidden units of each network.
    pub hidden: usize,
    /// Most passes through the training rows.
    pub passes: usize,
    /// The optimiser.
    pub method: Method,
    /// Weights of the squared weights to try; validation selects one.
    pub regularization: Vec<f64>,
    /// Random seed of the initial weights.
    pub seed: u64,
    /// Half width of the labels' window, s.
    pub window_half_s: f64,
    /// All window half widths that may be tried, in order, s.
    #[serde(default)]
    pub windows_half_s: Vec<f64>,
}

/// The data of a training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct DataSummary {
    /// How rows were split.
    pub split: SplitKind,
    /// Rows in each part: training, validation, test.
    pub rows: [usize; 3],
    /// -3 dB bandwidth of the labels, Hz.
    pub label_bandwidth_hz: f64,
    /// Source of the linear acceleration.
    pub acceleration: AccelerationSource,
    /// Standard deviation of each label over the training rows.
    pub deviation: [f64; ACCELERATIONS],
    /// Mean squared difference between labels and the simulator's truth, relative to the labels'
    /// variance; only if the logs hold the truth.
    pub label_error: Option<OneStep>,
    /// The logs that were used.
    pub logs: Vec<LogSummary>,
    /// The logs that were rejected, and why.
    pub refused: Vec<RefusedLog>,
}

/// A log that was used.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct LogSummary {
    /// File name without extension; the end of the path if another log has that name.
    pub run: String,
    /// The file.
    pub path: PathBuf,
    /// SHA-256 of the file.
    pub sha256: String,
    /// `mcap`, `tlog`, `csv`.
    pub format: String,
    /// Usable flight time, s.
    pub usable_s: f64,
    /// Number of rows.
    pub rows: usize,
    /// The purposes of its rows.
    pub parts: Vec<Part>,
    /// The source of u.
    pub source: String,
    /// Root mean square difference between the on-board law's outputs and the logged ones.
    pub law_error: Option<f64>,
    /// Latency of the attitude relative to the gyro, s.
    pub attitude_latency_s: Option<f64>,
    /// Latency of the velocity relative to the gyro, s.
    pub velocity_latency_s: Option<f64>,
    /// Additional delay of the motor outputs relative to the average, s.
    pub command_shift_s: f64,
    /// Excluded data: the reason, and the amount in words.
    pub left_out: Vec<(String, String)>,
}

/// A log that was rejected.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RefusedLog {
    /// The file.
    pub path: PathBuf,
    /// The reason.
    pub reason: String,
}

/// One training of one network.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct LearningCurve {
    /// The model that it is part of.
    pub model: ModelKind,
    /// `nn1` or `nn2`.
    pub network: String,
    /// Weight of the squared weights.
    pub regularization: f64,
    /// Whether validation selected it.
    pub chosen: bool,
    /// The pass whose weights were kept.
    pub best_pass: usize,
    /// Normalised mean squared error on the training rows, pass by pass.
    #[serde(deserialize_with = "not_finite::numbers")]
    pub training: Vec<f64>,
    /// The same on the validation rows, where it was computed.
    pub validation: Vec<Option<f64>>,
}

/// Errors of a model's accelerations.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OneStepSummary {
    /// The model.
    pub model: ModelKind,
    /// Against the labels: training, validation, test.
    pub labels: [Option<OneStep>; 3],
    /// Against the simulator's truth: training, validation, test.
    pub truth: [Option<OneStep>; 3],
}

/// Open-loop errors of one predictor.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct MultiStepSummary {
    /// `net`, `physics`, `hybrid`, `hold`, `constant velocity`.
    pub predictor: String,
    /// Errors at each of `horizons_s`.
    pub errors: MultiStep,
    /// Horizons, s.
    pub horizons_s: Vec<f64>,
    /// Number of windows.
    pub windows: usize,
}

/// Accelerations over time.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Series {
    /// The flight.
    pub run: String,
    /// Index of the acceleration.
    pub acceleration: usize,
    /// Time since the start of the series, s.
    pub time_s: Vec<f64>,
    /// The label.
    pub observed: Vec<f64>,
    /// The prediction of each model, in the order net, physics, hybrid.
    #[serde(deserialize_with = "not_finite::lists")]
    pub predicted: Vec<Vec<f64>>,
}
