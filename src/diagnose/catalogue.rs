//! The ways a vehicle may differ from its file: numbers with their tolerances and priors, and the
//! effects that they belong to.

pub mod candidate;
pub mod hypothesis;
pub mod number;
pub mod reference;
pub(super) mod term;
pub(super) mod tolerances;
