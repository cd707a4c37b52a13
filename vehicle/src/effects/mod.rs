//! The catalogue of effects: how a real vehicle may differ from the nominal one.
//!
//! Each effect has one file with its equation, parameters, neutral values, ranges and source. An
//! effect acts at one point in the chain from motor output to motion; the trait it implements names
//! that point. Effects that act outside the plant carry parameters only.
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

/// An effect of the catalogue, holding values for its parameters.
pub trait Effect: Copy {
    /// The effect's id.
    const ID: EffectId;
    /// The effect's parameters, and what the diagnosis and the exam know about it.
    const SPEC: Spec;

    /// Creates the effect from numbers that are already checked, in the order of [`Effect::SPEC`].
    fn from_slots(slots: &Slots) -> Self;

    /// Creates the effect with its default parameters, which do nothing where the defaults are
    /// neutral. A parameter without a default becomes 0.
    fn neutral() -> Self {
        let mut slots = Slots::default();
        for (value, slot) in slots.iter_mut().zip(Self::SPEC.slots()) {
            *value = slot.parameter.default.unwrap_or_default();
        }
        Self::from_slots(&slots)
    }
}

/// An effect that changes a constant of the nominal vehicle.
pub trait ConstantEffect: Effect {
    /// Replaces nominal constants with the true ones.
    fn apply(&self, constants: &mut Constants);
}

/// An effect that multiplies every rotor's thrust and leaves its drag torque alone.
pub trait ThrustEffect: Effect {
    /// Whether the effect reads [`Flow::rotor_speed_ratio`], which costs one square root per rotor.
    const READS_ROTOR_SPEED: bool = false;

    /// The factor on the thrust; 1 is neutral.
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T;
}

/// An effect that adds a force and a moment on the body.
pub trait BodyEffect: Effect {
    /// Whether the effect reads [`Flow::rotor_speed_ratio`], which costs one square root per rotor.
    const READS_ROTOR_SPEED: bool = false;

    /// Adds the effect's force (N) and moment (N m) to `wrench`.
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>);
}

/// The inputs of the aerodynamic effects.
#[derive(Clone, Copy, Debug)]
pub struct Flow<T> {
    /// v_a: velocity relative to the air in body axes, m/s.
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

/// The catalogue: each effect's type, its file, and where it acts. `constant`, `thrust` and `body`
/// name the trait it implements; an effect that acts `elsewhere` is wired by hand. The macro passes
/// the list to another macro, so this is the only list of effects.
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
    /// On the rotors, the air, the autopilot or the autopilot's reports.
    Elsewhere,
}

/// Declares the effects' modules and [`EffectId`].
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

        /// Where each effect acts.
        static PLACES: [Place; COUNT] = [$(named!(@ $place)),+];

        /// Source text of every effect's file; its module documentation describes the effect.
        static FILES: [&str; COUNT] = [$(include_str!(concat!(stringify!($file), ".rs"))),+];
    };
    (@ constant) => { Place::Constant };
    (@ thrust) => { Place::Thrust };
    (@ body) => { Place::Body };
    (@ elsewhere) => { Place::Elsewhere };
}
catalogue!(named);

impl EffectId {
    /// The effect's entry in [`CATALOGUE`].
    pub fn spec(self) -> &'static Spec {
        &CATALOGUE[self as usize]
    }

    /// The effect's id in files and on the command line.
    pub fn name(self) -> &'static str {
        self.spec().id
    }

    /// The effect's description, equation and source, taken from the module documentation of its
    /// file. The first paragraph has the equation.
    pub fn about(self) -> String {
        let lines = FILES[self as usize].lines().map_while(|line| line.strip_prefix("//!"));
        lines.map(str::trim).collect::<Vec<_>>().join("\n")
    }

    /// Where the effect acts.
    pub fn place(self) -> Place {
        PLACES[self as usize]
    }

    /// The effect that represents its variants and the effects that no flight can distinguish from
    /// it. Mass and thrust, for example, act only through their ratio.
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
    fn every_effect_specification_is_consistent() {
        for id in EffectId::ALL {
            let spec = id.spec();
            assert_eq!(spec.id.parse::<EffectId>().unwrap(), id);
            assert!(spec.slots().count() <= MAX_SLOTS, "{id}");
            // The description begins with the effect's name.
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
    fn vector_slots_are_consecutive() {
        let slots: Vec<_> = EffectId::PdGain.spec().slots().collect();
        assert_eq!(slots.len(), 6);
        assert_eq!(
            (slots[4].index, slots[4].parameter.name, slots[4].component),
            (4, "kd_scale", 1)
        );
    }
}
