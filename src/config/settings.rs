//! The settings, with their defaults.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::SCHEMA_VERSION;
use crate::control::ControlSettings;
use crate::mocap::settings::MocapSettings;
use crate::offboard::OffboardSettings;
use crate::plan::FlightEnvelope;
use crate::plan::planner::PlanSettings;
use crate::plan::programme::ProgrammeSettings;

/// Everything that can be set. Each section is the settings of the module that it is named after.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Version of this schema.
    pub schema_version: u32,
    /// Vehicle file.
    pub vehicle: Option<PathBuf>,
    /// Trajectory file that the daemon flies.
    pub trajectory: Option<PathBuf>,
    /// Endpoint of the vehicle, such as `udpin://0.0.0.0:14540`.
    pub connect: Option<String>,
    /// Folder of the flight logs.
    pub log_dir: Option<PathBuf>,
    /// The link.
    pub link: LinkSettings,
    /// Ground stations beside this one.
    pub forward: ForwardSettings,
    /// The bridge from a motion-capture room.
    pub mocap: MocapSettings,
    /// Whether the vehicle changes in flight.
    pub health: HealthSettings,
    /// What a trajectory may ask for.
    pub envelope: FlightEnvelope,
    /// Flights that a model is learned from.
    pub collect: ProgrammeSettings,
    /// Plans through a model.
    pub plan: PlanSettings,
    /// The control law and its gains. Its rate is that of the control ticks.
    pub control: ControlSettings,
    /// Telemetry, flight states, reactions to faults, take-off, limits of the setpoint.
    #[serde(alias = "pilot")]
    pub offboard: OffboardSettings,
}

/// Settings of `--forward`.
#[derive(Clone, Debug, Default, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ForwardSettings {
    /// Names of the messages that other ground stations may send to the vehicle.
    pub allow: Vec<String>,
}

/// Settings of the monitor of the vehicle's health. It warns, and does nothing else.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HealthSettings {
    /// Whether it watches.
    pub monitor: bool,
    /// Mean time between false alarms that its bound is for, h of flight.
    pub false_alarm_h: f64,
}

impl Default for HealthSettings {
    fn default() -> Self {
        Self { monitor: true, false_alarm_h: 1000.0 }
    }
}

/// Settings of the link.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkSettings {
    /// Own MAVLink system id. Ground stations are 255 by custom: a daemon with that id would keep
    /// ArduCopter from seeing that the pilot's station is gone.
    pub system: u8,
    /// Own MAVLink component id.
    pub component: u8,
    /// The vehicle's system id; none takes the first autopilot that is heard.
    pub vehicle_system: Option<u8>,
    /// What setpoints carry.
    pub attitude_target: FormSetting,
    /// Whether the vehicle's TIMESYNC requests are answered.
    pub answer_timesync: bool,
    /// Silence after which the link is stale, s.
    pub stale_after_s: f64,
    /// Silence after which the vehicle is lost, s.
    pub lost_after_s: f64,
    /// MAVLink 2 signing.
    pub signing: SigningSettings,
    /// `fly` gives up when no vehicle is heard for this long, s.
    pub search_timeout_s: f64,
}

/// Signing of the link. Without a key, here or in `DOWNWASH_SIGNING_KEY`, nothing is signed and
/// everybody is believed.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SigningSettings {
    /// File of the key, of mode 0600.
    pub key_file: Option<PathBuf>,
    /// Own number of the link: programs that sign with the same system and component take different
    /// ones.
    pub link_id: u8,
    /// File of the stamps that must not be used again; none takes the key's file with `.stamps`.
    pub state_file: Option<PathBuf>,
    /// Names of the messages that are believed without a signature.
    pub accept_unsigned: Vec<String>,
    /// Stamps further ahead of this computer's clock are not believed, s.
    pub ahead_max_s: f64,
}

impl Default for SigningSettings {
    fn default() -> Self {
        Self {
            key_file: None,
            link_id: 0,
            state_file: None,
            // What a radio says itself, which has no key.
            accept_unsigned: vec!["RADIO_STATUS".to_owned()],
            ahead_max_s: 86_400.0,
        }
    }
}

/// What SET_ATTITUDE_TARGET carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FormSetting {
    /// What the autopilot's profile says: the safe form for it.
    Profile,
    /// Rates and thrust, with the attitude loop closed by the daemon.
    RatesThrust,
    /// Attitude, rates and thrust, for a vehicle that flies them as a PD and cannot say so. Unsafe
    /// on PX4.
    ForceAttitudeRatesThrust,
    /// On ArduCopter attitude, rates and thrust, the rates turned back by the commanded attitude.
    ArducopterRates,
}

impl Default for LinkSettings {
    fn default() -> Self {
        Self {
            system: 254,
            component: 191,
            vehicle_system: None,
            attitude_target: FormSetting::Profile,
            answer_timesync: true,
            stale_after_s: 2.5,
            lost_after_s: 5.0,
            signing: SigningSettings::default(),
            search_timeout_s: 20.0,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            vehicle: None,
            trajectory: None,
            connect: None,
            log_dir: None,
            link: LinkSettings::default(),
            forward: ForwardSettings::default(),
            mocap: MocapSettings::default(),
            health: HealthSettings::default(),
            envelope: FlightEnvelope::default(),
            collect: ProgrammeSettings::default(),
            plan: PlanSettings::default(),
            control: ControlSettings::default(),
            offboard: OffboardSettings::default(),
        }
    }
}
