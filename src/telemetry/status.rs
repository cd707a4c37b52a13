//! What is known about the vehicle beside its state.

use std::collections::BTreeMap;

use crate::clock::HostTime;
use crate::link::message::{Inbound, LandedState, Received};

/// The pack, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Battery {
    /// V
    pub voltage: Option<f64>,
    /// A
    pub current: Option<f64>,
    /// 0..1
    pub remaining: Option<f64>,
}

/// The newest of each of the vehicle's slow messages.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleStatus {
    /// When the newest message of any kind came.
    pub heard: Option<HostTime>,
    /// Whether the motors are armed; `None` before the first heartbeat.
    pub armed: Option<bool>,
    /// Mode in force, of HEARTBEAT or CURRENT_MODE, whichever is newer.
    pub mode: Option<u32>,
    /// Since when the mode is known.
    pub mode_since: Option<HostTime>,
    /// The mode that was asked for last; only CURRENT_MODE says it.
    pub intended_mode: Option<u32>,
    /// On the ground or in the air.
    pub landed: LandedState,
    /// The pack.
    pub battery: Battery,
    /// MAV_SYS_STATUS_SENSOR bits that are enabled but not healthy.
    pub unhealthy: u32,
    /// Parameters that were read, by name.
    pub parameters: BTreeMap<String, f64>,
    /// The newest text of severity warning or worse, and when it came.
    pub warning: Option<(HostTime, String)>,
}

impl Default for VehicleStatus {
    fn default() -> Self {
        Self {
            heard: None,
            armed: None,
            mode: None,
            mode_since: None,
            intended_mode: None,
            landed: LandedState::Undefined,
            battery: Battery::default(),
            unhealthy: 0,
            parameters: BTreeMap::new(),
            warning: None,
        }
    }
}

/// MAV_SEVERITY_WARNING; smaller numbers are worse.
const WARNING: u8 = 4;

impl VehicleStatus {
    /// For how long nothing was heard, s; infinite before the first message.
    pub fn silence_s(&self, now: HostTime) -> f64 {
        self.heard.map_or(f64::INFINITY, |heard| now.since(heard).as_secs_f64())
    }

    /// Takes what the message says.
    pub(super) fn update(&mut self, received: &Received) {
        self.heard = Some(received.host);
        match &received.message {
            Inbound::Heartbeat { armed, custom_mode, .. } => {
                self.armed = Some(*armed);
                self.mode = Some(*custom_mode);
                self.mode_since.get_or_insert(received.host);
            }
            Inbound::CurrentMode { custom_mode, intended_custom_mode } => {
                self.mode = Some(*custom_mode);
                self.mode_since.get_or_insert(received.host);
                self.intended_mode = Some(*intended_custom_mode);
            }
            Inbound::LandedState(landed) => self.landed = *landed,
            Inbound::Battery { voltage, current, remaining } => {
                self.battery =
                    Battery { voltage: *voltage, current: *current, remaining: *remaining };
            }
            Inbound::SysStatus { unhealthy, .. } => self.unhealthy = *unhealthy,
            Inbound::Parameter { name, value } => {
                self.parameters.insert(name.clone(), *value);
            }
            Inbound::StatusText { severity, text } if *severity <= WARNING => {
                self.warning = Some((received.host, text.trim().to_owned()));
            }
            _ => {}
        }
    }

    /// Forgets what may have changed while nothing was heard.
    pub(super) fn forget_mode(&mut self) {
        (self.mode, self.intended_mode, self.armed) = (None, None, None);
        self.mode_since = None;
        self.landed = LandedState::Undefined;
    }
}
