//! The vehicle file: the simulator's and the firmware's nominal model of a quadrotor.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::EffectSet;
use crate::from_toml;
use crate::rotor::Allocation;

mod cascade;
mod check;
mod difference;
mod error;
mod required;
mod shipped;
mod validity;

pub use cascade::AttitudeCascade;
pub use check::{Doubt, Remark};
pub use difference::Difference;
pub use error::VehicleError;
pub use shipped::{SHIPPED, Shipped, read, shipped};

/// Number of rotors; only quadrotors are supported.
pub const ROTORS: usize = 4;

/// The contents of a vehicle file. Field names carry the unit where it is not plain SI.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleParams {
    /// Name of the vehicle.
    pub name: String,
    /// Mass in kg.
    pub mass: f64,
    /// Principal moments of inertia about body x, y, z in kg m^2.
    pub inertia: [f64; 3],
    /// The rotors, in the order of the motor outputs.
    pub rotors: [RotorParams; ROTORS],
    /// Time constant of the rotors' first-order lag in s; 0 means no lag.
    pub motor_time_constant_s: f64,
    /// Mean delay from sending a setpoint on the ground to its use on board, in s.
    pub command_delay_s: f64,
    /// The bundled simulator's on-board attitude loop; missing where the autopilot brings its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attitude_pd: Option<AttitudePd>,
    /// The on-board attitude loop of PX4 or ArduCopter, in place of `attitude_pd`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attitude_cascade: Option<AttitudeCascade>,
    /// The firmware's estimate of the hover thrust, as a fraction of the rotors' maximum.
    pub hover_thrust: f64,
    /// Gravity in m/s^2.
    pub gravity: f64,
    /// Air density in kg/m^3.
    pub air_density: f64,
    /// Radius of a rotor in m.
    pub rotor_radius_m: f64,
    /// Rotor speed at full output in revolutions per minute; missing where it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotor_max_rpm: Option<f64>,
    /// Nominal data of the battery pack.
    pub battery: BatteryParams,
    /// Effects that the simulator already models, by id.
    #[serde(default)]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub modelled_effects: EffectSet,
    /// How a motor output message maps to 0..1. Overrides the autopilot's own parameters; missing
    /// where those give the mapping or the message carries 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motor_output: Option<MotorOutput>,
    /// Linear drag on the air-relative velocity, in N per m/s; replaces the effect rotor_drag.
    #[serde(rename = "linear_drag_N_per_m_s", default, skip_serializing_if = "Option::is_none")]
    pub linear_drag_n_per_m_s: Option<f64>,
    /// Damping moment per body rate, for each axis, in N m s.
    #[serde(rename = "angular_damping_Nms", default, skip_serializing_if = "Option::is_none")]
    pub angular_damping_nms: Option<[f64; 3]>,
    /// Free text about the autopilot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autopilot: Option<String>,
    /// Free text about the vehicle.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Source of each number, by field name.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub provenance: serde_json::Map<String, serde_json::Value>,
}

/// Position, spin and thrust of one rotor.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorParams {
    /// Position relative to the centre of mass, body front, right, down, in m.
    pub position_m: [f64; 3],
    /// +1 if the rotor's drag torque on the body is about +z body (down), else -1.
    pub spin: i8,
    /// Thrust at full output in N.
    #[serde(rename = "thrust_max_N")]
    pub thrust_max_n: f64,
    /// Drag torque per thrust in m.
    pub drag_torque_per_thrust_m: f64,
}

/// Gains of the on-board attitude loop M = kp (zeta_des - zeta) + kd (omega_des - omega), body
/// axes.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudePd {
    /// Attitude gains for roll, pitch and yaw, in N m/rad.
    pub kp: [f64; 3],
    /// Rate gains for roll, pitch and yaw, in N m s/rad.
    pub kd: [f64; 3],
    /// Rate of the loop in Hz.
    pub rate_hz: f64,
}

/// The battery pack's nominal data.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatteryParams {
    /// Cells in series.
    pub cells: u8,
    /// Open-circuit voltage of the full pack in V.
    #[serde(rename = "full_V")]
    pub full_v: f64,
    /// Rated voltage of the pack in V.
    #[serde(rename = "nominal_V")]
    pub nominal_v: f64,
}

/// How a motor output message maps to u in 0..1: u = (value - zero) / (one - zero).
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorOutput {
    /// Name of the MAVLink message.
    pub message: String,
    /// Fields of that message, in the order of `rotors`.
    pub fields: Vec<String>,
    /// Message value for u = 0.
    pub zero: f64,
    /// Message value for u = 1.
    pub one: f64,
    /// Message value while disarmed.
    pub disarmed: f64,
}

impl VehicleParams {
    /// Reads and checks the vehicle file at `path`, or the shipped vehicle of that name. The
    /// extension `.toml` or `.json` selects the format; without either, the first character does.
    ///
    /// # Errors
    /// The file cannot be read, violates the schema, or holds an impossible value.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, VehicleError> {
        let path = path.as_ref();
        let read = |source| VehicleError::Read { path: path.to_owned(), source };
        let text = shipped::read(path).map_err(read)?;
        let json = match path.extension().and_then(|e| e.to_str()) {
            Some("toml") => false,
            Some("json") => true,
            _ => text.trim_start().starts_with('{'),
        };
        if json { Self::from_json_str(&text) } else { Self::from_toml_str(&text) }
            .map_err(|error| error.in_file(path))
    }

    /// Parses and checks a vehicle in TOML.
    ///
    /// # Errors
    /// The text violates the schema or holds an impossible value. The error names no file.
    pub fn from_toml_str(text: &str) -> Result<Self, VehicleError> {
        from_toml::<Self>(text)
            .map_err(|e| VehicleError::schema(e.to_string(), || toml::from_str(text).ok()))?
            .checked()
    }

    /// Parses and checks a vehicle in JSON.
    ///
    /// # Errors
    /// The text violates the schema or holds an impossible value. The error names no file.
    pub fn from_json_str(text: &str) -> Result<Self, VehicleError> {
        serde_json::from_str::<Self>(text)
            .map_err(|e| VehicleError::schema(e.to_string(), || serde_json::from_str(text).ok()))?
            .checked()
    }

    /// Formats the vehicle as TOML that [`VehicleParams::from_toml_str`] reads back.
    ///
    /// # Errors
    /// The provenance holds a value that TOML lacks, such as a JSON null.
    pub fn to_toml(&self) -> Result<String, VehicleError> {
        toml::to_string(self).map_err(|e| VehicleError::syntax(e.to_string()))
    }

    /// The weight m g of the nominal vehicle, N.
    pub fn weight_n(&self) -> f64 {
        self.mass * self.gravity
    }

    /// Mean horizontal distance of the rotors from the centre of mass, m.
    pub fn arm_m(&self) -> f64 {
        let arms = self.rotors.map(|rotor| rotor.position_m[0].hypot(rotor.position_m[1]));
        arms.iter().sum::<f64>() / ROTORS as f64
    }

    /// Full thrust of all rotors together, without modelled effects, N.
    pub fn thrust_full_n(&self) -> f64 {
        self.rotors.iter().map(|rotor| rotor.thrust_max_n).sum()
    }

    /// Weight over the rotors' maximum thrust, without modelled effects. `hover_thrust` equals it
    /// where the firmware's estimate is right.
    pub fn hover_share(&self) -> f64 {
        self.weight_n() / self.thrust_full_n()
    }

    /// The on-board attitude loop as a PD law, whether the file gives a PD law or a cascade.
    pub fn attitude_loop_pd(&self) -> Option<AttitudePd> {
        self.attitude_pd.or_else(|| self.attitude_cascade.map(|cascade| cascade.as_pd()))
    }

    /// The firmware's mixer, from the nominal rotors.
    ///
    /// # Errors
    /// The rotors cannot produce thrust, roll, pitch and yaw independently.
    pub fn allocation(&self) -> Result<Allocation, VehicleError> {
        Allocation::new(&self.rotors).ok_or_else(|| {
            let positions = self.rotors.map(|r| [r.position_m[0], r.position_m[1]]);
            let spins = self.rotors.map(|r| r.spin);
            self.error(
                "rotors",
                "positions, spins and drag torques that give thrust, roll, pitch and yaw",
                format!("positions {positions:?} m, spins {spins:?}"),
            )
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A 1.2 kg quadrotor in X layout with round numbers.
    pub(crate) fn quad() -> VehicleParams {
        let rotor = |x: f64, y: f64, spin: i8| RotorParams {
            position_m: [x, y, 0.0],
            spin,
            thrust_max_n: 6.0,
            drag_torque_per_thrust_m: 0.016,
        };
        VehicleParams {
            name: "quad".to_owned(),
            mass: 1.2,
            inertia: [0.011, 0.012, 0.021],
            rotors: [
                rotor(0.13, 0.12, 1),
                rotor(-0.13, 0.12, -1),
                rotor(-0.13, -0.12, 1),
                rotor(0.13, -0.12, -1),
            ],
            motor_time_constant_s: 0.0,
            command_delay_s: 0.005,
            attitude_pd: None,
            attitude_cascade: None,
            hover_thrust: 1.2 * 9.80665 / 24.0,
            gravity: 9.80665,
            air_density: 1.2,
            rotor_radius_m: 0.12,
            rotor_max_rpm: Some(9000.0),
            battery: BatteryParams { cells: 4, full_v: 16.8, nominal_v: 14.8 },
            modelled_effects: EffectSet::new(),
            motor_output: None,
            linear_drag_n_per_m_s: None,
            angular_damping_nms: None,
            autopilot: None,
            notes: Vec::new(),
            provenance: serde_json::Map::new(),
        }
    }

    #[test]
    fn six_rotors_and_moments_too_many_are_refused() {
        let mut text = quad().to_toml().unwrap();
        let start = text.find("[[rotors]]").unwrap();
        let rest = &text[start + 2..];
        let rotor = format!("[[{}\n", &rest[..rest.find("\n[").unwrap()]);
        text.insert_str(start, &rotor.repeat(2));
        let error = VehicleParams::from_toml_str(&text).unwrap_err().to_string();
        assert!(error.contains("length 6") && error.contains("only quadrotors"), "{error}");
        let text = quad().to_toml().unwrap().replacen("inertia = [", "inertia = [0.01, ", 1);
        let error = VehicleParams::from_toml_str(&text).unwrap_err().to_string();
        assert!(error.contains("length 4") && error.contains("inertia"), "{error}");
    }

    #[test]
    fn vehicle_round_trips_through_toml_and_json() {
        let vehicle = quad().checked().unwrap();
        assert_eq!(VehicleParams::from_toml_str(&vehicle.to_toml().unwrap()).unwrap(), vehicle);
        let json = serde_json::to_string(&vehicle).unwrap();
        assert_eq!(VehicleParams::from_json_str(&json).unwrap(), vehicle);
    }

    #[test]
    fn vehicle_file_has_one_onboard_loop() {
        let cascade = cascade::tests::cascade();
        let vehicle = VehicleParams { attitude_cascade: Some(cascade), ..quad() };
        assert_eq!(vehicle.attitude_loop_pd(), Some(cascade.as_pd()));
        let text = vehicle.clone().checked().unwrap().to_toml().unwrap();
        assert_eq!(VehicleParams::from_toml_str(&text).unwrap(), vehicle);
        let both = VehicleParams { attitude_pd: Some(cascade.as_pd()), ..vehicle };
        assert!(both.checked().unwrap_err().to_string().contains("one on-board loop"));
    }

    #[test]
    fn hover_share_follows_the_mass_not_hover_thrust() {
        let vehicle = VehicleParams { hover_thrust: 0.9, ..quad() };
        assert!((vehicle.hover_share() - 1.2 * 9.80665 / 24.0).abs() < 1e-12);
    }

    #[test]
    fn unknown_key_is_refused_by_name() {
        let text = quad().to_toml().unwrap();
        let error = VehicleParams::from_toml_str(&format!("colour = \"red\"\n{text}"));
        assert!(error.unwrap_err().to_string().contains("colour"));
        let text = text.replace("thrust_max_N", "thrust_max");
        assert!(
            VehicleParams::from_toml_str(&text).unwrap_err().to_string().contains("thrust_max")
        );
    }
}
