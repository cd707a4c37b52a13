//! The simulated vehicle without its autopilot, which turns motor outputs into motion.

use std::sync::atomic::{AtomicBool, Ordering};

use numpy::{PyReadonlyArray1, PyReadwriteArray1};
use pyo3::prelude::*;
use rayon::prelude::*;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::plant::Setup;
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleError};

use crate::errors::wrong;
use crate::fleet;
use crate::vehicle::{Vehicle, effects_of};
use crate::watch::on_every_core;

/// Length of a state: position, velocity, quaternion, body rate.
pub const STATE: usize = 13;

/// A simulated vehicle.
#[pyclass(module = "downwash._downwash")]
pub struct Plant {
    plant: vehicle::plant::Plant,
}

pub fn to_array(state: &State) -> [f64; STATE] {
    let [pn, pe, pd] = state.position.to_array();
    let [vn, ve, vd] = state.velocity.to_array();
    let Attitude { w, x, y, z } = state.attitude;
    let [p, q, r] = state.body_rate.to_array();
    [pn, pe, pd, vn, ve, vd, w, x, y, z, p, q, r]
}

pub fn from_array(state: &[f64]) -> PyResult<State> {
    let &[pn, pe, pd, vn, ve, vd, w, x, y, z, p, q, r] = state else {
        return Err(wrong(format!("state: expected {STATE} numbers, found {}", state.len())));
    };
    let norm2 = w * w + x * x + y * y + z * z;
    if !(state.iter().all(|number| number.is_finite()) && norm2 > 0.0 && norm2.is_finite()) {
        return Err(wrong("state: expected finite numbers and a quaternion that is not zero"));
    }
    Ok(State {
        position: Ned::new(pn, pe, pd),
        velocity: Ned::new(vn, ve, vd),
        attitude: Attitude { w, x, y, z }.normalized(),
        body_rate: Frd::new(p, q, r),
    })
}

fn new(vehicle: &Vehicle, effects: &str, seed: u64) -> PyResult<vehicle::plant::Plant> {
    let effects = effects_of(effects)?;
    let setup = Setup::default();
    vehicle::plant::Plant::new(&vehicle.file.params, &effects, &setup, seed)
        .map_err(|error| wrong(error.to_string()))
}

/// The four motor outputs of a row; missing ones are 0.
fn row(outputs: &[f64]) -> [f64; ROTORS] {
    std::array::from_fn(|rotor| outputs.get(rotor).copied().unwrap_or(0.0))
}

/// Steps between looks at the stop flag.
const LOOK_EVERY: usize = 50_000;

/// Steps through rows of outputs, each held for `every` steps, and writes the state after each row,
/// until it is stopped.
fn roll(
    plant: &mut vehicle::plant::Plant,
    outputs: &[f64],
    every: usize,
    states: &mut [f64],
    stop: &AtomicBool,
) {
    for (outputs, state) in outputs.chunks_exact(ROTORS).zip(states.chunks_exact_mut(STATE)) {
        for step in 0..every {
            if step.is_multiple_of(LOOK_EVERY) && stop.load(Ordering::Relaxed) {
                return;
            }
            plant.step(row(outputs));
        }
        state.copy_from_slice(&to_array(plant.state()));
    }
}

/// Checks the lengths of flat arrays, and that outputs are finite.
fn fits(outputs: &[f64], states: &[f64], every: usize) -> PyResult<()> {
    if every == 0 {
        return Err(wrong("steps: expected at least 1, found 0"));
    }
    if outputs.len() / ROTORS * STATE != states.len() || !outputs.len().is_multiple_of(ROTORS) {
        return Err(wrong("outputs: expected four for each state"));
    }
    if outputs.iter().any(|output| !output.is_finite()) {
        return Err(wrong("outputs: expected finite numbers in 0..1"));
    }
    Ok(())
}

#[pymethods]
impl Plant {
    /// Length of a step, s.
    #[classattr]
    const STEP_S: f64 = vehicle::plant::Plant::STEP;

    #[new]
    fn new(vehicle: &Vehicle, effects: &str, seed: u64) -> PyResult<Self> {
        Ok(Self { plant: new(vehicle, effects, seed)? })
    }

    fn step(
        &mut self,
        py: Python<'_>,
        outputs: PyReadonlyArray1<'_, f64>,
        every: usize,
        mut states: PyReadwriteArray1<'_, f64>,
    ) -> PyResult<()> {
        let (outputs, states) = (outputs.as_slice()?, states.as_slice_mut()?);
        fits(outputs, states, every)?;
        let plant = &mut self.plant;
        let never = AtomicBool::new(false);
        // A few steps take less time than releasing and reacquiring the lock.
        if outputs.len() * every < 400 {
            roll(plant, outputs, every, states, &never);
        } else {
            py.detach(|| roll(plant, outputs, every, states, &never));
        }
        Ok(())
    }

    fn state(&self, mut state: PyReadwriteArray1<'_, f64>) -> PyResult<()> {
        let state = state.as_slice_mut()?;
        if state.len() != STATE {
            return Err(wrong("state: expected 13 numbers"));
        }
        state.copy_from_slice(&to_array(self.plant.state()));
        Ok(())
    }

    fn set_state(&mut self, state: PyReadonlyArray1<'_, f64>) -> PyResult<()> {
        self.plant.set_state(from_array(state.as_slice()?)?);
        Ok(())
    }

    fn set_rotor_states(&mut self, states: PyReadonlyArray1<'_, f64>) -> PyResult<()> {
        let states = states.as_slice()?;
        if states.len() != ROTORS || states.iter().any(|state| !state.is_finite()) {
            return Err(wrong("rotor states: expected four finite numbers in 0..1"));
        }
        self.plant.set_rotor_states(row(states));
        Ok(())
    }

    #[getter]
    fn rotor_states(&self) -> [f64; ROTORS] {
        self.plant.rotor_states()
    }

    #[getter]
    fn specific_force_m_s2(&self) -> [f64; 3] {
        self.plant.specific_force().to_array()
    }

    #[getter]
    fn acceleration_m_s2(&self) -> [f64; 3] {
        self.plant.acceleration().to_array()
    }

    #[getter]
    fn angular_acceleration_rad_s2(&self) -> [f64; 3] {
        self.plant.angular_acceleration().to_array()
    }

    #[getter]
    fn air_velocity_m_s(&self) -> [f64; 3] {
        self.plant.air_velocity().to_array()
    }

    #[getter]
    fn voltage_v(&self) -> f64 {
        self.plant.voltage()
    }

    #[getter]
    fn time_s(&self) -> f64 {
        self.plant.time()
    }

    fn copy(&self) -> Self {
        Self { plant: self.plant.clone() }
    }
}

/// Simulates many vehicles at once, each from its own start through its own rows of four outputs.
/// Writes the states after each row to `states`. `seed + i` seeds the gusts of vehicle i.
#[pyfunction]
#[pyo3(signature = (vehicle, effects, seed, start, outputs, every, states, airborne))]
#[allow(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
pub fn rollouts(
    py: Python<'_>,
    vehicle: &Vehicle,
    effects: Vec<String>,
    seed: u64,
    start: PyReadonlyArray1<'_, f64>,
    outputs: PyReadonlyArray1<'_, f64>,
    every: usize,
    mut states: PyReadwriteArray1<'_, f64>,
    airborne: bool,
) -> PyResult<()> {
    let (start, outputs) = (start.as_slice()?, outputs.as_slice()?);
    let states = states.as_slice_mut()?;
    fits(outputs, states, every)?;
    let count = start.len() / STATE;
    if count == 0 || outputs.is_empty() {
        return Ok(());
    }
    if outputs.len() % (count * ROTORS) != 0 || start.len() % STATE != 0 {
        return Err(wrong("outputs: expected the same number of rows for each start"));
    }
    if effects.len() != 1 && effects.len() != count {
        return Err(wrong("effects: expected one set, or one for each start"));
    }
    let starts = start.chunks_exact(STATE).map(from_array).collect::<PyResult<Vec<_>>>()?;
    let rows = outputs.len() / count;
    if let [effects] = effects.as_slice() {
        let jobs = fleet::batches::<f64>(vehicle, effects, seed, count, airborne)?;
        let rolls = fleet::Rolls { starts: &starts, outputs, rows: rows / ROTORS, every };
        return fleet::roll(py, jobs, &rolls, states);
    }
    let sets = effects.iter().map(|effects| effects_of(effects)).collect::<PyResult<Vec<_>>>()?;
    let setup = Setup::default();
    let params = &vehicle.file.params;
    let one =
        |index: usize, start: State, outputs: &[f64], states: &mut [f64], stop: &AtomicBool| {
            let effects = sets.get(index).unwrap_or(&sets[0]);
            let seed = seed.wrapping_add(index as u64);
            let mut plant = vehicle::plant::Plant::new(params, effects, &setup, seed)?;
            if airborne {
                plant = plant.airborne();
            }
            plant.set_state(start);
            // The rotors start as if the first outputs had been held before.
            plant.set_rotor_states(row(outputs));
            roll(&mut plant, outputs, every, states, stop);
            Ok::<(), VehicleError>(())
        };
    let done = on_every_core(py, |stop| {
        let jobs = starts.into_par_iter().zip(outputs.par_chunks_exact(rows));
        let jobs = jobs.zip(states.par_chunks_exact_mut(rows / ROTORS * STATE)).enumerate();
        jobs.try_for_each(|(index, ((start, outputs), states))| {
            one(index, start, outputs, states, stop)
        })
    })?;
    done.map_err(|error| wrong(error.to_string()))
}
