//! Training of a network: passes, validation, early stopping, checkpoints.

use std::borrow::Cow;
use std::ops::ControlFlow;

use rand::seq::SliceRandom;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::adam::{self, Adam};
use super::objective::Objective;
use super::packed::{MOST_OUTPUTS, Shape};
use super::rprop::Rprop;
use super::samples::Samples;
use crate::model::net::Mlp;

/// Variance of the initial hidden weights, times the number of inputs. The paper's unit variance
/// leaves an error a hundred times as large after a hundred passes; small weights, with biases that
/// spread the kinks over the data, work best.
const HIDDEN_WEIGHTS: f64 = 1.0 / 6.0;
/// Variance of the initial hidden biases.
const HIDDEN_BIASES: f64 = 1.0 / 12.0;
/// Variance of the initial output weights, times the number of hidden units.
const OUTPUT_WEIGHTS: f64 = 1.0 / 3.0;

/// Adam's initial step size.
const ADAM_RATE: f64 = 1e-2;

/// The optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Resilient backpropagation over all rows, one step per pass, as in Bansal et al. 2016.
    Rprop,
    /// Adam on shuffled batches, many steps per pass; the step size falls to zero by the last pass.
    Adam,
}

/// Settings of a training.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Number of hidden units.
    pub hidden: usize,
    /// Most passes through the training rows.
    pub passes: usize,
    /// The optimiser.
    pub method: Method,
    /// gamma in the loss `(1 - gamma) MSE + gamma mean(parameters^2)`, 0 to 1.
    pub regularization: f64,
    /// Passes between two evaluations of the validation loss; the last pass always has one.
    pub validation_interval: usize,
    /// Stops after this many passes without an improvement of the validation loss.
    pub patience: usize,
    /// Random seed of the initial parameters and of the order of batches.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            hidden: 100,
            passes: 100,
            method: Method::Rprop,
            regularization: 0.0,
            validation_interval: 5,
            patience: 30,
            seed: 1,
        }
    }
}

/// One pass through the training rows.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Pass {
    /// Counted from 1.
    pub number: usize,
    /// Mean squared error over the training rows and outputs, normalised, without regularisation:
    /// for the parameters at the start of the pass (Rprop), for each batch before its step (Adam).
    pub training: f64,
    /// The same over the validation rows, for the parameters at the end of the pass, if it was
    /// computed.
    pub validation: Option<f64>,
    /// Whether this is the lowest validation loss so far.
    pub best: bool,
}

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stop {
    /// All passes are done.
    Passes,
    /// The validation loss did not improve for [`Settings::patience`] passes.
    Patience,
    /// The caller interrupted it.
    Interrupted,
    /// The loss is no longer finite.
    Diverged,
}

/// A finished training.
#[derive(Clone, Debug, PartialEq)]
pub struct Training {
    /// The network with the lowest validation loss.
    pub network: Mlp,
    /// The history of all passes.
    pub curve: Vec<Pass>,
    /// Why it ended.
    pub stop: Stop,
}

/// Why a training cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrainingError {
    /// A set has no rows.
    #[error("the {0} set has no rows")]
    Empty(&'static str),
    /// The sets have different columns.
    #[error(
        "the training set has {inputs} inputs and {outputs} targets, the validation set \
         {validation_inputs} and {validation_outputs}"
    )]
    Columns {
        /// Of the training set.
        inputs: usize,
        /// Of the training set.
        outputs: usize,
        /// Of the validation set.
        validation_inputs: usize,
        /// Of the validation set.
        validation_outputs: usize,
    },
    /// A setting or a size is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Range {
        /// The quantity.
        what: &'static str,
        /// The accepted range.
        expected: &'static str,
        /// The value found.
        found: f64,
    },
    /// The checkpoint belongs to another training.
    #[error("the checkpoint belongs to another training: {0}; train from the start")]
    Checkpoint(&'static str),
}

/// The state of a training between two passes. A training that resumes from it ends with identical
/// bits.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Checkpoint {
    settings: Settings,
    /// Fingerprints of the training and the validation rows.
    fingerprints: [u64; 2],
    parameters: Vec<f32>,
    optimizer: Optimizer,
    best: Vec<f32>,
    curve: Vec<Pass>,
}

#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Optimizer {
    Rprop(Rprop),
    Adam(Adam),
}

/// A training in progress: call [`Trainer::pass`] until it returns a [`Stop`].
pub struct Trainer<'a> {
    state: Checkpoint,
    shape: Shape,
    objective: Objective<'a>,
    validation: Objective<'a>,
    gradient: Vec<f64>,
}

impl<'a> Trainer<'a> {
    /// Starts from `resume`, or from random parameters.
    pub fn new(
        training: &'a Samples,
        validation: &'a Samples,
        settings: &Settings,
        resume: Option<Checkpoint>,
    ) -> Result<Self, TrainingError> {
        let shape = shape(training, validation, settings)?;
        let fingerprints = [training.fingerprint(), validation.fingerprint()];
        let state = match resume {
            Some(state) => continued(state, shape, settings, fingerprints)?,
            None => started(shape, settings, fingerprints),
        };
        let training = match settings.method {
            Method::Rprop => Cow::Borrowed(training),
            Method::Adam => Cow::Owned(training.shuffled(&mut Pcg64::new(settings.seed.into(), 0))),
        };
        Ok(Self {
            state,
            shape,
            objective: Objective::new(training, shape),
            validation: Objective::new(Cow::Borrowed(validation), shape),
            gradient: vec![0.0; shape.parameters()],
        })
    }

    /// Runs one pass through the training rows.
    pub fn pass(&mut self) -> Result<Pass, Stop> {
        let Checkpoint { settings, curve, .. } = &self.state;
        let best = best(curve);
        let done = curve.len();
        if done >= settings.passes {
            return Err(Stop::Passes);
        }
        if best.is_some_and(|best| done >= best.number.saturating_add(settings.patience)) {
            return Err(Stop::Patience);
        }
        if curve.last().is_some_and(|last| !last.training.is_finite()) {
            return Err(Stop::Diverged);
        }
        let number = done + 1;
        let looks = number % settings.validation_interval == 0 || number == settings.passes;
        let training = match self.state.optimizer {
            Optimizer::Rprop(_) => self.full_batch(),
            Optimizer::Adam(_) => self.batches(number),
        };
        let state = &mut self.state;
        let validation = looks.then(|| self.validation.loss(&state.parameters));
        let lowest = best.and_then(|best| best.validation).unwrap_or(f64::INFINITY);
        let improved = validation.is_some_and(|validation| validation < lowest);
        if improved {
            state.best.clone_from(&state.parameters);
        }
        let pass = Pass { number, training, validation, best: improved };
        state.curve.push(pass);
        Ok(pass)
    }

    /// The present state of the training.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.state
    }

    /// Ends the training and returns the best network.
    pub fn finish(self, stop: Stop) -> Training {
        let Checkpoint { best: lowest, parameters, curve, .. } = &self.state;
        let parameters = if best(curve).is_some() { lowest } else { parameters };
        let network = self.shape.network(parameters);
        Training { network, curve: self.state.curve, stop }
    }

    fn full_batch(&mut self) -> f64 {
        let loss = self.objective.gradient(&self.state.parameters, &mut self.gradient);
        self.step(0.0);
        loss
    }

    fn batches(&mut self, number: usize) -> f64 {
        let settings = &self.state.settings;
        let passes = settings.passes as f64;
        let mut order: Vec<usize> = (0..self.objective.batches()).collect();
        order.shuffle(&mut Pcg64::new(settings.seed.into(), number as u128));
        let mut losses = 0.0;
        let steps = order.len() as f64;
        for (step, batch) in order.into_iter().enumerate() {
            let progress = ((number - 1) as f64 + step as f64 / steps) / passes;
            losses +=
                self.objective.batch_gradient(batch, &self.state.parameters, &mut self.gradient);
            self.step(adam::rate(ADAM_RATE, progress));
        }
        losses / steps
    }

    /// One step along the gradients of loss and regularisation.
    fn step(&mut self, rate: f64) {
        let Checkpoint { settings, parameters, optimizer, .. } = &mut self.state;
        let gamma = settings.regularization;
        if gamma > 0.0 {
            let pull = 2.0 * gamma / parameters.len() as f64;
            for (derivative, parameter) in self.gradient.iter_mut().zip(parameters.iter()) {
                *derivative = (1.0 - gamma) * *derivative + pull * f64::from(*parameter);
            }
        }
        match optimizer {
            Optimizer::Rprop(rprop) => rprop.step(parameters, &self.gradient),
            Optimizer::Adam(adam) => adam.step(parameters, &self.gradient, rate),
        }
    }
}

/// The network's sizes, if sets and settings are consistent.
fn shape(
    training: &Samples,
    validation: &Samples,
    settings: &Settings,
) -> Result<Shape, TrainingError> {
    for (set, name) in [(training, "training"), (validation, "validation")] {
        if set.is_empty() {
            return Err(TrainingError::Empty(name));
        }
    }
    let (inputs, outputs) = (training.inputs(), training.outputs());
    if (inputs, outputs) != (validation.inputs(), validation.outputs()) {
        return Err(TrainingError::Columns {
            inputs,
            outputs,
            validation_inputs: validation.inputs(),
            validation_outputs: validation.outputs(),
        });
    }
    let range = |what, expected, found, within| {
        if within { Ok(()) } else { Err(TrainingError::Range { what, expected, found }) }
    };
    let Settings { hidden, regularization, validation_interval, .. } = *settings;
    range("targets", "1 to 8", outputs as f64, (1..=MOST_OUTPUTS).contains(&outputs))?;
    range("hidden units", "1 to 4096", hidden as f64, (1..=4096).contains(&hidden))?;
    let interval = validation_interval as f64;
    range("validation interval", "1 or more passes", interval, validation_interval > 0)?;
    let part = (0.0..1.0).contains(&regularization);
    range("regularization", "0 or more, below 1", regularization, part)?;
    Ok(Shape { inputs, hidden, outputs })
}

/// The state before the first pass: normal random parameters, with the variances of
/// [`HIDDEN_WEIGHTS`] and the constants next to it.
fn started(shape: Shape, settings: &Settings, fingerprints: [u64; 2]) -> Checkpoint {
    let Shape { inputs, hidden, outputs } = shape;
    let mut random = Pcg64::new(settings.seed.into(), u128::MAX);
    let mut normal = |count: usize, variance: f64| -> Vec<f32> {
        let normal = (0..count).map(|_| -> f64 { StandardNormal.sample(&mut random) });
        normal.map(|value| (variance.sqrt() * value) as f32).collect()
    };
    let mut parameters = normal(hidden * inputs, HIDDEN_WEIGHTS / inputs as f64);
    parameters.extend(normal(hidden, HIDDEN_BIASES));
    parameters.extend(normal(outputs * hidden, OUTPUT_WEIGHTS / hidden as f64));
    parameters.resize(shape.parameters(), 0.0);
    let optimizer = match settings.method {
        Method::Rprop => Optimizer::Rprop(Rprop::new(parameters.len())),
        Method::Adam => Optimizer::Adam(Adam::new(parameters.len())),
    };
    Checkpoint {
        settings: settings.clone(),
        fingerprints,
        best: parameters.clone(),
        parameters,
        optimizer,
        curve: Vec::new(),
    }
}

/// The checkpoint, if it belongs to this training.
fn continued(
    checkpoint: Checkpoint,
    shape: Shape,
    settings: &Settings,
    fingerprints: [u64; 2],
) -> Result<Checkpoint, TrainingError> {
    let size = shape.parameters();
    let remembered = match (&checkpoint.optimizer, settings.method) {
        (Optimizer::Rprop(rprop), Method::Rprop) => rprop.len(),
        (Optimizer::Adam(adam), Method::Adam) => adam.len(),
        _ => return Err(TrainingError::Checkpoint("the method differs")),
    };
    if checkpoint.settings != *settings {
        return Err(TrainingError::Checkpoint("the settings differ"));
    }
    if checkpoint.fingerprints != fingerprints {
        return Err(TrainingError::Checkpoint("the rows differ"));
    }
    if [checkpoint.parameters.len(), checkpoint.best.len(), remembered] != [size; 3] {
        return Err(TrainingError::Checkpoint("the network's size differs"));
    }
    Ok(checkpoint)
}

/// The last pass that improved the validation loss.
fn best(curve: &[Pass]) -> Option<Pass> {
    curve.iter().rev().find(|pass| pass.best).copied()
}

/// Mean squared error of `network` over rows and outputs of `samples`, in their normalised units.
///
/// # Panics
/// If the numbers of the network's inputs and outputs differ from those of the samples.
pub fn mean_squared_error(network: &Mlp, samples: &Samples) -> f64 {
    let shape = Shape { inputs: network.inputs, hidden: network.hidden, outputs: network.outputs };
    assert_eq!((shape.inputs, shape.outputs), (samples.inputs(), samples.outputs()));
    let parameters = [
        &network.hidden_weights,
        &network.hidden_biases,
        &network.output_weights,
        &network.output_biases,
    ];
    let parameters: Vec<f32> = parameters.into_iter().flatten().copied().collect();
    Objective::new(Cow::Borrowed(samples), shape).loss(&parameters)
}

/// Trains to the end. `on_pass` receives every pass, and the trainer for its checkpoint; it may
/// interrupt. Two trainings run well in parallel, on two threads of one pool.
pub fn train(
    training: &Samples,
    validation: &Samples,
    settings: &Settings,
    resume: Option<Checkpoint>,
    mut on_pass: impl FnMut(&Pass, &Trainer) -> ControlFlow<()>,
) -> Result<Training, TrainingError> {
    let mut trainer = Trainer::new(training, validation, settings, resume)?;
    let stop = loop {
        match trainer.pass() {
            Err(stop) => break stop,
            Ok(pass) if on_pass(&pass, &trainer).is_break() => break Stop::Interrupted,
            Ok(_) => {}
        }
    };
    Ok(trainer.finish(stop))
}
