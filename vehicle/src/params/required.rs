//! The keys that a vehicle file must have.

use serde_json::Value;

/// A key and a description of its value.
type Key = (&'static str, &'static str);

/// Required keys at the top level.
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
/// Required keys of each rotor.
const ROTOR: &[Key] = &[
    ("position_m", "the rotor's position from the centre of mass in m, as [front, right, down]"),
    ("spin", "1 where the rotor's drag turns the body to the right, else -1"),
    ("thrust_max_N", "the thrust at full output in N"),
    ("drag_torque_per_thrust_m", "the drag torque over the thrust in m"),
];
/// Required keys of the single tables. Every table except the battery may be absent altogether.
const TABLES: [(&str, &[Key]); 4] = [
    (
        "attitude_pd",
        &[
            ("kp", "the gains of roll, pitch and yaw in N m/rad"),
            ("kd", "the gains of the body rates in N m s/rad"),
            ("rate_hz", "the rate of the on-board loop in Hz"),
        ],
    ),
    (
        "attitude_cascade",
        &[
            ("angle_p_per_s", "the gains from attitude error to body rate in 1/s"),
            ("rate_max_rad_s", "the largest body rates in rad/s"),
            ("rate_p_Nms", "the gains from rate error to moment in N m s/rad"),
            ("rate_i_Nm", "the gains from its integral to moment in N m/rad"),
            ("rate_d_Nms2", "the gains from angular acceleration to moment in N m s^2/rad"),
            ("integral_max_Nm", "the bounds of the integral in N m"),
            ("gyro_cutoff_hz", "the cutoff of the gyro's low-pass in Hz"),
            ("derivative_cutoff_hz", "the cutoff of the derivative's low-pass in Hz"),
            ("rate_hz", "the rate of the loop in Hz"),
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

/// A required key that a file lacks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MissingKey {
    /// The table as written in the file; `None` at the top level.
    pub table: Option<String>,
    pub key: &'static str,
    /// Description of its value.
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
            TABLES.iter().find_map(|(name, keys)| {
                let table = file.get(name).filter(|found| found.is_object())?;
                lacking(Some(format!("[{name}]")), table, keys)
            })
        })
}

#[cfg(test)]
mod tests {
    use super::super::tests::quad;
    use super::super::{AttitudePd, MotorOutput, ROTORS, VehicleError, VehicleParams};

    /// Every table with every key.
    fn whole() -> serde_json::Value {
        let vehicle = VehicleParams {
            attitude_pd: Some(AttitudePd { kp: [1.0; 3], kd: [0.1; 3], rate_hz: 250.0 }),
            motor_output: Some(MotorOutput {
                message: "ACTUATOR_OUTPUT_STATUS".to_owned(),
                fields: (0..ROTORS).map(|i| format!("actuator[{i}]")).collect(),
                zero: 0.0,
                one: 1.0,
                disarmed: 0.0,
            }),
            ..quad()
        };
        serde_json::to_value(vehicle).unwrap()
    }

    /// Parses the file without one key of the table at `pointer`, as TOML and as JSON.
    fn without(pointer: &str, key: &str) -> [Result<VehicleParams, VehicleError>; 2] {
        let mut file = whole();
        file.pointer_mut(pointer).unwrap().as_object_mut().unwrap().remove(key).unwrap();
        [
            VehicleParams::from_toml_str(&toml::to_string(&file).unwrap()),
            VehicleParams::from_json_str(&file.to_string()),
        ]
    }

    #[test]
    fn missing_key_is_named_with_its_table() {
        let places = [
            ("", "the top level"),
            ("/rotors/2", "[[rotors]] number 3"),
            ("/attitude_pd", "[attitude_pd]"),
            ("/battery", "[battery]"),
            ("/motor_output", "[motor_output]"),
        ];
        let optional = ["attitude_pd", "rotor_max_rpm", "modelled_effects", "motor_output"];
        for (pointer, table) in places {
            let keys: Vec<String> =
                whole().pointer(pointer).unwrap().as_object().unwrap().keys().cloned().collect();
            for key in keys {
                for found in without(pointer, &key) {
                    if pointer.is_empty() && optional.contains(&key.as_str()) {
                        assert!(found.is_ok(), "{key}: {found:?}");
                        continue;
                    }
                    let error = found.unwrap_err().to_string();
                    assert!(error.contains(table), "{error}");
                    assert!(error.contains(&format!("has no key {key}: expected")), "{error}");
                    assert!(!error.contains("line"), "{error}");
                }
            }
        }
    }

    #[test]
    fn null_table_lacks_no_key() {
        let mut file = whole();
        file["attitude_pd"] = serde_json::Value::Null;
        file["battery"].as_object_mut().unwrap().remove("cells").unwrap();
        let error = VehicleParams::from_json_str(&file.to_string()).unwrap_err().to_string();
        assert!(error.contains("[battery] has no key cells"), "{error}");
    }

    #[test]
    fn misspelt_key_is_reported_with_its_line() {
        let text = quad().to_toml().unwrap().replace("gravity", "gravitation");
        let error = VehicleParams::from_toml_str(&text).unwrap_err().to_string();
        assert!(error.contains("line") && error.contains("gravitation"), "{error}");
    }
}
