//! The catalogue of effects: what a real vehicle may do that the nominal one does not.
//!
//! One effect, one file: its equation, parameters, neutral values, ranges and source. An effect
//! acts at one place of the chain from motor output to motion, and the trait it implements says
//! which. Effects that act outside the plant carry parameters only.
//!
//! Symbols: v_a = velocity relative to the air in body axes, V_h its horizontal part,
//! n_i = rotor speed as a fraction of the maximum, nr = mean(n_i) / sqrt(hover_thrust),
//! T = sum of the rotors' thrusts before the aerodynamic factors.

mod file;
mod schedule;
mod set;
mod spec;

use std::fmt;
use std::ops::AddAssign;
use std::str::FromStr;

pub use file::EffectsRefused;
pub use gusts::Turbulence;
pub use schedule::{Onset, OnsetError, Schedule};
pub use set::{EffectError, EffectSet, ParameterValue};
pub use spec::{
    Chance, Growth, Kind, MAX_SLOTS, Need, Neutral, Parameter, Slot, Slots, Spec, slots,
};

use serde::{Serialize, Serializer};

use crate::frame::Frd;
use crate::physics::Constants;
use crate::scalar::Scalar;

/// An effect with its parameters.
pub trait Effect: Copy {
    /// Which one.
    const ID: EffectId;
    /// Its parameters.
    const SPEC: Spec;

    /// From checked numbers, in the order of the specification.
    fn from_slots(slots: &Slots) -> Self;

    /// With the defaults of its parameters, which do nothing where these are neutral; 0 for one that
    /// has none.
    fn neutral() -> Self {
        let mut slots = Slots::default();
        for (value, slot) in slots.iter_mut().zip(Self::SPEC.slots()) {
            *value = slot.parameter.default.unwrap_or_default();
        }
        Self::from_slots(&slots)
    }
}

/// Acts by changing a constant of the nominal vehicle.
pub trait ConstantEffect: Effect {
    /// Makes the constants the true ones.
    fn apply(&self, constants: &mut Constants);
}

/// Acts by a factor on every rotor's thrust, and not on its drag torque.
pub trait ThrustEffect: Effect {
    /// Whether it reads [`Flow::rotor_speed_ratio`], which costs a square root a rotor.
    const READS_ROTOR_SPEED: bool = false;

    /// The factor; 1 is neutral.
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T;
}

/// Acts by a force and a moment on the body.
pub trait BodyEffect: Effect {
    /// Whether it reads [`Flow::rotor_speed_ratio`], which costs a square root a rotor.
    const READS_ROTOR_SPEED: bool = false;

    /// Adds to the force and moment.
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>);
}

/// What the aerodynamic effects see.
#[derive(Clone, Copy, Debug)]
pub struct Flow<T> {
    /// v_a: velocity relative to the air, m/s.
    pub air_relative: Frd<T>,
    /// V_h^2 in m^2/s^2.
    pub horizontal_speed2: T,
    /// nr: mean rotor speed over the one at hover.
    pub rotor_speed_ratio: T,
    /// T: the rotors' total thrust before aerodynamic factors, N.
    pub thrust: T,
    /// Height of the centre of mass above the floor, m.
    pub height: T,
    /// rho: density of the air, kg/m^3.
    pub air_density: f64,
    /// 1 / v_i, v_i the rotors' induced velocity at hover with the nominal mass, s/m.
    pub inverse_induced_velocity: f64,
}

/// Force and moment on the body at its centre of mass, without gravity.
#[derive(Clone, Copy, Debug)]
pub struct Wrench<T> {
    /// Force in N.
    pub force: Frd<T>,
    /// Moment in N m.
    pub moment: Frd<T>,
}

impl<T: Scalar> AddAssign for Wrench<T> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.force += other.force;
        self.moment += other.moment;
    }
}

/// The catalogue: each effect's type and file, and where it acts, which is the trait that it
/// implements: on a `constant` of the vehicle, on `thrust`, on the `body`. What acts `elsewhere` is
/// wired by hand. Calls another macro with the list, so that each effect is named here only.
macro_rules! catalogue {
    ($apply:ident) => {
        $apply! {
            ThrustScale thrust_scale constant,
            Mass mass constant,
            ThrustCurve thrust_curve elsewhere,
            BatterySag battery_sag elsewhere,
            RotorLoss rotor_loss constant,
            MotorLag motor_lag constant,
            CommandDelay command_delay elsewhere,
            RotorDrag rotor_drag body,
            ParasiticDrag parasitic_drag body,
            Wind wind elsewhere,
            Gusts gusts elsewhere,
            GroundEffect ground_effect thrust,
            TranslationalLift translational_lift thrust,
            BladeFlapping blade_flapping body,
            VortexRing vortex_ring thrust,
            Inertia inertia constant,
            ComOffset com_offset constant,
            RotorGyroscopic rotor_gyroscopic elsewhere,
            YawTorque yaw_torque constant,
            AttitudeTrim attitude_trim elsewhere,
            EstimatorLatency estimator_latency elsewhere,
            PdGain pd_gain elsewhere,
        }
    };
}
pub(crate) use catalogue;

/// Where an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// On a constant of the nominal vehicle: [`ConstantEffect`].
    Constant,
    /// On every rotor's thrust: [`ThrustEffect`].
    Thrust,
    /// On the body: [`BodyEffect`].
    Body,
    /// On the rotors, the air, the autopilot or what it reports.
    Elsewhere,
}

/// Names the effects of the catalogue.
macro_rules! named {
    ($($effect:ident $file:ident $place:ident),+ $(,)?) => {
        $(
            mod $file;
            pub use $file::$effect;
        )+

        /// Names an effect of the catalogue.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[allow(missing_docs)] // the types of the same names are documented
        pub enum EffectId {
            $($effect),+
        }

        /// Number of effects in the catalogue.
        pub const COUNT: usize = [$(EffectId::$effect),+].len();

        impl EffectId {
            /// Every effect, in the catalogue's order.
            pub const ALL: [EffectId; COUNT] = [$(EffectId::$effect),+];
        }

        /// Every effect's specification, in the order of [`EffectId::ALL`].
        pub static CATALOGUE: [Spec; COUNT] = [$(<$effect as Effect>::SPEC),+];

        /// Where each acts.
        static PLACES: [Place; COUNT] = [$(named!(@ $place)),+];

        /// Text of every effect's file, whose first lines say what it does.
        static FILES: [&str; COUNT] = [$(include_str!(concat!(stringify!($file), ".rs"))),+];
    };
    (@ constant) => { Place::Constant };
    (@ thrust) => { Place::Thrust };
    (@ body) => { Place::Body };
    (@ elsewhere) => { Place::Elsewhere };
}
catalogue!(named);

impl EffectId {
    /// Its specification.
    pub fn spec(self) -> &'static Spec {
        &CATALOGUE[self as usize]
    }

    /// Its id in files.
    pub fn name(self) -> &'static str {
        self.spec().id
    }

    /// What it does, its equation and where that is from: the documentation of its file. The first
    /// paragraph has the equation.
    pub fn about(self) -> String {
        let lines = FILES[self as usize].lines().map_while(|line| line.strip_prefix("//!"));
        lines.map(str::trim).collect::<Vec<_>>().join("\n")
    }

    /// Where it acts.
    pub fn place(self) -> Place {
        PLACES[self as usize]
    }

    /// The effect that stands for its variants, and for all that no flight can tell from it: mass and
    /// thrust act as their ratio.
    pub fn class(self) -> Self {
        self.spec().family.unwrap_or(self)
    }
}

impl fmt::Display for EffectId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Serialize for EffectId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl FromStr for EffectId {
    type Err = EffectError;

    fn from_str(name: &str) -> Result<Self, EffectError> {
        EffectId::ALL
            .into_iter()
            .find(|id| id.name() == name)
            .ok_or_else(|| EffectError::UnknownEffect { id: name.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_specification_is_sound() {
        for id in EffectId::ALL {
            let spec = id.spec();
            assert_eq!(spec.id.parse::<EffectId>().unwrap(), id);
            assert!(spec.slots().count() <= MAX_SLOTS, "{id}");
            // What it is called begins what it does.
            let name = spec.id.replace('_', " ");
            let about = id.about().to_lowercase();
            assert!(about.starts_with(&name) || id == EffectId::ComOffset, "{id}: {about}");
            for parameter in spec.parameters {
                assert!(parameter.min < parameter.max, "{id}.{}", parameter.name);
                if let Neutral::Value(neutral) = parameter.neutral {
                    assert!((parameter.min..=parameter.max).contains(&neutral), "{id}");
                    assert_eq!(parameter.default, Some(neutral), "{id}");
                }
            }
        }
    }

    #[test]
    fn the_slots_of_a_vector_follow_one_another() {
        let slots: Vec<_> = EffectId::PdGain.spec().slots().collect();
        assert_eq!(slots.len(), 6);
        assert_eq!(
            (slots[4].index, slots[4].parameter.name, slots[4].component),
            (4, "kd_scale", 1)
        );
    }
}
