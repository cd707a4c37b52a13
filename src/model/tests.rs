//! Every model's derivatives against finite differences, and the effect of a rotated world.

use std::f64::consts::PI;

use proptest::prelude::*;
use proptest::test_runner::TestCaseError;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Euler};

use super::features::{FEATURES_MAX, Features, Head, OUTPUTS};
use super::hybrid::Hybrid;
use super::learned::{LinearTerm, Network, NetworkModel};
use super::net::{Mlp, Normalization};
use super::physics::{PhysicsModel, PhysicsParameters};
use super::{ACCELERATIONS, Model, Point, VARIABLES};

/// Unit of the steps of each variable, and spread of the points about zero: v, omega, zeta, then
/// newtons and newton metres of a nano quadrotor.
const SCALES: [f64; VARIABLES] =
    [2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 0.5, 0.5, 3.0, 0.15, 5e-4, 5e-4, 5e-5];
/// Finite-difference steps, in these units.
const STEP: f64 = 1e-6;

pub(super) fn vehicle() -> VehicleParams {
    VehicleParams::from_toml_str(include_str!("../../config/vehicles/crazyflie.toml"))
        .expect("a vehicle")
}

/// All parameters that a fit may find, at once.
pub(super) fn physics_parameters() -> PhysicsParameters {
    let mut effects = EffectSet::new();
    for effect in [
        "rotor_drag:d_xy=0.012,d_z=0.008",
        "blade_flapping:moment_Nms_m=2e-5,tilt_rad_s_m=0.004",
        "attitude_trim:roll_rad=0.02,pitch_rad=-0.03",
    ] {
        effects.insert_argument(effect).expect("an effect");
    }
    PhysicsParameters { effects, angular_damping_nms: [2e-6, 3e-6, 1e-6] }
}

fn physics() -> PhysicsModel {
    PhysicsModel::new(&vehicle(), &physics_parameters()).expect("physics")
}

/// Networks with the given weights, which repeat if there are too few.
pub(super) fn networks(features: Features, hidden: usize, values: &[f32]) -> NetworkModel {
    let mut values = values.iter().copied().cycle();
    let [linear, angular] = Head::BOTH.map(|head| {
        let names = features.names(head);
        let mut take = |count| values.by_ref().take(count).collect::<Vec<_>>();
        let deviation = names.iter().map(|name| match *name {
            "u1" => 0.05,
            "u2" | "u3" | "u4" => 2e-4,
            _ => 0.8,
        });
        Network {
            inputs: Normalization {
                mean: names.iter().map(|name| if *name == "u1" { 0.3 } else { 0.0 }).collect(),
                deviation: deviation.collect(),
            },
            outputs: Normalization { mean: vec![0.1, -0.2, 0.3], deviation: vec![1.5, 2.0, 0.7] },
            mlp: Mlp {
                inputs: names.len(),
                hidden,
                outputs: OUTPUTS,
                hidden_weights: take(names.len() * hidden),
                hidden_biases: take(hidden),
                output_weights: take(OUTPUTS * hidden),
                output_biases: take(OUTPUTS),
            },
        }
    });
    NetworkModel { features, linear, angular }
}

/// Activity of each hidden unit.
fn active(model: &NetworkModel, at: &[f64; VARIABLES]) -> Vec<bool> {
    let mut active = Vec::new();
    for (head, network) in [(Head::Linear, &model.linear), (Head::Angular, &model.angular)] {
        let mut features = [0.0; FEATURES_MAX];
        let count = model.features.extract(head, at, &mut features);
        let Normalization { mean, deviation } = &network.inputs;
        let x: Vec<f64> = (0..count).map(|i| (features[i] - mean[i]) / deviation[i]).collect();
        for (row, bias) in network.mlp.hidden_weights.chunks(count).zip(&network.mlp.hidden_biases)
        {
            let sum: f64 = row.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum();
            active.push(sum + f64::from(*bias) > 0.0);
        }
    }
    active
}

/// Compares a model's value and derivatives at a point with finite differences; a step across a
/// kink of `networks` is skipped.
fn holds_to_differences(
    model: &dyn Model,
    networks: Option<&NetworkModel>,
    at: &[f64; VARIABLES],
) -> Result<(), TestCaseError> {
    let (value, jacobian) = model.linearize(&Point::from_array(at));
    let direct = model.accelerations(&Point::from_array(at));
    for (value, direct) in value.iter().zip(direct) {
        prop_assert!((value - direct).abs() < 1e-9 * (1.0 + direct.abs()), "{value} {direct}");
    }
    for column in 0..VARIABLES {
        let step = STEP * SCALES[column];
        let [mut above, mut below] = [*at; 2];
        above[column] += step;
        below[column] -= step;
        if networks.is_some_and(|networks| active(networks, &above) != active(networks, &below)) {
            continue;
        }
        let [above, below] =
            [above, below].map(|point| model.accelerations(&Point::from_array(&point)));
        for row in 0..ACCELERATIONS {
            let found = (above[row] - below[row]) / (2.0 * STEP);
            let stated = jacobian[row][column] * SCALES[column];
            let limit = 1e-7 * (1.0 + value[row].abs()) + 1e-6 * stated.abs();
            prop_assert!(
                (found - stated).abs() < limit.max(1e-6),
                "row {row}, column {column}: {stated}, by differences {found}"
            );
        }
    }
    Ok(())
}

fn points() -> impl Strategy<Value = [f64; VARIABLES]> {
    prop::array::uniform13(-1.0_f64..1.0).prop_map(|unit| {
        let mut at: [f64; VARIABLES] = std::array::from_fn(|i| unit[i] * SCALES[i]);
        // Around the thrust of hovering, where every rotor turns.
        at[9] += 0.3;
        at
    })
}

fn weights() -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(-1.0_f32..1.0, 223)
}

fn features() -> impl Strategy<Value = Features> {
    prop::sample::select(&Features::ALL)
}

/// Turns north and east of a vector by `angle` about down.
fn turned([n, e, d]: [f64; 3], angle: f64) -> [f64; 3] {
    let (sin, cos) = angle.sin_cos();
    [cos * n - sin * e, sin * n + cos * e, d]
}

/// The point in a world turned by `angle` about down.
fn turned_point(at: &[f64; VARIABLES], angle: f64) -> Point {
    let mut turned_at = *at;
    turned_at[..3].copy_from_slice(&turned([at[0], at[1], at[2]], angle));
    turned_at[8] += angle;
    Point::from_array(&turned_at)
}

/// Turning the world turns the linear acceleration and leaves the angular one unchanged.
fn holds_at_every_heading(
    model: &dyn Model,
    at: &[f64; VARIABLES],
    angle: f64,
) -> Result<(), TestCaseError> {
    let [n, e, d, angular @ ..] = model.accelerations(&Point::from_array(at));
    let [n2, e2, d2, angular2 @ ..] = model.accelerations(&turned_point(at, angle));
    let pairs = turned([n, e, d], angle).into_iter().zip([n2, e2, d2]);
    for (expected, found) in pairs.chain(angular.into_iter().zip(angular2)) {
        prop_assert!((expected - found).abs() < 1e-8 * (1.0 + expected.abs()));
    }
    Ok(())
}

proptest! {
    #[test]
    fn network_derivatives_match_finite_differences(
        at in points(), values in weights(), features in features(), hidden in 1_usize..30,
    ) {
        let model = networks(features, hidden, &values);
        holds_to_differences(&model, Some(&model), &at)?;
    }

    #[test]
    fn physics_derivatives_match_finite_differences(at in points()) {
        holds_to_differences(&physics(), None, &at)?;
        let plain = PhysicsModel::new(&vehicle(), &PhysicsParameters::default()).expect("physics");
        holds_to_differences(&plain, None, &at)?;
    }

    #[test]
    fn hybrid_derivatives_match_finite_differences(
        at in points(), values in weights(), features in features(), share in 0.0_f64..1.0,
    ) {
        let residual = networks(features, 12, &values).scaled([share, 0.5 * share]);
        let model = Hybrid::new(physics(), residual.clone());
        holds_to_differences(&model, Some(&residual), &at)?;
    }

    #[test]
    fn hybrid_is_the_sum_of_its_parts(at in points(), values in weights()) {
        let residual = networks(Features::World, 12, &values);
        let at = Point::from_array(&at);
        let sum = Hybrid::new(physics(), residual.clone()).accelerations(&at);
        let (a, b) = (physics().accelerations(&at), residual.accelerations(&at));
        for i in 0..ACCELERATIONS {
            prop_assert_eq!(sum[i], a[i] + b[i]);
        }
    }

    #[test]
    fn scaled_network_output_scales_by_its_share(
        at in points(), values in weights(), features in features(), share in 0.0_f64..2.0,
    ) {
        let model = networks(features, 9, &values);
        let shares = [share, 2.0 - share];
        let scaled = model.scaled(shares);
        holds_to_differences(&scaled, Some(&scaled), &at)?;
        let at = Point::from_array(&at);
        let (whole, parts) = (model.accelerations(&at), scaled.accelerations(&at));
        for (i, (whole, part)) in whole.iter().zip(parts).enumerate() {
            let share = shares[usize::from(i >= 3)];
            prop_assert!((share * whole - part).abs() < 1e-9 * (1.0 + whole.abs()));
        }
    }

    #[test]
    fn corrected_network_adds_a_linear_term(
        at in points(), values in weights(), features in features(), slope in -1.0_f64..1.0,
    ) {
        let model = networks(features, 9, &values);
        let (gains, constants) = ([1.2, 0.7, 1.0], [0.1, -0.3, 0.0]);
        let term = LinearTerm { feature: 4, output: 1, slope };
        let angular = model.angular.corrected(gains, constants, &[term]);
        let corrected = NetworkModel { angular, ..model.clone() };
        holds_to_differences(&corrected, Some(&corrected), &at)?;
        let at = Point::from_array(&at);
        let (old, new) = (model.accelerations(&at), corrected.accelerations(&at));
        let Normalization { mean, deviation } = &model.angular.inputs;
        let pitch_rate = (at.body_rate.right() - mean[4]) / deviation[4];
        for i in 0..3 {
            let linear = constants[i] + if i == 1 { slope * pitch_rate } else { 0.0 };
            let expected = gains[i] * old[3 + i] + linear * model.angular.outputs.deviation[i];
            prop_assert!((new[3 + i] - expected).abs() < 1e-5 * (1.0 + expected.abs()));
            prop_assert_eq!(new[i], old[i]);
        }
    }

    #[test]
    fn heading_features_body_features_and_physics_are_rotation_invariant(
        at in points(), values in weights(), angle in -PI..PI,
    ) {
        holds_at_every_heading(&networks(Features::Heading, 15, &values), &at, angle)?;
        holds_at_every_heading(&networks(Features::Body, 15, &values), &at, angle)?;
        holds_at_every_heading(&physics(), &at, angle)?;
        let hybrid = Hybrid::new(physics(), networks(Features::Heading, 15, &values));
        holds_at_every_heading(&hybrid, &at, angle)?;
    }

    #[test]
    fn point_round_trips_through_an_array(at in points()) {
        prop_assert_eq!(Point::from_array(&at).to_array(), at);
    }
}

#[test]
fn world_features_depend_on_heading() {
    let values: Vec<f32> = (0..223).map(|i| (i as f32 * 0.37).sin()).collect();
    let mut at = [0.3; VARIABLES];
    at[10..].fill(1e-4);
    let model = networks(Features::World, 15, &values);
    assert!(holds_at_every_heading(&model, &at, 1.0).is_err());
}

#[test]
fn physics_has_no_acceleration_at_hover() {
    let vehicle = vehicle();
    let model = PhysicsModel::new(&vehicle, &PhysicsParameters::default()).expect("physics");
    let at = Point { input: [vehicle.mass * vehicle.gravity, 0.0, 0.0, 0.0], ..Point::default() };
    for acceleration in model.accelerations(&at) {
        assert!(acceleration.abs() < 1e-9, "{acceleration}");
    }
}

#[test]
fn physics_removes_the_trim_of_the_reported_attitude() {
    // A hovering vehicle reports its trim.
    let vehicle = vehicle();
    let mut effects = EffectSet::new();
    effects.insert_argument("attitude_trim:roll_rad=0.05,pitch_rad=-0.03").expect("an effect");
    let parameters = PhysicsParameters { effects, ..PhysicsParameters::default() };
    let model = PhysicsModel::new(&vehicle, &parameters).expect("physics");
    let reported: Attitude = Euler::new(0.05, -0.03, 0.0).attitude();
    let at = Point {
        attitude: reported.euler(),
        input: [vehicle.mass * vehicle.gravity, 0.0, 0.0, 0.0],
        ..Point::default()
    };
    for acceleration in model.accelerations(&at) {
        assert!(acceleration.abs() < 1e-9, "{acceleration}");
    }
}
