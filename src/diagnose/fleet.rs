//! Many vehicles of one type: what the file of the type lacks, told apart from what single vehicles
//! have.
//!
//! Each vehicle's flights are first made into likelihoods of the numbers of every set of effects
//! ([`survey`]). Over the fleet a number is what the type has and what each vehicle adds to it: most
//! differ within the tolerances of a build, a few are damaged and lie anywhere ([`mixture`]). Which
//! sets of effects the type has is decided on the fleet's evidence, with a vehicle as a block, by the
//! rules of [`verdict`](super::verdict) ([`shared`]). What one vehicle has beyond it, the diagnosis of its flights
//! against the type's file says.

pub mod answer;
pub mod mixture;
pub mod shared;
pub mod survey;
pub mod words;
