//! A vehicle's parameters. Which encoding its integers have shows only in the whole log, so both
//! readings are kept until then.

use message::parameter_value::ParameterCast;
use message::{Inbound, Refusal};
use wire::{Frame, message_name};

use super::{PX4, VehicleLog};
use crate::import::clocks::FrameTime;

/// A parameter as each encoding of integers reads it; `None` where that is no number.
#[derive(Debug)]
pub(super) struct Heard {
    /// Number of its frame.
    pub index: u32,
    pub name: String,
    as_value: Option<f64>,
    as_bytes: Option<f64>,
}

impl Heard {
    /// Whether it can only be bytewise: as a value, the integer is no number or smaller than
    /// single precision holds in full.
    fn is_bytewise(&self) -> bool {
        let is_whole = |value: f64| value == 0.0 || value.abs() >= f64::from(f32::MIN_POSITIVE);
        self.as_value != self.as_bytes && !self.as_value.is_some_and(is_whole)
    }
}

impl VehicleLog {
    /// Adds a PARAM_VALUE.
    pub(super) fn add_parameter(&mut self, frame_time: FrameTime, frame: &Frame) {
        let mut read = |cast| {
            self.codec.set_parameter_cast(cast);
            self.codec.decode(frame).map(|decoded| match decoded {
                Some((_, Inbound::Parameter { name, value })) => Some((name, value)),
                _ => None,
            })
        };
        let (value, bytes) = (read(ParameterCast::Value), read(ParameterCast::Bytes));
        let number = |read: &Result<Option<(String, f64)>, Refusal>| match read {
            Ok(Some((_, value))) => Some(*value),
            _ => None,
        };
        let (as_value, as_bytes) = (number(&value), number(&bytes));
        match value.or(bytes) {
            Ok(Some((name, _))) => {
                self.messages += 1;
                self.parameters.push(Heard { index: frame_time.index, name, as_value, as_bytes });
            }
            Ok(None) => {}
            Err(refusal) => {
                self.tally.add(&format!("{}: {refusal}", message_name(frame.id())), 1);
            }
        }
    }

    /// Every parameter heard, in order: the number of its frame, its name and its value.
    pub(super) fn heard_parameters(&self) -> impl Iterator<Item = (u32, &str, f64)> {
        let is_bytewise =
            self.autopilot == Some(PX4) || self.parameters.iter().any(Heard::is_bytewise);
        self.parameters.iter().filter_map(move |heard| {
            let value = if is_bytewise { heard.as_bytes } else { heard.as_value };
            Some((heard.index, heard.name.as_str(), value?))
        })
    }
}

#[cfg(test)]
mod tests {
    use message::parameter_value;
    use wire::Encoder;
    use wire::dialect::*;

    use super::*;

    const INT32: MavParamType = MavParamType::MAV_PARAM_TYPE_INT32;
    const REAL32: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;

    fn parameter(name: &str, value: f64, kind: MavParamType, cast: ParameterCast) -> MavMessage {
        let mut param_id = [0; 16];
        param_id[..name.len()].copy_from_slice(name.as_bytes());
        MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value: parameter_value::encode(value, kind, cast),
            param_type: kind,
            param_id: param_id.into(),
            ..Default::default()
        })
    }

    fn heartbeat(autopilot: MavAutopilot) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA { autopilot, ..Default::default() })
    }

    fn values(messages: &[MavMessage]) -> Vec<f64> {
        let (mut log, mut encoder) = (VehicleLog::default(), Encoder::new(1, 1));
        for (index, message) in (1..).zip(messages) {
            let mut bytes = Vec::new();
            encoder.encode(message, &mut bytes);
            log.add(FrameTime { index, ground: 0.0 }, &Frame::parse(&bytes).expect("a frame"));
        }
        assert!(log.tally.clone().into_vec().is_empty());
        log.heard_parameters().map(|(_, _, value)| value).collect()
    }

    #[test]
    fn integers_are_read_alike_before_and_after_the_first_heartbeat() {
        let sent = |cast| {
            [("A", 1.0, INT32), ("B", 1_065_353_216.0, INT32), ("C", 0.5, REAL32)]
                .map(|(name, value, kind)| parameter(name, value, kind, cast))
        };
        let expected = [1.0, 1_065_353_216.0, 0.5];
        let px4 = heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4);
        let [a, b, c] = sent(ParameterCast::Bytes);
        assert_eq!(values(&[px4.clone(), a.clone(), b.clone(), c.clone()]), expected);
        assert_eq!(values(&[a.clone(), b.clone(), c.clone(), px4.clone()]), expected);
        assert_eq!(values(&[a, b.clone(), c]), expected);
        // Alone, this one may be the value 1.
        assert_eq!(values(std::slice::from_ref(&b)), [1.0]);
        assert_eq!(values(&[b, px4]), [expected[1]]);
        // The bytes of a negative integer are no number in single precision.
        assert_eq!(values(&[parameter("D", -1.0, INT32, ParameterCast::Bytes)]), [-1.0]);
        let [a, b, c] = sent(ParameterCast::Value);
        let ardupilot = heartbeat(MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA);
        assert_eq!(values(&[a, b, c, ardupilot]), expected);
    }
}
