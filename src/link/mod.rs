//! The link to a vehicle: codec, session, time synchronisation, counters.

pub mod message;
