//! One instant of a desired trajectory.

use vehicle::frame::Ned;

/// The desired motion at one instant. World axes, SI, radians. The origin is the trajectory's
/// anchor, the take-off point on the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DesiredPoint {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Acceleration, m/s^2.
    pub acceleration: Ned,
    /// Yaw, rad, continuous (not wrapped).
    pub yaw: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
}
