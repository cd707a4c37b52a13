//! What must hold of every flight, whatever went wrong.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What must hold.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// A setpoint is within the limits.
    Limits,
    /// A setpoint changes no quicker than its limits say.
    Changes,
    /// A setpoint answers a state that just came, and that is not late.
    Fresh,
    /// After a stall the first setpoint answers a state that came after it.
    Stalled,
    /// No setpoint rests on a mode that the vehicle reported long ago, or before a silence.
    OldMode,
    /// No setpoint after the vehicle told that it left the mode in which it obeys.
    AgainstThePilot,
    /// No setpoint after the time to hand over to landing.
    AfterLanding,
    /// No setpoint after the motors stopped.
    AfterDisarming,
    /// No mode and no arming is asked for after others lead.
    Commands,
    /// The vehicle stays near its trajectory, upright and slow, while the daemon flies it.
    Envelope,
    /// A vehicle that cannot be flown any more is let go.
    LetGo,
    /// The flight ends.
    Ends,
    /// It ends landed, holding, in the pilot's or in the failsafe's hands.
    GoodEnd,
}

/// A rule that did not hold.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Violation {
    /// Which.
    pub rule: Rule,
    /// Simulated time, s.
    pub at_s: f64,
    /// What was seen.
    pub what: String,
}
