//! The rigid body: its state and the Newton-Euler equations.

use crate::frame::{Attitude, Frd, Ned};
use crate::scalar::Scalar;

/// State of the vehicle's rigid body: position and velocity of the centre of mass in world NED,
/// attitude body to world, and body rate. SI, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State<T = f64>
where
    T: Scalar,
{
    /// Position in world axes, m.
    pub position: Ned<T>,
    /// Velocity in world axes, m/s.
    pub velocity: Ned<T>,
    /// Rotation from body to world.
    pub attitude: Attitude<T>,
    /// Angular velocity of the body relative to the world in body axes, rad/s.
    pub body_rate: Frd<T>,
}

impl State {
    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        let q = self.attitude;
        self.position.is_finite()
            && self.velocity.is_finite()
            && self.body_rate.is_finite()
            && [q.w, q.x, q.y, q.z].iter().all(|c| c.is_finite())
    }
}
