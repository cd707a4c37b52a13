//! The networks of a model: their data, and their parallel training.

use std::sync::Mutex;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::dataset::Row;
use super::error::TrainError;
use super::samples::Samples;
use super::summary::{LearningCurve, TrainSettings};
use super::training::{self, Checkpoint, Stop, Trainer};
use crate::model::ACCELERATIONS;
use crate::model::features::{FEATURES_MAX, Features, Head, OUTPUTS};
use crate::model::file::ModelKind;
use crate::model::learned::{Network, NetworkModel};
use crate::model::net::{Mlp, Normalization};

/// Number of networks in a model file: two models with two each.
pub(super) const NETWORKS: usize = 4;

/// The training target of a row: accelerations in the frames of its label.
pub type Target<'a> = dyn Fn(&Row) -> [f64; ACCELERATIONS] + 'a;

/// The normalised rows of one network.
pub struct Lesson {
    model: ModelKind,
    head: Head,
    inputs: Normalization,
    outputs: Normalization,
    training: Samples,
    validation: Samples,
}

impl Lesson {
    /// The rows of both networks of a model.
    ///
    /// # Errors
    /// [`TrainError::Network`] if a row is not finite.
    pub fn both(
        model: ModelKind,
        features: Features,
        training: &[&Row],
        validation: &[&Row],
        target: &Target<'_>,
    ) -> Result<[Self; 2], TrainError> {
        let lesson = |head| {
            Self::new(model, head, features, training, validation, target)
                .map_err(|reason| network_error(model, head, reason))
        };
        Ok([lesson(Head::Linear)?, lesson(Head::Angular)?])
    }

    fn new(
        model: ModelKind,
        head: Head,
        features: Features,
        training: &[&Row],
        validation: &[&Row],
        target: &Target<'_>,
    ) -> Result<Self, String> {
        let size = features.names(head).len();
        let mut extracted = [0.0; FEATURES_MAX];
        let mut raw = |row: &Row| -> ([f64; FEATURES_MAX], [f64; OUTPUTS]) {
            let at = row.point.to_array();
            features.extract(head, &at, &mut extracted);
            let all = target(row);
            let own = std::array::from_fn(|i| all[head.rows().start + i]);
            (extracted, features.target(head, &at, own))
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
                .map(|([_, square], mean)| (square / count - mean * mean).max(0.0).sqrt())
                // A constant column carries no information, and must not be amplified where it does
                // vary.
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
        Ok(Self { model, head, inputs, outputs, training, validation })
    }
}

/// Progress of one training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Waiting,
    Running(Box<Checkpoint>),
    Done { network: Mlp, curve: Vec<training::Pass> },
}

/// Observes a training, and may end it.
pub trait Watch: Send {
    /// A stage of `steps` steps begins.
    fn stage(&mut self, name: &str, steps: u64);
    /// One step of the stage is done.
    fn step(&mut self, note: &str);
    /// Whether to stop at the next point where no work is lost.
    fn interrupted(&self) -> bool;
    /// All networks are trained: `progress` is worth saving before the evaluation.
    fn trained(&mut self, _progress: &Progress) {}
}

/// Progress of all networks' trainings, from which an interrupted `train` resumes.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Progress {
    /// Identifies the training: settings, vehicle and the logs' hashes.
    fingerprint: String,
    /// Half width of the window of its labels, s: a training may try several.
    window_half_s: f64,
    states: Vec<State>,
}

impl Progress {
    /// No progress yet, for `count` trainings identified by `fingerprint`.
    pub(super) fn new(fingerprint: String, window_half_s: f64, count: usize) -> Self {
        Self { fingerprint, window_half_s, states: vec![State::Waiting; count] }
    }

    /// Half width of the window of its labels, s.
    pub fn window_half_s(&self) -> f64 {
        self.window_half_s
    }

    /// Whether this belongs to `count` trainings identified by `fingerprint`.
    pub(super) fn is_of(&self, fingerprint: &str, count: usize) -> bool {
        self.fingerprint == fingerprint && self.states.len() == count
    }

    /// Trains every lesson with every regularisation, in parallel. Returns whether all are done;
    /// otherwise the watch interrupted.
    ///
    /// # Errors
    /// [`TrainError::Network`].
    pub(super) fn go_on(
        &mut self,
        lessons: &[Lesson],
        settings: &TrainSettings,
        watch: &mut dyn Watch,
    ) -> Result<bool, TrainError> {
        watch.stage("networks", (self.states.len() * settings.passes) as u64);
        let watch = Mutex::new(watch);
        let tried = settings.regularization.len();
        self.states.par_iter_mut().enumerate().try_for_each(|(index, state)| {
            // The lesson exists: `is_of` rejects progress with another count.
            let Some(lesson) = lessons.get(index / tried) else { return Ok(()) };
            let resume = match std::mem::replace(state, State::Waiting) {
                State::Waiting => None,
                State::Running(checkpoint) => Some(*checkpoint),
                State::Done { network, curve } => {
                    let inputs = lesson.training.inputs();
                    let fits = network.has_size(inputs, settings.hidden, OUTPUTS);
                    *state = State::Done { network, curve };
                    let size = training::TrainingError::Checkpoint("the network's size differs");
                    let differs = || network_error(lesson.model, lesson.head, size.to_string());
                    return fits.then_some(()).ok_or_else(differs);
                }
            };
            let settings = training::Settings {
                hidden: settings.hidden,
                passes: settings.passes,
                method: settings.method,
                regularization: settings.regularization[index % tried],
                seed: settings.seed,
                ..training::Settings::default()
            };
            let note = format!("{} {}", lesson.model.name(), lesson.head.name());
            let error = |error: training::TrainingError| {
                network_error(lesson.model, lesson.head, error.to_string())
            };
            let mut trainer = Trainer::new(&lesson.training, &lesson.validation, &settings, resume)
                .map_err(error)?;
            let stop = loop {
                // A poisoned lock means a panic elsewhere, which ends the program anyway.
                let interrupted = watch.lock().map_or(true, |watch| watch.interrupted());
                if interrupted {
                    break Stop::Interrupted;
                }
                match trainer.pass() {
                    Ok(_) => drop(watch.lock().map(|mut watch| watch.step(&note))),
                    Err(stop) => break stop,
                }
            };
            *state = if stop == Stop::Interrupted {
                State::Running(Box::new(trainer.checkpoint().clone()))
            } else {
                let training::Training { network, curve, .. } = trainer.finish(stop);
                State::Done { network, curve }
            };
            Ok(())
        })?;
        Ok(self.states.iter().all(|state| matches!(state, State::Done { .. })))
    }

    /// The best network of each lesson on validation, and every learning curve.
    pub(super) fn networks(
        self,
        lessons: Vec<Lesson>,
        regularization: &[f64],
    ) -> (Vec<Network>, Vec<LearningCurve>) {
        let (mut networks, mut curves) = (Vec::new(), Vec::new());
        let mut states = self.states.into_iter();
        for lesson in lessons {
            let mut best: Option<(f64, usize, Mlp)> = None;
            let first = curves.len();
            for weight in regularization {
                let Some(State::Done { network, curve }) = states.next() else { continue };
                let looks = curve.iter().filter_map(|pass| Some((pass.number, pass.validation?)));
                // A non-finite loss cannot be compared.
                let looks = looks.filter(|(_, loss)| loss.is_finite());
                let (best_pass, loss) =
                    looks.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY));
                if best.as_ref().is_none_or(|(least, ..)| loss < *least) {
                    best = Some((loss, curves.len(), network));
                }
                curves.push(LearningCurve {
                    model: lesson.model,
                    network: lesson.head.name().to_owned(),
                    regularization: *weight,
                    chosen: false,
                    best_pass,
                    training: curve.iter().map(|pass| pass.training).collect(),
                    validation: curve.iter().map(|pass| pass.validation).collect(),
                });
            }
            if let Some((_, chosen, mlp)) = best {
                debug_assert!(chosen >= first);
                curves[chosen].chosen = true;
                networks.push(Network { inputs: lesson.inputs, outputs: lesson.outputs, mlp });
            }
        }
        (networks, curves)
    }
}

/// Two models with two networks each, in the order of the lessons.
pub(super) fn models(networks: Vec<Network>, features: Features) -> Option<[NetworkModel; 2]> {
    let [a, b, c, d] = <[Network; NETWORKS]>::try_from(networks).ok()?;
    let model = |linear, angular| NetworkModel { features, linear, angular };
    Some([model(a, b), model(c, d)])
}

/// A watch that does nothing.
struct Unwatched;

impl Watch for Unwatched {
    fn stage(&mut self, _name: &str, _steps: u64) {}
    fn step(&mut self, _note: &str) {}
    fn interrupted(&self) -> bool {
        false
    }
}

/// Trains one model's two networks to the end; validation selects the regularisation.
///
/// # Errors
/// [`TrainError::Network`], and [`TrainError::NoRegularization`] if the list to try is empty.
pub fn train_both(
    [training, validation]: [&[&Row]; 2],
    settings: &TrainSettings,
    target: &Target<'_>,
) -> Result<NetworkModel, TrainError> {
    let (features, regularization) = (settings.features, &settings.regularization);
    let lessons = Lesson::both(ModelKind::Hybrid, features, training, validation, target)?;
    let count = lessons.len() * regularization.len();
    let mut progress = Progress::new(String::new(), settings.window_half_s, count);
    progress.go_on(&lessons, settings, &mut Unwatched)?;
    let (networks, _) = progress.networks(lessons.into(), regularization);
    let [linear, angular] =
        <[Network; 2]>::try_from(networks).map_err(|_| TrainError::NoRegularization)?;
    Ok(NetworkModel { features, linear, angular })
}

fn network_error(model: ModelKind, head: Head, reason: String) -> TrainError {
    TrainError::Network { model: model.name(), network: head.name(), reason }
}
