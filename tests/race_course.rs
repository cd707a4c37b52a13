//! The racing quadrotor and the course of 19 waypoints that published planners are compared on
//! (Foehn, Romero and Scaramuzza, "Time-optimal planning for quadrotor waypoint flight", Science
//! Robotics 2021; Romero, Penicka and Scaramuzza 2022; Qin, Michet, Chen and Liu, "Time-optimal
//! gate-traversing planner for autonomous drone racing", 2024). The numbers are those of
//! FSC-Lab/TOGT-Planner at 6707d3a: `parameters/cpc/cpc_quad.yaml` and
//! `resources/racetrack/race_uzh_19wp.yaml`.

use downwash::plan::time_optimal::{Course, Finish, Knots, Limits, Passage, Start};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Ned};
use vehicle::physics::Physics;

use super::race_judge::{JudgedInput, JudgedLimits, JudgedPassage, JudgedState, JudgedVehicle};

/// Greatest thrust of a rotor, N.
pub const THRUST_N: f64 = 6.879;
/// Greatest body rates in TOGT's file, rad/s. CPC's own file has 0.3 about the vertical axis.
pub const RATES: [f64; 3] = [15.0, 15.0, 3.0];
/// Radius of the balls, m.
pub const RADIUS_M: f64 = 0.3;
/// x, y, z (up), m.
pub const START: [f64; 3] = [-5.0, 4.5, 1.2];
/// x, y, z (up), m.
pub const FINISH: [f64; 3] = [4.75, -0.9, 1.2];
const LAP: [[f64; 3]; 7] = [
    [-1.1, -1.6, 3.6],
    [9.2, 6.6, 1.0],
    [9.2, -4.0, 1.2],
    [-4.5, -6.0, 3.5],
    [-4.5, -6.0, 0.8],
    [4.75, -0.9, 1.2],
    [-2.8, 6.8, 1.2],
];

/// The first `count` of the course's 19 waypoints, x, y, z (up), m.
pub fn waypoints(count: usize) -> impl Iterator<Item = [f64; 3]> {
    LAP.into_iter().cycle().take(count)
}

/// The vehicle file of the racing quadrotor.
pub fn vehicle() -> VehicleParams {
    let arm = 0.15 * std::f64::consts::FRAC_1_SQRT_2;
    let rotor = |front: f64, right: f64, spin: i8| {
        format!(
            "{{ position_m = [{}, {}, 0.0], spin = {spin}, thrust_max_N = {THRUST_N}, \
             drag_torque_per_thrust_m = 0.05 }}",
            front * arm,
            right * arm
        )
    };
    let text = format!(
        "name = 'racer'\nmass = 0.85\ninertia = [0.001, 0.001, 0.0017]\n\
         motor_time_constant_s = 0.0\ncommand_delay_s = 0.0\nhover_thrust = {}\n\
         gravity = 9.8066\nair_density = 1.2\nrotor_radius_m = 0.06\n\
         rotors = [{}, {}, {}, {}]\n[battery]\ncells = 4\nfull_V = 16.8\nnominal_V = 14.8\n\
         [modelled_effects]\n[provenance]\n",
        0.85 * 9.8066 / (4.0 * THRUST_N),
        rotor(1.0, 1.0, 1),
        rotor(-1.0, 1.0, -1),
        rotor(-1.0, -1.0, 1),
        rotor(1.0, -1.0, -1),
    );
    VehicleParams::from_toml_str(&text).expect("the racing quadrotor")
}

/// Its physics.
pub fn physics(vehicle: &VehicleParams) -> Physics {
    Physics::new(vehicle, &EffectSet::new()).expect("physics")
}

/// Its limits.
pub fn limits(body_rate_rad_s: [f64; 3]) -> Limits {
    Limits {
        rotor: [0.0, 1.0],
        body_rate_rad_s,
        yaw_rate_rad_s: None,
        tilt_rad: None,
        speed_m_s: None,
    }
}

/// Up-axes to north, east, down: x is north, y west.
pub fn ned([x, y, z]: [f64; 3]) -> Ned {
    Ned::new(x, -y, -z)
}

/// North, east, down to up-axes.
fn up(vector: Ned) -> [f64; 3] {
    let [n, e, d] = vector.to_array();
    [n, -e, -d]
}

/// A course from rest to rest through the first `count` waypoints.
pub fn course(count: usize, is_level: bool) -> Course {
    Course {
        start: Start { position: ned(START), velocity: Ned::zero(), yaw: 0.0 },
        passages: waypoints(count)
            .map(|centre| Passage::Waypoint { centre: ned(centre), tolerance_m: RADIUS_M })
            .collect(),
        finish: Finish { position: ned(FINISH), velocity: Ned::zero(), is_level },
        keep_out: Vec::new(),
        room: None,
    }
}

/// The vehicle in the judge's form.
pub fn judged_vehicle(vehicle: &VehicleParams) -> JudgedVehicle {
    let rotors = &vehicle.rotors;
    JudgedVehicle {
        mass: vehicle.mass,
        inertia: vehicle.inertia,
        gravity: vehicle.gravity,
        arms: std::array::from_fn(|i| [rotors[i].position_m[0], -rotors[i].position_m[1]]),
        yaw: std::array::from_fn(|i| {
            -f64::from(rotors[i].spin) * rotors[i].drag_torque_per_thrust_m
        }),
    }
}

/// The limits in the judge's form.
pub fn judged_limits(vehicle: &VehicleParams, limits: &Limits) -> JudgedLimits {
    let most = vehicle.rotors[0].thrust_max_n;
    JudgedLimits { thrust: limits.rotor.map(|share| share * most), rate: limits.body_rate_rad_s }
}

/// The course's passages in the judge's form.
pub fn judged_passages(course: &Course) -> Vec<JudgedPassage> {
    let passage = |passage: &Passage| match passage {
        Passage::Waypoint { centre, tolerance_m } => {
            JudgedPassage::Ball { centre: up(*centre), radius: *tolerance_m }
        }
        Passage::Gate(gate) => JudgedPassage::Gate {
            centre: up(gate.centre),
            normal: up(gate.normal),
            side: up(gate.side),
            half: [gate.half_width_m, gate.half_height_m],
        },
    };
    course.passages.iter().map(passage).collect()
}

/// A plan's start and inputs in the judge's form.
pub fn judged_flight(vehicle: &VehicleParams, knots: &Knots) -> (JudgedState, Vec<JudgedInput>) {
    let first = knots.states[0];
    let Attitude { w, x, y, z } = first.attitude;
    let start = JudgedState {
        t: 0.0,
        place: up(first.position),
        velocity: up(first.velocity),
        attitude: [w, x, -y, -z],
        rate: [0.0; 3],
    };
    let inputs = knots.periods.iter().map(|period| JudgedInput {
        thrusts: std::array::from_fn(|i| period.rotors[i] * vehicle.rotors[i].thrust_max_n),
        held: period.length_s,
    });
    (start, inputs.collect())
}
