//! The settings of a session.

use std::time::Duration;

use crate::link::attitude_target::ThrustMap;
use crate::link::profile::{FormChoice, MessageRate};
use crate::link::signing::SigningSettings;

/// Settings of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Own system id.
    pub system: u8,
    /// Own component id.
    pub component: u8,
    /// The vehicle's system id; `None` takes the first autopilot that appears.
    pub vehicle_system: Option<u8>,
    /// Whether the vehicle file has `attitude_pd`.
    pub vehicle_has_attitude_pd: bool,
    /// The form of setpoints.
    pub form: FormChoice,
    /// Maps newtons to the thrust field.
    pub thrust: ThrustMap,
    /// Messages to request, whatever they cost; `None` requests the profile's, as far as the line
    /// has room.
    pub telemetry: Option<Vec<MessageRate>>,
    /// Whether to answer the vehicle's TIMESYNC requests. Two stations that answer confuse it.
    pub answer_timesync: bool,
    /// Whether these answers carry the vehicle's own clock as estimated here. The vehicle then
    /// accepts stamps of its own clock unchanged.
    pub answers_in_vehicle_time: bool,
    /// Silence after which the link is stale.
    pub stale_after: Duration,
    /// Silence after which the vehicle is lost.
    pub lost_after: Duration,
    /// The link's name in messages, such as its URL.
    pub endpoint: Option<String>,
    /// Bits per second of a serial line, to which the profile's messages are fitted.
    pub baud: Option<u32>,
    /// Signing; `None` signs nothing and accepts all frames.
    pub signing: Option<SigningSettings>,
}

impl Settings {
    /// The usual settings: an onboard computer (component 191) of system 254.
    pub fn new(thrust: ThrustMap) -> Self {
        Self {
            system: 254,
            component: 191,
            vehicle_system: None,
            vehicle_has_attitude_pd: false,
            form: FormChoice::Profile,
            thrust,
            telemetry: None,
            answer_timesync: true,
            answers_in_vehicle_time: false,
            stale_after: Duration::from_millis(2500),
            lost_after: Duration::from_secs(5),
            endpoint: None,
            baud: None,
            signing: None,
        }
    }
}
