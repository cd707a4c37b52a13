//! Several autopilots on one link, among which only the user can choose.

use super::session::{Session, VehicleId};

/// Asks for a choice between two autopilots.
pub fn choice_between(vehicle: VehicleId, other: VehicleId) -> String {
    format!(
        "two autopilots are on this link, {vehicle} and {other}; choose one with --system {} or \
         --system {} (link.vehicle_system in the configuration)",
        vehicle.system, other.system
    )
}

/// Asks for a choice between the session's vehicle and another; `None` where there is nothing to
/// choose, or the user chose.
pub fn choice(session: &Session) -> Option<String> {
    let (vehicle, other) = (session.vehicle()?, session.others().first()?);
    session.requested_system().is_none().then(|| choice_between(vehicle, *other))
}
