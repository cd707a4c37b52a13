//! How the vehicle is controlled: the law, its rate, its acceptable errors and its gains.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::Ned;

use super::{DesignError, Law, LawSpec};
use crate::control::adaptation::AdaptationSettings;
use crate::control::disturbance::Use;

/// Gains of the active law, by name. A law derives the missing ones from the vehicle.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Gains(BTreeMap<String, Vec<f64>>);

impl Gains {
    /// The values of a gain, if it is set with `N` values.
    pub fn get<const N: usize>(&self, name: &str) -> Option<[f64; N]> {
        self.0.get(name).and_then(|values| values.as_slice().try_into().ok())
    }

    /// Sets a gain; the design checks it.
    pub fn set(&mut self, name: &str, values: &[f64]) {
        self.0.insert(name.to_owned(), values.to_vec());
    }

    /// Whether these are gains of a law, each with its number of positive values.
    pub(super) fn check(&self, spec: &LawSpec) -> Result<(), DesignError> {
        let own =
            || spec.gains.iter().filter_map(|gain| Some((gain.key.strip_prefix("gains.")?, gain)));
        for (name, values) in &self.0 {
            let Some((_, gain)) = own().find(|(own, _)| own == name) else {
                let names: Vec<&str> = own().map(|(name, _)| name).collect();
                let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
                return Err(DesignError::UnknownGain { law: spec.id, name: name.clone(), known });
            };
            if values.len() != gain.values {
                let (quantity, expected) = (gain.key, gain.values);
                return Err(DesignError::Values { quantity, expected, found: values.len() });
            }
            if let Some(&found) = values.iter().find(|value| !(**value > 0.0 && value.is_finite()))
            {
                return Err(DesignError::NotPositive { quantity: gain.key, found });
            }
        }
        Ok(())
    }
}

/// How the vehicle is controlled. The acceptable errors set the LQR's weights by Bryson's rule:
/// each weight is 1 / (acceptable deviation)^2. Other laws derive their bandwidth from that LQR.
/// Thrust is in units of hover thrust and everything else is kinematic, so one set flies a 30 g
/// nano and a 1.2 kg quadrotor.
///
/// The defaults weigh velocity, attitude and body rate very little: the attitude loop holds the
/// last two, and their feedback excites its resonance with the rotors' lag after the link's delay.
/// [`Lqr::design_for`](super::Lqr::design_for) lowers the gains further where lag and delay are
/// known; where they are not, the defaults fly with 30 ms of delay and 60 ms of lag.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControlSettings {
    /// The law that flies.
    #[schemars(with = "String")]
    pub law: Law,
    /// Rate of the feedback, Hz.
    pub rate_hz: f64,
    /// Acceptable position error north, east, down in axes turned by yaw, m.
    pub position_m: [f64; 3],
    /// Acceptable velocity error in the same axes, m/s.
    pub velocity_m_s: [f64; 3],
    /// Acceptable error of roll, pitch and yaw, rad.
    pub attitude_rad: [f64; 3],
    /// Acceptable error of the body rate, rad/s.
    pub body_rate_rad_s: [f64; 3],
    /// Acceptable thrust correction, as a fraction of hover thrust.
    pub thrust: f64,
    /// Acceptable correction of the desired roll, pitch and yaw, rad.
    pub attitude_command_rad: [f64; 3],
    /// Acceptable correction of the desired body rate, rad/s.
    pub body_rate_command_rad_s: [f64; 3],
    /// Natural frequency of the vehicle's own attitude loop about roll, pitch and yaw, taken to be
    /// critically damped, rad/s. For a vehicle that takes attitude and thrust and whose file has no
    /// gains; unset, the slowest response expected of its autopilot applies.
    pub attitude_response_rad_s: Option<[f64; 3]>,
    /// Whether the LQR corrects roll and pitch by more than `attitude_command_rad` where the loop's
    /// margin allows it: an autopilot's own loop is slower than the paper's, and the lag of the
    /// feedback turns a wandering estimate into motion.
    // `for_loop` resolves `Use::Auto`.
    pub quicken: Use,
    /// Smallest distance of the opened loop from -1 that `quicken` keeps, 0..1.
    pub margin_min: f64,
    /// Largest horizontal position error that the feedback sees, m: the vehicle approaches a
    /// distant reference at a bounded speed.
    pub horizontal_error_max_m: f64,
    /// Largest vertical position error that the feedback sees, m.
    pub vertical_error_max_m: f64,
    /// Whether the physics' parameters are adapted in flight, around any law. Off, the feedback is
    /// the law's, plus that of `offboard.offset_free.observer` where that is on.
    pub adaptive: bool,
    /// Speed and bounds of the adaptation.
    pub adaptation: AdaptationSettings,
    /// The law's own gains.
    pub gains: Gains,
}

impl Default for ControlSettings {
    fn default() -> Self {
        Self {
            law: Law::LQR,
            rate_hz: 100.0,
            position_m: [0.3, 0.3, 0.2],
            velocity_m_s: [3.0, 3.0, 1.0],
            attitude_rad: [5.0, 5.0, 2.0],
            body_rate_rad_s: [50.0, 50.0, 20.0],
            thrust: 0.35,
            attitude_command_rad: [0.25, 0.25, 0.3],
            body_rate_command_rad_s: [0.05, 0.05, 0.05],
            attitude_response_rad_s: None,
            quicken: Use::Auto,
            margin_min: 0.6,
            horizontal_error_max_m: 1.0,
            vertical_error_max_m: 0.6,
            adaptive: false,
            adaptation: AdaptationSettings::default(),
            gains: Gains::default(),
        }
    }
}

impl ControlSettings {
    /// Resolves `quicken`'s `auto`: on for a loop whose parameters were read from its autopilot.
    /// Too little is known of any other.
    pub fn for_loop(&self, is_read: bool) -> Self {
        let quicken = if self.quicken.applies(is_read) { Use::On } else { Use::Off };
        Self { quicken, ..self.clone() }
    }
}

/// The largest position error that a law sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    horizontal_m: f64,
    vertical_m: f64,
}

impl From<&ControlSettings> for Reach {
    fn from(settings: &ControlSettings) -> Self {
        Self {
            horizontal_m: settings.horizontal_error_max_m,
            vertical_m: settings.vertical_error_max_m,
        }
    }
}

impl Reach {
    /// The position error with its horizontal part and its height bounded, and whether a bound
    /// applied.
    pub fn bounded(&self, error: Ned) -> (Ned, bool) {
        let horizontal = (error.north().powi(2) + error.east().powi(2)).sqrt();
        let scale = (self.horizontal_m / horizontal).min(1.0);
        let down = error.down().clamp(-self.vertical_m, self.vertical_m);
        let bounded = if scale < 1.0 {
            Ned::new(error.north() * scale, error.east() * scale, down)
        } else {
            Ned::new(error.north(), error.east(), down)
        };
        (bounded, scale < 1.0 || down != error.down())
    }
}
