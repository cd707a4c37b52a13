//! Log variables of a Crazyflie, as cfclient, cflib and its SD card name them.
//!
//! Source: the firmware's description of the log groups `stateEstimate`, `stabilizer`, `gyro` and
//! `acc` (crazyflie-firmware, `stabilizer.c` and `sensors.c`). Both groups of angles are
//! `state.attitude`, in degrees and in the "legacy CF2 body coordinate system, where pitch is
//! inverted": the estimators store `-pitch` (`kalmanCoreExternalizeState`,
//! `sensfusion6GetEulerRPY`). Roll and yaw, the quaternion and the gyro are right-handed in front,
//! left, up.

use super::Named;

/// Units by group and variables. Names with a unit of their own keep it.
const UNITS: [(&str, &[&str], &str); 7] = [
    ("stateestimate", &["x", "y", "z"], "m"),
    ("stateestimate", &["vx", "vy", "vz"], "m/s"),
    ("stateestimate", &["ax", "ay", "az"], "g"),
    ("stateestimate", &["roll", "pitch", "yaw"], "deg"),
    ("stabilizer", &["roll", "pitch", "yaw"], "deg"),
    ("gyro", &["x", "y", "z"], "deg/s"),
    ("acc", &["x", "y", "z"], "g"),
];
/// Groups that no other program names so.
const OWN: [&str; 2] = ["stateestimate", "stabilizer"];

/// Whether a name is one of these variables of a group.
fn is_of(name: &Named, group: &str, variables: &[&str]) -> bool {
    variables.iter().any(|variable| name.is(&format!("{group}_{variable}")))
}

/// Adds the units of a Crazyflie's variables, if the table is of one.
pub(super) fn add_units(names: &mut [Named]) {
    let is_own = |name: &Named| {
        let mut own = UNITS.iter().filter(|(group, ..)| OWN.contains(group));
        own.any(|(group, variables, _)| is_of(name, group, variables))
    };
    if !names.iter().any(is_own) {
        return;
    }
    for name in names.iter_mut().filter(|name| name.unit.is_none()) {
        let known = UNITS.iter().find(|(group, variables, _)| is_of(name, group, variables));
        name.unit = known.map(|(.., unit)| *unit);
    }
}

/// Whether the variable's sign is opposite to that of a rotation in front, left, up.
pub(super) fn is_opposite(name: &Named) -> bool {
    OWN.iter().any(|group| is_of(name, group, &["pitch"]))
}

/// Whether the variable is an acceleration in the axes of the world.
pub(super) fn is_of_world(name: &Named) -> bool {
    is_of(name, "stateestimate", &["ax", "ay", "az"])
}
