//! The MAVLink wire, shared by both of its ends: the daemon and the simulated vehicle.
//!
//! [`framing`] turns bytes into checked frames and messages into bytes, sans I/O. [`tlog`] is the
//! ground-station log of such frames. [`signing`] tells
//! whose they are. [`endpoint`] names where bytes come from, and `transport`
//! (feature `transport`) opens it.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod endpoint;
pub mod framing;
pub mod signing;
pub mod tlog;
#[cfg(feature = "transport")]
pub mod transport;

pub use endpoint::Endpoint;
pub use framing::{Decoder, DecoderStats, Encoder, Frame};
/// The MAVLink dialect that every message of this workspace is typed by: `ardupilotmega` contains
/// `common`, so it also serves PX4.
pub use mavlink::dialects::ardupilotmega as dialect;
