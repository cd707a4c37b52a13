//! Transmission: the setpoints that may still leave, all queued frames, and the log of both.

use wire::transport::Peer;

use super::Station;
use super::records::tick_record;
use crate::clock::HostTime;
use crate::guard::Cleared;
use crate::link::session;
use crate::log::record::{Direction, FrameRecord, Record, Severity};

impl Station {
    /// The answer to a sample, if it may leave once the rest of the read is known. A later message
    /// may have ended control, or may come from a vehicle that the controller was not designed for.
    /// After the end, nothing is sent whatever the controller makes of further messages.
    pub(super) fn cleared(&mut self, now: HostTime) -> Option<Cleared> {
        let is_another = self.session.profile().is_some_and(|it| self.profile.as_ref() != Some(it));
        let is_over = self.end.is_some() || is_another || self.is_check;
        if is_over { None } else { self.offboard.as_mut()?.clear(now) }
    }

    /// Queues a setpoint; returns whether it will be sent.
    pub(super) fn send_setpoint(&mut self, now: HostTime, setpoint: &Cleared) -> bool {
        let sent = self.session.send_setpoint(now, setpoint);
        let before = std::mem::replace(&mut self.setpoint_error, sent.err());
        // An event reports this once, not at every tick.
        if let Err(error) = sent
            && before != Some(error)
        {
            self.report(now, Severity::Warning, format!("no setpoint is sent: {error}"));
        }
        sent.is_ok()
    }

    /// Passes the frames to send since the last call to `send`, each with its peer; `None` means
    /// every peer. Queued frames come first, a setpoint before all others, then those that follow
    /// from received messages. `send` returns whether the frame left. The log omits a frame that
    /// did not leave, and its tick has no setpoint.
    pub fn transmit(&mut self, now: HostTime, mut send: impl FnMut(Option<Peer>, &[u8]) -> bool) {
        self.send_queued(now, &mut send);
        self.log_ticks();
        self.follow_up(now);
        self.send_queued(now, &mut send);
    }

    fn send_queued(&mut self, now: HostTime, send: &mut impl FnMut(Option<Peer>, &[u8]) -> bool) {
        let Self { session, offboard, records, ticks, setpoints, .. } = self;
        // The setpoint frames answer these ticks, in the same order.
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

    /// Records the ticks once it is known which setpoints left.
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
