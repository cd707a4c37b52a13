//! Every effect of the catalogue: none when neutral, its equation when on.
//!
//! The expected values follow from EFFECTS' formulas in plain numbers, at one state in which every
//! effect acts.

use crate::common::{ROTOR_STATES, airborne, effects, moving, quad};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet, Kind, Neutral, Slots};
use vehicle::frame::{Frd, Ned};
use vehicle::physics::{Environment, Physics};
use vehicle::plant::{Plant, Setup};

/// Force without gravity (N) and moment (N m), from the accelerations and the true constants.
fn force_and_moment(physics: &Physics, env: &Environment) -> (Frd, Frd) {
    let state = moving();
    let (acceleration, angular) = physics.accelerations(&state, &ROTOR_STATES, env);
    let gravity = Ned::new(0.0, 0.0, physics.body().gravity());
    let force = state.attitude.to_body(acceleration - gravity) * physics.body().mass();
    let inertia = physics.body().inertia();
    let momentum = state.body_rate.scale_by(inertia);
    (force, angular.scale_by(inertia) + state.body_rate.cross(momentum))
}

fn with(arguments: &[&str]) -> (Frd, Frd) {
    let physics = Physics::new(&quad(), &effects(arguments)).unwrap();
    force_and_moment(&physics, &physics.calm())
}

/// What the effects add to the nominal force and moment.
fn added(arguments: &[&str]) -> ([f64; 3], [f64; 3]) {
    let ((force, moment), (force0, moment0)) = (with(arguments), with(&[]));
    ((force - force0).to_array(), (moment - moment0).to_array())
}

#[track_caller]
fn assert_close(found: [f64; 3], expected: [f64; 3]) {
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "found {found:?}, expected {expected:?}");
    }
}

// The state, in the effects' symbols.
const RHO: f64 = 1.2;
const THRUST_MAX: f64 = 6.0;
const ARM: f64 = 0.13;
const KAPPA: f64 = 0.016;

fn air_relative() -> [f64; 3] {
    // R^T v with R = Rz(1.1) Ry(-0.3) Rx(0.2).
    let (sr, cr) = 0.2_f64.sin_cos();
    let (sp, cp) = (-0.3_f64).sin_cos();
    let (sy, cy) = 1.1_f64.sin_cos();
    let [n, e, d] = [2.0, -1.0, 3.0];
    [
        cp * cy * n + cp * sy * e - sp * d,
        (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d,
        (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d,
    ]
}

fn rotor_thrusts() -> [f64; 4] {
    ROTOR_STATES.map(|s| THRUST_MAX * s)
}

/// Moments of four thrusts at the nominal arms: front right, rear right, rear left, front left.
fn moments([a, b, c, d]: [f64; 4]) -> [f64; 3] {
    [ARM * (-a - b + c + d), ARM * (a - b - c + d), KAPPA * (a - b + c - d)]
}

fn speed_ratio() -> f64 {
    let mean = ROTOR_STATES.map(f64::sqrt).iter().sum::<f64>() / 4.0;
    mean / 0.4903325_f64.sqrt()
}

#[test]
fn nominal_vehicle_has_only_thrust_and_drag_torque() {
    let (force, moment) = with(&[]);
    assert_close(force.to_array(), [0.0, 0.0, -rotor_thrusts().iter().sum::<f64>()]);
    assert_close(moment.to_array(), moments(rotor_thrusts()));
}

fn neutral(id: EffectId, vehicle: &VehicleParams) -> Slots {
    let mut slots = Slots::default();
    for slot in id.spec().slots() {
        slots[slot.index] = match (slot.parameter.neutral, slot.parameter.default) {
            (Neutral::Value(value), _) | (Neutral::None, Some(value)) => value,
            (Neutral::Vehicle(of), _) => of(vehicle),
            (Neutral::None, None) => {
                assert_eq!(slot.parameter.kind, Kind::Index);
                0.0
            }
        };
    }
    slots
}

#[test]
fn neutral_parameters_match_the_nominal_vehicle() {
    let mut vehicle = quad();
    vehicle.motor_time_constant_s = 0.03;
    let fly = |set: &EffectSet| {
        let mut plant = airborne(&vehicle, set);
        plant.set_state(moving());
        plant.set_rotor_states(ROTOR_STATES);
        for _ in 0..200 {
            plant.step([0.6, 0.5, 0.58, 0.55]);
        }
        *plant.state()
    };
    let nominal = fly(&EffectSet::new());
    for id in EffectId::ALL {
        let mut set = EffectSet::new();
        set.insert(id, neutral(id, &vehicle)).unwrap();
        let state = fly(&set);
        assert!((state.position - nominal.position).norm() < 1e-12, "{id}");
        assert!((state.body_rate - nominal.body_rate).norm() < 1e-10, "{id}");
    }
}

#[test]
fn thrust_scale_scales_thrust_and_drag_torque() {
    let (force, moment) = with(&["thrust_scale:scale=1.2"]);
    let scaled = rotor_thrusts().map(|t| 1.2 * t);
    assert_close(force.to_array(), [0.0, 0.0, -scaled.iter().sum::<f64>()]);
    assert_close(moment.to_array(), moments(scaled));
}

#[test]
fn mass_changes_only_the_acceleration() {
    let physics = Physics::new(&quad(), &effects(&["mass:mass_kg=1.5"])).unwrap();
    assert_eq!((physics.body().mass(), physics.body().inertia()), (1.5, quad().inertia));
    assert_close(with(&["mass:mass_kg=1.5"]).0.to_array(), with(&[]).0.to_array());
}

#[test]
fn thrust_curve_bends_thrust() {
    let (force, moment) = with(&["thrust_curve:a=0.4"]);
    let bent = ROTOR_STATES.map(|s| THRUST_MAX * (0.6 * s + 0.4 * s * s));
    assert_close(force.to_array(), [0.0, 0.0, -bent.iter().sum::<f64>()]);
    assert_close(moment.to_array(), moments(bent));
}

#[test]
fn battery_sag_follows_the_voltage() {
    let set = effects(&["battery_sag:exponent=1.7", "rotor_drag:d_xy=0.3,d_z=0.1"]);
    let physics = Physics::new(&quad(), &set).unwrap();
    let (force, _) = force_and_moment(&physics, &physics.environment(15.0, Ned::zero()));
    let factor = (15.0_f64 / 16.8).powf(1.7);
    // Squared rotor speed sags too, and with it the drag.
    let nr = speed_ratio() * factor.sqrt();
    let [x, y, z] = air_relative();
    let thrust = factor * rotor_thrusts().iter().sum::<f64>();
    assert_close(force.to_array(), [-nr * 0.3 * x, -nr * 0.3 * y, -thrust - nr * 0.1 * z]);
}

#[test]
fn rotor_loss_weakens_one_rotor() {
    let (force, moment) = with(&["rotor_loss:rotor=2,scale=0.8"]);
    let [a, b, c, d] = rotor_thrusts();
    assert_close(force.to_array(), [0.0, 0.0, -(a + b + 0.8 * c + d)]);
    assert_close(moment.to_array(), moments([a, b, 0.8 * c, d]));
}

#[test]
fn motor_lag_is_the_total_time_constant() {
    let mut vehicle = quad();
    vehicle.motor_time_constant_s = 0.02;
    let mut plant = airborne(&vehicle, &effects(&["motor_lag:tau_s=0.06"]));
    for _ in 0..60 {
        plant.step([1.0; 4]);
    }
    assert!((plant.rotor_states()[0] - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
}

#[test]
fn rotor_drag_grows_with_rotor_speed() {
    let [x, y, z] = air_relative();
    let nr = speed_ratio();
    let (force, moment) = added(&["rotor_drag:d_xy=0.3,d_z=0.1"]);
    assert_close(force, [-nr * 0.3 * x, -nr * 0.3 * y, -nr * 0.1 * z]);
    assert_close(moment, [0.0; 3]);
}

#[test]
fn parasitic_drag_is_quadratic() {
    let v = air_relative();
    let speed = 14.0_f64.sqrt();
    let (force, moment) = added(&["parasitic_drag:cda_m2=0.02"]);
    assert_close(force, v.map(|c| -0.5 * RHO * 0.02 * speed * c));
    assert_close(moment, [0.0; 3]);
}

#[test]
fn wind_acts_only_through_drag() {
    assert_close(added(&["wind:north_m_s=2,east_m_s=-1,down_m_s=3"]).0, [0.0; 3]);
    // Wind equal to the vehicle's velocity: no drag.
    let wind = "wind:north_m_s=2,east_m_s=-1,down_m_s=3";
    assert_close(added(&["rotor_drag:d_xy=0.3,d_z=0.1", wind]).0, [0.0; 3]);
    // Twice that: the opposite drag.
    let wind = "wind:north_m_s=4,east_m_s=-2,down_m_s=6";
    let against = added(&["rotor_drag:d_xy=0.3,d_z=0.1"]).0;
    assert_close(added(&["rotor_drag:d_xy=0.3,d_z=0.1", wind]).0, against.map(|c| -c));
}

#[test]
fn gusts_depend_on_the_seed() {
    let set = effects(&["gusts:sigma_m_s=2,length_m=1,speed_m_s=2", "rotor_drag:d_xy=0.3"]);
    let fly = |seed| {
        let mut setup = Setup::default();
        setup.start.position_m = [0.0, 0.0, -50.0];
        let mut plant = Plant::new(&quad(), &set, &setup, seed).unwrap();
        for _ in 0..500 {
            plant.step([0.5; 4]);
        }
        (*plant.state(), plant.air_velocity())
    };
    assert_eq!(fly(1), fly(1));
    assert_ne!(fly(1), fly(2));
    assert!(fly(1).0.position.north().abs() > 1e-3);
}

/// The thrust factors: force along down and roll and pitch moments scale, yaw torque does not.
#[track_caller]
fn assert_factor(argument: &str, factor: f64) {
    let (force, moment) = with(&[argument]);
    let [roll, pitch, yaw] = moments(rotor_thrusts());
    let thrust: f64 = rotor_thrusts().iter().sum();
    assert_close(force.to_array(), [0.0, 0.0, -factor * thrust]);
    assert_close(moment.to_array(), [factor * roll, factor * pitch, yaw]);
}

#[test]
fn ground_effect_follows_cheeseman_bennett_up_to_its_limit() {
    // The height is 0.6 m.
    assert_factor("ground_effect:r_eff_m=0.8", 1.0 / (1.0 - (0.8_f64 / 2.4).powi(2)));
    assert_factor("ground_effect:r_eff_m=2", 1.0 / 0.65);
}

#[test]
fn ground_effect_is_at_its_limit_on_the_floor_and_below() {
    let physics = Physics::new(&quad(), &effects(&["ground_effect:r_eff_m=0.5"])).unwrap();
    for down in [0.0, 0.01, -1e-300] {
        let mut state = moving();
        state.position = Ned::new(0.0, 0.0, down);
        state.attitude = Default::default();
        let (a, _) = physics.accelerations(&state, &[0.5; 4], &physics.calm());
        assert!((a.down() - (9.80665 - 12.0 / 1.2 / 0.65)).abs() < 1e-9, "at {down}");
    }
}

#[test]
fn translational_lift_grows_with_horizontal_speed_up_to_its_limit() {
    let [x, y, _] = air_relative();
    assert_factor("translational_lift:k_s2_m2=0.05", 1.0 + 0.05 * (x * x + y * y));
    assert_factor("translational_lift:k_s2_m2=1", 1.5);
}

#[test]
fn blade_flapping_tilts_thrust_and_adds_moment() {
    let [x, y, _] = air_relative();
    let thrust: f64 = rotor_thrusts().iter().sum();
    let (force, moment) = added(&["blade_flapping:moment_Nms_m=0.04,tilt_rad_s_m=0.01"]);
    assert_close(force, [-thrust * 0.01 * x, -thrust * 0.01 * y, 0.0]);
    assert_close(moment, [-0.04 * speed_ratio() * y, 0.04 * speed_ratio() * x, 0.0]);
    // Flapping acts on the thrust before the aerodynamic factors.
    let both = "ground_effect:r_eff_m=2";
    let (with_ground, _) = with(&["blade_flapping:tilt_rad_s_m=0.01", both]);
    assert!((with_ground.front() + thrust * 0.01 * x).abs() < 1e-9);
}

#[test]
fn vortex_ring_reduces_thrust_in_descent() {
    let [x, y, z] = air_relative();
    let disc = std::f64::consts::PI * 0.127 * 0.127;
    let induced = (1.2 * 9.80665 / (2.0 * RHO * 4.0 * disc)).sqrt();
    let u = ((z / induced - 0.2) / 0.8).clamp(0.0, 1.0);
    assert!(u > 0.1 && u < 0.9, "the state is between onset and full: {u}");
    let step = u * u * (3.0 - 2.0 * u);
    let factor = 1.0 - 0.3 * step * (-(x * x + y * y) / (induced * induced)).exp();
    assert_factor("vortex_ring:loss_max=0.3,onset_ratio=0.2,full_ratio=1.0", factor);
    let full = 1.0 - 0.3 * (-(x * x + y * y) / (induced * induced)).exp();
    assert_factor("vortex_ring:loss_max=0.3,onset_ratio=0.1,full_ratio=0.1", full);
    assert_factor("vortex_ring:loss_max=0.3,onset_ratio=2,full_ratio=3", 1.0);
}

#[test]
fn vortex_ring_uses_the_nominal_mass() {
    let heavy = with(&["vortex_ring:loss_max=0.3", "mass:mass_kg=1.6"]).0;
    assert_close(heavy.to_array(), with(&["vortex_ring:loss_max=0.3"]).0.to_array());
}

#[test]
fn inertia_scales_each_axis() {
    let physics = Physics::new(&quad(), &effects(&["inertia:scale=[1.2,1.1,0.9]"])).unwrap();
    let [x, y, z] = quad().inertia;
    assert_close(physics.body().inertia(), [1.2 * x, 1.1 * y, 0.9 * z]);
}

#[test]
fn com_offset_shifts_the_arms() {
    let thrust: f64 = rotor_thrusts().iter().sum();
    let (force, moment) = added(&["com_offset:x_m=0.01,y_m=-0.005"]);
    assert_close(force, [0.0; 3]);
    assert_close(moment, [-0.005 * thrust, -0.01 * thrust, 0.0]);
}

#[test]
fn rotor_gyroscopic_turns_with_the_body() {
    let max = 8500.0 * std::f64::consts::TAU / 60.0;
    let [a, b, c, d] = ROTOR_STATES.map(f64::sqrt);
    let h = -4e-5 * max * (a - b + c - d);
    let (force, moment) = added(&["rotor_gyroscopic:rotor_inertia_kgm2=4e-5"]);
    assert_close(force, [0.0; 3]);
    // -omega x (0, 0, h) with omega = (1, -0.7, 0.5).
    assert_close(moment, [0.7 * h, h, 0.0]);
}

#[test]
fn yaw_torque_scales_drag_torque() {
    let [roll, pitch, yaw] = moments(rotor_thrusts());
    assert_close(with(&["yaw_torque:scale=1.5"]).1.to_array(), [roll, pitch, 1.5 * yaw]);
}

#[test]
fn linear_drag_and_damping_of_the_file_are_applied() {
    let mut vehicle = quad();
    vehicle.linear_drag_n_per_m_s = Some(0.5);
    vehicle.angular_damping_nms = Some([0.01, 0.02, 0.03]);
    let physics = Physics::new(&vehicle, &EffectSet::new()).unwrap();
    let (force, moment) = force_and_moment(&physics, &physics.calm());
    let thrust: f64 = rotor_thrusts().iter().sum();
    let [x, y, z] = air_relative();
    assert_close(force.to_array(), [-0.5 * x, -0.5 * y, -thrust - 0.5 * z]);
    let [roll, pitch, yaw] = moments(rotor_thrusts());
    assert_close(moment.to_array(), [roll - 0.01, pitch + 0.014, yaw - 0.015]);
}

#[test]
fn linear_drag_replaces_modelled_and_identified_drag_replaces_both() {
    let mut vehicle = quad();
    vehicle.linear_drag_n_per_m_s = Some(0.5);
    let force = |vehicle: &VehicleParams, overlay: &EffectSet| {
        let physics = Physics::new(vehicle, overlay).unwrap();
        force_and_moment(&physics, &physics.calm()).0.to_array()
    };
    let linear = force(&vehicle, &EffectSet::new());
    vehicle.modelled_effects = effects(&["rotor_drag:d_xy=0.3,d_z=0.1"]);
    assert_close(force(&vehicle, &EffectSet::new()), linear);
    let found = effects(&["rotor_drag:d_xy=0.4,d_z=0.2"]);
    let expected = with(&["rotor_drag:d_xy=0.4,d_z=0.2"]).0;
    assert_close(force(&vehicle, &found), expected.to_array());
}

#[test]
fn rotor_gyroscopic_requires_rotor_max_rpm() {
    let mut vehicle = quad();
    vehicle.rotor_max_rpm = None;
    let set = effects(&["rotor_gyroscopic:rotor_inertia_kgm2=1e-5"]);
    let error = Physics::new(&vehicle, &set).unwrap_err().to_string();
    assert!(error.contains("rotor_max_rpm"), "{error}");
}

#[test]
fn rpm_has_the_sign_of_spin_regardless_of_thrust() {
    let mut plant = airborne(&quad(), &effects(&["thrust_scale:scale=0.5"]));
    plant.set_rotor_states([0.25; 4]);
    assert_eq!(plant.rpm(), Some([4250.0, -4250.0, 4250.0, -4250.0]));
}
