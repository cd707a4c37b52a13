//! Roll and pitch from the direction of the body's down axis, and back.
//!
//! In level axes that turn with yaw, that axis is (sin pitch cos roll, -sin roll, cos pitch cos
//! roll).

use vehicle::frame::{Heading, Ned};

/// Roll and pitch at which the down axis of a body with heading `yaw` points along `down`, a vector
/// of any length except 0.
pub(super) fn tilt_towards(down: Ned, yaw: f64) -> [f64; 2] {
    tilt_of(Heading::new(yaw).to_level(down * (1.0 / down.norm())))
}

/// Roll and pitch from the down axis, a unit vector in level axes that turn with yaw.
pub(super) fn tilt_of([x, y, z]: [f64; 3]) -> [f64; 2] {
    [(-y).clamp(-1.0, 1.0).asin(), x.atan2(z)]
}

/// The down axis at a roll and pitch, in level axes that turn with yaw.
pub(super) fn down_at(roll: f64, pitch: f64) -> [f64; 3] {
    let (sin_roll, cos_roll) = roll.sin_cos();
    let (sin_pitch, cos_pitch) = pitch.sin_cos();
    [sin_pitch * cos_roll, -sin_roll, cos_pitch * cos_roll]
}
