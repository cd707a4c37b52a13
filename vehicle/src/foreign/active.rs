//! A law or disturbance of [`Foreign`] acting on a plant.

use crate::effects::Wrench;
use crate::frame::{Frd, Ned};
use crate::params::ROTORS;
use crate::physics::{Loads, RotorConstants};
use crate::rigid_body::State;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

use super::Foreign;

/// Height at which [`Foreign::WindShear`] has its stated velocity, m.
const SHEAR_HEIGHT: f64 = 3.0;
/// Smallest height at which the shear is evaluated, m.
const SHEAR_HEIGHT_MIN: f64 = 0.1;

/// Smallest height of a rotor above the floor, in radii.
const GROUND_HEIGHT_MIN: f64 = 0.5;
/// Number of eddies on each axis.
const EDDIES: usize = 9;
/// Ratio of one eddy's length to the next: all lengths span a factor of 170.
const EDDY_RATIO: f64 = 1.9;

/// Separates the draws of a disturbance from the plant's own draws of the same seed.
const STREAM: u64 = 0xf0_4e16;

/// The plant at the start of a step, as seen by a [`Foreign`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surroundings<'a> {
    pub state: &'a State,
    pub rotors: &'a [RotorConstants; ROTORS],
    /// Thrust of each rotor before aerodynamic factors, N.
    pub thrusts: [f64; ROTORS],
    pub loads: &'a Loads<f64>,
    pub air_velocity: Ned,
    /// Height above the floor, m.
    pub height: f64,
    /// Terminal voltage over the full one.
    pub voltage: f64,
    pub gravity: f64,
}

/// An active [`Foreign`] with its state.
#[derive(Clone, Debug)]
pub(crate) struct Active {
    law: Foreign,
    rng: Pcg64Mcg,
    time: f64,
    wrench: Wrench<f64>,
    air: Ned,
    /// Factor on each rotor's effective state, hence on its thrust where the vehicle has no
    /// thrust_curve.
    factors: [f64; ROTORS],
    swing: Swing,
    event: Event,
    /// The rotors' states between the two lags of [`Foreign::LagSecondOrder`].
    between: [f64; ROTORS],
    slow_voltage: Option<f64>,
    eddies: Option<Eddies>,
}

/// Frozen turbulence of unit deviation: on each axis, a sum of sines whose lengths fall by a
/// constant ratio.
#[derive(Clone, Debug)]
struct Eddies([[f64; EDDIES]; 3]);

impl Eddies {
    fn new(rng: &mut Pcg64Mcg) -> Self {
        Self(std::array::from_fn(|_| std::array::from_fn(|_| TAU * rng.random::<f64>())))
    }

    /// The air's velocity, in standard deviations, after `way` lengths of the longest eddy.
    fn velocity(&self, way: f64) -> Ned {
        // In bands of equal ratio the energy goes as the length to 2/3.
        let energy = |eddy: usize| EDDY_RATIO.powf(-2.0 / 3.0 * eddy as f64);
        let total: f64 = (0..EDDIES).map(energy).sum();
        Ned::from(self.0.map(|phases| {
            let sines = phases.iter().enumerate().map(|(eddy, phase)| {
                let amplitude = (2.0 * energy(eddy) / total).sqrt();
                amplitude * (TAU * way * EDDY_RATIO.powi(eddy as i32) + phase).sin()
            });
            sines.sum::<f64>()
        }))
    }
}

/// A slung load's offset, north and east, m.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    place: [f64; 2],
    rate: [f64; 2],
    velocity: Option<Ned>,
}

/// A short event at a random time.
#[derive(Clone, Copy, Debug)]
struct Event {
    begins: f64,
    ends: f64,
    direction: Ned,
}

impl Active {
    pub fn new(law: Foreign, seed: u64) -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed ^ STREAM),
            time: 0.0,
            wrench: Wrench { force: Frd::zero(), moment: Frd::zero() },
            air: Ned::zero(),
            factors: [1.0; ROTORS],
            swing: Swing::default(),
            event: Event { begins: 0.0, ends: 0.0, direction: Ned::zero() },
            between: [0.0; ROTORS],
            slow_voltage: None,
            eddies: None,
            law,
        }
    }

    /// Force (N) and moment (N m) over this step, body axes.
    pub fn wrench(&self) -> Wrench<f64> {
        self.wrench
    }

    /// Velocity of the air in addition to the plant's own, world axes, m/s.
    pub fn air_velocity(&self) -> Ned {
        self.air
    }

    /// The effective states, which determine thrust and speed.
    pub fn bent(&self, states: &[f64; ROTORS]) -> [f64; ROTORS] {
        std::array::from_fn(|i| {
            let s = states[i];
            let bent = match self.law {
                Foreign::CurveCubic { b } => s + b * (s * s * s - s),
                Foreign::CurvePower { dead, power } => {
                    ((s - dead) / (1.0 - dead)).max(0.0).powf(power)
                }
                _ => s,
            };
            bent * self.factors[i]
        })
    }

    /// The rotors' states at the middle and end of a step, where it replaces their lag.
    pub fn follow(
        &mut self,
        states: &[f64; ROTORS],
        outputs: &[f64; ROTORS],
        step: f64,
    ) -> Option<[[f64; ROTORS]; 2]> {
        let toward =
            |from: f64, to: f64, tau: f64, time: f64| to + (from - to) * (-time / tau).exp();
        let followed = match self.law {
            Foreign::LagSecondOrder { tau_s } => {
                let before = self.between;
                for (between, output) in self.between.iter_mut().zip(outputs) {
                    *between = toward(*between, *output, tau_s, step);
                }
                let target: [f64; ROTORS] =
                    std::array::from_fn(|i| 0.5 * (before[i] + self.between[i]));
                [0.5 * step, step]
                    .map(|time| std::array::from_fn(|i| toward(states[i], target[i], tau_s, time)))
            }
            Foreign::LagAsymmetric { up_s, down_s } => [0.5 * step, step].map(|time| {
                std::array::from_fn(|i| {
                    let tau = if outputs[i] > states[i] { up_s } else { down_s };
                    toward(states[i], outputs[i], tau, time)
                })
            }),
            _ => return None,
        };
        Some(followed)
    }

    /// Resets the state of the lag to these rotor states.
    pub fn reset(&mut self, states: &[f64; ROTORS]) {
        self.between = *states;
    }

    /// Computes force, moment, air velocity and thrust factors for the next step.
    pub fn advance(&mut self, around: &Surroundings<'_>, step: f64) {
        self.time += step;
        let state = around.state;
        let to_body = |force: Ned| state.attitude.to_body(force);
        let relative = to_body(state.velocity - around.air_velocity);
        let mut force = Frd::zero();
        let mut moment = Frd::zero();
        match self.law.clone() {
            Foreign::SlungLoad { mass_kg, length_m, damping } => {
                let [n, e] = self.swing.advance(state, around.gravity / length_m, damping, step);
                force = to_body(Ned::new(mass_kg * n, mass_kg * e, 0.0));
            }
            Foreign::Payload { share } => {
                force = Frd::new(0.0, 0.0, share / (1.0 + share) * around.loads.thrust());
            }
            Foreign::Tether { anchor_m, slack_m, stiffness_n_m } => {
                let line = Ned::from(anchor_m) - state.position;
                let length = line.norm();
                if length > slack_m {
                    force = to_body(line * (stiffness_n_m * (length - slack_m) / length));
                }
            }
            Foreign::Periodic { force_n, period_s } => {
                force = to_body(Ned::from(force_n) * (TAU * self.time / period_s).sin());
            }
            Foreign::Jet { centre_m: [north, east], radius_m, force_n } => {
                let [n, e, _] = state.position.to_array();
                let distance2 = (n - north).powi(2) + (e - east).powi(2);
                let share = (-distance2 / (radius_m * radius_m)).exp();
                force = to_body(Ned::from(force_n) * share);
            }
            Foreign::Bumps { force_n, duration_s, interval_s } => {
                if self.is_in_event(duration_s, interval_s) {
                    let phase = (self.time - self.event.begins) / duration_s;
                    let size = force_n * (0.5 * TAU * phase).sin();
                    force = to_body(self.event.direction * size);
                }
            }
            Foreign::ThrustBursts { rotor, loss, duration_s, interval_s } => {
                let lost = if self.is_in_event(duration_s, interval_s) { loss } else { 0.0 };
                self.factors[rotor.min(ROTORS - 1)] = 1.0 - lost;
            }
            Foreign::YawRateForce { force_ns } => {
                let [_, _, yaw_rate] = state.body_rate.to_array();
                force = Frd::new(0.0, force_ns * yaw_rate, 0.0);
            }
            Foreign::DragPower { coefficient, exponent } => {
                let speed = relative.norm().max(1e-9);
                force = relative * (-coefficient * speed.powf(exponent - 1.0));
            }
            Foreign::DragBody { quadratic, cross } => {
                let [x, y, _] = relative.to_array();
                force = relative.scale_by(quadratic) * -relative.norm();
                force += Frd::new(0.0, 0.0, -cross * (x * x + y * y));
            }
            Foreign::GroundExponential { gain, length_m } => {
                let more = gain * (-around.height.max(0.0) / length_m).exp();
                let [roll, pitch] = around.loads.tilting_moments();
                force = Frd::new(0.0, 0.0, -more * around.loads.thrust());
                moment = Frd::new(more * roll, more * pitch, 0.0);
            }
            Foreign::SagRecovery { exponent, recovery_s } => {
                let slow = self.slow_voltage.get_or_insert(around.voltage);
                *slow += (around.voltage - *slow) * (step / recovery_s).min(1.0);
                self.factors = [slow.powf(exponent); ROTORS];
            }
            Foreign::SagAffine { slope, recovery_s } => {
                let slow = self.slow_voltage.get_or_insert(around.voltage);
                *slow += (around.voltage - *slow) * (step / recovery_s).min(1.0);
                self.factors = [(1.0 - slope * (1.0 - *slow)).max(0.0); ROTORS];
            }
            Foreign::DragPlates { quadratic } => {
                let [x, y, z] = relative.to_array();
                force = Frd::new(-x * x.abs(), -y * y.abs(), -z * z.abs()).scale_by(quadratic);
            }
            Foreign::GroundPerRotor { radius_m } => {
                for (rotor, thrust) in around.rotors.iter().zip(around.thrusts) {
                    let arm = state.attitude.to_world(Frd::new(rotor.x, rotor.y, 0.0));
                    let height = (around.height - arm.down()).max(GROUND_HEIGHT_MIN * radius_m);
                    let share = (radius_m / (4.0 * height)).powi(2);
                    let more = thrust * share / (1.0 - share);
                    force += Frd::new(0.0, 0.0, -more);
                    moment += Frd::new(-rotor.y * more, rotor.x * more, 0.0);
                }
            }
            Foreign::LiftSaturating { gain, speed_m_s } => {
                let [x, y, _] = relative.to_array();
                let speed2 = x * x + y * y;
                let more = gain * speed2 / (speed2 + speed_m_s * speed_m_s);
                let [roll, pitch] = around.loads.tilting_moments();
                force = Frd::new(0.0, 0.0, -more * around.loads.thrust());
                moment = Frd::new(more * roll, more * pitch, 0.0);
            }
            Foreign::RotorWear { rotor, loss, torque_share } => {
                let rotor = rotor.min(ROTORS - 1);
                self.factors[rotor] = 1.0 - loss;
                // `thrusts` already include the loss.
                let kept = loss * (1.0 - torque_share) / (1.0 - loss).max(1e-9);
                let torque = around.thrusts[rotor] * around.rotors[rotor].torque_per_thrust;
                moment = Frd::new(0.0, 0.0, kept * torque);
            }
            Foreign::YawTorquePower { by, apart, power, hover_n } => {
                let mut yaw = 0.0;
                for (rotor, thrust) in around.rotors.iter().zip(around.thrusts) {
                    let bent = (thrust / hover_n).max(0.0).powf(power - 1.0);
                    let factor = (1.0 + by + apart * rotor.spin) * bent;
                    yaw += thrust * rotor.torque_per_thrust * (factor - 1.0);
                }
                moment = Frd::new(0.0, 0.0, yaw);
            }
            Foreign::GustEddies { sigma_m_s, length_m, speed_m_s } => {
                let eddies = self.eddies.get_or_insert_with(|| Eddies::new(&mut self.rng));
                self.air = eddies.velocity(self.time * speed_m_s / length_m) * sigma_m_s;
            }
            Foreign::PayloadLever { drag_ns_m, sunk_m } => {
                let [x, y, _] = relative.to_array();
                moment = Frd::new(-y, x, 0.0) * (sunk_m * drag_ns_m);
            }
            Foreign::WindShear { velocity_m_s: [north, east], exponent } => {
                let height = around.height.max(SHEAR_HEIGHT_MIN) / SHEAR_HEIGHT;
                self.air = Ned::new(north, east, 0.0) * height.powf(exponent);
            }
            Foreign::LagSecondOrder { .. }
            | Foreign::LagAsymmetric { .. }
            | Foreign::CurvePower { .. }
            | Foreign::CurveCubic { .. } => {}
        }
        self.wrench = Wrench { force, moment };
    }

    /// Whether an event is in progress; draws the next one once an event has passed.
    fn is_in_event(&mut self, duration_s: f64, interval_s: f64) -> bool {
        if self.time >= self.event.ends {
            let wait: f64 = Exp1.sample(&mut self.rng);
            let begins = self.time + interval_s * wait;
            let direction: [f64; 3] =
                std::array::from_fn(|_| self.rng.sample::<f64, _>(StandardNormal));
            let direction = Ned::from(direction);
            let direction = direction * direction.norm().max(1e-9).recip();
            self.event = Event { begins, ends: begins + duration_s, direction };
        }
        self.time >= self.event.begins
    }
}

impl Swing {
    /// Advances the load, whose pendulum has the square `frequency2` of its angular frequency,
    /// 1/s^2. Returns the load's force over its mass, north and east, m/s^2.
    fn advance(&mut self, state: &State, frequency2: f64, damping: f64, step: f64) -> [f64; 2] {
        let before = self.velocity.replace(state.velocity).unwrap_or(state.velocity);
        let [n, e, _] = ((state.velocity - before) * step.recip()).to_array();
        let friction = 2.0 * damping * frequency2.sqrt();
        let acceleration = [n, e];
        std::array::from_fn(|i| {
            let (place, rate) = (&mut self.place[i], &mut self.rate[i]);
            *rate += step * (-frequency2 * *place - friction * *rate - acceleration[i]);
            *place += step * *rate;
            frequency2 * *place + acceleration[i]
        })
    }
}
