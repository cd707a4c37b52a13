//! Random airframes: quadrotors from 25 g to 4 kg with the proportions of real ones.

use vehicle::effects::EffectSet;
use vehicle::{AttitudePd, BatteryParams, RotorParams, VehicleParams};

use super::draw::{Draw, rounded};

/// Range of the mass, kg.
const MASS: [f64; 2] = [0.025, 4.0];
/// Power of the mass that arms grow with: 46 mm at 30 g, 19 cm at 1.2 kg.
const ARM_POWER: f64 = 0.38;
const ARM_AT_30_G_M: f64 = 0.046;
/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.80665;
/// Upper limit of the loop's natural frequency times the lag of the rotors.
const LAG_SHARE: f64 = 0.7;

/// A vehicle as its builder would describe it. `name` must not reveal anything about the case.
pub fn vehicle(draw: &mut Draw, name: &str) -> VehicleParams {
    let mass = draw.log_within(MASS);
    let arm = ARM_AT_30_G_M * (mass / 0.03).powf(ARM_POWER) * draw.within([0.85, 1.2]);
    let angle = draw.within([38.0, 52.0]).to_radians();
    let (x, y) = (rounded(arm * angle.cos()), rounded(arm * angle.sin()));
    let roll = mass * arm * arm * draw.within([0.2, 0.34]);
    let pitch = roll * draw.within([1.0, 1.25]);
    let yaw = (roll + pitch) * draw.within([0.8, 0.96]);
    let inertia = [roll, pitch, yaw].map(rounded);
    let hover = draw.within([0.36, 0.58]);
    let thrust_max_n = rounded(mass * GRAVITY / (4.0 * hover));
    let drag_torque_per_thrust_m = rounded(arm * draw.within([0.08, 0.13]));
    let spin = if draw.chance(0.5) { 1 } else { -1 };
    let corners = [(x, y, spin), (-x, y, -spin), (-x, -y, spin), (x, -y, -spin)];
    let first = draw.below(4);
    let rotors = std::array::from_fn(|i| {
        let (x, y, spin) = corners[(i + first) % 4];
        RotorParams { position_m: [x, y, 0.0], spin, thrust_max_n, drag_torque_per_thrust_m }
    });
    let lag = if draw.chance(0.5) { 0.0 } else { (draw.within([0.02, 0.05]) * 1e3).round() * 1e-3 };
    let rotor_radius_m = rounded(arm * draw.within([0.5, 0.66]));
    let tip_speed = draw.within([55.0, 120.0]);
    let rpm = tip_speed / rotor_radius_m * 60.0 / std::f64::consts::TAU;
    let cells = match mass {
        m if m < 0.06 => 1,
        m if m < 0.3 => 2,
        m if m < 0.8 => 3,
        m if m < 2.5 => 4,
        _ => 6,
    };
    VehicleParams {
        name: name.to_owned(),
        mass: rounded(mass),
        inertia,
        rotors,
        motor_time_constant_s: lag,
        command_delay_s: (draw.within([0.003, 0.008]) * 1e3).round() * 1e-3,
        attitude_pd: Some(attitude_pd(draw, inertia, lag)),
        attitude_cascade: None,
        hover_thrust: rounded(rounded(mass) * GRAVITY / (4.0 * thrust_max_n)),
        gravity: GRAVITY,
        air_density: rounded(draw.within([1.1, 1.24])),
        rotor_radius_m,
        rotor_max_rpm: draw.chance(0.9).then(|| rounded(rpm).round()),
        battery: BatteryParams {
            cells,
            full_v: rounded(4.2 * f64::from(cells)),
            nominal_v: rounded(3.7 * f64::from(cells)),
        },
        modelled_effects: EffectSet::new(),
        motor_output: None,
        linear_drag_n_per_m_s: None,
        angular_damping_nms: None,
        autopilot: None,
        notes: Vec::new(),
        provenance: serde_json::Map::new(),
    }
}

fn attitude_pd(draw: &mut Draw, inertia: [f64; 3], lag: f64) -> AttitudePd {
    let most = if lag > 0.0 { LAG_SHARE / lag } else { f64::INFINITY };
    let tilt = draw.within([11.0, 18.0]).min(most);
    let frequency = [tilt, tilt, draw.within([4.5, 8.0])];
    let damping = [draw.within([0.75, 0.95]), draw.within([0.75, 0.95]), 0.9];
    let kp = std::array::from_fn(|i| rounded(inertia[i] * frequency[i] * frequency[i]));
    let kd = std::array::from_fn(|i| rounded(2.0 * damping[i] * frequency[i] * inertia[i]));
    AttitudePd { kp, kd, rate_hz: 250.0 }
}

/// Horizontal distance of the first rotor from the centre of mass, m: every drawn airframe is
/// symmetric.
pub(super) fn arm_m(vehicle: &VehicleParams) -> f64 {
    let [x, y, _] = vehicle.rotors[0].position_m;
    x.hypot(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_drawn_vehicle_is_valid_and_round_trips() {
        for number in 0..300 {
            let drawn = vehicle(&mut Draw::new(11, number), "quad");
            let checked = drawn.clone().checked();
            assert!(checked.is_ok(), "{checked:?}");
            let json = serde_json::to_string(&drawn).expect("JSON");
            assert_eq!(VehicleParams::from_json_str(&json).expect("a vehicle"), drawn);
        }
    }
}
