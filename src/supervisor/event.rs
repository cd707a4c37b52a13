//! What the supervisor hands out: requests to the vehicle, and what happened, in words.

use serde::Serialize;

use super::FlightState;
use crate::clock::HostTime;

/// A request to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Mode in which setpoints are obeyed.
    SetModeOffboard,
    /// Mode in which setpoints are not obeyed, so that the vehicle is released.
    SetModeHold,
    /// Mode in which the vehicle lands itself.
    SetModeLand,
    /// Start the motors.
    Arm,
    /// Stop the motors, on the ground.
    Disarm,
}

impl Action {
    /// For people.
    pub(super) fn in_words(self) -> &'static str {
        match self {
            Self::SetModeOffboard => "OFFBOARD",
            Self::SetModeHold => "the mode that holds",
            Self::SetModeLand => "to land",
            Self::Arm => "to arm",
            Self::Disarm => "to disarm",
        }
    }
}

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// As planned.
    Info,
    /// Not as planned, flight goes on.
    Warning,
    /// Flight ends or does not begin.
    Error,
}

/// Something that happened, in words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// When.
    #[serde(skip)]
    pub host: HostTime,
    /// How much it matters.
    pub severity: Severity,
    /// State after it.
    pub state: FlightState,
    /// What happened.
    pub text: String,
}
