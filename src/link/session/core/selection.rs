//! Which of those that are heard is the vehicle, and where it went.

use wire::Frame;
use wire::transport::Peer;

use super::{Core, Vehicle};
use crate::clock::HostTime;
use crate::link::codec::{self, Codec};
use crate::link::counters::LinkState;
use crate::link::message::Inbound;
use crate::link::session::{Event, VehicleId};
use crate::link::timesync::TimeSync;

/// MAV_TYPEs that fly nothing, whatever autopilot they name: antenna tracker, ground station,
/// onboard controller, gimbal, ADS-B receiver, camera.
const NO_VEHICLE: [u8; 6] = [5, 6, 18, 26, 27, 30];
/// MAV_AUTOPILOT_INVALID: a component that is no autopilot.
const NO_AUTOPILOT: u8 = 8;

impl Core {
    /// Takes the first autopilot for the vehicle, and finds it again where it went. Gives whether
    /// it is another one, under the ids of the one that was known.
    pub(super) fn select(&mut self, now: HostTime, peer: Peer, frame: &Frame) -> bool {
        let Inbound::Heartbeat { autopilot, vehicle_type, .. } = codec::heartbeat(frame.payload())
        else {
            return false;
        };
        let Ok(system) = u8::try_from(frame.system()) else { return false };
        let is_wanted = self.settings.vehicle_system.is_none_or(|wanted| wanted == system);
        let is_vehicle = autopilot != NO_AUTOPILOT && !NO_VEHICLE.contains(&vehicle_type);
        if !is_vehicle || system == 0 || !is_wanted {
            return false;
        }
        let id = VehicleId { system, component: frame.component(), autopilot, vehicle_type, peer };
        let Some(known) = &mut self.vehicle else {
            self.found(now, id);
            self.events.push_back(Event::VehicleFound(id));
            return false;
        };
        if (known.id.system, known.id.component) != (id.system, id.component) {
            return false;
        }
        let is_lost = self.state == LinkState::Lost;
        // Another route to the vehicle counts only when the known one is silent.
        let is_silent = is_lost || known.peer.is_none() || self.state == LinkState::Stale;
        if !is_silent && known.peer != Some(peer) {
            return false;
        }
        if known.id.is_another(&id) {
            self.replaced(now, id);
            return true;
        }
        if is_lost {
            self.found(now, id);
            self.events.push_back(Event::VehicleFound(id));
        } else if is_silent {
            let before = known.peer.replace(peer);
            known.id.peer = peer;
            // A connection that closed is another one now, though its number be the same; one that
            // was merely silent goes on counting.
            if before != Some(peer) {
                self.counters.rerouted();
            }
        }
        false
    }

    /// Nothing that was known or asked of the vehicle before holds for this one.
    fn replaced(&mut self, now: HostTime, id: VehicleId) {
        self.profile = None;
        self.intervals.stop();
        self.requests.withdraw();
        self.requests.abandon();
        self.collect_ended();
        self.found(now, id);
        self.events.push_back(Event::VehicleReplaced(id));
    }

    fn found(&mut self, now: HostTime, id: VehicleId) {
        self.vehicle = Some(Vehicle { id, peer: Some(id.peer), last_heard: now });
        self.codec = Codec::default();
        self.clock = TimeSync::default();
        self.counters.restart(now);
        self.attitude = None;
        self.timesync_due = now;
        self.version_due = Some((now, 0));
    }
}
