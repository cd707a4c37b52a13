//! Vehicles and the catalogue of effects.

use std::path::{Path, PathBuf};

use downwash::cli::{InitArgs, LayoutChoice};
use downwash::command::{VehicleFile, make};
use pyo3::prelude::*;
use serde_json::json;
use vehicle::effects::{EffectId, EffectSet, Kind, Neutral};
use vehicle::export::Peer;

use crate::errors::{exception, unread, wrong};

/// A checked vehicle file.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Vehicle {
    pub file: VehicleFile,
}

/// Parses effects from JSON.
pub fn effects_of(text: &str) -> PyResult<EffectSet> {
    serde_json::from_str(text).map_err(|error| unread("effects", &error))
}

#[pymethods]
impl Vehicle {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let file = py.detach(|| VehicleFile::load(&path)).map_err(|e| exception(py, &e))?;
        Ok(Self { file })
    }

    #[staticmethod]
    fn parse(py: Python<'_>, text: String, name: &str) -> PyResult<Self> {
        let file = VehicleFile::parse(name, text).map_err(|e| exception(py, &e))?;
        Ok(Self { file })
    }

    /// Creates a vehicle file. Returns its text, and what is missing and estimated, as JSON.
    /// `measured` holds numbers under the names of the flags of `vehicle init`.
    #[staticmethod]
    fn init(py: Python<'_>, parameters: Option<PathBuf>, measured: &str) -> PyResult<String> {
        let measured: Measured =
            serde_json::from_str(measured).map_err(|error| unread("measured", &error))?;
        let args = measured.args(parameters)?;
        let made = py.detach(|| make(&args)).map_err(|error| exception(py, &error))?;
        serde_json::to_string(&made).map_err(|error| wrong(error.to_string()))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.file.params.name
    }

    #[getter]
    fn source(&self) -> &str {
        &self.file.name
    }

    #[getter]
    fn text(&self) -> &str {
        &self.file.text
    }

    fn to_json(&self) -> PyResult<String> {
        serde_json::to_string(&self.file.params).map_err(|error| wrong(error.to_string()))
    }

    /// Remarks on implausible numbers, as JSON.
    fn remarks(&self) -> PyResult<String> {
        serde_json::to_string(&self.file.params.remarks()).map_err(|e| wrong(e.to_string()))
    }

    fn with_effects(&self, py: Python<'_>, effects: &str) -> PyResult<Self> {
        let effects = effects_of(effects)?;
        let file = self.file.with_effects(&effects).map_err(|error| exception(py, &error))?;
        Ok(Self { file })
    }

    /// The text for another simulator, and what that simulator cannot express.
    fn export(&self, peer: &str) -> PyResult<(String, Vec<String>)> {
        let names = Peer::ALL.map(Peer::name);
        let peer = Peer::ALL.into_iter().find(|known| known.name() == peer);
        let peer = peer.ok_or_else(|| wrong(format!("to: expected one of {names:?}")))?;
        let exported = vehicle::export::export(&self.file.params, peer);
        let exported = exported.map_err(|error| wrong(error.to_string()))?;
        Ok((exported.text, exported.lost))
    }

    /// The text for a file with this name, whose extension selects the format.
    fn to_text(&self, py: Python<'_>, path: PathBuf) -> PyResult<String> {
        self.file.to_text(Path::new(&path)).map_err(|error| exception(py, &error))
    }
}

/// Arguments of `vehicle init`, by flag name.
#[derive(serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
#[derive(Default)]
struct Measured {
    name: Option<String>,
    mass_kg: Option<f64>,
    inertia_kg_m2: Vec<f64>,
    arm_m: Option<f64>,
    layout: Option<String>,
    thrust_n: Option<f64>,
    hover_throttle: Option<f64>,
    propeller_inch: Option<f64>,
    torque_ratio_m: Option<f64>,
    motor_lag_s: Option<f64>,
    cells: Option<u8>,
}

impl Measured {
    fn args(self, file: Option<PathBuf>) -> PyResult<InitArgs> {
        let layout = match self.layout.as_deref() {
            None => None,
            Some("x") => Some(LayoutChoice::X),
            Some("plus") => Some(LayoutChoice::Plus),
            Some(other) => {
                return Err(wrong(format!("layout: expected 'x' or 'plus', found {other:?}")));
            }
        };
        Ok(InitArgs {
            file,
            connect: None,
            config: None,
            system: None,
            out: None,
            force: false,
            name: self.name,
            mass: self.mass_kg,
            inertia: self.inertia_kg_m2,
            arm: self.arm_m,
            wheelbase: None,
            layout,
            thrust: self.thrust_n,
            hover_throttle: self.hover_throttle,
            propeller: self.propeller_inch,
            torque_ratio: self.torque_ratio_m,
            motor_lag: self.motor_lag_s,
            cells: self.cells,
            json: false,
        })
    }
}

/// The catalogue of effects as JSON, one row for each parameter.
#[pyfunction]
pub fn effects() -> String {
    let rows = EffectId::ALL.into_iter().flat_map(|id| {
        let about = id.about();
        let (equation, more) = match about.split_once("\n\n") {
            Some((equation, more)) => (equation.to_owned(), more.to_owned()),
            None => (about, String::new()),
        };
        id.spec().parameters.iter().map(move |parameter| {
            json!({
                "id": id.name(),
                "parameter": parameter.name,
                "unit": parameter.unit,
                "shape": match parameter.kind {
                    Kind::Scalar => "scalar",
                    Kind::Vec3 => "vector",
                    Kind::Index => "index",
                },
                "least": parameter.min,
                "most": parameter.max,
                "default": parameter.default,
                "neutral": match parameter.neutral {
                    Neutral::Value(value) => Some(value),
                    Neutral::Vehicle(_) | Neutral::None => None,
                },
                "equation": equation.replace('\n', " "),
                "about": more.replace('\n', " "),
            })
        })
    });
    serde_json::Value::from(rows.collect::<Vec<_>>()).to_string()
}
