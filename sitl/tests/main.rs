//! The simulated vehicle's integration tests in one binary. The modules of the first block are what
//! several tests share.

mod bench;
mod common;

mod autopilot_flight;
mod autopilot_offboard;
mod autopilot_protocol;
mod autopilot_robustness;
mod closed_forms;
mod effects;
mod floor;
mod foreign_laws;
mod jacobian;
mod motion_under_effects;
mod personality_arducopter;
mod personality_health;
mod personality_px4;
mod practice_replay;
mod rotorpy;
mod sensors;
mod vehicle_files;
