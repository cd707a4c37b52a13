//! From flight logs to a model: dataset, features, training, validation.

pub mod alignment;
pub mod commands;
pub mod dataset;
pub mod identify;
pub mod segments;
mod window;
