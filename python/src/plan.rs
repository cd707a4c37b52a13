//! Plans: feasible references near a desired trajectory.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use downwash::command::{
    CLOSING_SHARE, PlanModel, SEARCH_SHARE, configuration, plan_fastest, plan_trajectory,
};
use downwash::plan::scp::Record;
use downwash::plan::time_optimal::Stop;
use downwash::plan::{TimeLimit, TrajectoryFile, planned};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

use crate::errors::{exception, read, wrong};
use crate::flight::{Trajectory, Wish, settings_of};
use crate::model::Model;
use crate::vehicle::Vehicle;
use crate::watch::watched;

/// A plan: states with the inputs that lead through them.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Plan {
    pub plan: Arc<planned::Plan>,
    /// Time of each passage of a course, s.
    passed_s: Option<Vec<f64>>,
}

#[pymethods]
impl Plan {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let plan = read(py, py.detach(|| planned::Plan::load(&path)))?;
        Ok(Self { plan: Arc::new(plan), passed_s: None })
    }

    /// A plan from the content of its file, and what the file does not hold.
    #[staticmethod]
    fn parse(py: Python<'_>, text: &str, passed_s: Option<Vec<f64>>) -> PyResult<Self> {
        let plan = read(py, planned::Plan::parse(text, Path::new("plan")))?;
        Ok(Self { plan: Arc::new(plan), passed_s })
    }

    fn to_json(&self) -> PyResult<String> {
        self.plan.to_json().map_err(|error| wrong(error.to_string()))
    }

    fn equals(&self, other: &Self) -> bool {
        self.plan == other.plan && self.passed_s == other.passed_s
    }

    #[getter]
    fn trajectory(&self) -> &str {
        &self.plan.trajectory
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.plan.status.text()
    }

    #[getter]
    fn cost(&self) -> f64 {
        self.plan.cost
    }

    #[getter]
    fn passed_s(&self) -> Option<Vec<f64>> {
        self.passed_s.clone()
    }

    #[getter]
    fn period_s(&self) -> f64 {
        self.plan.period_s
    }

    /// Why the plan must not be flown, if so.
    #[getter]
    fn not_flyable(&self) -> Option<String> {
        self.plan.check_flyable().err().map(|reason| reason.to_string())
    }

    fn states<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.plan.states.iter().flatten().copied().collect::<Vec<_>>().into_pyarray(py)
    }

    fn desired<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.plan.desired.iter().flatten().copied().collect::<Vec<_>>().into_pyarray(py)
    }

    fn inputs<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.plan.inputs.iter().flatten().copied().collect::<Vec<_>>().into_pyarray(py)
    }
}

/// Plans a trajectory for a vehicle, with its physics or a learned model.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
pub fn plan(
    py: Python<'_>,
    wish: &Bound<'_, PyAny>,
    vehicle: &Vehicle,
    model: Option<&Model>,
    kind: Option<&str>,
    config: Option<PathBuf>,
    settings: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Plan> {
    let settings = settings_of(settings)?;
    let config =
        configuration(config.as_deref(), &settings).map_err(|error| exception(py, &error))?;
    let vehicle = vehicle.file.params.clone();
    let wish = match wish.cast::<Trajectory>() {
        Ok(trajectory) => TrajectoryFile::Desired(trajectory.get().trajectory.clone()),
        Err(_) => wish.cast::<Wish>()?.get().file.clone(),
    };
    let plan_model = match model {
        Some(_) if matches!(wish, TrajectoryFile::Task(_)) => {
            return Err(wrong(
                "model: expected None, because the fastest plan uses the vehicle's own physics",
            ));
        }
        Some(model) => model.plan_model(py, kind)?,
        None if kind.is_some() => return Err(wrong("kind: expected None without a model")),
        None => PlanModel::nominal(&vehicle).map_err(|error| exception(py, &error))?,
    };
    let (plan, fastest) = watched(py, None, progress.as_ref(), move |watch| {
        let began = Instant::now();
        let limit = TimeLimit::new(config.settings.plan.time_limit_s);
        let ends = |records: &[Record], share: f64| {
            watch.report("subproblems", records.len() as u64, 0);
            watch.is_stopped() || limit.is_over(began.elapsed().div_f64(share))
        };
        match &wish {
            TrajectoryFile::Desired(trajectory) => {
                let ends = |records: &[Record]| ends(records, 1.0);
                let plan = plan_trajectory(trajectory, &vehicle, &plan_model, &config, &ends)?;
                Ok((plan, None))
            }
            TrajectoryFile::Task(task) => {
                let stop = Stop {
                    search: &|records| ends(records, SEARCH_SHARE),
                    closing: &|records| ends(records, CLOSING_SHARE),
                };
                let (plan, fastest) = plan_fastest(task, &vehicle, &config, stop)?;
                Ok((plan, Some(fastest)))
            }
        }
    })?;
    let passed_s = fastest.map(|fastest| fastest.passed_s().to_vec());
    Ok(Plan { plan: Arc::new(plan), passed_s })
}
