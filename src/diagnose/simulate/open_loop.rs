//! Open-loop predictions of a simulator from an instant of a flight.
//!
//! The plant starts at the reported state. The logged setpoints drive it through the on-board law,
//! or the logged outputs drive it directly where no law is known.

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::JITTER_MEAN_S;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::config::SensorConfig;
use vehicle::effects::{
    AttitudeTrim, CommandDelay, Effect, EffectSet, EstimatorLatency, Gusts, PdGain,
};
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use crate::diagnose::flights::normal_draws::standard_normals;
use crate::diagnose::flights::onboard::{TICK_TOLERANCE_S, setpoint_at};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::Cursor;
use crate::diagnose::flights::setpoints::as_flown;
use crate::diagnose::likelihood::noise::{ReportNoise, gyro_bias, small_rotation};
use crate::diagnose::residual_analysis::learner::Learner;
use crate::diagnose::simulate::metric::Metric;
use crate::log::import::{AttitudeSetpoint, Stream};

/// Prediction horizons, s.
pub const HORIZONS_S: [f64; 3] = [0.1, 0.5, 1.0];
/// Time before a start that delays and lags reach back to, s.
pub(in crate::diagnose) const MARGIN_S: f64 = 0.4;
/// Steps of the plant, us; [`Plant::STEP_US`] where the ticks of the on-board loop are not multiples
/// of it.
const STEP_US: u64 = 2 * Plant::STEP_US;
/// Time between evaluations of a learner, s.
const LEARNER_S: f64 = 0.01;
/// Time between readings of the pack's voltage, which changes slowly compared with this, s.
const VOLTAGE_S: f64 = 0.02;
/// Time constants after which rotors forget their states.
const MEMORY: f64 = 6.0;

/// A simulator: the vehicle file with effects put over it.
#[derive(Clone, Debug)]
pub struct Simulator {
    plant: Plant,
    /// The on-board loop and its rate, Hz; without it, logged outputs drive the plant.
    law: Option<(AttitudeLoop, f64)>,
    /// Rotation from the true attitude to the reported one.
    trim: Attitude,
    /// Latency of the reported pose, s.
    latency: f64,
    /// Delay from sending a setpoint to its use or, without a loop, from a logged output to its
    /// thrust, s.
    command_delay: f64,
    /// The metric of its predictions. Under any other than the mean, position and velocity are
    /// predicted with the body rotating as reported.
    metric: Metric,
    /// The axes about which rotation is compared: front, right, down.
    axes: [bool; 3],
    /// Adds to the plant's accelerations.
    learner: Option<Learner>,
}

impl Simulator {
    /// The vehicle with `effects` put over those that its file models, driven by setpoints
    /// (`setpoint_leg`) or by outputs.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn new(
        vehicle: &VehicleParams,
        effects: &EffectSet,
        setpoint_leg: bool,
    ) -> Result<Self, VehicleError> {
        let all = vehicle.modelled_effects.overlay(effects);
        let law = match vehicle.attitude_pd.filter(|_| setpoint_leg) {
            Some(pd) => {
                let gains = all.get::<PdGain>().map_or(pd, |gains| gains.apply(&pd));
                Some((AttitudeLoop::new(gains, vehicle.allocation()?), pd.rate_hz))
            }
            None => None,
        };
        let fits = |(_, rate_hz): &(AttitudeLoop, f64)| {
            let steps = 1e6 / rate_hz / STEP_US as f64;
            steps >= 1.0 - 1e-9 && (steps - steps.round()).abs() < 1e-9
        };
        let step_us = if law.as_ref().is_none_or(fits) { STEP_US } else { Plant::STEP_US };
        Ok(Self {
            plant: calm_plant(vehicle, effects)?.midpoint(step_us),
            law,
            trim: all.get::<AttitudeTrim>().map_or(Attitude::default(), |trim| trim.rotation()),
            latency: all.get::<EstimatorLatency>().map_or(0.0, |e| e.latency_s),
            command_delay: all.get::<CommandDelay>().map_or(vehicle.command_delay_s, |e| e.delay_s),
            metric: Metric::Mean,
            axes: [true; 3],
            learner: None,
        })
    }

    /// The same on-board law with the plant of another vehicle and effects: a vehicle that differs
    /// from the one in its firmware.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn with_vehicle(
        self,
        vehicle: &VehicleParams,
        effects: &EffectSet,
    ) -> Result<Self, VehicleError> {
        let plant = calm_plant(vehicle, effects)?.midpoint(self.plant.step_us());
        Ok(Self { plant, ..self })
    }

    /// The same simulator with its predictions compared by `metric`, their rotation about `axes`
    /// (front, right, down).
    pub fn compared_by(self, metric: Metric, axes: [bool; 3]) -> Self {
        Self { metric, axes, ..self }
    }

    /// The same simulator with a learner's accelerations added.
    pub fn with_learner(self, learner: Learner) -> Self {
        Self { learner: Some(learner), ..self }
    }

    /// The metric of its predictions.
    pub fn metric(&self) -> Metric {
        self.metric
    }

    /// The axes about which rotation is compared: front, right, down.
    pub(in crate::diagnose) fn rotation_axes(&self) -> [bool; 3] {
        self.axes
    }

    /// Latency of the reported attitude, s.
    pub(in crate::diagnose) fn latency(&self) -> f64 {
        self.latency
    }

    /// The first start of a prediction from `start` on: at a tick of the on-board loop, which then
    /// ticks with the plant's steps.
    pub(in crate::diagnose) fn start_from(&self, start: f64) -> f64 {
        let Some((_, rate_hz)) = self.law else { return start };
        ((start - self.latency - TICK_TOLERANCE_S) * rate_hz).ceil() / rate_hz + self.latency
    }

    /// Rotation from the true attitude to the reported one.
    pub(in crate::diagnose) fn trim(&self) -> Attitude {
        self.trim
    }

    /// Predicted reports at `start` plus each horizon, from the report `from` at `start`. Latency
    /// and trim are removed at the start and applied again at the end. `None` where no setpoint is
    /// in force. `sensed` is the noise that the on-board loop flies with.
    pub(in crate::diagnose) fn predict(
        &self,
        flight: &PreparedFlight,
        start: f64,
        from: &State,
        sensed: Option<LoopNoise<'_>>,
    ) -> Option<[State; 3]> {
        let start = start - self.latency;
        let mut plant = self.plant_at(flight, start, from);
        let mut rotated =
            (self.metric != Metric::Mean).then(|| ReportedRotation::new(self, &plant, flight));
        let mut inputs = Inputs::new(self, flight, sensed);
        let mut voltage = flight.channels.voltage.then(|| flight.voltage.cursor());
        let step_s = self.plant.step_s();
        let steps_in = |time: f64| (time / step_s).round() as usize;
        let (learner_steps, voltage_steps) = (steps_in(LEARNER_S), steps_in(VOLTAGE_S));
        let mut reported = [State::default(); 3];
        let mut learned = (Ned::zero(), Frd::zero());
        let mut next = 0;
        for k in 0..steps_in(HORIZONS_S[2]) {
            let time = start + k as f64 * step_s;
            let outputs = inputs.at(time, plant.state())?;
            if let Some(voltage) = voltage.as_mut().filter(|_| k % voltage_steps == 0) {
                let [volts] = voltage.at(time);
                plant.hold_voltage(volts);
                rotated.iter_mut().for_each(|rotated| rotated.plant.hold_voltage(volts));
            }
            rotated.iter_mut().for_each(|rotated| rotated.step(time, outputs));
            plant.step(outputs);
            if let Some(learner) = &self.learner {
                if k % learner_steps == 0 {
                    learned = learner.accelerations(plant.state(), outputs);
                }
                apply_accelerations(&mut plant, learned);
                rotated
                    .iter_mut()
                    .for_each(|rotated| apply_accelerations(&mut rotated.plant, learned));
            }
            if k + 1 == steps_in(HORIZONS_S[next]) {
                let state = *plant.state();
                let moved = rotated.as_ref().map_or(&state, |rotated| rotated.plant.state());
                reported[next] = State {
                    position: moved.position,
                    velocity: moved.velocity,
                    attitude: state.attitude.compose(self.trim),
                    ..state
                };
                next += 1;
            }
        }
        Some(reported)
    }

    /// The plant in the state reported as `from`, with its rotors driven by the outputs logged
    /// until `start`.
    fn plant_at(&self, flight: &PreparedFlight, start: f64, from: &State) -> Plant {
        let (mut plant, step_s) = (self.plant.clone(), self.plant.step_s());
        let tau = plant.physics().constants().motor_time_constant;
        let memory = ((MEMORY * tau).min(MARGIN_S) / step_s).ceil() as usize;
        let before = start - memory as f64 * step_s;
        let mut logged = flight.outputs.cursor();
        plant.set_rotor_states(logged.at(before - self.output_delay()));
        if flight.channels.voltage {
            let [volts] = flight.voltage.at(start);
            plant.hold_voltage(volts);
        }
        for k in 0..memory {
            let time = before + (k as f64 + 0.5) * step_s;
            plant.step(logged.at(time - self.output_delay()));
        }
        plant.set_clock(start);
        plant.set_state(State { attitude: from.attitude.compose(self.trim.inverse()), ..*from });
        plant
    }

    /// Delay from logged outputs to their action, s; 0 where setpoints drive the loop, as the delay
    /// is then theirs.
    fn output_delay(&self) -> f64 {
        if self.law.is_some() { 0.0 } else { self.command_delay }
    }
}

/// A vehicle in the air without gusts: a draw of turbulence differs from the flight's.
fn calm_plant(vehicle: &VehicleParams, effects: &EffectSet) -> Result<Plant, VehicleError> {
    let (mut vehicle, mut effects) = (vehicle.clone(), effects.clone());
    vehicle.modelled_effects.remove(Gusts::ID);
    effects.remove(Gusts::ID);
    Ok(Plant::new(&vehicle, &effects, &Setup::default(), 0)?.airborne())
}

/// Adds a learner's accelerations over one step of the plant.
fn apply_accelerations(plant: &mut Plant, (linear, angular): (Ned, Frd)) {
    let (state, step_s) = (*plant.state(), plant.step_s());
    plant.set_state(State {
        velocity: state.velocity + linear * step_s,
        body_rate: state.body_rate + angular * step_s,
        ..state
    });
}

/// A second plant that rotates as reported under the same outputs, to isolate the forces.
struct ReportedRotation<'a> {
    plant: Plant,
    attitude: Cursor<'a, 4>,
    body_rate: Cursor<'a, 3>,
    latency: f64,
    untrim: Attitude,
}

impl<'a> ReportedRotation<'a> {
    fn new(simulator: &Simulator, plant: &Plant, flight: &'a PreparedFlight) -> Self {
        Self {
            plant: plant.clone(),
            attitude: flight.attitude.cursor(),
            body_rate: flight.body_rate.cursor(),
            latency: simulator.latency,
            untrim: simulator.trim.inverse(),
        }
    }

    /// Puts the plant into the reported rotation of `time`, and advances it by one step.
    fn step(&mut self, time: f64, outputs: [f64; ROTORS]) {
        self.plant.set_state(State {
            attitude: self.attitude.attitude_at(time + self.latency).compose(self.untrim),
            body_rate: self.body_rate.at(time).into(),
            ..*self.plant.state()
        });
        self.plant.step(outputs);
    }
}

/// Drives a plant: the logged outputs, or the on-board loop under the logged setpoints.
enum Inputs<'a> {
    Logged { outputs: Cursor<'a, ROTORS>, delay: f64 },
    Loop(Loop<'a>),
}

impl<'a> Inputs<'a> {
    fn new(
        simulator: &'a Simulator,
        flight: &'a PreparedFlight,
        sensed: Option<LoopNoise<'a>>,
    ) -> Self {
        match &simulator.law {
            None => {
                Self::Logged {
                    outputs: flight.outputs.cursor(),
                    // To the middle of a step.
                    delay: simulator.output_delay() - 0.5 * simulator.plant.step_s(),
                }
            }
            Some((law, rate_hz)) => Self::Loop(Loop {
                law,
                rate_hz: *rate_hz,
                trim: simulator.trim,
                command_delay: simulator.command_delay,
                setpoints: sensed.as_ref().map_or(&flight.setpoint, |s| &s.draw.setpoints),
                sensed,
                held: None,
            }),
        }
    }

    /// The outputs for the step from `time`, of a plant in `state`; `None` where no setpoint is in
    /// force.
    fn at(&mut self, time: f64, state: &State) -> Option<[f64; ROTORS]> {
        match self {
            Self::Logged { outputs, delay } => Some(outputs.at(time - *delay)),
            Self::Loop(onboard) => onboard.at(time, state),
        }
    }
}

/// The running on-board loop.
struct Loop<'a> {
    law: &'a AttitudeLoop,
    rate_hz: f64,
    trim: Attitude,
    command_delay: f64,
    setpoints: &'a Stream<AttitudeSetpoint>,
    sensed: Option<LoopNoise<'a>>,
    /// The last tick and its outputs.
    held: Option<(f64, [f64; ROTORS])>,
}

impl Loop<'_> {
    /// The outputs in force at `time`; `None` where no setpoint is in force.
    fn at(&mut self, time: f64, state: &State) -> Option<[f64; ROTORS]> {
        let tick = ((time + TICK_TOLERANCE_S) * self.rate_hz).floor();
        if let Some((_, outputs)) = self.held.filter(|(last, _)| tick <= *last) {
            return Some(outputs);
        }
        let mut attitude = state.attitude.compose(self.trim);
        let mut rate = state.body_rate;
        let mut sent = tick / self.rate_hz - self.command_delay;
        if let Some(noise) = &mut self.sensed {
            attitude = attitude.compose(noise.attitude_error(1.0 / self.rate_hz));
            rate += noise.gyro_error();
            // The delay includes jitter, and cannot become negative.
            sent -= noise.lateness().max(-self.command_delay);
        }
        let setpoint = setpoint_at(self.setpoints, sent)?;
        let outputs = self.law.outputs(&setpoint, attitude.euler(), rate);
        self.held = Some((tick, outputs));
        Some(outputs)
    }
}

/// The noise of a flight in one draw.
pub(in crate::diagnose) struct NoiseDraw<'a> {
    pub(in crate::diagnose) noise: &'a ReportNoise,
    /// Offset of the gyro's reading from the body rate, rad/s.
    pub(in crate::diagnose) gyro_bias: Frd,
    /// The setpoints, with a draw of those that the log lacks.
    setpoints: Stream<AttitudeSetpoint>,
    pub(in crate::diagnose) seed: u64,
}

impl<'a> NoiseDraw<'a> {
    pub(in crate::diagnose) fn new(
        noise: &'a ReportNoise,
        flight: &PreparedFlight,
        untrim: Attitude,
        seed: u64,
    ) -> Self {
        let setpoints = as_flown(&flight.setpoint, &flight.inferred, seed);
        Self { noise, gyro_bias: gyro_bias(flight, untrim), setpoints, seed }
    }
}

/// Disturbances of the on-board loop: sensor noise, link jitter, and setpoints that the log lacks.
pub(in crate::diagnose) struct LoopNoise<'a> {
    draw: &'a NoiseDraw<'a>,
    /// Current error of the attitude about each axis, rad.
    attitude: [f64; 3],
    rng: Pcg64Mcg,
}

impl<'a> LoopNoise<'a> {
    pub(in crate::diagnose) fn new(draw: &'a NoiseDraw<'a>, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let attitude = standard_normals(&mut rng).map(|z| draw.noise.attitude * z);
        Self { draw, attitude, rng }
    }

    /// The attitude's error `elapsed` seconds after the last one.
    fn attitude_error(&mut self, elapsed: f64) -> Attitude {
        let decay = (-elapsed / SensorConfig::ATTITUDE_CORRELATION_S).exp();
        let fresh = self.draw.noise.attitude * (1.0 - decay * decay).sqrt();
        for (error, z) in self.attitude.iter_mut().zip(standard_normals::<3>(&mut self.rng)) {
            *error = decay * *error + fresh * z;
        }
        small_rotation(self.attitude)
    }

    /// The gyro's error with its bias, rad/s.
    fn gyro_error(&mut self) -> Frd {
        let deviation = self.draw.noise.body_rate;
        self.draw.gyro_bias + Frd::from(standard_normals(&mut self.rng).map(|z| deviation * z))
    }

    /// Delay of the setpoint in force beyond the mean delay, s.
    fn lateness(&mut self) -> f64 {
        let jitter: f64 = Exp1.sample(&mut self.rng);
        JITTER_MEAN_S * (jitter - 1.0)
    }
}
