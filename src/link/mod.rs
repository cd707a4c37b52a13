//! The link to a vehicle: codec, session, time synchronisation, counters.

pub mod attitude_target;
pub mod codec;
pub mod connection;
pub mod counters;
pub mod intervals;
pub mod message;
pub mod parameter;
pub mod profile;
pub mod request;
pub mod session;
pub mod tee;
mod text;
pub mod timesync;
