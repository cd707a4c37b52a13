//! Random generation of a programme's flights.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::FlightKind;
use super::limits::{Limits, Share};
use super::shares::Slot;
use crate::plan::file::{Multisine, Wave, YawWave};
use crate::plan::trajectory::DesiredPoint;

/// Slowest period, s.
const PERIOD_MAX_S: f64 = 10.0;
/// Highest main frequency, and range of the small fast waves, relative to the loop's bandwidth.
const MAIN_BAND: f64 = 0.22;
const FAST_BAND: [f64; 2] = [0.3, 0.8];
/// Share of the limits for the small fast waves; the main waves have the rest. Feedback follows
/// fast waves only partly, so their tilts are smaller than commanded.
const FAST_SHARE: Share = Share { speed: 0.12, acceleration: 0.4 };
/// Duration of a flight's ramps from and to rest, s; shorter flights have shorter ramps.
const RAMP_S: f64 = 2.0;
/// Sampling interval of the limit checks, s.
const SPACING_S: f64 = 0.02;

/// Waves of north, east and up, without an offset.
type Waves = [Vec<Wave>; 3];

/// Composes one flight.
pub(super) struct Composer<'a> {
    limits: &'a Limits,
    rng: Pcg64Mcg,
    slot: &'a Slot,
    ramp_s: f64,
}

/// The range of heights that a flight uses.
#[derive(Clone, Copy)]
enum Level {
    Low,
    High,
    Full,
}

impl<'a> Composer<'a> {
    /// A composer for the flight in `slot`, with its own random seed.
    pub fn new(limits: &'a Limits, slot: &'a Slot, seed: u64) -> Self {
        let rng = Pcg64Mcg::seed_from_u64(seed);
        Self { limits, rng, slot, ramp_s: RAMP_S.min(0.25 * slot.length_s) }
    }

    /// Composes the flight, as large as its share of the limits allows.
    pub fn compose(&mut self, heading_deg: f64) -> Multisine {
        let axes = self.slot.kind.axes();
        // Bold and gentle flights: 0.55 to 1 of the limits.
        let share = self.rng.random_range(0.55..=1.0);
        let level = match self.slot.number % 3 {
            0 => Level::Full,
            1 => Level::Low,
            _ => Level::High,
        };
        let [floor, ceiling] = self.band(level);

        let fast_shape = self.fast_waves(axes);
        let fast_share = FAST_SHARE.times(share);
        let fast = self.largest(&fast_shape, |samples, scale| {
            samples.iter().all(|point| self.limits.allow(point, scale, fast_share))
        });
        let fast_extents = extents(&self.samples(&fast));

        let [half_n, half_e] = self.limits.half_size;
        let room = [2.0 * half_n, 2.0 * half_e, ceiling - floor];
        let mut main = self.main_waves(axes);
        // Each axis as large as the box allows, then all of them as large as the limits allow.
        let main_extents = extents(&self.samples(&main));
        let main_share = FAST_SHARE.rest().times(share);
        for (axis, waves) in main.iter_mut().enumerate() {
            let [least, most] = main_extents[axis];
            let [fast_least, fast_most] = fast_extents[axis];
            let free = (room[axis] - (fast_most - fast_least)).max(0.0);
            let size = (most - least).max(1e-9);
            scale(waves, free / size);
        }
        for (axis, waves) in main.iter_mut().enumerate() {
            let mut alone: Waves = Default::default();
            alone[axis] = std::mem::take(waves);
            *waves = std::mem::take(&mut self.within(&alone, main_share)[axis]);
        }
        let main = self.within(&main, main_share);

        let mut waves: Waves = [0, 1, 2].map(|axis| [&main[axis][..], &fast[axis][..]].concat());
        for wave in waves.iter_mut().flatten() {
            wave.amplitude_m = rounded(wave.amplitude_m, 1e-4);
        }
        let [north, east, down] = extents(&self.samples(&waves));
        let centre = |[least, most]: [f64; 2]| -0.5 * (least + most);
        // Heights over time are at most -down above the start.
        let (lowest, highest) = (-down[1], -down[0]);
        let altitude_m = match level {
            Level::Low => floor - lowest,
            Level::High => ceiling - highest,
            Level::Full => {
                let spare = (ceiling - floor) - (highest - lowest);
                floor - lowest + spare.max(0.0) * self.rng.random_range(0.0..=1.0)
            }
        };
        let (yaw_rate_deg_s, yaw) =
            if self.slot.kind.turns() { self.yaw(share) } else { (0.0, vec![]) };
        let [north_waves, east_waves, up] = waves;
        Multisine {
            altitude_m: rounded(altitude_m, 1e-3),
            offset_m: [centre(north), centre(east)].map(|offset| rounded(offset, 1e-3)),
            heading_deg,
            yaw_rate_deg_s,
            duration_s: rounded(self.slot.length_s - self.ramp_s, 1e-3),
            ramp_s: self.ramp_s,
            north: north_waves,
            east: east_waves,
            up,
            yaw,
        }
    }

    /// The range of heights that the flight uses, m.
    fn band(&self, level: Level) -> [f64; 2] {
        let [floor, ceiling] = self.limits.height;
        let part = 0.4 * (ceiling - floor);
        match level {
            Level::Low => [floor, floor + part],
            Level::High => [ceiling - part, ceiling],
            Level::Full => [floor, ceiling],
        }
    }

    /// The main waves before scaling, each axis of size 1 m.
    fn main_waves(&mut self, axes: [bool; 3]) -> Waves {
        let fastest = std::f64::consts::TAU / (MAIN_BAND * self.limits.tilt_bandwidth);
        // A flight must contain its slowest wave.
        let slowest = PERIOD_MAX_S.min(0.7 * self.slot.length_s).max(1.5 * fastest);
        let at = |x: f64| fastest * (slowest / fastest).powf(x);
        // From slow to fast over the flights of a kind, so that both ends occur.
        let place =
            (self.slot.number as f64 + self.rng.random_range(0.2..0.8)) / self.slot.of as f64;
        let wave = |amplitude_m: f64, period: f64, phase: f64| Wave {
            amplitude_m,
            period_s: rounded(period, 1e-3),
            phase_deg: rounded(phase, 0.1),
        };
        let mut waves: Waves = Default::default();
        match self.slot.kind {
            FlightKind::CombinedFigureEight => {
                let period = at(0.4 + 0.6 * place);
                waves[0] = vec![wave(1.0, period, 0.0)];
                waves[1] = vec![wave(1.0, 0.5 * period, 0.0)];
            }
            FlightKind::Unstructured | FlightKind::CombinedUnstructured => {
                // Amplitudes between equal speeds and equal accelerations over the band.
                let slope = 1.0 + place;
                for axis in (0..3).filter(|axis| axes[*axis]) {
                    for _ in 0..WAVES_UNSTRUCTURED {
                        let period = at(self.rng.random_range(0.0..1.0));
                        let amplitude =
                            self.rng.random_range(0.3..1.0) * (period / slowest).powf(slope);
                        let phase = self.rng.random_range(0.0..360.0);
                        waves[axis].push(wave(amplitude, period, phase));
                    }
                }
            }
            _ => {
                let moving: Vec<usize> = (0..3).filter(|axis| axes[*axis]).collect();
                let leads = self.rng.random_range(0..moving.len().max(1));
                for (order, axis) in moving.into_iter().enumerate() {
                    let ratio = if order == leads { 1.0 } else { self.rng.random_range(0.55..1.0) };
                    let period = (at(place) / ratio).min(slowest);
                    waves[axis].push(wave(1.0, period, self.rng.random_range(0.0..360.0)));
                }
            }
        }
        waves
    }

    /// Small waves near the attitude loop's bandwidth, with equal speeds.
    fn fast_waves(&mut self, axes: [bool; 3]) -> Waves {
        let mut waves: Waves = Default::default();
        for axis in (0..3).filter(|axis| axes[*axis]) {
            for _ in 0..WAVES_FAST {
                let [low, high] = FAST_BAND;
                let omega = self.limits.tilt_bandwidth * self.rng.random_range(low..high);
                waves[axis].push(Wave {
                    amplitude_m: 1.0 / omega,
                    period_s: rounded(std::f64::consts::TAU / omega, 1e-3),
                    phase_deg: rounded(self.rng.random_range(0.0..360.0), 0.1),
                });
            }
        }
        waves
    }

    /// Yaw motion: a constant rate to either side with a small swing, or a large swing alone.
    fn yaw(&mut self, share: f64) -> (f64, Vec<YawWave>) {
        let most = share * self.limits.yaw_rate;
        let sign = if (self.slot.number / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
        let turning = self.slot.number.is_multiple_of(2);
        let (constant, swing) = if turning { (0.6, 0.2) } else { (0.0, 0.8) };
        // The yaw rates of the waves add up to the rest of the limit.
        let mut yaw = Vec::new();
        let mut wave = |rng: &mut Pcg64Mcg, rate: f64, omega: f64| {
            yaw.push(YawWave {
                amplitude_deg: rounded((rate / omega).to_degrees(), 1e-2),
                period_s: rounded(std::f64::consts::TAU / omega, 1e-3),
                phase_deg: rounded(rng.random_range(0.0..360.0), 0.1),
            });
        };
        let slow = std::f64::consts::TAU / PERIOD_MAX_S.min(0.7 * self.slot.length_s);
        let fast = MAIN_BAND * self.limits.yaw_bandwidth;
        for part in [0.6, 0.4] {
            let x: f64 = self.rng.random_range(0.0..1.0);
            wave(&mut self.rng, swing * part * most, slow * (fast / slow).max(1.0).powf(x));
        }
        for _ in 0..WAVES_FAST {
            let [low, high] = FAST_BAND;
            let omega = self.limits.yaw_bandwidth * self.rng.random_range(low..high);
            wave(&mut self.rng, 0.2 / WAVES_FAST as f64 * most, omega);
        }
        (rounded(sign * constant * most.to_degrees(), 1e-2), yaw)
    }

    /// The waves, scaled down where they exceed `share` of the limits.
    fn within(&self, waves: &Waves, share: Share) -> Waves {
        self.largest(waves, |samples, scale| {
            scale <= 1.0 && samples.iter().all(|point| self.limits.allow(point, scale, share))
        })
    }

    /// The waves times the largest factor that `fits`; any smaller factor must fit too.
    fn largest(&self, waves: &Waves, fits: impl Fn(&[DesiredPoint], f64) -> bool) -> Waves {
        let samples = self.samples(waves);
        let (mut low, mut high) = (0.0, 1.0);
        while high < 1e6 && fits(&samples, high) {
            (low, high) = (high, 2.0 * high);
        }
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            *(if fits(&samples, middle) { &mut low } else { &mut high }) = middle;
        }
        let mut waves = waves.clone();
        waves.iter_mut().for_each(|axis| scale(axis, low));
        waves
    }

    /// Samples of the trajectory that consists of these waves alone.
    fn samples(&self, waves: &Waves) -> Vec<DesiredPoint> {
        let [north, east, up] = waves.clone();
        let alone = Multisine {
            duration_s: self.slot.length_s - self.ramp_s,
            ramp_s: self.ramp_s,
            north,
            east,
            up,
            ..Multisine::default()
        };
        alone.samples(SPACING_S)
    }
}

/// Number of waves per axis in unstructured flight, and of small fast ones.
const WAVES_UNSTRUCTURED: usize = 6;
const WAVES_FAST: usize = 2;

/// Least and greatest position along each axis, m.
fn extents(samples: &[DesiredPoint]) -> [[f64; 2]; 3] {
    let mut extents = [[0.0f64; 2]; 3];
    for point in samples {
        for (extent, x) in extents.iter_mut().zip(<[f64; 3]>::from(point.position)) {
            *extent = [extent[0].min(x), extent[1].max(x)];
        }
    }
    extents
}

fn scale(waves: &mut [Wave], factor: f64) {
    waves.iter_mut().for_each(|wave| wave.amplitude_m *= factor);
}

/// `x` rounded to a multiple of `step`, for readable trajectory files.
fn rounded(x: f64, step: f64) -> f64 {
    let steps = (1.0 / step).round();
    (x * steps).round() / steps
}
