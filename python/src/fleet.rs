//! Fleets: many vehicles stepped together.

use std::sync::atomic::{AtomicBool, Ordering};

use numpy::{PyReadonlyArray1, PyReadwriteArray1};
use pyo3::prelude::*;
use rayon::prelude::*;
use vehicle::ROTORS;
use vehicle::batch::{Batch, Precision, Real};
use vehicle::plant::Setup;
use vehicle::rigid_body::State;

use crate::errors::wrong;
use crate::plant::{STATE, from_array, to_array};
use crate::vehicle::{Vehicle, effects_of};
use crate::watch::on_every_core;

/// Vehicles in a job for one core: small enough to balance the load, large enough for low overhead.
const JOB: usize = 256;
/// Number of steps, over all vehicles, above which the cores share the work.
const MANY: usize = 500_000;

/// Steps, over the vehicles of a job, between looks at the stop flag.
const LOOK_EVERY: usize = 100_000;

/// Identical vehicles, stepped together.
#[pyclass(module = "downwash._downwash")]
pub struct Fleet {
    jobs: Jobs,
}

#[derive(Clone)]
enum Jobs {
    Single(Vec<Batch<f32>>),
    Double(Vec<Batch<f64>>),
}

/// A NumPy array of numbers in either precision.
#[derive(FromPyObject)]
pub enum Numbers<'py> {
    Single(PyReadonlyArray1<'py, f32>),
    Double(PyReadonlyArray1<'py, f64>),
}

/// A writable NumPy array in either precision.
#[derive(FromPyObject)]
pub enum Room<'py> {
    Single(PyReadwriteArray1<'py, f32>),
    Double(PyReadwriteArray1<'py, f64>),
}

/// The batches of a fleet, one for each job.
pub fn batches<F: Precision>(
    vehicle: &Vehicle,
    effects: &str,
    seed: u64,
    count: usize,
    airborne: bool,
) -> PyResult<Vec<Batch<F>>> {
    let effects = effects_of(effects)?;
    let of = |first: usize| {
        let seed = seed.wrapping_add(first as u64);
        let count = JOB.min(count - first);
        let batch = Batch::new(&vehicle.file.params, &effects, &Setup::default(), seed, count)
            .map_err(|error| wrong(error.to_string()))?;
        Ok(if airborne { batch.airborne() } else { batch })
    };
    (0..count).step_by(JOB).map(of).collect()
}

/// The first four outputs; missing ones are 0.
pub fn row<F: Precision>(outputs: &[F]) -> [F; ROTORS] {
    std::array::from_fn(|rotor| outputs.get(rotor).copied().unwrap_or_default())
}

/// Writes the vehicles' states, one row for each.
pub fn write_states<F: Precision>(batch: &Batch<F>, states: &mut [F]) {
    for (index, into) in states.chunks_exact_mut(STATE).enumerate() {
        let state = batch.state(index).unwrap_or_default();
        for (into, number) in into.iter_mut().zip(to_array(&state)) {
            *into = F::from_f64(number);
        }
    }
}

/// Rollouts of vehicles from their starts through rows of outputs, each held for `every` steps.
pub struct Rolls<'a> {
    pub starts: &'a [State],
    /// Rows of four outputs, vehicle by vehicle.
    pub outputs: &'a [f64],
    /// Number of rows for each vehicle.
    pub rows: usize,
    pub every: usize,
}

/// Writes the states after each row, vehicle by vehicle.
pub fn roll(
    py: Python<'_>,
    jobs: Vec<Batch<f64>>,
    rolls: &Rolls<'_>,
    states: &mut [f64],
) -> PyResult<()> {
    let Rolls { starts, outputs, rows, every } = *rolls;
    let outputs_of = |vehicle: usize, at: usize| -> [f64; ROTORS] {
        let first = (vehicle * rows + at) * ROTORS;
        row(outputs.get(first..first + ROTORS).unwrap_or_default())
    };
    on_every_core(py, |stop| {
        let jobs = jobs.into_par_iter().zip(states.par_chunks_mut(JOB * rows * STATE)).enumerate();
        jobs.for_each(|(job, (mut batch, states))| {
            let first = job * JOB;
            for (index, start) in starts.iter().skip(first).take(batch.len()).enumerate() {
                // The rotors start as if the first outputs had been held before.
                batch.set(index, *start, outputs_of(first + index, 0));
            }
            for at in 0..rows {
                let held: Vec<_> =
                    (0..batch.len()).map(|index| outputs_of(first + index, at)).collect();
                if step_until(stop, &mut batch, &held, every).is_none() {
                    return;
                }
                for (index, states) in states.chunks_exact_mut(rows * STATE).enumerate() {
                    let state = to_array(&batch.state(index).unwrap_or_default());
                    states[at * STATE..(at + 1) * STATE].copy_from_slice(&state);
                }
            }
        });
    })
}

/// Steps a batch, unless it is stopped before the end.
fn step_until<F: Precision>(
    stop: &AtomicBool,
    batch: &mut Batch<F>,
    outputs: &[[F; ROTORS]],
    steps: usize,
) -> Option<()> {
    let most = (LOOK_EVERY / batch.len().max(1)).max(1);
    let mut left = steps;
    while left > 0 {
        if stop.load(Ordering::Relaxed) {
            return None;
        }
        let steps = left.min(most);
        batch.step(outputs, steps);
        left -= steps;
    }
    Some(())
}

fn step<F: Precision>(
    py: Python<'_>,
    jobs: &mut [Batch<F>],
    outputs: &[F],
    every: usize,
    states: &mut [F],
) -> PyResult<()> {
    let count: usize = jobs.iter().map(Batch::len).sum();
    if outputs.len() != count * ROTORS || states.len() != count * STATE {
        return Err(wrong("outputs: expected a row of four for each vehicle"));
    }
    if outputs.iter().any(|output| !output.to_f64().is_finite()) {
        return Err(wrong("outputs: expected finite numbers in 0..1"));
    }
    let one = |((batch, outputs), states): ((&mut Batch<F>, &[F]), &mut [F])| {
        let rows: Vec<[F; ROTORS]> = outputs.chunks_exact(ROTORS).map(row).collect();
        batch.step(&rows, every);
        write_states(batch, states);
    };
    if count * every < MANY {
        let outputs = outputs.chunks(JOB * ROTORS);
        jobs.iter_mut().zip(outputs).zip(states.chunks_mut(JOB * STATE)).for_each(one);
        return Ok(());
    }
    on_every_core(py, |_| {
        let outputs = outputs.par_chunks(JOB * ROTORS);
        jobs.par_iter_mut().zip(outputs).zip(states.par_chunks_mut(JOB * STATE)).for_each(one);
    })
}

fn set<F: Precision>(jobs: &mut [Batch<F>], states: &[F], rotors: &[F]) -> PyResult<()> {
    let count: usize = jobs.iter().map(Batch::len).sum();
    if states.len() != count * STATE || rotors.len() != count * ROTORS {
        return Err(wrong("state: expected 13 numbers and four rotor states for each vehicle"));
    }
    let doubles = |numbers: &[F]| numbers.iter().map(|n| n.to_f64()).collect::<Vec<f64>>();
    let states = doubles(states);
    let states = states.chunks_exact(STATE).map(from_array).collect::<PyResult<Vec<_>>>()?;
    for (index, (state, rotors)) in states.into_iter().zip(rotors.chunks_exact(ROTORS)).enumerate()
    {
        let rotors = row(rotors).map(Real::to_f64);
        if let Some(batch) = jobs.get_mut(index / JOB) {
            batch.set(index % JOB, state, rotors);
        }
    }
    Ok(())
}

#[pymethods]
impl Fleet {
    #[new]
    fn new(
        vehicle: &Vehicle,
        count: usize,
        effects: &str,
        seed: u64,
        airborne: bool,
        single: bool,
    ) -> PyResult<Self> {
        let jobs = if single {
            Jobs::Single(batches(vehicle, effects, seed, count, airborne)?)
        } else {
            Jobs::Double(batches(vehicle, effects, seed, count, airborne)?)
        };
        Ok(Self { jobs })
    }

    fn step(
        &mut self,
        py: Python<'_>,
        outputs: Numbers<'_>,
        every: usize,
        mut states: Room<'_>,
    ) -> PyResult<()> {
        match (&mut self.jobs, &outputs, &mut states) {
            (Jobs::Single(jobs), Numbers::Single(outputs), Room::Single(states)) => {
                step(py, jobs, outputs.as_slice()?, every, states.as_slice_mut()?)
            }
            (Jobs::Double(jobs), Numbers::Double(outputs), Room::Double(states)) => {
                step(py, jobs, outputs.as_slice()?, every, states.as_slice_mut()?)
            }
            _ => Err(wrong("outputs: expected the fleet's dtype")),
        }
    }

    fn copy(&self) -> Self {
        Self { jobs: self.jobs.clone() }
    }

    fn state(&self, mut states: Room<'_>) -> PyResult<()> {
        match (&self.jobs, &mut states) {
            (Jobs::Single(jobs), Room::Single(states)) => {
                let states = states.as_slice_mut()?.chunks_mut(JOB * STATE);
                jobs.iter().zip(states).for_each(|(batch, states)| write_states(batch, states));
            }
            (Jobs::Double(jobs), Room::Double(states)) => {
                let states = states.as_slice_mut()?.chunks_mut(JOB * STATE);
                jobs.iter().zip(states).for_each(|(batch, states)| write_states(batch, states));
            }
            _ => return Err(wrong("state: expected the fleet's dtype")),
        }
        Ok(())
    }

    fn set_state(&mut self, states: Numbers<'_>, rotors: Numbers<'_>) -> PyResult<()> {
        match (&mut self.jobs, &states, &rotors) {
            (Jobs::Single(jobs), Numbers::Single(states), Numbers::Single(rotors)) => {
                set(jobs, states.as_slice()?, rotors.as_slice()?)
            }
            (Jobs::Double(jobs), Numbers::Double(states), Numbers::Double(rotors)) => {
                set(jobs, states.as_slice()?, rotors.as_slice()?)
            }
            _ => Err(wrong("state: expected the fleet's dtype")),
        }
    }

    #[getter]
    fn rotor_states(&self) -> Vec<[f64; ROTORS]> {
        fn all<F: Precision>(jobs: &[Batch<F>]) -> Vec<[f64; ROTORS]> {
            let of = |batch: &Batch<F>| -> Vec<_> {
                (0..batch.len()).filter_map(|index| batch.rotor_states(index)).collect()
            };
            jobs.iter().flat_map(of).collect()
        }
        match &self.jobs {
            Jobs::Single(jobs) => all(jobs),
            Jobs::Double(jobs) => all(jobs),
        }
    }

    /// Name of the vector instruction set in use.
    #[getter]
    fn instructions(&self) -> &'static str {
        match &self.jobs {
            Jobs::Single(jobs) => jobs.first().map_or("none", Batch::instructions),
            Jobs::Double(jobs) => jobs.first().map_or("none", Batch::instructions),
        }
    }
}
