//! The bridge from a motion-capture room to a vehicle, sans I/O: datagrams of the room and time in, poses
//! that may be forwarded and news out.
//!
//! `stream` and `natnet` decode, `room_clock` ties the room's clock to the host's, `room_frame` turns the
//! room's axes into north, east, down, `watch` decides whether a pose is believed, and `bridge` is all of it
//! for one body. What leaves is a pose: nothing else has a way through here.

pub mod bridge;
pub mod fault;
pub mod natnet;
pub mod room_clock;
pub mod room_frame;
pub mod sample;
pub mod settings;
pub mod stream;
pub mod watch;
