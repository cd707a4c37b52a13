//! How streams of one motion fit each other, with no model of the vehicle: attitude turns by the
//! gyro, position moves by the velocity, velocity changes by the accelerometer. Each pair yields a
//! delay, a rotation, a bias and a scale.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};
use serde::Serialize;
use sitl::frame::{Attitude, Frd};

use super::trial::{DELAY_STEP, Trial};
use super::weak::{Bump, Fit, Row, Weighed, bumps, deviation, fit, weigh};
use crate::learn::alignment::interpolated;
use crate::log::import::{Flight, Stream};

/// Standard gravity, m/s^2. Places differ by 0.03, which adds to the vertical bias.
const GRAVITY: f64 = 9.806_65;
/// Half width of a bump: at least this, s, and this many periods of the slower stream.
const HALF: f64 = 0.2;
const HALF_PERIODS: f64 = 8.0;
/// Least share that must be explained for anything to be concluded.
const EXPLAINED_MIN: f64 = 0.5;
/// Standard deviations either side of a value that hold it in 95 of 100 cases.
const INTERVAL: f64 = 1.96;
/// Least half width of a delay's interval, s: stamps and sampling are not better known.
const DELAY_FLOOR: f64 = 2e-4;
/// A rotation that is this many times its interval is undone.
const SURE: f64 = 2.0;
/// A delay less sure than this is none, s.
const DELAY_UNSURE: f64 = 0.02;
/// A rotation less sure than this is not shown, rad.
const ROTATION_UNSURE: f64 = 1.0;
/// Steps of delay (s), rotation (rad) and bias (rad/s, m/s or m/s^2) that matter.
const DELAY_SIZE: f64 = 0.1;
const ROTATION_SIZE: f64 = 1.0;
const BIAS_SIZE: f64 = 1.0;
/// Those of a pair's unknowns.
const SIZES: [f64; 7] =
    [DELAY_SIZE, ROTATION_SIZE, ROTATION_SIZE, ROTATION_SIZE, BIAS_SIZE, BIAS_SIZE, BIAS_SIZE];

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Half width of the interval.
    pub half_width: f64,
}

impl Estimate {
    pub(super) fn new(value: f64, deviation: f64, floor: f64) -> Self {
        Self { value, half_width: (INTERVAL * deviation).max(floor) }
    }

    /// Whether zero is outside of `times` the interval.
    pub fn differs_from_zero(&self, times: f64) -> bool {
        self.value.abs() > times * self.half_width
    }
}

/// How one stream fits the derivative that another sensor measures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// By how much the stream shows the motion later than the other sensor, s.
    pub delay_s: Estimate,
    /// The delay in the second half of the log less that in the first, s, where both show.
    pub delay_drift_s: Option<Estimate>,
    /// How the stream's axes are turned in the other sensor's, as a rotation vector in rad: of an
    /// attitude that is the true one times a trim, the trim; of the velocity, by how much the
    /// attitude's heading is too large. `None` about an axis that the motion does not show, as
    /// the only one that it is about.
    pub rotation_rad: [Option<Estimate>; 3],
    /// What the other sensor measures too much, in its own axes and unit; `None` where the motion
    /// does not show it.
    pub bias: [Option<Estimate>; 3],
    /// The stream's derivative over what the other sensor measures.
    pub scale: f64,
    /// Share of the stream's motion that this explains.
    pub explained: f64,
    /// Whether the stream's axes are another handedness than the sensor's.
    pub is_mirrored: bool,
}

/// All pairs of a flight; `None` where a stream is missing or its motion shows nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Kinematics {
    /// Attitude against the gyro: rotation in body axes, bias in rad/s.
    pub attitude: Option<Agreement>,
    /// Position against velocity: rotation in world axes, bias in m/s.
    pub position: Option<Agreement>,
    /// Velocity against the accelerometer: rotation only about down (the heading), bias in body
    /// axes in m/s^2. A rotation of the attitude that the gyro shows for sure is undone before;
    /// what the gyro does not show of a tilt is in the bias.
    pub velocity: Option<Agreement>,
}

impl Kinematics {
    /// The pairs of a flight.
    pub fn of(flight: &Flight) -> Self {
        let attitude = Turning::of(flight, |q| q).agreement();
        let late = attitude.map_or(0.0, |agreement| agreement.delay_s.value);
        let turned = attitude.and_then(|agreement| {
            let shown = agreement.rotation_rad;
            let is_sure = shown.iter().flatten().any(|r| r.differs_from_zero(SURE));
            is_sure.then(|| shown.map(|r| r.map_or(0.0, |r| -r.value)))
        });
        let gaining = Gaining::of(flight, late, turned.unwrap_or_default());
        Self { attitude, position: moving(flight), velocity: gaining.agreement() }
    }
}

/// How well the attitude follows the gyro at best, in whatever axes.
pub(super) fn turning_follows(flight: &Flight) -> Option<f64> {
    Some(Turning::of(flight, |q| q).trial()?.explained)
}

/// What a quaternion means.
pub(super) type Reading = fn(Attitude) -> Attitude;

/// How well the attitude follows the gyro when its quaternions are read as `read` does: for
/// quaternions in another order or direction than stated.
pub(super) fn turning_explained(flight: &Flight, read: Reading) -> Option<f64> {
    let trial = Turning::of(flight, read).trial()?;
    // Of one axis alone any order could be true.
    let is_near = trial.moving > 1 && trial.angle() < 0.3 && !trial.is_mirrored;
    is_near.then_some(trial.explained)
}

/// By how much the vehicle's turning changes, root mean square about the mean in rad/s: as the
/// attitude and as the gyro show it, noise smoothed away. A steady spin shows nothing of how the two
/// go together.
pub(super) fn turns(flight: &Flight) -> Option<[f64; 2]> {
    let turning = Turning::of(flight, |q| q);
    let mean = |weighed: &dyn Fn(Bump) -> Option<Vector3<f64>>| {
        let rates = turning.bumps.iter().filter_map(|bump| Some(weighed(*bump)? / bump.area()));
        let rates: Vec<Vector3<f64>> = rates.collect();
        let count = rates.len() as f64;
        let mean = rates.iter().sum::<Vector3<f64>>() / count;
        let power = rates.iter().map(|rate| (rate - mean).norm_squared()).sum::<f64>();
        (count > 0.0).then(|| (power / count).sqrt())
    };
    let seen = mean(&|bump| turning.seen(bump))?;
    Some([seen, mean(&|bump| Some(turning.expected(bump, 0.0, |rate| rate)?.value))?])
}

fn half_width(periods: [Option<f64>; 2]) -> f64 {
    periods.into_iter().flatten().fold(HALF, |half, period| half.max(HALF_PERIODS * period))
}

fn vector(v: [f64; 3]) -> Vector3<f64> {
    Vector3::from(v)
}

/// The rotation vector of a rotation.
fn rotation_vector(q: Attitude) -> Vector3<f64> {
    let q = q.canonical();
    let v = Vector3::new(q.x, q.y, q.z);
    let sine = v.norm();
    if sine < 1e-9 { 2.0 * v } else { v * (2.0 * sine.atan2(q.w) / sine) }
}

/// The rotation of a rotation vector.
fn of_vector(v: Vector3<f64>) -> Attitude {
    let angle = v.norm();
    let (sine, w) = (0.5 * angle).sin_cos();
    let [x, y, z] = if angle > 0.0 { (v * (sine / angle)).into() } else { [0.0; 3] };
    Attitude { w, x, y, z }
}

/// The matrix of `v x`.
fn cross(v: Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// An agreement from the fit of delay, small rotation and bias about a first guess.
fn agreement(trial: &Trial, whole: Fit<7>, halves: [Option<Fit<7>>; 2]) -> Option<Agreement> {
    let delay = Estimate::new(whole.value[0], whole.deviation(0)?, DELAY_FLOOR);
    if whole.explained < EXPLAINED_MIN || delay.half_width > DELAY_UNSURE {
        return None;
    }
    let fine = Rotation3::new(vector([whole.value[1], whole.value[2], whole.value[3]]));
    // By way of the quaternion: a matrix's own axis is lost at half a turn.
    let turned = UnitQuaternion::from_rotation_matrix(&(fine * trial.rotation)).inverse();
    let turned = turned.scaled_axis();
    // The fit turns the stream's axes; what is told is in those of the other sensor.
    let there = |of: &SMatrix<f64, 7, 7>| {
        trial.rotation.transpose() * of.fixed_view::<3, 3>(1, 1) * trial.rotation
    };
    let (covariance, hidden) = (there(&whole.covariance), there(&whole.hidden));
    let rotation = |axis: usize| {
        let estimate = Estimate::new(turned[axis], deviation(&covariance, &hidden, axis)?, 0.0);
        (estimate.half_width < ROTATION_UNSURE).then_some(estimate)
    };
    let bias = |i: usize| Some(Estimate::new(whole.value[i], whole.deviation(i)?, 0.0));
    let drift = halves.map(|half| {
        let half = half.filter(|half| half.explained > EXPLAINED_MIN)?;
        Some((half.value[0], half.deviation(0)?))
    });
    let drift = match drift {
        [Some((first, a)), Some((second, b))] => {
            let deviation = a.hypot(b);
            let is_sure = INTERVAL * deviation < DELAY_UNSURE;
            is_sure.then(|| Estimate::new(second - first, deviation, DELAY_FLOOR))
        }
        _ => None,
    };
    Some(Agreement {
        delay_s: delay,
        delay_drift_s: drift,
        rotation_rad: [rotation(0), rotation(1), rotation(2)],
        bias: [bias(4), bias(5), bias(6)],
        scale: trial.scale,
        explained: whole.explained,
        is_mirrored: false,
    })
}

/// The agreement of streams of different handedness: nothing more can be said of them.
fn mirrored(trial: &Trial) -> Agreement {
    Agreement {
        delay_s: Estimate { value: trial.delay, half_width: DELAY_STEP },
        delay_drift_s: None,
        rotation_rad: [None; 3],
        bias: [None; 3],
        scale: trial.scale,
        explained: trial.explained,
        is_mirrored: true,
    }
}

/// Fits the whole and both halves of the bumps.
fn fits<const P: usize>(
    bumps: &[Bump],
    start: [f64; P],
    sizes: [f64; P],
    rows: impl Fn(&[Bump], &[f64; P]) -> Vec<Row<P>>,
) -> Option<(Fit<P>, [Option<Fit<P>>; 2])> {
    let whole = fit(start, sizes, |value| rows(bumps, value))?;
    let (first, second) = bumps.split_at(bumps.len() / 2);
    let half = |bumps: &[Bump]| fit(whole.value, sizes, |value| rows(bumps, value));
    Some((whole, [half(first), half(second)]))
}

/// Attitude against the gyro. Within a bump the attitude is the rotation vector from that at its
/// middle, whose derivative is the body rate times the inverse of its right Jacobian.
struct Turning<'a> {
    attitude: Stream<Attitude>,
    rate: &'a Stream<Frd>,
    bumps: Vec<Bump>,
}

impl<'a> Turning<'a> {
    fn of(flight: &'a Flight, read: Reading) -> Self {
        let attitude = flight.attitude.map(|q| read(*q));
        let rate = &flight.body_rate;
        let bumps = bumps(attitude.times(), half_width([attitude.period(), rate.period()]));
        Self { attitude, rate, bumps }
    }

    fn turn(&self, middle: Attitude, time: f64) -> Option<Vector3<f64>> {
        let now = interpolated(&self.attitude, time)?;
        Some(rotation_vector(middle.inverse().compose(now)))
    }

    fn seen(&self, bump: Bump) -> Option<Vector3<f64>> {
        let middle = interpolated(&self.attitude, bump.centre)?;
        let turn = |_, q: &Attitude| Some(rotation_vector(middle.inverse().compose(*q)));
        Some(-weigh(&self.attitude, bump, turn)?.slope)
    }

    /// What the gyro says under a bump of its own time, if the attitude is `delay` later.
    fn expected(
        &self,
        bump: Bump,
        delay: f64,
        corrected: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Option<Weighed<3>> {
        let middle = interpolated(&self.attitude, bump.centre + delay)?;
        weigh(self.rate, bump, |time, rate: &Frd| {
            let rate = corrected(vector(rate.to_array()));
            // Outside of the bump's support the turn does not matter.
            let turn = self.turn(middle, time + delay).unwrap_or_default();
            Some(rate + turn.cross(&rate) / 2.0 + turn.cross(&turn.cross(&rate)) / 12.0)
        })
    }

    fn trial(&self) -> Option<Trial> {
        let expected = |bump, delay| Some(self.expected(bump, delay, |rate| rate)?.value);
        Trial::best(&self.bumps, |bump| self.seen(bump), expected)
    }

    fn agreement(&self) -> Option<Agreement> {
        let trial = self.trial()?;
        if trial.explained < EXPLAINED_MIN {
            return None;
        }
        if trial.is_mirrored {
            return Some(mirrored(&trial));
        }
        let coarse = trial.rotation.into_inner() * trial.unit();
        let seen: Vec<_> = self.bumps.iter().map(|bump| (*bump, self.seen(*bump))).collect();
        let rows = |bumps: &[Bump], value: &[f64; 7]| {
            let [delay, ex, ey, ez, bx, by, bz] = *value;
            let turn = Rotation3::new(Vector3::new(ex, ey, ez)).into_inner() * coarse;
            let bias = Vector3::new(bx, by, bz);
            let first = bumps.first().map_or(f64::INFINITY, |bump| bump.centre);
            let from = seen.partition_point(|(bump, _)| bump.centre < first);
            let rows = seen[from..from + bumps.len()].iter().filter_map(|(bump, seen)| {
                let seen = (*seen)?;
                let moved = bump.shifted(-delay);
                let expected = self.expected(moved, delay, |rate| turn * (rate - bias))?;
                let mut slopes = SMatrix::<f64, 3, 7>::zeros();
                slopes.set_column(0, &expected.slope);
                slopes.fixed_columns_mut::<3>(1).copy_from(&-cross(expected.value));
                slopes.fixed_columns_mut::<3>(4).copy_from(&(-turn * bump.area()));
                Some(Row { seen, misfit: seen - expected.value, slopes })
            });
            rows.collect()
        };
        let start = [trial.delay, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let (whole, halves) = fits(&self.bumps, start, SIZES, rows)?;
        agreement(&trial, whole, halves)
    }
}

/// Position against velocity.
fn moving(flight: &Flight) -> Option<Agreement> {
    let (position, velocity) = (&flight.position, &flight.velocity);
    let bumps = bumps(position.times(), half_width([position.period(), velocity.period()]));
    let seen = |bump: Bump| {
        // From the bump's middle on, so that a position far from the origin loses nothing.
        let origin = vector(position.held_at(bump.centre)?.to_array());
        Some(-weigh(position, bump, |_, p| Some(vector(p.to_array()) - origin))?.slope)
    };
    let weighed = |bump: Bump| weigh(velocity, bump, |_, v| Some(vector(v.to_array())));
    let trial = Trial::best(&bumps, seen, |bump, _| Some(weighed(bump)?.value))?;
    if trial.explained < EXPLAINED_MIN {
        return None;
    }
    if trial.is_mirrored {
        return Some(mirrored(&trial));
    }
    let coarse = trial.rotation.into_inner() * trial.unit();
    let rows = |bumps: &[Bump], value: &[f64; 7]| {
        let [delay, ex, ey, ez, bx, by, bz] = *value;
        let turn = Rotation3::new(Vector3::new(ex, ey, ez)).into_inner() * coarse;
        let bias = Vector3::new(bx, by, bz);
        let rows = bumps.iter().filter_map(|bump| {
            let (seen, weighed) = (seen(*bump)?, weighed(bump.shifted(-delay))?);
            let expected = turn * (weighed.value - bias * bump.area());
            let mut slopes = SMatrix::<f64, 3, 7>::zeros();
            slopes.set_column(0, &(turn * weighed.slope));
            slopes.fixed_columns_mut::<3>(1).copy_from(&-cross(expected));
            slopes.fixed_columns_mut::<3>(4).copy_from(&(-turn * bump.area()));
            Some(Row { seen, misfit: seen - expected, slopes })
        });
        rows.collect()
    };
    let start = [trial.delay, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let (whole, halves) = fits(&bumps, start, SIZES, rows)?;
    agreement(&trial, whole, halves)
}

/// Velocity against the accelerometer, by an attitude whose delay is known.
struct Gaining<'a> {
    velocity: &'a Stream<sitl::frame::Ned>,
    /// Attitude and specific force at the accelerometer's times.
    force: Stream<(Attitude, Frd)>,
    bumps: Vec<Bump>,
}

/// Acceleration in the world, and the attitude's matrix by columns.
type Felt = SVector<f64, 12>;

impl<'a> Gaining<'a> {
    fn of(flight: &'a Flight, attitude_late: f64, turned: [f64; 3]) -> Self {
        let velocity = &flight.velocity;
        let mut force = Stream::default();
        let turn = of_vector(vector(turned));
        for (time, f) in flight.specific_force.iter() {
            if let Some(attitude) = interpolated(&flight.attitude, time + attitude_late) {
                force.push(time, (attitude.compose(turn), *f));
            }
        }
        let bumps = bumps(velocity.times(), half_width([velocity.period(), force.period()]));
        Self { velocity, force, bumps }
    }

    fn seen(&self, bump: Bump) -> Option<Vector3<f64>> {
        Some(-weigh(self.velocity, bump, |_, v| Some(vector(v.to_array())))?.slope)
    }

    fn expected(&self, bump: Bump, bias: Vector3<f64>) -> Option<Weighed<12>> {
        weigh(&self.force, bump, |_, (attitude, force)| {
            let axis = |v: [f64; 3]| vector(attitude.to_world(Frd::from(v)).to_array());
            let force = vector(force.to_array()) - bias;
            let acceleration = axis([force.x, force.y, force.z]) + Vector3::z() * GRAVITY;
            let mut felt = Felt::zeros();
            felt.fixed_rows_mut::<3>(0).copy_from(&acceleration);
            for (i, unit) in
                [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].into_iter().enumerate()
            {
                felt.fixed_rows_mut::<3>(3 + 3 * i).copy_from(&axis(unit));
            }
            Some(felt)
        })
    }

    fn agreement(&self) -> Option<Agreement> {
        let trial = Trial::best(
            &self.bumps,
            |bump| self.seen(bump),
            |bump, _| {
                Some(self.expected(bump, Vector3::zeros())?.value.fixed_rows::<3>(0).into_owned())
            },
        )?;
        if trial.explained < EXPLAINED_MIN {
            return None;
        }
        if trial.is_mirrored {
            return Some(mirrored(&trial));
        }
        let heading = trial.rotation[(1, 0)].atan2(trial.rotation[(0, 0)]);
        let rows = |bumps: &[Bump], value: &[f64; 5]| {
            let [delay, yaw, bx, by, bz] = *value;
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).into_inner();
            let bias = Vector3::new(bx, by, bz);
            let rows = bumps.iter().filter_map(|bump| {
                let seen = self.seen(*bump)?;
                let felt = self.expected(bump.shifted(-delay), bias)?;
                let expected = turn * felt.value.fixed_rows::<3>(0);
                let mut slopes = SMatrix::<f64, 3, 5>::zeros();
                slopes.set_column(0, &(turn * felt.slope.fixed_rows::<3>(0)));
                slopes.set_column(1, &Vector3::z().cross(&expected));
                for i in 0..3 {
                    slopes.set_column(2 + i, &(-turn * felt.value.fixed_rows::<3>(3 + 3 * i)));
                }
                Some(Row { seen, misfit: seen - expected, slopes })
            });
            rows.collect()
        };
        let start = [trial.delay, heading, 0.0, 0.0, 0.0];
        let sizes = [DELAY_SIZE, ROTATION_SIZE, BIAS_SIZE, BIAS_SIZE, BIAS_SIZE];
        let (whole, halves) = fits(&self.bumps, start, sizes, rows)?;
        let flat = Trial { rotation: Rotation3::identity(), ..trial };
        agreement(&flat, among_all(whole), halves.map(|half| half.map(among_all)))
    }
}

/// A fit of delay, heading and bias among the unknowns of the other pairs: rotations about north
/// and east are not looked for, and so not shown.
fn among_all(fit: Fit<5>) -> Fit<7> {
    const PLACES: [usize; 5] = [0, 3, 4, 5, 6];
    let mut value = [0.0; 7];
    let (mut covariance, mut hidden) = (SMatrix::zeros(), SMatrix::zeros());
    hidden[(1, 1)] = 1.0;
    hidden[(2, 2)] = 1.0;
    for (i, at) in PLACES.into_iter().enumerate() {
        value[at] = fit.value[i];
        for (j, other) in PLACES.into_iter().enumerate() {
            covariance[(at, other)] = fit.covariance[(i, j)];
            hidden[(at, other)] = fit.hidden[(i, j)];
        }
    }
    Fit { value, covariance, hidden, explained: fit.explained, bumps: fit.bumps }
}
