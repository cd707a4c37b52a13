//! RotorPy (Folk, Paulos and Kumar 2023): `quad_params`. Commands are rotor speeds w. Each rotor
//! has thrust k_eta w^2, torque k_m w^2, drag -w k_d v and a flapping moment -w k_flap (v x z).

use std::fmt::Write as _;

use super::{Model, real, reals};
use crate::effects::{BladeFlapping, EffectId, ParasiticDrag, TranslationalLift};
use crate::params::ROTORS;

/// RotorPy's gravity, m/s^2.
const GRAVITY: f64 = 9.81;
/// Smallest lag that RotorPy accepts, s; 0 is invalid.
const LEAST_LAG: f64 = 1e-3;

pub(super) fn text(model: &mut Model<'_>) -> String {
    let full = model.speed_max;
    // Sum of the rotors' speeds at hover, rad/s.
    let hover = ROTORS as f64 * model.hover_speed() * full;
    let (thrust, torque) = model.mean_rotor();
    let (drag, follows_speed) = model.linear_drag().unwrap_or(([0.0; 3], true));
    let cda = model.effect::<ParasiticDrag>().map_or(0.0, |drag| drag.cda_m2);
    let flapping = model.effect::<BladeFlapping>();
    let lift = model.effect::<TranslationalLift>();
    model.lose_but(&[
        EffectId::RotorDrag,
        EffectId::ParasiticDrag,
        EffectId::BladeFlapping,
        EffectId::TranslationalLift,
        EffectId::ThrustCurve,
    ]);
    model.lose_unlike_rotors();
    model.lose_assumed_speed();
    model.lose_gravity(GRAVITY);
    if !follows_speed {
        model.lose("a drag independent of the rotors' speed: exact only at hover speed");
    }
    if flapping.is_some_and(|flapping| flapping.tilt_rad_s_m != 0.0) {
        model.lose("the tilt of the thrust by blade_flapping: only its moment is expressed");
    }
    if lift.is_some() {
        model.lose("a translational lift in proportion to the thrust: exact only at hover thrust");
    }
    if model.constants.motor_time_constant > 0.0 {
        model.lose(
            "a lag of the thrust: RotorPy's rotors lag in their speed, equivalent near hover",
        );
    }
    if model.vehicle.angular_damping_nms.is_some() {
        model.lose("angular_damping_Nms");
    }
    let weight = model.constants.mass * model.vehicle.gravity;
    let [ix, iy, iz] = model.constants.inertia;
    let parasitic = 0.5 * model.vehicle.air_density * cda;
    let mut text = model.head("#");
    let _ = write!(
        text,
        "#\n# Motor outputs u become speeds: w = rotor_speed_max * sqrt((1 - a) u + a u^2), with a = \
         {}.\nimport numpy as np\n\nquad_params = {{\n",
        real(model.thrust_curve())
    );
    let mut put = |key: &str, value: String| {
        let _ = writeln!(text, "    '{key}': {value},");
    };
    put("mass", real(model.constants.mass));
    for (key, value) in [("Ixx", ix), ("Iyy", iy), ("Izz", iz)] {
        put(key, real(value));
    }
    for key in ["Ixy", "Iyz", "Ixz"] {
        put(key, real(0.0));
    }
    put("num_rotors", ROTORS.to_string());
    let places = model.constants.rotors.iter().enumerate().map(|(index, rotor)| {
        format!("'r{}': np.array([{}])", index + 1, reals(&[rotor.x, -rotor.y, 0.0]))
    });
    put("rotor_pos", format!("{{{}}}", places.collect::<Vec<_>>().join(", ")));
    let directions = model.constants.rotors.map(|rotor| -rotor.torque_per_thrust.signum());
    put("rotor_directions", format!("np.array([{}])", reals(&directions)));
    put("rI", "np.zeros(3)".to_owned());
    for key in ["c_Dx", "c_Dy", "c_Dz"] {
        put(key, real(parasitic));
    }
    let k_eta = thrust / (full * full);
    put("k_eta", real(k_eta));
    put("k_m", real(k_eta * torque));
    put("k_d", real(drag[0] / hover));
    put("k_z", real(drag[2] / hover));
    put("k_h", real(lift.map_or(0.0, |lift| lift.k_s2_m2 * weight / ROTORS as f64)));
    put("k_flap", real(flapping.map_or(0.0, |flapping| -flapping.moment_nms_m / hover)));
    put("tau_m", real(model.constants.motor_time_constant.max(LEAST_LAG)));
    put("rotor_speed_min", real(0.0));
    put("rotor_speed_max", real(full));
    put("motor_noise_std", real(0.0));
    text.push_str("}\n");
    text
}
