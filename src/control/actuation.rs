//! Delay and lag between a setpoint and the vehicle's acceleration, apart from the attitude loop:
//! the transport delay and the rotors' lag, as far as they are known.

use nalgebra::SMatrix;

use super::attitude_loop::AttitudeLoop;
use super::hover_model::{HoverModel, INPUTS, STATES};

/// The latency of a setpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Actuation {
    /// Mean time from sending a setpoint to its use on board, s.
    pub command_delay_s: f64,
    /// First-order lag of the rotors, s.
    pub motor_time_constant_s: f64,
}

impl Actuation {
    /// No delay and no lag: the paper's model.
    pub const IMMEDIATE: Self = Self { command_delay_s: 0.0, motor_time_constant_s: 0.0 };

    /// Delay from sending a thrust to its effect, with the rotors' lag counted as a delay, s.
    pub fn thrust_delay_s(&self) -> f64 {
        self.command_delay_s + self.motor_time_constant_s
    }

    /// The same for an attitude, without `attitude_loop`'s own response.
    pub fn attitude_delay_s(&self, attitude_loop: &AttitudeLoop) -> f64 {
        let is_before = attitude_loop.is_before_the_rotors();
        if is_before { self.thrust_delay_s() } else { self.command_delay_s }
    }
}

/// Thrust and the three angular accelerations, as the rotors produce them.
const LAGGING: usize = 4;
/// Size of the state with the delayed inputs and the rotors' outputs.
pub(super) const DELAYED_STATES: usize = STATES + INPUTS + LAGGING;
const VARIABLES: usize = DELAYED_STATES + INPUTS;
/// Index of the first delayed input, and of the rotors' thrust.
const DELAYED: usize = STATES;
const THRUST: usize = STATES + INPUTS;
const TURN: usize = THRUST + 1;
/// First row of the body rate.
const BODY_RATE: usize = 9;

/// Shorter times are raised to this, so that one model covers all cases, s. A lag this short has
/// decayed within one control period.
const SHORTEST_S: f64 = 1e-3;

/// A linear model `x+ = A x + B u_hat` over one control period. `x` begins with the 12 measured
/// states of [`HoverModel`]; the rest are not measured.
pub(super) struct DelayedModel {
    pub state: SMatrix<f64, DELAYED_STATES, DELAYED_STATES>,
    pub input: SMatrix<f64, DELAYED_STATES, INPUTS>,
}

impl DelayedModel {
    /// The hover model with `actuation` around the attitude loop. The delay is modelled as a lag of
    /// the same mean: both turn the phase alike where the loop's gain is near 1. The rotors' lag
    /// acts between the loop and its moments, unless the loop was measured with its rotors.
    pub fn new(
        hover: &HoverModel,
        attitude_loop: &AttitudeLoop,
        actuation: &Actuation,
        period_s: f64,
    ) -> Self {
        let delay = 1.0 / actuation.command_delay_s.max(SHORTEST_S);
        let lag = 1.0 / actuation.motor_time_constant_s.max(SHORTEST_S);
        let mut slope = SMatrix::<f64, VARIABLES, VARIABLES>::zeros();
        slope.fixed_view_mut::<STATES, STATES>(0, 0).copy_from(&hover.state);
        slope.fixed_view_mut::<STATES, INPUTS>(0, DELAYED).copy_from(&hover.input);
        for i in 0..INPUTS {
            slope[(DELAYED + i, DELAYED + i)] = -delay;
            slope[(DELAYED + i, DELAYED_STATES + i)] = delay;
        }
        // Thrust acts through its own state.
        for row in 0..STATES {
            slope[(row, THRUST)] = slope[(row, DELAYED)];
            slope[(row, DELAYED)] = 0.0;
        }
        slope[(THRUST, DELAYED)] = lag;
        slope[(THRUST, THRUST)] = -lag;
        for axis in 0..3 {
            let (row, turn) = (BODY_RATE + axis, TURN + axis);
            slope[(turn, turn)] = -lag;
            if attitude_loop.is_before_the_rotors() {
                // At hover only the loop's moments turn the body.
                for column in 0..THRUST {
                    slope[(turn, column)] = lag * slope[(row, column)];
                    slope[(row, column)] = 0.0;
                }
                slope[(row, turn)] = 1.0;
            }
        }
        let exponential = (slope * period_s).exp();
        Self {
            state: exponential.fixed_view::<DELAYED_STATES, DELAYED_STATES>(0, 0).into(),
            input: exponential.fixed_view::<DELAYED_STATES, INPUTS>(0, DELAYED_STATES).into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::HoverVehicle;
    use nalgebra::SVector;

    const NANO: HoverVehicle =
        HoverVehicle { mass_kg: 0.03, inertia: [1.66e-5, 1.66e-5, 2.93e-5], gravity: 9.81 };
    const PD: AttitudeLoop =
        AttitudeLoop::Pd { kp: [4.8e-3, 4.8e-3, 1.9e-3], kd: [5.1e-4, 5.1e-4, 4.2e-4] };

    /// Roll 0.5 s after a setpoint of 0.1 rad, and the largest on the way, rad.
    fn roll_step(attitude_loop: &AttitudeLoop, actuation: &Actuation) -> (f64, f64) {
        let hover = HoverModel::continuous(&NANO, attitude_loop);
        let model = DelayedModel::new(&hover, attitude_loop, actuation, 0.01);
        let mut input = SVector::<f64, INPUTS>::zeros();
        input[1] = 0.1;
        let mut state = SVector::<f64, DELAYED_STATES>::zeros();
        let mut largest: f64 = 0.0;
        for _ in 0..50 {
            state = model.state * state + model.input * input;
            largest = largest.max(state[6]);
        }
        (state[6], largest)
    }

    #[test]
    fn delayed_model_without_lag_matches_the_hover_model() {
        let hover = HoverModel::continuous(&NANO, &PD).discretised(0.01);
        let delayed = DelayedModel::new(
            &HoverModel::continuous(&NANO, &PD),
            &PD,
            &Actuation::IMMEDIATE,
            0.01,
        );
        let mut input = SVector::<f64, INPUTS>::zeros();
        input[1] = 0.1;
        let (mut at_once, mut late) = (SVector::<f64, STATES>::zeros(), SVector::zeros());
        for _ in 0..30 {
            at_once = hover.state * at_once + hover.input * input;
            late = delayed.state * late + delayed.input * input;
            // Two milliseconds late, at up to 0.8 rad/s.
            assert!((at_once[6] - late[6]).abs() < 2e-3, "{} and {}", at_once[6], late[6]);
        }
    }

    #[test]
    fn motor_lag_makes_pd_overshoot_but_not_a_measured_loop() {
        let slow = Actuation { command_delay_s: 0.0, motor_time_constant_s: 0.06 };
        let (end, prompt) = roll_step(&PD, &Actuation::IMMEDIATE);
        assert!((end - 0.1).abs() < 1e-3 && prompt < 0.102, "{end} {prompt}");
        assert!(roll_step(&PD, &slow).1 > 0.112);
        let measured = AttitudeLoop::PX4;
        let (with, without) =
            (roll_step(&measured, &slow), roll_step(&measured, &Actuation::IMMEDIATE));
        assert!((with.0 - without.0).abs() < 1e-12 && (with.1 - without.1).abs() < 1e-12);
    }
}
