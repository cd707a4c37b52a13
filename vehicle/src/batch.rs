//! Many identical vehicles, stepped together: the plant as a structure of arrays.
//!
//! One branch-free loop over its lanes steps a block of vehicles. The compiler vectorises the loop
//! for each vector instruction set, and a new [`Batch`] picks the widest that the processor
//! supports. The equations come from [`Physics`], so every effect acts as in a [`Plant`]. A lane
//! near the floor is stepped separately, in scalar code.

mod lane;
mod motion;
mod width;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use self::lane::Lane;
pub use self::lane::Real;
use self::motion::{Held, LANES, Model, Motion};
pub use self::width::{Precision, Width};
use crate::battery::{Battery, PowerModel};
use crate::contact::Floor;
use crate::effects::{EffectSet, Gusts, Turbulence};
use crate::frame::{Euler, Ned};
use crate::params::{ROTORS, VehicleError, VehicleParams};
use crate::physics::{Environment, Physics};
use crate::plant::{BATTERY_STEPS, Plant, Setup};
use crate::rigid_body::{Stage, State, rk4};
use crate::rotor::Lag;

/// Vehicles with one file and one set of effects, in single (`f32`) or double precision (`f64`).
///
/// In double precision a vehicle matches a [`Plant`] with the same seed to rounding error, as long
/// as its state is finite: a batch takes the steps that [`Plant::step`] leaves out.
#[derive(Clone, Debug)]
pub struct Batch<F> {
    model: Model,
    blocks: Vec<Block<F>>,
    count: usize,
    width: Width,
    steps: u64,
}

/// Up to [`LANES`] vehicles; surplus lanes are ignored.
#[derive(Clone, Debug)]
struct Block<F> {
    motion: Motion<F>,
    held: Held<F>,
    /// The packs; empty if their voltage has no effect.
    batteries: Vec<Battery>,
    turbulence: Vec<(Turbulence, Pcg64Mcg)>,
}

impl<F: Precision> Batch<F> {
    /// Creates `count` vehicles as [`Plant::new`] does; `seed + i` seeds the gusts of vehicle i.
    ///
    /// # Errors
    /// As [`Plant::new`].
    pub fn new(
        vehicle: &VehicleParams,
        truth: &EffectSet,
        setup: &Setup,
        seed: u64,
        count: usize,
    ) -> Result<Self, VehicleError> {
        let physics = Physics::new(vehicle, truth)?;
        let battery = Battery::new(vehicle, &setup.battery);
        let gusts = vehicle.modelled_effects.overlay(truth).get::<Gusts>();
        let gusts = gusts.filter(|gusts| gusts.sigma_m_s > 0.0);
        let calm = physics.environment(battery.voltage(), Ned::zero());
        let start = State {
            position: setup.start.position_m.into(),
            attitude: Euler::new(0.0, 0.0, setup.start.heading_rad).attitude(),
            ..State::default()
        };
        let zero = [F::from_f64(0.0); LANES];
        let block = |first: usize| {
            let lanes = LANES.min(count - first);
            let mut motion = Motion {
                position: [zero; 3],
                velocity: [zero; 3],
                attitude: [zero; 4],
                body_rate: [zero; 3],
                rotors: [zero; ROTORS],
            };
            (0..LANES).for_each(|lane| motion.set_state(lane, &lane::state_from(&start)));
            let turbulence = |gusts: Gusts| {
                let draw = move |lane| {
                    let seed = seed.wrapping_add((first + lane) as u64);
                    let mut rng = Pcg64Mcg::seed_from_u64(seed);
                    (Turbulence::new(&gusts, Plant::STEP, &mut rng), rng)
                };
                (0..lanes).map(draw).collect()
            };
            let packs = if physics.depends_on_voltage() { lanes } else { 0 };
            Block {
                motion,
                held: Held {
                    outputs: [zero; ROTORS],
                    air_velocity: calm.air_velocity.to_array().map(|v| [F::from_f64(v); LANES]),
                    voltage_factor: [F::from_f64(calm.voltage_factor); LANES],
                    voltage: [F::from_f64(calm.voltage); LANES],
                    time: 0.0,
                },
                batteries: vec![battery.clone(); packs],
                turbulence: gusts.map(turbulence).unwrap_or_default(),
            }
        };
        Ok(Self {
            blocks: (0..count).step_by(LANES).map(block).collect(),
            count,
            width: Width::of_this_processor(),
            steps: 0,
            model: Model {
                lag: Lag::new(physics.constants().motor_time_constant, Plant::STEP),
                floor: Floor::new(setup.floor_down_m, physics.constants(), vehicle.gravity),
                floor_down: setup.floor_down_m,
                power: PowerModel::new(vehicle),
                physics,
            },
        })
    }

    /// Removes contact with the floor, as [`Plant::airborne`].
    pub fn airborne(mut self) -> Self {
        self.model.floor = self.model.floor.out_of_reach();
        self
    }

    /// Limits the vector instructions to at most `width`.
    pub fn at_most(mut self, width: Width) -> Self {
        self.width = self.width.min(width);
        self
    }

    /// Number of vehicles.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether the batch has no vehicles.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Name of the vector instruction set in use.
    pub fn instructions(&self) -> &'static str {
        self.width.name()
    }

    /// Advances every vehicle by `steps` steps of [`Plant::STEP`] with its motor outputs held.
    /// Clips outputs to 0..=1 and treats NaN as 0. Ignores rows without a vehicle. A block of
    /// `LANES` vehicles without any row does not advance; a vehicle without a row in another
    /// block keeps its last outputs.
    pub fn step(&mut self, outputs: &[[F; ROTORS]], steps: usize) {
        for (block, outputs) in self.blocks.iter_mut().zip(outputs.chunks(LANES)) {
            for (lane, outputs) in outputs.iter().enumerate() {
                for (held, output) in block.held.outputs.iter_mut().zip(outputs) {
                    held[lane] = F::from_f64(clipped(output.to_f64()));
                }
            }
            for step in 0..steps as u64 {
                block.step(&self.model, self.steps + step, self.width);
            }
        }
        self.steps += steps as u64;
    }

    /// The state of a vehicle; `None` if the index is out of range.
    pub fn state(&self, vehicle: usize) -> Option<State> {
        let block = self.blocks.get(vehicle / LANES).filter(|_| vehicle < self.count)?;
        Some(lane::state_of(&block.motion.state(vehicle % LANES)))
    }

    /// A vehicle's rotor states s_i, 0..=1; `None` if the index is out of range.
    pub fn rotor_states(&self, vehicle: usize) -> Option<[f64; ROTORS]> {
        let block = self.blocks.get(vehicle / LANES).filter(|_| vehicle < self.count)?;
        Some(block.motion.rotors(vehicle % LANES).map(|s| s.0.to_f64()))
    }

    /// Sets a vehicle's state and rotor states s_i, as [`Plant::set_state`] and
    /// [`Plant::set_rotor_states`]. Does nothing if the index is out of range, the state is not
    /// finite, or its quaternion is 0.
    pub fn set(&mut self, vehicle: usize, state: State, rotors: [f64; ROTORS]) {
        let state = State { attitude: state.attitude.normalized(), ..state };
        let block = self.blocks.get_mut(vehicle / LANES).filter(|_| vehicle < self.count);
        if let Some(block) = block.filter(|_| state.is_finite()) {
            let rotors = rotors.map(|s| Lane(F::from_f64(clipped(s))));
            block.motion.set_state(vehicle % LANES, &lane::state_from(&state));
            block.motion.set_rotors(vehicle % LANES, rotors);
        }
    }
}

/// Clips to 0..=1; NaN becomes 0.
#[allow(clippy::manual_clamp, reason = "`max` gives 0 for NaN")]
fn clipped(value: f64) -> f64 {
    value.max(0.0).min(1.0)
}

impl<F: Precision> Block<F> {
    fn step(&mut self, model: &Model, count: u64, width: Width) {
        let wind = model.physics.wind();
        for (lane, (turbulence, rng)) in self.turbulence.iter_mut().enumerate() {
            turbulence.advance(rng);
            let air = (wind + turbulence.velocity()).to_array();
            for (values, value) in self.held.air_velocity.iter_mut().zip(air) {
                values[lane] = F::from_f64(value);
            }
        }
        self.held.time = count as f64 * Plant::STEP;
        if count.is_multiple_of(BATTERY_STEPS) {
            self.draw_power(model);
        }
        let on_floor = self.near_floor(model);
        let before = on_floor.as_ref().map(|_| self.motion.clone());
        F::step(width, &mut self.motion, &self.held, model);
        for (lane, before) in on_floor.iter().flatten().zip(before.iter().cycle()) {
            let after = self.on_floor(model, before, *lane);
            self.motion.set_state(*lane, &lane::state_from(&after));
        }
    }

    /// The lanes whose feet may reach the floor within a step; `None` if there are none.
    fn near_floor(&self, model: &Model) -> Option<Vec<usize>> {
        let is_near = |lane: &usize| {
            let state = lane::state_of(&self.motion.state(*lane));
            !model.floor.is_clear(&state, Plant::STEP)
        };
        // A quick test that ignores attitude: the whole block is usually in the air.
        let lowest = self.motion.position[2]
            .iter()
            .fold(f64::NEG_INFINITY, |low, down| low.max(down.to_f64()));
        let fastest =
            self.motion.velocity[2].iter().fold(0.0, |fast: f64, down| fast.max(down.to_f64()));
        if model.floor.is_clear_of(lowest, fastest, Plant::STEP) {
            return None;
        }
        let near: Vec<usize> = (0..LANES).filter(is_near).collect();
        (!near.is_empty()).then_some(near)
    }

    /// One lane's state a step later, including contact with the floor.
    fn on_floor(&self, model: &Model, before: &Motion<F>, lane: usize) -> State {
        let environment = self.environment(model, lane);
        let outputs = self.held.outputs.each_ref().map(|values| values[lane].to_f64());
        let rotors = before.rotors(lane).map(|s| s.0.to_f64());
        let [middle, end] = model.lag.advance(&rotors, &outputs);
        let physics = &model.physics;
        let [start, middle, end] =
            [rotors, middle, end].map(|rotors| physics.loads(&rotors, &environment));
        let loads = if model.lag.is_none() {
            physics.sudden_loads(start, end, Plant::STEP)
        } else {
            physics.lagged_loads([start, middle, end], Plant::STEP)
        };
        rk4(&lane::state_of(&before.state(lane)), Plant::STEP, |state: &State, stage: Stage| {
            let mut wrench = physics.wrench(state, &loads[stage.index()], &environment);
            wrench += model.floor.wrench(state);
            physics.body().accelerations(state, wrench.force, wrench.moment)
        })
    }

    fn environment(&self, model: &Model, lane: usize) -> Environment {
        Environment {
            air_velocity: Ned::from(self.held.air_velocity.each_ref().map(|v| v[lane].to_f64())),
            voltage_factor: self.held.voltage_factor[lane].to_f64(),
            floor: model.floor_down,
            voltage: self.held.voltage[lane].to_f64(),
            time: self.held.time,
        }
    }

    fn draw_power(&mut self, model: &Model) {
        for lane in 0..self.batteries.len() {
            let rotors = self.motion.rotors(lane).map(|s| s.0.to_f64());
            let thrusts = model.physics.thrusts(&rotors, &self.environment(model, lane));
            let battery = &mut self.batteries[lane];
            battery.advance(model.power.power(&thrusts), BATTERY_STEPS as f64 * Plant::STEP);
            let factor = model.physics.voltage_factor(battery.voltage());
            self.held.voltage_factor[lane] = F::from_f64(factor);
            self.held.voltage[lane] = F::from_f64(battery.voltage());
        }
    }
}
