//! Names for the parts whose health SYS_STATUS reports.

/// MAV_SYS_STATUS_SENSOR bits of the parts that a flight by setpoints depends on, and their names.
const PARTS: [(u32, &str); 9] = [
    (0x01, "gyroscope"),
    (0x02, "accelerometer"),
    (0x04, "magnetometer"),
    (0x08, "barometer"),
    (0x20, "GPS"),
    (0x80, "vision position"),
    (0x0020_0000, "attitude estimate"),
    (0x0200_0000, "battery"),
    (0x0800_0000, "propulsion"),
];

/// The bits that have a name here.
pub(super) fn watched(bits: u32) -> u32 {
    bits & PARTS.iter().fold(0, |all, (bit, _)| all | bit)
}

/// The names of the parts in `bits`, separated by commas.
pub(super) fn names(bits: u32) -> String {
    let named = PARTS.iter().filter(|(bit, _)| bits & bit != 0);
    named.map(|(_, name)| *name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_sensors_are_named_and_others_ignored() {
        assert_eq!(names(watched(0x21 | 0x1000_0000)), "gyroscope, GPS");
    }
}
