//! What a fit leaves: where it lies, which force nothing explains, what a flexible learner still predicts.

pub mod learner;
pub mod leftover;
pub mod map;
pub mod turbulence;
