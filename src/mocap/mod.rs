//! The bridge from a motion-capture room to a vehicle, sans I/O: the room's datagrams and time in,
//! poses to forward and news out.
//!
//! `stream` and `natnet` decode. `room_clock` relates the room's clock to the host's. `room_frame`
//! turns the room's axes into north, east, down. `watch` decides whether a pose is accepted.
//! `bridge` combines them for one body. Only poses leave the bridge.

pub mod bridge;
pub mod fault;
pub mod natnet;
pub mod room_clock;
pub mod room_frame;
pub mod sample;
pub mod settings;
pub mod stream;
pub mod watch;
