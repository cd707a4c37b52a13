//! From flight logs to a model: dataset, features, training, validation.

pub mod alignment;
pub mod commands;
pub mod dataset;
pub mod evaluation;
pub mod identify;
pub mod prediction;
pub mod segments;
pub mod split;
pub mod summary;
mod window;

mod adam;
mod kernel;
mod lanes;
mod objective;
pub mod procedure;
mod rprop;
pub mod samples;
pub mod training;
