//! Jacobians from dual numbers against central differences, with every effect on.

use crate::common::{ROTOR_STATES, effects, moving, quad};
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::physics::Physics;
use vehicle::rigid_body::State;
use vehicle::scalar::{Dual, Scalar};

const VARIABLES: usize = 16;

/// position, velocity, Euler angles, body rate, four rotor states or a wrench -> accelerations.
fn accelerations<T: Scalar>(physics: &Physics, x: [T; VARIABLES], wrench: bool) -> [T; 6] {
    let state = State {
        position: Ned::new(x[0], x[1], x[2]),
        velocity: Ned::new(x[3], x[4], x[5]),
        attitude: Euler::new(x[6], x[7], x[8]).attitude() as Attitude<T>,
        body_rate: Frd::new(x[9], x[10], x[11]),
    };
    let (inputs, env) = ([x[12], x[13], x[14], x[15]], physics.calm());
    let (a, alpha) = if wrench {
        physics.accelerations_for_wrench(&state, &inputs, &env)
    } else {
        physics.accelerations(&state, &inputs, &env)
    };
    let ([a, b, c], [d, e, f]) = (a.to_array(), alpha.to_array());
    [a, b, c, d, e, f]
}

#[test]
fn dual_numbers_and_finite_differences_agree() {
    let every_effect = [
        "thrust_curve:a=0.4",
        "battery_sag:exponent=2",
        "rotor_drag:d_xy=0.3,d_z=0.1",
        "parasitic_drag:cda_m2=0.02",
        "wind:north_m_s=1,east_m_s=2",
        "ground_effect:r_eff_m=0.4",
        "translational_lift:k_s2_m2=0.01",
        "blade_flapping:moment_Nms_m=0.04,tilt_rad_s_m=0.01",
        "vortex_ring:loss_max=0.3",
        "com_offset:x_m=0.01,y_m=-0.005",
        "rotor_gyroscopic:rotor_inertia_kgm2=4e-5",
        "inertia:scale=[1.2,1.1,0.9]",
    ];
    let start = moving();
    let [n, e, d] = start.position.to_array();
    let [u, v, w] = start.velocity.to_array();
    let Euler { roll, pitch, yaw } = start.attitude.euler();
    let [p, q, r] = start.body_rate.to_array();
    for set in [&every_effect[..], &[]] {
        let physics = Physics::new(&quad(), &effects(set)).unwrap();
        for (wrench, [a, b, c, f]) in [(false, ROTOR_STATES), (true, [12.0, 0.1, -0.05, 0.02])] {
            let x = [n, e, d, u, v, w, roll, pitch, yaw, p, q, r, a, b, c, f];
            let duals = std::array::from_fn(|i| Dual::<VARIABLES>::variable(x[i], i));
            let exact = accelerations(&physics, duals, wrench);
            let value = accelerations(&physics, x, wrench);
            for (dual, value) in exact.iter().zip(value) {
                assert!((dual.value() - value).abs() < 1e-12 * (1.0 + value.abs()));
            }
            for i in 0..VARIABLES {
                let step = 1e-6;
                let moved = |by: f64| {
                    let mut y = x;
                    y[i] += by;
                    accelerations(&physics, y, wrench)
                };
                let (up, down) = (moved(step), moved(-step));
                for j in 0..6 {
                    let difference = (up[j] - down[j]) / (2.0 * step);
                    let error = (exact[j].gradient()[i] - difference).abs();
                    assert!(error < 1e-6 * (1.0 + difference.abs()), "d{j}/d{i}: {error}");
                }
            }
        }
    }
}

/// At rest on stopped rotors no derivative may be infinite or undefined.
#[test]
fn derivatives_at_rest_are_finite() {
    let set = effects(&["rotor_drag:d_xy=0.3", "parasitic_drag:cda_m2=0.02"]);
    let physics = Physics::new(&quad(), &set).unwrap();
    let zero = std::array::from_fn(|i| Dual::<VARIABLES>::variable(0.0, i));
    for dual in accelerations(&physics, zero, false) {
        assert!(dual.value().is_finite() && dual.gradient().iter().all(|d| d.is_finite()));
    }
}
