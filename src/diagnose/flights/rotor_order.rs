//! Checks that the logs' outputs drive the rotors at the vehicle file's places. Another order would
//! look like a different inertia, a different centre of mass and a lost rotor.

use vehicle::VehicleParams;

use crate::audit::{Audit, check_order};
use crate::log::import::RotorFact;

/// Adds a fault to the audits of a vehicle's logs if their outputs do not turn the vehicle as its
/// file's rotors would.
pub fn check(audits: &mut [Audit], vehicle: &VehicleParams) {
    let rotors = vehicle.rotors.each_ref().map(|rotor| {
        let [front, right, _] = rotor.position_m;
        RotorFact { front, right, spin: rotor.spin }
    });
    let mut audits: Vec<&mut Audit> = audits.iter_mut().collect();
    check_order(&mut audits, &rotors, "the vehicle file's rotors");
}
