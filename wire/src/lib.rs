//! The MAVLink wire, shared by the daemon and the simulated vehicle.
//!
//! [`framing`] turns bytes into checked frames and messages into bytes, sans I/O. [`tlog`] reads
//! and writes the ground stations' log format. [`signing`] signs frames and verifies them.
//! [`endpoint`] parses connection strings, and `transport` (feature `transport`) opens endpoints.
//!
//! ```
//! use wire::dialect::{HEARTBEAT_DATA, MavMessage};
//! use wire::{Decoder, Encoder};
//!
//! let mut bytes = b"noise".to_vec();
//! Encoder::new(1, 1).encode(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()), &mut bytes);
//!
//! let mut decoder = Decoder::default();
//! decoder.push(&bytes);
//! let frame = decoder.next_frame().expect("the frame behind the noise");
//! assert!(matches!(frame.message()?, MavMessage::HEARTBEAT(_)));
//! # Ok::<(), mavlink::error::ParserError>(())
//! ```

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod endpoint;
pub mod framing;
pub mod signing;
pub mod tlog;
#[cfg(feature = "transport")]
pub mod transport;

pub use endpoint::Endpoint;
pub use framing::{Decoder, DecoderStats, Encoder, Frame, message_name};
/// The MAVLink dialect of this workspace. `ardupilotmega` contains `common`, so it also serves PX4.
pub use mavlink::dialects::ardupilotmega as dialect;
