//! PX4's parameters, with PX4's names and defaults, and gains and geometry from the vehicle file.

use super::super::gains::{Gain, Tuning, Unit};
use crate::autopilot::parameters::{Key, Spec, Value, fact, float, int};
use vehicle::rotor::Allocation;
use vehicle::{ROTORS, VehicleParams};

/// Pulse widths for an output of 0, for an output of 1, and for disarmed motors, us.
pub(super) const PULSES_US: [f64; 3] = [1000.0, 2000.0, 900.0];

/// PX4's default thrust coefficient; only ratios matter.
const THRUST_COEFFICIENT: f32 = 6.5;
/// Output function of the first motor.
const MOTOR_1: i32 = 101;

/// PX4's defaults: MC_ROLLRATE_I over _P, _D over _P, MC_RR_INT_LIM, the bounds on the rates and
/// the gyro filters.
pub(super) const TUNING: Tuning = Tuning {
    integral_per_s: [1.333, 1.333, 0.5],
    derivative_s: [0.02, 0.02, 0.0],
    integral_max: [0.3; 3],
    rate_max_rad_s: [3.84, 3.84, 3.49],
    gyro_cutoff_hz: 40.0,
    derivative_cutoff_hz: 30.0,
    shapes_setpoints: false,
    rate_hz: 250.0,
};

/// Gains of the attitude and rate loops. The common rate gains MC_*RATE_K are 1.
pub(super) const GAINS: &[Gain] = &[
    Gain { name: "IMU_DGYRO_CUTOFF", at: |c| &mut c.derivative_cutoff_hz, unit: Unit::Same },
    Gain { name: "IMU_GYRO_CUTOFF", at: |c| &mut c.gyro_cutoff_hz, unit: Unit::Same },
    Gain { name: "MC_PITCHRATE_D", at: |c| &mut c.rate_d_nms2[1], unit: Unit::Torque(1) },
    Gain { name: "MC_PITCHRATE_FF", at: |c| &mut c.rate_ff_nms[1], unit: Unit::Torque(1) },
    Gain { name: "MC_PITCHRATE_I", at: |c| &mut c.rate_i_nm[1], unit: Unit::Torque(1) },
    Gain { name: "MC_PITCHRATE_MAX", at: |c| &mut c.rate_max_rad_s[1], unit: Unit::Degrees },
    Gain { name: "MC_PITCHRATE_P", at: |c| &mut c.rate_p_nms[1], unit: Unit::Torque(1) },
    Gain { name: "MC_PITCH_P", at: |c| &mut c.angle_p_per_s[1], unit: Unit::Same },
    Gain { name: "MC_PR_INT_LIM", at: |c| &mut c.integral_max_nm[1], unit: Unit::Torque(1) },
    Gain { name: "MC_ROLLRATE_D", at: |c| &mut c.rate_d_nms2[0], unit: Unit::Torque(0) },
    Gain { name: "MC_ROLLRATE_FF", at: |c| &mut c.rate_ff_nms[0], unit: Unit::Torque(0) },
    Gain { name: "MC_ROLLRATE_I", at: |c| &mut c.rate_i_nm[0], unit: Unit::Torque(0) },
    Gain { name: "MC_ROLLRATE_MAX", at: |c| &mut c.rate_max_rad_s[0], unit: Unit::Degrees },
    Gain { name: "MC_ROLLRATE_P", at: |c| &mut c.rate_p_nms[0], unit: Unit::Torque(0) },
    Gain { name: "MC_ROLL_P", at: |c| &mut c.angle_p_per_s[0], unit: Unit::Same },
    Gain { name: "MC_RR_INT_LIM", at: |c| &mut c.integral_max_nm[0], unit: Unit::Torque(0) },
    Gain { name: "MC_YAWRATE_D", at: |c| &mut c.rate_d_nms2[2], unit: Unit::Torque(2) },
    Gain { name: "MC_YAWRATE_FF", at: |c| &mut c.rate_ff_nms[2], unit: Unit::Torque(2) },
    Gain { name: "MC_YAWRATE_I", at: |c| &mut c.rate_i_nm[2], unit: Unit::Torque(2) },
    Gain { name: "MC_YAWRATE_MAX", at: |c| &mut c.rate_max_rad_s[2], unit: Unit::Degrees },
    Gain { name: "MC_YAWRATE_P", at: |c| &mut c.rate_p_nms[2], unit: Unit::Torque(2) },
    Gain { name: "MC_YAW_P", at: |c| &mut c.angle_p_per_s[2], unit: Unit::Same },
    Gain { name: "MC_YR_INT_LIM", at: |c| &mut c.integral_max_nm[2], unit: Unit::Torque(2) },
];

/// Moments in N m of a normalised torque of 1 about roll, pitch and yaw. PX4 scales the mixer's
/// roll and pitch columns such that the squares in each sum to half the number of its rotors, where
/// the larger of the two scales applies to both. It scales the yaw column by its largest element.
pub(super) fn unit_moments(vehicle: &VehicleParams, allocation: &Allocation) -> [f64; 3] {
    // Outputs for 1 N m.
    let column = |axis: usize| -> [f64; ROTORS] {
        std::array::from_fn(|rotor| {
            allocation.inverse()[rotor][axis + 1] / vehicle.rotors[rotor].thrust_max_n
        })
    };
    let tilting = |axis: usize| {
        let squares = column(axis).map(|share| share * share);
        let largest = squares.into_iter().fold(0.0, f64::max);
        let count = squares.iter().filter(|square| **square > 1e-6 * largest).count();
        (squares.iter().sum::<f64>() / (0.5 * count.max(1) as f64)).sqrt()
    };
    let tilt = tilting(0).max(tilting(1));
    let yaw = column(2).into_iter().fold(0.0, f64::max);
    [1.0 / tilt, 1.0 / tilt, 1.0 / yaw]
}

/// All parameters except the gains.
pub(super) fn table(vehicle: &VehicleParams) -> Vec<Spec> {
    let float_fact = |name: &str, value: f64| fact(name.to_owned(), Value::Float(value as f32));
    let mut specs = vec![
        fact("BAT1_N_CELLS", Value::Int(vehicle.battery.cells.into())),
        // Charge at which the battery is critical and low.
        float(Key::BatCrtThr, "BAT_CRIT_THR", 0.07, 0.0, 1.0),
        float(Key::BatLowThr, "BAT_LOW_THR", 0.15, 0.0, 1.0),
        fact("CA_AIRFRAME", Value::Int(0)),
        fact("CA_ROTOR_COUNT", Value::Int(ROTORS as i32)),
        // Disarm this long after landing, and without take-off, s.
        float(Key::ComDisarmLand, "COM_DISARM_LAND", 2.0, -1.0, 60.0),
        float(Key::ComDisarmPrflt, "COM_DISARM_PRFLT", 10.0, -1.0, 120.0),
        // The ground station is lost when its heartbeat is older than this, s.
        float(Key::ComDlLossT, "COM_DL_LOSS_T", 10.0, 5.0, 300.0),
        // Hold before the action on lost sticks, s.
        float(Key::ComFailActT, "COM_FAIL_ACT_T", 5.0, 0.0, 25.0),
        int(Key::ComLowBatAct, "COM_LOW_BAT_ACT", 0, 0, 3),
        // Position needs sticks; without them NAV_RCL_ACT applies.
        int(Key::ComOblRcAct, "COM_OBL_RC_ACT", 0, 0, 7),
        float(Key::ComOfLossT, "COM_OF_LOSS_T", 1.0, 0.0, 60.0),
        // Modes that ignore a loss of the sticks: bit 1 Hold, bit 2 OFFBOARD.
        int(Key::ComRclExcept, "COM_RCL_EXCEPT", 0, 0, 31),
        int(Key::ComRcInMode, "COM_RC_IN_MODE", 1, 0, 4),
        float(Key::ComRcLossT, "COM_RC_LOSS_T", 0.5, 0.0, 35.0),
        int(Key::ComRcOverride, "COM_RC_OVERRIDE", 1, 0, 3),
        fact("MAV_COMP_ID", Value::Int(1)),
        fact("MAV_PROTO_VER", Value::Int(0)),
        fact("MAV_SYS_ID", Value::Int(1)),
        fact("MAV_TYPE", Value::Int(2)),
        fact("MC_BAT_SCALE_EN", Value::Int(0)),
        fact("MC_PITCHRATE_K", Value::Float(1.0)),
        fact("MC_ROLLRATE_K", Value::Float(1.0)),
        fact("MC_YAWRATE_K", Value::Float(1.0)),
        float(Key::YawWeight, "MC_YAW_WEIGHT", 0.4, 0.0, 1.0),
        float(Key::MisTakeoffAlt, "MIS_TAKEOFF_ALT", 2.5, 0.2, 80.0),
        float(Key::MpcLandSpeed, "MPC_LAND_SPEED", 0.7, 0.1, 2.0),
        float(Key::MpcThrHover, "MPC_THR_HOVER", vehicle.hover_thrust as f32, 0.05, 0.9),
        float(Key::MpcTiltMaxAir, "MPC_TILTMAX_AIR", 45.0, 5.0, 89.0),
        float(Key::MpcTkoSpeed, "MPC_TKO_SPEED", 1.5, 0.2, 5.0),
        float(Key::MpcXyVelMax, "MPC_XY_VEL_MAX", 12.0, 0.2, 20.0),
        float(Key::MpcZVelMaxDn, "MPC_Z_VEL_MAX_DN", 1.5, 0.2, 4.0),
        float(Key::MpcZVelMaxUp, "MPC_Z_VEL_MAX_UP", 3.0, 0.2, 8.0),
        int(Key::NavDllAct, "NAV_DLL_ACT", 0, 0, 6),
        int(Key::NavRclAct, "NAV_RCL_ACT", 2, 1, 6),
        fact("SYS_AUTOSTART", Value::Int(10040)),
        // Quadratic share of the thrust curve that the outputs compensate.
        float(Key::ThrustCurve, "THR_MDL_FAC", 0.0, 0.0, 1.0),
    ];
    let [low, high, disarmed] = PULSES_US.map(|pulse| Value::Int(pulse as i32));
    for (at, rotor) in vehicle.rotors.iter().enumerate() {
        let [x, y, z] = rotor.position_m;
        let moment = f64::from(rotor.spin) * rotor.drag_torque_per_thrust_m;
        for (axis, value) in [("PX", x), ("PY", y), ("PZ", z), ("KM", moment)] {
            specs.push(float_fact(&format!("CA_ROTOR{at}_{axis}"), value));
        }
        specs.push(fact(format!("CA_ROTOR{at}_CT"), Value::Float(THRUST_COEFFICIENT)));
        let output = at + 1;
        specs.push(fact(format!("PWM_MAIN_FUNC{output}"), Value::Int(MOTOR_1 + at as i32)));
        specs.push(fact(format!("PWM_MAIN_MIN{output}"), low));
        specs.push(fact(format!("PWM_MAIN_MAX{output}"), high));
        specs.push(fact(format!("PWM_MAIN_DIS{output}"), disarmed));
    }
    let [ixx, iyy, izz] = vehicle.inertia;
    let mean = |of: fn(&vehicle::RotorParams) -> f64| {
        vehicle.rotors.iter().map(of).sum::<f64>() / ROTORS as f64
    };
    // The simulation in hardware reports its physical parameters.
    specs.extend([
        float_fact("SIH_MASS", vehicle.mass),
        float_fact("SIH_IXX", ixx),
        float_fact("SIH_IYY", iyy),
        float_fact("SIH_IZZ", izz),
        float_fact("SIH_T_MAX", mean(|rotor| rotor.thrust_max_n)),
        float_fact("SIH_Q_MAX", mean(|rotor| rotor.thrust_max_n * rotor.drag_torque_per_thrust_m)),
        float_fact("SIH_T_TAU", vehicle.motor_time_constant_s),
        float_fact("SIH_L_ROLL", mean(|rotor| rotor.position_m[1].abs())),
        float_fact("SIH_L_PITCH", mean(|rotor| rotor.position_m[0].abs())),
    ]);
    specs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing;

    #[test]
    fn unit_torque_matches_px4_mixer() {
        // X layout, four equal rotors: sqrt(8) y T about roll, 4 T kappa about yaw.
        let vehicle = testing::vehicle();
        let moments = unit_moments(&vehicle, &vehicle.allocation().unwrap());
        let expected = [8f64.sqrt() * 0.1 * 2.5, 8f64.sqrt() * 0.1 * 2.5, 4.0 * 2.5 * 0.015];
        for (found, expected) in moments.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn parameter_names_fit_the_protocol() {
        let specs = table(&testing::vehicle());
        assert!(specs.iter().all(|spec| spec.name().len() <= 16));
        assert!(GAINS.iter().all(|gain| gain.name.len() <= 16));
    }
}
