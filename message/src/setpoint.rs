//! The controller's setpoint and reference.

use vehicle::frame::{Euler, Frd, Ned};

pub use vehicle::rigid_body::State;

/// The commanded input `u_hat = (u1, zeta_des, omega_des)` in R^7 of the vehicle with its PD
/// attitude loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setpoint {
    /// Collective thrust along -z body in N; hover is m g.
    pub thrust_n: f64,
    /// Desired roll, pitch and yaw, rad.
    pub attitude: Euler,
    /// Desired body rate, rad/s.
    pub body_rate: Frd,
}

impl Setpoint {
    /// Component-wise sum, such as feed-forward plus feedback.
    pub fn plus(self, other: Self) -> Self {
        let (a, b) = (self.attitude, other.attitude);
        Self {
            thrust_n: self.thrust_n + other.thrust_n,
            attitude: Euler::new(a.roll + b.roll, a.pitch + b.pitch, a.yaw + b.yaw),
            body_rate: self.body_rate + other.body_rate,
        }
    }

    /// Each component times `factor`.
    pub fn scaled(self, factor: f64) -> Self {
        let Euler { roll, pitch, yaw } = self.attitude;
        Self {
            thrust_n: self.thrust_n * factor,
            attitude: Euler::new(roll * factor, pitch * factor, yaw * factor),
            body_rate: self.body_rate * factor,
        }
    }

    /// Whether every component is finite.
    pub fn is_finite(&self) -> bool {
        let Euler { roll, pitch, yaw } = self.attitude;
        self.body_rate.is_finite()
            && [self.thrust_n, roll, pitch, yaw].iter().all(|c| c.is_finite())
    }
}

/// A point on the reference: the state `s*` and its input `u_hat*`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Position in world axes, m.
    pub position: Ned,
    /// Velocity in world axes, m/s.
    pub velocity: Ned,
    /// Roll, pitch and yaw, rad.
    pub attitude: Euler,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Feed-forward input.
    pub feedforward: Setpoint,
}

/// What the model behind a reference expects in addition to thrust, weight and the attitude loop,
/// such as drag. The reference's input already accounts for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Expected {
    /// Acceleration in world axes, m/s^2.
    pub acceleration: Ned,
    /// Attitude in addition to the loop's response, rad.
    pub attitude: [f64; 3],
}

impl Reference {
    /// The reference at a place and a velocity whose attitude and body rate are those of its input.
    pub fn led_by(feedforward: Setpoint, position: Ned, velocity: Ned) -> Self {
        let Setpoint { attitude, body_rate, .. } = feedforward;
        Self { position, velocity, attitude, body_rate, feedforward }
    }
}

impl Expected {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.acceleration.is_finite() && self.attitude.iter().all(|angle| angle.is_finite())
    }

    /// The difference of this and `other`.
    pub fn beyond(&self, other: &Self) -> Self {
        Self {
            acceleration: self.acceleration - other.acceleration,
            attitude: std::array::from_fn(|i| self.attitude[i] - other.attitude[i]),
        }
    }
}
