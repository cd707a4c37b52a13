//! What belongs to the simulation and not to the vehicle: noise, pack, clock, home, start, floor.

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
    /// Which autopilot the vehicle behaves as.
    pub autopilot: Autopilot,
    /// The vehicle never notices that it has landed, as in strong wind: it stays armed.
    pub landing_goes_unnoticed: bool,
    /// Where on earth the local frame's origin is.
    pub home: Home,
    /// Where the vehicle begins.
    pub start: Start,
    /// Down coordinate of the floor in m.
    pub floor_down_m: f64,
    /// The pack.
    pub battery: BatteryConfig,
    /// Noise and bias.
    pub sensors: SensorConfig,
    /// Lines of the rotors in gyro and accelerometer.
    pub vibration: Vibration,
    /// Errors of the position estimate beyond noise.
    pub estimator: EstimatorConfig,
    /// How the vehicle's clock runs.
    pub clock: ClockConfig,
    /// Parameters of the autopilot that differ from its defaults, by name.
    pub parameters: BTreeMap<String, f64>,
}

/// What the rotors shake gyro and accelerometer by: a sine for each rotor at its speed, with the
/// same amplitude about or along every axis and another phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vibration {
    /// Turns of a rotor at full speed, Hz.
    pub rotor_max_hz: f64,
    /// Amplitude of each rotor in the gyro, rad/s.
    pub gyro_rad_s: f64,
    /// Amplitude of each rotor in the accelerometer, m/s^2.
    pub accelerometer_m_s2: f64,
}

/// Errors of the estimated position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Standard deviation of a slow wander, per axis, m; it begins at zero.
    pub wander_m: f64,
    /// Time constant of the wander, s.
    pub wander_time_s: f64,
    /// Standard deviation per axis of a slow error of the velocity that the position has no part
    /// in, m/s: an estimator that corrects its position does not say so in its velocity.
    pub velocity_wander_m_s: f64,
    /// Time constant of that, s.
    pub velocity_wander_time_s: f64,
    /// Time after switching on from which the position is known, s.
    pub ready_after_s: f64,
    /// The position comes from VISION_POSITION_ESTIMATE or ODOMETRY alone: none is known before the
    /// first, nor long after the last.
    pub from_vision: bool,
    /// GPS that is wrong for a while.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gps_glitch: Option<GpsGlitch>,
    /// How long GPS that contradicts the estimate is rejected before the estimate goes over to it, s.
    pub reset_after_s: f64,
    /// Time constant with which the estimate slides over to GPS that is right again, without a word
    /// of it in its velocity, as ArduCopter's was seen to, s; 0 is a jump there too.
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

/// GPS that is wrong by an offset for a while.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GpsGlitch {
    /// Vehicle time at which it begins, s.
    pub at_s: f64,
    /// How long it lasts, s.
    pub for_s: f64,
    /// North, east, down, m.
    pub offset_m: [f64; 3],
}

/// How the vehicle's clock runs against the host's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClockConfig {
    /// Vehicle seconds in a second.
    pub rate: f64,
    /// Moments in which the simulation stands still.
    pub stalls: Vec<Stall>,
}

/// A moment in which the simulation stands still.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stall {
    /// Vehicle time, s.
    pub at_s: f64,
    /// Host time that passes, s.
    pub for_s: f64,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self { rate: 1.0, stalls: Vec::new() }
    }
}

/// The autopilot that the vehicle behaves as, on the wire and in the air.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Autopilot {
    /// PX4's protocol, with a PD on attitude and rates together.
    #[default]
    Bundled,
    /// PX4.
    Px4,
    /// ArduCopter.
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

/// Standard deviations, per axis. The defaults are motion capture and a small MEMS IMU.
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
    /// The gyro.
    pub gyro: ImuNoise,
    /// The accelerometer.
    pub accelerometer: ImuNoise,
}

/// Noise of a gyro [rad/s] or an accelerometer [m/s^2].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuNoise {
    /// White noise of a sample.
    pub noise: f64,
    /// Bias drawn once for a flight.
    pub bias: f64,
    /// Walk of the bias in a second, per square root of second.
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
    /// Correlation time of the attitude's error where nothing else is said, s.
    pub const ATTITUDE_CORRELATION_S: f64 = 0.05;

    /// Perfect sensors.
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
        /// What the parser found and where.
        message: String,
    },
    /// A value is impossible.
    #[error("SITL configuration: {field}: expected {expected}, found {found}")]
    Value {
        /// Path of the field.
        field: &'static str,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: f64,
    },
}

impl SitlConfig {
    /// Reads and checks a TOML file.
    ///
    /// # Errors
    /// A file that cannot be read, does not follow the schema, or holds impossible values.
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

    /// A configuration from TOML text.
    ///
    /// # Errors
    /// As [`SitlConfig::load`], naming no file.
    pub fn from_toml_str(text: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text).map_err(|error| ConfigError::Syntax {
            path: PathBuf::from("(text)"),
            message: error.to_string(),
        })?;
        config.checked()
    }

    /// What of it the plant begins with.
    pub fn plant(&self) -> Setup {
        Setup { start: self.start, floor_down_m: self.floor_down_m, battery: self.battery }
    }

    fn checked(self) -> Result<Self, ConfigError> {
        let require = |field, found: f64, holds: bool, expected| {
            let right = found.is_finite() && holds;
            if right { Ok(()) } else { Err(ConfigError::Value { field, expected, found }) }
        };
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
        let Vibration { rotor_max_hz, gyro_rad_s, accelerometer_m_s2 } = self.vibration;
        for (field, value) in [
            ("vibration.rotor_max_hz", rotor_max_hz),
            ("vibration.gyro_rad_s", gyro_rad_s),
            ("vibration.accelerometer_m_s2", accelerometer_m_s2),
        ] {
            require(field, value, value >= 0.0, "0 or more")?;
        }
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
        let ClockConfig { rate, stalls } = &self.clock;
        let expected = "vehicle seconds a second in 0.5..=2";
        require("clock.rate", *rate, (0.5..=2.0).contains(rate), expected)?;
        for Stall { at_s, for_s } in stalls {
            require("clock.stalls.at_s", *at_s, *at_s >= 0.0, "0 or more s")?;
            // The server lets go of real time when it is a second behind.
            let expected = "a time in 0..=0.9 s";
            require("clock.stalls.for_s", *for_s, (0.0..=0.9).contains(for_s), expected)?;
        }
        let BatteryConfig { capacity_mah, resistance_ohm, charge } = self.battery;
        if let Some(mah) = capacity_mah {
            require("battery.capacity_mah", mah, mah > 0.0, "a capacity above 0 mAh")?;
        }
        if let Some(ohm) = resistance_ohm {
            require("battery.resistance_ohm", ohm, ohm >= 0.0, "a resistance of 0 or more ohm")?;
        }
        require("battery.charge", charge, (0.0..=1.0).contains(&charge), "a charge in 0..=1")?;
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
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_file_is_the_default() {
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
