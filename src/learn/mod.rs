//! From flight logs to a model: dataset, features, training, validation.

mod adam;
mod kernel;
mod lanes;
mod objective;
mod rprop;
pub mod samples;
pub mod training;
