//! The scalar of one lane in a block, with arithmetic that lets a loop over vehicles vectorise.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use crate::frame::{Attitude, Frd, Ned};
use crate::rigid_body::State;
use crate::scalar::Scalar;

/// Single or double precision.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Rounds to this precision.
    fn from_f64(value: f64) -> Self;
    /// Converts exactly to double precision.
    fn to_f64(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// The integer n nearest to `self`, and 2^n. Valid for |n| < 1000, or 126 in single precision.
    fn nearest_power_of_two(self) -> (Self, Self);
}

impl Real for f32 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    fn nearest_power_of_two(self) -> (Self, Self) {
        // Adding 1.5 * 2^23 leaves the integer in the lowest bits.
        let shifted = self + 12_582_912.0;
        let exponent = shifted.to_bits().wrapping_sub(12_582_912.0_f32.to_bits());
        (shifted - 12_582_912.0, f32::from_bits(exponent.wrapping_add(127) << 23))
    }
}

impl Real for f64 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn nearest_power_of_two(self) -> (Self, Self) {
        const SHIFT: f64 = 6_755_399_441_055_744.0;
        let shifted = self + SHIFT;
        let exponent = shifted.to_bits().wrapping_sub(SHIFT.to_bits());
        (shifted - SHIFT, f64::from_bits(exponent.wrapping_add(1023) << 52))
    }
}

/// A number of one vehicle. Its exponential is a polynomial, because a call would prevent
/// vectorisation. The equations of motion use no other transcendental functions, except in laws.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lane<F>(pub F);

/// Converts a state to double precision.
pub(super) fn state_of<F: Real>(state: &State<Lane<F>>) -> State {
    let Attitude { w, x, y, z } = state.attitude;
    let [w, x, y, z] = [w, x, y, z].map(|value| value.0.to_f64());
    State {
        position: Ned::from(state.position.to_array().map(|value| value.0.to_f64())),
        velocity: Ned::from(state.velocity.to_array().map(|value| value.0.to_f64())),
        attitude: Attitude { w, x, y, z },
        body_rate: Frd::from(state.body_rate.to_array().map(|value| value.0.to_f64())),
    }
}

/// Converts a state to this precision.
pub(super) fn state_from<F: Real>(state: &State) -> State<Lane<F>> {
    let Attitude { w, x, y, z } = state.attitude;
    let [w, x, y, z] = [w, x, y, z].map(Lane::from);
    State {
        position: state.position.map(Lane::from),
        velocity: state.velocity.map(Lane::from),
        attitude: Attitude { w, x, y, z },
        body_rate: state.body_rate.map(Lane::from),
    }
}

impl<F: Real> From<f64> for Lane<F> {
    #[inline(always)]
    fn from(value: f64) -> Self {
        Self(F::from_f64(value))
    }
}

macro_rules! operators {
    ($($operator:ident $method:ident)*) => {$(
        impl<F: Real> $operator for Lane<F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(self.0.$method(other.0))
            }
        }
    )*};
}
operators! { Add add  Sub sub  Mul mul  Div div }

impl<F: Real> Neg for Lane<F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<F: Real> AddAssign for Lane<F> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<F: Real> SubAssign for Lane<F> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<F: Real> Mul<f64> for Lane<F> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Self::from(factor)
    }
}

impl<F: Real> Add<f64> for Lane<F> {
    type Output = Self;
    #[inline(always)]
    fn add(self, offset: f64) -> Self {
        self + Self::from(offset)
    }
}

impl<F: Real> Scalar for Lane<F> {
    #[inline(always)]
    fn value(self) -> f64 {
        self.0.to_f64()
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }
    #[inline(always)]
    fn is_above(self, bound: f64) -> bool {
        self.0 > F::from_f64(bound)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if other.0 < self.0 { other } else { self }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if other.0 > self.0 { other } else { self }
    }
    fn sin(self) -> Self {
        Self::from(self.value().sin())
    }
    fn cos(self) -> Self {
        Self::from(self.value().cos())
    }

    /// The argument is clamped to -80..=80; within it the error is of the order of rounding.
    #[inline(always)]
    fn exp(self) -> Self {
        let x = self.max(Self::from(-80.0)).min(Self::from(80.0));
        // e^x = 2^n e^r with |r| <= ln 2 / 2. ln 2 is split in two, the first part with few digits.
        let (n, power) = (x * std::f64::consts::LOG2_E).0.nearest_power_of_two();
        let r = x - Self(n) * 0.693_145_751_953_125 - Self(n) * 1.428_606_820_309_417e-6;
        // Taylor series, to below rounding: 1 + r (1 + r/2 (1 + r/3 (...))).
        let term = |rest: Self, k: f64| rest * r * (1.0 / k) + 1.0;
        let tail = term(term(term(term(Self::from(1.0), 13.0), 12.0), 11.0), 10.0);
        let middle = term(term(term(term(term(tail, 9.0), 8.0), 7.0), 6.0), 5.0);
        term(term(term(term(middle, 4.0), 3.0), 2.0), 1.0) * Self(power)
    }
    fn powf(self, exponent: f64) -> Self {
        Self::from(self.value().powf(exponent))
    }
    fn atan2(self, x: Self) -> Self {
        Self::from(self.value().atan2(x.value()))
    }
    fn asin(self) -> Self {
        Self::from(self.value().asin())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exponential_matches_the_standard_library(x in -80.0..80.0_f64) {
            let double = Lane::<f64>(x).exp().0;
            prop_assert!((double / x.exp() - 1.0).abs() < 1e-13, "{double}");
            let single = Lane::<f32>(x as f32).exp().0;
            prop_assert!((single / (x as f32).exp() - 1.0).abs() < 1e-5, "{single}");
        }
    }
}
