//! The live view: a Foxglove WebSocket server of the log's own topics, and a page at the same
//! address.
//!
//! It cannot delay the control thread: [`LiveFeed`] receives records in the thread that writes the
//! log, the server runs in its own thread, and every viewer has a bounded queue that drops its
//! oldest messages. If viewers may change something, the control thread takes their [`Changes`]
//! from a short queue.

mod feed;
mod front;
mod playback;
mod recording;
mod relay;
mod server;
mod trail;
mod write;

pub use self::feed::{CoursePath, LiveFeed, LiveView};
pub use self::playback::Playback;
pub use self::recording::Recording;
pub use self::server::{ViewError, ViewSettings};
pub use self::write::Changes;
