//! MAVLink messages as physical quantities: an autopilot's reports and setpoints, in SI units and
//! typed frames.
//!
//! [`Codec`] decodes checked frames into [`Inbound`] messages and refuses impossible values. The
//! code behind it never sees MAVLink's units, frames and markers for unset fields. [`parameters`]
//! derives vehicle properties from an autopilot's parameters. [`clock`] and [`setpoint`] hold the
//! types that the link, the log and the controller share.
//!
//! ```
//! use message::{Codec, Inbound};
//! use wire::dialect::{LOCAL_POSITION_NED_DATA, MavMessage};
//!
//! let data = LOCAL_POSITION_NED_DATA { time_boot_ms: 1500, z: -2.0, ..Default::default() };
//! let mut bytes = Vec::new();
//! wire::Encoder::new(1, 1).encode(&MavMessage::LOCAL_POSITION_NED(data), &mut bytes);
//!
//! let frame = wire::Frame::parse(&bytes).unwrap();
//! let (time, message) = Codec::default().decode(&frame).unwrap().unwrap();
//! assert_eq!(time.unwrap().as_us(), 1_500_000);
//! let Inbound::LocalPosition { position, .. } = message else { panic!("{message:?}") };
//! assert_eq!(position.to_array(), [0.0, 0.0, -2.0]);
//! ```

#![warn(missing_docs)]

pub mod attitude_target;
pub mod clock;
pub mod codec;
mod inbound;
pub mod parameter_value;
pub mod parameters;
pub mod setpoint;
mod text;

pub use codec::{Codec, Refusal};
pub use inbound::{
    AttitudeSource, Battery, ChargeState, Inbound, LandedState, MotorSource, SystemState,
};
