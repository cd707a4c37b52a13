//! A whole log in memory, in the order of time.

use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;
use std::sync::Arc;

use vehicle::frame::Ned;

use super::trail::Trail;
use crate::clock::HostTime;
use crate::log::LogReader;
use crate::log::reader::{Channel, Message, ReadError};
use crate::log::schema::{Flat, PositionSample, ReferenceMessage, StateMessage, TruthMessage};

/// Most points of the plan that are drawn.
const PLAN_POINTS: usize = 5000;

/// The messages of a log for playback, the vehicle's path and its reference.
#[derive(Debug, Default)]
pub struct Recording {
    pub(super) channels: Vec<Arc<Channel>>,
    pub(super) messages: Vec<Recorded>,
    bodies: Vec<u8>,
    /// Facts about the run.
    pub(super) run: BTreeMap<String, String>,
    /// The vehicle's path, thinned, with its times.
    pub(super) path: Vec<(HostTime, Ned)>,
    pub(super) plan: Vec<Ned>,
    /// The unreadable parts of the log, in words.
    pub damages: Vec<String>,
}

/// One message.
#[derive(Debug)]
pub(super) struct Recorded {
    pub time: HostTime,
    /// Index of its channel.
    pub channel: usize,
    body: Range<usize>,
}

impl Recording {
    /// Reads a log to its end.
    ///
    /// # Errors
    /// [`ReadError`], if the source cannot be read; damaged parts are left out.
    pub fn read(mut reader: LogReader<impl Read>) -> Result<Self, ReadError> {
        let mut log = Self::default();
        let mut paths = Paths::default();
        while let Some(message) = reader.next_message()? {
            paths.take(&message);
            let known = log.channels.iter().position(|known| *known == message.channel);
            let channel = known.unwrap_or_else(|| {
                log.channels.push(Arc::clone(&message.channel));
                log.channels.len() - 1
            });
            let from = log.bodies.len();
            log.bodies.extend_from_slice(message.data);
            let body = from..log.bodies.len();
            log.messages.push(Recorded { time: message.log_time, channel, body });
        }
        log.messages.sort_by_key(|message| message.time);
        log.run.clone_from(reader.run());
        log.damages.clone_from(&reader.ending().damages);
        (log.path, log.plan) = paths.drawn();
        Ok(log)
    }

    /// The bytes of a message.
    pub(super) fn body(&self, message: &Recorded) -> &[u8] {
        self.bodies.get(message.body.clone()).unwrap_or_default()
    }

    /// Times of the first and the last message; `None` without any.
    pub fn span(&self) -> Option<(HostTime, HostTime)> {
        Some((self.messages.first()?.time, self.messages.last()?.time))
    }

    /// The number of messages up to and including `time`.
    pub(super) fn up_to(&self, time: HostTime) -> usize {
        self.messages.partition_point(|message| message.time <= time)
    }

    /// The last two minutes of the path before `time`.
    pub(super) fn trail(&self, time: HostTime) -> &[(HostTime, Ned)] {
        let end = self.path.partition_point(|(at, _)| *at <= time);
        self.path.get(end.saturating_sub(Trail::POINTS)..end).unwrap_or_default()
    }
}

/// The vehicle's path according to each topic with a position; the first one with data is used.
#[derive(Default)]
struct Paths {
    by_topic: [Vec<(HostTime, Ned)>; 3],
    plan: Vec<Ned>,
}

impl Paths {
    fn take(&mut self, message: &Message<'_>) {
        let time = message.log_time;
        let (topic, position) = match message.channel.schema.as_str() {
            StateMessage::NAME => match message.decode::<StateMessage>() {
                Some(m) => (0, Ned::new(m.p_n_m, m.p_e_m, m.p_d_m)),
                None => return,
            },
            PositionSample::NAME => match message.decode::<PositionSample>() {
                Some(m) => (1, Ned::new(m.p_n_m, m.p_e_m, m.p_d_m)),
                None => return,
            },
            TruthMessage::NAME => match message.decode::<TruthMessage>() {
                Some(m) => (2, Ned::new(m.p_n_m, m.p_e_m, m.p_d_m)),
                None => return,
            },
            ReferenceMessage::NAME => {
                let reference = message.decode::<ReferenceMessage>();
                // Before and after the trajectory the reference leads to it and away from it.
                if let Some(m) = reference.filter(|m| m.trajectory_time_s.is_finite()) {
                    self.plan.push(Ned::new(m.p_n_m, m.p_e_m, m.p_d_m));
                }
                return;
            }
            _ => return,
        };
        let path = &mut self.by_topic[topic];
        let is_due = path.last().is_none_or(|(last, _)| time.since(*last) >= Trail::PERIOD);
        if is_due && position.to_array().iter().all(|x| x.is_finite()) {
            path.push((time, position));
        }
    }

    fn drawn(self) -> (Vec<(HostTime, Ned)>, Vec<Ned>) {
        let mut path = self.by_topic.into_iter().find(|path| !path.is_empty()).unwrap_or_default();
        path.sort_by_key(|(time, _)| *time);
        let every = self.plan.len().div_ceil(PLAN_POINTS).max(1);
        (path, self.plan.into_iter().step_by(every).collect())
    }
}
