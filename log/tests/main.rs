//! The package's integration tests in one binary.

mod onboard_log;

mod foreign;
mod onboard;
mod table;
