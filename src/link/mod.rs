//! The link to a vehicle: codec, session, time synchronisation, counters.

pub mod attitude_target;
pub mod codec;
pub mod counters;
pub mod intervals;
pub mod message;
pub mod parameter;
pub mod profile;
pub mod request;
pub mod session;
mod text;
pub mod timesync;
