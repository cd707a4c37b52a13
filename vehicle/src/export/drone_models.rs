//! drone-models and crazyflow: a drone's table of physical parameters. A rotor's thrust and torque
//! are polynomials of its speed in 1/min, which follows its command with a first-order lag.

use std::fmt::Write as _;

use super::{Model, one_line, real, reals};
use crate::effects::{EffectId, RotorGyroscopic};

/// Smallest lag that the simulator accepts, s; 0 is invalid.
const LEAST_LAG: f64 = 1e-3;

pub(super) fn text(model: &mut Model<'_>) -> String {
    let rpm = model.speed_max * 60.0 / std::f64::consts::TAU;
    let (thrust, torque) = model.mean_rotor();
    let (drag, follows_speed) = model.linear_drag().unwrap_or(([0.0; 3], false));
    let gyroscopic = model.effect::<RotorGyroscopic>();
    model.lose_but(&[EffectId::RotorDrag, EffectId::RotorGyroscopic, EffectId::ThrustCurve]);
    model.lose_unlike_rotors();
    model.lose_assumed_speed();
    if follows_speed {
        model.lose("a drag that grows with the rotors' speed: exact only at hover speed");
    }
    if model.constants.motor_time_constant > 0.0 {
        model.lose("a lag of the thrust: their rotors lag in their speed, equivalent near hover");
    }
    if model.vehicle.angular_damping_nms.is_some() {
        model.lose("angular_damping_Nms");
    }
    let rotors = &model.constants.rotors;
    let arm = rotors.iter().flat_map(|r| [r.x.abs(), r.y.abs()]).fold(0.0, f64::max);
    let rows = [
        rotors.map(|rotor| -rotor.y / arm),
        rotors.map(|rotor| -rotor.x / arm),
        rotors.map(|rotor| -rotor.torque_per_thrust.signum()),
    ];
    let diagonal = |[x, y, z]: [f64; 3]| {
        format!("[[{}], [{}], [{}]]", reals(&[x, 0., 0.]), reals(&[0., y, 0.]), reals(&[0., 0., z]))
    };
    let per_rpm2 = thrust / (rpm * rpm);
    let rate = 1.0 / model.constants.motor_time_constant.max(LEAST_LAG);
    let mut text = model.head("#");
    let name = one_line(model.vehicle).replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    let _ = write!(
        text,
        "# Motor outputs u become speeds: rpm = {} * sqrt((1 - a) u + a u^2), with a = {}.\n\n\
         [{name}]\n",
        real(rpm),
        real(model.thrust_curve())
    );
    let mut put = |key: &str, value: String| {
        let _ = writeln!(text, "{key} = {value}");
    };
    put("gravity_vec", format!("[{}]", reals(&[0.0, 0.0, -model.vehicle.gravity])));
    put("mass", real(model.constants.mass));
    put("L", real(arm));
    put("J", diagonal(model.constants.inertia));
    put("rpm2thrust", format!("[{}]", reals(&[0.0, 0.0, per_rpm2])));
    put("rpm2torque", format!("[{}]", reals(&[0.0, 0.0, per_rpm2 * torque])));
    put("thrust2torque", real(torque));
    put("rotor_dyn_coef", format!("[{}]", reals(&[rate, 0.0, rate, 0.0])));
    put("rotor_dyn_coef_simple", real(rate));
    put("thrust_dyn_coef", real(rate));
    let matrix = rows.map(|row| format!("[{}]", reals(&row))).join(", ");
    put("mixing_matrix", format!("[{matrix}]"));
    put("drag_matrix", diagonal(drag.map(|drag| -drag)));
    put("thrust_min", real(0.0));
    put("thrust_max", real(thrust));
    put("prop_radius", real(model.vehicle.rotor_radius_m));
    put("prop_inertia", real(gyroscopic.map_or(0.0, |rotor| rotor.rotor_inertia_kgm2)));
    text
}
