//! The state as a vector, and a linearised bound on it.

/// Size of the state `s = (p, v, zeta, omega)`.
pub const STATES: usize = 12;
/// First index of the velocity in a [`StateVector`].
pub(super) const VELOCITY: usize = 3;
/// First index of the attitude (roll, pitch, yaw) in a [`StateVector`].
pub(super) const ANGLE: usize = 6;
/// Index of yaw in a [`StateVector`].
pub(super) const YAW: usize = 8;
/// First index of the body rate in a [`StateVector`].
pub(super) const RATE: usize = 9;

/// `s = (p, v, zeta, omega)`: position (m) and velocity (m/s) in world axes, roll, pitch and yaw
/// [rad, continuous], body rate (rad/s).
pub type StateVector = [f64; STATES];

/// A bound `excess(s) <= 0` and its gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRow {
    /// Amount by which the bound is exceeded (m, rad, rad/s); negative inside.
    pub excess: f64,
    /// d(excess)/ds.
    pub gradient: StateVector,
}

impl StateRow {
    /// Whether it bounds the position.
    pub(super) fn is_of_position(&self) -> bool {
        self.gradient[..3].iter().any(|slope| *slope != 0.0)
    }
}
