//! The vehicle file: the simulator's and the firmware's nominal model of a quadrotor.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::{Effect, EffectSet, RotorGyroscopic};
use crate::from_toml;
use crate::rotor::Allocation;

mod cascade;
mod check;
mod difference;
mod error;
mod required;
mod shipped;

pub use cascade::AttitudeCascade;
pub use check::{Doubt, Remark};
pub use difference::Difference;
pub use error::VehicleError;
pub use shipped::{SHIPPED, Shipped, read, shipped};

/// Number of rotors; only quadrotors are supported.
pub const ROTORS: usize = 4;

/// Largest accepted mass, moment of inertia or thrust, each in its unit. A larger value would swamp
/// the others in floating-point arithmetic.
const MOST: f64 = 1e6;

/// Smallest accepted mass, kg. Below it, thrust over weight exceeds what a controller can handle.
const LEAST_MASS_KG: f64 = 1e-6;

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

    /// Weight over the rotors' maximum thrust, without modelled effects. `hover_thrust` equals it
    /// where the firmware's estimate is right.
    pub fn hover_share(&self) -> f64 {
        let full_n: f64 = self.rotors.iter().map(|rotor| rotor.thrust_max_n).sum();
        self.mass * self.gravity / full_n
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

    /// Returns this vehicle if every value is physically possible.
    ///
    /// # Errors
    /// Names the first impossible value and its field.
    pub fn checked(self) -> Result<Self, VehicleError> {
        self.check_body()?;
        self.check_rotors()?;
        self.check_loop()?;
        self.check_battery()?;
        self.check_effects(&self.modelled_effects)?;
        Ok(self)
    }

    /// Checks that this vehicle has every number that `effects` need.
    ///
    /// # Errors
    /// Names the first number that is missing.
    pub fn check_effects(&self, effects: &EffectSet) -> Result<(), VehicleError> {
        if effects.contains(RotorGyroscopic::ID) && self.rotor_max_rpm.is_none() {
            let expected = "a speed in 1/min, which the effect rotor_gyroscopic needs";
            return Err(self.error("rotor_max_rpm", expected, "none".to_owned()));
        }
        Ok(())
    }

    fn check_body(&self) -> Result<(), VehicleError> {
        let is_possible = |value: f64| value > 0.0 && value <= MOST;
        let is_mass = (LEAST_MASS_KG..=MOST).contains(&self.mass);
        self.require("mass", self.mass, is_mass, "a mass of at least 1e-6 kg, at most 1e6")?;
        for (axis, moment) in ["inertia[0]", "inertia[1]", "inertia[2]"].iter().zip(self.inertia) {
            let expected = "a moment of inertia above 0 kg m^2, at most 1e6";
            self.require(axis, moment, is_possible(moment), expected)?;
        }
        let sum: f64 = self.inertia.iter().sum();
        let largest = self.inertia.into_iter().fold(0.0, f64::max);
        // Published inertias violate the triangle inequality by a percent or two.
        if largest > 1.05 * (sum - largest) {
            let expected = "no moment above the sum of the other two, by more than 5 %";
            return Err(self.error("inertia", expected, format!("{:?} kg m^2", self.inertia)));
        }
        let g = self.gravity;
        self.require("gravity", g, g > 0.0 && g < 100.0, "gravity in 0..100 m/s^2")?;
        let rho = self.air_density;
        self.require("air_density", rho, rho > 0.0 && rho < 100.0, "a density in 0..100 kg/m^3")?;
        if let Some(k) = self.linear_drag_n_per_m_s {
            self.require("linear_drag_N_per_m_s", k, k >= 0.0, "0 or more N per m/s")?;
        }
        for k in self.angular_damping_nms.into_iter().flatten() {
            self.require("angular_damping_Nms", k, k >= 0.0, "0 or more N m s")?;
        }
        Ok(())
    }

    fn check_rotors(&self) -> Result<(), VehicleError> {
        for (i, rotor) in self.rotors.iter().enumerate() {
            let field = |name: &str| format!("rotors[{i}].{name}");
            for coordinate in rotor.position_m {
                let expected = "lengths in m, at most 1000";
                let is_possible = coordinate.abs() <= 1e3;
                self.require(&field("position_m"), coordinate, is_possible, expected)?;
            }
            let spin = rotor.spin;
            if spin != 1 && spin != -1 {
                return Err(self.error(&field("spin"), "1 or -1", spin.to_string()));
            }
            let thrust = rotor.thrust_max_n;
            let expected = "a thrust above 0 N, at most 1e6";
            self.require(&field("thrust_max_N"), thrust, thrust > 0.0 && thrust <= MOST, expected)?;
            let torque = rotor.drag_torque_per_thrust_m;
            let name = field("drag_torque_per_thrust_m");
            self.require(&name, torque, torque > 0.0, "a ratio above 0 m (spin has the sign)")?;
        }
        self.allocation()?;
        let radius = self.rotor_radius_m;
        self.require("rotor_radius_m", radius, radius > 0.0, "a radius above 0 m")?;
        if let Some(rpm) = self.rotor_max_rpm {
            self.require("rotor_max_rpm", rpm, rpm > 0.0, "a speed above 0 in 1/min")?;
        }
        let tau = self.motor_time_constant_s;
        let expected = "a time in 0..=2 s";
        self.require("motor_time_constant_s", tau, (0.0..=2.0).contains(&tau), expected)?;
        let hover = self.hover_thrust;
        let expected = "a fraction of the full thrust between 0 and 1";
        self.require("hover_thrust", hover, hover > 0.0 && hover < 1.0, expected)?;
        if let Some(MotorOutput { zero, one, disarmed, .. }) = &self.motor_output {
            self.require("motor_output.zero", *zero, true, "a number")?;
            self.require("motor_output.one", *one, one != zero, "a number other than zero's")?;
            self.require("motor_output.disarmed", *disarmed, true, "a number")?;
        }
        if let Some(MotorOutput { fields, .. }) = &self.motor_output
            && fields.len() != ROTORS
        {
            let found = format!("{} fields", fields.len());
            return Err(self.error("motor_output.fields", "one field for each rotor", found));
        }
        Ok(())
    }

    fn check_loop(&self) -> Result<(), VehicleError> {
        let delay = self.command_delay_s;
        let expected = "a time in 0..=1 s";
        self.require("command_delay_s", delay, (0.0..=1.0).contains(&delay), expected)?;
        if let Some(cascade) = &self.attitude_cascade {
            self.check_cascade(cascade)?;
        }
        let Some(pd) = &self.attitude_pd else { return Ok(()) };
        for gain in pd.kp {
            self.require("attitude_pd.kp", gain, gain >= 0.0, "gains of 0 or more N m/rad")?;
        }
        for gain in pd.kd {
            self.require("attitude_pd.kd", gain, gain >= 0.0, "gains of 0 or more N m s/rad")?;
        }
        let rate = pd.rate_hz;
        let expected = "a rate in 1..=1000 Hz";
        self.require("attitude_pd.rate_hz", rate, (1.0..=1000.0).contains(&rate), expected)
    }

    fn check_cascade(&self, cascade: &AttitudeCascade) -> Result<(), VehicleError> {
        if self.attitude_pd.is_some() {
            let expected = "one on-board loop, attitude_pd or attitude_cascade";
            return Err(self.error("attitude_cascade", expected, "both".to_owned()));
        }
        for (name, triple) in [
            ("angle_p_per_s", cascade.angle_p_per_s),
            ("rate_max_rad_s", cascade.rate_max_rad_s),
            ("rate_p_Nms", cascade.rate_p_nms),
        ] {
            for value in triple {
                let field = format!("attitude_cascade.{name}");
                self.require(&field, value, value > 0.0, "numbers above 0")?;
            }
        }
        for (name, triple) in [
            ("rate_i_Nm", cascade.rate_i_nm),
            ("rate_d_Nms2", cascade.rate_d_nms2),
            ("rate_ff_Nms", cascade.rate_ff_nms),
            ("integral_max_Nm", cascade.integral_max_nm),
        ] {
            for value in triple {
                let field = format!("attitude_cascade.{name}");
                self.require(&field, value, value >= 0.0, "numbers of 0 or more")?;
            }
        }
        for (name, hz) in [
            ("gyro_cutoff_hz", cascade.gyro_cutoff_hz),
            ("derivative_cutoff_hz", cascade.derivative_cutoff_hz),
        ] {
            let field = format!("attitude_cascade.{name}");
            self.require(&field, hz, hz > 0.0, "a frequency above 0 Hz")?;
        }
        if let Some(tc) = cascade.input_time_constant_s {
            let field = "attitude_cascade.input_time_constant_s";
            self.require(field, tc, (0.0..=2.0).contains(&tc), "a time in 0..=2 s")?;
        }
        let rate = cascade.rate_hz;
        let expected = "a rate in 1..=8000 Hz";
        self.require("attitude_cascade.rate_hz", rate, (1.0..=8000.0).contains(&rate), expected)
    }

    fn check_battery(&self) -> Result<(), VehicleError> {
        let BatteryParams { cells, full_v, nominal_v } = self.battery;
        if cells == 0 {
            return Err(self.error("battery.cells", "1 or more cells", cells.to_string()));
        }
        let expected = "a voltage above 0 V";
        self.require("battery.nominal_V", nominal_v, nominal_v > 0.0, expected)?;
        let expected = "a voltage of at least nominal_V";
        self.require("battery.full_V", full_v, full_v >= nominal_v, expected)
    }

    fn require(
        &self,
        field: &str,
        value: f64,
        holds: bool,
        expected: &'static str,
    ) -> Result<(), VehicleError> {
        if value.is_finite() && holds {
            return Ok(());
        }
        // Debug writes very large and very small numbers with an exponent.
        Err(self.error(field, expected, format!("{value:?}")))
    }

    fn error(&self, field: &str, expected: &'static str, found: String) -> VehicleError {
        let (vehicle, field) = (self.name.clone(), field.to_owned());
        VehicleError::Value { vehicle, field, expected, found }
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

    fn refused(change: impl FnOnce(&mut VehicleParams)) -> String {
        let mut vehicle = quad();
        change(&mut vehicle);
        vehicle.checked().unwrap_err().to_string()
    }

    #[test]
    fn six_rotors_and_moments_too_many_are_refused() {
        let mut text = quad().to_toml().unwrap();
        let rotors: String = text
            .match_indices("[[rotors]]")
            .take(1)
            .map(|(at, _)| {
                let end = text[at + 2..].find("\n[").map_or(text.len(), |end| at + 2 + end + 1);
                text[at..end].to_owned()
            })
            .collect();
        let at = text.find("[[rotors]]").unwrap();
        text.insert_str(at, &rotors.repeat(2));
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
    fn impossible_values_are_refused_with_field_and_unit() {
        assert!(
            refused(|v| v.mass = -1.0)
                .contains("mass: expected a mass of at least 1e-6 kg, at most 1e6, found -1")
        );
        assert!(refused(|v| v.mass = 1e300).ends_with("found 1e300"));
        assert!(refused(|v| v.mass = 1e-300).ends_with("found 1e-300"));
        assert!(refused(|v| v.mass = f64::NAN).contains("found NaN"));
        assert!(refused(|v| v.inertia[1] = 0.0).contains("inertia[1]"));
        assert!(refused(|v| v.inertia = [0.01, 0.01, 0.03]).contains("sum of the other two"));
        assert!(refused(|v| v.rotors[2].spin = 0).contains("rotors[2].spin: expected 1 or -1"));
        assert!(refused(|v| v.rotors[3].thrust_max_n = 0.0).contains("rotors[3].thrust_max_N"));
        assert!(refused(|v| v.rotors[0].position_m[0] = f64::INFINITY).contains("position_m"));
        assert!(refused(|v| v.rotors.iter_mut().for_each(|r| r.spin = 1)).contains("rotors:"));
        assert!(refused(|v| v.hover_thrust = 1.0).contains("hover_thrust"));
        assert!(refused(|v| v.gravity = 0.0).contains("m/s^2"));
        assert!(refused(|v| v.air_density = -1.2).contains("kg/m^3"));
        assert!(refused(|v| v.battery.cells = 0).contains("battery.cells"));
        assert!(refused(|v| v.battery.full_v = 1.0).contains("at least nominal_V"));
        assert!(refused(|v| v.motor_time_constant_s = -0.1).contains("0..=2 s"));
        assert!(
            refused(|v| {
                v.rotor_max_rpm = None;
                v.modelled_effects
                    .insert_argument("rotor_gyroscopic:rotor_inertia_kgm2=1e-5")
                    .unwrap();
            })
            .contains("rotor_max_rpm")
        );
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
    fn inertia_may_violate_the_triangle_inequality_slightly() {
        let mut vehicle = quad();
        vehicle.inertia = [1.0e-5, 1.0e-5, 2.03e-5];
        assert!(vehicle.checked().is_ok());
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
