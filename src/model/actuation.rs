//! From logged commands to the input that acts: transport delay, lag of the rotors, voltage.

use serde::{Deserialize, Serialize};
use sitl::rotor::{Allocation, Lag};
use sitl::vehicle::ROTORS;

/// How the rotors answer their commands.
///
/// `tau ds_i/dt = u_i(t - delay) - s_i`, and rotor i gives `thrust_max_i s_i (V / full_V)^exponent`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuation {
    /// From the logged command (setpoint where the on-board law is known, else motor output) to
    /// its effect as the log's sensors see it, without the lag, s.
    pub delay_s: f64,
    /// tau: first-order lag of the rotors, s.
    pub lag_s: f64,
    /// Power of the voltage ratio in the thrust; 0 where it does not act or is not logged.
    pub voltage_exponent: f64,
}

/// The rotors of one vehicle, followed over time.
#[derive(Clone, Debug)]
pub struct Rotors<'a> {
    allocation: &'a Allocation,
    lag_s: f64,
    states: Option<[f64; ROTORS]>,
}

impl<'a> Rotors<'a> {
    /// Rotors that follow their first command at once, for what came before is not known.
    pub fn new(allocation: &'a Allocation, lag_s: f64) -> Self {
        Self { allocation, lag_s, states: None }
    }

    /// Holds `outputs` through `step` seconds; returns the states at the end.
    pub fn advance(&mut self, outputs: &[f64; ROTORS], step: f64) -> [f64; ROTORS] {
        let states = self.states.get_or_insert(*outputs);
        let [_, end] = Lag::new(self.lag_s, step).advance(states, outputs);
        *states = end;
        end
    }

    /// Collective [N] and moments [N m] of `states` times `voltage_factor`, in the nominal
    /// vehicle's numbers: the input u of a [`super::Point`].
    pub fn input(&self, states: &[f64; ROTORS], voltage_factor: f64) -> [f64; 4] {
        self.allocation.wrench(*states).map(|component| component * voltage_factor)
    }
}
