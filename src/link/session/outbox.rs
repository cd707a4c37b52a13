//! Frames queued for the driver, and the messages that the session itself makes.

use mavlink::MavlinkVersion;
use wire::Encoder;
use wire::dialect::*;
use wire::signing::Signer;
use wire::transport::Peer;

use super::VehicleId;

/// Encoded frames, in order; the buffers are reused.
#[derive(Debug)]
pub(super) struct Outbox {
    encoder: Encoder,
    bytes: Vec<u8>,
    /// Destination of each frame (`None` means every peer), and its end in `bytes`.
    frames: Vec<(Option<Peer>, usize)>,
}

impl Outbox {
    pub(super) fn new(encoder: Encoder) -> Self {
        Self { encoder, bytes: Vec::new(), frames: Vec::new() }
    }

    /// Sets the MAVLink version from the next frame on.
    pub(super) fn set_version(&mut self, version: MavlinkVersion) {
        self.encoder.set_version(version);
    }

    /// The signer of the frames.
    pub(super) fn signer(&mut self) -> Option<&mut Signer> {
        self.encoder.signer()
    }

    pub(super) fn push(&mut self, to: Option<Peer>, message: &MavMessage) {
        if self.encoder.encode(message, &mut self.bytes) {
            self.frames.push((to, self.bytes.len()));
        }
    }

    /// Queues a finished frame unchanged.
    pub(super) fn push_frame(&mut self, to: Peer, frame: &[u8]) {
        self.bytes.extend_from_slice(frame);
        self.frames.push((Some(to), self.bytes.len()));
    }

    pub(super) fn drain(&mut self, mut send: impl FnMut(Option<Peer>, &[u8])) {
        let mut start = 0;
        for (to, end) in self.frames.drain(..) {
            send(to, &self.bytes[start..end]);
            start = end;
        }
        self.bytes.clear();
    }
}

/// The heartbeat of this program.
pub(super) fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

/// A command to a vehicle.
pub(super) fn command_long(
    to: VehicleId,
    command: MavCmd,
    params: [f32; 7],
    confirmation: u8,
) -> MavMessage {
    let [param1, param2, param3, param4, param5, param6, param7] = params;
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        command,
        target_system: to.system,
        target_component: to.component,
        confirmation,
    })
}
