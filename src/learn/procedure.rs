//! From observed flights to a model file, step by step: split, actuation, physics, networks,
//! errors.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sitl::vehicle::{VehicleError, VehicleParams};

use super::commands::Onboard;
use super::dataset::{ObservedFlight, Row, WindowSettings};
use super::evaluation::{HORIZONS_S, MultiStep, OneStep, Predictor, multi_step, window_starts};
use super::identify;
use super::prediction::{Baseline, RecordedInputs};
use super::refine;
use super::samples::Samples;
use super::split::{Part, Split};
use super::summary::{
    DataSummary, LearningCurve, LogSummary, MultiStepSummary, OneStepSummary, RefusedLog, Series,
    TrainSettings, TrainingSummary,
};
use super::training::{self, Checkpoint, Stop, Trainer};
use crate::model::actuation::Actuation;
use crate::model::file::AccelerationSource;
use crate::model::file::{ModelFile, ModelKind};
use crate::model::hybrid::Hybrid;
use crate::model::learned::{FEATURES_MAX, Features, Head, Network, NetworkModel, OUTPUTS};
use crate::model::net::{Mlp, Normalization};
use crate::model::physics::{PhysicsModel, PhysicsParameters};
use crate::model::{ACCELERATIONS, Model};

/// Refined physics must lower the validation's score to this share to be taken.
const REFINED_MIN: f64 = 0.99;
/// Shares of the learned correction that a hybrid may take.
const SHARES: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// Least number of training rows.
pub const ROWS_MIN: usize = 500;
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

/// Length of the pieces over which observed and predicted are drawn, s.
const SERIES_S: f64 = 10.0;
/// Accelerations that are drawn: the paper's, east and roll.
const SERIES: [usize; 2] = [1, 3];

/// Watches a training, and may end it.
pub trait Watch {
    /// A stage of `steps` steps begins.
    fn stage(&mut self, name: &str, steps: u64);
    /// One step of the stage is done.
    fn step(&mut self, note: &str);
    /// Whether to stop as soon as nothing is lost.
    fn interrupted(&self) -> bool;
}

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Too little data.
    #[error(
        "only {found} rows to train on; at least {ROWS_MIN} are needed (5 s of flight), in \
         training, validation and test parts that are not empty"
    )]
    TooFewRows {
        /// Rows in the training part.
        found: usize,
    },
    /// The vehicle's physics does not work.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// A network could not be trained.
    #[error("network {network} of the {model} model: {reason}")]
    Network {
        /// The model that it is part of.
        model: &'static str,
        /// `nn1` or `nn2`.
        network: &'static str,
        /// Why.
        reason: String,
    },
    /// The checkpoint is of another training.
    #[error("the checkpoint is of other data or settings; train without --resume")]
    Checkpoint,
}

/// A training that was interrupted: what is done, and where the network at hand stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// What the checkpoint is of: settings and the logs' hashes.
    fingerprint: String,
    done: Vec<DoneTraining>,
    current: Option<Checkpoint>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct DoneTraining {
    network: Mlp,
    curve: Vec<training::Pass>,
    regularization: f64,
}

impl DoneTraining {
    /// Number of the pass with the lowest validation loss, and that loss.
    fn best(&self) -> (usize, f64) {
        let losses = self.curve.iter().filter_map(|pass| Some((pass.number, pass.validation?)));
        losses.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
    }
}

/// How a training ended.
pub enum Outcome {
    /// With a model.
    Done(Box<(ModelFile, TrainingSummary)>),
    /// Interrupted; it goes on from here.
    Interrupted(Progress),
}

/// Flights that are ready to be learned from.
pub struct Dataset<'a> {
    vehicle: &'a VehicleParams,
    onboard: &'a Onboard,
    flights: &'a [ObservedFlight],
    split: Split,
    actuation: Actuation,
    acceleration: AccelerationSource,
    physics: PhysicsParameters,
    rows: Vec<Vec<Row>>,
}

impl<'a> Dataset<'a> {
    /// Splits the flights, finds how the rotors answer on the training part, and makes the rows.
    ///
    /// # Errors
    /// [`TrainError::TooFewRows`], [`TrainError::Vehicle`].
    pub fn new(
        vehicle: &'a VehicleParams,
        onboard: &'a Onboard,
        flights: &'a mut [ObservedFlight],
    ) -> Result<Self, TrainError> {
        let counts: Vec<usize> = flights.iter().map(|f| f.observations.len()).collect();
        let split = Split::of(&counts);
        // Streams that are offset differently in each flight would blur the common delay.
        let source = AccelerationSource::VelocitySlope;
        let first = identify::actuation(&training_part(flights, &split), onboard, vehicle, source);
        for flight in flights.iter_mut() {
            identify::align_commands(flight, onboard, &first, source, vehicle.gravity);
        }
        let flights: &'a [ObservedFlight] = flights;
        let training = training_part(flights, &split);
        let mut dataset = Self {
            vehicle,
            onboard,
            flights,
            split,
            actuation: Actuation::default(),
            acceleration: AccelerationSource::VelocitySlope,
            physics: PhysicsParameters::default(),
            rows: Vec::new(),
        };
        // Both sources estimate the same; the one that physics explains with the smaller error
        // has the smaller noise.
        let mut best = f64::INFINITY;
        for source in [AccelerationSource::SpecificForce, AccelerationSource::VelocitySlope] {
            let actuation = identify::actuation(&training, onboard, vehicle, source);
            let rows: Vec<Vec<Row>> =
                flights.iter().map(|f| f.rows(onboard, &actuation, source)).collect();
            let candidate = Self {
                actuation,
                acceleration: source,
                rows,
                split: dataset.split.clone(),
                physics: PhysicsParameters::default(),
                ..dataset
            };
            let fit = candidate.part(Part::Training);
            if fit.len() < ROWS_MIN {
                continue;
            }
            let physics = identify::physics(&fit, vehicle)?;
            let model = PhysicsModel::new(vehicle, &physics)?;
            let error = OneStep::of(&model, &fit, &[1.0; ACCELERATIONS], |row| Some(row.label))
                .map_or(f64::INFINITY, |error| error.linear);
            if error < best {
                best = error;
                dataset = Self { physics, ..candidate };
            }
        }
        dataset.refine()?;
        let rows = Part::ALL.map(|part| dataset.part(part).len());
        if rows[0] < ROWS_MIN || rows.contains(&0) {
            return Err(TrainError::TooFewRows { found: rows[0] });
        }
        Ok(dataset)
    }

    /// Takes the actuation and physics whose open loop on the training part is best, if they
    /// also predict the validation part better.
    fn refine(&mut self) -> Result<(), VehicleError> {
        let training: Vec<_> = self
            .flights
            .iter()
            .enumerate()
            .map(|(index, flight)| (flight, self.blocks(index, Part::Training)))
            .filter(|(_, spans)| !spans.is_empty())
            .collect();
        let refined = refine::open_loop(
            &training,
            self.onboard,
            self.vehicle,
            &self.actuation,
            &self.physics,
        );
        let Some((actuation, physics)) = refined else { return Ok(()) };
        let score = |actuation: &Actuation, physics: &PhysicsParameters| {
            let model = PhysicsModel::new(self.vehicle, physics)?;
            let windows = self.windows(Part::Validation, actuation);
            Ok::<_, VehicleError>(score(&windows, &Predictor::Model(&model)))
        };
        if score(&actuation, &physics)? < REFINED_MIN * score(&self.actuation, &self.physics)? {
            self.rows = self
                .flights
                .iter()
                .map(|f| f.rows(self.onboard, &actuation, self.acceleration))
                .collect();
            (self.actuation, self.physics) = (actuation, physics);
        }
        Ok(())
    }

    /// The rows of one part.
    fn part(&self, part: Part) -> Vec<&Row> {
        let mut chosen = Vec::new();
        for index in 0..self.rows.len() {
            for span in self.spans(index, part) {
                let rows = &self.rows[index];
                let start = rows.partition_point(|row| row.time < span.start);
                let end = rows.partition_point(|row| row.time <= span.end);
                chosen.extend(&rows[start..end]);
            }
        }
        chosen
    }

    /// Times of one part of a flight, from the first to the last observation of each block.
    fn spans(&self, flight: usize, part: Part) -> Vec<Range<f64>> {
        let observations = &self.flights[flight].observations;
        let time = |index: usize| observations[index].time;
        self.split.flights[flight]
            .iter()
            .filter(|(range, p)| *p == part && !range.is_empty())
            .map(|(range, _)| time(range.start)..time(range.end - 1))
            .collect()
    }

    /// Usable times of one part of a flight, without gaps.
    fn blocks(&self, flight: usize, part: Part) -> Vec<Range<f64>> {
        let mut blocks = Vec::new();
        for block in self.spans(flight, part) {
            for segment in &self.flights[flight].segments.spans {
                let both = block.start.max(segment.start)..block.end.min(segment.end);
                if both.start < both.end {
                    blocks.push(both);
                }
            }
        }
        blocks
    }

    /// Recorded inputs and starts of windows of one part.
    fn windows<'b>(
        &'b self,
        part: Part,
        actuation: &'b Actuation,
    ) -> Vec<(RecordedInputs<'b>, Vec<f64>)> {
        let mut windows = Vec::new();
        for (index, flight) in self.flights.iter().enumerate() {
            let starts = window_starts(&self.blocks(index, part));
            if !starts.is_empty() {
                windows.push((RecordedInputs::new(flight, self.onboard, actuation), starts));
            }
        }
        windows
    }
}

/// Trains the networks and fits the physics on a dataset.
///
/// `progress` is that of an interrupted training, to go on from.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    dataset: &Dataset<'_>,
    settings: &TrainSettings,
    windows: &WindowSettings,
    refused: Vec<RefusedLog>,
    progress: Option<Progress>,
    watch: &mut dyn Watch,
) -> Result<Outcome, TrainError> {
    let vehicle = dataset.vehicle;
    let parts = Part::ALL.map(|part| dataset.part(part));
    let [training, validation, test] = &parts;
    let deviation = deviation(training);

    let physics = &dataset.physics;
    let physics_model = PhysicsModel::new(vehicle, physics)?;

    let fingerprint = fingerprint(dataset, settings);
    let mut progress = match progress {
        Some(progress) if progress.fingerprint != fingerprint => {
            return Err(TrainError::Checkpoint);
        }
        Some(progress) => progress,
        None => Progress { fingerprint, ..Progress::default() },
    };
    let leftover = |row: &Row| {
        let explained = physics_model.accelerations(&row.point);
        std::array::from_fn(|i| row.label[i] - explained[i])
    };
    let label = |row: &Row| row.label;
    let targets: [(ModelKind, &Target); 2] =
        [(ModelKind::Net, &label), (ModelKind::Hybrid, &leftover)];

    let jobs = targets.len() * Head::BOTH.len() * settings.regularization.len();
    watch.stage("networks", (jobs * settings.passes) as u64);
    let mut curves = Vec::new();
    let mut models = Vec::new();
    let mut job = 0;
    for (kind, target) in targets {
        let mut networks = Vec::new();
        for head in Head::BOTH {
            let set = NetworkData::new(settings.features, head, training, validation, target)
                .map_err(|reason| network_error(kind, head, reason))?;
            for regularization in &settings.regularization {
                if job >= progress.done.len() {
                    let passes = training::Settings {
                        hidden: settings.hidden,
                        passes: settings.passes,
                        regularization: *regularization,
                        seed: settings.seed,
                        ..training::Settings::default()
                    };
                    let current = progress.current.take();
                    let note = format!("{} {} {regularization}", kind.name(), head.name());
                    let mut trainer =
                        Trainer::new(&set.training, &set.validation, &passes, current)
                            .map_err(|error| network_error(kind, head, error.to_string()))?;
                    let stop = loop {
                        match trainer.pass() {
                            Ok(_) if watch.interrupted() => break Stop::Interrupted,
                            Ok(_) => watch.step(&note),
                            Err(stop) => break stop,
                        }
                    };
                    if stop == Stop::Interrupted {
                        progress.current = Some(trainer.checkpoint().clone());
                        return Ok(Outcome::Interrupted(progress));
                    }
                    let trained = trainer.finish(stop);
                    progress.done.push(DoneTraining {
                        network: trained.network,
                        curve: trained.curve,
                        regularization: *regularization,
                    });
                }
                job += 1;
            }
            let tried = &progress.done[job - settings.regularization.len()..job];
            let best = tried
                .iter()
                .enumerate()
                .min_by(|a, b| a.1.best().1.total_cmp(&b.1.best().1))
                .map_or(0, |(index, _)| index);
            for (index, done) in tried.iter().enumerate() {
                curves.push(LearningCurve {
                    model: kind,
                    network: head.name().to_owned(),
                    regularization: done.regularization,
                    chosen: index == best,
                    best_pass: done.best().0,
                    training: done.curve.iter().map(|pass| pass.training).collect(),
                    validation: done.curve.iter().map(|pass| pass.validation).collect(),
                });
            }
            networks.push(Network {
                inputs: set.inputs,
                outputs: set.outputs,
                mlp: tried[best].network.clone(),
            });
        }
        let [linear, angular] = <[Network; 2]>::try_from(networks)
            .map_err(|_| network_error(kind, Head::Linear, "missing".to_owned()))?;
        models.push(NetworkModel { features: settings.features, linear, angular });
    }
    let [net, residual] = <[NetworkModel; 2]>::try_from(models)
        .map_err(|_| network_error(ModelKind::Net, Head::Linear, "missing".to_owned()))?;

    watch.stage("errors", 12);
    let residual = dataset.shrink(residual, &physics_model, watch);
    let mut file = ModelFile {
        vehicle: vehicle.clone(),
        actuation: dataset.actuation,
        acceleration: dataset.acceleration,
        deviation,
        net,
        physics: physics.clone(),
        residual,
        preferred: ModelKind::Hybrid,
        training: serde_json::Value::Null,
    };
    let judged = judge(dataset, &file, &parts, &deviation, watch)?;
    file.preferred = judged.preferred;
    let summary = TrainingSummary {
        schema: "downwash.training".to_owned(),
        schema_version: 1,
        vehicle: vehicle.name.clone(),
        settings: settings.clone(),
        data: DataSummary {
            split: dataset.split.kind,
            rows: [training.len(), validation.len(), test.len()],
            label_bandwidth_hz: windows.bandwidth_hz(),
            acceleration: dataset.acceleration,
            deviation,
            label_error: label_error(training, &deviation),
            logs: dataset.log_summaries(),
            refused,
        },
        actuation: dataset.actuation,
        physics: physics.clone(),
        curves,
        preferred: judged.preferred,
        one_step: judged.one_step,
        multi_step: judged.multi_step,
        series: judged.series,
    };
    Ok(Outcome::Done(Box::new((file, summary))))
}

/// The observations of the training part.
fn training_part<'a>(
    flights: &'a [ObservedFlight],
    split: &Split,
) -> Vec<(&'a ObservedFlight, Range<usize>)> {
    let mut chosen = Vec::new();
    for (flight, parts) in flights.iter().zip(&split.flights) {
        for (range, part) in parts {
            if *part == Part::Training {
                chosen.push((flight, range.clone()));
            }
        }
    }
    chosen
}

type Target<'a> = dyn Fn(&Row) -> [f64; ACCELERATIONS] + 'a;

fn network_error(model: ModelKind, head: Head, reason: String) -> TrainError {
    TrainError::Network { model: model.name(), network: head.name(), reason }
}

/// What a training depends on.
fn fingerprint(dataset: &Dataset<'_>, settings: &TrainSettings) -> String {
    let logs: Vec<&str> = dataset.flights.iter().map(|f| f.flight.origin.sha256.as_str()).collect();
    format!("{settings:?} {logs:?} {:?}", dataset.vehicle)
}

/// Deviation of each label.
fn deviation(rows: &[&Row]) -> [f64; ACCELERATIONS] {
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
fn label_error(rows: &[&Row], deviation: &[f64; ACCELERATIONS]) -> Option<OneStep> {
    OneStep::of_values(rows, deviation, |row| row.truth.map(|truth| (row.label, truth)))
}

/// One network's rows, normalised.
struct NetworkData {
    inputs: Normalization,
    outputs: Normalization,
    training: Samples,
    validation: Samples,
}

impl NetworkData {
    fn new(
        features: Features,
        head: Head,
        training: &[&Row],
        validation: &[&Row],
        target: &Target<'_>,
    ) -> Result<Self, String> {
        let size = features.names(head).len();
        let mut extracted = [0.0; FEATURES_MAX];
        let mut raw = |row: &Row| -> ([f64; FEATURES_MAX], [f64; OUTPUTS]) {
            features.extract(head, &row.point.to_array(), &mut extracted);
            let all = target(row);
            let own = std::array::from_fn(|i| all[head.rows().start + i]);
            (extracted, features.target(head, row.point.attitude.yaw, own))
        };
        let mut sums = [[0.0; 2]; FEATURES_MAX + OUTPUTS];
        for row in training {
            let (x, y) = raw(row);
            for (sums, value) in sums.iter_mut().zip(x.into_iter().chain(y)) {
                sums[0] += value;
                sums[1] += value * value;
            }
        }
        let count = training.len() as f64;
        let normalization = |sums: &[[f64; 2]]| {
            let mean: Vec<f64> = sums.iter().map(|[sum, _]| sum / count).collect();
            let deviation = sums
                .iter()
                .zip(&mean)
                // What does not vary tells nothing, and must not be blown up where it does.
                .map(|([_, square], mean)| (square / count - mean * mean).max(0.0).sqrt())
                .map(|deviation| if deviation > 1e-9 { deviation } else { 1.0 })
                .collect();
            Normalization { mean, deviation }
        };
        let inputs = normalization(&sums[..size]);
        let outputs = normalization(&sums[FEATURES_MAX..]);
        let mut samples = |rows: &[&Row]| {
            let mut samples = Samples::with_capacity(size, OUTPUTS, rows.len());
            for row in rows {
                let (x, y) = raw(row);
                let scaled = |values: &[f64], by: &Normalization| -> Vec<f32> {
                    let pairs = values.iter().zip(by.mean.iter().zip(&by.deviation));
                    pairs.map(|(v, (mean, deviation))| ((v - mean) / deviation) as f32).collect()
                };
                samples
                    .push(&scaled(&x[..size], &inputs), &scaled(&y, &outputs))
                    .map_err(|error| error.to_string())?;
            }
            Ok::<_, String>(samples)
        };
        let (training, validation) = (samples(training)?, samples(validation)?);
        Ok(Self { inputs, outputs, training, validation })
    }
}

struct Judgement {
    preferred: ModelKind,
    one_step: Vec<OneStepSummary>,
    multi_step: Vec<MultiStepSummary>,
    series: Vec<Series>,
}

fn judge(
    dataset: &Dataset<'_>,
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
fn score(windows: &[(RecordedInputs<'_>, Vec<f64>)], predictor: &Predictor<'_>) -> f64 {
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
pub fn compare(
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
fn series(dataset: &Dataset<'_>, models: &[(ModelKind, Box<dyn Model>)]) -> Vec<Series> {
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

impl Dataset<'_> {
    /// The share of the learned correction with which the hybrid's open loop predicts the
    /// validation part best: what a network learned of noise is not taken.
    fn shrink(
        &self,
        residual: NetworkModel,
        physics: &PhysicsModel,
        watch: &mut dyn Watch,
    ) -> NetworkModel {
        let windows = self.windows(Part::Validation, &self.actuation);
        let mut best = (f64::INFINITY, residual.clone());
        for share in SHARES {
            let candidate = residual.scaled(share);
            let hybrid = Hybrid::new(physics.clone(), candidate.clone());
            let score = score(&windows, &Predictor::Model(&hybrid));
            if score < best.0 {
                best = (score, candidate);
            }
            watch.step("share of the correction");
        }
        best.1
    }

    fn log_summaries(&self) -> Vec<LogSummary> {
        let flights = self.flights.iter().zip(&self.rows).zip(&self.split.flights);
        flights
            .map(|((observed, rows), parts)| {
                let origin = &observed.flight.origin;
                let counted = observed.flight.left_out.iter();
                let mut left_out: Vec<(String, String)> =
                    counted.map(|(why, count)| (why.clone(), count.to_string())).collect();
                left_out.extend(
                    observed
                        .segments
                        .excluded
                        .iter()
                        .map(|e| (e.reason.clone(), format!("{:.2} s", e.seconds))),
                );
                LogSummary {
                    run: origin.run.clone(),
                    path: origin.path.clone(),
                    sha256: origin.sha256.clone(),
                    format: origin.format.to_owned(),
                    usable_s: observed.segments.seconds(),
                    rows: rows.len(),
                    parts: parts.iter().map(|(_, part)| *part).collect(),
                    source: observed.source.name().to_owned(),
                    law_error: observed.law_error,
                    attitude_latency_s: observed.alignment.attitude_s,
                    velocity_latency_s: observed.alignment.velocity_s,
                    command_shift_s: observed.command_shift_s,
                    left_out,
                }
            })
            .collect()
    }
}
