//! A received message with the times of both clocks.

use message::Inbound;

use super::vehicle_clock::Delay;
use crate::clock::{HostTime, VehicleTime};

/// A message from the vehicle, and its times.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Host time of arrival.
    pub host: HostTime,
    /// Vehicle time of the sample, where the message has one.
    pub vehicle: Option<VehicleTime>,
    /// Its delay, where it has a stamp and the link knows the vehicle's clock.
    pub delay: Option<Delay>,
    /// The content.
    pub message: Inbound,
}
