use proptest::prelude::*;

use super::*;
use crate::effects::EffectSet;
use crate::frame::Euler;
use crate::physics::Physics;
use crate::plant::{Plant, Setup};
use crate::scalar::Dual;
use crate::{ROTORS, VehicleParams};

fn line(text: &str) -> Result<Law, LawError> {
    Law::from_line("law", text)
}

fn reason(text: &str) -> String {
    line(text).unwrap_err().to_string()
}

fn vehicle() -> VehicleParams {
    VehicleParams::load("crazyflie").unwrap()
}

fn effects_of(law: Law) -> EffectSet {
    let mut effects = EffectSet::new();
    effects.insert_law(law).unwrap();
    effects
}

fn with(text: &str) -> EffectSet {
    effects_of(line(text).unwrap())
}

#[test]
fn wrong_units_are_refused_with_both_units() {
    let text = reason("force_x = air_x");
    assert!(text.contains("the formula is in m/s, expected N"), "{text}");
    let text = reason("force_x = 1[N] + air_x");
    assert!(text.contains("in m/s cannot be added to a value in N"), "{text}");
    assert!(reason("force_x = 1[N] * sin(air_x)").contains("sin needs a number without a unit"));
    assert!(reason("force_x = 1[kg] * airspeed^1.3").contains("divide it by a reference"));
    assert!(reason("force_x = 1[N] * speed").contains("neither a constant"));
    assert!(reason("thrust = height").contains("expected 1"));
    assert!(reason("lag = 0.01[s] * tilt").contains("only constants and numbers"));
    assert!(reason("push = 1").contains("unknown key"));
    let number = toml::from_str::<LawText>("max_forceN = 1").unwrap_err().to_string();
    assert!(number.contains("max_forceN: expected a formula"), "{number}");
    assert!(line("moment_x = -1e-6[N m s] * rate_x; lag = 0.01[s]").is_ok());
    assert!(line("force_x = -0.01[kg/s] * air_x * (airspeed / 1[m/s])^0.3").is_ok());
}

#[test]
fn law_round_trips_through_toml_and_json() {
    let text = r#"
        [law.drag]
        about = "drag of the body"
        force_x = "-c * air_x * (airspeed / v0)^n"
        constants = { c = "0.012 kg/s", v0 = "1 m/s", n = "0.3" }
        range = { air_x = [-6.0, 6.0] }
        max_force_N = 0.5
        [motor_lag]
        tau_s = 0.03
    "#;
    let set: EffectSet = toml::from_str(text).unwrap();
    assert_eq!(set.laws().len(), 1);
    assert_eq!(toml::from_str::<EffectSet>(&toml::to_string(&set).unwrap()).unwrap(), set);
    assert_eq!(
        serde_json::from_str::<EffectSet>(&serde_json::to_string(&set).unwrap()).unwrap(),
        set
    );
    let wrong = text.replace("kg/s", "kg");
    let error = toml::from_str::<EffectSet>(&wrong).unwrap_err().to_string();
    assert!(error.contains("law \"drag\": force_x"), "{error}");
}

#[test]
fn formula_acts_like_the_catalogue_effect_with_its_equation() {
    let mut known = EffectSet::new();
    known.insert_argument("rotor_drag:d_xy=0.02,d_z=0.01").unwrap();
    let law = with(
        "force_x = -0.02[kg/s]*rotor_speed*air_x; force_y = -0.02[kg/s]*rotor_speed*air_y; \
         force_z = -0.01[kg/s]*rotor_speed*air_z",
    );
    let flown = |effects: &EffectSet| {
        let mut plant = Plant::new(&vehicle(), effects, &Setup::default(), 1).unwrap().airborne();
        plant.set_state(State {
            velocity: Ned::new(2.0, -1.0, 0.5),
            attitude: Euler::new(0.2, -0.1, 0.7).attitude(),
            ..State::default()
        });
        plant.set_rotor_states([0.6; 4]);
        (0..800).for_each(|_| plant.step([0.62, 0.6, 0.61, 0.6]));
        plant.state().position
    };
    let (a, b) = (flown(&known), flown(&law));
    assert!((a - b).norm() < 1e-9, "{a:?} {b:?}");
    assert!((a - flown(&EffectSet::new())).norm() > 1e-2);
}

#[test]
fn batch_and_plant_agree_on_a_law() {
    let law = with("force_north = 0.05[N] * sin(heading); moment_z = -1e-6[N m s]*rate_z");
    let mut plant = Plant::new(&vehicle(), &law, &Setup::default(), 1).unwrap().airborne();
    let mut batch = crate::batch::Batch::<f64>::new(&vehicle(), &law, &Setup::default(), 1, 3)
        .unwrap()
        .airborne();
    let state = State { attitude: Euler::new(0.1, 0.0, 0.9).attitude(), ..State::default() };
    plant.set_state(state);
    plant.set_rotor_states([0.6; 4]);
    batch.set(0, state, [0.6; 4]);
    (0..300).for_each(|_| plant.step([0.6; 4]));
    batch.step(&[[0.6; 4]; 3], 300);
    let apart = plant.state().position - batch.state(0).unwrap().position;
    assert!(apart.norm() < 1e-9, "{apart:?}");
}

#[test]
fn law_saturates_beyond_its_range_and_bound() {
    let mut text = line("force_x = -1[kg/s] * air_x").unwrap().text().clone();
    text.range.insert("air_x".to_owned(), [-2.0, 3.0]);
    text.max_force_n = Some(2.5);
    let effects = effects_of(Law::new("law", text).unwrap());
    let physics = Physics::new(&vehicle(), &effects).unwrap();
    let force = |speed: f64| {
        let state = State { velocity: Ned::new(speed, 0.0, 0.0), ..State::default() };
        let env = physics.calm();
        physics.wrench(&state, &physics.loads(&[0.0; 4], &env), &env).force.front()
    };
    assert_eq!([-9.0, 1.0, 9.0].map(force), [2.0, -1.0, -2.5]);
}

#[test]
fn law_that_spins_the_body_ever_faster_leaves_a_finite_state() {
    let mut text = line("moment_x = 1000[N m]; moment_y = 500[N m]").unwrap().text().clone();
    text.max_moment_nm = Some(1000.0);
    let effects = effects_of(Law::new("law", text).unwrap());
    let mut plant = Plant::new(&vehicle(), &effects, &Setup::default(), 1).unwrap().airborne();
    let states = (0..200).map(|_| {
        plant.step([0.6; ROTORS]);
        *plant.state()
    });
    let states: Vec<State> = states.collect();
    assert!(states.iter().all(State::is_finite));
    // It spins until the steps cannot follow.
    assert!(states.iter().any(|state| state.body_rate.norm() > 1e6));
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics_or_hangs(text in "[-a-z_0-9+*/^()., =;\\[\\]]{0,200}", raw in "\\PC{0,200}") {
        for text in [text, raw] {
            let _ = line(&text);
            let _ = line(&format!("force_x = {text}"));
            let _ = Unit::parse(&text);
        }
    }

    #[test]
    fn deep_nesting_is_refused(depth in 1_usize..400) {
        let text = format!("thrust = {}tilt{}", "(".repeat(depth), ")".repeat(depth));
        prop_assert_eq!(line(&text).is_ok(), depth < 24);
        let _ = line(&format!("thrust = {}tilt", "-".repeat(depth)));
        let _ = line(&format!("thrust = tilt{}", "^2".repeat(depth)));
    }

    #[test]
    fn law_derivatives_match_finite_differences(
        x in prop::array::uniform9(-3.0_f64..3.0),
        which in 0_usize..5,
    ) {
        let formula = [
            "force_x = -0.01[kg/s] * air_x * (airspeed / 1[m/s])^0.3",
            "force_y = 0.02[N] * sin(heading) + 0.01[kg/m] * abs(velocity_y) * velocity_y",
            "moment_z = 1e-4[N m s] * rate_z * exp(-height / 2[m])",
            "force_z = -0.1[kg/m] * airspeed_xy^2 / (1 + airspeed_xy^2 / 4[m^2/s^2])",
            "force_down = 0.1[N] * min(tilt, 0.4) * max(rate_x, rate_y) * 1[s]",
        ][which];
        let effects = with(formula);
        let physics = Physics::new(&vehicle(), &effects).unwrap();
        let env = physics.calm();
        fn state<T: Scalar>(x: [T; 9]) -> State<T> {
            let [a, b, c, d, e, f, g, h, i] = x;
            State {
                position: Ned::new(T::default(), T::default(), -(a * a) - T::from(0.5)),
                velocity: Ned::new(a, b, c),
                attitude: Euler { roll: d * 0.2, pitch: e * 0.2, yaw: f }.attitude(),
                body_rate: Frd::new(g, h, i),
            }
        }
        fn wrench<T: Scalar>(physics: &Physics, env: &Environment, x: [T; 9]) -> [T; 6] {
            let loads = physics.loads(&[T::from(0.6); 4], env);
            let wrench = physics.wrench(&state(x), &loads, env);
            let ([a, b, c], [d, e, f]) = (wrench.force.to_array(), wrench.moment.to_array());
            [a, b, c, d, e, f]
        }
        let duals: [Dual<9>; 9] = std::array::from_fn(|i| Dual::variable(x[i], i));
        let exact = wrench(&physics, &env, duals);
        let h = 1e-6;
        for i in 0..9 {
            let moved = |by: f64| {
                let mut x = x;
                x[i] += by;
                wrench(&physics, &env, x)
            };
            let (up, down) = (moved(h), moved(-h));
            for k in 0..6 {
                let slope = (up[k] - down[k]) / (2.0 * h);
                let found = exact[k].gradient()[i];
                // A kink within the step is not an error.
                let kink = (moved(10.0 * h)[k] - up[k]) / (9.0 * h);
                let is_smooth = (kink - slope).abs() < 1e-4 * (1.0 + slope.abs());
                prop_assert!(!is_smooth || (found - slope).abs() < 1e-4 * (1.0 + slope.abs()), "{found} {slope}");
            }
        }
    }
}
