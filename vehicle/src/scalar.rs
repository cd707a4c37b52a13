//! The number type of the physics: `f64`, or a dual number whose derivative part gives exact
//! Jacobians.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A real number, or one that carries derivatives.
///
/// Comparisons and branches in the physics depend on the value only.
pub trait Scalar:
    Copy
    + Debug
    + Default
    + From<f64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Mul<f64, Output = Self>
    + Add<f64, Output = Self>
{
    /// The value without its derivatives.
    fn value(self) -> f64;
    /// Square root; the derivative at 0 is infinite.
    fn sqrt(self) -> Self;
    /// Sine of an angle in radians.
    fn sin(self) -> Self;
    /// Cosine of an angle in radians.
    fn cos(self) -> Self;
    /// Natural exponential.
    fn exp(self) -> Self;
    /// `self` to a constant power.
    fn powf(self, exponent: f64) -> Self;
    /// Four-quadrant arc tangent of `self / x`, in radians.
    fn atan2(self, x: Self) -> Self;
    /// Arc sine, in radians.
    fn asin(self) -> Self;
    /// Whether the value is above `bound`.
    fn is_above(self, bound: f64) -> bool {
        self.value() > bound
    }

    /// The argument with the smaller value.
    fn min(self, other: Self) -> Self {
        if other.value() < self.value() { other } else { self }
    }

    /// The argument with the larger value.
    fn max(self, other: Self) -> Self {
        if other.value() > self.value() { other } else { self }
    }

    /// Sine and cosine together.
    fn sin_cos(self) -> (Self, Self) {
        (self.sin(), self.cos())
    }
}

impl Scalar for f64 {
    #[inline]
    fn value(self) -> f64 {
        self
    }
    #[inline]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline]
    fn sin(self) -> Self {
        f64::sin(self)
    }
    #[inline]
    fn cos(self) -> Self {
        f64::cos(self)
    }
    #[inline]
    fn exp(self) -> Self {
        f64::exp(self)
    }
    #[inline]
    fn powf(self, exponent: f64) -> Self {
        f64::powf(self, exponent)
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        f64::atan2(self, x)
    }
    #[inline]
    fn asin(self) -> Self {
        f64::asin(self)
    }
}

/// A dual number: a value and its derivatives with respect to `N` variables.
#[derive(Clone, Copy, Debug)]
pub struct Dual<const N: usize> {
    value: f64,
    gradient: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// Variable number `index` at `value`; its derivative with respect to itself is 1.
    ///
    /// # Panics
    /// If `index` is not below `N`.
    pub fn variable(value: f64, index: usize) -> Self {
        let mut gradient = [0.0; N];
        gradient[index] = 1.0;
        Self { value, gradient }
    }

    /// Derivatives with respect to the `N` variables.
    pub fn gradient(&self) -> &[f64; N] {
        &self.gradient
    }

    /// `f(self)`, given the value and the derivative of `f` at `self`.
    #[inline]
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { value, gradient: self.gradient.map(|d| d * slope) }
    }

    #[inline]
    fn zip(self, other: Self, value: f64, combine: impl Fn(f64, f64) -> f64) -> Self {
        let mut gradient = self.gradient;
        for (mine, theirs) in gradient.iter_mut().zip(other.gradient) {
            *mine = combine(*mine, theirs);
        }
        Self { value, gradient }
    }
}

impl<const N: usize> Default for Dual<N> {
    fn default() -> Self {
        Self::from(0.0)
    }
}

impl<const N: usize> From<f64> for Dual<N> {
    #[inline]
    fn from(value: f64) -> Self {
        Self { value, gradient: [0.0; N] }
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        self.zip(other, self.value + other.value, |a, b| a + b)
    }
}

#[allow(clippy::suspicious_arithmetic_impl)] // the rule of differentiation mixes operators
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        self.zip(other, self.value - other.value, |a, b| a - b)
    }
}

#[allow(clippy::suspicious_arithmetic_impl)] // the rule of differentiation mixes operators
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[inline]
    fn mul(self, other: Self) -> Self {
        let (x, y) = (self.value, other.value);
        self.zip(other, x * y, |a, b| a * y + x * b)
    }
}

#[allow(clippy::suspicious_arithmetic_impl)] // the rule of differentiation mixes operators
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[inline]
    fn div(self, other: Self) -> Self {
        let (quotient, y) = (self.value / other.value, other.value);
        self.zip(other, quotient, |a, b| (a - quotient * b) / y)
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl<const N: usize> AddAssign for Dual<N> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const N: usize> SubAssign for Dual<N> {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    #[inline]
    fn mul(self, factor: f64) -> Self {
        self.chain(self.value * factor, factor)
    }
}

impl<const N: usize> Add<f64> for Dual<N> {
    type Output = Self;
    #[inline]
    fn add(self, offset: f64) -> Self {
        Self { value: self.value + offset, ..self }
    }
}

impl<const N: usize> Scalar for Dual<N> {
    #[inline]
    fn value(self) -> f64 {
        self.value
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn sin(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(sin, cos)
    }
    fn cos(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(cos, -sin)
    }
    fn exp(self) -> Self {
        let exp = self.value.exp();
        self.chain(exp, exp)
    }
    fn powf(self, exponent: f64) -> Self {
        let slope = exponent * self.value.powf(exponent - 1.0);
        self.chain(self.value.powf(exponent), slope)
    }
    fn atan2(self, x: Self) -> Self {
        let norm2 = self.value * self.value + x.value * x.value;
        let (dy, dx) = (x.value / norm2, -self.value / norm2);
        self.zip(x, self.value.atan2(x.value), |a, b| a * dy + b * dx)
    }
    fn asin(self) -> Self {
        self.chain(self.value.asin(), 1.0 / (1.0 - self.value * self.value).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn composed<T: Scalar>(x: T, y: T) -> T {
        (x * y).sin() + (x / y).exp() * y.sqrt() - x.powf(1.7) * y.atan2(x).cos() + (x * 0.1).asin()
    }

    proptest! {
        #[test]
        fn gradient_matches_finite_differences(x in 0.2..2.0f64, y in 0.2..2.0f64) {
            let dual = composed(Dual::<2>::variable(x, 0), Dual::<2>::variable(y, 1));
            let h = 1e-6;
            let dx = (composed(x + h, y) - composed(x - h, y)) / (2.0 * h);
            let dy = (composed(x, y + h) - composed(x, y - h)) / (2.0 * h);
            prop_assert!((dual.gradient()[0] - dx).abs() < 1e-6 * (1.0 + dx.abs()));
            prop_assert!((dual.gradient()[1] - dy).abs() < 1e-6 * (1.0 + dy.abs()));
        }
    }
}
