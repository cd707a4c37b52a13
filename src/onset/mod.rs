//! When a vehicle changed: a detector of change points in what a model leaves unexplained of a
//! flight. Pure and sans I/O: samples in, changes out, time passed in, so that a monitor in flight
//! and a reader of logs are the same.
//!
//! Samples become [`cells`] of fixed length. Each cell holds what the vehicle file's physics leaves of
//! the equations of motion, and by how much each cause would change that ([`columns`]). Both are
//! whitened by the spectrum of the noise before ([`noise`]). In what is left, each cause is asked, for each
//! instant of the last seconds, whether it differs after from before by more than chance
//! ([`likelihood`]); [`detector`] decides. [`history`] asks the same of flights by their dates.

pub mod cells;
pub mod change;
pub mod columns;
pub mod detector;
mod equations;
pub mod history;
pub mod likelihood;
pub mod noise;
pub mod words;
