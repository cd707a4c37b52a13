//! Laws: effects as formulas, for causes that the catalogue does not have.
//!
//! A law is a table of formulas over [`Quantity`]s, each acting at one place in the physics. A
//! formula is parsed once into a flat program. Its units are checked, its magnitude is bounded, and
//! it can access nothing except the quantities. Laws belong to an
//! [`EffectSet`](crate::effects::EffectSet), as the catalogue's effects do.

mod check;
mod parser;
mod program;
mod quantity;
mod unit;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize};

use self::check::Fault;
pub use parser::{Constant, LENGTH_MAX};
pub use program::{OPERATIONS_MAX, Program};
pub use quantity::{Needed, QUANTITIES, Quantity};
pub use unit::Unit;

use crate::effects::Wrench;
use crate::frame::{Frd, Ned};
use crate::physics::Environment;
use crate::rigid_body::State;
use crate::scalar::Scalar;

pub(crate) use quantity::{Rotors, values};

/// Largest number of constants in a law.
const CONSTANTS_MAX: usize = 32;
/// Largest number of laws in a set.
pub const LAWS_MAX: usize = 8;
/// Default bound of a force, in weights. The default bound of a moment is this force times the
/// rotors' largest arm.
const WEIGHTS_MAX: f64 = 2.0;

/// Where a formula acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Channel {
    /// Force along an axis of the body, N.
    Force(usize),
    /// Force along an axis of the world (north, east, down), N.
    WorldForce(usize),
    /// Moment about an axis of the body, N m.
    Moment(usize),
    /// f in T <- T (1 + f); tilting moments scale too, as with a
    /// [`ThrustEffect`](crate::effects::ThrustEffect).
    Thrust,
    /// Extra lag of the rotors, s. It may use constants only, because it is fixed for all flights.
    Lag,
}

impl Channel {
    /// Every channel, in the order of the documentation.
    pub const ALL: [Self; 11] = [
        Self::Force(0),
        Self::Force(1),
        Self::Force(2),
        Self::WorldForce(0),
        Self::WorldForce(1),
        Self::WorldForce(2),
        Self::Moment(0),
        Self::Moment(1),
        Self::Moment(2),
        Self::Thrust,
        Self::Lag,
    ];

    /// The channel's key in a law.
    pub fn name(self) -> &'static str {
        let axis = |names: [&'static str; 3], axis: usize| names.get(axis).copied().unwrap_or("");
        match self {
            Self::Force(i) => axis(["force_x", "force_y", "force_z"], i),
            Self::WorldForce(i) => axis(["force_north", "force_east", "force_down"], i),
            Self::Moment(i) => axis(["moment_x", "moment_y", "moment_z"], i),
            Self::Thrust => "thrust",
            Self::Lag => "lag",
        }
    }

    /// The required unit of the channel's formula.
    pub fn unit(self) -> Unit {
        match self {
            Self::Force(_) | Self::WorldForce(_) => Unit::FORCE,
            Self::Moment(_) => Unit::MOMENT,
            Self::Thrust => Unit::NONE,
            Self::Lag => Unit::TIME,
        }
    }

    fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.name() == name)
    }
}

/// A law as written in files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LawText {
    /// Description of the law, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<String>,
    /// Formulas by the name of their channel: `force_x = "-c * air_x"`.
    #[serde(flatten, deserialize_with = "formulas")]
    pub formulas: BTreeMap<String, String>,
    /// Named numbers with their units: `c = "0.012 kg/s"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub constants: BTreeMap<String, String>,
    /// 90 % intervals of the constants, for people.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub intervals_90: BTreeMap<String, [f64; 2]>,
    /// Range of validity of each quantity; the law clamps quantities to it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub range: BTreeMap<String, [f64; 2]>,
    /// Bound on the force along each axis, N.
    #[serde(default, rename = "max_force_N", skip_serializing_if = "Option::is_none")]
    pub max_force_n: Option<f64>,
    /// Bound on the moment about each axis, N m.
    #[serde(default, rename = "max_moment_Nm", skip_serializing_if = "Option::is_none")]
    pub max_moment_nm: Option<f64>,
}

/// Formulas by their keys; an error names the key.
fn formulas<'de, D: Deserializer<'de>>(source: D) -> Result<BTreeMap<String, String>, D::Error> {
    let values = BTreeMap::<String, toml::Value>::deserialize(source)?;
    let text = |(key, value): (String, toml::Value)| match value {
        toml::Value::String(text) => Ok((key, text)),
        other => Err(serde::de::Error::custom(format!(
            "{key}: expected a formula such as force_x = \"-0.1 [kg/s] * air_x\", or one of the law's other \
             keys, found {other}"
        ))),
    };
    values.into_iter().map(text).collect()
}

/// Why a law is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("law {law:?}: {place}: {reason}")]
pub struct LawError {
    /// Name of the law.
    pub law: String,
    /// The key at fault.
    pub place: String,
    /// What is wrong and what is accepted.
    pub reason: String,
}

/// A checked law; cheap to clone.
#[derive(Clone)]
pub struct Law(Arc<Checked>);

struct Checked {
    name: String,
    text: LawText,
    formulas: Vec<(Channel, Program)>,
    limits: [[f64; 2]; QUANTITIES],
    needed: Needed,
    lag_s: f64,
}

impl PartialEq for Law {
    fn eq(&self, other: &Self) -> bool {
        self.0.name == other.0.name && self.0.text == other.0.text
    }
}

impl fmt::Debug for Law {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Law").field(&self.0.name).field(&self.0.text).finish()
    }
}

impl Law {
    /// Checks a law and compiles its formulas.
    ///
    /// # Errors
    /// [`LawError`] names the key at fault and the reason.
    pub fn new(name: &str, text: LawText) -> Result<Self, LawError> {
        Self::checked(name, text).map_err(|fault| fault.of(name))
    }

    fn checked(name: &str, text: LawText) -> Result<Self, Fault> {
        check::name(name)?;
        let constants = check::constants(&text)?;
        let mut formulas = check::formulas(&text, &constants)?;
        let limits = check::limits(&text)?;
        check::bounds(&text)?;
        let lag_s = check::lag_s(&formulas, &limits)?;
        formulas.retain(|(channel, _)| *channel != Channel::Lag);
        let needed =
            formulas.iter().fold(Needed::default(), |all, (_, program)| all.and(program.needed()));
        let name = name.to_owned();
        Ok(Self(Arc::new(Checked { name, text, formulas, limits, needed, lag_s })))
    }

    /// Parses a one-line law: `force_x = -0.02[kg/s] * air_x; force_y = -0.02[kg/s] * air_y`.
    ///
    /// # Errors
    /// [`LawError`] names the key at fault and the reason.
    pub fn from_line(name: &str, line: &str) -> Result<Self, LawError> {
        let mut text = LawText::default();
        for part in line.split(';').filter(|part| !part.trim().is_empty()) {
            let Some((key, formula)) = part.split_once('=') else {
                let reason = format!("{part:?} has no '='; write force_x = -0.02[kg/s] * air_x");
                return Err(LawError { law: name.to_owned(), place: "formula".to_owned(), reason });
            };
            let (key, formula) = (key.trim().to_owned(), formula.trim().to_owned());
            if text.formulas.insert(key.clone(), formula).is_some() {
                let reason = "it is given twice".to_owned();
                return Err(LawError { law: name.to_owned(), place: key, reason });
            }
        }
        Self::new(name, text)
    }

    /// Whether `text` starts with a channel and `=`, the form that [`Law::from_line`] parses.
    pub fn is_line(text: &str) -> bool {
        text.split_once('=').is_some_and(|(key, _)| Channel::of(key.trim()).is_some())
    }

    /// The law's name within its set.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// The law as written.
    pub fn text(&self) -> &LawText {
        &self.0.text
    }

    /// Extra lag of the rotors, s.
    pub fn lag_s(&self) -> f64 {
        self.0.lag_s
    }

    /// The quantities that the law reads.
    pub fn needed(&self) -> Needed {
        self.0.needed
    }
}

/// Laws that act on a vehicle, with their default bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct Laws {
    laws: Arc<[Law]>,
    needed: Needed,
    /// Default bounds of a force (N) and a moment (N m).
    bounds: [f64; 2],
    full_voltage: f64,
}

impl Laws {
    /// Takes the weight in N, the rotors' largest arm in m and the full pack's voltage in V.
    /// Returns `None` without a law.
    pub fn new(laws: &[Law], weight: f64, arm: f64, full_voltage: f64) -> Option<Self> {
        let needed = laws.iter().fold(Needed::default(), |all, law| all.and(law.needed()));
        let force = WEIGHTS_MAX * weight;
        (!laws.is_empty()).then(|| Self {
            laws: laws.into(),
            needed,
            bounds: [force, force * arm],
            full_voltage,
        })
    }

    /// Whether a law reads `quantity`.
    pub fn reads(&self, quantity: Quantity) -> bool {
        self.needed.has(quantity)
    }

    /// Adds the laws' forces and moments to `wrench`, in body axes.
    pub fn add<T: Scalar>(
        &self,
        state: &State<T>,
        rotors: &Rotors<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    ) {
        let quantities = values(self.needed, state, rotors, env, self.full_voltage);
        let zero = T::default();
        for law in self.laws.iter() {
            let Checked { formulas, limits, text, .. } = law.0.as_ref();
            let force_max = text.max_force_n.unwrap_or(self.bounds[0]);
            let moment_max = text.max_moment_nm.unwrap_or(self.bounds[1]);
            let (mut body, mut world, mut moment) = ([zero; 3], [zero; 3], [zero; 3]);
            for (channel, program) in formulas {
                let value = program.value(&quantities, limits);
                match *channel {
                    Channel::Force(axis) => body[axis] = bounded(value, force_max),
                    Channel::WorldForce(axis) => world[axis] = bounded(value, force_max),
                    Channel::Moment(axis) => moment[axis] += bounded(value, moment_max),
                    Channel::Thrust => {
                        let more = bounded(value, 1.0);
                        let [roll, pitch, _] = rotors.moment;
                        wrench.force += Frd::new(zero, zero, -(rotors.thrust * more));
                        moment[0] += roll * more;
                        moment[1] += pitch * more;
                    }
                    Channel::Lag => {}
                }
            }
            wrench.force += Frd::from(body);
            wrench.force += state.attitude.to_body(Ned::from(world));
            wrench.moment += Frd::from(moment);
        }
    }
}

fn bounded<T: Scalar>(value: T, most: f64) -> T {
    value.max(T::from(-most)).min(T::from(most))
}

#[cfg(test)]
mod tests;
