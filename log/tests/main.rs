//! The package's integration tests in one binary.

mod onboard_import;
mod onboard_log;
mod table_import;

mod foreign;
mod onboard;
mod onboard_damage;
mod onboard_motors;
mod onboard_practice;
mod table;
mod table_frames;
mod table_proposals;
