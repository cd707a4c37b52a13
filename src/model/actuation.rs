//! From logged commands to the acting input: transport delay, rotor lag, voltage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::ROTORS;
use vehicle::rotor::{Allocation, Lag};

/// The rotors' response to their commands.
///
/// `tau ds_i/dt = u_i(t - delay) - s_i`, and rotor i produces
/// `thrust_max_i s_i (V / full_V)^exponent`.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuation {
    /// Delay from the logged command (setpoint if the on-board law is known, else motor output) to
    /// its effect in the log's sensors, without the lag, s.
    pub delay_s: f64,
    /// tau: first-order lag of the rotors, s.
    pub lag_s: f64,
    /// Exponent of the voltage ratio in the thrust; 0 if voltage has no effect or is not logged.
    pub voltage_exponent: f64,
    /// Moments that last longer than this are balanced by something unmodelled (an uneven mass, a
    /// bent arm, air on the frame), because the vehicle does not spin up: the acting moment is the
    /// difference to its own first-order average over this time, s. `None` if the logs do not
    /// support it: the moments then act in full.
    pub balance_s: Option<f64>,
}

/// The rotors' states, and their average over the balance time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorState {
    /// s_i.
    pub now: [f64; ROTORS],
    /// Averages of s_i; 0 without balance.
    pub average: [f64; ROTORS],
}

impl From<RotorState> for [f64; 2 * ROTORS] {
    fn from(RotorState { now, average }: RotorState) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (now, average);
        [a, b, c, d, e, f, g, h]
    }
}

impl From<[f64; 2 * ROTORS]> for RotorState {
    fn from([a, b, c, d, e, f, g, h]: [f64; 2 * ROTORS]) -> Self {
        Self { now: [a, b, c, d], average: [e, f, g, h] }
    }
}

impl RotorState {
    /// Rotors that have held these outputs for a long time.
    pub fn settled(outputs: [f64; ROTORS], balanced: bool) -> Self {
        Self { now: outputs, average: if balanced { outputs } else { [0.0; ROTORS] } }
    }

    /// Collective (N) and moments (N m) times `voltage_factor`, with the nominal vehicle's
    /// parameters: the input u of a [`super::Point`].
    pub fn input(&self, allocation: &Allocation, voltage_factor: f64) -> [f64; 4] {
        let [u1, u2, u3, u4] = allocation.wrench(self.now);
        let [_, b2, b3, b4] = allocation.wrench(self.average);
        [u1, u2 - b2, u3 - b3, u4 - b4].map(|component| component * voltage_factor)
    }
}

/// The rotors' response over steps of one length.
#[derive(Clone, Copy, Debug)]
pub struct RotorStep {
    lag: Lag,
    balance: Option<Lag>,
}

impl RotorStep {
    /// Steps of `step` seconds. `lag_s` replaces the actuation's lag, for sources that measure the
    /// states.
    pub fn new(actuation: &Actuation, lag_s: f64, step: f64) -> Self {
        let balance = actuation.balance_s.map(|time| Lag::new(time, step));
        Self { lag: Lag::new(lag_s, step), balance }
    }

    /// The states half way through and at the end of a step during which `outputs` are held.
    pub fn advance(&self, state: &RotorState, outputs: &[f64; ROTORS]) -> [RotorState; 2] {
        let now = self.lag.advance(&state.now, outputs);
        let average = match &self.balance {
            // The average follows the states, which hardly change over one step.
            Some(balance) => balance.advance(&state.average, &now[0]),
            None => [state.average; 2],
        };
        [0, 1].map(|i| RotorState { now: now[i], average: average[i] })
    }
}
