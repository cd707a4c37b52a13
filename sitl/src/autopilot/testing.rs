//! A vehicle and its parameters for unit tests.

use super::parameters::Parameters;
use vehicle::{AttitudePd, BatteryParams, RotorParams, VehicleParams};

/// A 0.5 kg quadrotor in X layout.
pub(crate) fn vehicle() -> VehicleParams {
    let rotor = |x: f64, y: f64, spin: i8| RotorParams {
        position_m: [0.1 * x, 0.1 * y, 0.0],
        spin,
        thrust_max_n: 2.5,
        drag_torque_per_thrust_m: 0.015,
    };
    VehicleParams {
        name: "test".to_owned(),
        mass: 0.5,
        inertia: [0.003, 0.003, 0.005],
        rotors: [
            rotor(1.0, 1.0, 1),
            rotor(-1.0, 1.0, -1),
            rotor(-1.0, -1.0, 1),
            rotor(1.0, -1.0, -1),
        ],
        motor_time_constant_s: 0.03,
        command_delay_s: 0.005,
        attitude_pd: Some(AttitudePd {
            kp: [0.6, 0.6, 0.3],
            kd: [0.075, 0.075, 0.06],
            rate_hz: 250.0,
        }),
        attitude_cascade: None,
        hover_thrust: 0.4905,
        gravity: 9.81,
        air_density: 1.2,
        rotor_radius_m: 0.06,
        rotor_max_rpm: Some(20_000.0),
        battery: BatteryParams { cells: 3, full_v: 12.6, nominal_v: 11.1 },
        modelled_effects: Default::default(),
        motor_output: None,
        linear_drag_n_per_m_s: None,
        angular_damping_nms: None,
        autopilot: None,
        notes: Vec::new(),
        provenance: Default::default(),
    }
}

/// The vehicle's default parameters.
pub(crate) fn parameters() -> Parameters {
    let vehicle = vehicle();
    super::personality::bundled_parameters(&vehicle, &vehicle.attitude_pd.unwrap())
}
