//! The channels of the residuals: one equation of motion or of measurement each.

/// Number of channels.
pub const CHANNELS: usize = 16;
/// First of the three channels of the velocity: increments along north, east, down, m/s^2.
pub const VELOCITY: usize = 0;
/// First of the three channels of the specific force along front, right, down, m/s^2.
pub const FORCE: usize = 3;
/// First of the three channels of the body rate: increments about front, right, down, rad/s^2.
pub const RATE: usize = 6;
/// First of the three channels of the attitude: rotation about front, right, down, rad/s.
pub const ATTITUDE: usize = 9;
/// First of the four channels of the command: collective, N, and moments, N m.
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
