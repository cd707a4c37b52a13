//! Checks that a log's outputs drive the rotors at the vehicle file's places. Another order would
//! look like a different inertia, a different centre of mass and a lost rotor.

use vehicle::VehicleParams;

use crate::audit::Audit;
use crate::log::import::RotorFact;

/// Adds a fault to the audit of a log whose outputs do not turn the vehicle as its file's rotors
/// would.
pub fn check(audit: &mut Audit, vehicle: &VehicleParams) {
    let rotors = vehicle.rotors.each_ref().map(|rotor| {
        let [front, right, _] = rotor.position_m;
        RotorFact { front, right, spin: rotor.spin }
    });
    audit.check_order(&rotors, "the vehicle file's rotors");
}
