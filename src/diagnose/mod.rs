//! Diagnosis of the gap between a simulator and flights: where the gap is, which effect causes it,
//! and how far that effect closes it.

pub mod answer;
pub mod catalogue;
mod context;
pub mod discovery;
pub mod error;
pub mod fleet;
pub mod flights;
pub mod likelihood;
pub mod next_flight;
pub mod onset;
pub mod pipeline;
pub mod residual_analysis;
pub mod search;
pub mod simulate;
pub mod verdict;
