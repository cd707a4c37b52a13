//! ArduCopter's parameters, with ArduCopter's names and defaults, and gains and frame from the
//! vehicle file.

use super::super::gains::{Gain, Tuning, Unit};
use crate::autopilot::parameters::{Key, Spec, Value, fact, float, int};
use vehicle::{ROTORS, RotorParams, VehicleParams};

/// ArduCopter's defaults: ATC_RAT_RLL_I over _P, _D over _P, _IMAX and the filters. By default
/// ArduCopter does not bound the rates; this bound is far beyond normal setpoints.
pub(super) const TUNING: Tuning = Tuning {
    integral_per_s: [1.0, 1.0, 0.1],
    derivative_s: [0.0267, 0.0267, 0.0],
    integral_max: [0.5; 3],
    rate_max_rad_s: [std::f64::consts::TAU; 3],
    gyro_cutoff_hz: 20.0,
    derivative_cutoff_hz: 20.0,
    shapes_setpoints: true,
    rate_hz: 400.0,
};

/// ATC_ACCEL_R_MAX, ATC_ACCEL_P_MAX and ATC_ACCEL_Y_MAX, 110000 and 27000 cdeg/s^2.
pub(super) const ACCELERATION_MAX_RAD_S2: [f64; 3] = [19.2, 19.2, 4.71];

/// Share of a normalised torque on the farthest motor of an axis.
const TORQUE_SHARE: f64 = 0.5;
/// Output function of the first motor.
const MOTOR_1: i32 = 33;
/// Voltage of a low cell, V.
const CELL_LOW_V: f64 = 3.5;

pub(super) const GAINS: &[Gain] = &[
    Gain { name: "ATC_ANG_PIT_P", at: |c| &mut c.angle_p_per_s[1], unit: Unit::Same },
    Gain { name: "ATC_ANG_RLL_P", at: |c| &mut c.angle_p_per_s[0], unit: Unit::Same },
    Gain { name: "ATC_ANG_YAW_P", at: |c| &mut c.angle_p_per_s[2], unit: Unit::Same },
    Gain {
        name: "ATC_INPUT_TC",
        at: |c| c.input_time_constant_s.get_or_insert(0.0),
        unit: Unit::Same,
    },
    Gain { name: "ATC_RATE_P_MAX", at: |c| &mut c.rate_max_rad_s[1], unit: Unit::Degrees },
    Gain { name: "ATC_RATE_R_MAX", at: |c| &mut c.rate_max_rad_s[0], unit: Unit::Degrees },
    Gain { name: "ATC_RATE_Y_MAX", at: |c| &mut c.rate_max_rad_s[2], unit: Unit::Degrees },
    Gain { name: "ATC_RAT_PIT_D", at: |c| &mut c.rate_d_nms2[1], unit: Unit::Torque(1) },
    Gain { name: "ATC_RAT_PIT_FF", at: |c| &mut c.rate_ff_nms[1], unit: Unit::Torque(1) },
    Gain { name: "ATC_RAT_PIT_FLTD", at: |c| &mut c.derivative_cutoff_hz, unit: Unit::Same },
    Gain { name: "ATC_RAT_PIT_I", at: |c| &mut c.rate_i_nm[1], unit: Unit::Torque(1) },
    Gain { name: "ATC_RAT_PIT_IMAX", at: |c| &mut c.integral_max_nm[1], unit: Unit::Torque(1) },
    Gain { name: "ATC_RAT_PIT_P", at: |c| &mut c.rate_p_nms[1], unit: Unit::Torque(1) },
    Gain { name: "ATC_RAT_RLL_D", at: |c| &mut c.rate_d_nms2[0], unit: Unit::Torque(0) },
    Gain { name: "ATC_RAT_RLL_FF", at: |c| &mut c.rate_ff_nms[0], unit: Unit::Torque(0) },
    Gain { name: "ATC_RAT_RLL_FLTD", at: |c| &mut c.derivative_cutoff_hz, unit: Unit::Same },
    Gain { name: "ATC_RAT_RLL_I", at: |c| &mut c.rate_i_nm[0], unit: Unit::Torque(0) },
    Gain { name: "ATC_RAT_RLL_IMAX", at: |c| &mut c.integral_max_nm[0], unit: Unit::Torque(0) },
    Gain { name: "ATC_RAT_RLL_P", at: |c| &mut c.rate_p_nms[0], unit: Unit::Torque(0) },
    Gain { name: "ATC_RAT_YAW_D", at: |c| &mut c.rate_d_nms2[2], unit: Unit::Torque(2) },
    Gain { name: "ATC_RAT_YAW_FF", at: |c| &mut c.rate_ff_nms[2], unit: Unit::Torque(2) },
    Gain { name: "ATC_RAT_YAW_I", at: |c| &mut c.rate_i_nm[2], unit: Unit::Torque(2) },
    Gain { name: "ATC_RAT_YAW_IMAX", at: |c| &mut c.integral_max_nm[2], unit: Unit::Torque(2) },
    Gain { name: "ATC_RAT_YAW_P", at: |c| &mut c.rate_p_nms[2], unit: Unit::Torque(2) },
    Gain { name: "INS_GYRO_FILTER", at: |c| &mut c.gyro_cutoff_hz, unit: Unit::Same },
];

/// Values without an ArduCopter parameter: largest tilt at arming in rad, take-off height in m and
/// speed in m/s, sticks over MAVLink.
pub(super) const BUILT_IN: &[(Key, f64)] = &[
    (Key::ComArmLevel, 0.3),
    (Key::MisTakeoffAlt, 2.5),
    (Key::MpcTkoSpeed, 1.0),
    (Key::ComRcInMode, 1.0),
];

/// Moments in N m of a normalised torque of 1 about roll, pitch and yaw. ArduCopter's mixer gives
/// the farthest motors of an axis half of the torque, and nearer ones in proportion to distance.
pub(super) fn unit_moments(vehicle: &VehicleParams) -> [f64; 3] {
    let about = |arm: fn(&RotorParams) -> f64| {
        let farthest = vehicle.rotors.iter().map(|rotor| arm(rotor).abs()).fold(0.0, f64::max);
        let of = |rotor: &RotorParams| {
            let arm = arm(rotor).abs();
            TORQUE_SHARE * arm / farthest.max(1e-9) * rotor.thrust_max_n * arm
        };
        vehicle.rotors.iter().map(of).sum::<f64>()
    };
    let yaw = vehicle
        .rotors
        .iter()
        .map(|rotor| TORQUE_SHARE * rotor.thrust_max_n * rotor.drag_torque_per_thrust_m);
    [about(|rotor| rotor.position_m[1]), about(|rotor| rotor.position_m[0]), yaw.sum()]
}

/// The frame's motors, motor 1 first: angle from the front clockwise in degrees, spin.
const FRAMES: [(i32, [(f64, i8); ROTORS]); 2] = [
    (0, [(90.0, 1), (-90.0, 1), (0.0, -1), (180.0, -1)]),
    (1, [(45.0, 1), (-135.0, 1), (-45.0, -1), (135.0, -1)]),
];

/// FRAME_TYPE and each rotor's motor number, counted from 0, for the frame whose motors are nearest
/// to the rotors.
fn frame(vehicle: &VehicleParams) -> (i32, [i32; ROTORS]) {
    let apart = |rotor: &RotorParams, degrees: f64| {
        let angle = rotor.position_m[1].atan2(rotor.position_m[0]);
        vehicle::frame::wrap_angle(angle - degrees.to_radians()).abs()
    };
    let fit = |motors: &[(f64, i8); ROTORS]| {
        let mut total = 0.0;
        let numbers = vehicle.rotors.each_ref().map(|rotor| {
            let distance = |at: &usize| apart(rotor, motors[*at].0);
            let nearest = (0..ROTORS).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            total += nearest.map_or(0.0, |at| distance(&at));
            nearest.unwrap_or(0) as i32
        });
        (total, numbers)
    };
    let fits = FRAMES.map(|(kind, motors)| (kind, fit(&motors)));
    let [(plus, (plus_off, plus_numbers)), (x, (x_off, x_numbers))] = fits;
    if plus_off < x_off { (plus, plus_numbers) } else { (x, x_numbers) }
}

/// All parameters except the gains.
pub(super) fn table(vehicle: &VehicleParams, rate_hz: f64) -> Vec<Spec> {
    let (frame_type, motors) = frame(vehicle);
    let cells = f64::from(vehicle.battery.cells);
    let low_v = (CELL_LOW_V * cells) as f32;
    let curve = vehicle.modelled_effects.get::<vehicle::effects::ThrustCurve>();
    let curve = curve.map_or(0.0, |curve| curve.a.max(0.0)) as f32;
    let centi = |spec: Spec| spec.scaled(0.01);
    let mut specs = vec![
        // Largest tilt, centidegrees.
        centi(int(Key::MpcTiltMaxAir, "ANGLE_MAX", 3000, 1000, 8000)),
        fact("ARMING_CHECK", Value::Int(1)),
        // Whether thrust is divided by the cosine of the tilt.
        int(Key::AngleBoost, "ATC_ANGLE_BOOST", 1, 0, 1),
        fact("ATC_RATE_FF_ENAB", Value::Int(1)),
        float(Key::BatCriticalVolt, "BATT_CRT_VOLT", 0.0, 0.0, 100.0),
        // 0 none, 1 land, 2 to 4 return, 5 disarm.
        int(Key::BatFsCrtAct, "BATT_FS_CRT_ACT", 0, 0, 7),
        int(Key::BatFsLowAct, "BATT_FS_LOW_ACT", 0, 0, 7),
        float(Key::BatLowVolt, "BATT_LOW_VOLT", low_v, 0.0, 100.0),
        // Disarm without take-off, and after a landing in GUIDED, s.
        int(Key::ComDisarmPrflt, "DISARM_DELAY", 10, 0, 127),
        fact("FRAME_CLASS", Value::Int(1)),
        fact("FRAME_TYPE", Value::Int(frame_type)),
        // On loss of the ground station's heartbeats: 0 nothing, 1 to 4 return, 5 land, 6 and 7
        // brake.
        int(Key::FsGcsEnable, "FS_GCS_ENABLE", 0, 0, 7),
        float(Key::ComDlLossT, "FS_GCS_TIMEOUT", 5.0, 2.0, 120.0),
        // On loss of the sticks: 0 nothing, 3 land, else return.
        int(Key::NavRclAct, "FS_THR_ENABLE", 1, 0, 7),
        // Bit 3: the thrust field is a thrust, not a climb rate.
        int(Key::GuidOptions, "GUID_OPTIONS", 0, 0, 511),
        // A setpoint is tracked for this long, s.
        float(Key::ComOfLossT, "GUID_TIMEOUT", 3.0, 0.1, 5.0),
        // cm/s
        centi(int(Key::MpcLandSpeed, "LAND_SPEED", 50, 30, 200)),
        int(Key::GroundStationSystem, "MAV_GCS_SYSID", 255, 1, 255),
        fact("MAV_SYSID", Value::Int(1)),
        fact("MOT_BAT_VOLT_MAX", Value::Float(0.0)),
        fact("MOT_BAT_VOLT_MIN", Value::Float(0.0)),
        int(Key::MotPwmMax, "MOT_PWM_MAX", 2000, 0, 2000),
        int(Key::MotPwmMin, "MOT_PWM_MIN", 1000, 0, 2000),
        float(Key::MotSpinArm, "MOT_SPIN_ARM", 0.1, 0.0, 1.0),
        float(Key::MotSpinMax, "MOT_SPIN_MAX", 0.95, 0.9, 1.0),
        float(Key::MotSpinMin, "MOT_SPIN_MIN", 0.15, 0.0, 0.3),
        float(Key::MotSpoolTime, "MOT_SPOOL_TIME", 0.5, 0.0, 2.0),
        float(Key::ThrustCurve, "MOT_THST_EXPO", curve, -1.0, 1.0),
        float(Key::MpcThrHover, "MOT_THST_HOVER", vehicle.hover_thrust as f32, 0.05, 0.9),
        // Sticks are lost after this long, s.
        float(Key::ComRcLossT, "RC_FS_TIMEOUT", 1.0, 0.5, 10.0),
        fact("SCHED_LOOP_RATE", Value::Int(rate_hz.round() as i32)),
        // cm/s
        centi(int(Key::MpcXyVelMax, "WPNAV_SPEED", 1000, 20, 2000)),
        centi(int(Key::MpcZVelMaxDn, "WPNAV_SPEED_DN", 150, 10, 500)),
        centi(int(Key::MpcZVelMaxUp, "WPNAV_SPEED_UP", 250, 10, 1000)),
    ];
    for (at, motor) in motors.into_iter().enumerate() {
        specs.push(fact(format!("SERVO{}_FUNCTION", at + 1), Value::Int(MOTOR_1 + motor)));
    }
    specs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::testing;

    #[test]
    fn unit_torque_matches_arducopter_mixer() {
        // X layout, four equal rotors: 2 y T about roll, 2 T kappa about yaw.
        let moments = unit_moments(&testing::vehicle());
        for (found, expected) in moments.into_iter().zip([0.5, 0.5, 0.075]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn rotors_in_any_order_map_to_their_motors() {
        let mut vehicle = testing::vehicle();
        assert_eq!(frame(&vehicle), (1, [0, 3, 1, 2]));
        vehicle.rotors.swap(0, 2);
        assert_eq!(frame(&vehicle), (1, [1, 3, 0, 2]));
        for (rotor, place) in vehicle.rotors.iter_mut().zip([[0.1, 0.0], [0.0, 0.1]]) {
            [rotor.position_m[0], rotor.position_m[1]] = place;
        }
        for (rotor, place) in vehicle.rotors[2..].iter_mut().zip([[-0.1, 0.0], [0.0, -0.1]]) {
            [rotor.position_m[0], rotor.position_m[1]] = place;
        }
        assert_eq!(frame(&vehicle), (0, [2, 0, 3, 1]));
    }

    #[test]
    fn parameter_names_fit_the_protocol() {
        let specs = table(&testing::vehicle(), 400.0);
        assert!(specs.iter().all(|spec| spec.name().len() <= 16));
        assert!(GAINS.iter().all(|gain| gain.name.len() <= 16));
    }
}
