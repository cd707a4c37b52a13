//! The state as a vector, and a bound of it.

/// Size of the state `s = (p, v, zeta, omega)`.
pub const STATES: usize = 12;
/// Where the velocity begins in a [`StateVector`].
pub(super) const VELOCITY: usize = 3;
/// Where the attitude (roll, pitch, yaw) begins in a [`StateVector`].
pub(super) const ANGLE: usize = 6;
/// Where yaw is in a [`StateVector`].
pub(super) const YAW: usize = 8;
/// Where the body rate begins in a [`StateVector`].
pub(super) const RATE: usize = 9;

/// `s = (p, v, zeta, omega)`: position (m) and velocity [m/s] in world axes, roll, pitch and yaw
/// [rad, continuous], body rate [rad/s].
pub type StateVector = [f64; STATES];

/// A bound `excess(s) <= 0` and how it changes with the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRow {
    /// By how much the bound is broken (m, rad, rad/s); negative inside.
    pub excess: f64,
    /// d(excess)/ds.
    pub gradient: StateVector,
}

impl StateRow {
    /// Whether it bounds where the vehicle is.
    pub(super) fn is_of_position(&self) -> bool {
        self.gradient[..3].iter().any(|slope| *slope != 0.0)
    }
}
