//! The supervisor's output: requests to the vehicle, and events for people.

use serde::Serialize;

use super::FlightState;
use crate::clock::HostTime;

/// A request to the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Select the mode that obeys setpoints.
    SetModeOffboard,
    /// Select a mode that ignores setpoints, which releases the vehicle.
    SetModeHold,
    /// Select the mode in which the vehicle lands itself.
    SetModeLand,
    /// Start the motors.
    Arm,
    /// Stop the motors, on the ground.
    Disarm,
}

impl Action {
    /// The request as messages name it.
    pub(super) fn text(self) -> &'static str {
        match self {
            Self::SetModeOffboard => "OFFBOARD",
            Self::SetModeHold => "the hold mode",
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
    /// Not as planned; the flight goes on.
    Warning,
    /// The flight ends or does not begin.
    Error,
}

/// Something that happened, described for people.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// The time at which the supervisor raised it.
    #[serde(skip)]
    pub host: HostTime,
    /// How much it matters.
    pub severity: Severity,
    /// State of the flight after the event.
    pub state: FlightState,
    /// What happened and why.
    pub text: String,
}
