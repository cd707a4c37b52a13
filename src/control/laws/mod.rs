//! Control laws: from state and reference to a setpoint. Each law has its own file, and [`LAWS`]
//! lists them all; every caller takes its law from there.

mod geometric;
mod geometric_adaptive;
mod l1;
mod lqr;
#[cfg(test)]
mod quad;

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use vehicle::frame::{Ned, wrap_angle};

pub use self::geometric::Geometric;
pub use self::lqr::Lqr;
use super::actuation::Actuation;
use super::adaptation::AdaptationSettings;
use super::attitude_loop::AttitudeLoop;
use super::disturbance::Use;
use super::hover_model::HoverVehicle;
use super::limits::Limits;
use super::riccati::RiccatiError;
use crate::setpoint::{Reference, Setpoint, State};

/// Every law that `control.law` can name.
pub const LAWS: [&LawSpec; 4] =
    [&lqr::SPEC, &geometric::SPEC, &l1::SPEC, &geometric_adaptive::SPEC];

/// A control law.
///
/// The vehicle's attitude loop, on board or closed by the link's encoder, tracks the setpoint that
/// a law returns. Its roll and pitch tilt the vehicle about its present heading; its yaw is the
/// heading to turn to. The thrust therefore points in the wanted direction while the vehicle still
/// turns. The controller around the law applies limits and rejects disturbances; a law does
/// neither.
pub trait ControlLaw: CloneLaw + fmt::Debug + Send + Sync {
    /// The setpoint that moves the vehicle from `state` to `reference`. `dt_s` is the time since
    /// the last call, s; 0 on the first call and after a [`reset`](Self::reset).
    fn command(&mut self, state: &State, reference: &Reference, dt_s: f64) -> Command;

    /// Clears the integrated state: the vehicle is on the ground, or something else flew it.
    fn reset(&mut self) {}
}

/// Cloning of boxed laws, implemented for every law that is [`Clone`]: each flight starts from a
/// copy of the designed law.
pub trait CloneLaw {
    /// A boxed copy of the law and its state.
    fn boxed(&self) -> Box<dyn ControlLaw>;
}

impl<L: ControlLaw + Clone + 'static> CloneLaw for L {
    fn boxed(&self) -> Box<dyn ControlLaw> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn ControlLaw> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// The output of a law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// `u_hat`, before any limit.
    pub setpoint: Setpoint,
    /// The setpoint less the reference's feed-forward.
    pub feedback: Setpoint,
    /// Whether the position error was cut before the law saw it.
    pub is_cut: bool,
}

impl Command {
    /// The reference's input plus `feedback`.
    pub fn correcting(reference: &Reference, feedback: Setpoint, is_cut: bool) -> Self {
        Self { setpoint: reference.feedforward.plus(feedback), feedback, is_cut }
    }

    /// `setpoint` itself, whatever the reference's input is; the feedback is their difference.
    pub fn absolute(reference: &Reference, setpoint: Setpoint, is_cut: bool) -> Self {
        let Setpoint { thrust_n, attitude, body_rate } = reference.feedforward;
        let mut feedback = setpoint;
        feedback.thrust_n -= thrust_n;
        feedback.attitude.roll -= attitude.roll;
        feedback.attitude.pitch -= attitude.pitch;
        feedback.attitude.yaw = wrap_angle(setpoint.attitude.yaw - attitude.yaw);
        feedback.body_rate = setpoint.body_rate - body_rate;
        Self { setpoint, feedback, is_cut }
    }
}

/// An entry of [`LAWS`].
#[derive(Debug)]
pub struct LawSpec {
    /// Its name in settings and flags.
    pub id: &'static str,
    /// A one-sentence description for people.
    pub summary: &'static str,
    /// The gains that can be set.
    pub gains: &'static [Gain],
    /// Designs the law for a vehicle.
    pub design: fn(&ControlProblem) -> Result<Box<dyn ControlLaw>, DesignError>,
}

/// A settable number of a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gain {
    /// Its key below `control`; keys that begin with `gains.` belong to one law alone.
    pub key: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Number of values.
    pub values: usize,
    /// Its effect.
    pub meaning: &'static str,
}

/// What a law is designed for.
#[derive(Clone, Copy, Debug)]
pub struct ControlProblem<'a> {
    /// Mass, inertia and gravity.
    pub vehicle: &'a HoverVehicle,
    /// The vehicle's command delay and rotor lag.
    pub actuation: &'a Actuation,
    /// The loop that tracks the attitude.
    pub attitude_loop: &'a AttitudeLoop,
    /// The limits applied to the setpoint after the law.
    pub limits: &'a Limits,
    /// Rate, acceptable errors and gains.
    pub settings: &'a ControlSettings,
}

/// The law in use: an entry of [`LAWS`], or a law of another crate. Laws are equal if their ids
/// are.
#[derive(Clone, Copy)]
pub struct Law(&'static LawSpec);

impl Law {
    /// The yaw-rotated LQR, the default.
    pub const LQR: Self = Self(&lqr::SPEC);
    /// The geometric tracking law.
    pub const GEOMETRIC: Self = Self(&geometric::SPEC);

    /// A law that need not be in [`LAWS`].
    pub const fn new(spec: &'static LawSpec) -> Self {
        Self(spec)
    }

    /// The listed law with this id.
    pub fn named(id: &str) -> Option<Self> {
        LAWS.into_iter().find(|spec| spec.id == id).map(Self)
    }

    /// Its name, description, gains and design function.
    pub fn spec(self) -> &'static LawSpec {
        self.0
    }

    /// Designs the law for a vehicle, with the gains of `control.gains` where these are set.
    ///
    /// # Errors
    /// [`DesignError`] if a gain is not one of the law's, has the wrong number of values or is not
    /// positive, or if the design fails.
    pub fn design(self, problem: &ControlProblem) -> Result<Box<dyn ControlLaw>, DesignError> {
        problem.settings.gains.check(self.0)?;
        (self.0.design)(problem)
    }
}

impl Default for Law {
    fn default() -> Self {
        Self::LQR
    }
}

impl PartialEq for Law {
    fn eq(&self, other: &Self) -> bool {
        self.0.id == other.0.id
    }
}

impl fmt::Debug for Law {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Law({})", self.0.id)
    }
}

impl fmt::Display for Law {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.id)
    }
}

impl Serialize for Law {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0.id)
    }
}

impl<'de> Deserialize<'de> for Law {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let id = String::deserialize(deserializer)?;
        Self::named(&id).ok_or_else(|| {
            let known = LAWS.map(|spec| spec.id).join(", ");
            serde::de::Error::custom(format!("expected a control law ({known}), found {id:?}"))
        })
    }
}

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

    fn check(&self, spec: &LawSpec) -> Result<(), DesignError> {
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
/// [`Lqr::design_for`] lowers the gains further where lag and delay are known; where they are not,
/// the defaults fly with 30 ms of delay and 60 ms of lag.
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

/// Why a law cannot be designed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// A number that must be positive is not.
    #[error("controller design: {quantity} is {found}, expected a positive finite number")]
    NotPositive {
        /// The quantity.
        quantity: &'static str,
        /// Its value.
        found: f64,
    },
    /// A gain has too few or too many values.
    #[error("controller design: control.{quantity} has {found} values, expected {expected}")]
    Values {
        /// The gain.
        quantity: &'static str,
        /// Number of values that the gain takes.
        expected: usize,
        /// Number of values found.
        found: usize,
    },
    /// The law has no such gain.
    #[error(
        "controller design: control.gains.{name} is not a gain of the law {law}, which has: {known}"
    )]
    UnknownGain {
        /// The law.
        law: &'static str,
        /// The name that was set.
        name: String,
        /// The names of the law's gains.
        known: String,
    },
    /// The Riccati equation has no usable solution.
    #[error("controller design: {0}; check the vehicle's inertia and attitude gains")]
    Riccati(#[from] RiccatiError),
    /// No gain that was tried settles the loop with the vehicle's delay and lag.
    #[error(
        "controller design: no feedback settles the vehicle with a command delay of {delay_s} s \
         and a motor lag of {lag_s} s; check both, and its inertia and attitude gains"
    )]
    TooSlow {
        /// Command delay, s.
        delay_s: f64,
        /// Lag of the rotors, s.
        lag_s: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_law_is_listed_once_with_a_summary() {
        let ids: BTreeSet<&str> = LAWS.iter().map(|spec| spec.id).collect();
        assert_eq!(ids.len(), LAWS.len());
        for spec in LAWS {
            assert!(spec.summary.ends_with('.') && spec.summary.len() > 20, "{}", spec.id);
            let law = Law::named(spec.id).expect("listed");
            let text = serde_json::to_string(&law).expect("a name");
            assert_eq!(serde_json::from_str::<Law>(&text).expect("its own name"), law);
        }
        let refused = serde_json::from_str::<Law>("\"pid\"").expect_err("not listed").to_string();
        assert!(refused.contains("lqr, geometric") && refused.contains("pid"), "{refused}");
    }

    #[test]
    fn listed_gains_exist_in_the_settings() {
        let settings = serde_json::to_value(ControlSettings::default()).expect("settings");
        for gain in LAWS.iter().flat_map(|spec| spec.gains) {
            if let Some(name) = gain.key.strip_prefix("gains.") {
                assert!(!name.contains('.'));
                continue;
            }
            let value = settings.get(gain.key).unwrap_or_else(|| panic!("{}", gain.key));
            assert_eq!(value.as_array().map_or(1, Vec::len), gain.values, "{}", gain.key);
        }
    }

    #[test]
    fn unknown_or_invalid_gains_are_refused() {
        let check = |name: &str, values: &[f64]| {
            let mut gains = Gains::default();
            gains.set(name, values);
            gains.check(&geometric::SPEC).map_err(|error| error.to_string())
        };
        assert_eq!(check("position_per_s2", &[4.0, 9.0]), Ok(()));
        for (name, values, expected) in [
            ("position", &[4.0, 9.0][..], "which has: position_per_s2"),
            ("position_per_s2", &[4.0], "has 1 values, expected 2"),
            ("velocity_per_s", &[4.0, -1.0], "is -1, expected a positive"),
            ("velocity_per_s", &[f64::NAN, 1.0], "is NaN, expected a positive"),
        ] {
            let refused = check(name, values).expect_err("refused");
            assert!(refused.contains(expected), "{refused}");
        }
    }

    #[test]
    fn absolute_and_corrective_commands_agree() {
        let feedforward = Setpoint {
            thrust_n: 3.0,
            attitude: vehicle::frame::Euler::new(0.1, -0.2, 3.0),
            body_rate: [0.1, 0.2, 0.3].into(),
        };
        let reference = Reference { feedforward, ..Reference::default() };
        let mut setpoint = feedforward;
        setpoint.thrust_n = 2.5;
        setpoint.attitude.yaw = -3.0;
        let absolute = Command::absolute(&reference, setpoint, false);
        let correcting = Command::correcting(&reference, absolute.feedback, false);
        assert_eq!(correcting.setpoint.thrust_n, 2.5);
        let turn = correcting.setpoint.attitude.yaw - setpoint.attitude.yaw;
        assert!(wrap_angle(turn).abs() < 1e-12 && absolute.feedback.attitude.yaw > 0.0);
    }
}
