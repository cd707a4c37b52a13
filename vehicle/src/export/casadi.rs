//! CasADi: a Python module that builds the equations of motion as one function of state, motor
//! outputs and voltage, in the axes and units of vehicle files.

use std::fmt::Write as _;

use super::{Model, real, reals};
use crate::effects::{
    BatterySag, BladeFlapping, EffectId, GroundEffect, ParasiticDrag, RotorGyroscopic, ThrustCurve,
    TranslationalLift, VortexRing,
};

/// The equations, which do not depend on the vehicle.
const EQUATIONS: &str = include_str!("casadi.py");

pub(super) fn text(model: &mut Model<'_>) -> String {
    model.lose_but(&[
        EffectId::ThrustCurve,
        EffectId::BatterySag,
        EffectId::RotorDrag,
        EffectId::ParasiticDrag,
        EffectId::Wind,
        EffectId::GroundEffect,
        EffectId::TranslationalLift,
        EffectId::BladeFlapping,
        EffectId::VortexRing,
        EffectId::RotorGyroscopic,
    ]);
    let tau = model.constants.motor_time_constant;
    let gyroscopic = model.effect::<RotorGyroscopic>();
    if gyroscopic.is_some() && tau <= 0.0 {
        model.lose("the yaw reaction of rotors whose speed changes at once");
    }
    let vehicle = model.vehicle;
    let rotors = &model.constants.rotors;
    let momentum = gyroscopic.map_or(0.0, |rotor| rotor.rotor_inertia_kgm2 * model.speed_max);
    let (drag, follows_speed) = model.linear_drag().unwrap_or(([0.0; 3], false));
    let flapping = model.effect::<BladeFlapping>();
    let ring = model.effect::<VortexRing>();
    let disc = 4.0 * std::f64::consts::PI * vehicle.rotor_radius_m * vehicle.rotor_radius_m;
    let weight = vehicle.mass * vehicle.gravity;
    let cda = model.effect::<ParasiticDrag>().map_or(0.0, |drag| drag.cda_m2);

    let mut text = model.head("#");
    text.push('\n');
    let mut put = |name: &str, value: String| {
        let _ = writeln!(text, "{name} = {value}");
    };
    let list = |values: &[f64]| format!("[{}]", reals(values));
    let by_speed = |yes: bool| if yes == follows_speed { drag } else { [0.0; 3] };
    put("MASS", real(model.constants.mass));
    put("INERTIA", list(&model.constants.inertia));
    put("GRAVITY", real(vehicle.gravity));
    put("ROTOR_X", list(&rotors.map(|rotor| rotor.x)));
    put("ROTOR_Y", list(&rotors.map(|rotor| rotor.y)));
    put("THRUST_MAX", list(&rotors.map(|rotor| rotor.thrust_max)));
    put("TORQUE_PER_THRUST", list(&rotors.map(|rotor| rotor.torque_per_thrust)));
    put("SPIN_MOMENTUM", list(&rotors.map(|rotor| -momentum * rotor.spin)));
    put("LAG", real(tau));
    put("THRUST_CURVE", real(model.effect::<ThrustCurve>().map_or(0.0, |curve| curve.a)));
    put("SAG_EXPONENT", real(model.effect::<BatterySag>().map_or(0.0, |sag| sag.exponent)));
    put("FULL_VOLTAGE", real(vehicle.battery.full_v));
    put("WIND", list(&model.wind.to_array()));
    put("HOVER_SPEED", real(model.hover_speed()));
    put("ROTOR_DRAG", list(&by_speed(true)));
    put("LINEAR_DRAG", list(&by_speed(false)));
    put("ANGULAR_DAMPING", list(&vehicle.angular_damping_nms.unwrap_or_default()));
    put("PARASITIC_DRAG", real(0.5 * vehicle.air_density * cda));
    put("FLAPPING_MOMENT", real(flapping.map_or(0.0, |flapping| flapping.moment_nms_m)));
    put("FLAPPING_TILT", real(flapping.map_or(0.0, |flapping| flapping.tilt_rad_s_m)));
    put("GROUND_RADIUS", real(model.effect::<GroundEffect>().map_or(0.0, |ground| ground.r_eff_m)));
    put("LIFT", real(model.effect::<TranslationalLift>().map_or(0.0, |lift| lift.k_s2_m2)));
    put("INDUCED_VELOCITY", real((weight / (2.0 * vehicle.air_density * disc)).sqrt()));
    put("RING_LOSS", real(ring.map_or(0.0, |ring| ring.loss_max)));
    put("RING_ONSET", real(ring.map_or(0.0, |ring| ring.onset_ratio)));
    put("RING_FULL", real(ring.map_or(1.0, |ring| ring.full_ratio)));
    text.push('\n');
    text.push_str(EQUATIONS);
    text
}
