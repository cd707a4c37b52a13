//! What is known about the vehicle besides its state.

use std::time::Duration;

use message::{Battery, Inbound, LandedState, SystemState};

use crate::clock::HostTime;
use crate::link::received::Received;
use crate::parameters::Parameters;

/// The content of the vehicle's slow messages, newest values.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleStatus {
    /// When the newest message of any kind arrived.
    pub last_received: Option<HostTime>,
    /// Whether the motors are armed; `None` before the first heartbeat.
    pub armed: Option<bool>,
    /// When HEARTBEAT last reported `armed`; `None` where that report may be outdated.
    pub armed_reported: Option<HostTime>,
    /// When the motors were last stopped.
    pub disarmed: Option<HostTime>,
    /// Present mode, from HEARTBEAT or CURRENT_MODE, whichever is newer.
    pub mode: Option<u32>,
    /// Since when the mode is known.
    pub mode_since: Option<HostTime>,
    /// When the vehicle last reported its mode; `None` where that report may be outdated.
    pub mode_reported: Option<HostTime>,
    /// When the present mode last changed.
    pub mode_changed: Option<HostTime>,
    /// The mode that was last requested of the vehicle; only CURRENT_MODE reports it.
    pub intended_mode: Option<u32>,
    /// On the ground or in the air.
    pub landed: LandedState,
    /// The pack's charge and voltage.
    pub battery: Battery,
    /// MAV_SYS_STATUS_SENSOR bits that are enabled but not healthy.
    pub unhealthy: u32,
    /// Whether SYS_STATUS calls the position estimate healthy. `None` if it never did, or not since
    /// the estimate was last out of use.
    pub position_healthy: Option<bool>,
    /// The vehicle's overall state from HEARTBEAT.
    pub system: SystemState,
    /// The newest text that declares a failsafe which the vehicle has not cleared since, and its
    /// arrival.
    pub failsafe: Option<(HostTime, String)>,
    /// The parameters read so far, by name.
    pub parameters: Parameters,
    /// The newest text of severity warning or worse, and its arrival.
    pub warning: Option<(HostTime, String)>,
    /// When the vehicle's last silence ended.
    silence_ended: Option<HostTime>,
}

impl Default for VehicleStatus {
    fn default() -> Self {
        Self {
            last_received: None,
            armed: None,
            armed_reported: None,
            disarmed: None,
            mode: None,
            mode_since: None,
            mode_reported: None,
            mode_changed: None,
            intended_mode: None,
            landed: LandedState::Undefined,
            battery: Battery::default(),
            unhealthy: 0,
            position_healthy: None,
            system: SystemState::Unknown,
            failsafe: None,
            parameters: Parameters::default(),
            warning: None,
            silence_ended: None,
        }
    }
}

/// Silence of the whole vehicle that may hide a mode change.
const SILENCE: Duration = Duration::from_millis(500);
/// HEARTBEAT reports the mode once a second, and two in a row may be lost.
const MODE_AGE_MAX: Duration = Duration::from_millis(2500);
/// PX4 returns to the mode chosen before arming when it disarms. CURRENT_MODE reports the mode up
/// to a second before HEARTBEAT reports that the motors stopped.
const RETURN_AHEAD: Duration = Duration::from_secs(2);
/// Where HEARTBEAT is first, the next CURRENT_MODE follows within this time.
const RETURN_AFTER: Duration = Duration::from_millis(800);

/// MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL. PX4 uses it for its local position estimate, and sets
/// it as enabled wherever the estimate is unhealthy. ArduCopter uses it for its position
/// controller: healthy and enabled while that runs, neither while Guided obeys setpoints, which
/// says nothing about the position. If the position is lost, ArduCopter's own EKF failsafe leaves
/// Guided.
const POSITION: u32 = 0x4000;

/// MAV_SEVERITY_WARNING; smaller numbers are worse.
const WARNING: u8 = 4;

impl VehicleStatus {
    /// Time since the last message, s; infinite before the first.
    pub fn silence_s(&self, now: HostTime) -> f64 {
        self.last_received.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64())
    }

    /// Takes the content of a message.
    pub(super) fn update(&mut self, received: &Received) {
        let now = received.host;
        match received.message {
            Inbound::DoubtfulMode => return self.doubt_mode(),
            Inbound::DoubtfulArming => {
                self.armed_reported = None;
                return self.doubt_mode();
            }
            _ => {}
        }
        if self.last_received.is_none_or(|at| now.since(at) > SILENCE) {
            self.silence_ended = Some(now);
        }
        self.last_received = Some(now);
        match &received.message {
            Inbound::Heartbeat { armed, custom_mode, system, .. } => {
                if self.armed == Some(true) && !armed {
                    self.disarmed = Some(now);
                }
                (self.armed, self.armed_reported) = (Some(*armed), Some(now));
                self.system = *system;
                self.update_mode(now, *custom_mode);
            }
            Inbound::CurrentMode { custom_mode, intended_custom_mode } => {
                self.update_mode(now, *custom_mode);
                self.intended_mode = Some(*intended_custom_mode);
            }
            Inbound::LandedState(landed) => self.landed = *landed,
            Inbound::Battery(battery) => self.battery = *battery,
            Inbound::SysStatus { unhealthy, health, enabled } => {
                self.unhealthy = *unhealthy;
                self.position_healthy = match (health & POSITION != 0, enabled & POSITION != 0) {
                    (true, _) => Some(true),
                    (false, true) => self.position_healthy.map(|_| false),
                    (false, false) => None,
                };
            }
            Inbound::Parameter { name, value } => {
                self.parameters.set(name.clone(), *value);
            }
            Inbound::StatusText { severity, text } => {
                let text = text.trim();
                if *severity <= WARNING {
                    self.warning = Some((now, text.to_owned()));
                }
                self.update_failsafe(now, text);
            }
            _ => {}
        }
    }

    fn update_mode(&mut self, now: HostTime, mode: u32) {
        if self.mode != Some(mode) {
            self.mode_changed = Some(now);
        }
        (self.mode, self.mode_reported) = (Some(mode), Some(now));
        self.mode_since.get_or_insert(now);
    }

    /// Both autopilots use the word "failsafe" when one begins and when it ends.
    fn update_failsafe(&mut self, now: HostTime, text: &str) {
        let lower = text.to_lowercase();
        if !lower.contains("failsafe") {
            return;
        }
        let is_over = ["clear", "resolved", "deactivated"].iter().any(|over| lower.contains(over));
        self.failsafe = (!is_over).then(|| (now, text.to_owned()));
    }

    /// Whether the present mode is known: reported recently, and since the last silence ended. The
    /// pilot may have changed an older one. A mode says nothing while it is doubtful whether the
    /// motors are armed.
    pub fn is_mode_known(&self, now: HostTime) -> bool {
        let is_arming_doubtful = self.armed.is_some() && self.armed_reported.is_none();
        !is_arming_doubtful
            && self.mode_reported.is_some_and(|reported| now.since(reported) <= MODE_AGE_MAX)
            && self.is_mode_newer_than_silence()
            && self.is_live(now)
    }

    /// Whether the mode was reported since the last silence ended.
    pub fn is_mode_newer_than_silence(&self) -> bool {
        self.mode_reported
            .is_some_and(|reported| self.silence_ended.is_none_or(|end| reported >= end))
    }

    /// Whether the last reported mode may be outdated, and none has been reported since.
    pub fn is_mode_doubtful(&self) -> bool {
        self.mode.is_some() && self.mode_reported.is_none()
    }

    /// Whether a message arrived within the last half second.
    pub fn is_live(&self, now: HostTime) -> bool {
        self.last_received.is_some_and(|at| now.since(at) <= SILENCE)
    }

    /// Whether the present mode came with the stop of the motors: the autopilot's own return to an
    /// earlier mode, not an act of the pilot.
    pub fn mode_changed_with_disarming(&self) -> bool {
        let (Some(disarmed), Some(changed)) = (self.disarmed, self.mode_changed) else {
            return false;
        };
        disarmed.since(changed) <= RETURN_AHEAD && changed.since(disarmed) <= RETURN_AFTER
    }

    /// The failsafe that the vehicle has declared since `since`, in its own words where it has
    /// some; `None` where there is none.
    pub fn failsafe_since(&self, since: HostTime) -> Option<&str> {
        match &self.failsafe {
            Some((at, text)) if *at >= since => Some(text),
            _ => self.system.is_failsafe().then_some(""),
        }
    }

    /// Marks the last reported mode as possibly outdated: nothing is commanded on it.
    pub(super) fn doubt_mode(&mut self) {
        self.mode_reported = None;
    }

    /// Forgets what may have changed during a silence.
    pub(super) fn forget_mode(&mut self) {
        (self.mode, self.intended_mode, self.armed) = (None, None, None);
        (self.mode_reported, self.armed_reported) = (None, None);
        self.mode_since = None;
        self.landed = LandedState::Undefined;
    }
}
