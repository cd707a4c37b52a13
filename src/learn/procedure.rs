//! From a training set to a model file: networks, corrections, evaluation.

use super::dataset::{Row, WindowSettings};
use super::error::TrainError;
use super::judgement::{deviation, judge, label_error};
use super::networks::{Lesson, NETWORKS, Progress, Target, Watch, models};
use super::split::Part;
use super::summary::{DataSummary, RefusedLog, TrainSettings, TrainingSummary};
use super::training_set::{CHOICE_WINDOWS_MAX, TrainingSet};
use crate::model::file::{ModelFile, ModelKind};
use crate::model::physics::PhysicsModel;

/// How a training ended.
pub enum Outcome {
    /// The training finished.
    Done(Box<(ModelFile, TrainingSummary)>),
    /// The training was interrupted, and can resume from here.
    Interrupted(Progress),
}

/// Trains the networks on a dataset, whose physics is already fitted, and evaluates the models.
///
/// `progress` resumes an interrupted training.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    dataset: &TrainingSet<'_>,
    settings: &TrainSettings,
    windows: &WindowSettings,
    refused: Vec<RefusedLog>,
    progress: Option<Progress>,
    watch: &mut dyn Watch,
) -> Result<Outcome, TrainError> {
    let vehicle = dataset.vehicle;
    let parts = Part::ALL.map(|part| dataset.part(part));
    let [training, validation, _] = &parts;
    let deviation = deviation(training);

    let physics = &dataset.physics;
    let physics_model = PhysicsModel::new(vehicle, physics)?;

    let lessons = |kind, target: &Target<'_>| {
        Lesson::both(kind, settings.features, training, validation, target)
    };
    let mut all = Vec::from(lessons(ModelKind::Net, &|row: &Row| row.label)?);
    all.extend(lessons(ModelKind::Hybrid, &|row: &Row| row.residual(&physics_model))?);

    let mut progress = begun(progress, dataset, settings)?;
    if !progress.go_on(&all, settings, watch)? {
        return Ok(Outcome::Interrupted(progress));
    }
    watch.trained(&progress);
    let reached = progress.clone();
    let (networks, curves) = progress.networks(all, &settings.regularization);
    let [net, residual] =
        models(networks, settings.features).ok_or(TrainError::NoRegularization)?;

    watch.stage("errors", 13);
    let corrected = dataset.refine_net(&net);
    let net_corrected = corrected.is_some();
    let net = corrected.unwrap_or(net);
    watch.step("open loop of the net");
    if watch.interrupted() {
        return Ok(Outcome::Interrupted(reached));
    }
    let residual =
        dataset.shrink(residual, &physics_model, CHOICE_WINDOWS_MAX, &mut |note| watch.step(note));
    if watch.interrupted() {
        return Ok(Outcome::Interrupted(reached));
    }
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
            rows: parts.each_ref().map(Vec::len),
            label_bandwidth_hz: windows.bandwidth_hz(),
            acceleration: dataset.acceleration,
            deviation,
            label_error: label_error(training, &deviation),
            logs: dataset.log_summaries(),
            refused,
        },
        actuation: dataset.actuation,
        physics: physics.clone(),
        net_corrected,
        curves,
        preferred: judged.preferred,
        one_step: judged.one_step,
        validation: judged.validation,
        multi_step: judged.multi_step,
        series: judged.series,
    };
    Ok(Outcome::Done(Box::new((file, summary))))
}

/// The progress to continue from: none yet, or that of the same training.
fn begun(
    progress: Option<Progress>,
    dataset: &TrainingSet<'_>,
    settings: &TrainSettings,
) -> Result<Progress, TrainError> {
    match progress {
        Some(progress) if belongs(&progress, dataset, settings) => Ok(progress),
        Some(_) => Err(TrainError::Checkpoint),
        None => {
            let fingerprint = fingerprint(dataset, settings);
            Ok(Progress::new(fingerprint, settings.window_half_s, trainings(settings)))
        }
    }
}

/// Whether `progress` belongs to this training, for any window of its labels.
pub fn belongs(progress: &Progress, dataset: &TrainingSet<'_>, settings: &TrainSettings) -> bool {
    progress.is_of(&fingerprint(dataset, settings), trainings(settings))
}

/// Number of trainings: each network with every regularisation.
fn trainings(settings: &TrainSettings) -> usize {
    NETWORKS * settings.regularization.len()
}

/// Everything that a training depends on except the window of its labels.
fn fingerprint(dataset: &TrainingSet<'_>, settings: &TrainSettings) -> String {
    let logs: Vec<&str> = dataset.flights.iter().map(|f| f.flight.origin.sha256.as_str()).collect();
    let settings = TrainSettings { window_half_s: 0.0, ..settings.clone() };
    format!("{settings:?} {logs:?} {:?}", dataset.vehicle)
}
