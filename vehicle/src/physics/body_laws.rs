//! How laws enter the physics: by value, by reference, or not at all.

use super::{Environment, Loads};
use crate::effects::Wrench;
use crate::law::Laws;
use crate::rigid_body::State;
use crate::scalar::Scalar;

/// Laws that act on the body in addition to the catalogue's effects.
pub trait BodyLaws {
    /// Adds the laws' forces and moments to `wrench`.
    fn add<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    );
}

impl BodyLaws for Laws {
    #[inline(always)]
    fn add<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    ) {
        Laws::add(self, state, &loads.as_quantities(), env, wrench);
    }
}

impl<L: BodyLaws> BodyLaws for Option<L> {
    #[inline(always)]
    fn add<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    ) {
        if let Some(laws) = self {
            laws.add(state, loads, env, wrench);
        }
    }
}

/// No laws, known at compile time. Physics without laws are plain numbers, and the compiler
/// vectorises loops over them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lawless;

impl BodyLaws for Lawless {
    #[inline(always)]
    fn add<T: Scalar>(&self, _: &State<T>, _: &Loads<T>, _: &Environment, _: &mut Wrench<T>) {}
}

impl<L: BodyLaws> BodyLaws for &L {
    #[inline(always)]
    fn add<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    ) {
        (**self).add(state, loads, env, wrench);
    }
}
