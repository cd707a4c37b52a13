//! The near-hover model for the LQR's design: the vehicle's equations of motion with the attitude
//! loop inside, linearised at hover and zero yaw.

use nalgebra::SMatrix;
use vehicle::frame::{Euler, Frd, Ned};
use vehicle::rigid_body::{RigidBody, State};
use vehicle::scalar::{Dual, Scalar};

use super::attitude_loop::AttitudeLoop;

/// Size of the state `(p, v, zeta, omega)`.
pub(super) const STATES: usize = 12;
/// Size of the input `u_hat = (u1, zeta_des, omega_des)`.
pub(super) const INPUTS: usize = 7;
const VARIABLES: usize = STATES + INPUTS;

/// The vehicle parameters of the near-hover model, best estimates: a vehicle file's numbers with
/// its modelled effects applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoverVehicle {
    /// kg
    pub mass_kg: f64,
    /// Principal moments about body x, y, z, kg m^2.
    pub inertia: [f64; 3],
    /// m/s^2
    pub gravity: f64,
}

impl HoverVehicle {
    /// Collective thrust at hover, `m g`, in N.
    pub fn hover_thrust_n(&self) -> f64 {
        self.mass_kg * self.gravity
    }
}

/// A linear model `s+ = A s + B u_hat` of the errors from hover at zero yaw, over one control
/// period. States: position and velocity in NED, (roll, pitch, yaw), body rate. A loop that takes
/// no rates has zero columns for them.
#[derive(Clone, Copy, Debug)]
pub struct HoverModel {
    /// `A`.
    pub state: SMatrix<f64, STATES, STATES>,
    /// `B`.
    pub input: SMatrix<f64, STATES, INPUTS>,
}

impl HoverModel {
    /// The continuous model `ds/dt = A s + B u_hat`: exact Jacobians, by dual numbers.
    pub fn continuous(vehicle: &HoverVehicle, attitude_loop: &AttitudeLoop) -> Self {
        let state = std::array::from_fn(|i| Dual::<VARIABLES>::variable(0.0, i));
        let hover: [f64; INPUTS] =
            std::array::from_fn(|i| if i == 0 { vehicle.hover_thrust_n() } else { 0.0 });
        let input = std::array::from_fn(|i| Dual::variable(hover[i], STATES + i));
        let derivative = state_derivative(vehicle, attitude_loop, state, input);
        Self {
            state: SMatrix::from_fn(|row, column| derivative[row].gradient()[column]),
            input: SMatrix::from_fn(|row, column| derivative[row].gradient()[STATES + column]),
        }
    }

    /// The model over a period (s) during which the input is held:
    /// `exp([A B; 0 0] period) = [A_d B_d; 0 I]` (van Loan, 1978).
    pub fn discretised(&self, period_s: f64) -> Self {
        let mut augmented = SMatrix::<f64, VARIABLES, VARIABLES>::zeros();
        augmented.fixed_view_mut::<STATES, STATES>(0, 0).copy_from(&(self.state * period_s));
        augmented.fixed_view_mut::<STATES, INPUTS>(0, STATES).copy_from(&(self.input * period_s));
        let exponential = augmented.exp();
        Self {
            state: exponential.fixed_view::<STATES, STATES>(0, 0).into(),
            input: exponential.fixed_view::<STATES, INPUTS>(0, STATES).into(),
        }
    }

    /// Whether every entry is finite.
    pub fn is_finite(&self) -> bool {
        self.state.iter().chain(self.input.iter()).all(|entry| entry.is_finite())
    }
}

/// `ds/dt`: `dp = v`, `dzeta = W(zeta) omega`, and the plant's own Newton-Euler equations under
/// thrust and the attitude loop's moment.
fn state_derivative<T: Scalar>(
    vehicle: &HoverVehicle,
    attitude_loop: &AttitudeLoop,
    state: [T; STATES],
    input: [T; INPUTS],
) -> [T; STATES] {
    let [_, _, _, vn, ve, vd, roll, pitch, yaw, p, q, r] = state;
    let [thrust, roll_des, pitch_des, yaw_des, p_des, q_des, r_des] = input;
    let attitude = Euler::new(roll, pitch, yaw);
    let zero = T::default();
    let rigid_body = RigidBody::new(vehicle.mass_kg, vehicle.inertia, vehicle.gravity);
    let state = State {
        position: Ned::zero(),
        velocity: Ned::new(vn, ve, vd),
        attitude: attitude.attitude(),
        body_rate: Frd::new(p, q, r),
    };
    let error = [roll_des - roll, pitch_des - pitch, yaw_des - yaw];
    let turn = attitude_loop.angular_acceleration(
        vehicle.inertia,
        error,
        [p_des, q_des, r_des],
        [p, q, r],
    );
    let moment = Frd::from(turn).scale_by(vehicle.inertia.map(T::from));
    let (acceleration, turn) =
        rigid_body.accelerations(&state, Frd::new(zero, zero, -thrust), moment);
    let [an, ae, ad] = acceleration.to_array();
    let [droll, dpitch, dyaw] = attitude.rates(state.body_rate);
    let [dp, dq, dr] = turn.to_array();
    [vn, ve, vd, an, ae, ad, droll, dpitch, dyaw, dp, dq, dr]
}

#[cfg(test)]
mod tests {
    use super::*;

    const NANO: HoverVehicle =
        HoverVehicle { mass_kg: 0.03, inertia: [1.43e-5, 1.5e-5, 2.89e-5], gravity: 9.81 };
    const PD: AttitudeLoop =
        AttitudeLoop::Pd { kp: [5e-3, 5.2e-3, 2.4e-3], kd: [5e-4, 5.2e-4, 5.1e-4] };

    #[test]
    fn hover_is_an_equilibrium_with_the_textbook_jacobian() {
        let mut hover = [0.0; INPUTS];
        hover[0] = NANO.hover_thrust_n();
        let rest = state_derivative(&NANO, &PD, [0.0; STATES], hover);
        assert!(rest.iter().all(|slope| slope.abs() < 1e-12));
        let model = HoverModel::continuous(&NANO, &PD);
        let mut a = SMatrix::<f64, STATES, STATES>::zeros();
        let mut b = SMatrix::<f64, STATES, INPUTS>::zeros();
        for i in 0..3 {
            a[(i, 3 + i)] = 1.0;
            a[(6 + i, 9 + i)] = 1.0;
        }
        a[(3, 7)] = -9.81; // nose up pushes south
        a[(4, 6)] = 9.81; // right side down pushes east
        b[(5, 0)] = -1.0 / 0.03;
        for (i, inertia) in NANO.inertia.into_iter().enumerate() {
            let AttitudeLoop::Pd { kp, kd } = PD else { unreachable!() };
            a[(9 + i, 6 + i)] = -kp[i] / inertia;
            a[(9 + i, 9 + i)] = -kd[i] / inertia;
            b[(9 + i, 1 + i)] = kp[i] / inertia;
            b[(9 + i, 4 + i)] = kd[i] / inertia;
        }
        assert!((model.state - a).norm() < 1e-9 * a.norm());
        assert!((model.input - b).norm() < 1e-9 * b.norm());
    }

    #[test]
    fn discretisation_matches_fine_integration_of_continuous_model() {
        for attitude_loop in [PD, AttitudeLoop::PX4] {
            let model = HoverModel::continuous(&NANO, &attitude_loop);
            let exact = model.discretised(0.01);
            // Fourth-order Runge-Kutta on the matrix equation, 1000 steps: an error near 1e-13.
            let (mut a, mut b) = (SMatrix::identity(), SMatrix::zeros());
            let h = 1e-5;
            for _ in 0..1000 {
                let slope = |x: SMatrix<f64, STATES, STATES>| model.state * x;
                let (k1, k2) = (slope(a), slope(a + slope(a) * (h / 2.0)));
                let k3 = slope(a + k2 * (h / 2.0));
                let k4 = slope(a + k3 * h);
                // Simpson's rule on B_d = integral of exp(A t) B.
                let middle: SMatrix<f64, STATES, STATES> = a + (k1 + k2) * (h / 4.0);
                let next = a + (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
                b += (a + middle * 4.0 + next) * model.input * (h / 6.0);
                a = next;
            }
            assert!((exact.state - a).norm() < 1e-9, "{}", (exact.state - a).norm());
            assert!((exact.input - b).norm() < 1e-6 * b.norm(), "{}", (exact.input - b).norm());
        }
    }

    #[test]
    fn loop_that_ignores_rates_has_zero_rate_inputs() {
        let model = HoverModel::continuous(&NANO, &AttitudeLoop::PX4);
        assert_eq!(model.input.fixed_view::<STATES, 3>(0, 4).norm(), 0.0);
    }
}
