//! The codec: decodes frames of the vehicle's autopilot into [`Inbound`] messages.
//!
//! MAVLink's units, frames and markers for unset fields end here. The codec refuses numbers that
//! are not finite or physically impossible, so the code behind it need not check.

mod condition;
mod wrapping_clock;

use std::collections::BTreeMap;

use mavlink::MessageData;
use vehicle::frame::{Attitude, Euler, Ned};
use wire::Frame;
use wire::dialect::*;

pub use self::condition::heartbeat;
use self::condition::{battery, landed_state, sys_status};
use self::wrapping_clock::WrappingClock;
use crate::clock::VehicleTime;
use crate::inbound::{AttitudeSource, Inbound, MotorSource};
use crate::parameter_value::{self, ParameterCast};
use crate::text::TextAssembler;

/// Largest distance from the origin on each axis, m; beyond it the estimate has diverged.
const POSITION_MAX: f64 = 1e6;
/// Largest velocity component, m/s.
const SPEED_MAX: f64 = 1e3;
/// Largest body rate, rad/s; gyros saturate at 35.
const RATE_MAX: f64 = 200.0;
/// Largest specific force, m/s^2; accelerometers saturate at a tenth of it.
const SPECIFIC_FORCE_MAX: f64 = 3e3;
/// Largest Euler angle: autopilots send (-pi, pi] or [0, 2 pi).
const ANGLE_MAX: f64 = 2.0 * std::f64::consts::PI + 0.01;
/// Largest number of parameter types kept; autopilots have about two thousand parameters.
const PARAMETERS_MAX: usize = 8192;

/// Why a frame with a valid checksum was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The payload does not fit its message, such as an enum value that the dialect lacks.
    #[error("payload does not fit its message")]
    Malformed,
    /// A number is NaN, infinite, or larger than physics allows.
    #[error("number out of range")]
    OutOfRange,
    /// A quaternion is not of unit length.
    #[error("quaternion is not of unit length")]
    Quaternion,
    /// ODOMETRY in frames other than LOCAL_NED with LOCAL_NED or BODY_FRD.
    #[error(
        "frame {frame:?} with child frame {child:?}, expected MAV_FRAME_LOCAL_NED with \
             MAV_FRAME_LOCAL_NED or MAV_FRAME_BODY_FRD; have the vehicle send the estimate of its \
             autopilot, or ATTITUDE_QUATERNION and LOCAL_POSITION_NED"
    )]
    OdometryFrame {
        /// Frame of the pose.
        frame: MavFrame,
        /// Frame of the velocity.
        child: MavFrame,
    },
}

/// A message and the vehicle time of its sample; `None` if the message has no time stamp.
pub type Decoded = (Option<VehicleTime>, Inbound);

/// Decodes the frames of one autopilot. It keeps state that spans several frames.
#[derive(Debug, Default)]
pub struct Codec {
    text: TextAssembler,
    cast: ParameterCast,
    /// Types of the parameters received so far; PARAM_SET needs them.
    parameter_types: BTreeMap<String, MavParamType>,
    clock: WrappingClock,
}

impl Codec {
    /// Sets this autopilot's encoding of integer parameters.
    pub fn set_parameter_cast(&mut self, cast: ParameterCast) {
        self.cast = cast;
    }

    /// The type of a parameter, if it was received.
    pub fn parameter_type(&self, name: &str) -> Option<MavParamType> {
        self.parameter_types.get(name).copied()
    }

    /// Whether a message has stated the vehicle's time, to which shorter stamps can be extended.
    pub fn knows_time(&self) -> bool {
        self.clock.is_known()
    }

    /// The vehicle time nearest to the newest one at which a counter of 32 bits reads `low_us`
    /// microseconds; notes it as the newest.
    pub fn extended_us(&mut self, low_us: u32) -> VehicleTime {
        let time = self.clock.extend_us(low_us);
        self.clock.observe(time);
        time
    }

    /// As [`extended_us`](Self::extended_us), for a counter of milliseconds since boot.
    pub fn extended_ms(&mut self, low_ms: u32) -> VehicleTime {
        let time = self.clock.extend_ms(low_ms);
        self.clock.observe(time);
        time
    }

    /// Decodes a frame. Returns `None` for an unsupported message, or for a STATUSTEXT chunk that
    /// does not complete its text.
    ///
    /// # Errors
    /// [`Refusal`] if the content is malformed or impossible.
    pub fn decode(&mut self, frame: &Frame) -> Result<Option<Decoded>, Refusal> {
        if frame.id() == HEARTBEAT_DATA::ID {
            return Ok(Some((None, heartbeat(frame.payload()))));
        }
        if !is_understood(frame.id()) {
            return Ok(None);
        }
        let message = frame.message().map_err(|_| Refusal::Malformed)?;
        let decoded = self.message(&message)?;
        if let Some((Some(time), _)) = decoded {
            self.clock.observe(time);
        }
        Ok(decoded)
    }

    fn message(&mut self, message: &MavMessage) -> Result<Option<Decoded>, Refusal> {
        use MavMessage as M;
        Ok(Some(match message {
            M::ODOMETRY(data) => odometry(data)?,
            M::ATTITUDE_QUATERNION(data) => {
                (Some(self.clock.extend_ms(data.time_boot_ms)), attitude_quaternion(data)?)
            }
            M::ATTITUDE(data) => {
                (Some(self.clock.extend_ms(data.time_boot_ms)), attitude_euler(data)?)
            }
            M::LOCAL_POSITION_NED(data) => {
                (Some(self.clock.extend_ms(data.time_boot_ms)), local_position(data)?)
            }
            M::HIGHRES_IMU(data) => imu(data)?,
            M::ACTUATOR_OUTPUT_STATUS(data) => {
                let [a, b, c, d, ..] = data.actuator;
                let time = VehicleTime::from_us(data.time_usec);
                outputs(MotorSource::ActuatorOutputStatus, time, [a, b, c, d])?
            }
            M::SERVO_OUTPUT_RAW(data) if data.port == 0 => {
                let raw = [data.servo1_raw, data.servo2_raw, data.servo3_raw, data.servo4_raw];
                let time = self.clock.extend_us(data.time_usec);
                outputs(MotorSource::ServoOutputRaw, time, raw.map(f32::from))?
            }
            M::BATTERY_STATUS(data) if data.id == 0 => (None, battery(data)),
            M::ATTITUDE_TARGET(data) => {
                (Some(self.clock.extend_ms(data.time_boot_ms)), attitude_target(data)?)
            }
            M::SYS_STATUS(data) => (None, sys_status(data)),
            M::EXTENDED_SYS_STATE(data) => (None, landed_state(data)),
            M::AUTOPILOT_VERSION(data) => {
                let message = Inbound::AutopilotVersion {
                    vendor_id: data.vendor_id,
                    product_id: data.product_id,
                    flight_sw_version: data.flight_sw_version,
                };
                (None, message)
            }
            M::CURRENT_MODE(data) => {
                let message = Inbound::CurrentMode {
                    custom_mode: data.custom_mode,
                    intended_custom_mode: data.intended_custom_mode,
                };
                (None, message)
            }
            M::COMMAND_ACK(data) => {
                let message =
                    Inbound::CommandAck { command: data.command as u16, result: data.result as u8 };
                (None, message)
            }
            M::PARAM_VALUE(data) => {
                let value = parameter_value::decode(data.param_value, data.param_type, self.cast);
                if !value.is_finite() {
                    return Err(Refusal::OutOfRange);
                }
                let name = parameter_value::name(&data.param_id);
                if self.parameter_types.len() < PARAMETERS_MAX {
                    self.parameter_types.insert(name.clone(), data.param_type);
                }
                (None, Inbound::Parameter { name, value })
            }
            M::STATUSTEXT(data) => match self.text.push(data) {
                Some(text) => (None, Inbound::StatusText { severity: data.severity as u8, text }),
                None => return Ok(None),
            },
            _ => return Ok(None),
        }))
    }
}

/// Whether a message carries the time of its sample, which makes each one unique.
pub fn is_stamped(id: u32) -> bool {
    matches!(
        id,
        ODOMETRY_DATA::ID
            | ATTITUDE_QUATERNION_DATA::ID
            | ATTITUDE_DATA::ID
            | LOCAL_POSITION_NED_DATA::ID
            | HIGHRES_IMU_DATA::ID
            | ACTUATOR_OUTPUT_STATUS_DATA::ID
            | SERVO_OUTPUT_RAW_DATA::ID
            | ATTITUDE_TARGET_DATA::ID
    )
}

fn is_understood(id: u32) -> bool {
    is_stamped(id)
        || matches!(
            id,
            BATTERY_STATUS_DATA::ID
                | SYS_STATUS_DATA::ID
                | EXTENDED_SYS_STATE_DATA::ID
                | AUTOPILOT_VERSION_DATA::ID
                | CURRENT_MODE_DATA::ID
                | COMMAND_ACK_DATA::ID
                | PARAM_VALUE_DATA::ID
                | STATUSTEXT_DATA::ID
        )
}

fn odometry(data: &ODOMETRY_DATA) -> Result<Decoded, Refusal> {
    let (frame, child) = (data.frame_id, data.child_frame_id);
    if frame != MavFrame::MAV_FRAME_LOCAL_NED {
        return Err(Refusal::OdometryFrame { frame, child });
    }
    let attitude = unit(data.q)?;
    let velocity = bounded([data.vx, data.vy, data.vz], SPEED_MAX)?;
    let velocity: Ned = match child {
        MavFrame::MAV_FRAME_LOCAL_NED => velocity.into(),
        MavFrame::MAV_FRAME_BODY_FRD => attitude.to_world(velocity.into()),
        _ => return Err(Refusal::OdometryFrame { frame, child }),
    };
    let message = Inbound::Odometry {
        position: bounded([data.x, data.y, data.z], POSITION_MAX)?.into(),
        velocity,
        attitude,
        body_rate: bounded([data.rollspeed, data.pitchspeed, data.yawspeed], RATE_MAX)?.into(),
        reset_counter: data.reset_counter,
    };
    Ok((Some(VehicleTime::from_us(data.time_usec)), message))
}

fn attitude_quaternion(data: &ATTITUDE_QUATERNION_DATA) -> Result<Inbound, Refusal> {
    let message = Inbound::Attitude {
        source: AttitudeSource::Quaternion,
        attitude: unit([data.q1, data.q2, data.q3, data.q4])?,
        body_rate: bounded([data.rollspeed, data.pitchspeed, data.yawspeed], RATE_MAX)?.into(),
    };
    Ok(message)
}

fn attitude_euler(data: &ATTITUDE_DATA) -> Result<Inbound, Refusal> {
    let [roll, pitch, yaw] = bounded([data.roll, data.pitch, data.yaw], ANGLE_MAX)?;
    let message = Inbound::Attitude {
        source: AttitudeSource::Euler,
        attitude: Euler::new(roll, pitch, yaw).attitude(),
        body_rate: bounded([data.rollspeed, data.pitchspeed, data.yawspeed], RATE_MAX)?.into(),
    };
    Ok(message)
}

fn local_position(data: &LOCAL_POSITION_NED_DATA) -> Result<Inbound, Refusal> {
    let message = Inbound::LocalPosition {
        position: bounded([data.x, data.y, data.z], POSITION_MAX)?.into(),
        velocity: bounded([data.vx, data.vy, data.vz], SPEED_MAX)?.into(),
    };
    Ok(message)
}

fn imu(data: &HIGHRES_IMU_DATA) -> Result<Decoded, Refusal> {
    let message = Inbound::Imu {
        specific_force: bounded([data.xacc, data.yacc, data.zacc], SPECIFIC_FORCE_MAX)?.into(),
        body_rate: bounded([data.xgyro, data.ygyro, data.zgyro], RATE_MAX)?.into(),
    };
    Ok((Some(VehicleTime::from_us(data.time_usec)), message))
}

fn outputs(source: MotorSource, time: VehicleTime, outputs: [f32; 4]) -> Result<Decoded, Refusal> {
    if outputs.iter().all(|output| output.is_finite()) {
        Ok((Some(time), Inbound::MotorOutputs { source, outputs }))
    } else {
        Err(Refusal::OutOfRange)
    }
}

fn attitude_target(data: &ATTITUDE_TARGET_DATA) -> Result<Inbound, Refusal> {
    let ignored = AttitudeTargetTypemask::ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE;
    let rates = [data.body_roll_rate, data.body_pitch_rate, data.body_yaw_rate];
    let [thrust] = bounded([data.thrust], 10.0)?;
    let attitude =
        if data.type_mask.contains(ignored) { None } else { Attitude::from_wire(data.q) };
    let message = Inbound::AttitudeTarget {
        attitude,
        body_rate: bounded(rates, RATE_MAX)?.into(),
        thrust,
        type_mask: data.type_mask.bits(),
    };
    Ok(message)
}

fn unit(q: [f32; 4]) -> Result<Attitude, Refusal> {
    Attitude::from_wire(q).ok_or(Refusal::Quaternion)
}

/// Converts to f64; all values must be finite and within `limit` of zero.
fn bounded<const N: usize>(values: [f32; N], limit: f64) -> Result<[f64; N], Refusal> {
    let values = values.map(f64::from);
    // NaN is not within any limit.
    if values.iter().all(|value| value.abs() <= limit) {
        Ok(values)
    } else {
        Err(Refusal::OutOfRange)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use wire::{Decoder, Encoder};

    use super::*;

    fn decode_with(codec: &mut Codec, message: &MavMessage) -> Result<Option<Decoded>, Refusal> {
        let mut bytes = Vec::new();
        Encoder::new(1, 1).encode(message, &mut bytes);
        let mut decoder = Decoder::new();
        decoder.push(&bytes);
        codec.decode(&decoder.next_frame().expect("a whole frame"))
    }

    fn decode(message: &MavMessage) -> Result<Option<Decoded>, Refusal> {
        decode_with(&mut Codec::default(), message)
    }

    fn odometry_in(child_frame_id: MavFrame) -> ODOMETRY_DATA {
        let quarter = std::f32::consts::FRAC_1_SQRT_2;
        ODOMETRY_DATA {
            time_usec: 5_000_000,
            // Facing east.
            q: [quarter, 0.0, 0.0, quarter],
            vx: 2.0,
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id,
            reset_counter: 3,
            ..Default::default()
        }
    }

    #[test]
    fn odometry_velocity_is_converted_to_world_from_any_child_frame() {
        let velocity = |child| {
            let data = odometry_in(child);
            match decode(&MavMessage::ODOMETRY(data)).unwrap().unwrap() {
                (Some(time), Inbound::Odometry { velocity, reset_counter: 3, .. }) => {
                    assert_eq!(time, VehicleTime::from_us(5_000_000));
                    velocity
                }
                other => panic!("{other:?}"),
            }
        };
        let world = velocity(MavFrame::MAV_FRAME_LOCAL_NED);
        assert!((world.north() - 2.0).abs() < 1e-6, "{world:?}");
        let body = velocity(MavFrame::MAV_FRAME_BODY_FRD);
        assert!((body.east() - 2.0).abs() < 1e-6, "forward is east: {body:?}");
        let refused = decode(&MavMessage::ODOMETRY(odometry_in(MavFrame::MAV_FRAME_LOCAL_ENU)));
        let refused = refused.expect_err("refused").to_string();
        assert!(refused.contains("MAV_FRAME_LOCAL_ENU"), "{refused}");
    }

    #[test]
    fn implausible_state_values_are_refused() {
        let mut data = odometry_in(MavFrame::MAV_FRAME_LOCAL_NED);
        data.x = f32::NAN;
        assert_eq!(decode(&MavMessage::ODOMETRY(data)), Err(Refusal::OutOfRange));
        let zero = ATTITUDE_QUATERNION_DATA::default();
        assert_eq!(decode(&MavMessage::ATTITUDE_QUATERNION(zero)), Err(Refusal::Quaternion));
        let spin = ATTITUDE_DATA { rollspeed: 1e9, ..Default::default() };
        assert_eq!(decode(&MavMessage::ATTITUDE(spin)), Err(Refusal::OutOfRange));
        let far = LOCAL_POSITION_NED_DATA { vz: f32::INFINITY, ..Default::default() };
        assert_eq!(decode(&MavMessage::LOCAL_POSITION_NED(far)), Err(Refusal::OutOfRange));
    }

    #[test]
    fn clock_is_consistent_when_first_received_after_a_wrap() {
        let mut codec = Codec::default();
        let us = 60 * 86_400 * 1_000_000;
        let imu = HIGHRES_IMU_DATA { time_usec: us, ..Default::default() };
        decode_with(&mut codec, &MavMessage::HIGHRES_IMU(imu)).unwrap();
        let low = ((us + 20_000) / 1000) as u32;
        let data = LOCAL_POSITION_NED_DATA { time_boot_ms: low, ..Default::default() };
        let message = MavMessage::LOCAL_POSITION_NED(data);
        let time = decode_with(&mut codec, &message).unwrap().unwrap().0;
        assert_eq!(time, Some(VehicleTime::from_us(us + 20_000)));
    }

    proptest! {
        #[test]
        fn decoded_attitude_keeps_its_rotation(
            w in -1f32..1.0, x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0,
        ) {
            let norm = (w * w + x * x + y * y + z * z).sqrt();
            prop_assume!(norm > 0.1);
            let q = [w / norm, x / norm, y / norm, z / norm];
            let data = ATTITUDE_QUATERNION_DATA {
                q1: q[0], q2: q[1], q3: q[2], q4: q[3], ..Default::default()
            };
            let decoded = decode(&MavMessage::ATTITUDE_QUATERNION(data)).unwrap().unwrap().1;
            let Inbound::Attitude { attitude, .. } = decoded else { panic!("{decoded:?}") };
            let sent = Attitude::from_wire(q).unwrap();
            prop_assert!(attitude.angle_to(sent) < 1e-6);
        }

        #[test]
        fn no_payload_panics(
            id in prop::sample::select(vec![
                0u32, 1, 22, 30, 31, 32, 36, 77, 83, 105, 147, 148, 245, 253, 331, 375, 436,
            ]),
            payload in prop::collection::vec(any::<u8>(), 0..255),
        ) {
            if let Ok(message) = <MavMessage as mavlink::Message>::parse(
                mavlink::MavlinkVersion::V2, id, &payload,
            ) {
                let _ = Codec::default().message(&message);
            }
            heartbeat(&payload);
        }
    }
}
