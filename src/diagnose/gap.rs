//! How far a simulator is from flights: errors of its open-loop predictions.
//!
//! From many instants the plant predicts from the reported state, driven by the logged setpoints
//! through the on-board law (by the logged outputs where there is none), and is compared with what
//! was reported after 0.1, 0.5 and 1 s.

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::Serialize;
use sitl::autopilot::offboard::JITTER_MEAN_S;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::config::{SensorConfig, SitlConfig};
use sitl::effects::{AttitudeTrim, CommandDelay, EffectSet, EstimatorLatency, Gusts, PdGain};
use sitl::frame::{Attitude, Frd, Ned};
use sitl::plant::Plant;
use sitl::rigid_body::State;
use sitl::vehicle::{VehicleError, VehicleParams};

use super::learner::Learner;
use super::noise::{ReportNoise, gyro_bias, normals, small_rotation};
use super::onboard::setpoint_at;
use super::preparation::PreparedFlight;
use super::setpoints::as_flown;
use crate::log::import::{AttitudeSetpoint, Stream};

/// Horizons, s.
pub const HORIZONS_S: [f64; 3] = [0.1, 0.5, 1.0];
/// Quantities, each by the norm of its error.
pub const QUANTITIES: [&str; 4] = ["pos", "vel", "att", "rate"];
/// Time between the starts of windows, s.
const SPACING_S: f64 = 0.25;
/// Time before a window that delays and lags reach back to, s.
const MARGIN_S: f64 = 0.4;
/// Steps of the plant from one look of a learner to the next.
const LEARNER_STEPS: usize = 10;
/// Rotors forget their states within this many time constants.
const MEMORY: f64 = 6.0;

/// Errors of one window: of each of [`HORIZONS_S`] and [`QUANTITIES`].
pub type Window = [[f64; 4]; 3];

/// Root mean squares over windows: by horizon and quantity, in m, m/s, rad, rad/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors(pub Window);

impl Errors {
    /// The mean of position, velocity and attitude at 0.5 and 1 s, each over its noise: the
    /// metric `mean`.
    pub fn mean_over(&self, noise: &Errors) -> f64 {
        let mut sum = 0.0;
        for horizon in 1..3 {
            for quantity in 0..3 {
                let scale = noise.0[horizon][quantity].max(1e-12);
                sum += self.0[horizon][quantity] / scale;
            }
        }
        sum / 6.0
    }
}

/// What noise alone leaves of predictions.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    /// Root mean squares over windows and draws of the noise.
    pub errors: Errors,
    /// By how much the metric `mean` of one draw scatters about 1: where the body turns fast, a few
    /// windows are most of it.
    pub scatter: f64,
}

/// Draws of the noise over flights.
const FLOOR_DRAWS: u64 = 4;

/// The metric `mean` in units of what noise alone leaves.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OverNoise {
    /// The metric.
    pub gap: f64,
    /// By how much noise alone scatters it.
    pub scatter: f64,
}

/// A simulator: the vehicle file with effects put over it.
#[derive(Clone, Debug)]
pub struct Simulator {
    plant: Plant,
    law: Option<(AttitudeLoop, f64)>,
    trim: Attitude,
    latency: f64,
    command_delay: f64,
    /// Position and velocity are predicted with the body turning as reported.
    guided: bool,
    /// What is added to the plant's accelerations.
    learner: Option<Learner>,
}

impl Simulator {
    /// The vehicle with `effects` put over what its file models. `setpoint_leg`: driven by
    /// setpoints, else by outputs.
    ///
    /// # Errors
    /// A vehicle that the physics refuses.
    pub fn new(
        vehicle: &VehicleParams,
        effects: &EffectSet,
        setpoint_leg: bool,
    ) -> Result<Self, VehicleError> {
        let mut calm = effects.clone();
        // One draw of turbulence is not the one that the flight met.
        calm.remove(<Gusts as sitl::effects::Effect>::ID);
        let all = vehicle.modelled_effects.overlay(&calm);
        let law = match vehicle.attitude_pd.filter(|_| setpoint_leg) {
            Some(pd) => {
                let gains = all.get::<PdGain>().map_or(pd, |gains| gains.apply(&pd));
                Some((AttitudeLoop::new(gains, vehicle.allocation()?), pd.rate_hz))
            }
            None => None,
        };
        Ok(Self {
            plant: Plant::new(vehicle, &calm, &SitlConfig::default(), 0)?.airborne(),
            law,
            trim: all.get::<AttitudeTrim>().map_or(Attitude::default(), |trim| trim.rotation()),
            latency: all.get::<EstimatorLatency>().map_or(0.0, |e| e.latency_s),
            command_delay: all.get::<CommandDelay>().map_or(vehicle.command_delay_s, |e| e.delay_s),
            guided: false,
            learner: None,
        })
    }

    /// The same simulator, in which forces are put to the test by themselves: where logged outputs
    /// drive the plant without a loop, a small moment turns the body far within a second, and no
    /// force would show beside it.
    pub fn guided(self) -> Self {
        Self { guided: self.law.is_none(), ..self }
    }

    /// The same simulator with what a learner adds to its accelerations.
    pub fn with_learner(self, learner: Learner) -> Self {
        Self { learner: Some(learner), ..self }
    }

    /// What will be reported at `start` plus each horizon, from the reported state `from` at
    /// `start`. Latency and trim are undone at the start and applied again at the end. `None`
    /// where no setpoint rules at the start. `sensed`: the noise that the on-board loop flies with.
    fn predict(
        &self,
        flight: &PreparedFlight,
        start: f64,
        from: &State,
        mut sensed: Option<LoopNoise<'_>>,
    ) -> Option<[State; 3]> {
        let start = start - self.latency;
        let mut plant = self.plant.clone();
        let tau = plant.physics().constants().motor_time_constant;
        let memory = ((MEMORY * tau).min(MARGIN_S) / Plant::STEP).ceil() as usize;
        let delay = if self.law.is_some() { 0.0 } else { self.command_delay };
        let mut logged = flight.outputs.cursor();
        let mut voltage = flight.voltage.cursor();
        let has_voltage = flight.channels.voltage;
        let before = start - memory as f64 * Plant::STEP;
        plant.set_rotor_states(logged.at(before - delay));
        if has_voltage {
            plant.hold_voltage(voltage.at(start)[0]);
        }
        for k in 0..memory {
            let time = before + (k as f64 + 0.5) * Plant::STEP;
            plant.step(logged.at(time - delay));
        }
        let untrim = self.trim.inverse();
        plant.set_state(State { attitude: from.attitude.compose(untrim), ..*from });
        let mut forced = self.guided.then(|| plant.clone());
        let mut attitude = flight.attitude.cursor();
        let mut body_rate = flight.body_rate.cursor();
        let steps = (HORIZONS_S[2] / Plant::STEP).round() as usize;
        let mut outputs = None;
        let mut last_tick = f64::NEG_INFINITY;
        let mut reported = [State::default(); 3];
        let mut learned = (Ned::zero(), Frd::zero());
        let mut next = 0;
        for k in 0..steps {
            let time = start + k as f64 * Plant::STEP;
            let acting = match &self.law {
                None => logged.at(time + 0.5 * Plant::STEP - delay),
                Some((law, rate_hz)) => {
                    let tick = ((time + 1e-6) * rate_hz).floor();
                    if tick > last_tick || outputs.is_none() {
                        last_tick = tick;
                        let state = plant.state();
                        let mut attitude = state.attitude.compose(self.trim);
                        let mut rate = state.body_rate;
                        let mut sent = tick / rate_hz - self.command_delay;
                        if let Some(noise) = &mut sensed {
                            attitude = attitude.compose(noise.attitude_error(1.0 / rate_hz));
                            rate += noise.gyro_error();
                            // Jitter is a part of the delay.
                            sent -= noise.lateness().max(-self.command_delay);
                        }
                        let setpoints =
                            sensed.as_ref().map_or(&flight.setpoint, |s| &s.draw.setpoints);
                        let asked = setpoint_at(setpoints, sent)?;
                        outputs = Some(law.outputs(&asked, attitude.euler(), rate));
                    }
                    outputs?
                }
            };
            // The pack's voltage changes slowly against this.
            if has_voltage && k % 20 == 0 {
                plant.hold_voltage(voltage.at(time)[0]);
            }
            if let Some(forced) = &mut forced {
                if has_voltage && k % 20 == 0 {
                    forced.hold_voltage(plant.voltage());
                }
                forced.set_state(State {
                    attitude: attitude.attitude_at(time + self.latency).compose(untrim),
                    body_rate: body_rate.at(time).into(),
                    ..*forced.state()
                });
                forced.step(acting);
            }
            plant.step(acting);
            if let Some(learner) = &self.learner {
                let state = *plant.state();
                if k % LEARNER_STEPS == 0 {
                    learned = learner.accelerations(&state, acting);
                }
                let (linear, angular) = learned;
                plant.set_state(State {
                    velocity: state.velocity + linear * Plant::STEP,
                    body_rate: state.body_rate + angular * Plant::STEP,
                    ..state
                });
            }
            if k + 1 == (HORIZONS_S[next] / Plant::STEP).round() as usize {
                let state = *plant.state();
                let moved = forced.as_ref().map_or(&state, |forced| forced.state());
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

    /// Root mean square errors over the windows of flights; `None` without a window.
    pub fn errors(&self, flights: &[PreparedFlight]) -> Option<Errors> {
        root_mean_square(&self.windows(flights))
    }

    /// The errors of each window of flights, in order; not a number where one cannot be predicted.
    pub fn windows(&self, flights: &[PreparedFlight]) -> Vec<Window> {
        windows(flights, |index, start| {
            let flight = &flights[index];
            let from = reported(flight, start, self.latency);
            let predicted = self.predict(flight, start, &from, None)?;
            Some(std::array::from_fn(|h| {
                let there = reported(flight, start + HORIZONS_S[h], self.latency);
                distance(&there, &predicted[h])
            }))
        })
    }

    /// The errors that noise alone leaves: predictions from noisy starts, compared with noisy
    /// reports of what the same simulator does from the start as it was, its on-board loop flying
    /// with the sensors' noise, the gyro's bias and the link's jitter.
    pub fn floor(
        &self,
        flights: &[PreparedFlight],
        noise: &ReportNoise,
        seed: u64,
    ) -> Option<Floor> {
        let draws: Vec<_> = (0..FLOOR_DRAWS)
            .map(|draw| {
                let seed = seed.wrapping_add(draw << 32);
                let draws: Vec<NoiseDraw<'_>> = (0_u64..)
                    .zip(flights)
                    .map(|(index, flight)| {
                        let seed = seed.wrapping_add(index << 40);
                        NoiseDraw::new(noise, flight, self.trim.inverse(), seed)
                    })
                    .collect();
                windows(flights, |index, start| {
                    self.by_noise(&flights[index], start, &draws[index])
                })
            })
            .collect();
        let errors = root_mean_square(draws.iter().flatten())?;
        let of_one = draws.iter().filter_map(root_mean_square);
        let squares = of_one.map(|draw| (draw.mean_over(&errors) - 1.0).powi(2));
        let scatter = (squares.sum::<f64>() / (FLOOR_DRAWS - 1) as f64).sqrt();
        Some(Floor { errors, scatter })
    }

    /// The errors that noise alone leaves in the window of `flight` from `start`.
    fn by_noise(
        &self,
        flight: &PreparedFlight,
        start: f64,
        draw: &NoiseDraw<'_>,
    ) -> Option<Window> {
        let mut rng = Pcg64Mcg::seed_from_u64(draw.seed ^ start.to_bits());
        let bias = draw.gyro_bias;
        let truth = turning_faster(-bias, reported(flight, start, self.latency));
        let sensed = LoopNoise::new(draw, rng.random());
        let ends = self.predict(flight, start, &truth, Some(sensed))?;
        let mut report = |time: f64, state: &State| {
            let noise = draw.noise.read_at(flight, time, self.latency);
            turning_faster(bias, noise.applied(state, &mut rng))
        };
        let predicted = self.predict(flight, start, &report(start, &truth), None)?;
        Some(std::array::from_fn(|h| {
            distance(&report(start + HORIZONS_S[h], &ends[h]), &predicted[h])
        }))
    }

    /// The metric `mean` on one flight; `None` without a window.
    pub fn gap(
        &self,
        flight: &PreparedFlight,
        noise: &ReportNoise,
        seed: u64,
    ) -> Option<OverNoise> {
        let flight = std::slice::from_ref(flight);
        let Floor { errors, scatter } = self.floor(flight, noise, seed)?;
        Some(OverNoise { gap: self.errors(flight)?.mean_over(&errors), scatter })
    }
}

/// A flight as it is under one draw of its noise.
struct NoiseDraw<'a> {
    noise: &'a ReportNoise,
    /// What the gyro shows beyond the body rate.
    gyro_bias: Frd,
    /// The setpoints with a draw of those that the log lacks.
    setpoints: Stream<AttitudeSetpoint>,
    seed: u64,
}

impl<'a> NoiseDraw<'a> {
    fn new(noise: &'a ReportNoise, flight: &PreparedFlight, untrim: Attitude, seed: u64) -> Self {
        let setpoints = as_flown(&flight.setpoint, &flight.inferred, seed);
        Self { noise, gyro_bias: gyro_bias(flight, untrim), setpoints, seed }
    }
}

/// What disturbs the on-board loop: its sensors' noise, the link's jitter, and setpoints that the
/// log lacks.
struct LoopNoise<'a> {
    draw: &'a NoiseDraw<'a>,
    /// The attitude's present error about each axis, rad.
    attitude: [f64; 3],
    rng: Pcg64Mcg,
}

impl<'a> LoopNoise<'a> {
    fn new(draw: &'a NoiseDraw<'a>, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let attitude = normals(&mut rng).map(|z| draw.noise.attitude * z);
        Self { draw, attitude, rng }
    }

    /// The attitude's error `elapsed` seconds after the last one.
    fn attitude_error(&mut self, elapsed: f64) -> Attitude {
        let decay = (-elapsed / SensorConfig::ATTITUDE_CORRELATION_S).exp();
        let fresh = self.draw.noise.attitude * (1.0 - decay * decay).sqrt();
        for (error, z) in self.attitude.iter_mut().zip(normals::<3>(&mut self.rng)) {
            *error = decay * *error + fresh * z;
        }
        small_rotation(self.attitude)
    }

    /// The gyro's, rad/s.
    fn gyro_error(&mut self) -> Frd {
        let deviation = self.draw.noise.body_rate;
        self.draw.gyro_bias + Frd::from(normals(&mut self.rng).map(|z| deviation * z))
    }

    /// How much longer than on average the setpoint in force has been under way, s.
    fn lateness(&mut self) -> f64 {
        let jitter: f64 = Exp1.sample(&mut self.rng);
        JITTER_MEAN_S * (jitter - 1.0)
    }
}

/// The reported state at `time`; the body rate is not late.
fn reported(flight: &PreparedFlight, time: f64, latency: f64) -> State {
    State {
        position: flight.position.at(time).into(),
        velocity: flight.velocity.at(time).into(),
        attitude: flight.attitude.attitude_at(time),
        body_rate: flight.body_rate.at(time - latency).into(),
    }
}

/// `state` with a body rate that is larger by `rate`.
fn turning_faster(rate: Frd, state: State) -> State {
    State { body_rate: state.body_rate + rate, ..state }
}

fn distance(a: &State, b: &State) -> [f64; 4] {
    [
        (a.position - b.position).norm(),
        (a.velocity - b.velocity).norm(),
        a.attitude.angle_to(b.attitude),
        (a.body_rate - b.body_rate).norm(),
    ]
}

/// Starts of the windows of a flight.
fn starts(flight: &PreparedFlight) -> Vec<f64> {
    let channels = &flight.channels;
    if !(channels.velocity && channels.attitude && channels.body_rate) {
        return Vec::new();
    }
    let mut starts = Vec::new();
    for span in &flight.spans {
        let mut start = span.start + MARGIN_S;
        while start + HORIZONS_S[2] + 0.1 <= span.end {
            starts.push(start);
            start += SPACING_S;
        }
    }
    starts
}

/// `window` of the index of each flight and each start in it.
fn windows(
    flights: &[PreparedFlight],
    window: impl Fn(usize, f64) -> Option<Window> + Sync,
) -> Vec<Window> {
    let windows: Vec<(usize, f64)> = flights
        .iter()
        .enumerate()
        .flat_map(|(index, flight)| starts(flight).into_iter().map(move |start| (index, start)))
        .collect();
    windows
        .par_iter()
        .map(|(index, start)| window(*index, *start).unwrap_or([[f64::NAN; 4]; 3]))
        .collect()
}

fn root_mean_square<'a>(errors: impl IntoIterator<Item = &'a Window>) -> Option<Errors> {
    let finite = |e: &&Window| e.iter().flatten().all(|x| x.is_finite());
    let mut sums = [[0.0; 4]; 3];
    let mut count = 0.0;
    for error in errors.into_iter().filter(finite) {
        count += 1.0;
        for (sums, error) in sums.iter_mut().zip(error) {
            for (sum, error) in sums.iter_mut().zip(error) {
                *sum += error * error;
            }
        }
    }
    (count > 0.0).then(|| Errors(sums.map(|row| row.map(|sum: f64| (sum / count).sqrt()))))
}

/// One window counts at most so much, in squares of the floor: few windows alone do not decide.
const GAIN_MAX: f64 = 4.0;

/// How much smaller `after`'s squared errors are than `before`'s, in squares of the floor: by
/// horizon and quantity the mean over windows, and its standard error.
pub fn improvement(before: &[Window], after: &[Window], floor: &Errors) -> [[[f64; 2]; 4]; 3] {
    std::array::from_fn(|h| {
        std::array::from_fn(|q| {
            let scale = floor.0[h][q].max(1e-12).powi(-2);
            let gains: Vec<f64> = before
                .iter()
                .zip(after)
                .map(|(b, a)| (b[h][q].powi(2) - a[h][q].powi(2)) * scale)
                .map(|gain| gain.clamp(-GAIN_MAX, GAIN_MAX))
                .filter(|gain| gain.is_finite())
                .collect();
            let n = gains.len() as f64;
            if n < 2.0 {
                return [0.0, f64::INFINITY];
            }
            let mean = gains.iter().sum::<f64>() / n;
            let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0);
            // Windows that overlap count once.
            let effective = (n * SPACING_S / HORIZONS_S[2]).max(1.0);
            [mean, (variance / effective).sqrt()]
        })
    })
}
