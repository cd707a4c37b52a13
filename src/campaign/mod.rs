//! Flights under drawn faults, and an independent judge. It knows nothing of the controller except
//! its frames on the wire and the vehicle's true motion.

mod aircraft;
pub mod bench;
mod bounds;
mod channel;
pub mod coverage;
pub mod draw;
mod frame_content;
pub mod judge;
pub mod kit;
pub mod live;
pub mod planner;
mod process;
mod relay;
mod rule;
pub mod script;
pub mod shrink;
mod signing;
mod tamper;
mod truth;
