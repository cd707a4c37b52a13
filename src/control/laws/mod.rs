//! Control laws: from state and reference to a setpoint. Each law has its own file, and [`LAWS`]
//! lists them all; every caller takes its law from there.

mod geometric;
mod geometric_adaptive;
mod l1;
mod lqr;
#[cfg(test)]
mod quad;
mod settings;

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use vehicle::frame::wrap_angle;

pub use self::geometric::Geometric;
pub use self::lqr::Lqr;
pub use self::settings::{ControlSettings, Gains, Reach};
use super::actuation::Actuation;
use super::attitude_loop::AttitudeLoop;
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
