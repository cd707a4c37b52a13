//! Settings of the simulation, as opposed to the vehicle: noise, pack, clock, home, start, floor.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use vehicle::bounded;
use vehicle::plant::Setup;

pub use vehicle::battery::BatteryConfig;
pub use vehicle::plant::Start;

/// Settings of the simulated vehicle; every key has a default, any other key is refused.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SitlConfig {
    /// The autopilot that the vehicle simulates.
    pub autopilot: Autopilot,
    /// The vehicle never detects that it has landed, as in strong wind, and stays armed.
    pub landing_goes_unnoticed: bool,
    /// Geodetic position of the local frame's origin.
    pub home: Home,
    /// Position and heading of the vehicle at the start.
    pub start: Start,
    /// Down coordinate of the floor in m.
    pub floor_down_m: f64,
    /// Capacity, resistance and initial charge of the pack.
    pub battery: BatteryConfig,
    /// Noise and bias of the sensors.
    pub sensors: SensorConfig,
    /// Vibration of the rotors in gyro and accelerometer.
    pub vibration: Vibration,
    /// Errors of the position and velocity estimate beyond noise.
    pub estimator: EstimatorConfig,
    /// Rate and stalls of the vehicle's clock.
    pub clock: ClockConfig,
    /// Autopilot parameters that differ from their defaults, by name.
    pub parameters: BTreeMap<String, f64>,
}

/// Vibration of the rotors in gyro and accelerometer: a sine for each rotor at its speed, with the
/// same amplitude on every axis and a different phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vibration {
    /// Rotation frequency of a rotor at full speed, Hz.
    pub rotor_max_hz: f64,
    /// Amplitude of each rotor in the gyro, rad/s.
    pub gyro_rad_s: f64,
    /// Amplitude of each rotor in the accelerometer, m/s^2.
    pub accelerometer_m_s2: f64,
}

/// Errors of the estimated position and velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Standard deviation of a slow drift of the position on each axis, m; it starts at zero.
    pub wander_m: f64,
    /// Time constant of the position's drift, s.
    pub wander_time_s: f64,
    /// Standard deviation on each axis of a slow velocity error without a matching position error,
    /// m/s: an estimator that corrects its position does not show it in its velocity.
    pub velocity_wander_m_s: f64,
    /// Time constant of the velocity's drift, s.
    pub velocity_wander_time_s: f64,
    /// Time after power-on from which the position is known, s.
    pub ready_after_s: f64,
    /// The position comes from VISION_POSITION_ESTIMATE or ODOMETRY only. It is unknown before the
    /// first message and soon after the last.
    pub from_vision: bool,
    /// A temporary GPS error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gps_glitch: Option<GpsGlitch>,
    /// Time for which the estimator rejects contradicting GPS before it resets to it, s.
    pub reset_after_s: f64,
    /// Time constant with which the estimate slides back to correct GPS, s. The velocity does not
    /// show it, as observed on ArduCopter. With 0 the estimate jumps back as well.
    pub slide_time_s: f64,
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self {
            wander_m: 0.0,
            wander_time_s: 5.0,
            velocity_wander_m_s: 0.0,
            velocity_wander_time_s: 3.0,
            ready_after_s: 0.0,
            from_vision: false,
            gps_glitch: None,
            reset_after_s: 9.0,
            slide_time_s: 0.0,
        }
    }
}

/// A GPS error: a constant offset for a limited time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GpsGlitch {
    /// Vehicle time of its start, s.
    pub at_s: f64,
    /// Duration, s.
    pub for_s: f64,
    /// Offset north, east, down, m.
    pub offset_m: [f64; 3],
}

/// The vehicle's clock relative to the host's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClockConfig {
    /// Vehicle seconds per host second.
    pub rate: f64,
    /// Stalls of the simulation.
    pub stalls: Vec<Stall>,
}

/// A stall of the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stall {
    /// Vehicle time of the stall, s.
    pub at_s: f64,
    /// Host time that passes during the stall, s.
    pub for_s: f64,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self { rate: 1.0, stalls: Vec::new() }
    }
}

/// The autopilot that the vehicle simulates, on the wire and in flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Autopilot {
    /// PX4's protocol, with a PD law on attitude and rates.
    #[default]
    Bundled,
    /// PX4, with its attitude and rate cascade.
    Px4,
    /// ArduCopter, with its attitude and rate cascade.
    Arducopter,
}

/// Geodetic position of the local frame's origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Home {
    /// Latitude in degrees, WGS 84.
    pub latitude_deg: f64,
    /// Longitude in degrees, WGS 84.
    pub longitude_deg: f64,
    /// Altitude above mean sea level in m.
    pub altitude_m: f64,
}

impl Default for Home {
    fn default() -> Self {
        Self { latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_m: 488.0 }
    }
}

/// Standard deviations for each axis. The defaults represent motion capture and a small MEMS IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorConfig {
    /// White noise of the position in m.
    pub position_noise_m: f64,
    /// White noise of the velocity in m/s.
    pub velocity_noise_m_s: f64,
    /// Error of the attitude about each body axis in rad.
    pub attitude_noise_rad: f64,
    /// Correlation time of the attitude's error in s.
    pub attitude_correlation_s: f64,
    /// Errors of the gyro, rad/s.
    pub gyro: ImuNoise,
    /// Errors of the accelerometer, m/s^2.
    pub accelerometer: ImuNoise,
}

/// Noise of a gyro (rad/s) or an accelerometer (m/s^2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuNoise {
    /// White noise of each sample.
    pub noise: f64,
    /// Standard deviation of the bias, drawn once per flight.
    pub bias: f64,
    /// Random walk of the bias, per square root of second.
    pub bias_walk: f64,
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            position_noise_m: 0.001,
            velocity_noise_m_s: 0.01,
            attitude_noise_rad: 0.001,
            attitude_correlation_s: Self::ATTITUDE_CORRELATION_S,
            gyro: ImuNoise { noise: 0.01, bias: 0.003, bias_walk: 0.0002 },
            accelerometer: ImuNoise { noise: 0.1, bias: 0.03, bias_walk: 0.002 },
        }
    }
}

impl SensorConfig {
    /// Default correlation time of the attitude's error, s.
    pub const ATTITUDE_CORRELATION_S: f64 = 0.05;

    /// Sensors without errors.
    pub const IDEAL: Self = Self {
        position_noise_m: 0.0,
        velocity_noise_m_s: 0.0,
        attitude_noise_rad: 0.0,
        attitude_correlation_s: Self::ATTITUDE_CORRELATION_S,
        gyro: ImuNoise { noise: 0.0, bias: 0.0, bias_walk: 0.0 },
        accelerometer: ImuNoise { noise: 0.0, bias: 0.0, bias_walk: 0.0 },
    };
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("SITL configuration {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML or does not follow the schema.
    #[error("SITL configuration {path}: {message}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// The parser's message with the position.
        message: String,
    },
    /// A value is impossible.
    #[error("SITL configuration: {field}: expected {expected}, found {found}")]
    Value {
        /// Path of the field.
        field: &'static str,
        /// The accepted values.
        expected: &'static str,
        /// The value found.
        found: f64,
    },
}

impl SitlConfig {
    /// Reads and checks a TOML file.
    ///
    /// # Errors
    /// The file cannot be read, violates the schema, or holds an impossible value.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, ConfigError> {
        let path = path.as_ref();
        let text = bounded::read_to_string(path, bounded::WRITTEN_MAX)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        Self::from_toml_str(&text).map_err(|error| match error {
            ConfigError::Syntax { message, .. } => {
                ConfigError::Syntax { path: path.to_owned(), message }
            }
            other => other,
        })
    }

    /// Parses and checks a configuration in TOML.
    ///
    /// # Errors
    /// The text violates the schema or holds an impossible value. The error names no file.
    pub fn from_toml_str(text: &str) -> Result<Self, ConfigError> {
        let config: Self = vehicle::from_toml(text).map_err(|error| ConfigError::Syntax {
            path: PathBuf::from("(text)"),
            message: error.to_string(),
        })?;
        config.checked()
    }

    /// The initial conditions of the plant.
    pub fn plant(&self) -> Setup {
        Setup { start: self.start, floor_down_m: self.floor_down_m, battery: self.battery }
    }

    fn checked(self) -> Result<Self, ConfigError> {
        self.check_place()?;
        self.check_vibration()?;
        self.check_estimator()?;
        self.check_clock()?;
        self.check_battery()?;
        self.check_sensors()?;
        Ok(self)
    }

    fn check_place(&self) -> Result<(), ConfigError> {
        let Home { latitude_deg, longitude_deg, altitude_m } = self.home;
        let on_earth = latitude_deg.abs() <= 90.0;
        require("home.latitude_deg", latitude_deg, on_earth, "degrees in -90..=90")?;
        let on_earth = longitude_deg.abs() <= 180.0;
        require("home.longitude_deg", longitude_deg, on_earth, "degrees in -180..=180")?;
        require("home.altitude_m", altitude_m, true, "a length in m")?;
        require("floor_down_m", self.floor_down_m, true, "a length in m")?;
        for coordinate in self.start.position_m {
            require("start.position_m", coordinate, true, "lengths in m")?;
        }
        let below = self.start.position_m[2];
        let above = below <= self.floor_down_m;
        require("start.position_m", below, above, "a down coordinate not below floor_down_m")?;
        require("start.heading_rad", self.start.heading_rad, true, "an angle in rad")?;
        Ok(())
    }

    fn check_vibration(&self) -> Result<(), ConfigError> {
        let Vibration { rotor_max_hz, gyro_rad_s, accelerometer_m_s2 } = self.vibration;
        for (field, value) in [
            ("vibration.rotor_max_hz", rotor_max_hz),
            ("vibration.gyro_rad_s", gyro_rad_s),
            ("vibration.accelerometer_m_s2", accelerometer_m_s2),
        ] {
            require(field, value, value >= 0.0, "0 or more")?;
        }
        Ok(())
    }

    fn check_estimator(&self) -> Result<(), ConfigError> {
        let EstimatorConfig {
            wander_m,
            wander_time_s,
            velocity_wander_m_s,
            velocity_wander_time_s,
            ready_after_s,
            from_vision: _,
            gps_glitch,
            reset_after_s,
            slide_time_s,
        } = self.estimator;
        for (field, deviation) in [
            ("estimator.wander_m", wander_m),
            ("estimator.velocity_wander_m_s", velocity_wander_m_s),
        ] {
            require(field, deviation, deviation >= 0.0, "0 or more")?;
        }
        let expected = "a time above 0.01 s";
        for (field, time) in [
            ("estimator.wander_time_s", wander_time_s),
            ("estimator.velocity_wander_time_s", velocity_wander_time_s),
        ] {
            require(field, time, time > 0.01, expected)?;
        }
        for (field, time) in [
            ("estimator.ready_after_s", ready_after_s),
            ("estimator.reset_after_s", reset_after_s),
            ("estimator.slide_time_s", slide_time_s),
        ] {
            require(field, time, time >= 0.0, "0 or more s")?;
        }
        if let Some(GpsGlitch { at_s, for_s, offset_m }) = gps_glitch {
            require("estimator.gps_glitch.at_s", at_s, at_s >= 0.0, "0 or more s")?;
            require("estimator.gps_glitch.for_s", for_s, for_s >= 0.0, "0 or more s")?;
            for offset in offset_m {
                require("estimator.gps_glitch.offset_m", offset, true, "lengths in m")?;
            }
        }
        Ok(())
    }

    fn check_clock(&self) -> Result<(), ConfigError> {
        let ClockConfig { rate, stalls } = &self.clock;
        let expected = "vehicle seconds a second in 0.5..=2";
        require("clock.rate", *rate, (0.5..=2.0).contains(rate), expected)?;
        for Stall { at_s, for_s } in stalls {
            require("clock.stalls.at_s", *at_s, *at_s >= 0.0, "0 or more s")?;
            // The server gives up real time when it lags by a second.
            let expected = "a time in 0..=0.9 s";
            require("clock.stalls.for_s", *for_s, (0.0..=0.9).contains(for_s), expected)?;
        }
        Ok(())
    }

    fn check_battery(&self) -> Result<(), ConfigError> {
        let BatteryConfig { capacity_mah, resistance_ohm, charge } = self.battery;
        if let Some(mah) = capacity_mah {
            require("battery.capacity_mah", mah, mah > 0.0, "a capacity above 0 mAh")?;
        }
        if let Some(ohm) = resistance_ohm {
            require("battery.resistance_ohm", ohm, ohm >= 0.0, "a resistance of 0 or more ohm")?;
        }
        require("battery.charge", charge, (0.0..=1.0).contains(&charge), "a charge in 0..=1")?;
        Ok(())
    }

    fn check_sensors(&self) -> Result<(), ConfigError> {
        let sensors = &self.sensors;
        for (field, value) in [
            ("sensors.position_noise_m", sensors.position_noise_m),
            ("sensors.velocity_noise_m_s", sensors.velocity_noise_m_s),
            ("sensors.attitude_noise_rad", sensors.attitude_noise_rad),
            ("sensors.attitude_correlation_s", sensors.attitude_correlation_s),
            ("sensors.gyro.noise", sensors.gyro.noise),
            ("sensors.gyro.bias", sensors.gyro.bias),
            ("sensors.gyro.bias_walk", sensors.gyro.bias_walk),
            ("sensors.accelerometer.noise", sensors.accelerometer.noise),
            ("sensors.accelerometer.bias", sensors.accelerometer.bias),
            ("sensors.accelerometer.bias_walk", sensors.accelerometer.bias_walk),
        ] {
            require(field, value, value >= 0.0, "0 or more")?;
        }
        Ok(())
    }
}

/// Checks that a value is finite and that its condition holds.
fn require(
    field: &'static str,
    found: f64,
    holds: bool,
    expected: &'static str,
) -> Result<(), ConfigError> {
    let right = found.is_finite() && holds;
    if right { Ok(()) } else { Err(ConfigError::Value { field, expected, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_file_gives_the_default() {
        assert_eq!(SitlConfig::from_toml_str("").unwrap(), SitlConfig::default());
    }

    #[test]
    fn unknown_keys_and_impossible_values_are_refused_by_name() {
        let message = |text: &str| SitlConfig::from_toml_str(text).unwrap_err().to_string();
        assert!(message("[sensors]\nposition_nose_m = 1").contains("position_nose_m"));
        assert!(message("[sensors]\nposition_noise_m = -1").contains("sensors.position_noise_m"));
        assert!(message("[battery]\ncharge = nan").contains("battery.charge"));
        assert!(message("[start]\nposition_m = [0, 0, 1]").contains("not below floor_down_m"));
    }
}
