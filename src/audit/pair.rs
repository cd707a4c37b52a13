//! Two streams of one motion: under a bump, the derivative of one and its prediction from the
//! other.

use nalgebra::{Matrix3, Vector3};

use super::weak::{Bump, BumpIntegrals};

/// The prediction of the other sensor under a bump, as means over it.
pub(super) struct Expected {
    /// In the stream's axes: without the bias, scaled and rotated.
    pub value: Vector3<f64>,
    /// Derivative of the value with respect to the delay, 1/s.
    pub by_delay: Vector3<f64>,
    /// In the sensor's axes: without the bias.
    pub unbiased: Vector3<f64>,
    /// Derivative of `unbiased` with respect to the bias.
    pub bias: Matrix3<f64>,
}

impl Expected {
    /// The prediction of a signal under `bump` that needs the correction alone.
    pub fn of(integrals: BumpIntegrals<3>, bump: Bump, correction: &Correction) -> Self {
        let unbiased = integrals.value / bump.area() - correction.bias;
        Self {
            value: correction.map * unbiased,
            by_delay: correction.map * integrals.slope / bump.area(),
            unbiased,
            bias: -Matrix3::identity(),
        }
    }
}

/// The bias of the other sensor, and the map that scales and rotates it.
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
    /// Moments to compare, in order.
    fn bumps(&self) -> &[Bump];

    /// The stream's derivative, averaged over a bump.
    fn measured(&self, bump: Bump) -> Option<Vector3<f64>>;

    /// The other sensor's prediction under a bump of its own time, if the stream is `delay` later.
    fn expected(&self, bump: Bump, delay: f64, correction: &Correction) -> Option<Expected>;

    /// Axes about which the stream may be rotated.
    fn rotatable_axes(&self) -> [bool; 3] {
        [true; 3]
    }
}
