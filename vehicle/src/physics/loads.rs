//! What acts on a vehicle during a step: its environment and its rotors' loads.

use crate::frame::Ned;
use crate::law::Rotors;
use crate::scalar::Scalar;

/// The vehicle's surroundings, constant over an integration step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Environment {
    /// Velocity of the air in world axes, m/s.
    pub air_velocity: Ned,
    /// Factor of the pack's voltage on thrust and squared rotor speed.
    pub voltage_factor: f64,
    /// Down coordinate of the floor, m.
    pub floor: f64,
    /// The pack's terminal voltage, V; an input of laws.
    pub voltage: f64,
    /// Time since the start, s; an input of laws.
    pub time: f64,
}

/// The rotors' action on the body, before aerodynamic factors.
#[derive(Clone, Copy, Debug)]
pub struct Loads<T> {
    /// T: total thrust, N.
    pub(super) thrust: T,
    /// Moments of the thrusts about front and right, and of the drag torques about down, N m.
    pub(super) moment: [T; 3],
    /// nr: mean rotor speed over the one at hover; 0 if no effect needs it.
    pub(super) rotor_speed_ratio: T,
    /// h: angular momentum of the rotors along down, N m s; 0 if no effect needs it.
    pub(super) spin_momentum: T,
    /// dh/dt in N m.
    pub(super) spin_momentum_rate: T,
}

impl<T: Scalar> Loads<T> {
    /// Total thrust before aerodynamic factors, N.
    pub fn thrust(&self) -> T {
        self.thrust
    }

    /// Moments of the thrusts about front and right before aerodynamic factors, N m.
    pub fn tilting_moments(&self) -> [T; 2] {
        let [roll, pitch, _] = self.moment;
        [roll, pitch]
    }

    pub(super) fn as_quantities(&self) -> Rotors<T> {
        Rotors { thrust: self.thrust, speed_ratio: self.rotor_speed_ratio, moment: self.moment }
    }

    /// The rotors' angular momentum along down in N m s.
    pub fn spin_momentum(&self) -> T {
        self.spin_momentum
    }

    /// The same loads, with the given rate of change of the rotors' angular momentum in N m.
    pub fn with_spin_momentum_rate(self, rate: T) -> Self {
        Self { spin_momentum_rate: rate, ..self }
    }
}
