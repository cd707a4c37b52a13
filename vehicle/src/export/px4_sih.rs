//! PX4's simulation in hardware (SIH): parameters in QGroundControl's format. Its model has four
//! rotors in an X with a common thrust and torque, linear drag, rate damping and a thrust lag.

use std::fmt::Write as _;

use super::Model;
use crate::effects::EffectId;
use crate::params::ROTORS;

/// SIH's gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;
/// MAV_PARAM_TYPE_REAL32 of MAVLink.
const REAL32: u8 = 9;

pub(super) fn text(model: &mut Model<'_>) -> String {
    let (thrust, torque) = model.mean_rotor();
    let (drag, follows_speed) = model.linear_drag().unwrap_or(([0.0; 3], false));
    let damping = model.vehicle.angular_damping_nms.unwrap_or_default();
    model.lose_but(&[EffectId::RotorDrag, EffectId::Wind]);
    model.lose_unlike_rotors();
    model.lose_gravity(GRAVITY);
    if follows_speed {
        model.lose("a drag that grows with the rotors' speed: exact only at hover speed");
    }
    if drag[0] != drag[2] {
        model.lose(
            "a drag along the thrust that differs from the drag across it: both are the \
             drag across",
        );
    }
    if damping.iter().any(|axis| *axis != damping[0]) {
        model.lose("a damping that differs between axes: all have roll's");
    }
    if model.wind.down() != 0.0 {
        model.lose("a wind up or down");
    }
    let rotors = &model.constants.rotors;
    let mean = |of: fn(f64, f64) -> f64| {
        rotors.iter().map(|rotor| of(rotor.x, rotor.y)).sum::<f64>() / ROTORS as f64
    };
    let (along, across) = (mean(|x, _| x.abs()), mean(|_, y| y.abs()));
    let is_x = rotors.iter().all(|rotor| {
        (rotor.x.abs() - along).abs() < 1e-3 * along
            && (rotor.y.abs() - across).abs() < 1e-3 * across
    });
    if !is_x {
        model.lose("rotors that form no even X about the centre of mass: the arms are means");
    }
    let [ix, iy, iz] = model.constants.inertia;
    let [north, east, _] = model.wind.to_array();
    let mut text = model.head("#");
    text.push_str("# Vehicle-Id Component-Id Name Value Type\n");
    for (name, value) in [
        ("SIH_MASS", model.constants.mass),
        ("SIH_IXX", ix),
        ("SIH_IYY", iy),
        ("SIH_IZZ", iz),
        ("SIH_IXY", 0.0),
        ("SIH_IXZ", 0.0),
        ("SIH_IYZ", 0.0),
        ("SIH_T_MAX", thrust),
        ("SIH_Q_MAX", thrust * torque),
        ("SIH_L_ROLL", across),
        ("SIH_L_PITCH", along),
        ("SIH_T_TAU", model.constants.motor_time_constant),
        ("SIH_KDV", drag[0]),
        ("SIH_KDW", damping[0]),
        ("SIH_WIND_N", north),
        ("SIH_WIND_E", east),
    ] {
        let _ = writeln!(text, "1\t1\t{name}\t{}\t{REAL32}", super::real(value));
    }
    text
}
