//! Flags of `mocap`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::link::external_pose::PoseForm;

/// Flags of `mocap`.
#[derive(Debug, Args)]
pub struct MocapArgs {
    /// Source of the room's poses. stream:HOST:PORT listens there for lines of JSON; natnet:SERVER
    /// or natnet:SERVER:PORT requests frames from Motive (unicast); natnet-multicast:GROUP:PORT
    /// listens for them.
    #[arg(long, value_name = "ROOM")]
    pub room: String,
    /// The rigid body to bridge: its name in the stream, its streaming id in Motive.
    #[arg(long, value_name = "BODY")]
    pub body: String,
    /// Connection to the vehicle: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD; a
    /// separate endpoint from that of `fly`.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// System id of the vehicle, where several are on the link.
    #[arg(long, value_name = "ID")]
    pub system: Option<u8>,
    /// The message that carries the poses [default: vision, which PX4 and ArduPilot both fuse].
    #[arg(long = "as", value_name = "MESSAGE")]
    pub form: Option<PoseForm>,
    /// Poses per second at most [default: 50].
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// The room's axis that points up [default: z].
    #[arg(long, value_name = "AXIS")]
    pub up: Option<UpChoice>,
    /// Heading of the room's x axis, clockwise from the vehicle's north, degrees [default: 0].
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub x_heading: Option<f64>,
    /// Direction of the vehicle's nose in the body's axes, clockwise from x, degrees [default: 0].
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub nose: Option<f64>,
    /// Stops after this time, s [default: on Ctrl-C].
    #[arg(long, value_name = "SECONDS", value_parser = super::value::seconds)]
    pub seconds: Option<f64>,
    /// Configuration file; its `mocap` has the other settings.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints a summary as JSON at the end.
    #[arg(long)]
    pub json: bool,
}

/// Which of a room's axes points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpChoice {
    /// z.
    Z,
    /// y.
    Y,
}
