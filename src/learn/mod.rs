//! From flight logs to a model: dataset, features, training, validation.

pub mod alignment;
pub mod commands;
pub mod dataset;
pub mod error;
pub mod evaluation;
pub mod gaps;
pub mod identify;
pub mod in_flight;
pub mod judgement;
pub mod networks;
pub mod physics_fit;
pub mod prediction;
pub mod procedure;
pub mod refine;
pub mod samples;
pub mod segments;
pub mod split;
pub mod summary;
pub mod training;
pub mod training_set;

mod adam;
mod comparison;
mod error_ratio;
mod kernel;
mod lanes;
mod least_squares;
mod not_finite;
mod objective;
mod packed;
mod preference;
mod rprop;
mod window;

/// Rows per second of a dataset.
pub const ROW_RATE_HZ: f64 = 100.0;
