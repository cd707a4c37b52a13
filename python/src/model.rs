//! Learned models: training and evaluation.

use std::path::PathBuf;
use std::sync::Arc;

use clap::ValueEnum;
use downwash::cli::{FeatureChoice, MethodChoice, TrainArgs};
use downwash::command::{self, Learning, ModelInfo, PlanModel, Resume, evaluated, learn};
use downwash::model::file::{ModelFile, ModelKind};
use downwash::model::onnx::{self, Networks};
use downwash::model::{ACCELERATIONS, Point, VARIABLES};
use numpy::{PyReadonlyArray1, PyReadwriteArray1};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::Deserialize;

use crate::errors::{exception, read, unread, wrong};
use crate::watch::watched;

/// Length of a point's motion: velocity, body rate, roll, pitch and yaw.
const MOTION: usize = 9;
/// Length of a point's input: thrust and moments.
const INPUT: usize = VARIABLES - MOTION;

/// A loaded model file.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Model {
    file: Arc<ModelFile>,
    sha256: String,
}

impl Model {
    /// One of the file's models, for the planner.
    pub fn plan_model(&self, py: Python<'_>, kind: Option<&str>) -> PyResult<PlanModel> {
        let learned = PlanModel::learned(&self.file, self.kind(kind)?, &self.sha256);
        learned.map_err(|error| exception(py, &error))
    }

    fn kind(&self, name: Option<&str>) -> PyResult<ModelKind> {
        let Some(name) = name else { return Ok(self.file.preferred) };
        let known = ModelKind::ALL.map(ModelKind::name);
        ModelKind::ALL
            .into_iter()
            .find(|kind| kind.name() == name)
            .ok_or_else(|| wrong(format!("kind: expected {}, found {name:?}", known.join(", "))))
    }
}

#[pymethods]
impl Model {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let file = read(py, py.detach(|| ModelFile::load(&path)))?;
        let sha256 = command::sha256_of(&path).map_err(|error| exception(py, &error))?;
        Ok(Self { file: Arc::new(file), sha256 })
    }

    fn info(&self) -> PyResult<String> {
        serde_json::to_string(&ModelInfo::of(&self.file)).map_err(|e| wrong(e.to_string()))
    }

    /// The networks as the bytes of an ONNX file: those of the net, or those that the hybrid adds
    /// to the physics.
    fn to_onnx<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Bound<'py, PyBytes>> {
        let kind = named::<Networks>("kind", kind)?;
        Ok(PyBytes::new(py, &onnx::encode(&self.file, kind)))
    }

    #[getter]
    fn preferred(&self) -> &'static str {
        self.file.preferred.name()
    }

    /// Writes accelerations at points and, with `jacobians`, their derivatives.
    fn accelerations(
        &self,
        py: Python<'_>,
        motions: PyReadonlyArray1<'_, f64>,
        inputs: PyReadonlyArray1<'_, f64>,
        kind: Option<&str>,
        mut accelerations: PyReadwriteArray1<'_, f64>,
        mut jacobians: Option<PyReadwriteArray1<'_, f64>>,
    ) -> PyResult<()> {
        let (motions, inputs) = (motions.as_slice()?, inputs.as_slice()?);
        let accelerations = accelerations.as_slice_mut()?;
        let jacobians = match &mut jacobians {
            Some(jacobians) => Some(jacobians.as_slice_mut()?),
            None => None,
        };
        let count = motions.len() / MOTION;
        let lengths = [motions.len(), inputs.len(), accelerations.len()];
        let requested = jacobians.as_ref().map_or(0, |jacobians| jacobians.len());
        let expected = if jacobians.is_some() { count * ACCELERATIONS * VARIABLES } else { 0 };
        if lengths != [MOTION, INPUT, ACCELERATIONS].map(|each| each * count)
            || requested != expected
        {
            return Err(wrong("x and u: expected 9 and 4 numbers for each point"));
        }
        if !motions.iter().chain(inputs).all(|number| number.is_finite()) {
            return Err(wrong("x and u: expected finite numbers"));
        }
        let kind = self.kind(kind)?;
        let model = read(py, self.file.model(kind))?;
        py.detach(|| {
            let point = |index: usize| {
                let mut point = [0.0; VARIABLES];
                point[..MOTION].copy_from_slice(&motions[index * MOTION..][..MOTION]);
                point[MOTION..].copy_from_slice(&inputs[index * INPUT..][..INPUT]);
                Point::from_array(&point)
            };
            let rows = accelerations.chunks_exact_mut(ACCELERATIONS).enumerate();
            match jacobians {
                None => rows.for_each(|(index, row)| {
                    row.copy_from_slice(&model.accelerations(&point(index)));
                }),
                Some(jacobians) => {
                    let all = rows.zip(jacobians.chunks_exact_mut(ACCELERATIONS * VARIABLES));
                    all.for_each(|((index, row), jacobian)| {
                        let (value, slope) = model.linearize(&point(index));
                        row.copy_from_slice(&value);
                        jacobian.copy_from_slice(slope.as_flattened());
                    });
                }
            }
        });
        Ok(())
    }
}

/// Optional flags of `train`.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Training {
    features: Option<String>,
    method: Option<String>,
    hidden: Option<u16>,
    passes: Option<u32>,
    regularization: Option<Vec<f64>>,
    window_ms: Option<Vec<f64>>,
    seed: Option<u64>,
}

/// Parses the value of a flag.
fn named<T: ValueEnum>(what: &str, name: &str) -> PyResult<T> {
    T::from_str(name, false).map_err(|_| {
        let known = T::value_variants().iter().filter_map(ValueEnum::to_possible_value);
        let known: Vec<String> = known.map(|value| value.get_name().to_owned()).collect();
        wrong(format!("{what}: expected {}, found {name:?}", known.join(", ")))
    })
}

/// Trains a model and writes it to `out`. Returns the summary as JSON.
#[pyfunction]
pub fn train(
    py: Python<'_>,
    logs: Vec<PathBuf>,
    vehicle: PathBuf,
    out: PathBuf,
    mapping: Option<PathBuf>,
    settings: &str,
) -> PyResult<String> {
    let given: Training =
        serde_json::from_str(settings).map_err(|error| unread("parameters", &error))?;
    let mut args = TrainArgs::new(logs, vehicle, out);
    args.mapping = mapping;
    if let Some(name) = given.features {
        args.features = named::<FeatureChoice>("features", &name)?;
    }
    if let Some(name) = given.method {
        args.method = named::<MethodChoice>("method", &name)?;
    }
    if let Some(hidden) = given.hidden {
        if !(1..=256).contains(&hidden) {
            return Err(wrong(format!("hidden: expected 1 to 256, found {hidden}")));
        }
        args.hidden = hidden;
    }
    if let Some(passes) = given.passes {
        if passes == 0 {
            return Err(wrong("passes: expected at least 1, found 0"));
        }
        args.passes = passes;
    }
    args.regularization = given.regularization.unwrap_or(args.regularization);
    args.window = given.window_ms.unwrap_or(args.window);
    args.seed = given.seed.unwrap_or(args.seed);
    watched(py, None, None, move |watch| match learn(&args, Resume::Never, watch.stop())? {
        Learning::Done(trained) => Ok(serde_json::to_string(&trained.summary)?),
        Learning::Interrupted(_) => anyhow::bail!("interrupted"),
    })
}

/// Evaluates a model file on logs. Returns the JSON of `model eval`.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    model: PathBuf,
    logs: Vec<PathBuf>,
    mapping: Option<PathBuf>,
) -> PyResult<String> {
    watched(py, None, None, move |_| {
        let summary = evaluated(&model, &logs, None, mapping.as_deref())?;
        Ok(serde_json::to_string(&summary)?)
    })
}
