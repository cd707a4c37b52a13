//! What a training has to say for itself: the data, the fit, the errors. Its JSON is a contract.

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

/// Everything about one training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct TrainingSummary {
    /// `downwash.training`.
    pub schema: String,
    /// Version of this form.
    pub schema_version: u32,
    /// Name of the vehicle.
    pub vehicle: String,
    /// How it was asked for.
    pub settings: TrainSettings,
    /// The data.
    pub data: DataSummary,
    /// How the rotors answer, by the training flights.
    pub actuation: Actuation,
    /// The fitted physics.
    pub physics: PhysicsParameters,
    /// Whether the net is corrected by its open loop.
    #[serde(default)]
    pub net_corrected: bool,
    /// Every training of a network.
    pub curves: Vec<LearningCurve>,
    /// The model that did best on the validation rows.
    pub preferred: ModelKind,
    /// Errors of each model, in the order net, physics, hybrid.
    pub one_step: Vec<OneStepSummary>,
    /// Open-loop errors on validation windows, by which models were chosen: models, then baselines.
    pub validation: Vec<MultiStepSummary>,
    /// Open-loop errors on the test rows: models, then baselines.
    pub multi_step: Vec<MultiStepSummary>,
    /// Observed against predicted over time, from a test flight.
    pub series: Vec<Series>,
}

/// How a training is done.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct TrainSettings {
    /// What the networks are given.
    pub features: Features,
    /// Hidden units of each network.
    pub hidden: usize,
    /// Passes through the training rows at most.
    pub passes: usize,
    /// How weights follow the gradient.
    pub method: Method,
    /// Weights of the squared weights that are tried; validation decides.
    pub regularization: Vec<f64>,
    /// Seed of the weights.
    pub seed: u64,
    /// Half width of the labels' window, s.
    pub window_half_s: f64,
    /// All that may be tried, one after another, s.
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
    /// Where the linear acceleration is from.
    pub acceleration: AccelerationSource,
    /// Deviation of each label over the training rows.
    pub deviation: [f64; ACCELERATIONS],
    /// Mean squared difference between labels and the simulator's truth, over the labels'
    /// variance; only where the logs hold the truth.
    pub label_error: Option<OneStep>,
    /// The logs that were used.
    pub logs: Vec<LogSummary>,
    /// The logs of which nothing was used, and why.
    pub refused: Vec<RefusedLog>,
}

/// A log that was used.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct LogSummary {
    /// File name without extension.
    pub run: String,
    /// The file.
    pub path: PathBuf,
    /// SHA-256 of the file.
    pub sha256: String,
    /// `mcap`, `tlog`, `csv`.
    pub format: String,
    /// Usable flight, s.
    pub usable_s: f64,
    /// Rows.
    pub rows: usize,
    /// What they are for.
    pub parts: Vec<Part>,
    /// Where u is from.
    pub source: String,
    /// Outputs by the on-board law against the logged ones, root mean square.
    pub law_error: Option<f64>,
    /// Lateness of the attitude against the gyro, s.
    pub attitude_latency_s: Option<f64>,
    /// Lateness of the velocity against the gyro, s.
    pub velocity_latency_s: Option<f64>,
    /// How much later than on average the motor outputs act, s.
    pub command_shift_s: f64,
    /// What was left out: why, and how much in words.
    pub left_out: Vec<(String, String)>,
}

/// A log of which nothing was used.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RefusedLog {
    /// The file.
    pub path: PathBuf,
    /// Why.
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
    /// Whether validation chose it.
    pub chosen: bool,
    /// Pass whose weights were kept.
    pub best_pass: usize,
    /// Normalised mean squared error on the training rows, pass by pass.
    #[serde(deserialize_with = "not_finite::numbers")]
    pub training: Vec<f64>,
    /// And on the validation rows, where it was computed.
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
    /// At each of `horizons_s`.
    pub errors: MultiStep,
    /// Horizons, s.
    pub horizons_s: Vec<f64>,
    /// Windows.
    pub windows: usize,
}

/// Accelerations over time.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Series {
    /// The flight.
    pub run: String,
    /// Which acceleration, an index.
    pub acceleration: usize,
    /// Since the start of the piece, s.
    pub time_s: Vec<f64>,
    /// The label.
    pub observed: Vec<f64>,
    /// By each model, in the order net, physics, hybrid.
    #[serde(deserialize_with = "not_finite::lists")]
    pub predicted: Vec<Vec<f64>>,
}
