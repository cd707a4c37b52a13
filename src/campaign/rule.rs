//! The rules that every flight must keep, whatever went wrong.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A rule for every flight.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// A setpoint is within the limits.
    Limits,
    /// A setpoint changes no faster than its limits allow.
    Changes,
    /// A setpoint answers a state that just arrived and is not late.
    Fresh,
    /// After a stall the first setpoint answers a state that arrived after it.
    Stalled,
    /// No setpoint relies on a mode that was reported long ago, or before a silence.
    OldMode,
    /// No setpoint leaves after the vehicle reported that it left the mode that obeys.
    AgainstThePilot,
    /// No setpoint leaves after the time for the hand-over to landing.
    AfterLanding,
    /// No setpoint leaves after the motors stopped.
    AfterDisarming,
    /// Neither a mode nor arming is requested after someone else took control.
    Commands,
    /// The vehicle stays near its trajectory, upright and slow, while the controller flies it.
    Envelope,
    /// The controller lets go of a vehicle that can no longer be flown.
    LetGo,
    /// The flight ends.
    Ends,
    /// It ends landed, holding, or under the control of the pilot or a failsafe.
    GoodEnd,
}

/// A broken rule.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Violation {
    /// The rule.
    pub rule: Rule,
    /// Simulated time, s.
    pub at_s: f64,
    /// What the judge observed.
    pub what: String,
}
