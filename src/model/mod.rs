//! Models of the vehicle's accelerations: nominal physics, learned networks, and their sum.
//!
//! A model maps the state without position and the acting input to accelerations:
//! `(v, omega, zeta, u) -> (dv/dt, domega/dt)`. [`actuation`] covers everything between a command
//! and the acting input (delay, rotor lag, saturation, voltage).

pub mod actuation;
pub mod features;
pub mod file;
pub mod hybrid;
pub mod learned;
pub mod net;
pub mod onnx;
pub mod physics;

#[cfg(test)]
mod tests;

use vehicle::frame::{Euler, Frd, Ned};

/// Number of variables of a [`Point`]: v, omega, zeta, u.
pub const VARIABLES: usize = 13;
/// Number of accelerations: linear in world axes, angular in body axes.
pub const ACCELERATIONS: usize = 6;

/// The point at which a model is evaluated. Position has no effect (Bansal et al. 2016, section
/// V-B).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Velocity in world axes, m/s.
    pub velocity: Ned,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Roll, pitch and yaw, rad.
    pub attitude: Euler,
    /// u: collective thrust along -z body in N, then moments about body x, y, z in N m, from the
    /// rotors with the nominal vehicle's parameters.
    pub input: [f64; 4],
}

impl Point {
    /// v, omega, zeta, u in this order: the columns of a [`Jacobian`].
    pub fn to_array(&self) -> [f64; VARIABLES] {
        let [vn, ve, vd] = self.velocity.to_array();
        let [p, q, r] = self.body_rate.to_array();
        let Euler { roll, pitch, yaw } = self.attitude;
        let [u1, u2, u3, u4] = self.input;
        [vn, ve, vd, p, q, r, roll, pitch, yaw, u1, u2, u3, u4]
    }

    /// The inverse of [`Point::to_array`].
    pub fn from_array(array: &[f64; VARIABLES]) -> Self {
        let [vn, ve, vd, p, q, r, roll, pitch, yaw, u1, u2, u3, u4] = *array;
        Self {
            velocity: Ned::new(vn, ve, vd),
            body_rate: Frd::new(p, q, r),
            attitude: Euler::new(roll, pitch, yaw),
            input: [u1, u2, u3, u4],
        }
    }
}

/// Rows: linear acceleration in world axes, angular acceleration in body axes. Columns: the
/// variables of a [`Point`].
pub type Jacobian = [[f64; VARIABLES]; ACCELERATIONS];

/// A model of the accelerations.
pub trait Model: Send + Sync {
    /// Linear acceleration in world axes (m/s^2) and angular acceleration in body axes
    /// (rad/s^2).
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS];

    /// The accelerations and their exact derivatives; at a kink of a network, those of one side.
    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian);
}
