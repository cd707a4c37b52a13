//! Which vehicle a session is with.

use std::fmt;

use wire::transport::Peer;

use crate::link::profile::{ARDUPILOT, PX4};

/// The identity of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VehicleId {
    /// System id.
    pub system: u8,
    /// Component id of its autopilot.
    pub component: u8,
    /// MAV_AUTOPILOT.
    pub autopilot: u8,
    /// MAV_TYPE.
    pub vehicle_type: u8,
    /// The peer from which it was received.
    pub peer: Peer,
}

impl VehicleId {
    /// Whether its autopilot is one that can be flown. An unknown autopilot replaces a known one
    /// only under the same ids, once that one is lost.
    pub fn is_known(&self) -> bool {
        matches!(self.autopilot, ARDUPILOT | PX4)
    }

    /// Whether `other`, which has the same system and component, is a different vehicle.
    pub(super) fn is_another(&self, other: &Self) -> bool {
        (self.autopilot, self.vehicle_type) != (other.autopilot, other.vehicle_type)
    }
}

impl fmt::Display for VehicleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let autopilot = match self.autopilot {
            ARDUPILOT => "ArduPilot",
            PX4 => "PX4",
            _ => "unknown",
        };
        // MAV_TYPE.
        let vehicle_type = match self.vehicle_type {
            2 => "quadrotor",
            13 => "hexarotor",
            14 => "octorotor",
            _ => "other",
        };
        write!(
            f,
            "system {} component {}: autopilot {autopilot} ({}), type {vehicle_type} ({})",
            self.system, self.component, self.autopilot, self.vehicle_type
        )
    }
}
