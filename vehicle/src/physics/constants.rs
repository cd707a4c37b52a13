//! The numbers of a vehicle that effects may change.

use crate::params::{ROTORS, VehicleParams};

/// The numbers of a vehicle that effects may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants {
    /// Mass in kg.
    pub mass: f64,
    /// Principal moments of inertia in kg m^2.
    pub inertia: [f64; 3],
    /// The rotors, in the order of the outputs.
    pub rotors: [RotorConstants; ROTORS],
    /// Lag of the rotors' states in s; 0 for none.
    pub motor_time_constant: f64,
}

/// One rotor, relative to the true centre of mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorConstants {
    /// Arm towards the front, m.
    pub x: f64,
    /// Arm towards the right, m.
    pub y: f64,
    /// Thrust at state 1 and full voltage, N.
    pub thrust_max: f64,
    /// Drag torque per thrust about down with its sign, m.
    pub torque_per_thrust: f64,
    /// +1 if the drag torque on the body is about +z body, else -1.
    pub spin: f64,
}

impl Constants {
    /// The nominal vehicle's numbers.
    pub fn nominal(vehicle: &VehicleParams) -> Self {
        let rotors = vehicle.rotors.map(|rotor| {
            let spin = f64::from(rotor.spin);
            RotorConstants {
                x: rotor.position_m[0],
                y: rotor.position_m[1],
                thrust_max: rotor.thrust_max_n,
                torque_per_thrust: spin * rotor.drag_torque_per_thrust_m,
                spin,
            }
        });
        Self {
            mass: vehicle.mass,
            inertia: vehicle.inertia,
            rotors,
            motor_time_constant: vehicle.motor_time_constant_s,
        }
    }
}
