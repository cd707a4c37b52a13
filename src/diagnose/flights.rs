//! Logs as data: streams as plain numbers, blocks of airborne time, their spectra, and the on-board
//! loop's response to setpoints.

pub mod command_delay;
pub(super) mod data_split;
pub mod input;
pub mod normal_draws;
pub mod onboard;
pub mod preparation;
pub mod rotor_order;
pub mod series;
pub(super) mod setpoints;
pub mod spectrum;
