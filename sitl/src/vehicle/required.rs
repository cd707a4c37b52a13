//! The keys that a vehicle file must have.

use serde_json::Value;

/// A key, and what its value is.
type Key = (&'static str, &'static str);

/// At the top level.
const TOP: &[Key] = &[
    ("name", "the vehicle's name"),
    ("mass", "the mass in kg"),
    ("inertia", "the moments of inertia about front, right and down in kg m^2, as [x, y, z]"),
    ("rotors", "four tables [[rotors]], in the order of the motor outputs"),
    ("motor_time_constant_s", "the rotors' lag in s, 0 where none is modelled"),
    ("command_delay_s", "the delay from sending a setpoint to its use on board in s"),
    ("hover_thrust", "the fraction of the rotors' full thrust at hover"),
    ("gravity", "gravity in m/s^2"),
    ("air_density", "the air's density in kg/m^3"),
    ("rotor_radius_m", "the radius of a rotor in m"),
    ("battery", "a table [battery] with cells, full_V and nominal_V"),
];
/// In each of the rotors.
const ROTOR: &[Key] = &[
    ("position_m", "the rotor's place from the centre of mass in m, as [front, right, down]"),
    ("spin", "1 where the rotor's drag turns the body to the right, else -1"),
    ("thrust_max_N", "the thrust at full output in N"),
    ("drag_torque_per_thrust_m", "the drag torque over the thrust in m"),
];
/// In tables that are there once; but for the battery they may be missing as a whole.
const TABLES: [(&str, &[Key]); 3] = [
    (
        "attitude_pd",
        &[
            ("kp", "the gains of roll, pitch and yaw in N m/rad"),
            ("kd", "the gains of the body rates in N m s/rad"),
            ("rate_hz", "the rate of the on-board loop in Hz"),
        ],
    ),
    (
        "battery",
        &[
            ("cells", "the number of cells in series"),
            ("full_V", "the pack's voltage when full"),
            ("nominal_V", "the pack's nominal voltage"),
        ],
    ),
    (
        "motor_output",
        &[
            ("message", "the name of the MAVLink message"),
            ("fields", "four names of its fields, in the order of the rotors"),
            ("zero", "the value that means no output"),
            ("one", "the value that means full output"),
            ("disarmed", "the value while disarmed"),
        ],
    ),
];

/// A key that is missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MissingKey {
    /// The table as the file writes it; none at the top level.
    pub table: Option<String>,
    pub key: &'static str,
    /// What its value would be.
    pub expected: &'static str,
}

/// The first key that `file` lacks.
pub(super) fn missing(file: &Value) -> Option<MissingKey> {
    let lacking = |table: Option<String>, found: &Value, keys: &[Key]| {
        let (key, expected) = keys.iter().find(|(key, _)| found.get(key).is_none())?;
        Some(MissingKey { table, key, expected })
    };
    let rotors = file.get("rotors").and_then(Value::as_array).into_iter().flatten().enumerate();
    lacking(None, file, TOP)
        .or_else(|| {
            rotors.into_iter().find_map(|(index, rotor)| {
                lacking(Some(format!("[[rotors]] number {}", index + 1)), rotor, ROTOR)
            })
        })
        .or_else(|| {
            TABLES
                .iter()
                .find_map(|(name, keys)| lacking(Some(format!("[{name}]")), file.get(name)?, keys))
        })
}
