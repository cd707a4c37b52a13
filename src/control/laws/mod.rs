//! Control laws: from state and reference to a setpoint. One law, one file; [`LAWS`] names them all,
//! and whatever flies takes its law from there.

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
/// The vehicle's attitude loop, on board or closed by the link's encoder, tracks what it returns.
/// Roll and pitch of a setpoint tilt the vehicle about its present heading, yaw is the heading that
/// it is to turn to: so the thrust points where it is wanted while the vehicle still turns.
/// The controller around it applies limits and takes out disturbances; a law does neither.
pub trait ControlLaw: CloneLaw + fmt::Debug + Send + Sync {
    /// The setpoint at `state`, which `reference` wants elsewhere. `dt_s` is the time since the law
    /// was last asked, s; 0 the first time and after a [`reset`](Self::reset).
    fn command(&mut self, state: &State, reference: &Reference, dt_s: f64) -> Command;

    /// Forgets what it has integrated: the vehicle is on the ground, or others flew it.
    fn reset(&mut self) {}
}

/// What every law that is [`Clone`] has: each flight begins with a copy of what was designed once.
pub trait CloneLaw {
    /// A copy.
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

/// What a law answers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// `u_hat`, before any limit.
    pub setpoint: Setpoint,
    /// What of it is not the reference's feed-forward.
    pub feedback: Setpoint,
    /// Whether the law saw less than the whole position error.
    pub is_cut: bool,
}

impl Command {
    /// The reference's input, corrected by `feedback`.
    pub fn correcting(reference: &Reference, feedback: Setpoint, is_cut: bool) -> Self {
        Self { setpoint: reference.feedforward.plus(feedback), feedback, is_cut }
    }

    /// `setpoint`, whatever the reference's input is.
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

/// A law as [`LAWS`] lists it.
#[derive(Debug)]
pub struct LawSpec {
    /// Its name in settings and flags.
    pub id: &'static str,
    /// One sentence for people.
    pub summary: &'static str,
    /// What of it can be set.
    pub gains: &'static [Gain],
    /// Designs it for a vehicle.
    pub design: fn(&ControlProblem) -> Result<Box<dyn ControlLaw>, DesignError>,
}

/// A number of a law that can be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gain {
    /// Its key below `control`; keys that begin with `gains.` belong to one law alone.
    pub key: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// How many values it has.
    pub values: usize,
    /// What it does.
    pub meaning: &'static str,
}

/// What a law is designed for.
#[derive(Clone, Copy, Debug)]
pub struct ControlProblem<'a> {
    /// Mass, inertia and gravity.
    pub vehicle: &'a HoverVehicle,
    /// How late the vehicle answers.
    pub actuation: &'a Actuation,
    /// The loop that tracks the attitude.
    pub attitude_loop: &'a AttitudeLoop,
    /// What bounds the setpoint after the law.
    pub limits: &'a Limits,
    /// Rate, acceptable errors and gains.
    pub settings: &'a ControlSettings,
}

/// Which law flies: an entry of [`LAWS`], or a law of another crate. Laws are equal by their ids.
#[derive(Clone, Copy)]
pub struct Law(&'static LawSpec);

impl Law {
    /// The yaw-rotated LQR, which flies unless another is chosen.
    pub const LQR: Self = Self(&lqr::SPEC);
    /// The geometric tracking law.
    pub const GEOMETRIC: Self = Self(&geometric::SPEC);

    /// A law that [`LAWS`] need not list.
    pub const fn new(spec: &'static LawSpec) -> Self {
        Self(spec)
    }

    /// The law of this id, if it is listed.
    pub fn named(id: &str) -> Option<Self> {
        LAWS.into_iter().find(|spec| spec.id == id).map(Self)
    }

    /// What it is.
    pub fn spec(self) -> &'static LawSpec {
        self.0
    }

    /// Designs the law for a vehicle, by its own gains where `control.gains` has them.
    ///
    /// # Errors
    /// [`DesignError`] where a gain is not one of the law's or not positive, or the law finds none.
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

/// Gains of the law that flies, by name. A law derives what is not here from the vehicle.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Gains(BTreeMap<String, Vec<f64>>);

impl Gains {
    /// The values of a gain, where it is set with as many.
    pub fn get<const N: usize>(&self, name: &str) -> Option<[f64; N]> {
        self.0.get(name).and_then(|values| values.as_slice().try_into().ok())
    }

    /// Sets a gain.
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

/// How the vehicle is controlled. The acceptable errors weigh the LQR by Bryson's rule: each weight
/// is 1 / (acceptable deviation)^2. Other laws derive from that LQR what bandwidth the vehicle bears.
/// Thrust counts in units of hover thrust and everything else is kinematic, so that one set flies a
/// 30 g nano and a 1.2 kg quadrotor.
///
/// The defaults ask next to nothing of velocity, attitude and body rate: the attitude loop holds
/// the last two, and what is fed back of them meets its resonance with the rotors' lag after the
/// link's delay. [`Lqr::design_for`] takes back more of it where lag and delay are known; with what
/// is not known, these fly with 30 ms of delay and 60 ms of lag.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControlSettings {
    /// Which law flies.
    #[schemars(with = "String")]
    pub law: Law,
    /// Rate of the feedback, Hz.
    pub rate_hz: f64,
    /// Acceptable position error north, east, down in axes turned by yaw, m.
    pub position_m: [f64; 3],
    /// Acceptable velocity error, likewise, m/s.
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
    /// How quickly the vehicle's own attitude loop answers about roll, pitch and yaw: the natural
    /// frequency of its response, taken to be critically damped, rad/s. For a vehicle that is sent
    /// attitude and thrust and whose file has no gains; none takes the slowest that its autopilot
    /// is expected to fly with.
    pub attitude_response_rad_s: Option<[f64; 3]>,
    /// Whether the LQR corrects roll and pitch by more than `attitude_command_rad` where the loop's
    /// margin leaves room: an autopilot's own loop is slower than the paper's, and an estimate that
    /// wanders moves the vehicle by what feedback lags.
    // `for_loop` resolves `Use::Auto`.
    pub quicken: Use,
    /// How near -1 the opened loop may so come, 0..1.
    pub margin_min: f64,
    /// The feedback sees at most this horizontal position error, so that a reference far away is
    /// approached at a bounded speed, m.
    pub horizontal_error_max_m: f64,
    /// The same for height, m.
    pub vertical_error_max_m: f64,
    /// Whether the physics' parameters are adapted in flight, around whichever law flies. Off, the
    /// feedback is that of the law, and of `offboard.offset_free.observer` where that is on.
    pub adaptive: bool,
    /// How.
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
    /// For a loop that was read from its autopilot, or not: of another too little is known.
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
    /// The position error with its horizontal part and its height within bounds, and whether that
    /// cut it.
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
        /// Which.
        quantity: &'static str,
        /// Its value.
        found: f64,
    },
    /// A gain has too few or too many values.
    #[error("controller design: control.{quantity} has {found} values, expected {expected}")]
    Values {
        /// Which.
        quantity: &'static str,
        /// How many it has.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// The law has no such gain.
    #[error(
        "controller design: control.gains.{name} is no gain of the law {law}, which has: {known}"
    )]
    UnknownGain {
        /// The law.
        law: &'static str,
        /// What was set.
        name: String,
        /// The law's own.
        known: String,
    },
    /// The Riccati equation has no usable solution.
    #[error("controller design: {0}; check the vehicle's inertia and attitude gains")]
    Riccati(#[from] RiccatiError),
    /// The loop with the vehicle's delay and lag does not settle under any gain that was tried.
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
    fn every_law_is_listed_once_and_says_what_it_is() {
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
    fn gains_in_the_table_are_settings() {
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
    fn gains_of_no_law_are_refused() {
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
    fn absolute_and_correcting_commands_agree() {
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
