//! A body's sample in the room's own terms.

/// A rigid body at one instant, in the room's axes. None of it is checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The body: its name in a stream of lines, its streaming number in NatNet.
    pub body: String,
    /// When the cameras saw it, s on the room's clock.
    pub captured_s: f64,
    /// When the room sent it, s on the same clock, if it reports that.
    pub sent_s: Option<f64>,
    /// Position along the room's x, y, z, m.
    pub position_m: [f64; 3],
    /// Rotation from the body's axes to the room's: w, x, y, z.
    pub rotation: [f64; 4],
    /// Whether the room reports that it sees the body.
    pub is_tracked: bool,
}

/// Why a datagram violates its protocol.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Malformed(pub String);
