//! The newest part of a flight in progress, kept in memory.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use wire::Frame;

use super::Choice;
use super::flight::Flight;
use super::frames::{Frames, UNREAD_FRAME};
use crate::record::{FrameRecord, Record, stated_parameter};

/// Largest number of frames kept: four minutes at the highest rate of a link, some 160 MB.
const FRAMES_MAX: usize = 500_000;

/// Makes the flight that [`open`](super::open) would read from the frames and parameters of the
/// same records; it has no reference and no vehicle file.
#[derive(Debug)]
pub struct Collected {
    /// Length of the part that is kept.
    span: Duration,
    frames: VecDeque<FrameRecord>,
    parameters: BTreeMap<String, f64>,
}

impl Collected {
    /// Keeps the frames of the newest part of a flight, of this length.
    pub fn new(span: Duration) -> Self {
        Self { span, frames: VecDeque::new(), parameters: BTreeMap::new() }
    }

    /// Adds a record: a frame, or facts with the vehicle's parameters. Others are ignored.
    pub fn take(&mut self, record: &Record) {
        match record {
            Record::Frame(frame) => {
                self.frames.push_back(*frame);
                let is_old = |first: &FrameRecord| frame.host.since(first.host) > self.span;
                while self.frames.len() > FRAMES_MAX || self.frames.front().is_some_and(is_old) {
                    self.frames.pop_front();
                }
            }
            Record::Facts(facts) => {
                let stated = facts.iter().filter_map(|(key, value)| stated_parameter(key, value));
                self.parameters.extend(stated);
            }
            _ => {}
        }
    }

    /// The flight so far, named `run`; without streams until the vehicle sends some.
    pub fn flight(&self, run: &str) -> Flight {
        let mut flight = Flight::in_memory(run, "memory");
        flight.facts.parameters.clone_from(&self.parameters);
        let mut frames = Frames::default();
        for record in &self.frames {
            match Frame::parse(record.bytes()) {
                Some(frame) => frames.add(Some(record.host.as_ns()), &frame),
                None => frames.left_out(UNREAD_FRAME, 1),
            }
        }
        // Fails only if a vehicle or a boot is selected.
        let _ = frames.finish(Choice::default(), &mut flight);
        flight
    }
}
