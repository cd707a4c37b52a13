//! Whether a frame of the vehicle says anything that is not known yet.

use mavlink::MessageData;
use message::codec;
use wire::Frame;
use wire::dialect::*;

use crate::clock::HostTime;
use crate::link::mode_reports::{ModeReport, ModeReports, Newness};
use crate::link::sequence::{Order, Sequence};
#[cfg(test)]
use crate::planted::{self, Planted};

/// Number of quantities that the vehicle repeats without a stamp: its mode, whether it is landed,
/// its health, its battery.
const UNSTAMPED_QUANTITIES: usize = 4;

/// Which of them a message with this id carries.
fn unstamped_quantity(id: u32) -> Option<usize> {
    match id {
        HEARTBEAT_DATA::ID | CURRENT_MODE_DATA::ID => Some(0),
        EXTENDED_SYS_STATE_DATA::ID => Some(1),
        SYS_STATUS_DATA::ID => Some(2),
        BATTERY_STATUS_DATA::ID => Some(3),
        _ => None,
    }
}

/// The mode that a frame carries, if any: the first field of either message.
fn reported_mode(frame: &Frame) -> Option<u32> {
    matches!(frame.id(), HEARTBEAT_DATA::ID | CURRENT_MODE_DATA::ID).then(|| {
        // A payload's trailing zeros are not sent.
        let mut mode = [0; 4];
        mode.iter_mut().zip(frame.payload()).for_each(|(to, from)| *to = *from);
        u32::from_le_bytes(mode)
    })
}

/// Whether a HEARTBEAT reports that the motors are armed; `None` for any other frame.
fn reported_arming(frame: &Frame) -> Option<bool> {
    // Behind the mode, the vehicle's type and its autopilot.
    const FLAGS: usize = 6;
    let flags = frame.payload().get(FLAGS).copied().unwrap_or(0);
    let is_armed = flags & MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED.bits() != 0;
    (frame.id() == HEARTBEAT_DATA::ID).then_some(is_armed)
}

/// The vehicle's frames received so far, as far as they decide whether another one is new.
#[derive(Debug, Default)]
pub(super) struct Novelty {
    sequence: Sequence,
    /// Place in the sequence of the newest message on each unstamped quantity.
    newest_places: [u64; UNSTAMPED_QUANTITIES],
    /// Place of the newest HEARTBEAT, which alone reports whether the motors are armed.
    newest_heartbeat: u64,
    mode_reports: ModeReports,
}

impl Novelty {
    /// Starts a new sequence: the vehicle, or the path to it, changed.
    pub fn restart(&mut self) {
        self.sequence.restart();
    }

    /// Number of frames that the link lost.
    pub fn lost(&self) -> u64 {
        self.sequence.lost()
    }

    /// Whether the frame is new: it was not received before, and its mode or condition is not older
    /// than the known one. `obeys` is the mode in which setpoints are obeyed, where it is known.
    pub fn of(&mut self, now: HostTime, frame: &Frame, obeys: Option<u32>) -> Newness {
        let (number, is_unique) = (frame.sequence(), codec::is_stamped(frame.id()));
        let is_next = self.sequence.is_next(number);
        let place = match self.sequence.take(now, number, frame.bytes(), is_unique) {
            Order::Copy => {
                if reported_mode(frame).is_some() {
                    self.mode_reports.copied(now, frame.bytes());
                }
                return Newness::Old;
            }
            Order::New(place) | Order::Overtaken(place) => place,
        };
        self.mode_reports.frame_arrived(now);
        let is_settled = !self.sequence.is_unsettled(now);
        if !is_settled && reported_mode(frame).is_none() && self.mode_reports.unsettled() {
            return Newness::Doubtful;
        }
        let Some(newest) =
            unstamped_quantity(frame.id()).and_then(|index| self.newest_places.get_mut(index))
        else {
            return Newness::New;
        };
        let is_newer = place > *newest;
        *newest = place.max(*newest);
        #[cfg(test)]
        if planted::is(Planted::OlderHeartbeat) {
            return Newness::New;
        }
        match (reported_mode(frame), is_newer) {
            (None, true) => Newness::New,
            (None, false) => Newness::Old,
            (Some(mode), _) => {
                let arming = reported_arming(frame);
                let is_overtaken = is_settled && place < self.newest_heartbeat;
                if arming.is_some() {
                    self.newest_heartbeat = place.max(self.newest_heartbeat);
                }
                self.mode_reports.judge(&ModeReport {
                    frame: frame.bytes(),
                    mode,
                    obeys,
                    is_armed: arming.filter(|_| !is_overtaken),
                    is_newer,
                    is_settled,
                    is_next,
                })
            }
        }
    }
}
