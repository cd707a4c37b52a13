//! The mapping file: a TOML definition of a table's columns. `config/mappings/` has examples.
//!
//! Units, frames, orders and signs must be stated and are never guessed: anything missing that a
//! column needs is an error that names it.

mod axes;
mod bind;
mod contradiction;
mod heading;
mod propose;
mod row;
mod shipped;
mod unit_word;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Deserialize;

use super::error::ImportError;
pub use axes::{AttitudeTurn, BodyFrame, WorldFrame};
pub(super) use heading::Heading;
pub(super) use propose::propose;
pub(super) use row::{Cell, Outputs, Row, RowReader};
pub use shipped::SHIPPED;
pub(super) use unit_word::{is_line as is_line_of_units, is_none as is_no_unit};

/// The content of a mapping file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Character between the cells of a row; detected from the columns by default.
    pub separator: Option<char>,
    /// Decimal mark. By default a point, or a comma if no cell has a point.
    pub decimal: Option<DecimalMark>,
    /// Lines before the one that names the columns; by default the names are searched for.
    pub skip_lines: Option<u64>,
    /// Cells above the table and the values that must follow them, such as `"Length Units" =
    /// "Meters"`.
    #[serde(default)]
    pub expect: BTreeMap<String, String>,
    /// A column that the table may have only once, such as `["Rigid Body", "Position", "X"]`, where
    /// columns by number are those of the first body.
    pub single: Option<Column>,
    /// Axes of the world frame in the table.
    pub world_frame: Option<WorldFrame>,
    /// Axes of the body frame in the table.
    pub body_frame: Option<BodyFrame>,
    /// Time of a row.
    pub time: Option<TimeMap>,
    /// Columns of the position.
    pub position: Option<PositionMap>,
    /// Columns of the velocity.
    pub velocity: Option<VelocityMap>,
    /// Columns of the attitude.
    pub attitude: Option<AttitudeMap>,
    /// Columns of the body rate.
    pub body_rate: Option<RateMap>,
    /// Columns of the accelerometer or the acceleration.
    pub specific_force: Option<ForceMap>,
    /// Columns of the motor commands.
    pub motors: Option<MotorMap>,
    /// Columns of the measured rotor speeds.
    pub rotor_speed: Option<SpeedMap>,
    /// Column of the pack voltage.
    pub voltage: Option<VoltageMap>,
    /// Columns of the setpoints.
    pub setpoint: Option<SetpointMap>,
}

/// Decimal mark of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum DecimalMark {
    /// A point, as in 0.5.
    #[serde(rename = ".")]
    Point,
    /// A comma, as in 0,5.
    #[serde(rename = ",")]
    Comma,
}

/// A column of a table, or its values with the opposite sign: `{ minus = "pitch" }`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(from = "ColumnText")]
pub struct Column {
    place: Place,
    is_opposite: bool,
}

/// A column as a mapping file states it.
#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected a column: its name, its number from 1, a list of words above it, or \
                 { minus = one of these } for the opposite sign"
)]
enum ColumnText {
    Plain(Place),
    Opposite(Opposite),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Opposite {
    minus: Place,
}

impl From<ColumnText> for Column {
    fn from(text: ColumnText) -> Self {
        match text {
            ColumnText::Plain(place) => Self { place, is_opposite: false },
            ColumnText::Opposite(Opposite { minus }) => Self { place: minus, is_opposite: true },
        }
    }
}

impl Column {
    /// The factor of its values: 1 or -1.
    fn sign(&self) -> f64 {
        if self.is_opposite { -1.0 } else { 1.0 }
    }
}

/// Identifies a column of a table.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
enum Place {
    /// By name.
    Name(String),
    /// By number, counted from 1.
    Number(usize),
    /// By words in the lines above it and, last, its name, if several columns share the name.
    Words(Vec<String>),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "{name:?}"),
            Self::Number(number) => write!(f, "number {number}"),
            Self::Words(words) => write!(f, "{words:?}"),
        }
    }
}

/// `[time]`: a column with its unit, or the rate of the rows.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeMap {
    column: Option<Column>,
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
    /// Dates with a time of day, or times of day.
    Iso8601,
}

/// `[position]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PositionMap {
    columns: [Column; 3],
    unit: Option<LengthText>,
}

/// A unit of length, or the cell above the table that precedes one.
#[derive(Clone, Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected \"m\", \"cm\" or \"mm\", or { above = \"a cell that the unit follows\" }"
)]
enum LengthText {
    Unit(LengthUnit),
    Above { above: String },
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum LengthUnit {
    M,
    Cm,
    Mm,
}

impl LengthUnit {
    /// Parses the unit's name, as other programs write it.
    fn named(name: &str) -> Option<Self> {
        Some(match name.to_ascii_lowercase().as_str() {
            "m" | "meter" | "meters" | "metre" | "metres" => Self::M,
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => Self::Cm,
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Self::Mm,
            _ => return None,
        })
    }

    /// Length of one unit in m.
    fn in_m(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 0.01,
            Self::Mm => 1e-3,
        }
    }
}

/// `[velocity]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VelocityMap {
    columns: [Column; 3],
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

/// Frame of a vector's components.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Axes {
    World,
    Body,
}

/// `[attitude]`: exactly one of quaternion, Euler angles and matrix.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudeMap {
    quaternion: Option<[Column; 4]>,
    order: Option<QuaternionOrder>,
    euler: Option<[Column; 3]>,
    unit: Option<AngleUnit>,
    matrix: Option<[Column; 9]>,
    rotates: Option<Rotates>,
}

impl AttitudeMap {
    /// The columns of all forms.
    fn columns(&self) -> impl Iterator<Item = &Column> {
        let forms = [
            self.quaternion.as_ref().map(<[Column; 4]>::as_slice),
            self.euler.as_ref().map(<[Column; 3]>::as_slice),
            self.matrix.as_ref().map(<[Column; 9]>::as_slice),
        ];
        forms.into_iter().flatten().flatten()
    }
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
    columns: [Column; 3],
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
    columns: [Column; 3],
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
    columns: [Column; 4],
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
    columns: [Column; 4],
    unit: Option<RotorUnit>,
}

/// `[voltage]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoltageMap {
    column: Column,
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
    thrust_fraction: Option<Column>,
}

impl Mapping {
    /// Reads a mapping file, or the shipped one of that name if there is no such file.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, or has invalid keys or values.
    pub fn load(path: &Path) -> Result<Self, ImportError> {
        let text = shipped::text(path)?;
        Self::parse(&text)
            .map_err(|message| ImportError::Mapping { path: path.to_owned(), message })
    }

    /// All columns that the mapping names.
    pub(super) fn columns(&self) -> impl Iterator<Item = &Column> {
        let setpoint = self.setpoint.as_ref();
        let attitudes = [self.attitude.as_ref(), setpoint.and_then(|map| map.attitude.as_ref())];
        let rates = [self.body_rate.as_ref(), setpoint.and_then(|map| map.body_rate.as_ref())];
        let single = [
            self.time.as_ref().and_then(|map| map.column.as_ref()),
            self.voltage.as_ref().map(|map| &map.column),
            setpoint.and_then(|map| map.thrust_fraction.as_ref()),
        ];
        let several = [
            self.position.as_ref().map(|map| map.columns.as_slice()),
            self.velocity.as_ref().map(|map| map.columns.as_slice()),
            self.specific_force.as_ref().map(|map| map.columns.as_slice()),
            self.motors.as_ref().map(|map| map.columns.as_slice()),
            self.rotor_speed.as_ref().map(|map| map.columns.as_slice()),
        ];
        let rates = rates.into_iter().flatten().flat_map(|map| &map.columns);
        let attitudes = attitudes.into_iter().flatten().flat_map(AttitudeMap::columns);
        single
            .into_iter()
            .flatten()
            .chain(several.into_iter().flatten().flatten())
            .chain(rates)
            .chain(attitudes)
    }

    /// Parses a mapping in TOML; the error says what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        vehicle::from_toml(text).map_err(|error| error.to_string())
    }
}
