//! The vehicle's physics with rotor thrusts as inputs, over periods of any length.

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::physics::{Environment, Physics};
use vehicle::rigid_body::{State, rk4};
use vehicle::scalar::{Dual, Scalar};

use super::knots::{Period, difference};
use crate::plan::discretisation::LinearStep;
use crate::plan::state_vector::{STATES, VELOCITY};

/// Inputs of a period: the rotors' thrusts, and its length.
pub(super) const INPUTS: usize = 5;
/// Index of the length among them.
pub(super) const LENGTH: usize = 4;
/// Velocity, attitude, body rate and rotors: the variables that a period's end depends on, besides
/// the position, to which it is relative.
const VARIABLES: usize = 13;
/// Height at which the physics is evaluated, m: out of ground effect.
const HEIGHT: f64 = 1e3;

type Number = Dual<VARIABLES>;

/// Runge-Kutta steps through the vehicle file's physics, in calm air; the rotors' thrusts are held
/// over a period, without their lag.
#[derive(Clone, Debug)]
pub struct RotorDynamics {
    physics: Physics,
    environment: Environment,
    step_max_s: f64,
}

impl RotorDynamics {
    /// Uses steps of at most `step_max_s`.
    pub fn new(physics: Physics, step_max_s: f64) -> Self {
        let environment = physics.calm();
        Self { physics, environment, step_max_s }
    }

    /// The vehicle's physics.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// The same dynamics with another step length.
    pub(super) fn in_steps_of(&self, step_max_s: f64) -> Self {
        Self { step_max_s, ..self.clone() }
    }

    /// The state at the end of a period.
    pub fn end(&self, state: &State, period: &Period) -> State {
        let end = self.advance(State { position: origin(), ..*state }, period, &period.rotors);
        State { position: state.position + (end.position - origin()), ..end }
    }

    fn advance<T: Scalar>(
        &self,
        mut state: State<T>,
        period: &Period,
        rotors: &[T; 4],
    ) -> State<T> {
        let steps = (period.length_s / self.step_max_s).ceil().max(1.0);
        for _ in 0..steps as usize {
            state = rk4(&state, period.length_s / steps, |s: &State<T>, _| {
                self.physics.accelerations(s, rotors, &self.environment)
            });
        }
        state
    }

    /// Linearises a period around a state and relative to another, `towards`: `next` is the
    /// deviation of its end from that, as a function of the deviations of its start and of its
    /// inputs.
    pub(super) fn linearize(
        &self,
        state: &State,
        period: &Period,
        towards: &State,
    ) -> LinearStep<INPUTS> {
        let rotors = std::array::from_fn(|i| Number::variable(period.rotors[i], 9 + i));
        let end = self.advance(variable(state), period, &rotors);
        let value =
            State { position: state.position + (values(end.position) - origin()), ..value(&end) };
        let mut step = LinearStep {
            next: difference(towards, &value),
            state: [[0.0; STATES]; STATES],
            input: [[0.0; INPUTS]; STATES],
        };
        // Twice the vector part of the rotation from the end: its small angles.
        let turned = value.attitude.inverse().lift::<Number>().compose(end.attitude);
        let parts = [
            end.position.to_array(),
            end.velocity.to_array(),
            [turned.x * 2.0, turned.y * 2.0, turned.z * 2.0],
            end.body_rate.to_array(),
        ];
        let flow = self.flow(&value, &period.rotors);
        for (i, number) in parts.iter().flatten().enumerate() {
            let (by_state, by_rotor) = number.gradient().split_at(9);
            step.state[i][VELOCITY..].copy_from_slice(by_state);
            step.input[i][..LENGTH].copy_from_slice(by_rotor);
            // A longer period continues at the rates of its end.
            step.input[i][LENGTH] = flow[i];
        }
        for i in 0..VELOCITY {
            step.state[i][i] = 1.0;
        }
        step
    }

    /// Time derivative of a state.
    fn flow(&self, state: &State, rotors: &[f64; 4]) -> [f64; STATES] {
        let at = State { position: origin(), ..*state };
        let (linear, angular) = self.physics.accelerations(&at, rotors, &self.environment);
        let parts = [
            state.velocity.to_array(),
            linear.to_array(),
            state.body_rate.to_array(),
            angular.to_array(),
        ];
        let mut flow = [0.0; STATES];
        for (entry, part) in flow.iter_mut().zip(parts.iter().flatten()) {
            *entry = *part;
        }
        flow
    }
}

fn origin() -> Ned {
    Ned::new(0.0, 0.0, -HEIGHT)
}

/// The state at the origin, with velocity, rotation in body axes and body rate as variables.
fn variable(state: &State) -> State<Number> {
    let [vn, ve, vd] = state.velocity.to_array();
    let [p, q, r] = state.body_rate.to_array();
    let half = |index| Number::variable(0.0, index) * 0.5;
    let turn = Attitude { w: Number::from(1.0), x: half(3), y: half(4), z: half(5) };
    State {
        position: origin().map(Number::from),
        velocity: Ned::new(
            Number::variable(vn, 0),
            Number::variable(ve, 1),
            Number::variable(vd, 2),
        ),
        attitude: state.attitude.lift::<Number>().compose(turn),
        body_rate: Frd::new(Number::variable(p, 6), Number::variable(q, 7), Number::variable(r, 8)),
    }
}

fn values(vector: Ned<Number>) -> Ned {
    vector.map(Scalar::value)
}

fn value(state: &State<Number>) -> State {
    let Attitude { w, x, y, z } = state.attitude;
    State {
        position: values(state.position),
        velocity: values(state.velocity),
        attitude: Attitude { w: w.value(), x: x.value(), y: y.value(), z: z.value() },
        body_rate: state.body_rate.map(Scalar::value),
    }
}
