//! The likelihood of flights: equations of motion over cells of time, by frequency, and their fit.

mod bounded_minimum;
pub mod channels;
pub mod column;
pub mod equation_residual;
pub mod fit;
pub mod layout;
pub mod linearised;
pub mod noise;
pub mod observed;
pub mod residuals;
