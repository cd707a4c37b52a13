//! The live view: a Foxglove WebSocket server of the log's own topics, and a page of its own at the
//! same address.
//!
//! Nothing here is known to the control thread: [`LiveFeed`] hears records in the thread that
//! writes the log, the server runs in a thread of its own, and every viewer has a bounded queue
//! that loses its oldest messages.

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
