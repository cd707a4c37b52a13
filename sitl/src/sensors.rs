//! Sensors and estimator: they turn the true state into what the vehicle reports.

use std::collections::VecDeque;

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use crate::config::{ImuNoise, SensorConfig, SitlConfig, Vibration};
use crate::estimate_error::ErrorModel;
pub use crate::estimate_error::EstimatorStatus;
use vehicle::ROTORS;
use vehicle::effects::{AttitudeTrim, EffectSet, EstimatorLatency};
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::plant::Plant;
use vehicle::rigid_body::State;

/// The sensors' readings at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readings {
    /// Vehicle time of the readings, microseconds since the start.
    pub time_us: u64,
    /// Pose and velocity as reported over the link: `estimator_latency` old, with noise and
    /// `attitude_trim`. The body rate is the gyro's, without latency.
    pub estimate: State,
    /// Attitude that the on-board loop uses: with trim and noise, without latency.
    pub onboard_attitude: Attitude,
    /// The gyro in true body axes, rad/s.
    pub gyro: Frd,
    /// The accelerometer in true body axes, m/s^2.
    pub specific_force: Frd,
    /// The power module's reading.
    pub battery: BatteryReading,
    /// The estimator's status.
    pub estimator: EstimatorStatus,
}

/// The power module's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BatteryReading {
    /// Terminal voltage in V.
    pub voltage: f64,
    /// Current in A.
    pub current: f64,
    /// Charge left, 0..=1.
    pub remaining: f64,
}

/// The vehicle's sensors and estimator. Each has its own random stream.
#[derive(Clone, Debug)]
pub struct Sensors {
    config: SensorConfig,
    trim: Attitude,
    history: History,
    position: Stream,
    velocity: Stream,
    attitude: Stream,
    attitude_error: [f64; 3],
    gyro: Imu,
    accelerometer: Imu,
    vibration: Shaking,
    errors: ErrorModel,
    sampled_at: Option<u64>,
}

impl Sensors {
    /// Sensors of a vehicle with these effects (the modelled ones overlaid with the true ones).
    pub fn new(config: &SitlConfig, effects: &EffectSet, seed: u64) -> Self {
        let latency = effects.get::<EstimatorLatency>().map_or(0.0, |effect| effect.latency_s);
        let trim = effects.get::<AttitudeTrim>();
        let errors = ErrorModel::new(config.estimator, Stream::seed(seed, 6));
        let vibration = Shaking::new(config.vibration, Stream::new(seed, 7));
        let config = config.sensors;
        let mut attitude = Stream::new(seed, 3);
        let attitude_error = attitude.normals().map(|n| n * config.attitude_noise_rad);
        Self {
            trim: trim.map_or(Attitude::default(), |trim| trim.rotation()),
            history: History::new(latency),
            position: Stream::new(seed, 1),
            velocity: Stream::new(seed, 2),
            attitude,
            attitude_error,
            gyro: Imu::new(config.gyro, Stream::new(seed, 4)),
            accelerometer: Imu::new(config.accelerometer, Stream::new(seed, 5)),
            config,
            vibration,
            errors,
            sampled_at: None,
        }
    }

    /// Records the plant's state for reports with latency; call it after every step.
    pub fn record(&mut self, plant: &Plant) {
        self.history.record(plant);
    }

    /// Reads every sensor at the plant's time.
    pub fn sample(&mut self, plant: &Plant) -> Readings {
        let time_us = plant.time_us();
        let elapsed = time_us.saturating_sub(self.sampled_at.unwrap_or(time_us)) as f64 * 1e-6;
        self.sampled_at = Some(time_us);
        self.advance_attitude_error(elapsed);

        let truth = plant.state();
        let late = self.history.state().unwrap_or(*truth);
        let off = self.errors.advance(time_us, elapsed);
        let error = small_rotation(self.attitude_error);
        let reported =
            |true_attitude: Attitude| true_attitude.compose(self.trim).compose(error).normalized();
        let [shaken, shaken_force] = self.vibration.advance(plant, elapsed);
        let gyro = self.gyro.read(truth.body_rate + shaken, elapsed);
        let estimate = State {
            position: late.position
                + off.position()
                + Ned::from(self.position.normals()) * self.config.position_noise_m,
            velocity: late.velocity
                + off.velocity()
                + Ned::from(self.velocity.normals()) * self.config.velocity_noise_m_s,
            attitude: reported(late.attitude),
            body_rate: gyro,
        };
        Readings {
            time_us,
            estimate,
            onboard_attitude: reported(truth.attitude),
            gyro,
            specific_force: self.accelerometer.read(plant.specific_force() + shaken_force, elapsed),
            battery: BatteryReading {
                voltage: plant.voltage(),
                current: plant.current(),
                remaining: plant.remaining(),
            },
            estimator: self.errors.status(),
        }
    }

    /// A first-order process on each axis, advanced exactly.
    fn advance_attitude_error(&mut self, elapsed: f64) {
        let correlation = self.config.attitude_correlation_s;
        let decay = if correlation > 0.0 { (-elapsed / correlation).exp() } else { 0.0 };
        let noise = self.config.attitude_noise_rad * (1.0 - decay * decay).sqrt();
        for (error, normal) in self.attitude_error.iter_mut().zip(self.attitude.normals()) {
            *error = decay * *error + noise * normal;
        }
    }
}

/// The rotation by a small rotation vector in rad.
fn small_rotation([x, y, z]: [f64; 3]) -> Attitude {
    Attitude { w: 1.0, x: 0.5 * x, y: 0.5 * y, z: 0.5 * z }.normalized()
}

/// The random stream of one sensor.
#[derive(Clone, Debug)]
struct Stream(Pcg64Mcg);

impl Stream {
    /// Stream `number` of `seed`.
    fn new(seed: u64, number: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(Self::seed(seed, number)))
    }

    fn seed(seed: u64, number: u64) -> u64 {
        // Seeding spreads its argument over the generator's whole state.
        seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)
    }

    fn normals(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.0.sample(StandardNormal))
    }
}

/// A gyro or an accelerometer, with white noise, a constant bias and a random walk of the bias.
#[derive(Clone, Debug)]
struct Imu {
    noise: ImuNoise,
    bias: Frd,
    stream: Stream,
}

impl Imu {
    fn new(noise: ImuNoise, mut stream: Stream) -> Self {
        let bias = Frd::from(stream.normals()) * noise.bias;
        Self { noise, bias, stream }
    }

    fn read(&mut self, truth: Frd, elapsed: f64) -> Frd {
        let walk = self.noise.bias_walk * elapsed.sqrt();
        self.bias += Frd::from(self.stream.normals()) * walk;
        truth + self.bias + Frd::from(self.stream.normals()) * self.noise.noise
    }
}

/// The rotors' vibration in gyro and accelerometer.
#[derive(Clone, Debug)]
struct Shaking {
    config: Vibration,
    /// Phase of each rotor, rad.
    phases: [f64; ROTORS],
    /// Phase offset of each axis of the gyro and of the accelerometer, rad.
    offsets: [[f64; 3]; 2],
}

impl Shaking {
    fn new(config: Vibration, mut stream: Stream) -> Self {
        let turn = |stream: &mut Stream| std::f64::consts::TAU * stream.0.random::<f64>();
        let phases = std::array::from_fn(|_| turn(&mut stream));
        let offsets = std::array::from_fn(|_| std::array::from_fn(|_| turn(&mut stream)));
        Self { config, phases, offsets }
    }

    /// Vibration to add to the body rate (rad/s) and to the specific force (m/s^2).
    fn advance(&mut self, plant: &Plant, elapsed: f64) -> [Frd; 2] {
        let Vibration { rotor_max_hz, gyro_rad_s, accelerometer_m_s2 } = self.config;
        if gyro_rad_s == 0.0 && accelerometer_m_s2 == 0.0 {
            return [Frd::zero(); 2];
        }
        let full_turn = std::f64::consts::TAU * rotor_max_hz * elapsed;
        for (phase, speed) in self.phases.iter_mut().zip(plant.rotor_speeds()) {
            *phase = (*phase + full_turn * speed) % std::f64::consts::TAU;
        }
        let lines = |offsets: [f64; 3], amplitude: f64| {
            let line = |offset: f64| {
                self.phases.iter().map(|phase| (phase + offset).sin()).sum::<f64>() * amplitude
            };
            Frd::from(offsets.map(line))
        };
        let [gyro, accelerometer] = self.offsets;
        [lines(gyro, gyro_rad_s), lines(accelerometer, accelerometer_m_s2)]
    }
}

/// The latest states, one for each step.
#[derive(Clone, Debug)]
struct History {
    latency: f64,
    states: VecDeque<State>,
}

impl History {
    fn new(latency: f64) -> Self {
        Self { latency, states: VecDeque::new() }
    }

    fn steps(&self) -> f64 {
        self.latency / Plant::STEP
    }

    fn record(&mut self, plant: &Plant) {
        if self.latency <= 0.0 {
            return;
        }
        self.states.push_back(*plant.state());
        while self.states.len() > self.steps().ceil() as usize + 1 {
            self.states.pop_front();
        }
    }

    /// The state `latency` ago, interpolated between steps, or the oldest one at the start. Returns
    /// `None` without latency.
    fn state(&self) -> Option<State> {
        let newest = self.states.len().checked_sub(1)?;
        let place = (newest as f64 - self.steps()).max(0.0);
        let before = self.states.get(place.floor() as usize)?;
        let after = self.states.get(place.ceil() as usize)?;
        let share = place.fract();
        let mix = |a: f64, b: f64| a + (b - a) * share;
        let (p, q) = (before.attitude, after.attitude);
        let attitude =
            Attitude { w: mix(p.w, q.w), x: mix(p.x, q.x), y: mix(p.y, q.y), z: mix(p.z, q.z) };
        Some(State {
            position: before.position + (after.position - before.position) * share,
            velocity: before.velocity + (after.velocity - before.velocity) * share,
            attitude: attitude.normalized(),
            body_rate: before.body_rate + (after.body_rate - before.body_rate) * share,
        })
    }
}
