//! Vectors and attitudes typed by frame: world NED (north, east, down) and body FRD (front, right,
//! down).
//!
//! The types do not distinguish bodies or instants of time.

mod heading;

use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

pub use self::heading::Heading;
use crate::scalar::Scalar;

/// Marks the world frame: north, east, down.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct World;

/// Marks the body frame: front, right, down.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Body;

/// Three components in frame `F`; in SI units unless the name of the value says otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec3<F, T = f64> {
    components: [T; 3],
    frame: PhantomData<F>,
}

/// A vector in world axes: north, east, down.
pub type Ned<T = f64> = Vec3<World, T>;
/// A vector in body axes: front, right, down.
pub type Frd<T = f64> = Vec3<Body, T>;

impl<F, T: Copy> Vec3<F, T> {
    /// Creates a vector from components in the order of the frame's axes.
    #[inline(always)]
    pub const fn new(x: T, y: T, z: T) -> Self {
        Self { components: [x, y, z], frame: PhantomData }
    }

    /// The components as an array.
    #[inline(always)]
    pub const fn to_array(self) -> [T; 3] {
        self.components
    }

    /// Applies `f` to each component.
    #[inline(always)]
    pub fn map<U>(self, f: impl FnMut(T) -> U) -> Vec3<F, U> {
        Vec3 { components: self.components.map(f), frame: PhantomData }
    }
}

impl<F, T> From<[T; 3]> for Vec3<F, T> {
    #[inline(always)]
    fn from(components: [T; 3]) -> Self {
        Self { components, frame: PhantomData }
    }
}

impl<F, T: Copy> From<Vec3<F, T>> for [T; 3] {
    fn from(v: Vec3<F, T>) -> Self {
        v.to_array()
    }
}

impl<T: Copy> Ned<T> {
    /// Component towards true north.
    #[inline(always)]
    pub const fn north(&self) -> T {
        self.components[0]
    }

    /// Component towards east.
    #[inline(always)]
    pub const fn east(&self) -> T {
        self.components[1]
    }

    /// Component towards the centre of the earth.
    #[inline(always)]
    pub const fn down(&self) -> T {
        self.components[2]
    }
}

impl<T: Copy> Frd<T> {
    /// Component out of the vehicle's front; as a rate, roll.
    #[inline(always)]
    pub const fn front(&self) -> T {
        self.components[0]
    }

    /// Component out of the vehicle's right side; as a rate, pitch.
    #[inline(always)]
    pub const fn right(&self) -> T {
        self.components[1]
    }

    /// Component out of the vehicle's belly; as a rate, yaw.
    #[inline(always)]
    pub const fn down(&self) -> T {
        self.components[2]
    }
}

impl<F: Copy, T: Scalar> Vec3<F, T> {
    /// The zero vector.
    pub fn zero() -> Self {
        Self::new(T::default(), T::default(), T::default())
    }

    /// Inner product.
    #[inline(always)]
    pub fn dot(self, other: Self) -> T {
        let ([a, b, c], [x, y, z]) = (self.components, other.components);
        a * x + b * y + c * z
    }

    /// Vector product; both frames are right-handed.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.components, other.components);
        Self::new(b * z - c * y, c * x - a * z, a * y - b * x)
    }

    /// Euclidean norm.
    #[inline(always)]
    pub fn norm(self) -> T {
        self.dot(self).sqrt()
    }

    /// Component-wise product: multiplies by a diagonal matrix.
    #[inline(always)]
    pub fn scale_by(self, diagonal: [T; 3]) -> Self {
        let ([a, b, c], [x, y, z]) = (self.components, diagonal);
        Self::new(a * x, b * y, c * z)
    }
}

impl<F> Vec3<F, f64> {
    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        self.components.iter().all(|c| c.is_finite())
    }
}

impl<F, T: Scalar> Add for Vec3<F, T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.components, other.components);
        Self::new(a + x, b + y, c + z)
    }
}

impl<F, T: Scalar> AddAssign for Vec3<F, T> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        for (mine, theirs) in self.components.iter_mut().zip(other.components) {
            *mine += theirs;
        }
    }
}

impl<F, T: Scalar> Sub for Vec3<F, T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.components, other.components);
        Self::new(a - x, b - y, c - z)
    }
}

impl<F, T: Scalar> Neg for Vec3<F, T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|c| -c)
    }
}

impl<F, T: Scalar> Mul<T> for Vec3<F, T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: T) -> Self {
        self.map(|c| c * factor)
    }
}

/// An attitude: the rotation from body FRD to world NED, as a unit quaternion w, x, y, z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude<T = f64> {
    /// Scalar part.
    pub w: T,
    /// Vector part, front/north.
    pub x: T,
    /// Vector part, right/east.
    pub y: T,
    /// Vector part, down.
    pub z: T,
}

/// Euler angles of the yaw-pitch-roll (z-y-x) sequence, body with respect to world, in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Euler<T = f64> {
    /// Rotation about the body's front axis, positive right side down.
    pub roll: T,
    /// Rotation about the intermediate right axis, positive nose up.
    pub pitch: T,
    /// Rotation about down, positive from north to east.
    pub yaw: T,
}

impl<T: Scalar> Default for Attitude<T> {
    fn default() -> Self {
        Self { w: T::from(1.0), x: T::default(), y: T::default(), z: T::default() }
    }
}

impl<T: Scalar> Attitude<T> {
    /// Transforms `v` from body axes to world axes.
    #[inline(always)]
    pub fn to_world(self, v: Frd<T>) -> Ned<T> {
        Ned::from(self.rotate(v.to_array()))
    }

    /// Transforms `v` from world axes to body axes.
    #[inline(always)]
    pub fn to_body(self, v: Ned<T>) -> Frd<T> {
        Frd::from(self.inverse().rotate(v.to_array()))
    }

    /// The inverse rotation, for a unit quaternion.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        Self { w: self.w, x: -self.x, y: -self.y, z: -self.z }
    }

    /// v + 2 w (r x v) + 2 r x (r x v), with r the vector part.
    #[inline(always)]
    fn rotate(self, v: [T; 3]) -> [T; 3] {
        let [a, b, c] = v;
        let (tx, ty, tz) = (
            (self.y * c - self.z * b) * 2.0,
            (self.z * a - self.x * c) * 2.0,
            (self.x * b - self.y * a) * 2.0,
        );
        [
            a + self.w * tx + self.y * tz - self.z * ty,
            b + self.w * ty + self.z * tx - self.x * tz,
            c + self.w * tz + self.x * ty - self.y * tx,
        ]
    }

    /// Hamilton product `self * other`: first `other`, then `self`.
    #[inline(always)]
    pub fn compose(self, other: Self) -> Self {
        let (p, q) = (self, other);
        Self {
            w: p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z,
            x: p.w * q.x + p.x * q.w + p.y * q.z - p.z * q.y,
            y: p.w * q.y - p.x * q.z + p.y * q.w + p.z * q.x,
            z: p.w * q.z + p.x * q.y - p.y * q.x + p.z * q.w,
        }
    }

    /// Time derivative of the quaternion, half of `self * (0, body_rate)`, in 1/s.
    #[inline(always)]
    pub fn derivative(self, body_rate: Frd<T>) -> [T; 4] {
        let [p, q, r] = body_rate.to_array();
        [
            (self.x * p + self.y * q + self.z * r) * -0.5,
            (self.w * p + self.y * r - self.z * q) * 0.5,
            (self.w * q + self.z * p - self.x * r) * 0.5,
            (self.w * r + self.x * q - self.y * p) * 0.5,
        ]
    }

    /// The quaternion scaled to unit norm.
    #[inline(always)]
    pub fn normalized(self) -> Self {
        let norm = (self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z).sqrt();
        let inverse = T::from(1.0) / norm;
        Self { w: self.w * inverse, x: self.x * inverse, y: self.y * inverse, z: self.z * inverse }
    }

    /// Euler angles; pitch in [-pi/2, pi/2], roll and yaw in (-pi, pi].
    pub fn euler(self) -> Euler<T> {
        let (w, x, y, z) = (self.w, self.x, self.y, self.z);
        let one = T::from(1.0);
        let sin_pitch = ((w * y - x * z) * 2.0).min(one).max(-one);
        Euler {
            roll: ((w * x + y * z) * 2.0).atan2(one - (x * x + y * y) * 2.0),
            pitch: sin_pitch.asin(),
            yaw: self.yaw(),
        }
    }

    /// The yaw of [`Attitude::euler`].
    pub fn yaw(self) -> T {
        let (w, x, y, z) = (self.w, self.x, self.y, self.z);
        ((w * z + x * y) * 2.0).atan2(T::from(1.0) - (y * y + z * z) * 2.0)
    }
}

impl Attitude {
    /// The same attitude, as a constant of another number type.
    pub fn lift<T: Scalar>(self) -> Attitude<T> {
        let Self { w, x, y, z } = self;
        Attitude { w: w.into(), x: x.into(), y: y.into(), z: z.into() }
    }

    /// The same rotation with w >= 0, which avoids jumps in plots.
    pub fn canonical(self) -> Self {
        if self.w < 0.0 { Self { w: -self.w, x: -self.x, y: -self.y, z: -self.z } } else { self }
    }

    /// The attitude from a message's w, x, y, z.
    ///
    /// Returns `None` unless the four are finite and their norm is within 1 % of 1.
    pub fn from_wire([w, x, y, z]: [f32; 4]) -> Option<Self> {
        let q = Self { w: w.into(), x: x.into(), y: y.into(), z: z.into() };
        let norm = (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
        // Also false for NaN.
        ((norm - 1.0).abs() < 0.01).then(|| q.normalized())
    }

    /// w, x, y, z for a message, with w >= 0.
    pub fn to_wire(self) -> [f32; 4] {
        let q = self.canonical();
        [q.w as f32, q.x as f32, q.y as f32, q.z as f32]
    }

    /// Angle between body down and world down, in [0, pi], in radians.
    pub fn tilt(self) -> f64 {
        let (across, along) = (self.x.powi(2) + self.y.powi(2), self.w.powi(2) + self.z.powi(2));
        2.0 * across.sqrt().atan2(along.sqrt())
    }

    /// Interpolates the shorter way to `other`: the normalised weighted mean of the quaternions,
    /// which approximates a constant rate for small angles.
    pub fn between(self, other: Self, share: f64) -> Self {
        let dot = self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z;
        let to = if dot < 0.0 { -share } else { share };
        let mix = |a: f64, b: f64| a * (1.0 - share) + b * to;
        Self {
            w: mix(self.w, other.w),
            x: mix(self.x, other.x),
            y: mix(self.y, other.y),
            z: mix(self.z, other.z),
        }
        .normalized()
    }

    /// The shorter rotation from `self` to `other` as angle times axis (rad), in body axes of
    /// `self`.
    pub fn rotation_to(self, other: Self) -> Frd {
        let d = self.inverse().compose(other).canonical();
        let sine = (d.x * d.x + d.y * d.y + d.z * d.z).sqrt();
        // angle / sin(angle / 2), which tends to 2.
        let scale = if sine < 1e-9 { 2.0 } else { 2.0 * sine.atan2(d.w) / sine };
        Frd::new(d.x, d.y, d.z) * scale
    }

    /// Angle of the rotation from `self` to `other`, in [0, pi], in radians.
    pub fn angle_to(self, other: Self) -> f64 {
        let d = self.inverse().compose(other);
        2.0 * (d.x * d.x + d.y * d.y + d.z * d.z).sqrt().atan2(d.w.abs())
    }
}

impl<T: Scalar> Euler<T> {
    /// Creates the angles from roll, pitch and yaw in radians.
    pub const fn new(roll: T, pitch: T, yaw: T) -> Self {
        Self { roll, pitch, yaw }
    }

    /// The same attitude as a quaternion.
    pub fn attitude(self) -> Attitude<T> {
        let (sr, cr) = (self.roll * 0.5).sin_cos();
        let (sp, cp) = (self.pitch * 0.5).sin_cos();
        let (sy, cy) = (self.yaw * 0.5).sin_cos();
        Attitude {
            w: cr * cp * cy + sr * sp * sy,
            x: sr * cp * cy - cr * sp * sy,
            y: cr * sp * cy + sr * cp * sy,
            z: cr * cp * sy - sr * sp * cy,
        }
    }

    /// Time derivative of roll, pitch and yaw at `body_rate`, in rad/s (Bansal et al., eq. 3).
    /// Singular at pitch = +-pi/2.
    pub fn rates(self, body_rate: Frd<T>) -> [T; 3] {
        let [p, q, r] = body_rate.to_array();
        let (sr, cr) = self.roll.sin_cos();
        let (sp, cp) = self.pitch.sin_cos();
        let turn = q * sr + r * cr;
        [p + turn * sp / cp, q * cr - r * sr, turn / cp]
    }

    /// Body rate at which the angles change at `rates` (rad/s); the inverse of [`Euler::rates`].
    pub fn body_rate(self, rates: [T; 3]) -> Frd<T> {
        let [roll_rate, pitch_rate, yaw_rate] = rates;
        let (sr, cr) = self.roll.sin_cos();
        let (sp, cp) = self.pitch.sin_cos();
        Frd::new(
            roll_rate - yaw_rate * sp,
            pitch_rate * cr + yaw_rate * sr * cp,
            yaw_rate * cr * cp - pitch_rate * sr,
        )
    }
}

/// `angle` wrapped to [-pi, pi), in radians.
pub fn wrap_angle<T: Scalar>(angle: T) -> T {
    let turns = ((angle.value() + std::f64::consts::PI) / std::f64::consts::TAU).floor();
    if turns == 0.0 { angle } else { angle + -turns * std::f64::consts::TAU }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn angles() -> impl Strategy<Value = Euler> {
        (-3.1..3.1, -1.5..1.5, -3.1..3.1).prop_map(|(r, p, y)| Euler::new(r, p, y))
    }

    #[test]
    fn heading_east_turns_front_to_east() {
        let front = Euler::new(0.0, 0.0, FRAC_PI_2).attitude().to_world(Frd::new(1.0, 0.0, 0.0));
        assert!((front.east() - 1.0).abs() < 1e-12 && front.north().abs() < 1e-12);
    }

    #[test]
    fn positive_pitch_lifts_the_nose_and_positive_roll_lowers_the_right_side() {
        let nose = Euler::new(0.0, 0.1, 0.0).attitude().to_world(Frd::new(1.0, 0.0, 0.0));
        assert!(nose.down() < 0.0);
        let right = Euler::new(0.1, 0.0, 0.0).attitude().to_world(Frd::new(0.0, 1.0, 0.0));
        assert!(right.down() > 0.0);
    }

    #[test]
    fn wire_quaternion_refuses_nan_and_zero() {
        assert!(Attitude::from_wire([f32::NAN, 0.0, 0.0, 0.0]).is_none());
        assert!(Attitude::from_wire([0.0; 4]).is_none());
        assert!(Attitude::from_wire([1.0, 0.0, 0.0, 0.0]).is_some());
    }

    proptest! {
        #[test]
        fn euler_and_quaternion_round_trip(e in angles()) {
            let back = e.attitude().euler();
            prop_assert!((back.roll - e.roll).abs() < 1e-9);
            prop_assert!((back.pitch - e.pitch).abs() < 1e-9);
            prop_assert!((back.yaw - e.yaw).abs() < 1e-9);
        }

        #[test]
        fn rotation_keeps_length_and_is_undone_by_its_inverse(e in angles(), x in -9.0..9.0, y in -9.0..9.0, z in -9.0..9.0) {
            let v = Frd::new(x, y, z);
            let world = e.attitude().to_world(v);
            prop_assert!((world.norm() - v.norm()).abs() < 1e-9);
            prop_assert!((e.attitude().to_body(world) - v).norm() < 1e-9);
        }

        #[test]
        fn composition_is_associative_with_rotation(a in angles(), b in angles()) {
            let v = Frd::new(0.3, -1.0, 2.0);
            let (p, q) = (a.attitude(), b.attitude());
            let once = p.compose(q).to_world(v);
            let twice = p.to_world(Frd::from(q.to_world(v).to_array()));
            prop_assert!((once - twice).norm() < 1e-9);
        }

        #[test]
        fn body_rate_inverts_euler_rates(e in angles(), p in -5.0..5.0, q in -5.0..5.0, r in -5.0..5.0) {
            let rate = Frd::new(p, q, r);
            prop_assert!((e.body_rate(e.rates(rate)) - rate).norm() < 1e-8);
        }

        #[test]
        fn wrapped_angle_differs_by_whole_turns(angle in -100.0..100.0f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!((-PI..PI).contains(&wrapped));
            let turns = (angle - wrapped) / (2.0 * PI);
            prop_assert!((turns - turns.round()).abs() < 1e-9);
        }
    }
}
