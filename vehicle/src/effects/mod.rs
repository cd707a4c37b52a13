//! The catalogue of effects: what a real vehicle may do that the nominal one does not.
//!
//! One effect, one file: its equation, parameters, neutral values, ranges and source. An effect
//! acts at one place of the chain from motor output to motion, and the trait it implements says
//! which. Effects that act outside the plant carry parameters only.
//!
//! Symbols: v_a = velocity relative to the air in body axes, V_h its horizontal part,
//! n_i = rotor speed as a fraction of the maximum, nr = mean(n_i) / sqrt(hover_thrust),
//! T = sum of the rotors' thrusts before the aerodynamic factors.

mod set;
mod spec;

mod attitude_trim;
mod battery_sag;
mod blade_flapping;
mod com_offset;
mod command_delay;
mod estimator_latency;
mod file;
mod ground_effect;
mod gusts;
mod inertia;
mod mass;
mod motor_lag;
mod parasitic_drag;
mod pd_gain;
mod rotor_drag;
mod rotor_gyroscopic;
mod rotor_loss;
mod schedule;
mod thrust_curve;
mod thrust_scale;
mod translational_lift;
mod vortex_ring;
mod wind;
mod yaw_torque;

use std::fmt;
use std::ops::AddAssign;
use std::str::FromStr;

pub use attitude_trim::AttitudeTrim;
pub use battery_sag::BatterySag;
pub use blade_flapping::BladeFlapping;
pub use com_offset::ComOffset;
pub use command_delay::CommandDelay;
pub use estimator_latency::EstimatorLatency;
pub use file::EffectsRefused;
pub use ground_effect::GroundEffect;
pub use gusts::{Gusts, Turbulence};
pub use inertia::Inertia;
pub use mass::Mass;
pub use motor_lag::MotorLag;
pub use parasitic_drag::ParasiticDrag;
pub use pd_gain::PdGain;
pub use rotor_drag::RotorDrag;
pub use rotor_gyroscopic::RotorGyroscopic;
pub use rotor_loss::RotorLoss;
pub use schedule::{Onset, OnsetError, Schedule};
pub use set::{EffectError, EffectSet, ParameterValue};
pub use spec::{Kind, MAX_SLOTS, Neutral, Parameter, Slot, Slots, Spec};
pub use thrust_curve::ThrustCurve;
pub use thrust_scale::ThrustScale;
pub use translational_lift::TranslationalLift;
pub use vortex_ring::VortexRing;
pub use wind::Wind;
pub use yaw_torque::YawTorque;

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
    /// The factor; 1 is neutral.
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T;
}

/// Acts by a force and a moment on the body.
pub trait BodyEffect: Effect {
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

/// Names every effect once: the id's variants, its order and [`CATALOGUE`] cannot disagree.
macro_rules! catalogue {
    ($($effect:ident $file:literal),+ $(,)?) => {
        /// Names an effect of the catalogue.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[allow(missing_docs)] // the types of the same names are documented
        pub enum EffectId {
            $($effect),+
        }

        impl EffectId {
            /// Every effect, in the catalogue's order.
            pub const ALL: [EffectId; COUNT] = [$(EffectId::$effect),+];
        }

        /// Every effect's specification, in the order of [`EffectId::ALL`].
        pub static CATALOGUE: [Spec; COUNT] = [$(<$effect as Effect>::SPEC),+];

        /// Text of every effect's file, whose first lines say what it does.
        static FILES: [&str; COUNT] = [$(include_str!($file)),+];
    };
}

/// Number of effects in the catalogue.
pub const COUNT: usize = 22;

catalogue! {
    ThrustScale "thrust_scale.rs",
    Mass "mass.rs",
    ThrustCurve "thrust_curve.rs",
    BatterySag "battery_sag.rs",
    RotorLoss "rotor_loss.rs",
    MotorLag "motor_lag.rs",
    CommandDelay "command_delay.rs",
    RotorDrag "rotor_drag.rs",
    ParasiticDrag "parasitic_drag.rs",
    Wind "wind.rs",
    Gusts "gusts.rs",
    GroundEffect "ground_effect.rs",
    TranslationalLift "translational_lift.rs",
    BladeFlapping "blade_flapping.rs",
    VortexRing "vortex_ring.rs",
    Inertia "inertia.rs",
    ComOffset "com_offset.rs",
    RotorGyroscopic "rotor_gyroscopic.rs",
    YawTorque "yaw_torque.rs",
    AttitudeTrim "attitude_trim.rs",
    EstimatorLatency "estimator_latency.rs",
    PdGain "pd_gain.rs",
}

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

    /// The effect that stands for all that no flight can tell from this one: mass and thrust act as
    /// their ratio.
    pub fn class(self) -> Self {
        if self == Self::Mass { Self::ThrustScale } else { self }
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
