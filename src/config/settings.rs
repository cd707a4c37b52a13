//! All settings, with their defaults.

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

/// All settings. Each section has the settings of the module that it is named after.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Version of this schema.
    pub schema_version: u32,
    /// Vehicle file.
    pub vehicle: Option<PathBuf>,
    /// Trajectory file to fly.
    pub trajectory: Option<PathBuf>,
    /// Endpoint of the vehicle, such as `udpin://0.0.0.0:14540`.
    pub connect: Option<String>,
    /// Folder of the flight logs.
    pub log_dir: Option<PathBuf>,
    /// The link to the vehicle.
    pub link: LinkSettings,
    /// Other ground stations.
    pub forward: ForwardSettings,
    /// The bridge from a motion-capture room.
    pub mocap: MocapSettings,
    /// The monitor of the vehicle's health.
    pub health: HealthSettings,
    /// Learning in flight.
    pub learn: LearnSettings,
    /// The limits that a trajectory must keep.
    pub envelope: FlightEnvelope,
    /// Flights for learning a model.
    pub collect: ProgrammeSettings,
    /// Plans made with a learned model.
    pub plan: PlanSettings,
    /// The control law and its gains. Its rate is the rate of the control ticks.
    pub control: ControlSettings,
    /// Telemetry, flight states, reactions to faults, take-off, setpoint limits.
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

/// Settings of the health monitor, which warns and does nothing else.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HealthSettings {
    /// Whether the monitor runs.
    pub monitor: bool,
    /// Mean time between false alarms that sets its bound, h of flight.
    pub false_alarm_h: f64,
}

impl Default for HealthSettings {
    fn default() -> Self {
        Self { monitor: true, false_alarm_h: 1000.0 }
    }
}

/// Settings of `--learn`.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnSettings {
    /// Duration of learning in simulated flights, s. Real flights take the actual time.
    pub simulated_latency_s: f64,
}

impl Default for LearnSettings {
    fn default() -> Self {
        Self { simulated_latency_s: 1.0 }
    }
}

/// Settings of the link.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkSettings {
    /// Own MAVLink system id. Ground stations use 255 by convention. With that id, this program
    /// would keep ArduCopter from noticing the loss of the pilot's station.
    pub system: u8,
    /// Own MAVLink component id.
    pub component: u8,
    /// The vehicle's system id; without it, the first autopilot that appears is the vehicle.
    pub vehicle_system: Option<u8>,
    /// The content of the setpoints.
    pub attitude_target: FormSetting,
    /// Whether to answer the vehicle's TIMESYNC requests.
    pub answer_timesync: bool,
    /// Silence after which the link is stale, s.
    pub stale_after_s: f64,
    /// Silence after which the vehicle is lost, s.
    pub lost_after_s: f64,
    /// MAVLink 2 signing.
    pub signing: SigningSettings,
    /// Time without any vehicle after which `fly` gives up, s.
    pub search_timeout_s: f64,
}

/// Signing of the link. Without a key, here or in `DOWNWASH_SIGNING_KEY`, nothing is signed and all
/// frames are accepted.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SigningSettings {
    /// File of the key, with mode 0600.
    pub key_file: Option<PathBuf>,
    /// Own link id: programs that sign with the same system and component use different ones.
    pub link_id: u8,
    /// File of the stamps that must not be used again; by default the key's file name with
    /// `.stamps`.
    pub state_file: Option<PathBuf>,
    /// Names of the messages that are accepted without a signature.
    pub accept_unsigned: Vec<String>,
    /// Stamps further ahead of this computer's clock are rejected, s.
    pub ahead_max_s: f64,
}

impl Default for SigningSettings {
    fn default() -> Self {
        Self {
            key_file: None,
            link_id: 0,
            state_file: None,
            // A radio's own messages; a radio has no key.
            accept_unsigned: vec!["RADIO_STATUS".to_owned()],
            ahead_max_s: 86_400.0,
        }
    }
}

/// The content of SET_ATTITUDE_TARGET.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FormSetting {
    /// As in the autopilot's profile: the safe form for it.
    Profile,
    /// Rates and thrust, with the attitude loop closed by the controller.
    RatesThrust,
    /// Attitude, rates and thrust, for a vehicle that flies them as a PD law without declaring it.
    /// Unsafe on PX4.
    ForceAttitudeRatesThrust,
    /// On ArduCopter attitude, rates and thrust, with the rates rotated back by the commanded
    /// attitude.
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
            learn: LearnSettings::default(),
            envelope: FlightEnvelope::default(),
            collect: ProgrammeSettings::default(),
            plan: PlanSettings::default(),
            control: ControlSettings::default(),
            offboard: OffboardSettings::default(),
        }
    }
}
