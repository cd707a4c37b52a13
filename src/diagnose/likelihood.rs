//! How likely flights are by a vehicle: equations of motion cell by cell, by frequency, fitted.

pub mod channels;
pub mod fit;
pub mod layout;
pub mod linearised;
pub mod noise;
pub mod observed;
pub mod residuals;
