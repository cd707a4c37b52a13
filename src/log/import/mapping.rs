//! The mapping file: what the columns of a table are, in TOML. `config/mappings/` has examples.
//!
//! Units, frames, orders and signs are stated, never guessed: what a column needs and the file
//! does not say is an error that names it.

mod axes;
mod bind;
mod row;

use std::fs;
use std::path::Path;

use serde::Deserialize;

use super::error::ImportError;
pub use axes::{BodyFrame, WorldFrame, attitude_to_ned};
pub(super) use row::{Outputs, Row, RowReader};

/// A mapping file, as read.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// One character between the fields of a row; a comma where it is not said.
    pub separator: Option<char>,
    /// Axes of the world.
    pub world_frame: Option<WorldFrame>,
    /// Axes of the body.
    pub body_frame: Option<BodyFrame>,
    /// When a row was sampled.
    pub time: Option<TimeMap>,
    /// Position.
    pub position: Option<PositionMap>,
    /// Velocity.
    pub velocity: Option<VelocityMap>,
    /// Attitude.
    pub attitude: Option<AttitudeMap>,
    /// Body rate.
    pub body_rate: Option<RateMap>,
    /// Accelerometer or acceleration.
    pub specific_force: Option<ForceMap>,
    /// Motor commands.
    pub motors: Option<MotorMap>,
    /// Measured rotor speeds.
    pub rotor_speed: Option<SpeedMap>,
    /// Pack voltage.
    pub voltage: Option<VoltageMap>,
    /// What was asked of the vehicle.
    pub setpoint: Option<SetpointMap>,
}

/// `[time]`: a column with its unit, or the rate of rows without one.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeMap {
    column: Option<String>,
    unit: Option<TimeUnit>,
    rate_hz: Option<f64>,
}

/// Unit of times.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum TimeUnit {
    S,
    Ms,
    Us,
    Ns,
}

/// `[position]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PositionMap {
    columns: [String; 3],
    unit: Option<LengthUnit>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum LengthUnit {
    M,
    Cm,
    Mm,
}

/// `[velocity]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VelocityMap {
    columns: [String; 3],
    unit: Option<SpeedUnit>,
    axes: Option<Axes>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum SpeedUnit {
    #[serde(rename = "m/s")]
    Metres,
    #[serde(rename = "cm/s")]
    Centimetres,
    #[serde(rename = "mm/s")]
    Millimetres,
}

/// Whose axes a vector's components are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Axes {
    World,
    Body,
}

/// `[attitude]`: exactly one of the three forms.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudeMap {
    quaternion: Option<[String; 4]>,
    order: Option<QuaternionOrder>,
    euler: Option<[String; 3]>,
    unit: Option<AngleUnit>,
    matrix: Option<[String; 9]>,
    rotates: Option<Rotates>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum QuaternionOrder {
    Wxyz,
    Xyzw,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum AngleUnit {
    Rad,
    Deg,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Rotates {
    BodyToWorld,
    WorldToBody,
}

/// `[body_rate]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateMap {
    columns: [String; 3],
    unit: Option<RateUnit>,
    axes: Option<Axes>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum RateUnit {
    #[serde(rename = "rad/s")]
    Radians,
    #[serde(rename = "deg/s")]
    Degrees,
}

/// `[specific_force]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceMap {
    columns: [String; 3],
    unit: Option<AccelerationUnit>,
    meaning: Option<ForceMeaning>,
    axes: Option<Axes>,
    gravity_mps2: Option<f64>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum AccelerationUnit {
    #[serde(rename = "m/s2")]
    MetresPerSecondSquared,
    #[serde(rename = "g")]
    Gravity,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ForceMeaning {
    SpecificForce,
    Acceleration,
}

/// `[motors]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorMap {
    columns: [String; 4],
    meaning: Option<MotorMeaning>,
    range: Option<[f64; 2]>,
    #[serde(rename = "polynomial_N")]
    polynomial_n: Option<Vec<f64>>,
    unit: Option<RotorUnit>,
    #[serde(rename = "thrust_coefficient_N_s2")]
    thrust_coefficient_n_s2: Option<f64>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum MotorMeaning {
    ThrustFraction,
    #[serde(rename = "thrust_N")]
    ThrustN,
    Pwm,
    RotorSpeed,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum RotorUnit {
    #[serde(rename = "rad/s")]
    Radians,
    #[serde(rename = "rpm")]
    Rpm,
}

/// `[rotor_speed]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedMap {
    columns: [String; 4],
    unit: Option<RotorUnit>,
}

/// `[voltage]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoltageMap {
    column: String,
    unit: Option<VoltageUnit>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
enum VoltageUnit {
    V,
    #[serde(rename = "mV")]
    Millivolt,
}

/// `[setpoint]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetpointMap {
    attitude: Option<AttitudeMap>,
    body_rate: Option<RateMap>,
    thrust_fraction: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// A file that cannot be read, is no TOML, or has keys or values that no mapping has.
    pub fn load(path: &Path) -> Result<Self, ImportError> {
        let text = fs::read_to_string(path)
            .map_err(|source| ImportError::Read { path: path.to_owned(), source })?;
        Self::parse(&text)
            .map_err(|message| ImportError::Mapping { path: path.to_owned(), message })
    }

    /// A mapping from TOML text; the error says what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        toml::from_str(text).map_err(|error| error.to_string())
    }
}
