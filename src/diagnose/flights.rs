//! Logs as data: streams as plain numbers, blocks of airborne time, their spectra, and the on-board
//! loop's response to setpoints.

pub mod arrival;
pub mod case;
pub mod normal;
pub mod onboard;
pub(super) mod parts;
pub mod preparation;
pub mod rotor_order;
pub mod series;
pub(super) mod setpoints;
pub mod spectrum;
