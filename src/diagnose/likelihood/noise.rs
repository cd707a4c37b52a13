//! Noise of the reported state, from the high-frequency residuals that no vehicle model explains.

use rand_pcg::Pcg64Mcg;
use schemars::JsonSchema;
use serde::Serialize;
use sitl::config::{ImuNoise, SensorConfig};
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::rigid_body::State;

use crate::diagnose::flights::normal_draws::{CHI_SQUARED_MEDIAN, standard_normals};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::Series;
use crate::diagnose::flights::spectrum::{BANDS, CELL_S, edges, mean_square_share};
use crate::diagnose::likelihood::channels::{ATTITUDE, VELOCITY};
use crate::diagnose::likelihood::layout::Bin;

/// Below this frequency, gyro and accelerometer drift and forces act, Hz.
const ATTITUDE_FROM_HZ: f64 = 0.35;
/// Above this frequency, a vehicle's velocity and body rate are mostly noise, Hz.
const WHITE_FROM_HZ: f64 = 8.0;

/// Standard deviations of the reported state, per axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct ReportNoise {
    /// Position, m.
    pub position: f64,
    /// Velocity, m/s.
    pub velocity: f64,
    /// Attitude, rad.
    pub attitude: f64,
    /// Body rate, rad/s.
    pub body_rate: f64,
    /// Specific force, m/s^2.
    pub specific_force: f64,
}

impl ReportNoise {
    /// The mean of each standard deviation.
    pub fn mean<'a>(all: impl Iterator<Item = &'a Self> + Clone) -> Self {
        Self::each(|of| {
            let count = all.clone().count().max(1) as f64;
            all.clone().map(of).sum::<f64>() / count
        })
    }

    /// Noise whose estimate would be `self`, given that noise of `self` is estimated as `found`.
    /// The estimate also contains motion.
    pub fn matched(&self, found: &Self) -> Self {
        Self::each(|own| {
            let [own, found] = [own(self), own(found)];
            if found > 0.0 { own * own / found } else { own }
        })
    }

    /// Builds each standard deviation with `of`, which receives its getter.
    fn each(of: impl Fn(fn(&Self) -> f64) -> f64) -> Self {
        Self {
            position: of(|noise| noise.position),
            velocity: of(|noise| noise.velocity),
            attitude: of(|noise| noise.attitude),
            body_rate: of(|noise| noise.body_rate),
            specific_force: of(|noise| noise.specific_force),
        }
    }

    /// Sensors with this noise and an inertial unit without bias.
    pub(in crate::diagnose) fn sensors(&self) -> SensorConfig {
        let imu = |noise: f64| ImuNoise { noise, ..ImuNoise::default() };
        SensorConfig {
            position_noise_m: self.position,
            velocity_noise_m_s: self.velocity,
            attitude_noise_rad: self.attitude,
            attitude_correlation_s: SensorConfig::ATTITUDE_CORRELATION_S,
            gyro: imu(self.body_rate),
            accelerometer: imu(self.specific_force),
        }
    }

    /// The noise of a value interpolated at `time`: white noise is smaller between two samples.
    pub(in crate::diagnose) fn read_at(
        &self,
        flight: &PreparedFlight,
        time: f64,
        latency: f64,
    ) -> Self {
        Self {
            position: self.position * flight.position.noise_share(time),
            velocity: self.velocity * flight.velocity.noise_share(time),
            body_rate: self.body_rate * flight.body_rate.noise_share(time - latency),
            ..*self
        }
    }

    /// A report of `state` with one draw of this noise.
    pub(in crate::diagnose) fn applied(&self, state: &State, rng: &mut Pcg64Mcg) -> State {
        let mut draw = |deviation: f64| standard_normals(rng).map(|z| deviation * z);
        let turned = small_rotation(draw(self.attitude));
        State {
            position: state.position + Ned::from(draw(self.position)),
            velocity: state.velocity + Ned::from(draw(self.velocity)),
            attitude: state.attitude.compose(turned),
            body_rate: state.body_rate + Frd::from(draw(self.body_rate)),
        }
    }
}

/// Noise of the reports, from the sums of squares that a fit leaves in each bin.
pub fn report_noise(flights: &[PreparedFlight], power: &[f64], counts: &[f64]) -> ReportNoise {
    let variance: Vec<f64> =
        power.iter().zip(counts).map(|(q, n)| if *n > 0.0 { q / n } else { 0.0 }).collect();
    let rate = |of: fn(&PreparedFlight) -> f64| {
        flights.iter().map(of).sum::<f64>() / flights.len().max(1) as f64
    };
    // Where slow outputs limit the equations to lower frequencies, use the velocity's samples.
    let velocity = white_noise_deviation(&variance, VELOCITY, rate(|f| f.velocity.rate()))
        .unwrap_or_else(|| second_differences(flights, |flight| &flight.velocity));
    let body_rate = second_differences(flights, |flight| &flight.body_rate);
    let specific_force = second_differences(flights, |flight| &flight.specific_force);
    ReportNoise {
        position: position(flights, velocity),
        velocity,
        attitude: attitude(&variance),
        body_rate,
        specific_force,
    }
}

/// Mean of the gyro beyond the rate of the reported attitude, rad/s; 0 where either is not logged.
/// `untrim` rotates the reported attitude to the true one.
pub(in crate::diagnose) fn gyro_bias(flight: &PreparedFlight, untrim: Attitude) -> Frd {
    if !(flight.channels.attitude && flight.channels.body_rate) {
        return Frd::zero();
    }
    let (mut sum, mut count) = (Frd::zero(), 0.0);
    for block in &flight.blocks {
        let (mut attitude, mut body_rate) = (flight.attitude.cursor(), flight.body_rate.cursor());
        let mut read =
            |time: f64| (attitude.attitude_at(time).compose(untrim), Frd::from(body_rate.at(time)));
        let mut before = read(block.start);
        for k in 0..block.cells {
            let after = read(block.edge(k + 1));
            let turn = before.0.inverse().compose(after.0).canonical();
            let turn = Frd::new(turn.x, turn.y, turn.z) * (2.0 / CELL_S);
            sum += (before.1 + after.1) * 0.5 - turn;
            count += 1.0;
            before = after;
        }
    }
    sum * (1.0 / f64::max(count, 1.0))
}

/// Power gain of the increment over a cell at a frequency, 1/s^2.
fn increment_gain(frequency_hz: f64) -> f64 {
    (2.0 * (std::f64::consts::PI * frequency_hz * CELL_S).sin() / CELL_S).powi(2)
}

/// Variance of a coefficient in a band, for the increments of white noise of `deviation` at `rate`
/// samples per second.
pub(in crate::diagnose) fn increments_of_white(deviation: f64, rate: f64, band: usize) -> f64 {
    deviation * deviation * increment_gain(middle(band)) / (rate * CELL_S).max(f64::MIN_POSITIVE)
}

/// Middle frequency of a band, Hz.
fn middle(band: usize) -> f64 {
    let [lower, upper] = edges(band);
    0.5 * (lower + upper)
}

/// Standard deviation of white noise at `rate` samples per second, from its increments in three
/// channels from `first`; `None` where none are used above the frequency of motion. It is the
/// median over bands and axes, since vibration and motion only add.
fn white_noise_deviation(variance: &[f64], first: usize, rate: f64) -> Option<f64> {
    let mut found: Vec<f64> = (first..first + 3)
        .flat_map(|channel| (0..BANDS.len()).map(move |band| (channel, band)))
        .filter(|(_, band)| middle(*band) > WHITE_FROM_HZ)
        .map(|(channel, band)| {
            variance[Bin::index_of(channel, band)] / increment_gain(middle(band)) * rate * CELL_S
        })
        .filter(|v| *v > 0.0)
        .collect();
    found.sort_by(f64::total_cmp);
    found.get(found.len() / 2).map(|v| v.sqrt())
}

/// Standard deviation of a stream's white noise, from the median of its second differences: most of
/// the time, rotation and thrust are smooth over three samples.
fn second_differences(
    flights: &[PreparedFlight],
    series: fn(&PreparedFlight) -> &Series<3>,
) -> f64 {
    let mut squares: Vec<f64> = Vec::new();
    for flight in flights {
        let series = series(flight);
        for (t, w) in series.times().windows(3).zip(series.values().windows(3)) {
            if flight.spans.iter().any(|s| s.contains(&t[1])) {
                squares.extend((0..3).map(|i| (w[0][i] - 2.0 * w[1][i] + w[2][i]).powi(2)));
            }
        }
    }
    if squares.is_empty() {
        return 0.0;
    }
    squares.sort_by(f64::total_cmp);
    (squares[squares.len() / 2] / (6.0 * CHI_SQUARED_MEDIAN)).sqrt()
}

/// Standard deviation of the attitude's coloured noise: its power summed over the bands.
fn attitude(variance: &[f64]) -> f64 {
    let mut sum = 0.0;
    for channel in ATTITUDE..ATTITUDE + 3 {
        for band in 0..BANDS.len() {
            if edges(band)[0] >= ATTITUDE_FROM_HZ {
                let increments = variance[Bin::index_of(channel, band)];
                sum += increments / increment_gain(middle(band)) * mean_square_share(band);
            }
        }
    }
    (sum / 3.0).sqrt()
}

/// Longest step between positions over which the trapezoid of the velocity is accurate, s. Slower
/// positions give no estimate.
const STEP_MAX_S: f64 = 0.05;

/// Standard deviation of the position's noise: its increments against the velocity's integral. It
/// is 0 where no velocity is logged, or positions are rare.
fn position(flights: &[PreparedFlight], velocity_noise: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    // Without a velocity the increments are motion.
    for flight in flights.iter().filter(|flight| !flight.velocity.is_empty()) {
        for pair in flight.position.times().windows(2) {
            let step = pair[1] - pair[0];
            if step > STEP_MAX_S || !flight.spans.iter().any(|s| s.contains(&pair[0])) {
                continue;
            }
            let (a, b) = (flight.position.at(pair[0]), flight.position.at(pair[1]));
            let (v, w) = (flight.velocity.at(pair[0]), flight.velocity.at(pair[1]));
            for i in 0..3 {
                let miss = b[i] - a[i] - 0.5 * step * (v[i] + w[i]);
                sum += miss * miss - 0.5 * (step * velocity_noise).powi(2);
                count += 1.0;
            }
        }
    }
    (0.5 * sum / f64::max(count, 1.0)).max(0.0).sqrt()
}

/// A rotation by small angles about the body axes, rad.
pub(in crate::diagnose) fn small_rotation([roll, pitch, yaw]: [f64; 3]) -> Attitude {
    Euler { roll, pitch, yaw }.attitude()
}
