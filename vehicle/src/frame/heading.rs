//! Level axes that turn with the yaw.

use super::Ned;

/// The axes front, right and down of a level vehicle with a yaw: Bansal et al. 2016, eq. 12.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    sin: f64,
    cos: f64,
}

impl Heading {
    /// The axes at a yaw, rad.
    pub fn new(yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        Self { sin, cos }
    }

    /// Front, right and down of a vector.
    pub fn to_level(self, vector: Ned) -> [f64; 3] {
        let Self { sin, cos } = self;
        let [north, east, down] = vector.to_array();
        [cos * north + sin * east, cos * east - sin * north, down]
    }

    /// The vector with these components along front, right and down.
    pub fn to_world(self, [front, right, down]: [f64; 3]) -> Ned {
        let Self { sin, cos } = self;
        Ned::new(cos * front - sin * right, sin * front + cos * right, down)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Euler, Frd};
    use super::*;

    #[test]
    fn level_axes_are_those_of_an_attitude_without_tilt() {
        for yaw in [0.0, 0.7, 2.0, -3.0] {
            let (heading, attitude) = (Heading::new(yaw), Euler::new(0.0, 0.0, yaw).attitude());
            let vector = Ned::new(0.3, -1.2, 0.5);
            let level = heading.to_level(vector);
            assert!((Frd::from(level) - attitude.to_body(vector)).norm() < 1e-12);
            assert!((heading.to_world(level) - vector).norm() < 1e-12);
        }
    }
}
