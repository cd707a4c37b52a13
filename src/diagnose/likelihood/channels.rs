//! The channels of the residuals: one equation of motion or of measurement each.

/// Number of channels.
pub const CHANNELS: usize = 16;
/// First channels of the groups, in the order of [`CHANNEL_NAMES`].
pub const VELOCITY: usize = 0;
/// See [`VELOCITY`].
pub const FORCE: usize = 3;
/// See [`VELOCITY`].
pub const RATE: usize = 6;
/// See [`VELOCITY`].
pub const ATTITUDE: usize = 9;
/// See [`VELOCITY`].
pub const COMMAND: usize = 12;

/// Names of the channels.
pub const CHANNEL_NAMES: [&str; CHANNELS] = [
    "acceleration north",
    "acceleration east",
    "acceleration down",
    "specific force front",
    "specific force right",
    "specific force down",
    "angular acceleration roll",
    "angular acceleration pitch",
    "angular acceleration yaw",
    "attitude rate roll",
    "attitude rate pitch",
    "attitude rate yaw",
    "commanded thrust",
    "commanded roll moment",
    "commanded pitch moment",
    "commanded yaw moment",
];
