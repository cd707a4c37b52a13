//! Open-loop prediction: a model's states from one instant on, under the recorded inputs.

use vehicle::ROTORS;
use vehicle::frame::{Attitude, Frd};
use vehicle::rigid_body::{Stage, State, rk4};

use super::alignment::interpolated;
use super::commands::{CommandSource, EVERYTHING, Onboard, fresh_setpoint, lerp};
use super::dataset::ObservedFlight;
use super::gaps::is_bridged;
use crate::log::import::{Flight, Stream};
use crate::model::actuation::{Actuation, RotorState, RotorStep};
use crate::model::{Model, Point};

/// Longest step of the integration, s.
const STEP_MAX_S: f64 = 0.005;
/// Largest age of a rotor state, in steps of the on-board loop.
const STATE_AGE_STEPS: f64 = 2.5;

/// The recorded inputs of a flight.
///
/// If the on-board law is known, the setpoints are the input and the law closes the loop on the
/// predicted state; otherwise the motor outputs or rotor speeds are the input. The rotors' states
/// at the start follow from the recorded past.
pub struct RecordedInputs<'a> {
    flight: &'a Flight,
    onboard: &'a Onboard,
    actuation: &'a Actuation,
    source: CommandSource,
    rotor_states: Stream<[f64; 2 * ROTORS]>,
    delay_s: f64,
    lag_s: f64,
    step: f64,
}

impl<'a> RecordedInputs<'a> {
    /// The inputs of a flight whose rotors respond according to `actuation`.
    pub fn new(
        observed: &'a ObservedFlight,
        onboard: &'a Onboard,
        actuation: &'a Actuation,
    ) -> Self {
        let source = observed.source;
        let steps = (1.0 / onboard.rate_hz / STEP_MAX_S).ceil();
        Self {
            flight: &observed.flight,
            onboard,
            actuation,
            source,
            rotor_states: observed.rotor_states(onboard, actuation, &EVERYTHING),
            delay_s: observed.delay_s(actuation),
            lag_s: source.lag_s(actuation),
            step: (1.0 / onboard.rate_hz / steps).max(0.004),
        }
    }

    /// The reported state at `time`, interpolated in each stream between close samples.
    pub fn reported(&self, time: f64) -> Option<State> {
        let flight = self.flight;
        let is_known = is_bridged(&flight.position, time)
            && is_bridged(&flight.velocity, time)
            && is_bridged(&flight.attitude, time)
            && is_bridged(&flight.body_rate, time);
        is_known.then_some(())?;
        Some(State {
            position: lerp(&flight.position, time)?.into(),
            velocity: lerp(&flight.velocity, time)?.into(),
            attitude: interpolated(&flight.attitude, time)?,
            body_rate: lerp(&flight.body_rate, time)?.into(),
        })
    }

    /// The rotors' state at `time`, if its past is recorded.
    fn rotors(&self, time: f64) -> Option<RotorState> {
        let index = self.rotor_states.index_at(time)?;
        let age = time - self.rotor_states.times().get(index)?;
        let states = self.rotor_states.values().get(index)?;
        (age <= STATE_AGE_STEPS / self.onboard.rate_hz).then(|| RotorState::from(*states))
    }

    /// The outputs in force during the step from `time`, at a predicted state.
    fn outputs(&self, time: f64, state: &State) -> Option<[f64; ROTORS]> {
        let sent = time - self.delay_s;
        match self.source {
            CommandSource::OnboardLaw => {
                let setpoint = fresh_setpoint(self.flight, sent)?;
                self.onboard.law_outputs(setpoint, state.attitude, state.body_rate)
            }
            // Commands change within the step; its middle represents it.
            CommandSource::MotorOutputs => {
                let middle = sent + 0.5 * self.step;
                is_bridged(&self.flight.outputs, middle).then_some(())?;
                lerp(&self.flight.outputs, middle)
            }
            CommandSource::RotorSpeeds => Some(self.rotors(time + 0.5 * self.step)?.now),
        }
    }

    /// The states that `model` predicts at `start` plus each of `horizons` [s, ascending], from
    /// `state` at `start`: fewer if the inputs are not recorded that far, `None` if they are
    /// missing at the start.
    pub fn predict(
        &self,
        model: &dyn Model,
        start: f64,
        state: State,
        horizons: &[f64],
    ) -> Option<Vec<State>> {
        let mut rotors = match self.rotors(start) {
            Some(rotors) => rotors,
            None => {
                let balanced = self.actuation.balance_s.is_some();
                RotorState::settled(self.outputs(start, &state)?, balanced)
            }
        };
        let answer = |step: f64| (step, RotorStep::new(self.actuation, self.lag_s, step));
        let mut rotor_step = answer(self.step);
        let (mut state, mut passed) = (state, 0.0);
        let mut predicted = Vec::with_capacity(horizons.len());
        for horizon in horizons {
            while *horizon - passed > 1e-9 {
                let step = self.step.min(horizon - passed);
                if step != rotor_step.0 {
                    rotor_step = answer(step);
                }
                let time = start + passed;
                let Some(outputs) = self.outputs(time, &state) else { return Some(predicted) };
                let [middle, end] = rotor_step.1.advance(&rotors, &outputs);
                let voltage = self.flight.voltage.held_at(time).copied();
                let factor = self.onboard.voltage_factor(self.actuation, voltage);
                let allocation = &self.onboard.allocation;
                let inputs = [rotors, middle, end].map(|state| state.input(allocation, factor));
                state = rk4(&state, step, |state: &State, stage: Stage| {
                    let input = match stage {
                        Stage::Start => inputs[0],
                        Stage::Middle => inputs[1],
                        Stage::End => inputs[2],
                    };
                    let point = Point {
                        velocity: state.velocity,
                        body_rate: state.body_rate,
                        attitude: state.attitude.euler(),
                        input,
                    };
                    let [n, e, d, p, q, r] = model.accelerations(&point);
                    ([n, e, d].into(), Frd::new(p, q, r))
                });
                rotors = end;
                passed += step;
            }
            predicted.push(state);
        }
        Some(predicted)
    }
}

/// Predictions without a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// The state stays constant.
    Hold,
    /// Velocity and body rate stay constant.
    ConstantVelocity,
}

impl Baseline {
    /// The state after `seconds`.
    pub fn predict(self, state: &State, seconds: f64) -> State {
        match self {
            Baseline::Hold => *state,
            Baseline::ConstantVelocity => State {
                position: state.position + state.velocity * seconds,
                attitude: state.attitude.compose(turn(state.body_rate * seconds)).normalized(),
                ..*state
            },
        }
    }
}

/// The rotation of a rotation vector, rad.
fn turn(by: Frd) -> Attitude {
    let angle = by.norm();
    let scale = if angle > 1e-12 { (0.5 * angle).sin() / angle } else { 0.5 };
    let [x, y, z] = (by * scale).to_array();
    Attitude { w: (0.5 * angle).cos(), x, y, z }
}
