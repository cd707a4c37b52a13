//! Many vehicles of one type: separates what the type's file lacks from what single vehicles have.
//!
//! Each vehicle's flights first become likelihoods of the numbers of every set of effects
//! ([`survey`]). Over the fleet, a number is the type's value plus each vehicle's deviation: most
//! vehicles are within the tolerances of a build, a few are damaged and may be anywhere
//! ([`mixture`]). The fleet's evidence, with a vehicle as a block, decides which effects the type
//! has, by the rules of [`verdict`](super::verdict) ([`shared`]). The diagnosis of a vehicle's
//! flights against the type's file shows what that vehicle has beyond it.

pub mod answer;
pub mod mixture;
pub mod shared;
pub mod survey;
pub mod text;
