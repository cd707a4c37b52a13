//! Decodes and checks a ground station's SET_ATTITUDE_TARGET, honouring its type mask.

use vehicle::frame::{Attitude, Frd};
use wire::Frame;
use wire::dialect::{MavMessage, SET_ATTITUDE_TARGET_DATA};

use crate::codec::Refusal;

/// The commands in a SET_ATTITUDE_TARGET; a part that its mask ignores is `None`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeTarget {
    /// Time on the sender's clock, ms; 0 if it has none.
    pub time_boot_ms: u32,
    /// System id of the target, 0 for all.
    pub target_system: u8,
    /// Desired attitude, body to world.
    pub attitude: Option<Attitude>,
    /// Desired body rate, rad/s; `None` unless the mask keeps all three components.
    pub body_rate: Option<Frd>,
    /// Thrust field, as sent.
    pub thrust: Option<f64>,
}

/// Decodes a frame; `None` for any other message.
///
/// # Errors
/// [`Refusal`] if the frame is malformed or a part that the mask keeps is impossible.
pub fn decode(frame: &Frame) -> Result<Option<AttitudeTarget>, Refusal> {
    if frame.id() != <SET_ATTITUDE_TARGET_DATA as mavlink::MessageData>::ID {
        return Ok(None);
    }
    let MavMessage::SET_ATTITUDE_TARGET(data) = frame.message().map_err(|_| Refusal::Malformed)?
    else {
        return Ok(None);
    };
    const RATES_IGNORED: u8 = 0x07;
    const THRUST_IGNORED: u8 = 0x40;
    const ATTITUDE_IGNORED: u8 = 0x80;
    let mask = data.type_mask.bits();
    let finite = |value: f64| value.is_finite().then_some(value).ok_or(Refusal::OutOfRange);
    let attitude = (mask & ATTITUDE_IGNORED == 0)
        .then(|| Attitude::from_wire(data.q).ok_or(Refusal::Quaternion))
        .transpose()?;
    let rates = [data.body_roll_rate, data.body_pitch_rate, data.body_yaw_rate].map(f64::from);
    let body_rate = (mask & RATES_IGNORED == 0)
        .then(|| rates.iter().try_for_each(|rate| finite(*rate).map(drop)).map(|()| rates.into()))
        .transpose()?;
    let thrust =
        (mask & THRUST_IGNORED == 0).then(|| finite(f64::from(data.thrust))).transpose()?;
    let SET_ATTITUDE_TARGET_DATA { time_boot_ms, target_system, .. } = data;
    Ok(Some(AttitudeTarget { time_boot_ms, target_system, attitude, body_rate, thrust }))
}
