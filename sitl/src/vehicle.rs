//! The vehicle file: what the simulator and the firmware believe about a quadrotor.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::effects::EffectSet;

/// Number of rotors; the project is about quadrotors.
pub const ROTORS: usize = 4;

/// A vehicle file, as read and checked. Units are in the field names where they are not SI.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// First-order lag of the rotors' state in s; 0 means none is modelled.
    pub motor_time_constant_s: f64,
    /// Mean delay from the ground station's send to use on board, in s.
    pub command_delay_s: f64,
    /// The on-board attitude loop; missing where the autopilot's loop is its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attitude_pd: Option<AttitudePd>,
    /// Fraction of the rotors' maximum thrust at hover, as the firmware believes.
    pub hover_thrust: f64,
    /// Gravity in m/s^2.
    pub gravity: f64,
    /// Air density in kg/m^3.
    pub air_density: f64,
    /// Radius of a rotor in m.
    pub rotor_radius_m: f64,
    /// Rotor speed at full output in revolutions per minute; missing where rpm is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotor_max_rpm: Option<f64>,
    /// The pack.
    pub battery: BatteryParams,
    /// Effects that the simulator already has, by id.
    #[serde(default)]
    pub modelled_effects: EffectSet,
    /// How a motor output message maps to 0..1; missing where it carries 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motor_output: Option<MotorOutput>,
    /// Exact linear drag on the air-relative velocity, in N per m/s; takes rotor_drag's place.
    #[serde(rename = "linear_drag_N_per_m_s", default, skip_serializing_if = "Option::is_none")]
    pub linear_drag_n_per_m_s: Option<f64>,
    /// Moment against the body rate, per axis, in N m s.
    #[serde(rename = "angular_damping_Nms", default, skip_serializing_if = "Option::is_none")]
    pub angular_damping_nms: Option<[f64; 3]>,
    /// Free text about the autopilot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autopilot: Option<String>,
    /// Free text.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Where the numbers come from, by field.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub provenance: serde_json::Map<String, serde_json::Value>,
}

/// One rotor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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

/// Gains of the on-board loop M = kp (zeta_des - zeta) + kd (omega_des - omega), about body axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudePd {
    /// Roll, pitch, yaw, in N m/rad.
    pub kp: [f64; 3],
    /// Roll, pitch, yaw, in N m s/rad.
    pub kd: [f64; 3],
    /// Rate of the loop in Hz.
    pub rate_hz: f64,
}

/// The pack's nominal data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatteryParams {
    /// Cells in series.
    pub cells: u8,
    /// Pack voltage when full.
    #[serde(rename = "full_V")]
    pub full_v: f64,
    /// Pack voltage for ratings.
    #[serde(rename = "nominal_V")]
    pub nominal_v: f64,
}

/// How a motor output message maps to u in 0..1: u = (value - zero) / (one - zero).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorOutput {
    /// MAVLink message name.
    pub message: String,
    /// Fields of that message, in the order of `rotors`.
    pub fields: Vec<String>,
    /// Value that means u = 0.
    pub zero: f64,
    /// Value that means u = 1.
    pub one: f64,
    /// Value while disarmed.
    pub disarmed: f64,
}

/// Why a vehicle file is refused.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The file cannot be read.
    #[error("vehicle file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML or JSON, or does not follow the schema.
    #[error("vehicle file {path}: {message}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the parser found and where.
        message: String,
    },
    /// A value is impossible.
    #[error("vehicle {vehicle}: {field}: expected {expected}, found {found}")]
    Value {
        /// The vehicle's name.
        vehicle: String,
        /// Path of the field.
        field: String,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: String,
    },
}
