//! From logged commands to the input that acts: transport delay, lag of the rotors, voltage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::ROTORS;
use vehicle::rotor::{Allocation, Lag};

/// How the rotors answer their commands.
///
/// `tau ds_i/dt = u_i(t - delay) - s_i`, and rotor i gives `thrust_max_i s_i (V /
/// full_V)^exponent`.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuation {
    /// From the logged command (setpoint where the on-board law is known, else motor output) to
    /// its effect as the log's sensors see it, without the lag, s.
    pub delay_s: f64,
    /// tau: first-order lag of the rotors, s.
    pub lag_s: f64,
    /// Power of the voltage ratio in the thrust; 0 where it does not act or is not logged.
    pub voltage_exponent: f64,
    /// Moments that last longer than this are balanced by something that is not modelled (an
    /// uneven mass, a bent arm, air at the frame), for the vehicle does not spin up: what acts is
    /// their difference to their own first-order average over this time, s. Missing where the
    /// logs do not ask for it: the moments act in full.
    pub balance_s: Option<f64>,
}

/// The rotors' states, and their average over the time of balance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorState {
    /// s_i.
    pub now: [f64; ROTORS],
    /// Their average; 0 where nothing is balanced.
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
    /// Rotors that have long had these outputs.
    pub fn settled(outputs: [f64; ROTORS], balanced: bool) -> Self {
        Self { now: outputs, average: if balanced { outputs } else { [0.0; ROTORS] } }
    }

    /// Collective (N) and moments [N m] times `voltage_factor`, in the nominal vehicle's numbers:
    /// the input u of a [`super::Point`].
    pub fn input(&self, allocation: &Allocation, voltage_factor: f64) -> [f64; 4] {
        let [u1, u2, u3, u4] = allocation.wrench(self.now);
        let [_, b2, b3, b4] = allocation.wrench(self.average);
        [u1, u2 - b2, u3 - b3, u4 - b4].map(|component| component * voltage_factor)
    }
}

/// The rotors' answer over steps of one length.
#[derive(Clone, Copy, Debug)]
pub struct RotorStep {
    lag: Lag,
    balance: Option<Lag>,
}

impl RotorStep {
    /// Steps of `step` seconds. `lag_s` overrides the actuation's where states are measured.
    pub fn new(actuation: &Actuation, lag_s: f64, step: f64) -> Self {
        let balance = actuation.balance_s.map(|time| Lag::new(time, step));
        Self { lag: Lag::new(lag_s, step), balance }
    }

    /// The states half way and at the end of a step through which `outputs` are held.
    pub fn advance(&self, state: &RotorState, outputs: &[f64; ROTORS]) -> [RotorState; 2] {
        let now = self.lag.advance(&state.now, outputs);
        let average = match &self.balance {
            // The average follows the states; over one step they hardly move.
            Some(balance) => balance.advance(&state.average, &now[0]),
            None => [state.average; 2],
        };
        [0, 1].map(|i| RotorState { now: now[i], average: average[i] })
    }
}
