//! Flight logs of any format as arrays.

use std::path::PathBuf;

use downwash::command;
use downwash::log::import::{self, AttitudeSetpoint, Choice, Clock, Flight, Stream};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use serde_json::{Value, json};
use vehicle::frame::{Attitude, Frd, Ned};

use crate::errors::wrong;
use crate::watch::watched;

/// A logged flight.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Log {
    flight: Flight,
}

/// A stream's times, and its values in row-major order.
type Arrays<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

const NED_M: [&str; 3] = ["north_m", "east_m", "down_m"];
const NED_M_S: [&str; 3] = ["north_m_s", "east_m_s", "down_m_s"];
const QUATERNION: [&str; 4] = ["qw", "qx", "qy", "qz"];
const RATES: [&str; 3] = ["roll_rad_s", "pitch_rad_s", "yaw_rad_s"];

fn quaternion(attitude: &Attitude) -> [f64; 4] {
    [attitude.w, attitude.x, attitude.y, attitude.z]
}

fn setpoint(setpoint: &AttitudeSetpoint) -> [f64; 8] {
    let [w, x, y, z] = setpoint.attitude.as_ref().map_or([f64::NAN; 4], quaternion);
    let [p, q, r] = setpoint.body_rate.map_or([f64::NAN; 3], Frd::to_array);
    [w, x, y, z, p, q, r, setpoint.thrust.unwrap_or(f64::NAN)]
}

fn flat<const N: usize, T>(
    stream: &Stream<T>,
    row: impl Fn(&T) -> [f64; N],
) -> (Vec<f64>, Vec<f64>) {
    (stream.times().to_vec(), stream.values().iter().flat_map(row).collect())
}

#[pymethods]
impl Log {
    #[staticmethod]
    #[pyo3(signature = (path, mapping, boot, system))]
    fn read(
        py: Python<'_>,
        path: PathBuf,
        mapping: Option<PathBuf>,
        boot: Option<usize>,
        system: Option<u8>,
    ) -> PyResult<Self> {
        let flight = watched(py, None, None, move |_| {
            let choice = Choice { mapping: mapping.as_deref(), boot, system };
            Ok(import::open_chosen(&path, choice)?)
        })?;
        Ok(Self { flight })
    }

    /// Names and columns of the streams that have samples.
    #[getter]
    fn streams(&self) -> Vec<(&'static str, Vec<&'static str>)> {
        let flight = &self.flight;
        let force = ["front_m_s2", "right_m_s2", "down_m_s2"];
        let truth = [&NED_M[..], &NED_M_S, &QUATERNION, &RATES].concat();
        let all = [
            ("attitude", flight.attitude.len(), QUATERNION.to_vec()),
            ("position", flight.position.len(), NED_M.to_vec()),
            ("velocity", flight.velocity.len(), NED_M_S.to_vec()),
            ("body_rate", flight.body_rate.len(), RATES.to_vec()),
            ("specific_force", flight.specific_force.len(), force.to_vec()),
            ("outputs", flight.outputs.len(), vec!["u1", "u2", "u3", "u4"]),
            (
                "rotor_speed",
                flight.rotor_speed.len(),
                vec!["w1_rad_s", "w2_rad_s", "w3_rad_s", "w4_rad_s"],
            ),
            ("setpoint", flight.setpoint.len(), [&QUATERNION[..], &RATES, &["thrust"]].concat()),
            ("voltage", flight.voltage.len(), vec!["voltage_v"]),
            ("in_air", flight.in_air.len(), vec!["in_air"]),
            ("truth", flight.truth.len(), truth),
        ];
        let there = all.into_iter().filter(|(_, samples, _)| *samples > 0);
        there.map(|(name, _, columns)| (name, columns)).collect()
    }

    fn stream<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Arrays<'py>> {
        let flight = &self.flight;
        let (times, values) = match name {
            "attitude" => flat(&flight.attitude, quaternion),
            "position" => flat(&flight.position, |v: &Ned| v.to_array()),
            "velocity" => flat(&flight.velocity, |v: &Ned| v.to_array()),
            "body_rate" => flat(&flight.body_rate, |v: &Frd| v.to_array()),
            "specific_force" => flat(&flight.specific_force, |v: &Frd| v.to_array()),
            "outputs" => flat(&flight.outputs, |v| *v),
            "rotor_speed" => flat(&flight.rotor_speed, |v| *v),
            "setpoint" => flat(&flight.setpoint, setpoint),
            "voltage" => flat(&flight.voltage, |v| [*v]),
            "in_air" => flat(&flight.in_air, |v| [f64::from(u8::from(*v))]),
            "truth" => flat(&flight.truth, |truth| {
                let state = vehicle::rigid_body::State {
                    position: truth.position,
                    velocity: truth.velocity,
                    attitude: truth.attitude,
                    body_rate: truth.body_rate,
                };
                crate::plant::to_array(&state)
            }),
            _ => return Err(wrong(format!("a log has no stream {name:?}"))),
        };
        Ok((times.into_pyarray(py), values.into_pyarray(py)))
    }

    /// Facts about the log and its vehicle, as JSON.
    fn facts(&self) -> PyResult<String> {
        let flight = &self.flight;
        let clock = match flight.clock {
            Clock::Single => "single",
            Clock::Synchronised => "synchronised",
            Clock::LeastDelay { .. } => "least delay",
        };
        let left_out: serde_json::Map<String, Value> =
            flight.left_out.iter().map(|(what, count)| (what.clone(), (*count).into())).collect();
        let facts = json!({
            "path": flight.origin.path.display().to_string(),
            "run": flight.origin.run,
            "format": flight.origin.format,
            "sha256": flight.origin.sha256,
            "clock": clock,
            "vehicle": flight.facts,
            "has_vehicle_file": flight.vehicle_file.is_some(),
            "left_out": left_out,
        });
        Ok(facts.to_string())
    }

    /// Content of the vehicle file inside the log, if any.
    #[getter]
    fn vehicle_file(&self) -> Option<&str> {
        self.flight.vehicle_file.as_deref()
    }
}

/// Audits logs. Returns the JSON of `log audit`, and a sentence for each log that cannot be read.
#[pyfunction]
pub fn audit(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    mapping: Option<PathBuf>,
) -> PyResult<(String, Vec<String>)> {
    watched(py, None, None, move |_| {
        let (summary, refused) = command::audit(&paths, mapping.as_deref());
        Ok((serde_json::to_string(&summary)?, refused.iter().map(ToString::to_string).collect()))
    })
}
