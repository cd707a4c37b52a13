//! The session's sending side: setpoints, requests, and the key for a vehicle that is to sign.

#[cfg(test)]
use std::time::Duration;

use message::parameter_value;
use wire::dialect::*;
use wire::signing::{Key, Stamp};

use super::{ATTITUDE_FRESH, Core};
use crate::clock::HostTime;
use crate::guard::Cleared;
use crate::link::attitude_target;
use crate::link::counters::LinkState;
use crate::link::request::Action;
use crate::link::session::outbox::command_long;
use crate::link::session::{Event, SetpointError};
#[cfg(test)]
use crate::planted::{self, Planted};

impl Core {
    pub(in crate::link::session) fn send_setpoint(
        &mut self,
        now: HostTime,
        setpoint: &Cleared,
    ) -> Result<(), SetpointError> {
        self.turn(now);
        let vehicle = self.vehicle.as_ref().filter(|_| self.state == LinkState::Connected);
        let (id, to) = vehicle
            .and_then(|vehicle| Some((vehicle.id, vehicle.peer?)))
            .ok_or(SetpointError::NotConnected)?;
        let profile = self.profile.as_ref().ok_or(SetpointError::NotIdentified)?;
        let attitude = self.attitude.filter(|(at, ..)| now.since(*at) < ATTITUDE_FRESH);
        let attitude = attitude.map(|(.., attitude)| attitude);
        let data = attitude_target::encode(setpoint, attitude, profile, &self.settings.thrust)?;
        let data = SET_ATTITUDE_TARGET_DATA {
            time_boot_ms: now.since(self.started).as_millis() as u32,
            target_system: id.system,
            target_component: id.component,
            ..data
        };
        let message = MavMessage::SET_ATTITUDE_TARGET(data);
        self.outbox.push(Some(to), &message);
        #[cfg(test)]
        {
            self.sent = Some((now, to, message));
        }
        Ok(())
    }

    /// A bug that tests plant: sends a setpoint that was not cleared.
    #[cfg(test)]
    pub(super) fn send_again(&mut self, now: HostTime) {
        if let Some((at, to, message)) = &self.sent
            && planted::is(Planted::SentAgain)
            && now.since(*at) > Duration::from_millis(30)
        {
            self.outbox.push(Some(*to), message);
        }
    }

    pub(super) fn request_intervals(&mut self, now: HostTime) {
        let counters = &self.counters;
        if let Some(rate) = self.intervals.next_request(now, |id| counters.total(id)) {
            let interval_us = (1e6 / rate.hz).round() as f32;
            let params = [rate.id as f32, interval_us, 0.0, 0.0, 0.0, 0.0, 0.0];
            self.command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, params, 0);
        }
    }

    pub(in crate::link::session) fn send_requests(&mut self, now: HostTime) {
        self.turn(now);
        let Some(vehicle) = &self.vehicle else { return self.collect_ended() };
        let (id, to) = (vehicle.id, vehicle.peer);
        let (codec, outbox) = (&self.codec, &mut self.outbox);
        let cast = self.profile.as_ref().map(|profile| profile.parameter_cast).unwrap_or_default();
        self.requests.poll(now, |action| {
            let message = match action {
                Action::Command { command, params, confirmation } => {
                    Some(command_long(id, command, params, confirmation))
                }
                Action::ReadParameter(name) => {
                    Some(MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
                        param_index: -1,
                        target_system: id.system,
                        target_component: id.component,
                        param_id: name.into(),
                    }))
                }
                Action::SetParameter { name, value } => codec.parameter_type(name).map(|kind| {
                    MavMessage::PARAM_SET(PARAM_SET_DATA {
                        param_value: parameter_value::encode(value, kind, cast),
                        target_system: id.system,
                        target_component: id.component,
                        param_id: name.into(),
                        param_type: kind,
                    })
                }),
            };
            if let Some(message) = message {
                outbox.push(to, &message);
            }
        });
        self.collect_ended();
    }

    pub(in crate::link::session) fn collect_ended(&mut self) {
        let ended = self.requests.take_ended();
        self.events.extend(ended.map(|(id, request, outcome)| Event::Request {
            id,
            request,
            outcome,
        }));
    }

    pub(super) fn command(&mut self, command: MavCmd, params: [f32; 7], confirmation: u8) {
        let Some(vehicle) = &self.vehicle else { return };
        self.send(&command_long(vehicle.id, command, params, confirmation));
    }

    pub(in crate::link::session) fn set_up_signing(&mut self, key: Option<(&Key, Stamp)>) {
        let Some(vehicle) = &self.vehicle else { return };
        let message = MavMessage::SETUP_SIGNING(SETUP_SIGNING_DATA {
            target_system: vehicle.id.system,
            target_component: vehicle.id.component,
            secret_key: key.map_or_else(Default::default, |(key, _)| *key.bytes()),
            initial_timestamp: key.map_or(0, |(_, time)| time.ticks()),
        });
        self.send(&message);
    }

    /// Queues a message for the vehicle.
    pub(in crate::link::session) fn send(&mut self, message: &MavMessage) {
        let to = self.vehicle.as_ref().and_then(|vehicle| vehicle.peer);
        self.outbox.push(to, message);
    }

    pub(super) fn timesync_target(&self) -> TIMESYNC_DATA {
        let id = self.vehicle.as_ref().map(|vehicle| vehicle.id);
        TIMESYNC_DATA {
            target_system: id.map_or(0, |id| id.system),
            target_component: id.map_or(0, |id| id.component),
            ..Default::default()
        }
    }
}
