//! What leaves: setpoints that may still be sent, every frame, and the log of both.

use wire::transport::Peer;

use super::Station;
use super::records::tick_record;
use crate::clock::HostTime;
use crate::guard::Cleared;
use crate::link::session;
use crate::log::record::{Direction, FrameRecord, Record, Severity};

impl Station {
    /// The answer to a sample, if it may leave now that the rest of the read is known: what was
    /// heard after the sample may have ended control, or may come from a vehicle that the controller is
    /// not made for. And whatever the controller makes of what is heard after the end: nothing is sent.
    pub(super) fn cleared(&mut self, now: HostTime) -> Option<Cleared> {
        let is_another = self.session.profile().is_some_and(|it| self.profile.as_ref() != Some(it));
        let is_over = self.end.is_some() || is_another || self.is_check;
        if is_over { None } else { self.offboard.as_mut()?.clear(now) }
    }

    /// Gives whether it is on its way.
    pub(super) fn send_setpoint(&mut self, now: HostTime, setpoint: &Cleared) -> bool {
        let sent = self.session.send_setpoint(now, setpoint);
        let before = std::mem::replace(&mut self.setpoint_error, sent.err());
        // Said once, not at every tick.
        if let Err(error) = sent
            && before != Some(error)
        {
            self.tell(now, Severity::Warning, format!("no setpoint is sent: {error}"));
        }
        sent.is_ok()
    }

    /// Gives the frames to send since the last call, each with its peer; `None` is every peer.
    /// First those that are there, a setpoint above all; then those that follow from what was
    /// received. `send` says whether the frame left: one that did not is in no log, and its
    /// setpoint not in that of its tick.
    pub fn transmit(&mut self, now: HostTime, mut send: impl FnMut(Option<Peer>, &[u8]) -> bool) {
        self.send_queued(now, &mut send);
        self.log_ticks();
        self.follow_up(now);
        self.send_queued(now, &mut send);
    }

    fn send_queued(&mut self, now: HostTime, send: &mut impl FnMut(Option<Peer>, &[u8]) -> bool) {
        let Self { session, offboard, records, ticks, setpoints, .. } = self;
        // Each setpoint's frame answers one of these, in their order.
        let mut answered = ticks.iter_mut().filter(|tick| tick.setpoint.is_some());
        session.transmit(|peer, frame| {
            let is_sent = send(peer, frame);
            let record = FrameRecord::from_bytes(Direction::Tx, now, frame);
            if record.as_ref().is_some_and(|record| record.message_id == session::SETPOINT_ID) {
                let tick = answered.next();
                if let Some(offboard) = offboard {
                    offboard.sent(is_sent);
                }
                if is_sent {
                    *setpoints += 1;
                } else if let Some(tick) = tick {
                    tick.withhold();
                }
            }
            records.extend(record.filter(|_| is_sent).map(Record::Frame));
            is_sent
        });
    }

    /// Ticks to the log, once it is known which setpoints left.
    fn log_ticks(&mut self) {
        let ticks = std::mem::take(&mut self.ticks);
        for tick in &ticks {
            self.tracking_error_m = tick.tracking_error;
            self.trajectory_time = tick.trajectory_time;
            let mapped = self.session.to_host(tick.vehicle);
            let sampled = mapped.map_or(tick.host, |sampled| sampled.min(tick.host));
            self.records.push(Record::Tick(tick_record(tick, sampled)));
        }
        self.ticks = ticks;
        self.ticks.clear();
    }
}
