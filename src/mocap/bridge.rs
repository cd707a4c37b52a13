//! The bridge for one body: samples of a room in, poses to forward and news out.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::time::Duration;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Attitude, Ned};

use super::fault::{Fault, FaultCounts};
use super::room_clock::RoomClock;
use super::room_frame::RoomFrame;
use super::sample::Sample;
use super::settings::MocapSettings;
use super::watch::{Seen, Watch};
use crate::clock::HostTime;

/// Tolerance of a quaternion's length, for senders that round.
const UNIT_TOLERANCE: f64 = 0.01;
/// Most names of other bodies that are kept for messages.
const NAMES_MAX: usize = 8;
/// Time after which a recurring fault is reported again.
const REPORTED_AGAIN: Duration = Duration::from_secs(10);
/// Time without any accepted stamp, with all of them out of order or ahead, after which the room's
/// clock was set, s.
const CLOCK_SET_S: f64 = 1.0;
/// Most news that are kept until they are taken.
const NEWS_MAX: usize = 32;

/// A pose to forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Host time at which the cameras saw it.
    pub at: HostTime,
    /// Position in the vehicle's world, m.
    pub position: Ned,
    /// Attitude of the vehicle's body.
    pub attitude: Attitude,
    /// Number of restarts of the poses, modulo 256.
    pub reset_count: u8,
}

/// News for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// The body's poses are accepted, for the first time or again.
    Accepted,
    /// Poses are no longer forwarded, or one datagram was not. The text is the reason, where there
    /// is one.
    Fault(Fault, Option<String>),
    /// The room's clock was set; its offset is estimated again.
    ClockSet,
}

impl fmt::Display for News {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Accepted => f.write_str("the body is seen: its poses are forwarded"),
            Self::Fault(fault, None) => write!(f, "not forwarded: {fault}"),
            Self::Fault(fault, Some(why)) => write!(f, "not forwarded: {fault} ({why})"),
            Self::ClockSet => {
                f.write_str("the room's clock was set; its offset is estimated again")
            }
        }
    }
}

/// Counters of poses and their fate.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Tally {
    /// Poses of the body that arrived.
    pub heard: u64,
    /// Poses of other bodies that arrived.
    pub others: u64,
    /// Poses that were accepted and young enough.
    pub good: u64,
    /// Poses that were forwarded, at most at `rate_hz`.
    pub forwarded: u64,
    /// Mean age of the forwarded poses on arrival, s.
    pub age_mean_s: f64,
    /// Largest age of the forwarded poses on arrival, s.
    pub age_max_s: f64,
    /// Number of restarts of the poses at another place.
    pub resets: u64,
    /// Number of losses of the body after its poses were accepted.
    pub losses: u64,
    /// Poses and datagrams that were not forwarded, by reason.
    pub faults: FaultCounts,
}

/// The bridge of one body.
#[derive(Debug)]
pub struct Bridge {
    settings: MocapSettings,
    body: String,
    frame: RoomFrame,
    clock: RoomClock,
    watch: Watch,
    started: HostTime,
    /// Stamp of the body's newest sample, s of the room's clock, and its arrival.
    newest: Option<(f64, HostTime)>,
    /// Since when every stamp was wrong.
    wrong_since: Option<HostTime>,
    last_pose: Option<HostTime>,
    last_packet: Option<HostTime>,
    /// The earliest capture to forward next, s of the room's clock.
    next_s: f64,
    names: BTreeSet<String>,
    reported: BTreeMap<Fault, HostTime>,
    news: VecDeque<News>,
    tally: Tally,
    was_held: bool,
}

impl Bridge {
    /// A bridge for `body` that starts at `now`.
    pub fn new(body: String, settings: MocapSettings, now: HostTime) -> Self {
        let frame = RoomFrame::new(
            settings.up,
            settings.x_heading_deg.to_radians(),
            settings.nose_deg.to_radians(),
        );
        Self {
            watch: Watch::new(settings.watch),
            settings,
            body,
            frame,
            clock: RoomClock::default(),
            started: now,
            newest: None,
            wrong_since: None,
            last_pose: None,
            last_packet: None,
            next_s: f64::NEG_INFINITY,
            names: BTreeSet::new(),
            reported: BTreeMap::new(),
            news: VecDeque::new(),
            tally: Tally::default(),
            was_held: false,
        }
    }

    /// Takes a sample that arrived at `now`; returns the pose to forward, if any. A vehicle that
    /// may be armed counts as armed.
    pub fn take(&mut self, now: HostTime, sample: &Sample, is_armed: bool) -> Option<Pose> {
        self.last_packet = Some(now);
        if sample.body != self.body {
            self.take_other(sample);
            return None;
        }
        self.tally.heard += 1;
        self.last_pose = Some(now);
        match self.judge(now, sample, is_armed) {
            Ok(pose) => pose,
            Err(fault) => {
                self.fault(now, fault, None);
                None
            }
        }
    }

    /// Notes a datagram that violates its protocol.
    pub fn malformed(&mut self, now: HostTime, why: String) {
        self.last_packet = Some(now);
        self.fault(now, Fault::Malformed, Some(why));
    }

    /// Checks the time: a body that has been silent for too long is lost.
    pub fn tick(&mut self, now: HostTime) {
        let gap_s = self.settings.watch.gap_s;
        let is_silent = |at: HostTime| now.since(at).as_secs_f64() > gap_s;
        if self.watch.holds() && self.last_pose.is_some_and(is_silent) {
            self.watch.lose(Fault::Silent);
            self.fault(now, Fault::Silent, None);
        }
    }

    /// The next of the news, oldest first.
    pub fn next_news(&mut self) -> Option<News> {
        self.news.pop_front()
    }

    /// The counters so far.
    pub fn tally(&self) -> Tally {
        let mut tally = self.tally;
        // The field holds the sum until here.
        tally.age_mean_s /= tally.forwarded.max(1) as f64;
        tally
    }

    /// Whether the body's poses are accepted at present.
    pub fn holds(&self) -> bool {
        self.watch.holds()
    }

    /// What the bridge waits for from the room, if anything.
    pub fn waits_for(&self, now: HostTime) -> Option<String> {
        if self.holds() {
            return None;
        }
        let body = &self.body;
        let recent = |at: Option<HostTime>| at.filter(|at| now.since(*at) < Duration::from_secs(2));
        Some(if recent(self.last_pose).is_some() {
            format!("waiting for steady and plausible poses of {body:?}")
        } else if recent(self.last_packet).is_some() && !self.names.is_empty() {
            let names: Vec<_> = self.names.iter().map(|name| format!("{name:?}")).collect();
            format!("waiting for {body:?}: the room sends {} (--body)", names.join(", "))
        } else if recent(self.last_packet).is_some() {
            "waiting for the room: its data violates its protocol".to_owned()
        } else {
            "waiting for the room: nothing arrives; check that it streams to this address and \
             port, and that no firewall blocks it"
                .to_owned()
        })
    }

    fn judge(
        &mut self,
        now: HostTime,
        sample: &Sample,
        is_armed: bool,
    ) -> Result<Option<Pose>, Fault> {
        let seen = self.placed(now, sample)?;
        let now_s = self.seconds(now);
        let host_s = self.clock.host_s(now_s, seen.at_s).unwrap_or(now_s);
        let at_s = host_s.min(now_s) - self.settings.latency_s;
        let accepted = self.watch.see(seen, is_armed)?;
        if accepted.is_anew {
            self.tally.resets += 1;
        }
        if !self.was_held {
            self.was_held = true;
            self.report(News::Accepted);
        }
        let age_s = now_s - at_s;
        if age_s > self.settings.age_max_s {
            return Err(Fault::Old);
        }
        self.tally.good += 1;
        let period = 1.0 / self.settings.rate_hz;
        // A thousandth of the period compensates for rounded stamps.
        if seen.at_s < self.next_s - 1e-3 * period {
            return Ok(None);
        }
        let is_regular = seen.at_s < self.next_s + period;
        self.next_s = if is_regular { self.next_s } else { seen.at_s } + period;
        self.tally.forwarded += 1;
        self.tally.age_mean_s += age_s;
        self.tally.age_max_s = self.tally.age_max_s.max(age_s);
        Ok(Some(Pose {
            at: self.started + Duration::from_secs_f64(at_s.max(0.0)),
            position: seen.position,
            attitude: seen.attitude,
            reset_count: self.tally.resets as u8,
        }))
    }

    /// Converts a sample to a pose in the vehicle's world. Its time stays that of the room's clock.
    fn placed(&mut self, now: HostTime, sample: &Sample) -> Result<Seen, Fault> {
        let numbers = sample.position_m.iter().chain(&sample.rotation);
        let stamps = [sample.captured_s, sample.sent_s.unwrap_or(0.0)];
        if !sample.is_tracked {
            self.watch.lose(Fault::NotTracked);
            return Err(Fault::NotTracked);
        }
        // Beyond this a stamp has no millisecond resolution.
        if !numbers.chain(&stamps).all(|number| number.is_finite() && number.abs() < 1e12) {
            return Err(Fault::NotANumber);
        }
        let rotation = unit(sample.rotation).ok_or(Fault::NotAUnit)?;
        if self.newest.is_some_and(|(newest, _)| sample.captured_s <= newest) {
            self.doubt_clock(now, sample.captured_s);
            return Err(Fault::OutOfOrder);
        }
        let now_s = self.seconds(now);
        if self.clock.observe(now_s, sample.sent_s.unwrap_or(sample.captured_s)).is_err() {
            self.doubt_clock(now, sample.captured_s);
            return Err(Fault::Ahead);
        }
        self.wrong_since = None;
        self.newest = Some((sample.captured_s, now));
        Ok(Seen {
            at_s: sample.captured_s,
            position: self.frame.position(sample.position_m),
            attitude: self.frame.attitude(rotation),
        })
    }

    fn take_other(&mut self, sample: &Sample) {
        self.tally.others += 1;
        if self.names.len() < NAMES_MAX && !self.names.contains(&sample.body) {
            self.names.insert(sample.body.clone());
        }
        let mut numbers = sample.position_m.iter().chain([&sample.captured_s]);
        if sample.is_tracked && numbers.all(|number| number.is_finite()) {
            let position = self.frame.position(sample.position_m);
            let at_s = sample.captured_s;
            let attitude = Attitude::default();
            self.watch.see_other(&sample.body, Seen { at_s, position, attitude });
        }
    }

    /// Restarts the clock estimate once stamps have stayed wrong: the room's clock was set.
    fn doubt_clock(&mut self, now: HostTime, stamp_s: f64) {
        let since = *self.wrong_since.get_or_insert(now);
        if now.since(since).as_secs_f64() >= CLOCK_SET_S {
            self.clock = RoomClock::default();
            self.wrong_since = None;
            if let Some((newest_s, at)) = self.newest.take() {
                let by_s = stamp_s - (newest_s + now.since(at).as_secs_f64());
                self.watch.shift(by_s);
                self.next_s = f64::NEG_INFINITY;
            }
            self.report(News::ClockSet);
        }
    }

    fn fault(&mut self, now: HostTime, fault: Fault, why: Option<String>) {
        self.tally.faults.count(fault);
        if self.was_held && !self.watch.holds() {
            self.was_held = false;
            self.tally.losses += 1;
        }
        let is_reported = match fault {
            // Either another fault was already reported, or nothing is wrong.
            Fault::Settling => false,
            Fault::Frozen => self.newest.is_some_and(|(at_s, _)| self.watch.is_frozen(at_s)),
            _ => true,
        };
        let is_new = self.reported.get(&fault).is_none_or(|at| now.since(*at) > REPORTED_AGAIN);
        if is_reported {
            // A continuing fault is not reported again.
            self.reported.insert(fault, now);
        }
        if is_reported && is_new {
            self.report(News::Fault(fault, why));
        }
    }

    fn report(&mut self, news: News) {
        if self.news.len() < NEWS_MAX {
            self.news.push_back(news);
        }
    }

    /// Seconds since the bridge started.
    fn seconds(&self, now: HostTime) -> f64 {
        now.since(self.started).as_secs_f64()
    }
}

/// A quaternion of nearly unit length, normalised; `None` if its length is off.
fn unit(q: [f64; 4]) -> Option<[f64; 4]> {
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    ((norm - 1.0).abs() <= UNIT_TOLERANCE).then(|| q.map(|c| c / norm))
}

#[cfg(test)]
mod tests;
