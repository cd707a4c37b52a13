//! The flights that a model of the vehicle is learned from, after Bansal et al. 2016, section V-A:
//! sinusoids in the XY, XZ and YZ planes without yaw, yaw rotations at a fixed position, and
//! unstructured flight, in the shares of the paper's data set.
//!
//! Every flight asks for as much as its limits give: the periods are drawn, the amplitudes are the
//! largest within the box, the speed, the tilt and the thrust that it may use. Smaller and faster
//! waves, up to the bandwidth of the attitude loop, keep the rotational dynamics above the noise.

use std::path::Path;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::feasibility::{Feasibility, FlightEnvelope, InfeasibleTrajectory};
use super::file::TrajectoryError;
use super::multisine::{Multisine, Wave, YawWave};
use super::trajectory::{DesiredPoint, Trajectory};

/// Where and how boldly a programme is flown. What is beyond the [`FlightEnvelope`] or the vehicle
/// is cut to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProgrammeSettings {
    /// Half of the box's side to the north and to the east, around the take-off point, m.
    pub half_size_m: [f64; 2],
    /// Lowest desired height above the take-off floor, m. Without integral action the vehicle flies
    /// lower than that by a few decimetres where it has less thrust than its file says.
    pub height_min_m: f64,
    /// Greatest desired height, m.
    pub height_max_m: f64,
    /// Desired speed, m/s.
    pub speed_max_m_s: f64,
    /// Tilt that the desired acceleration needs, degrees.
    pub tilt_max_deg: f64,
    /// Desired yaw rate, degrees/s.
    pub yaw_rate_max_deg_s: f64,
    /// Headings that flights without yaw motion hold, in turn, degrees.
    pub headings_deg: Vec<f64>,
    /// About the length of each flight's trajectory, s.
    pub flight_s: f64,
}

impl Default for ProgrammeSettings {
    fn default() -> Self {
        Self {
            half_size_m: [2.0, 2.0],
            height_min_m: 0.6,
            height_max_m: 2.4,
            speed_max_m_s: 2.5,
            tilt_max_deg: 30.0,
            yaw_rate_max_deg_s: 150.0,
            headings_deg: vec![0.0],
            flight_s: 60.0,
        }
    }
}

/// What the vehicle is able to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capability {
    /// m/s^2
    pub gravity: f64,
    /// Thrust at full output over the weight.
    pub thrust_to_weight: f64,
    /// Natural frequency of the attitude loop in roll and pitch, the slower of both, rad/s.
    pub tilt_bandwidth: f64,
    /// That in yaw, rad/s.
    pub yaw_bandwidth: f64,
}

/// What a flight moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlightKind {
    /// North and east.
    SinusoidXy,
    /// North and height.
    SinusoidXz,
    /// East and height.
    SinusoidYz,
    /// Yaw alone.
    YawRotation,
    /// All three axes, a band of frequencies.
    Unstructured,
    /// North, east and yaw: what the model is tested on.
    CombinedSinusoidYaw,
    /// A figure 8 while turning.
    #[serde(rename = "combined-figure-8")]
    CombinedFigureEight,
    /// All three axes and yaw.
    CombinedUnstructured,
}

impl FlightKind {
    /// The name in logs and file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::SinusoidXy => "sinusoid-xy",
            Self::SinusoidXz => "sinusoid-xz",
            Self::SinusoidYz => "sinusoid-yz",
            Self::YawRotation => "yaw-rotation",
            Self::Unstructured => "unstructured",
            Self::CombinedSinusoidYaw => "combined-sinusoid-yaw",
            Self::CombinedFigureEight => "combined-figure-8",
            Self::CombinedUnstructured => "combined-unstructured",
        }
    }

    /// Whether it moves north, east and vertically.
    fn axes(self) -> [bool; 3] {
        match self {
            Self::SinusoidXy | Self::CombinedSinusoidYaw | Self::CombinedFigureEight => {
                [true, true, false]
            }
            Self::SinusoidXz => [true, false, true],
            Self::SinusoidYz => [false, true, true],
            Self::YawRotation => [false; 3],
            Self::Unstructured | Self::CombinedUnstructured => [true; 3],
        }
    }

    fn turns(self) -> bool {
        matches!(
            self,
            Self::YawRotation
                | Self::CombinedSinusoidYaw
                | Self::CombinedFigureEight
                | Self::CombinedUnstructured
        )
    }
}

/// Shares of a programme: 90,000, 50,000 and 100,000 of 240,000 samples, the sinusoids in equal
/// parts over the planes.
const SHARES: [(FlightKind, f64); 5] = [
    (FlightKind::SinusoidXy, 30.0 / 240.0),
    (FlightKind::SinusoidXz, 30.0 / 240.0),
    (FlightKind::SinusoidYz, 30.0 / 240.0),
    (FlightKind::YawRotation, 50.0 / 240.0),
    (FlightKind::Unstructured, 100.0 / 240.0),
];

/// Shares of the flights to test on.
const COMBINED_SHARES: [(FlightKind, f64); 3] = [
    (FlightKind::CombinedSinusoidYaw, 1.0 / 3.0),
    (FlightKind::CombinedFigureEight, 1.0 / 3.0),
    (FlightKind::CombinedUnstructured, 1.0 / 3.0),
];

/// One flight of a programme.
#[derive(Clone, Debug)]
pub struct ProgrammeFlight {
    /// Its number and kind, such as `01-sinusoid-xy`; flights of one kind follow one another.
    pub name: String,
    /// What it moves.
    pub kind: FlightKind,
    /// Seed of its own, for whoever simulates it.
    pub seed: u64,
    /// The trajectory file.
    pub text: String,
    /// What that file says.
    pub trajectory: Trajectory,
    /// The most that it asks for.
    pub demands: Feasibility,
}

/// Why there is no programme.
#[derive(Debug, thiserror::Error)]
pub enum ProgrammeError {
    /// A length that makes no flights.
    #[error(
        "a programme of {seconds} s has no room for its kinds of flight: expected at least {least} s"
    )]
    TooShort {
        /// What was asked for.
        seconds: f64,
        /// What there must be.
        least: f64,
    },
    /// Settings that leave no room to fly in.
    #[error(
        "[collect] with [envelope] and the vehicle leaves {quantity} of {found:.3}: {expected}"
    )]
    NoRoom {
        /// What there is too little of.
        quantity: &'static str,
        /// What there is.
        found: f64,
        /// What there must be.
        expected: &'static str,
    },
    /// A flight that its own file or the envelope refuses.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// As above.
    #[error(transparent)]
    Infeasible(#[from] InfeasibleTrajectory),
}

/// Least length of a flight's trajectory: shorter ones are all ramp.
const FLIGHT_MIN_S: f64 = 4.0;

/// The programme: `seconds` of trajectory in the kinds that are learned from, then
/// `combined_seconds` of those that combine both motions. The same arguments give the same
/// flights, and the first part does not depend on the second.
///
/// # Errors
/// [`ProgrammeError`]; every flight that is returned is within the envelope.
pub fn programme(
    settings: &ProgrammeSettings,
    envelope: &FlightEnvelope,
    capability: &Capability,
    seconds: f64,
    combined_seconds: f64,
    seed: u64,
) -> Result<Vec<ProgrammeFlight>, ProgrammeError> {
    let limits = Limits::new(settings, envelope, capability)?;
    let mut slots = slots(&SHARES, seconds, settings.flight_s)?;
    if combined_seconds != 0.0 {
        slots.extend(self::slots(&COMBINED_SHARES, combined_seconds, settings.flight_s)?);
    }
    let mut flights = Vec::new();
    for (index, slot) in slots.iter().enumerate() {
        let flight_seed = mixed(seed, index as u64);
        let heading_deg = match settings.headings_deg.as_slice() {
            [] => 0.0,
            headings => headings[slot.number % headings.len()],
        };
        let mut composer = Composer {
            limits: &limits,
            rng: Pcg64Mcg::seed_from_u64(flight_seed),
            slot,
            ramp_s: RAMP_S.min(0.25 * slot.length_s),
        };
        let text = composer.compose(heading_deg).to_toml();
        let name = format!("{:02}-{}", index + 1, slot.kind.name());
        let origin = format!("{name}.toml");
        let trajectory = Trajectory::parse(&text, Path::new(&origin))?;
        let demands = envelope.check(&trajectory, capability.gravity)?;
        flights.push(ProgrammeFlight {
            name,
            kind: slot.kind,
            seed: flight_seed,
            text,
            trajectory,
            demands,
        });
    }
    Ok(flights)
}

/// Room for one flight.
struct Slot {
    kind: FlightKind,
    /// Which of its kind, from 0.
    number: usize,
    /// How many there are of its kind.
    of: usize,
    length_s: f64,
}

fn slots(
    shares: &[(FlightKind, f64)],
    seconds: f64,
    flight_s: f64,
) -> Result<Vec<Slot>, ProgrammeError> {
    let smallest = shares.iter().map(|(_, share)| *share).fold(1.0, f64::min);
    let least = FLIGHT_MIN_S / smallest;
    if !(least..=1e6).contains(&seconds) || flight_s.is_nan() || flight_s < FLIGHT_MIN_S {
        return Err(ProgrammeError::TooShort { seconds: seconds.min(flight_s), least });
    }
    let of_kind = |&(kind, share): &(FlightKind, f64)| {
        let of = ((share * seconds / flight_s).round() as usize).max(1);
        let length_s = share * seconds / of as f64;
        (0..of).map(move |number| Slot { kind, number, of, length_s })
    };
    Ok(shares.iter().flat_map(of_kind).collect())
}

/// A seed of 32 bits, so that it survives every JSON reader (splitmix64's mixing).
fn mixed(seed: u64, index: u64) -> u64 {
    let mut x = seed.wrapping_add((index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (x ^ (x >> 31)) >> 32
}

/// Part of the envelope that is used: feedback overshoots.
const MARGIN: f64 = 0.9;
/// Part of the vehicle's thrust that a trajectory may need; the rest is for feedback, and for a
/// pack that is not full.
const THRUST_SHARE: f64 = 0.72;
/// Least specific thrust in units of gravity: rotors must keep their authority.
const THRUST_MIN_G: f64 = 0.5;
/// Slowest period, s.
const PERIOD_MAX_S: f64 = 10.0;
/// Fastest main frequency, and range of the small fast waves, over the loop's bandwidth.
const MAIN_BAND: f64 = 0.22;
const FAST_BAND: [f64; 2] = [0.3, 0.8];
/// What the small fast waves have of the limits; the main waves have the rest. Feedback follows
/// fast waves by a part only, so that their tilts are smaller than what they ask for.
const FAST_SHARE: Share = Share { speed: 0.12, acceleration: 0.4 };
/// Vertical acceleration, in units of gravity.
const CLIMB_G: f64 = 0.3;
/// Fast and slow end of a flight's ramp from and to rest, s.
const RAMP_S: f64 = 2.0;
/// Spacing of the samples that limits are checked on, s.
const SPACING_S: f64 = 0.02;

/// Parts of the limits of speed, and of tilt, thrust and vertical acceleration.
#[derive(Clone, Copy)]
struct Share {
    speed: f64,
    acceleration: f64,
}

impl Share {
    fn times(self, factor: f64) -> Self {
        Self { speed: factor * self.speed, acceleration: factor * self.acceleration }
    }

    fn rest(self) -> Self {
        Self { speed: 1.0 - self.speed, acceleration: 1.0 - self.acceleration }
    }
}

/// What settings, envelope and vehicle together allow.
struct Limits {
    gravity: f64,
    half_size: [f64; 2],
    height: [f64; 2],
    speed: f64,
    tilt_tan: f64,
    thrust_g: f64,
    /// rad/s
    yaw_rate: f64,
    /// rad/s
    tilt_bandwidth: f64,
    /// rad/s
    yaw_bandwidth: f64,
}

impl Limits {
    fn new(
        settings: &ProgrammeSettings,
        envelope: &FlightEnvelope,
        capability: &Capability,
    ) -> Result<Self, ProgrammeError> {
        // A corner of the box is on the envelope's circle at most.
        let side = MARGIN * envelope.radius_max_m / 2f64.sqrt();
        let floor = settings.height_min_m.max(1.05 * envelope.height_min_m);
        let ceiling = settings.height_max_m.min(MARGIN * envelope.height_max_m);
        let tilt_deg = settings.tilt_max_deg.min(MARGIN * envelope.tilt_max_deg);
        let yaw_rate = settings.yaw_rate_max_deg_s.min(MARGIN * envelope.yaw_rate_max_deg_s);
        let limits = Self {
            gravity: capability.gravity,
            half_size: settings.half_size_m.map(|half| half.min(side)),
            height: [floor, ceiling],
            speed: settings.speed_max_m_s.min(MARGIN * envelope.speed_max_m_s),
            tilt_tan: tilt_deg.to_radians().tan(),
            thrust_g: (THRUST_SHARE * capability.thrust_to_weight)
                .min(1.0 + MARGIN * (envelope.thrust_max_g - 1.0)),
            yaw_rate: yaw_rate.to_radians(),
            tilt_bandwidth: capability.tilt_bandwidth,
            yaw_bandwidth: capability.yaw_bandwidth,
        };
        let room = |quantity, found: f64, least: f64, expected| {
            if found >= least {
                Ok(())
            } else {
                Err(ProgrammeError::NoRoom { quantity, found, expected })
            }
        };
        let half = limits.half_size[0].min(limits.half_size[1]);
        room("half a side", half, 0.2, "expected at least 0.2 m")?;
        room("a height", ceiling - floor, 0.3, "expected at least 0.3 m between low and high")?;
        room("a speed", limits.speed, 0.1, "expected at least 0.1 m/s")?;
        room("a tilt", tilt_deg, 2.0, "expected at least 2 degrees")?;
        room("a yaw rate", yaw_rate, 1.0, "expected at least 1 degree/s")?;
        room("a specific thrust", limits.thrust_g, 1.1, "expected at least 1.1 g")?;
        room("a bandwidth", limits.tilt_bandwidth, 1.0, "expected at least 1 rad/s")?;
        room("a yaw bandwidth", limits.yaw_bandwidth, 1.0, "expected at least 1 rad/s")?;
        Ok(limits)
    }

    /// Whether the motion of `point` times `scale` is within `share` of the limits. What is allowed
    /// is convex, so that two motions with shares that add up to 1 may be added.
    fn allow(&self, point: &DesiredPoint, scale: f64, share: Share) -> bool {
        let [north, east, down] = (point.acceleration * scale).into();
        let lift = self.gravity - down;
        let horizontal = f64::hypot(north, east);
        let part = share.acceleration;
        let thrust = 1.0 + part * (self.thrust_g - 1.0);
        let least = 1.0 - part * (1.0 - THRUST_MIN_G);
        scale * point.velocity.norm() <= share.speed * self.speed
            && horizontal <= self.tilt_tan * (part * self.gravity - down)
            && f64::hypot(horizontal, lift) <= thrust * self.gravity
            && lift >= least * self.gravity
            && f64::abs(down) <= part * CLIMB_G * self.gravity
    }
}

/// Waves of north, east and up, without an offset.
type Waves = [Vec<Wave>; 3];

/// Draws one flight.
struct Composer<'a> {
    limits: &'a Limits,
    rng: Pcg64Mcg,
    slot: &'a Slot,
    ramp_s: f64,
}

/// The part of the height that a flight keeps to.
#[derive(Clone, Copy)]
enum Level {
    Low,
    High,
    Whole,
}

impl Composer<'_> {
    fn compose(&mut self, heading_deg: f64) -> Multisine {
        let axes = self.slot.kind.axes();
        // Bold and gentle flights, from 0.55 to 1 of the limits.
        let share = self.rng.random_range(0.55..=1.0);
        let level = match self.slot.number % 3 {
            0 => Level::Whole,
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
        // Heights over time lie within -down of the start.
        let (lowest, highest) = (-down[1], -down[0]);
        let altitude_m = match level {
            Level::Low => floor - lowest,
            Level::High => ceiling - highest,
            Level::Whole => {
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

    /// Heights that the flight keeps to.
    fn band(&self, level: Level) -> [f64; 2] {
        let [floor, ceiling] = self.limits.height;
        let part = 0.4 * (ceiling - floor);
        match level {
            Level::Low => [floor, floor + part],
            Level::High => [ceiling - part, ceiling],
            Level::Whole => [floor, ceiling],
        }
    }

    /// The shape of the flight, its axes of size 1 m.
    fn main_waves(&mut self, axes: [bool; 3]) -> Waves {
        let fastest = std::f64::consts::TAU / (MAIN_BAND * self.limits.tilt_bandwidth);
        // A flight must hold its slowest wave.
        let slowest = PERIOD_MAX_S.min(0.7 * self.slot.length_s).max(1.5 * fastest);
        let at = |x: f64| fastest * (slowest / fastest).powf(x);
        // From slow to fast over the flights of a kind, so that both ends are there.
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
                // Amplitudes from equal speeds to equal accelerations over the band.
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

    /// Small waves near the attitude loop's bandwidth, of equal speeds.
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

    /// Turning: flights with a constant rate to either side, and flights that swing.
    fn yaw(&mut self, share: f64) -> (f64, Vec<YawWave>) {
        let most = share * self.limits.yaw_rate;
        let sign = if (self.slot.number / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
        let turning = self.slot.number.is_multiple_of(2);
        let (constant, swing) = if turning { (0.6, 0.2) } else { (0.0, 0.8) };
        // Yaw rates of the waves add up to the rest of the limit.
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

    /// The waves, made smaller where they are beyond `share` of the limits.
    fn within(&self, waves: &Waves, share: Share) -> Waves {
        self.largest(waves, |samples, scale| {
            scale <= 1.0 && samples.iter().all(|point| self.limits.allow(point, scale, share))
        })
    }

    /// The waves times the largest factor that `fits`: what fits at one factor fits below it.
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

    /// Points of the trajectory that the waves alone make.
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

/// Waves of each axis in unstructured flight, and small fast ones.
const WAVES_UNSTRUCTURED: usize = 6;
const WAVES_FAST: usize = 2;

/// Least and greatest position of each axis.
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

/// `x` to a multiple of `step`, so that trajectory files can be read.
fn rounded(x: f64, step: f64) -> f64 {
    let steps = (1.0 / step).round();
    (x * steps).round() / steps
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn nano() -> Capability {
        Capability {
            gravity: 9.80665,
            thrust_to_weight: 1.95,
            tilt_bandwidth: 17.0,
            yaw_bandwidth: 8.0,
        }
    }

    fn made(seconds: f64, combined: f64, seed: u64) -> Vec<ProgrammeFlight> {
        let (settings, envelope) = (ProgrammeSettings::default(), FlightEnvelope::default());
        programme(&settings, &envelope, &nano(), seconds, combined, seed).expect("a programme")
    }

    #[test]
    fn shares_are_the_papers() {
        let flights = made(2400.0, 300.0, 1);
        let length = |kinds: &[FlightKind]| -> f64 {
            let of = flights.iter().filter(|flight| kinds.contains(&flight.kind));
            of.map(|flight| flight.trajectory.duration()).sum()
        };
        use FlightKind::*;
        for (kinds, seconds) in [
            (&[SinusoidXy, SinusoidXz, SinusoidYz][..], 900.0),
            (&[YawRotation], 500.0),
            (&[Unstructured], 1000.0),
            (&[CombinedSinusoidYaw, CombinedFigureEight, CombinedUnstructured], 300.0),
        ] {
            assert!((length(kinds) - seconds).abs() < 0.1, "{kinds:?}: {} s", length(kinds));
        }
        let mut kinds: Vec<_> = flights.iter().map(|flight| flight.kind).collect();
        assert!(kinds.is_sorted());
        kinds.dedup();
        assert_eq!(kinds.len(), 8);
        let names: Vec<_> = flights.iter().map(|flight| flight.name.as_str()).collect();
        assert_eq!((names[0], names[16]), ("01-sinusoid-xy", "17-yaw-rotation"));
    }

    #[test]
    fn only_combined_flights_move_and_turn() {
        for flight in made(300.0, 60.0, 3) {
            let (mut moves, mut turns) = (false, false);
            let start = flight.trajectory.sample(0.0).position;
            for step in 0..(flight.trajectory.duration() * 10.0) as usize {
                let point = flight.trajectory.sample(step as f64 * 0.1);
                moves |= (point.position - start).norm() > 1e-9;
                turns |= point.yaw_rate != 0.0;
            }
            let combines = flight.kind >= FlightKind::CombinedSinusoidYaw;
            assert_eq!(moves && turns, combines, "{}", flight.name);
            assert!(moves || turns, "{}", flight.name);
        }
    }

    #[test]
    fn flights_to_test_on_leave_the_others_as_they_are() {
        let texts = |flights: Vec<ProgrammeFlight>| -> Vec<String> {
            flights.into_iter().map(|flight| flight.text).collect()
        };
        let (short, long) = (texts(made(300.0, 0.0, 5)), texts(made(300.0, 60.0, 5)));
        assert_eq!(short[..], long[..short.len()]);
        assert_ne!(short, texts(made(300.0, 0.0, 6)));
    }

    #[test]
    fn what_leaves_no_room_is_refused_with_the_quantity() {
        let error = |settings: ProgrammeSettings, seconds: f64| {
            programme(&settings, &FlightEnvelope::default(), &nano(), seconds, 0.0, 1)
                .expect_err("refused")
                .to_string()
        };
        let settings = ProgrammeSettings::default;
        assert!(error(settings(), 10.0).contains("at least 32 s"));
        assert!(error(settings(), f64::NAN).contains("at least 32 s"));
        assert!(
            error(ProgrammeSettings { height_max_m: 0.7, ..settings() }, 60.0).contains("height")
        );
        assert!(
            error(ProgrammeSettings { speed_max_m_s: 0.0, ..settings() }, 60.0).contains("speed")
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn every_vehicle_has_a_feasible_programme(
            thrust_to_weight in 1.6..5.0f64,
            tilt_bandwidth in 5.0..30.0f64,
            yaw_bandwidth in 2.0..12.0f64,
            tilt_max_deg in 8.0..40.0f64,
            half in 0.5..10.0f64,
            height_max_m in 1.2..8.0f64,
            seed in 0..1000u64,
        ) {
            let capability = Capability { gravity: 9.80665, thrust_to_weight, tilt_bandwidth, yaw_bandwidth };
            let settings = ProgrammeSettings {
                half_size_m: [half, 0.7 * half],
                height_max_m,
                tilt_max_deg,
                ..ProgrammeSettings::default()
            };
            let envelope = FlightEnvelope { tilt_max_deg, ..FlightEnvelope::default() };
            let flights = programme(&settings, &envelope, &capability, 180.0, 40.0, seed);
            for flight in flights.map_err(|error| TestCaseError::fail(error.to_string()))? {
                let demands = flight.demands;
                prop_assert!(demands.speed_m_s <= settings.speed_max_m_s + 1e-3);
                prop_assert!(demands.tilt_deg <= tilt_max_deg);
                prop_assert!(demands.height_m <= height_max_m + 2e-3);
                // Not timid: it moves, or it turns.
                prop_assert!(demands.speed_m_s > 0.2 || demands.yaw_rate_deg_s > 20.0, "{demands:?}");
                for step in 0..(flight.trajectory.duration() * 50.0) as usize {
                    let point = flight.trajectory.sample(step as f64 * 0.02);
                    let [north, east, down]: [f64; 3] = point.position.into();
                    prop_assert!(north.abs() <= half + 2e-3 && east.abs() <= 0.7 * half + 2e-3);
                    prop_assert!(-down >= settings.height_min_m - 2e-3);
                }
            }
        }
    }
}
