//! Parameter values on the wire: always a float, which PX4 fills with the bytes of its integers.

use wire::dialect::MavParamType;

/// An autopilot's encoding of integer parameters in the float field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ParameterCast {
    /// Converted to float (ArduPilot).
    #[default]
    Value,
    /// Bit by bit (PX4): 5 reads as 7.0e-45.
    Bytes,
}

/// Decodes a parameter's value from the float field.
pub(crate) fn decode(wire: f32, kind: MavParamType, cast: ParameterCast) -> f64 {
    use MavParamType as T;
    let bits = wire.to_bits();
    match (cast, kind) {
        (ParameterCast::Value, _) => wire.into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT8) => (bits as u8).into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT8) => (bits as i8).into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT16) => (bits as u16).into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT16) => (bits as i16).into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT32) => bits.into(),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT32) => (bits as i32).into(),
        (ParameterCast::Bytes, _) => wire.into(),
    }
}

/// Encodes a parameter's value in the float field. With [`ParameterCast::Bytes`], integers are
/// rounded and clamped to their type's range.
pub fn encode(value: f64, kind: MavParamType, cast: ParameterCast) -> f32 {
    use MavParamType as T;
    let rounded = value.round();
    match (cast, kind) {
        (ParameterCast::Value, _) => value as f32,
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT8) => f32::from_bits((rounded as u8).into()),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT8) => f32::from_bits(rounded as i8 as u32),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT16) => f32::from_bits((rounded as u16).into()),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT16) => f32::from_bits(rounded as i16 as u32),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_UINT32) => f32::from_bits(rounded as u32),
        (ParameterCast::Bytes, T::MAV_PARAM_TYPE_INT32) => f32::from_bits(rounded as i32 as u32),
        (ParameterCast::Bytes, _) => value as f32,
    }
}

/// Decodes a parameter's name: up to 16 bytes, zero-terminated if shorter.
pub(crate) fn name(id: &[u8; 16]) -> String {
    let len = id.iter().position(|&byte| byte == 0).unwrap_or(id.len());
    String::from_utf8_lossy(&id[..len]).into_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn px4_integers_are_byte_cast_and_ardupilot_integers_are_values() {
        let kind = MavParamType::MAV_PARAM_TYPE_INT32;
        assert_eq!(decode(7.0e-45, kind, ParameterCast::Bytes), 5.0);
        assert_eq!(decode(8.0, kind, ParameterCast::Value), 8.0);
        let real = MavParamType::MAV_PARAM_TYPE_REAL32;
        assert_eq!(decode(0.5, real, ParameterCast::Bytes), 0.5);
    }

    proptest! {
        #[test]
        fn byte_cast_integers_round_trip(value in any::<i32>()) {
            let kind = MavParamType::MAV_PARAM_TYPE_INT32;
            let sent = encode(value.into(), kind, ParameterCast::Bytes);
            prop_assert_eq!(decode(sent, kind, ParameterCast::Bytes), f64::from(value));
        }
    }
}
