//! How strongly a difference between the true and the nominal vehicle shows: the error that it
//! causes in the nominal simulator's predictions, over the error that noise alone causes when a
//! prediction starts from single samples.
//!
//! This is the signal-to-noise ratio by which detection is judged. It is computed from true states
//! and never from a log, with the plant alone and with none of what the diagnosis is made of.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::AttitudeSetpoint;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::config::{SensorConfig, SitlConfig};
use sitl::effects::{AttitudeTrim, CommandDelay, EffectSet, EstimatorLatency, PdGain};
use sitl::frame::{Attitude, Frd, Ned};
use sitl::plant::Plant;
use sitl::rigid_body::State;
use sitl::rotor::Lag;
use sitl::vehicle::{ROTORS, VehicleError, VehicleParams};

use super::flight::Track;

/// Horizons, in steps of a millisecond.
const HORIZONS: [usize; 3] = [100, 500, 1000];
/// Steps between the starts of windows, and before the first.
const SPACING: usize = 500;
const MARGIN: usize = 400;
/// Position, velocity, attitude and body rate, three axes each.
const CHANNELS: usize = 12;
const NAMES: [&str; CHANNELS] = [
    "pos_x", "pos_y", "pos_z", "vel_x", "vel_y", "vel_z", "att_x", "att_y", "att_z", "rate_x",
    "rate_y", "rate_z",
];

/// Sums of squares over windows, by horizon and channel.
type Squares = [[f64; CHANNELS]; HORIZONS.len()];

/// The ratio and where it is largest.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Strength {
    /// RMS error due to the difference over that due to noise.
    pub ratio: f64,
    /// Channel and horizon.
    pub channel: String,
}

/// What the nominal simulator is off by over some flights.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    due: Squares,
    noise: Squares,
    windows: f64,
}

impl Errors {
    /// How much larger these errors are than those of the nominal vehicle itself, which come of the
    /// link's jitter.
    pub fn strength(&self, nominal: &Errors) -> Strength {
        let mut best = Strength { ratio: 0.0, channel: String::new() };
        for (place, horizon) in HORIZONS.iter().enumerate() {
            for (channel, name) in NAMES.iter().enumerate() {
                let mean = |squares: &Squares, windows: f64| {
                    squares[place][channel] / f64::max(windows, 1.0)
                };
                let due = mean(&self.due, self.windows) - mean(&nominal.due, nominal.windows);
                let noise = mean(&self.noise, self.windows).max(1e-30);
                let ratio = (due.max(0.0) / noise).sqrt();
                if ratio > best.ratio {
                    let channel = format!("{name}@{}s", *horizon as f64 * 1e-3);
                    best = Strength { ratio, channel };
                }
            }
        }
        best
    }
}

/// Predicts with the nominal vehicle.
pub struct Predictor {
    plant: Plant,
    law: AttitudeLoop,
    rate_hz: f64,
    delay_s: f64,
    lag: Lag,
    noise: SensorConfig,
}

impl Predictor {
    /// For the vehicle file, and sensors of this noise.
    ///
    /// # Errors
    /// A vehicle that the physics refuses; one without its on-board loop has none to predict with.
    pub fn new(nominal: &VehicleParams, noise: SensorConfig) -> Result<Option<Self>, VehicleError> {
        let Some(pd) = nominal.attitude_pd else { return Ok(None) };
        let effects = &nominal.modelled_effects;
        let pd = effects.get::<PdGain>().map_or(pd, |gains| gains.apply(&pd));
        let plant = Plant::new(nominal, &EffectSet::new(), &SitlConfig::default(), 0)?;
        let lag = plant.physics().constants().motor_time_constant;
        Ok(Some(Self {
            law: AttitudeLoop::new(pd, nominal.allocation()?),
            rate_hz: pd.rate_hz,
            delay_s: effects.get::<CommandDelay>().map_or(nominal.command_delay_s, |e| e.delay_s),
            lag: Lag::new(lag, Plant::STEP),
            plant,
            noise,
        }))
    }

    /// The errors over flights of a vehicle with `truth`, flown without sensor noise.
    pub fn errors(&self, tracks: &[Track], truth: &EffectSet, seed: u64) -> Errors {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut errors = Errors::default();
        let reporter = Reporter::new(truth);
        for track in tracks {
            let last = track.states.len().saturating_sub(HORIZONS[2] + 1);
            for start in (MARGIN..last).step_by(SPACING) {
                let reports = HORIZONS.map(|horizon| reporter.report(track, start + horizon));
                let from = reporter.report(track, start);
                let predicted = self.predict(track, start, &from);
                add(&mut errors.due, &reports, &predicted);
                let noisy = self.predict(track, start, &self.noisy(&from, &mut rng));
                add(&mut errors.noise, &predicted.map(|s| self.noisy(&s, &mut rng)), &noisy);
                errors.windows += 1.0;
            }
        }
        errors
    }

    /// The states at each horizon after step `start` of a track, from `state`.
    fn predict(&self, track: &Track, start: usize, state: &State) -> [State; HORIZONS.len()] {
        let mut plant = self.plant.clone();
        plant.hold_voltage(track.voltage[start]);
        plant.set_rotor_states(self.rotors(track, start));
        plant.set_state(*state);
        let mut ahead = [*state; HORIZONS.len()];
        let mut outputs = track.outputs[start];
        let mut ticked = None;
        let mut sent = track.setpoints.partition_point(|(us, _)| self.rules_at(track, *us, start));
        for step in 0..HORIZONS[2] {
            let time = self.seconds(track, start + step);
            let tick = (time * self.rate_hz + 1e-6).floor() as u64;
            if ticked != Some(tick) {
                ticked = Some(tick);
                let next = |sent: usize| track.setpoints.get(sent);
                while next(sent).is_some_and(|(us, _)| self.rules_at(track, *us, start + step)) {
                    sent += 1;
                }
                let setpoint: Option<AttitudeSetpoint> =
                    sent.checked_sub(1).and_then(next).map(|(_, setpoint)| *setpoint);
                if let Some(setpoint) = setpoint {
                    let state = plant.state();
                    outputs = self.law.outputs(&setpoint, state.attitude.euler(), state.body_rate);
                }
            }
            if step % 20 == 0 {
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
    fn rules_at(&self, track: &Track, us: u64, step: usize) -> bool {
        us as f64 * 1e-6 + self.delay_s <= self.seconds(track, step) + 1e-9
    }

    /// The nominal rotors' states at a step: their lag over the outputs before.
    fn rotors(&self, track: &Track, start: usize) -> [f64; ROTORS] {
        if self.lag.is_none() {
            return track.outputs[start];
        }
        let before = start - MARGIN;
        (before..start).fold(track.outputs[before], |states, step| {
            self.lag.advance(&states, &track.outputs[step])[1]
        })
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

/// What the true vehicle reports, but for noise.
struct Reporter {
    trim: Attitude,
    latency: usize,
}

impl Reporter {
    fn new(truth: &EffectSet) -> Self {
        let latency = truth.get::<EstimatorLatency>().map_or(0.0, |effect| effect.latency_s);
        Self {
            trim: truth.get::<AttitudeTrim>().map_or(Attitude::default(), |trim| trim.rotation()),
            latency: (latency / Plant::STEP).round() as usize,
        }
    }

    fn report(&self, track: &Track, step: usize) -> State {
        let late = &track.states[step.saturating_sub(self.latency)];
        State {
            attitude: late.attitude.compose(self.trim),
            body_rate: track.states[step].body_rate,
            ..*late
        }
    }
}

fn add(squares: &mut Squares, reports: &[State], predicted: &[State]) {
    for (squares, (a, b)) in squares.iter_mut().zip(reports.iter().zip(predicted)) {
        let turn = b.attitude.inverse().compose(a.attitude);
        let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
        let errors = [
            (a.position - b.position).to_array(),
            (a.velocity - b.velocity).to_array(),
            [sign * turn.x, sign * turn.y, sign * turn.z],
            (a.body_rate - b.body_rate).to_array(),
        ];
        for (square, error) in squares.iter_mut().zip(errors.iter().flatten()) {
            *square += error * error;
        }
    }
}

/// An attitude turned by a small rotation vector in body axes, rad.
fn turned(attitude: Attitude, [x, y, z]: [f64; 3]) -> Attitude {
    attitude.compose(Attitude { w: 1.0, x: 0.5 * x, y: 0.5 * y, z: 0.5 * z }.normalized())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exam::airframe;
    use crate::exam::draw::Draw;
    use crate::exam::flight::{Link, Sortie};
    use crate::exam::ground::Rates;
    use crate::exam::programme::{Restriction, Vigour, programme};

    #[test]
    fn nominal_vehicle_is_predicted_and_an_effect_is_not() {
        let mut draw = Draw::new(2, 0);
        let mut nominal = airframe::vehicle(&mut draw, "quad");
        // Without a delay there is no jitter, and nothing is left to chance.
        nominal.command_delay_s = 0.0;
        let vigour = Vigour::draw(&mut draw, nominal.rotor_radius_m);
        let motions = programme(&mut draw, &vigour, Restriction::None, 2, 8.0);
        let noise = SensorConfig::default();
        let predictor = Predictor::new(&nominal, noise).expect("a vehicle").expect("a loop");
        let errors = |argument: Option<&str>| {
            let mut effects = EffectSet::new();
            argument.into_iter().for_each(|text| effects.insert_argument(text).expect("an effect"));
            let fly = |motion| {
                let sortie = Sortie {
                    nominal: &nominal,
                    effects: &effects,
                    foreign: None,
                    config: SitlConfig { sensors: SensorConfig::IDEAL, ..SitlConfig::default() },
                    rates: Rates {
                        attitude: 250.0,
                        imu: 100.0,
                        position: 100.0,
                        outputs: 100.0,
                        battery: 5.0,
                        rpm: 0.0,
                    },
                    link: Link { delay_s: 1.5e-3, jitter_s: 1e-3, offset_s: 5.0, skew: 1e-5 },
                    motion,
                    seconds: 8.0,
                    seed: 3,
                };
                sortie.fly().expect("a flight").track
            };
            let tracks: Vec<Track> = motions.iter().map(fly).collect();
            predictor.errors(&tracks, &effects, 1)
        };
        let (null, none) = (errors(None), Errors::default());
        assert!(null.strength(&none).ratio < 1e-3, "{:?}", null.strength(&none));
        let weak = errors(Some("thrust_scale:scale=0.99")).strength(&null);
        let strong = errors(Some("thrust_scale:scale=0.98")).strength(&null);
        assert!((strong.ratio / weak.ratio - 2.0).abs() < 0.2, "{weak:?} {strong:?}");
        assert!(strong.channel.contains('z'), "{strong:?}");
    }
}
