//! Two streams of one motion: under a bump, what one shows, and what the other says of it.

use nalgebra::{Matrix3, Vector3};

use super::weak::Bump;

/// What the other sensor says under a bump, as means over it.
pub(super) struct Expected {
    /// In the stream's axes: with the bias off, scaled and turned.
    pub value: Vector3<f64>,
    /// How the value changes with the delay, 1/s.
    pub late: Vector3<f64>,
    /// In the sensor's axes: with the bias off.
    pub plain: Vector3<f64>,
    /// How `plain` changes with the bias.
    pub bias: Matrix3<f64>,
}

/// What is subtracted from the other sensor, and how it is scaled and turned.
#[derive(Clone, Copy)]
pub(super) struct Correction {
    pub map: Matrix3<f64>,
    pub bias: Vector3<f64>,
}

impl Correction {
    pub const NONE: Self = Self {
        map: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        bias: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// Two streams of one motion.
pub(super) trait Pair {
    /// Moments that are compared, in their order.
    fn bumps(&self) -> &[Bump];

    /// The stream's derivative, as a mean over a bump.
    fn seen(&self, bump: Bump) -> Option<Vector3<f64>>;

    /// What the other sensor says under a bump of its own time, if the stream is `delay` later.
    fn expected(&self, bump: Bump, delay: f64, correction: &Correction) -> Option<Expected>;

    /// About which axes the stream may be turned.
    fn turns(&self) -> [bool; 3] {
        [true; 3]
    }
}
