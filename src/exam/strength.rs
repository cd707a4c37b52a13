//! The strength of a difference between the true and the nominal vehicle: the prediction error of
//! the nominal simulator due to it, divided by the error from noise alone for predictions that
//! start from single samples.
//!
//! This is the signal-to-noise ratio for judging detection. It is computed from true states, never
//! from a log, with the plant alone and without any code of the diagnosis.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::AttitudeSetpoint;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::config::SensorConfig;
use vehicle::effects::{AttitudeTrim, CommandDelay, EffectSet, EstimatorLatency, PdGain};
use vehicle::foreign::Foreign;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;
use vehicle::rotor::Lag;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::flight::Track;

/// Horizons, in steps of a millisecond.
const HORIZONS: [usize; 3] = [100, 500, 1000];
/// Steps between the starts of windows.
const SPACING: usize = 500;
/// As above where a file's numbers are moved, one after the other.
const SPARSE: usize = 1_000;
/// Steps between readings of the pack's voltage.
const VOLTAGE_STEPS: usize = 20;
/// Most rounds of coordinate descent: similar columns converge slowly.
const SWEEPS: usize = 500;
const MARGIN: usize = 400;
/// Position, velocity, attitude and body rate, three axes each.
const CHANNELS: usize = 12;
const NAMES: [&str; CHANNELS] = [
    "pos_x", "pos_y", "pos_z", "vel_x", "vel_y", "vel_z", "att_x", "att_y", "att_z", "rate_x",
    "rate_y", "rate_z",
];

/// Least strength at which an answer should name an effect, with an exact vehicle file.
pub const DETECTABLE: f64 = 2.0;

/// Errors or sums of their squares, by horizon and channel.
type Table = [[f64; CHANNELS]; HORIZONS.len()];

/// A strength with the channel where it is largest.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Strength {
    /// RMS error from the difference, relative to that from noise.
    pub ratio: f64,
    /// Channel and horizon of the largest ratio.
    pub channel: String,
}

impl Strength {
    /// The strength of no difference.
    pub fn none() -> Self {
        Self { ratio: 0.0, channel: String::new() }
    }
}

/// Prediction errors of a simulator over some flights.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Errors of each window.
    window_errors: Vec<Table>,
    noise: Table,
}

/// A table from a function of horizon and channel.
fn each(element: impl Fn(usize, usize) -> f64) -> Table {
    std::array::from_fn(|place| std::array::from_fn(|channel| element(place, channel)))
}

/// Mean squares of errors over windows.
fn mean_squares(errors: &[Table]) -> Table {
    each(|place, channel| {
        let squares = errors.iter().map(|error| error[place][channel].powi(2));
        squares.sum::<f64>() / errors.len().max(1) as f64
    })
}

/// The largest RMS error beyond `without`, relative to the noise; all three are mean squares.
fn strongest(total: &Table, without: &Table, noise: &Table) -> Strength {
    let mut best = Strength::none();
    for (place, horizon) in HORIZONS.iter().enumerate() {
        for (channel, name) in NAMES.iter().enumerate() {
            let excess = total[place][channel] - without[place][channel];
            let noise = (noise[place][channel] + without[place][channel]).max(1e-30);
            let ratio = (excess.max(0.0) / noise).sqrt();
            if ratio > best.ratio {
                let channel = format!("{name}@{}s", *horizon as f64 * 1e-3);
                best = Strength { ratio, channel };
            }
        }
    }
    best
}

impl Errors {
    fn noise(&self) -> Table {
        let count = self.window_errors.len().max(1) as f64;
        each(|place, channel| self.noise[place][channel] / count)
    }

    /// The strength of these errors beyond those of the vehicle without the difference, which come
    /// from the link's jitter and slowly logged outputs.
    pub fn strength(&self, without: &Errors) -> Strength {
        strongest(
            &mean_squares(&self.window_errors),
            &mean_squares(&without.window_errors),
            &self.noise(),
        )
    }
}

/// The vehicle that makes predictions.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// The vehicle as the firmware knows it: loop and mixer.
    pub believed: &'a VehicleParams,
    /// The vehicle's real numbers.
    pub body: &'a VehicleParams,
    /// Effects beyond those numbers.
    pub effects: &'a EffectSet,
    /// Effects outside the catalogue.
    pub foreign: &'a [Foreign],
    /// Trim of the attitude that the loop flies with.
    pub trim: Attitude,
    /// Rate of the logged outputs that predictions follow, Hz; `None` with a known loop.
    pub outputs_hz: Option<f64>,
}

/// Predicts with a model of the vehicle.
#[derive(Clone, Debug)]
pub struct Predictor {
    plant: Plant,
    /// The loop with its rate, Hz.
    law: Option<(AttitudeLoop, f64)>,
    trim: Attitude,
    /// Steps between logged outputs.
    outputs_steps: usize,
    delay_s: f64,
    lag: Lag,
    noise: SensorConfig,
}

/// A number of a vehicle file, moved by one tolerance.
#[derive(Clone, Debug)]
pub struct Moved {
    predictor: Predictor,
    /// Trim and pose latency that belong to the move.
    trim: Attitude,
    latency_s: f64,
    /// Most tolerances that it may move by.
    most: f64,
}

impl Moved {
    /// A move whose predictions are those of `predictor`, by `most` tolerances at most.
    pub fn of(predictor: Predictor, most: f64) -> Self {
        Self { predictor, trim: Attitude::default(), latency_s: 0.0, most }
    }

    /// The move with a trim of the reported attitude.
    pub fn trim(self, trim: Attitude) -> Self {
        Self { trim, ..self }
    }

    /// The move with a latency of the reported pose, s.
    pub fn latency(self, latency_s: f64) -> Self {
        Self { latency_s, ..self }
    }
}

impl Predictor {
    /// A predictor with a model, and with this noise of the sensors.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn new(model: &Model<'_>, noise: SensorConfig) -> Result<Self, VehicleError> {
        let Model { believed, body, effects, foreign, trim, outputs_hz } = *model;
        let all = body.modelled_effects.overlay(effects);
        let pd = believed.attitude_pd.filter(|_| outputs_hz.is_none());
        let law = match pd.map(|pd| all.get::<PdGain>().map_or(pd, |gains| gains.apply(&pd))) {
            Some(pd) => Some((AttitudeLoop::new(pd, believed.allocation()?), pd.rate_hz)),
            None => None,
        };
        let mut plant = Plant::new(body, effects, &Setup::default(), 0)?;
        foreign.iter().for_each(|foreign| plant.disturb(foreign.clone(), 0));
        let lag = plant.physics().constants().motor_time_constant;
        let steps = outputs_hz.map_or(1.0, |hz| 1.0 / (hz * Plant::STEP));
        Ok(Self {
            law,
            trim,
            outputs_steps: (steps.round() as usize).max(1),
            delay_s: all.get::<CommandDelay>().map_or(body.command_delay_s, |e| e.delay_s),
            lag: Lag::new(lag, Plant::STEP),
            plant,
            noise,
        })
    }

    /// Prediction errors over flights of a vehicle with `truth`, without sensor noise.
    pub fn errors(&self, tracks: &[Track], truth: &EffectSet, seed: u64) -> Errors {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut errors = Errors::default();
        let reporter = Reporter::new(truth);
        for (track, start) in windows(tracks, SPACING) {
            let reports = HORIZONS.map(|horizon| reporter.report(track, start + horizon));
            let from = reporter.report(track, start);
            let predicted = self.predict(track, start, &from);
            errors.window_errors.push(differences(&reports, &predicted));
            let noisy = self.predict(track, start, &self.noisy(&from, &mut rng));
            let noise = differences(&predicted.map(|s| self.noisy(&s, &mut rng)), &noisy);
            errors.noise = each(|i, j| errors.noise[i][j] + noise[i][j].powi(2));
        }
        errors
    }

    /// The strength that remains after the file's numbers have moved to explain the difference,
    /// each within its bound. With e the errors and e_j those with number j moved by a tolerance,
    /// this minimises |e + sum_j b_j (e_j - e)|^2 in units of the noise over |b_j| <= most_j.
    pub fn beyond(
        &self,
        tracks: &[Track],
        truth: &EffectSet,
        moved: &[Moved],
        measured: &Errors,
        without: &Errors,
    ) -> Strength {
        let noise = measured.noise();
        let baseline = mean_squares(&without.window_errors);
        let scale = each(|i, j| (noise[i][j] + baseline[i][j]).max(1e-30).sqrt().recip());
        let whitened = |predictor: &Predictor, reporter: &Reporter| -> Vec<Table> {
            windows(tracks, SPARSE)
                .map(|(track, start)| {
                    let reports = HORIZONS.map(|horizon| reporter.report(track, start + horizon));
                    let from = reporter.report(track, start);
                    let error = differences(&reports, &predictor.predict(track, start, &from));
                    each(|i, j| error[i][j] * scale[i][j])
                })
                .collect()
        };
        let reporter = Reporter::new(truth);
        let mut left = whitened(self, &reporter);
        let columns: Vec<Vec<Table>> = moved
            .iter()
            .map(|moved| {
                let mut column = whitened(&moved.predictor, &reporter.moved(moved));
                for (column, error) in column.iter_mut().zip(&left) {
                    *column = each(|i, j| column[i][j] - error[i][j]);
                }
                column
            })
            .collect();
        shrink(&mut left, &columns, moved);
        let whitened = each(|i, j| baseline[i][j] * scale[i][j] * scale[i][j]);
        let noise = each(|i, j| noise[i][j] * scale[i][j] * scale[i][j]);
        strongest(&mean_squares(&left), &whitened, &noise)
    }

    /// The states at each horizon after step `start` of a track, from `state`.
    fn predict(&self, track: &Track, start: usize, state: &State) -> [State; HORIZONS.len()] {
        match &self.law {
            Some((law, rate_hz)) => self.by_setpoints(law, *rate_hz, track, start, state),
            None => self.by_outputs(track, start, state),
        }
    }

    fn plant_at(&self, track: &Track, start: usize, state: &State) -> Plant {
        let mut plant = self.plant.clone();
        plant.hold_voltage(track.voltage[start]);
        plant.set_rotor_states(self.rotors(track, start));
        plant.set_state(*state);
        plant
    }

    /// Predicts along the logged outputs. One prediction yields attitude and body rate. Another
    /// yields position and velocity with the reported rotation, since a small moment would hide
    /// every force.
    fn by_outputs(&self, track: &Track, start: usize, state: &State) -> [State; HORIZONS.len()] {
        let mut plant = self.plant_at(track, start, state);
        let mut turned = plant.clone();
        let off = track.states[start].attitude.inverse().compose(state.attitude);
        let mut ahead = [*state; HORIZONS.len()];
        for step in 0..HORIZONS[2] {
            if step % VOLTAGE_STEPS == 0 {
                plant.hold_voltage(track.voltage[start + step]);
                turned.hold_voltage(track.voltage[start + step]);
            }
            let outputs = self.logged(track, start + step);
            plant.step(outputs);
            turned.step(outputs);
            let State { attitude, body_rate, .. } = track.states[start + step + 1];
            let attitude = attitude.compose(off);
            turned.set_state(State { attitude, body_rate, ..*turned.state() });
            if let Some(place) = HORIZONS.iter().position(|horizon| *horizon == step + 1) {
                let State { position, velocity, .. } = *turned.state();
                ahead[place] = State { position, velocity, ..*plant.state() };
            }
        }
        ahead
    }

    /// Predicts with the loop along the setpoints.
    fn by_setpoints(
        &self,
        law: &AttitudeLoop,
        rate_hz: f64,
        track: &Track,
        start: usize,
        state: &State,
    ) -> [State; HORIZONS.len()] {
        let mut plant = self.plant_at(track, start, state);
        let mut ahead = [*state; HORIZONS.len()];
        let mut outputs = track.outputs[start];
        let mut ticked = None;
        let mut sent =
            track.setpoints.partition_point(|(us, _)| self.has_arrived(track, *us, start));
        for step in 0..HORIZONS[2] {
            let time = self.seconds(track, start + step);
            let tick = (time * rate_hz + 1e-6).floor() as u64;
            if ticked != Some(tick) {
                ticked = Some(tick);
                let next = |sent: usize| track.setpoints.get(sent);
                while next(sent).is_some_and(|(us, _)| self.has_arrived(track, *us, start + step)) {
                    sent += 1;
                }
                let setpoint: Option<AttitudeSetpoint> =
                    sent.checked_sub(1).and_then(next).map(|(_, setpoint)| *setpoint);
                if let Some(setpoint) = setpoint {
                    let state = plant.state();
                    let reported = state.attitude.compose(self.trim).euler();
                    outputs = law.outputs(&setpoint, reported, state.body_rate);
                }
            }
            if step % VOLTAGE_STEPS == 0 {
                plant.hold_voltage(track.voltage[start + step]);
            }
            plant.step(outputs);
            if let Some(place) = HORIZONS.iter().position(|horizon| *horizon == step + 1) {
                ahead[place] = *plant.state();
            }
        }
        ahead
    }

    fn seconds(&self, track: &Track, step: usize) -> f64 {
        track.start_us as f64 * 1e-6 + step as f64 * Plant::STEP
    }

    /// Whether a setpoint sent at `us` has reached the nominal vehicle at a step.
    fn has_arrived(&self, track: &Track, us: u64, step: usize) -> bool {
        us as f64 * 1e-6 + self.delay_s <= self.seconds(track, step) + 1e-9
    }

    /// The nominal rotors' states at a step, from their lag over the outputs before.
    fn rotors(&self, track: &Track, start: usize) -> [f64; ROTORS] {
        if self.lag.is_none() {
            return self.logged(track, start);
        }
        let before = start - MARGIN;
        (before..start).fold(track.outputs[before], |states, step| {
            self.lag.advance(&states, &self.logged(track, step))[1]
        })
    }

    /// The logged outputs at a step, held between messages.
    fn logged(&self, track: &Track, step: usize) -> [f64; ROTORS] {
        track.outputs[step - step % self.outputs_steps]
    }

    fn noisy(&self, state: &State, rng: &mut Pcg64Mcg) -> State {
        let mut draw = |deviation: f64| -> [f64; 3] {
            std::array::from_fn(|_| {
                let z: f64 = StandardNormal.sample(rng);
                deviation * z
            })
        };
        State {
            position: state.position + Ned::from(draw(self.noise.position_noise_m)),
            velocity: state.velocity + Ned::from(draw(self.noise.velocity_noise_m_s)),
            attitude: turned(state.attitude, draw(self.noise.attitude_noise_rad)),
            body_rate: state.body_rate + Frd::from(draw(self.noise.gyro.noise)),
        }
    }
}

/// The true vehicle's reports, without noise.
struct Reporter {
    trim: Attitude,
    latency_s: f64,
}

impl Reporter {
    fn new(truth: &EffectSet) -> Self {
        Self {
            trim: truth.get::<AttitudeTrim>().map_or(Attitude::default(), |trim| trim.rotation()),
            latency_s: truth.get::<EstimatorLatency>().map_or(0.0, |effect| effect.latency_s),
        }
    }

    /// The reports with a number of the file moved.
    fn moved(&self, moved: &Moved) -> Self {
        Self { trim: self.trim.compose(moved.trim), latency_s: self.latency_s + moved.latency_s }
    }

    fn report(&self, track: &Track, step: usize) -> State {
        let latency = (self.latency_s / Plant::STEP).round() as usize;
        let late = &track.states[step.saturating_sub(latency)];
        State {
            attitude: late.attitude.compose(self.trim),
            body_rate: track.states[step].body_rate,
            ..*late
        }
    }
}

/// Starts of windows in flights, `spacing` steps apart.
fn windows(tracks: &[Track], spacing: usize) -> impl Iterator<Item = (&Track, usize)> {
    tracks.iter().flat_map(move |track| {
        let last = track.states.len().saturating_sub(HORIZONS[2] + 1);
        (MARGIN..last).step_by(spacing).map(move |start| (track, start))
    })
}

/// Reported minus predicted states.
fn differences(reports: &[State; HORIZONS.len()], predicted: &[State; HORIZONS.len()]) -> Table {
    std::array::from_fn(|place| {
        let (a, b) = (&reports[place], &predicted[place]);
        let turn = b.attitude.inverse().compose(a.attitude);
        let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
        let [px, py, pz] = (a.position - b.position).to_array();
        let [vx, vy, vz] = (a.velocity - b.velocity).to_array();
        let [wx, wy, wz] = (a.body_rate - b.body_rate).to_array();
        [px, py, pz, vx, vy, vz, sign * turn.x, sign * turn.y, sign * turn.z, wx, wy, wz]
    })
}

/// Adds each column to `left` with the factor, within its bound, that minimises the sum of squares.
/// Coordinate descent converges since the problem is convex.
fn shrink(left: &mut [Table], columns: &[Vec<Table>], moved: &[Moved]) {
    let product = |a: &[Table], b: &[Table]| -> f64 {
        a.iter()
            .zip(b)
            .map(|(a, b)| {
                a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum::<f64>()
            })
            .sum()
    };
    let norms: Vec<f64> = columns.iter().map(|column| product(column, column)).collect();
    let products: Vec<Vec<f64>> =
        columns.iter().map(|a| columns.iter().map(|b| product(a, b)).collect()).collect();
    let mut slopes: Vec<f64> = columns.iter().map(|column| product(column, left)).collect();
    let mut moves = vec![0.0; columns.len()];
    for _ in 0..SWEEPS {
        for (number, moved) in moved.iter().enumerate() {
            if norms[number] <= 0.0 {
                continue;
            }
            let ideal: f64 = moves[number] - slopes[number] / norms[number];
            let step = ideal.clamp(-moved.most, moved.most) - moves[number];
            moves[number] += step;
            for (slope, product) in slopes.iter_mut().zip(&products[number]) {
                *slope += step * product;
            }
        }
    }
    for (column, by) in columns.iter().zip(moves) {
        for (left, column) in left.iter_mut().zip(column) {
            *left = each(|i, j| left[i][j] + by * column[i][j]);
        }
    }
}

/// An attitude rotated by a small rotation vector in body axes, rad.
fn turned(attitude: Attitude, [x, y, z]: [f64; 3]) -> Attitude {
    attitude.compose(Attitude { w: 1.0, x: 0.5 * x, y: 0.5 * y, z: 0.5 * z }.normalized())
}

#[cfg(test)]
mod tests;
