//! MuJoCo: a free body with four thrusters, each with its drag torque and lag.

use std::fmt::Write as _;

use super::{Model, one_line, real};
use crate::effects::EffectId;

pub(super) fn text(model: &mut Model<'_>) -> String {
    model.lose_but(&[EffectId::ThrustCurve]);
    if model.vehicle.linear_drag_n_per_m_s.is_some() {
        model.lose("linear_drag_N_per_m_s");
    }
    if model.vehicle.angular_damping_nms.is_some() {
        model.lose("angular_damping_Nms");
    }
    if model.constants.motor_time_constant > 0.0 && model.thrust_curve() != 0.0 {
        model.lose("a thrust_curve behind the lag: here it acts before the lag");
    }
    let name = one_line(model.vehicle);
    let lost = model.lost.iter().map(|lost| format!("  Not expressed: {}.\n", dashes(lost)));
    let mut text = format!(
        "<!-- {}, by `downwash vehicle export`.\n{}  Controls are (1 - a) u + a u^2 of motor outputs u, \
         0 to 1, with a = {}.\n  x is front, y left, z up. -->\n",
        dashes(&name),
        lost.collect::<String>(),
        real(model.thrust_curve())
    );
    let [ix, iy, iz] = model.constants.inertia;
    let tau = model.constants.motor_time_constant;
    let lag = if tau > 0.0 {
        format!(" dyntype=\"filterexact\" dynprm=\"{}\"", real(tau))
    } else {
        String::new()
    };
    let _ = writeln!(
        text,
        "<mujoco model=\"{name}\">\n  <option gravity=\"0 0 {}\" timestep=\"0.001\" \
         integrator=\"RK4\"/>\n  <worldbody>\n    <body name=\"vehicle\" pos=\"0 0 1\">\n      \
         <freejoint/>\n      <inertial pos=\"0 0 0\" mass=\"{}\" diaginertia=\"{} {} {}\"/>",
        real(-model.vehicle.gravity),
        real(model.constants.mass),
        real(ix),
        real(iy),
        real(iz)
    );
    for (index, rotor) in model.constants.rotors.iter().enumerate() {
        let (x, y) = (real(rotor.x), real(-rotor.y));
        let _ = writeln!(text, "      <site name=\"rotor{}\" pos=\"{x} {y} 0\"/>", index + 1);
    }
    text.push_str("    </body>\n  </worldbody>\n  <actuator>\n");
    for (index, rotor) in model.constants.rotors.iter().enumerate() {
        let (thrust, torque) = (rotor.thrust_max, -rotor.thrust_max * rotor.torque_per_thrust);
        let _ = writeln!(
            text,
            "    <general name=\"motor{number}\" site=\"rotor{number}\" gear=\"0 0 {} 0 0 {}\" \
             ctrlrange=\"0 1\"{lag}/>",
            real(thrust),
            real(torque),
            number = index + 1
        );
    }
    text.push_str("  </actuator>\n</mujoco>\n");
    text
}

/// Breaks up double dashes, which an XML comment must not contain.
fn dashes(text: &str) -> String {
    let mut text = text.to_owned();
    while text.contains("--") {
        text = text.replace("--", "- -");
    }
    text
}
