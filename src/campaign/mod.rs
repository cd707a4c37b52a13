//! Flights under drawn faults, and a judge that knows nothing of the controller but what it says on the
//! wire and what becomes of the vehicle.

mod aircraft;
pub mod bench;
mod bounds;
mod channel;
pub mod coverage;
pub mod draw;
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
mod word;
