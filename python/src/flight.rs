//! Flights of the simulated vehicle in lockstep.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use downwash::command::{Course, Simulation, Truth, configuration};
use downwash::plan::TrajectoryFile;
use numpy::{PyReadonlyArray1, PyReadwriteArray1};
use pyo3::prelude::*;
use rayon::prelude::*;
use sitl::config::SitlConfig;
use vehicle::effects::{EffectSet, Onset, Schedule};

use crate::errors::{exception, read, unread, wrong};
use crate::plan::Plan;
use crate::vehicle::{Vehicle, effects_of};
use crate::watch::watched;

/// Length of a desired point: position, velocity, acceleration, yaw, yaw rate.
const POINT: usize = 11;

/// A desired trajectory.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Trajectory {
    pub trajectory: downwash::plan::Trajectory,
    /// Content of its file, with the file's path.
    text: String,
    origin: PathBuf,
}

impl Trajectory {
    fn of(py: Python<'_>, text: String, path: PathBuf) -> PyResult<Self> {
        let trajectory = read(py, downwash::plan::Trajectory::parse(&text, &path))?;
        // Wherever it is unpickled, a path in the text means the same file.
        let origin = std::path::absolute(&path).unwrap_or(path);
        Ok(Self { trajectory, text, origin })
    }
}

/// The input of the planner: a trajectory, or a course to fly as fast as possible.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Wish {
    pub file: TrajectoryFile,
}

#[pymethods]
impl Wish {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self { file: read(py, TrajectoryFile::load(&path))? })
    }

    /// Parses the keys of a trajectory file, given as JSON.
    #[staticmethod]
    fn parse(py: Python<'_>, keys: &str, name: PathBuf) -> PyResult<Self> {
        let file = TrajectoryFile::parse(&keys_of(keys)?.to_string(), &name);
        Ok(Self { file: read(py, file)? })
    }
}

/// Parses the keys of a trajectory file from JSON.
fn keys_of(text: &str) -> PyResult<toml::Table> {
    serde_json::from_str(text).map_err(|error| unread("trajectory", &error))
}

#[pymethods]
impl Trajectory {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let text = read(py, TrajectoryFile::text(&path))?;
        Self::of(py, text, path)
    }

    /// A trajectory from its [`Trajectory::source`].
    #[staticmethod]
    fn restored(py: Python<'_>, text: String, origin: PathBuf) -> PyResult<Self> {
        Self::of(py, text, origin)
    }

    /// Parses the keys of a trajectory file, given as JSON.
    #[staticmethod]
    fn parse(py: Python<'_>, keys: &str, name: PathBuf) -> PyResult<Self> {
        Self::of(py, keys_of(keys)?.to_string(), name)
    }

    /// Content of its file, with the file's path.
    #[getter]
    fn source(&self) -> (&str, &Path) {
        (&self.text, &self.origin)
    }

    /// Whether both are the same desired motion, of one name.
    fn equals(&self, other: &Self) -> bool {
        self.trajectory == other.trajectory
    }

    #[getter]
    fn name(&self) -> &str {
        self.trajectory.name()
    }

    #[getter]
    fn duration_s(&self) -> f64 {
        self.trajectory.duration()
    }

    fn sample(
        &self,
        times: PyReadonlyArray1<'_, f64>,
        mut points: PyReadwriteArray1<'_, f64>,
    ) -> PyResult<()> {
        let (times, points) = (times.as_slice()?, points.as_slice_mut()?);
        if times.iter().any(|time| !time.is_finite()) || points.len() != times.len() * POINT {
            return Err(wrong("times: expected finite seconds"));
        }
        for (time, row) in times.iter().zip(points.chunks_exact_mut(POINT)) {
            let point = self.trajectory.sample(*time);
            let [position, velocity, acceleration] =
                [point.position, point.velocity, point.acceleration].map(|v| v.to_array());
            row[..3].copy_from_slice(&position);
            row[3..6].copy_from_slice(&velocity);
            row[6..9].copy_from_slice(&acceleration);
            row[9..].copy_from_slice(&[point.yaw, point.yaw_rate]);
        }
        Ok(())
    }
}

/// Parses settings by dotted path from JSON.
pub fn settings_of(text: &str) -> PyResult<BTreeMap<String, toml::Value>> {
    serde_json::from_str(text).map_err(|error| unread("settings", &error))
}

/// Parses onsets from JSON: pairs of a time and a set of effects.
fn onsets_of(text: &str) -> PyResult<Vec<Onset>> {
    let pairs: Vec<(f64, EffectSet)> =
        serde_json::from_str(text).map_err(|error| unread("onsets", &error))?;
    let mut schedule = Schedule::default();
    for (at_s, effects) in pairs {
        let added = schedule.add(effects, at_s);
        added.map_err(|error| wrong(format!("onsets: {error}")))?;
    }
    Ok(schedule.onsets)
}

/// Converts a trajectory or a plan to a course.
fn course(given: &Bound<'_, PyAny>) -> PyResult<Course> {
    if let Ok(plan) = given.cast::<Plan>() {
        return Ok(Course::Planned(Arc::clone(&plan.get().plan)));
    }
    let trajectory = given.cast::<Trajectory>()?;
    Ok(Course::Desired(trajectory.get().trajectory.clone()))
}

/// Flies once for each seed, `jobs` flights at once. Returns the rows of `simulate` as JSON, in the
/// order of the seeds. With `logs`, each log goes into the subfolder `seed-N`.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
pub fn fly(
    py: Python<'_>,
    vehicle: &Vehicle,
    trajectory: &Bound<'_, PyAny>,
    effects: &str,
    onsets: &str,
    settings: &str,
    config: Option<PathBuf>,
    sitl_config: Option<&str>,
    seeds: Vec<u64>,
    logs: Option<PathBuf>,
    jobs: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<String>> {
    let settings = settings_of(settings)?;
    let truth = Truth {
        effects: effects_of(effects)?,
        onsets: onsets_of(onsets)?,
        config: match sitl_config {
            Some(text) => serde_json::from_str::<SitlConfig>(text)
                .map_err(|error| unread("simulation", &error))?,
            None => SitlConfig::default(),
        },
    };
    let config =
        configuration(config.as_deref(), &settings).map_err(|error| exception(py, &error))?;
    let vehicle = vehicle.file.clone();
    let course = course(trajectory)?;
    course.check(&vehicle, &config).map_err(|error| exception(py, &error))?;
    let first = Simulation { config, vehicle, course, truth, settings, seed: 0 };
    watched(py, jobs, progress.as_ref(), move |watch| {
        let (done, of) = (AtomicU64::new(0), seeds.len() as u64);
        let one = |seed: &u64| {
            if watch.is_stopped() {
                anyhow::bail!("interrupted");
            }
            let simulation = Simulation { seed: *seed, ..first.clone() };
            let (row, _) = match &logs {
                Some(folder) => simulation.fly_logged(&folder.join(format!("seed-{seed}")), |_| {}),
                None => simulation.fly(|_| {}),
            }?;
            watch.report("flights", done.fetch_add(1, Ordering::Relaxed) + 1, of);
            Ok(serde_json::to_string(&row)?)
        };
        seeds.par_iter().map(one).collect()
    })
}
