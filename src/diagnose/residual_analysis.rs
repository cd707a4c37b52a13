//! The residual of a fit: where it is, which force is unexplained, what a flexible learner
//! predicts.

pub mod learner;
pub mod map;
pub mod slung_load;
pub mod turbulence;
pub mod unmodelled_force;
