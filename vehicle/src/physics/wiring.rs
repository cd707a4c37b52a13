//! Wires the catalogue's effects into the physics. A macro generates the code from the catalogue's
//! list, so every effect in the list acts.

use super::Constants;
use crate::effects::*;
use crate::scalar::Scalar;

/// Sorts the catalogue by where its effects act.
macro_rules! wired {
    (@ [$($thrust:ident $t:ident)*] [$($body:ident $b:ident)*] [$($constant:ident)*]) => {
        /// The effects that depend on the airflow past the vehicle.
        #[derive(Clone, Copy, Debug, Default)]
        pub(super) struct FlowEffects {
            $(pub $t: Option<$thrust>,)*
            $(pub $b: Option<$body>,)*
        }

        impl FlowEffects {
            /// Picks the effects of a set.
            pub fn of(effects: &EffectSet) -> Self {
                Self { $($t: effects.get(),)* $($b: effects.get(),)* }
            }

            pub fn is_empty(&self) -> bool {
                true $(&& self.$t.is_none())* $(&& self.$b.is_none())*
            }

            /// Whether an active effect reads the rotors' speed.
            pub fn read_rotor_speed(&self) -> bool {
                false
                    $(|| self.$t.is_some() && <$thrust as ThrustEffect>::READS_ROTOR_SPEED)*
                    $(|| self.$b.is_some() && <$body as BodyEffect>::READS_ROTOR_SPEED)*
            }

            /// All effects, with inactive ones set to neutral values.
            #[inline(always)]
            pub fn dense(&self) -> Self {
                Self {
                    $($t: Some(self.$t.unwrap_or(Effect::neutral())),)*
                    $($b: Some(self.$b.unwrap_or(Effect::neutral())),)*
                }
            }

            /// The product of the factors on every rotor's thrust.
            #[inline(always)]
            pub fn thrust_factor<T: Scalar>(&self, flow: &Flow<T>) -> T {
                let mut factor = T::from(1.0);
                $(if let Some(effect) = &self.$t {
                    factor = factor * effect.factor(flow);
                })*
                factor
            }

            /// Adds the forces and moments on the body.
            #[inline(always)]
            pub fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>) {
                $(if let Some(effect) = &self.$b {
                    effect.add(flow, wrench);
                })*
            }
        }

        impl Constants {
            /// Applies the effects to the nominal constants.
            pub(super) fn apply_all(&mut self, effects: &EffectSet) {
                $(if let Some(effect) = effects.get::<$constant>() {
                    effect.apply(self);
                })*
            }
        }
    };
    (@ [$($t:tt)*] [$($b:tt)*] [$($c:tt)*] $effect:ident $file:ident thrust, $($rest:tt)*) => {
        wired! { @ [$($t)* $effect $file] [$($b)*] [$($c)*] $($rest)* }
    };
    (@ [$($t:tt)*] [$($b:tt)*] [$($c:tt)*] $effect:ident $file:ident body, $($rest:tt)*) => {
        wired! { @ [$($t)*] [$($b)* $effect $file] [$($c)*] $($rest)* }
    };
    (@ [$($t:tt)*] [$($b:tt)*] [$($c:tt)*] $effect:ident $file:ident constant, $($rest:tt)*) => {
        wired! { @ [$($t)*] [$($b)*] [$($c)* $effect] $($rest)* }
    };
    (@ [$($t:tt)*] [$($b:tt)*] [$($c:tt)*] $effect:ident $file:ident elsewhere, $($rest:tt)*) => {
        wired! { @ [$($t)*] [$($b)*] [$($c)*] $($rest)* }
    };
    ($effect:ident $($rest:tt)*) => {
        wired! { @ [] [] [] $effect $($rest)* }
    };
}
catalogue!(wired);
