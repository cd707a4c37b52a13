//! A formula as a flat postfix program. Evaluation does not allocate and works for any scalar; dual
//! numbers give exact derivatives.

use super::quantity::{Needed, QUANTITIES, Quantity};
use crate::scalar::Scalar;

/// Largest number of operations in a formula.
pub const OPERATIONS_MAX: usize = 96;
/// Size of the evaluation stack.
pub const STACK_MAX: usize = 16;
/// Smallest magnitude of a divisor, and of the argument of a root or a real power, which have no
/// finite derivative at 0.
const LEAST: f64 = 1e-9;
/// Bound on the magnitude of an exponent of e.
const EXPONENT_MAX: f64 = 50.0;

/// One instruction of the stack machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Operation {
    /// Pushes a constant.
    Constant(f64),
    /// Pushes a quantity, clamped to the law's range.
    Quantity(Quantity),
    /// Replaces the top two numbers with one.
    Binary(Binary),
    /// Replaces the top number.
    Unary(Unary),
}

/// An operation on two numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Least,
    Greatest,
}

/// An operation on one number.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Unary {
    Negate,
    Absolute,
    Root,
    Exponential,
    Sine,
    Cosine,
    /// An integer power.
    IntegerPower(i8),
    /// A real power; the base is clamped to positive values.
    Power(f64),
}

/// A checked formula.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    operations: Vec<Operation>,
    needed: Needed,
}

impl Program {
    /// Checks that the operations leave one number, fit the stack of `STACK_MAX` and are at most
    /// [`OPERATIONS_MAX`]. Returns `None` otherwise.
    pub fn new(operations: Vec<Operation>) -> Option<Self> {
        let (mut depth, mut needed) = (0_usize, Needed::default());
        for operation in &operations {
            match operation {
                Operation::Constant(_) => depth += 1,
                Operation::Quantity(quantity) => {
                    depth += 1;
                    needed = needed.with(*quantity);
                }
                Operation::Binary(_) => depth = depth.checked_sub(1).filter(|d| *d > 0)?,
                Operation::Unary(_) => depth = Some(depth).filter(|d| *d > 0)?,
            }
            if depth > STACK_MAX {
                return None;
            }
        }
        let fits = depth == 1 && operations.len() <= OPERATIONS_MAX;
        fits.then_some(Self { operations, needed })
    }

    /// The quantities that the formula reads.
    pub fn needed(&self) -> Needed {
        self.needed
    }

    /// Evaluates the formula with each quantity clamped to its limits. Returns 0 if the result is
    /// not finite.
    pub fn value<T: Scalar>(
        &self,
        quantities: &[T; QUANTITIES],
        limits: &[[f64; 2]; QUANTITIES],
    ) -> T {
        let mut stack = [T::default(); STACK_MAX];
        let mut top = 0;
        // `new` has checked that the stack neither underflows nor overflows.
        for operation in &self.operations {
            match *operation {
                Operation::Constant(value) => {
                    stack[top] = T::from(value);
                    top += 1;
                }
                Operation::Quantity(quantity) => {
                    let [low, high] = limits[quantity as usize];
                    let value = quantities[quantity as usize];
                    stack[top] = value.max(T::from(low)).min(T::from(high));
                    top += 1;
                }
                Operation::Binary(binary) => {
                    top -= 1;
                    stack[top - 1] = binary.of(stack[top - 1], stack[top]);
                }
                Operation::Unary(unary) => stack[top - 1] = unary.of(stack[top - 1]),
            }
        }
        let value = stack[0];
        if value.value().is_finite() { value } else { T::default() }
    }
}

impl Binary {
    #[inline]
    fn of<T: Scalar>(self, a: T, b: T) -> T {
        match self {
            Self::Add => a + b,
            Self::Subtract => a - b,
            Self::Multiply => a * b,
            Self::Divide => a / away_from_zero(b),
            Self::Least => a.min(b),
            Self::Greatest => a.max(b),
        }
    }
}

impl Unary {
    #[inline]
    fn of<T: Scalar>(self, x: T) -> T {
        match self {
            Self::Negate => -x,
            Self::Absolute => x.max(-x),
            Self::Root => above_zero(x).sqrt(),
            Self::Exponential => x.max(T::from(-EXPONENT_MAX)).min(T::from(EXPONENT_MAX)).exp(),
            Self::Sine => x.sin(),
            Self::Cosine => x.cos(),
            Self::Power(power) => above_zero(x).powf(power),
            Self::IntegerPower(power) => {
                let base = if power < 0 { T::from(1.0) / away_from_zero(x) } else { x };
                (0..power.unsigned_abs()).fold(T::from(1.0), |product, _| product * base)
            }
        }
    }
}

#[inline]
fn above_zero<T: Scalar>(x: T) -> T {
    x.max(T::from(LEAST))
}

#[inline]
fn away_from_zero<T: Scalar>(x: T) -> T {
    if x.is_above(0.0) { x.max(T::from(LEAST)) } else { x.min(T::from(-LEAST)) }
}
