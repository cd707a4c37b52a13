//! The simulated vehicle's integration tests in one binary. Several tests share the modules of the
//! first block.

mod bench;

mod autopilot_flight;
mod autopilot_offboard;
mod autopilot_protocol;
mod autopilot_robustness;
mod personality_arducopter;
mod personality_health;
mod personality_px4;
mod personality_vision;
mod sensors;
