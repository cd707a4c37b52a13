//! Selects the vehicle among the senders, and follows it to another peer.

use mavlink::MavlinkVersion;
use message::Inbound;
use message::codec::{self, Codec};
use wire::Frame;
use wire::transport::Peer;

use super::{Core, Vehicle};
use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::link::session::{Event, VehicleId};
use crate::link::vehicle_clock::VehicleClock;

/// MAV_TYPEs that do not fly, whatever autopilot they name: antenna tracker, ground station,
/// onboard controller, gimbal, ADS-B receiver, camera, and the components from charging station to
/// winch and illuminator.
fn is_component(vehicle_type: u8) -> bool {
    matches!(vehicle_type, 5 | 6 | 18 | 26 | 27 | 30..=34 | 36..=42 | 44)
}

/// MAV_AUTOPILOT_INVALID: a component without an autopilot.
const NO_AUTOPILOT: u8 = 8;
/// Most other autopilots that are remembered.
const OTHERS_MAX: usize = 16;

/// The autopilot that sent a HEARTBEAT; `None` if another component did.
pub(super) fn autopilot_of(peer: Peer, frame: &Frame) -> Option<VehicleId> {
    let Inbound::Heartbeat { autopilot, vehicle_type, .. } = codec::heartbeat(frame.payload())
    else {
        return None;
    };
    let system = u8::try_from(frame.system()).ok().filter(|system| *system != 0)?;
    let is_autopilot = autopilot != NO_AUTOPILOT && !is_component(vehicle_type);
    let component = frame.component();
    is_autopilot.then_some(VehicleId { system, component, autopilot, vehicle_type, peer })
}

impl Core {
    /// Takes the first autopilot as the vehicle, preferring known ones, and finds it again at
    /// another peer. Returns whether a different one now answers under the known ids.
    pub(super) fn select(&mut self, now: HostTime, id: VehicleId, is_signed: bool) -> bool {
        if self.settings.vehicle_system.is_some_and(|requested| requested != id.system) {
            return false;
        }
        let Some(known) = &mut self.vehicle else {
            self.found(now, id, is_signed);
            self.events.push_back(Event::VehicleFound(id));
            return false;
        };
        if (known.id.system, known.id.component) != (id.system, id.component) {
            self.note_other(now, id, is_signed);
            return false;
        }
        let is_lost = self.state == LinkState::Lost;
        // A second path to the vehicle counts only while the known one is silent.
        let is_silent = is_lost || known.peer.is_none() || self.state == LinkState::Stale;
        if !is_silent && known.peer != Some(id.peer) {
            return false;
        }
        if known.id.is_another(&id) {
            if known.id.is_known() && !id.is_known() && !is_lost {
                return false;
            }
            self.replaced(now, id, is_signed);
            return true;
        }
        if is_lost {
            self.found(now, id, is_signed);
            self.events.push_back(Event::VehicleFound(id));
        } else if is_silent {
            let before = known.peer.replace(id.peer);
            known.id.peer = id.peer;
            // A reopened connection is a new one even under the same peer number. One that was
            // merely silent continues its count.
            if before != Some(id.peer) {
                self.novelty.restart();
            }
        }
        false
    }

    /// Handles a second autopilot. A known one replaces an unknown one. Between two known or two
    /// unknown ones, only the user can choose.
    fn note_other(&mut self, now: HostTime, id: VehicleId, is_signed: bool) {
        let Some(vehicle) = self.vehicle.as_ref().map(|vehicle| vehicle.id) else { return };
        if id.is_known() && !vehicle.is_known() {
            self.replaced(now, id, is_signed);
        } else if id.is_known() == vehicle.is_known()
            && !self.others.contains(&id)
            && self.others.len() < OTHERS_MAX
        {
            self.others.push(id);
            self.events.push_back(Event::AnotherAutopilot { vehicle, other: id });
        }
    }

    /// Replaces the vehicle. Nothing known about the former one applies, and requests to it end.
    fn replaced(&mut self, now: HostTime, id: VehicleId, is_signed: bool) {
        self.profile = None;
        self.intervals.stop();
        self.requests.withdraw();
        self.requests.abandon();
        self.collect_ended();
        self.found(now, id, is_signed);
        self.events.push_back(Event::VehicleReplaced(id));
    }

    fn found(&mut self, now: HostTime, id: VehicleId, is_signed: bool) {
        let version = MavlinkVersion::V2;
        self.vehicle =
            Some(Vehicle { id, peer: Some(id.peer), last_received: now, is_signed, version });
        self.others.retain(|other| *other != id);
        self.codec = Codec::default();
        self.clock = VehicleClock::default();
        self.counters.restart(now);
        self.counters.is_vehicle(id.system, id.component);
        self.novelty.restart();
        self.attitude = None;
        self.outbox.set_version(MavlinkVersion::V2);
        self.timesync_due = now;
        self.version_due = Some((now, 0));
    }
}
