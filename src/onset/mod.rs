//! Onset detection: a change-point detector on the residuals of a flight under a model. It is pure
//! and sans I/O (samples in, changes out, time passed in), so an in-flight monitor and a log reader
//! use the same code.
//!
//! Samples become [`cells`] of fixed length. Each cell holds the residual of the equations of
//! motion under the vehicle file's physics, and its derivative with respect to each possible cause
//! ([`columns`]). Both are whitened with the spectrum of the earlier noise ([`noise`]). For each
//! cause and each instant of the last seconds, [`likelihood`] tests whether the whitened residuals
//! before and after differ by more than chance; [`detector`] decides. [`history`] runs the
//! corresponding test across flights by date.

pub mod cells;
pub mod change;
pub mod columns;
pub mod detector;
mod equations;
pub mod history;
pub mod likelihood;
pub mod noise;
pub mod text;
