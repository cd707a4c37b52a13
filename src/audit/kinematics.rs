//! Consistency of the streams of one motion, without a vehicle model: the attitude turns with the
//! gyro, the position moves with the velocity, and the velocity changes with the accelerometer and,
//! for anything that hangs on its rotors, with the lean. The attitude follows its setpoint. Each
//! pair yields a delay, a drift, a rotation, scales and a bias ([`super::pair`]).

use nalgebra::{Matrix3, SVector, Vector3};
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Attitude, Frd, Ned, wrap_angle};

use super::agreement::{Agreement, agreement};
use super::initial_fit::InitialFit;
use super::pair::{Correction, Expected, Pair};
use super::weak::{Bump, BumpIntegrals, bumps, integrate, median};
use crate::learn::alignment::interpolated;
use crate::log::import::{Flight, Stream};

/// Standard gravity, m/s^2. Local gravity differs by up to 0.03, which adds to the vertical bias.
const GRAVITY: f64 = 9.806_65;
/// Half width of a bump: at least this time, s, and this many periods of the slower stream.
const HALF: f64 = 0.2;
const HALF_PERIODS: f64 = 8.0;
/// Limit of a fast vehicle's rotation within half a bump, rad, and least half width that it may
/// lead to, s.
const TURN_MAX: f64 = 1.0;
const HALF_MIN: f64 = 0.05;
/// Half width of the longer bumps, which show slow motion above the noise of a derivative, in half
/// widths of the others.
const LONGER: f64 = 3.0;
/// A rotation beyond this many intervals is removed.
const CERTAIN_INTERVALS: f64 = 2.0;
/// A delay of the attitude with at most this interval is removed, s.
const REMOVED_DELAY_HALF_WIDTH_MAX: f64 = 0.05;
/// Largest lean at which the thrust that holds the height indicates the force, rad.
const LEAN_MAX: f64 = 1.0;

/// All pairs of a flight; `None` where a stream is missing or its motion shows nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Kinematics {
    /// Attitude against the gyro: rotation in body axes, bias in rad/s.
    pub attitude: Option<Agreement>,
    /// Position against velocity: rotation in world axes, bias in m/s.
    pub position: Option<Agreement>,
    /// Velocity against the accelerometer: rotation only about down (the heading), scales in world
    /// axes, bias in body axes in m/s^2. A rotation of the attitude that the gyro shows with
    /// certainty is removed first; a tilt that the gyro does not show is part of the bias.
    pub velocity: Option<Agreement>,
    /// Velocity against the lean, where no accelerometer is logged: the horizontal acceleration of
    /// a thrust that holds the height at this attitude. Rotation only about down; bias as for the
    /// accelerometer. Drag and climbs affect all values, so they serve only to check axes.
    pub lean: Option<Agreement>,
    /// Attitude against its setpoint, as lean to the north, lean to the east and heading: the
    /// response of the vehicle's loop. Neither its delay nor its scale is a flaw.
    pub setpoint: Option<Agreement>,
}

impl Kinematics {
    /// Compares the pairs of a flight.
    pub fn of(flight: &Flight) -> Self {
        let attitude = agreement(&AttitudeAndGyro::of(flight, |q| q));
        let late = attitude
            .filter(|agreement| agreement.delay_s.half_width < REMOVED_DELAY_HALF_WIDTH_MAX);
        let late = late.map_or(0.0, |agreement| agreement.delay_s.value);
        let turned = attitude.and_then(|agreement| {
            let shown = agreement.rotation_rad;
            let is_sure = shown.iter().flatten().any(|r| r.differs_from_zero(CERTAIN_INTERVALS));
            is_sure.then(|| shown.map(|r| r.map_or(0.0, |r| -r.value)))
        });
        let velocity_and_force = VelocityAndForce::by_accelerometer(
            flight,
            &flight.specific_force,
            late,
            turned.unwrap_or_default(),
        );
        let velocity = agreement(&velocity_and_force);
        let has_force = !flight.specific_force.is_empty();
        let lean = (!has_force).then(|| agreement(&VelocityAndForce::by_lean(flight))).flatten();
        // An attitude that precedes its setpoint does not follow it.
        let follows = |pair: &Agreement| pair.delay_s.value > -pair.delay_s.half_width;
        let setpoint = agreement(&AttitudeAndSetpoint::of(flight)).filter(follows);
        Self {
            attitude,
            position: agreement(&PositionAndVelocity::of(flight)),
            velocity,
            lean,
            setpoint,
        }
    }
}

/// Share of the attitude's motion that the gyro explains at best, in any axes.
pub(super) fn share_explained_by_gyro(flight: &Flight) -> Option<f64> {
    Some(InitialFit::best(&AttitudeAndGyro::of(flight, |q| q))?.explained)
}

/// Share of the position's motion that the velocity explains at best, in any axes, and the typical
/// deviation of either from its mean, m/s.
pub(super) fn share_explained_by_velocity(flight: &Flight) -> Option<(f64, [f64; 2])> {
    let pair = PositionAndVelocity::of(flight);
    Some((InitialFit::best(&pair)?.explained, changes(&pair)?))
}

/// Each sample of a stream, transformed with the attitude at its time; samples without one are left
/// out.
pub(super) fn by_attitude<V, W>(
    flight: &Flight,
    stream: &Stream<V>,
    turned: impl Fn(Attitude, &V) -> W,
) -> Stream<W> {
    let mut all = Stream::default();
    for (time, value) in stream.iter() {
        if let Some(attitude) = interpolated(&flight.attitude, time) {
            all.push(time, turned(attitude, value));
        }
    }
    all
}

/// An interpretation of a quaternion.
pub(super) type Reading = fn(Attitude) -> Attitude;

/// Share of the attitude's motion that the gyro explains with quaternions interpreted by `read`:
/// for quaternions in another order or direction than stated.
pub(super) fn share_explained_as_read(flight: &Flight, read: Reading) -> Option<f64> {
    let initial = InitialFit::best(&AttitudeAndGyro::of(flight, read))?;
    // With motion about a single axis, any order may fit.
    let is_near = initial.moving > 1 && initial.angle() < 0.3 && initial.signs.min() > 0.0;
    is_near.then_some(initial.explained)
}

/// Typical deviation of the vehicle's rotation from its mean, rad/s, according to the attitude and
/// to the gyro, with noise smoothed out. A steady spin does not show whether the two match.
pub(super) fn rotation_rates(flight: &Flight) -> Option<[f64; 2]> {
    changes(&AttitudeAndGyro::of(flight, |q| q))
}

/// Typical distance from the mean of the stream's derivative and of the expected one.
fn changes(pair: &impl Pair) -> Option<[f64; 2]> {
    let typical = |values: Vec<Vector3<f64>>| {
        let count = values.len() as f64;
        let mean = values.iter().sum::<Vector3<f64>>() / count;
        let distances = values.iter().map(|value| (value - mean).norm()).collect();
        (count > 0.0).then(|| median(distances))
    };
    let bumps = || pair.bumps().iter().filter(|bump| bump.group == 0);
    let measured = bumps().filter_map(|bump| pair.measured(*bump)).collect();
    let expected = |bump: &Bump| Some(pair.expected(*bump, 0.0, &Correction::NONE)?.value);
    Some([typical(measured)?, typical(bumps().filter_map(expected).collect())?])
}

fn half_width(periods: [Option<f64>; 2]) -> f64 {
    periods.into_iter().flatten().fold(HALF, |half, period| half.max(HALF_PERIODS * period))
}

fn vector(v: [f64; 3]) -> Vector3<f64> {
    Vector3::from(v)
}

/// The rotation vector of a rotation, rad.
fn rotation_vector(q: Attitude) -> Vector3<f64> {
    let q = q.canonical();
    let v = Vector3::new(q.x, q.y, q.z);
    let sine = v.norm();
    if sine < 1e-9 { 2.0 * v } else { v * (2.0 * sine.atan2(q.w) / sine) }
}

/// The rotation of a rotation vector, rad.
fn of_vector(v: Vector3<f64>) -> Attitude {
    let angle = v.norm();
    let (sine, w) = (0.5 * angle).sin_cos();
    let [x, y, z] = if angle > 0.0 { (v * (sine / angle)).into() } else { [0.0; 3] };
    Attitude { w, x, y, z }
}

/// Three vectors that are weighted together.
type StackedVectors = SVector<f64, 9>;

fn stacked(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>) -> StackedVectors {
    let mut all = StackedVectors::zeros();
    all.fixed_rows_mut::<3>(0).copy_from(&a);
    all.fixed_rows_mut::<3>(3).copy_from(&b);
    all.fixed_rows_mut::<3>(6).copy_from(&c);
    all
}

/// The 90 % quantile of an attitude's rate of rotation, rad/s.
fn fastest(attitude: &Stream<Attitude>) -> f64 {
    let pairs = attitude.times().windows(2).zip(attitude.values().windows(2));
    let mut paces: Vec<f64> =
        pairs.map(|(times, q)| q[0].angle_to(q[1]) / (times[1] - times[0])).collect();
    paces.sort_by(f64::total_cmp);
    paces.get(paces.len() * 9 / 10).copied().unwrap_or(0.0)
}

/// Attitude against the gyro. Within a bump the attitude is the rotation vector relative to its
/// middle, whose derivative is the body rate times the inverse of its right Jacobian.
pub(super) struct AttitudeAndGyro<'a> {
    attitude: Stream<Attitude>,
    rate: &'a Stream<Frd>,
    bumps: Vec<Bump>,
}

impl<'a> AttitudeAndGyro<'a> {
    pub fn of(flight: &'a Flight, read: Reading) -> Self {
        Self::new(flight.attitude.map(|q| read(*q)), &flight.body_rate)
    }

    pub fn new(attitude: Stream<Attitude>, rate: &'a Stream<Frd>) -> Self {
        let half = half_width([attitude.period(), rate.period()]);
        // A longer one might contain half a turn.
        let half = half.min((TURN_MAX / fastest(&attitude)).max(HALF_MIN));
        let bumps = bumps(attitude.times(), &[half]);
        Self { attitude, rate, bumps }
    }

    /// The rotation vector of the attitude at `time` relative to `middle`, rad.
    fn turn(&self, middle: Attitude, time: f64) -> Option<Vector3<f64>> {
        let now = interpolated(&self.attitude, time)?;
        Some(rotation_vector(middle.inverse().compose(now)))
    }
}

impl Pair for AttitudeAndGyro<'_> {
    fn bumps(&self) -> &[Bump] {
        &self.bumps
    }

    fn measured(&self, bump: Bump) -> Option<Vector3<f64>> {
        let middle = interpolated(&self.attitude, bump.centre)?;
        let turn = |_, q: &Attitude| Some(rotation_vector(middle.inverse().compose(*q)));
        Some(-integrate(&self.attitude, bump, turn)?.slope / bump.area())
    }

    fn expected(&self, bump: Bump, delay: f64, correction: &Correction) -> Option<Expected> {
        let middle = interpolated(&self.attitude, bump.centre + delay)?;
        let BumpIntegrals { value, slope } = integrate(self.rate, bump, |time, rate: &Frd| {
            let unbiased = vector(rate.to_array()) - correction.bias;
            let rate = correction.map * unbiased;
            // Outside the bump's support the rotation does not matter.
            let turn = self.turn(middle, time + delay).unwrap_or_default();
            // The inverse of the right Jacobian, to second order.
            let turning = rate + turn.cross(&rate) / 2.0 + turn.cross(&turn.cross(&rate)) / 12.0;
            Some(stacked(turning, unbiased, Vector3::zeros()))
        })?;
        let part =
            |of: StackedVectors, at: usize| of.fixed_rows::<3>(at).into_owned() / bump.area();
        Some(Expected {
            value: part(value, 0),
            by_delay: part(slope, 0),
            unbiased: part(value, 3),
            bias: -Matrix3::identity(),
        })
    }
}

/// Position against velocity.
pub(super) struct PositionAndVelocity<'a> {
    position: &'a Stream<Ned>,
    velocity: &'a Stream<Ned>,
    bumps: Vec<Bump>,
}

impl<'a> PositionAndVelocity<'a> {
    pub fn of(flight: &'a Flight) -> Self {
        Self::new(&flight.position, &flight.velocity)
    }

    pub fn new(position: &'a Stream<Ned>, velocity: &'a Stream<Ned>) -> Self {
        let half = half_width([position.period(), velocity.period()]);
        let bumps = bumps(position.times(), &[half, LONGER * half]);
        Self { position, velocity, bumps }
    }
}

impl Pair for PositionAndVelocity<'_> {
    fn bumps(&self) -> &[Bump] {
        &self.bumps
    }

    fn measured(&self, bump: Bump) -> Option<Vector3<f64>> {
        // Relative to the bump's middle, so that a position far from the origin loses no precision.
        let origin = vector(self.position.held_at(bump.centre)?.to_array());
        let from_there = |_, p: &Ned| Some(vector(p.to_array()) - origin);
        Some(-integrate(self.position, bump, from_there)?.slope / bump.area())
    }

    fn expected(&self, bump: Bump, _: f64, correction: &Correction) -> Option<Expected> {
        let velocity = integrate(self.velocity, bump, |_, v| Some(vector(v.to_array())))?;
        Some(Expected::of(velocity, bump, correction))
    }
}

/// Velocity against a specific force, with an attitude of known delay.
pub(super) struct VelocityAndForce<'a> {
    velocity: &'a Stream<Ned>,
    /// Attitude and specific force.
    force: Stream<(Attitude, Vector3<f64>)>,
    bumps: Vec<Bump>,
    /// Whether only horizontal components are compared.
    is_level: bool,
}

/// Acceleration in the world, and the attitude's matrix by columns.
type ForceColumns = SVector<f64, 12>;

impl<'a> VelocityAndForce<'a> {
    /// With `specific_force`, and an attitude that is `attitude_late` (s) late and `turned` (rad).
    pub fn by_accelerometer(
        flight: &'a Flight,
        specific_force: &Stream<Frd>,
        attitude_late: f64,
        turned: [f64; 3],
    ) -> Self {
        let mut force = Stream::default();
        let turn = of_vector(vector(turned));
        for (time, f) in specific_force.iter() {
            if let Some(attitude) = interpolated(&flight.attitude, time + attitude_late) {
                force.push(time, (attitude.compose(turn), vector(f.to_array())));
            }
        }
        Self::of(flight, force, false)
    }

    /// With the thrust that holds the height.
    pub fn by_lean(flight: &'a Flight) -> Self {
        let force = flight.attitude.filter_map(|q| {
            let upright = q.to_world(Frd::new(0.0, 0.0, 1.0)).to_array()[2];
            let thrust = Vector3::new(0.0, 0.0, -GRAVITY / upright);
            (upright > LEAN_MAX.cos()).then_some((*q, thrust))
        });
        Self::of(flight, force, true)
    }

    fn of(flight: &'a Flight, force: Stream<(Attitude, Vector3<f64>)>, is_level: bool) -> Self {
        let velocity = &flight.velocity;
        let half = half_width([velocity.period(), force.period()]);
        let bumps = bumps(velocity.times(), &[half, LONGER * half]);
        Self { velocity, force, bumps, is_level }
    }
}

impl Pair for VelocityAndForce<'_> {
    fn bumps(&self) -> &[Bump] {
        &self.bumps
    }

    fn measured(&self, bump: Bump) -> Option<Vector3<f64>> {
        let gained = integrate(self.velocity, bump, |_, v| Some(vector(v.to_array())))?;
        let mut gained = -gained.slope / bump.area();
        if self.is_level {
            gained.z = 0.0;
        }
        Some(gained)
    }

    fn expected(&self, bump: Bump, _: f64, correction: &Correction) -> Option<Expected> {
        let BumpIntegrals { value, slope } =
            integrate(&self.force, bump, |_, (attitude, force)| {
                let axis = |v: Vector3<f64>| {
                    vector(attitude.to_world(Frd::from(<[f64; 3]>::from(v))).to_array())
                };
                let acceleration = axis(force - correction.bias) + Vector3::z() * GRAVITY;
                let mut columns_of_force = ForceColumns::zeros();
                columns_of_force.fixed_rows_mut::<3>(0).copy_from(&acceleration);
                for i in 0..3 {
                    columns_of_force
                        .fixed_rows_mut::<3>(3 + 3 * i)
                        .copy_from(&axis(Vector3::ith(i, 1.0)));
                }
                Some(columns_of_force)
            })?;
        let part = |of: &ForceColumns, at: usize| of.fixed_rows::<3>(at).into_owned() / bump.area();
        let columns = [part(&value, 3), part(&value, 6), part(&value, 9)];
        let mut unbiased = part(&value, 0);
        let mut by_delay = part(&slope, 0);
        let mut bias = -Matrix3::from_columns(&columns);
        if self.is_level {
            (unbiased.z, by_delay.z) = (0.0, 0.0);
            bias.row_mut(2).fill(0.0);
            // Along the thrust, a bias is a scale.
            bias.column_mut(2).fill(0.0);
        }
        let map = correction.map;
        Some(Expected { value: map * unbiased, by_delay: map * by_delay, unbiased, bias })
    }

    fn rotatable_axes(&self) -> [bool; 3] {
        [false, false, true]
    }
}

/// Attitude against its setpoint: lean and heading themselves, not their derivatives.
struct AttitudeAndSetpoint {
    attitude: Stream<Vector3<f64>>,
    setpoint: Stream<Vector3<f64>>,
    bumps: Vec<Bump>,
}

impl AttitudeAndSetpoint {
    fn of(flight: &Flight) -> Self {
        let attitude = leans(&flight.attitude);
        let setpoint = leans(&flight.setpoint.filter_map(|setpoint| setpoint.attitude));
        let half = half_width([attitude.period(), setpoint.period()]);
        let bumps = bumps(attitude.times(), &[half]);
        Self { attitude, setpoint, bumps }
    }
}

/// The lean to the north and to the east, and the heading without jumps. The lean is in world axes,
/// so that a heading error does not rotate it.
fn leans(attitude: &Stream<Attitude>) -> Stream<Vector3<f64>> {
    let mut yaw = 0.0;
    attitude.map(|q| {
        yaw += wrap_angle(q.yaw() - yaw);
        let [north, east, _] = q.to_world(Frd::new(0.0, 0.0, -1.0)).to_array();
        Vector3::new(north, east, yaw)
    })
}

impl Pair for AttitudeAndSetpoint {
    fn bumps(&self) -> &[Bump] {
        &self.bumps
    }

    fn measured(&self, bump: Bump) -> Option<Vector3<f64>> {
        Some(integrate(&self.attitude, bump, |_, lean| Some(*lean))?.value / bump.area())
    }

    fn expected(&self, bump: Bump, _: f64, correction: &Correction) -> Option<Expected> {
        let lean = integrate(&self.setpoint, bump, |_, lean| Some(*lean))?;
        Some(Expected::of(lean, bump, correction))
    }
}
