//! The plant: the nominal vehicle with effects above a floor, integrated in fixed steps.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::battery::{Battery, BatteryConfig, PowerModel};
use crate::contact::Floor;
use crate::effects::{EffectSet, Gusts, Turbulence, Wrench};
use crate::foreign::{Active, Foreign, Surroundings};
use crate::frame::{Euler, Frd, Ned};
use crate::params::{ROTORS, VehicleError, VehicleParams};
use crate::physics::{Environment, Loads, Physics};
use crate::rigid_body::{Stage, State, midpoint, rk4};
use crate::rotor::Lag;

/// Steps between updates of the pack. 4 ms is short compared with the rotors' lag.
pub(crate) const BATTERY_STEPS: u64 = 4;

/// Where the vehicle starts, at rest and level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// Position north, east, down in m.
    pub position_m: [f64; 3],
    /// Heading from north towards east in rad.
    pub heading_rad: f64,
}

/// Initial conditions of a plant: start, floor and pack.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setup {
    /// Start of the vehicle.
    pub start: Start,
    /// Down coordinate of the floor in m.
    pub floor_down_m: f64,
    /// Capacity, resistance and initial charge of the pack.
    pub battery: BatteryConfig,
}

/// The simulated vehicle without its autopilot: it turns motor outputs into motion.
#[derive(Clone, Debug)]
pub struct Plant {
    physics: Physics,
    lag: Lag,
    floor: Floor,
    battery: Battery,
    power: PowerModel,
    turbulence: Option<(Turbulence, Pcg64Mcg)>,
    foreign: Vec<Active>,
    gravity: f64,
    full_voltage: f64,
    max_rpm: Option<f64>,
    /// Whether the midpoint rule replaces RK4 in free flight.
    is_midpoint: bool,
    /// Length of a step, us.
    step_us: u64,
    spin: [f64; ROTORS],
    state: State,
    rotors: [f64; ROTORS],
    outputs: [f64; ROTORS],
    environment: Environment,
    /// The rotors' loads at the present instant.
    loads: Loads<f64>,
    steps: u64,
    /// Time of the laws' clock when the first step begins, s.
    began: f64,
}

impl Plant {
    /// Length of a step in us, unless [midpoint](Self::midpoint) sets another.
    pub const STEP_US: u64 = 1000;
    /// The same in s.
    pub const STEP: f64 = 1e-3;

    /// A vehicle at its start, rotors at rest. `truth` adds to or overrides the file's
    /// `modelled_effects`; `seed` seeds the gusts.
    ///
    /// # Errors
    /// The vehicle's mixer cannot be inverted, or the file lacks a number that an effect needs.
    pub fn new(
        vehicle: &VehicleParams,
        truth: &EffectSet,
        setup: &Setup,
        seed: u64,
    ) -> Result<Self, VehicleError> {
        let physics = Physics::new(vehicle, truth)?;
        let battery = Battery::new(vehicle, &setup.battery);
        let mut environment = physics.environment(battery.voltage(), Ned::zero());
        environment.floor = setup.floor_down_m;
        let gusts = vehicle.modelled_effects.overlay(truth).get::<Gusts>();
        let turbulence = gusts.filter(|gusts| gusts.sigma_m_s > 0.0).map(|gusts| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            (Turbulence::new(&gusts, Self::STEP, &mut rng), rng)
        });
        let state = State {
            position: setup.start.position_m.into(),
            attitude: Euler::new(0.0, 0.0, setup.start.heading_rad).attitude(),
            ..State::default()
        };
        Ok(Self {
            lag: Lag::new(physics.constants().motor_time_constant, Self::STEP),
            floor: Floor::new(setup.floor_down_m, physics.constants(), vehicle.gravity),
            power: PowerModel::new(vehicle),
            battery,
            turbulence,
            foreign: Vec::new(),
            gravity: vehicle.gravity,
            full_voltage: vehicle.battery.full_v,
            max_rpm: vehicle.rotor_max_rpm,
            is_midpoint: false,
            step_us: Self::STEP_US,
            spin: physics.constants().rotors.map(|rotor| rotor.spin),
            loads: physics.loads(&[0.0; ROTORS], &environment),
            physics,
            state,
            rotors: [0.0; ROTORS],
            outputs: [0.0; ROTORS],
            environment,
            steps: 0,
            began: 0.0,
        })
    }

    /// Removes contact with the floor, for flights that are known to be in the air: the zero of a
    /// log's height is too uncertain for contact. Effects still see the floor.
    pub fn airborne(self) -> Self {
        Self { floor: self.floor.out_of_reach(), ..self }
    }

    /// Integrates with the midpoint rule in steps of `step_us`, us. With 1 ms it deviates from RK4 by
    /// about 1e-5 of the motion in a second, with 2 ms by four times that. It suits large numbers of
    /// flights whose noise is far above that. Gusts need steps of [`Plant::STEP`].
    pub fn midpoint(self, step_us: u64) -> Self {
        debug_assert!(self.turbulence.is_none() || step_us == Self::STEP_US, "gusts are for 1 ms");
        let mut plant = Self { is_midpoint: true, step_us, ..self };
        plant.lag = Lag::new(plant.physics.constants().motor_time_constant, plant.step_s());
        plant
    }

    /// Length of a step in us.
    pub fn step_us(&self) -> u64 {
        self.step_us
    }

    /// Length of a step in s.
    #[inline]
    pub fn step_s(&self) -> f64 {
        self.step_us as f64 * 1e-6
    }

    /// Adds a disturbance from outside the catalogue from now on; `seed` seeds its random part.
    pub fn disturb(&mut self, foreign: Foreign, seed: u64) {
        let mut active = Active::new(foreign, seed);
        active.reset(&self.rotors);
        self.foreign.push(active);
        self.loads = self.loads_of(&self.rotors);
    }

    /// Replaces the vehicle from now on; the state, the pack and the disturbances stay.
    pub fn become_vehicle(&mut self, physics: Physics) {
        self.lag = Lag::new(physics.constants().motor_time_constant, self.step_s());
        self.environment.air_velocity += physics.wind() - self.physics.wind();
        self.environment.voltage_factor = physics.voltage_factor(self.battery.voltage());
        self.physics = physics;
        self.loads = self.loads_of(&self.rotors);
    }

    /// The loads of rotors in states s_i.
    #[inline]
    fn loads_of(&self, rotors: &[f64; ROTORS]) -> Loads<f64> {
        if self.foreign.is_empty() {
            self.physics.loads(rotors, &self.environment)
        } else {
            self.physics.loads(&self.bent(rotors), &self.environment)
        }
    }

    /// The effective states, which determine thrust and speed.
    fn bent(&self, rotors: &[f64; ROTORS]) -> [f64; ROTORS] {
        self.foreign.iter().fold(*rotors, |rotors, foreign| foreign.bent(&rotors))
    }

    /// Advances the foreign disturbances. Returns the velocity of the air that they add.
    fn advance_foreign(&mut self) -> Ned {
        if self.foreign.is_empty() {
            return Ned::default();
        }
        let thrusts = self.rotor_thrusts();
        let around = Surroundings {
            rotors: &self.physics.constants().rotors,
            thrusts,
            state: &self.state,
            loads: &self.loads,
            air_velocity: self.environment.air_velocity,
            height: self.environment.floor - self.state.position.down(),
            voltage: self.battery.voltage() / self.full_voltage,
            gravity: self.gravity,
        };
        let (step, mut air_velocity) = (self.step_s(), Ned::default());
        for foreign in &mut self.foreign {
            foreign.advance(&around, step);
            air_velocity += foreign.air_velocity();
        }
        air_velocity
    }

    /// Advances by one step with the motor outputs held. Clips outputs to 0..=1 and treats
    /// NaN as 0. The state stays finite: loads that a step cannot integrate, such as those of a law
    /// that spins the body ever faster, leave it as it is.
    pub fn step(&mut self, outputs: [f64; ROTORS]) {
        // `max` gives 0 for NaN.
        #[allow(clippy::manual_clamp)]
        let outputs = outputs.map(|u| u.max(0.0).min(1.0));
        self.outputs = outputs;
        self.environment.time = self.began + self.time();
        let mut air_velocity = self.physics.wind();
        if let Some((turbulence, rng)) = &mut self.turbulence {
            turbulence.advance(rng);
            air_velocity += turbulence.velocity();
        }
        air_velocity += self.advance_foreign();
        self.environment.air_velocity = air_velocity;
        if self.steps.is_multiple_of(BATTERY_STEPS) {
            self.draw_power();
        }
        let (rotors, step) = (&self.rotors, self.step_s());
        let followed =
            self.foreign.iter_mut().find_map(|foreign| foreign.follow(rotors, &outputs, step));
        let next = if self.lag.is_none() && followed.is_none() {
            let end = self.loads_of(&outputs);
            let loads = self.physics.sudden_loads(self.loads, end, step);
            self.rotors = outputs;
            self.loads = end;
            self.integrate(&loads)
        } else {
            let [middle, end] =
                followed.unwrap_or_else(|| self.lag.advance(&self.rotors, &outputs));
            let loads = [self.loads, self.loads_of(&middle), self.loads_of(&end)];
            let loads = self.physics.lagged_loads(loads, step);
            self.rotors = end;
            self.loads = loads[2];
            self.integrate(&loads)
        };
        if next.is_finite() {
            self.state = next;
        }
        self.steps += 1;
    }

    fn draw_power(&mut self) {
        let thrusts = self.rotor_thrusts();
        self.battery.advance(self.power.power(&thrusts), BATTERY_STEPS as f64 * self.step_s());
        self.apply_voltage();
    }

    /// Applies the pack's voltage to the rotors, without a reaction on the body.
    fn apply_voltage(&mut self) {
        if self.physics.depends_on_voltage() {
            self.environment.voltage = self.battery.voltage();
            self.environment.voltage_factor = self.physics.voltage_factor(self.battery.voltage());
            self.loads = self.loads_of(&self.rotors);
        }
    }

    /// The state one step later, given the loads at the start, middle and end.
    #[inline]
    fn integrate(&self, loads: &[Loads<f64>; 3]) -> State {
        let step = self.step_s();
        if self.foreign.is_empty() && self.floor.is_clear(&self.state, step) {
            let slope = |state: &State, stage: Stage| {
                self.physics.accelerations_under(state, &loads[stage.index()], &self.environment)
            };
            if self.is_midpoint {
                midpoint(&self.state, step, slope)
            } else {
                rk4(&self.state, step, slope)
            }
        } else {
            rk4(&self.state, step, |state: &State, stage: Stage| {
                self.slope(state, &loads[stage.index()])
            })
        }
    }

    fn wrench(&self, state: &State, loads: &Loads<f64>) -> Wrench<f64> {
        let mut wrench = self.physics.wrench(state, loads, &self.environment);
        wrench += self.floor.wrench(state);
        for foreign in &self.foreign {
            wrench += foreign.wrench();
        }
        wrench
    }

    fn slope(&self, state: &State, loads: &Loads<f64>) -> (Ned, Frd) {
        let wrench = self.wrench(state, loads);
        self.physics.body().accelerations(state, wrench.force, wrench.moment)
    }

    /// The true state.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Sets the state, with the quaternion scaled to unit norm. Ignores a state that is not finite
    /// or whose quaternion is 0.
    pub fn set_state(&mut self, state: State) {
        let attitude = state.attitude.normalized();
        let state = State { attitude, ..state };
        if state.is_finite() {
            self.state = state;
        }
    }

    /// s_i: the rotors' states, 0..=1.
    pub fn rotor_states(&self) -> [f64; ROTORS] {
        self.rotors
    }

    /// Sets the rotors' states s_i, clipped to 0..=1, without a reaction on the body.
    pub fn set_rotor_states(&mut self, states: [f64; ROTORS]) {
        #[allow(clippy::manual_clamp)] // `max` gives 0 for NaN
        let states = states.map(|s| s.max(0.0).min(1.0));
        self.rotors = states;
        self.outputs = states;
        self.foreign.iter_mut().for_each(|foreign| foreign.reset(&states));
        self.loads = self.loads_of(&states);
    }

    /// Holds the pack's terminal voltage at `voltage` (V) from now on, to replay a log.
    pub fn hold_voltage(&mut self, voltage: f64) {
        self.battery.hold(voltage);
        self.apply_voltage();
    }

    /// Sets the clock that laws read to `time`, s.
    pub fn set_clock(&mut self, time: f64) {
        self.began = time - self.time();
        self.environment.time = time;
    }

    /// Drains the pack to `charge`, 0..1, at once; never raises it.
    pub fn drain(&mut self, charge: f64) {
        self.battery.drain(charge);
    }

    /// u_i: the outputs of the last step, after clipping.
    pub fn outputs(&self) -> [f64; ROTORS] {
        self.outputs
    }

    /// Thrust of each rotor before aerodynamic factors, N.
    pub fn rotor_thrusts(&self) -> [f64; ROTORS] {
        self.physics.thrusts(&self.bent(&self.rotors), &self.environment)
    }

    /// n_i: the rotors' speeds as fractions of the maximum.
    pub fn rotor_speeds(&self) -> [f64; ROTORS] {
        self.physics.rotor_speeds(&self.bent(&self.rotors), &self.environment)
    }

    /// The rotors' speeds in 1/min with the sign of `spin`, if the vehicle file has
    /// `rotor_max_rpm`.
    pub fn rpm(&self) -> Option<[f64; ROTORS]> {
        let max = self.max_rpm?;
        let speeds = self.rotor_speeds();
        Some(std::array::from_fn(|i| self.spin[i] * max * speeds[i]))
    }

    /// Reading of an ideal accelerometer at the centre of mass in body axes, m/s^2: all forces
    /// except gravity, over the mass. (0, 0, -g) at rest on a level floor.
    pub fn specific_force(&self) -> Frd {
        self.wrench(&self.state, &self.loads).force * self.physics.body().mass().recip()
    }

    /// Acceleration of the centre of mass in world axes, m/s^2.
    pub fn acceleration(&self) -> Ned {
        self.slope(&self.state, &self.loads).0
    }

    /// Angular acceleration in body axes, rad/s^2.
    pub fn angular_acceleration(&self) -> Frd {
        self.slope(&self.state, &self.loads).1
    }

    /// Velocity of the air in world axes, gusts included, m/s.
    pub fn air_velocity(&self) -> Ned {
        self.environment.air_velocity
    }

    /// The pack with its present charge, voltage and current.
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// Terminal voltage of the pack in V.
    pub fn voltage(&self) -> f64 {
        self.battery.voltage()
    }

    /// Current out of the pack in A.
    pub fn current(&self) -> f64 {
        self.battery.current()
    }

    /// Charge left in the pack, 0..=1.
    pub fn remaining(&self) -> f64 {
        self.battery.remaining()
    }

    /// Whether the vehicle touches the floor.
    pub fn on_ground(&self) -> bool {
        self.floor.touches(&self.state)
    }

    /// The constants and equations of the vehicle with its effects.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Time since the start in s.
    pub fn time(&self) -> f64 {
        self.steps as f64 * self.step_s()
    }

    /// Time since the start in whole microseconds, exact.
    pub fn time_us(&self) -> u64 {
        self.steps * self.step_us
    }
}
