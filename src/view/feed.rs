//! Encodes records for the topics that viewers subscribed to.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use foxglove::{PartialMetadata, RawChannel};
use prost::Message;
use vehicle::frame::{Frd, Ned};

use super::server::{Server, ViewError, ViewSettings};
use super::trail::Trail;
use super::write::Changes;
use crate::clock::HostTime;
use crate::log::encoder::{Definition, Encoder, MessageSink, Times, Topic};
use crate::log::record::{PARAMETER_FACT, Record, Tick};
use crate::log::schema::{self, Flat, StatusMessage};
use crate::log::sink::Listener;
use crate::log::viewer;
use crate::station::Status;

/// Periods at which viewers receive the time and the trail.
const TIME_PERIOD: Duration = Duration::from_millis(100);
const TRAIL_PERIOD: Duration = Duration::from_millis(500);
/// Movement of the plan's origin above which the plan is drawn again, m.
const ORIGIN_MOVED_M: f64 = 0.1;
/// Number of past events that a new viewer receives.
const EVENTS: usize = 100;

pub(super) const TRAIL_COLOUR: [f64; 4] = [0.85, 0.37, 0.05, 0.9];
pub(super) const PLAN_COLOUR: [f64; 4] = [0.12, 0.47, 0.71, 0.7];
const TUBE_COLOUR: [f64; 4] = [0.12, 0.47, 0.71, 0.25];

/// The path to fly: positions relative to the trajectory's origin, at a fixed period from its
/// beginning.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoursePath {
    /// Time between two points, s.
    pub period_s: f64,
    /// The points, m.
    pub points: Vec<Ned>,
    /// Helix around the points at the radius of the plan's tube, m; empty without a tube.
    pub tube: Vec<Ned>,
}

impl CoursePath {
    /// The origin for which the desired position at `t` is `desired`; `None` outside the path.
    fn origin(&self, t: f64, desired: Ned) -> Option<Ned> {
        let at = t / self.period_s;
        if !(at.is_finite() && at >= 0.0) {
            return None;
        }
        let index = at as usize;
        let (a, b) = (*self.points.get(index)?, *self.points.get(index + 1)?);
        Some(desired - (a + (b - a) * at.fract()))
    }
}

/// Handle to the view of a run. Viewers are disconnected when this and the feed are dropped.
pub struct LiveView {
    server: Arc<Server>,
    status: Arc<RawChannel>,
}

/// Receives the records of a run, in the thread that writes the log.
pub struct LiveFeed {
    server: Arc<Server>,
    channels: Vec<Arc<RawChannel>>,
    encoder: Encoder,
    body: Vec<u8>,
    course: CoursePath,
    origin: Option<Ned>,
    trail: Trail,
    trail_due: HostTime,
    time_due: HostTime,
    events: VecDeque<Record>,
    /// Whether only the simulator's true state gives the position.
    is_alone: bool,
}

impl LiveView {
    /// Starts a server for a vehicle with rotors at these positions in body axes, m, and its path
    /// `course`.
    ///
    /// # Errors
    /// [`ViewError`], mostly because the address is taken.
    pub fn start(
        settings: ViewSettings,
        rotors: &[Frd],
        course: CoursePath,
    ) -> Result<(Self, LiveFeed), ViewError> {
        let server = Arc::new(Server::start(settings, None)?);
        let channels = Topic::ALL.map(|topic| server.advertise(&topic.definition()));
        let status = Definition {
            topic: "/status",
            schema: StatusMessage::NAME,
            descriptor: schema::descriptor::<StatusMessage>(),
        };
        let status = server.advertise(&status)?;
        let feed = LiveFeed {
            server: Arc::clone(&server),
            channels: channels.into_iter().collect::<Result<_, _>>()?,
            encoder: Encoder::new(rotors),
            body: Vec::new(),
            course,
            origin: None,
            trail: Trail::default(),
            trail_due: HostTime::default(),
            time_due: HostTime::default(),
            events: VecDeque::new(),
            is_alone: false,
        };
        Ok((Self { server, status }, feed))
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// The queue of viewers' changes, if they may make any; `None` on a second call.
    pub fn take_changes(&self) -> Option<Changes> {
        self.server.take_changes()
    }

    /// Publishes the status of the flight.
    pub fn show(&self, now: HostTime, status: &Status) {
        self.server.show_adjusted(&status.adjusted);
        if self.status.has_sinks() {
            let time = PartialMetadata { log_time: Some(now.as_ns()) };
            self.status.log_with_meta(&message(status).encode_to_vec(), time);
        }
    }
}

fn message(status: &Status) -> StatusMessage {
    let armed = |armed| if armed { "armed" } else { "disarmed" };
    let mode = |mode| status.mode_name.map_or(format!("{mode:#010x}"), str::to_owned);
    let (time, length) = status.progress.unwrap_or((f64::NAN, f64::NAN));
    StatusMessage {
        link: status.link.to_owned(),
        vehicle: status.vehicle.unwrap_or_default().to_owned(),
        phase: status.phase.map_or("", |phase| phase.name()).to_owned(),
        mode: status.mode.map(mode).unwrap_or_default(),
        armed: status.armed.map_or("", armed).to_owned(),
        tick_rate_hz: status.tick_rate_hz,
        setpoints: status.setpoints,
        tracking_error_m: status.tracking_error_m,
        trajectory_time_s: time,
        trajectory_length_s: length,
        battery_ratio: status.battery.unwrap_or(f64::NAN),
        rtt_s: status.round_trip_s.unwrap_or(f64::NAN),
    }
}

/// Passes messages to the topics that have subscribers.
struct ToViewers<'a> {
    channels: &'a [Arc<RawChannel>],
    body: &'a mut Vec<u8>,
    /// One viewer instead of all.
    only: Option<foxglove::SinkId>,
}

impl MessageSink for ToViewers<'_> {
    fn put(&mut self, topic: Topic, times: Times, message: &impl Message) -> io::Result<()> {
        let Some(channel) = self.channels.get(topic as usize).filter(|c| c.has_sinks()) else {
            return Ok(());
        };
        self.body.clear();
        message.encode_raw(self.body);
        let time = PartialMetadata { log_time: Some(times.log.as_ns()) };
        channel.log_with_meta_to_sink(self.body, time, self.only);
        Ok(())
    }
}

impl Listener for LiveFeed {
    fn on_record(&mut self, record: &Record) {
        let is_watched = self.server.is_watched();
        if is_watched {
            self.greet();
        }
        match record {
            Record::Tick(tick) => self.follow(tick),
            Record::Truth { stamp, truth } if self.is_alone => {
                self.trail.add(stamp.host, truth.state.position);
            }
            Record::Event { .. } => {
                if self.events.len() == EVENTS {
                    self.events.pop_front();
                }
                self.events.push_back(record.clone());
            }
            Record::Facts(facts) => {
                let parameters = facts.iter().filter(|(name, _)| name.starts_with(PARAMETER_FACT));
                self.server.add_parameters(parameters.map(|(k, v)| (k.clone(), v.clone())));
            }
            _ => {}
        }
        if !is_watched {
            return;
        }
        let Self { channels, body, encoder, .. } = self;
        // Sending to viewers cannot fail.
        let _ = encoder.encode(record, &mut ToViewers { channels, body, only: None });
        match record {
            Record::Tick(tick) => self.draw(tick.stamp.host),
            Record::Truth { stamp, truth } if self.is_alone => {
                let times = Times { log: stamp.host, publish: stamp.sampled };
                let mut out = ToViewers { channels, body, only: None };
                let _ = encoder.encode_pose(times, &truth.state, &mut out);
                self.draw(stamp.host);
            }
            _ => {}
        }
    }
}

impl LiveFeed {
    /// The feed of a simulated vehicle without a controller: its true state replaces the ticks.
    pub fn alone(self) -> Self {
        Self { is_alone: true, ..self }
    }

    fn follow(&mut self, tick: &Tick) {
        self.trail.add(tick.stamp.host, tick.state.position);
        if let (Some(time), Some(desired)) = (tick.trajectory_time, tick.desired)
            && let Some(origin) = self.course.origin(time, desired)
            // A moved goal moves the plan too.
            && self.origin.is_none_or(|shown| (origin - shown).norm() > ORIGIN_MOVED_M)
        {
            self.origin = Some(origin);
            self.trail_due = HostTime::default();
        }
    }

    /// Sends new viewers what is sent only once.
    fn greet(&mut self) {
        for (sink, topic) in self.server.take_newcomers() {
            if topic == Topic::Scene.definition().topic {
                self.encoder.repeat_scene();
                self.trail_due = HostTime::default();
            } else if topic == Topic::Log.definition().topic {
                let Self { channels, body, encoder, events, .. } = self;
                let mut out = ToViewers { channels, body, only: Some(sink) };
                for event in events.iter() {
                    let _ = encoder.encode(event, &mut out);
                }
            }
        }
    }

    /// Sends the time, the trail and the plan when they are due.
    fn draw(&mut self, now: HostTime) {
        if now >= self.time_due {
            self.time_due = now + TIME_PERIOD;
            self.server.send_time(now.as_ns());
        }
        if now < self.trail_due {
            return;
        }
        let is_first = self.trail_due == HostTime::default();
        self.trail_due = now + TRAIL_PERIOD;
        let Self { channels, body, trail, course, origin, .. } = self;
        let mut out = ToViewers { channels, body, only: None };
        let trail = viewer::line(now, "trail", TRAIL_COLOUR, 2.0, trail.points());
        let _ = out.put(Topic::Scene, Times::host(now), &trail);
        if let Some(origin) = origin.filter(|_| is_first) {
            let points = course.points.iter().map(|point| *point + origin);
            let plan = viewer::line(now, "plan", PLAN_COLOUR, 1.5, points);
            let _ = out.put(Topic::Scene, Times::host(now), &plan);
            if !course.tube.is_empty() {
                let points = course.tube.iter().map(|point| *point + origin);
                let tube = viewer::line(now, "tube", TUBE_COLOUR, 1.0, points);
                let _ = out.put(Topic::Scene, Times::host(now), &tube);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origin_is_the_offset_of_the_path() {
        let points = [0.0, 1.0, 3.0].map(|north| Ned::new(north, 0.0, -1.0)).to_vec();
        let course = CoursePath { period_s: 0.5, points, ..CoursePath::default() };
        let origin = course.origin(0.75, Ned::new(12.0, 5.0, -3.0));
        assert_eq!(origin, Some(Ned::new(10.0, 5.0, -2.0)));
        for outside in [-0.1, 1.1, f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(course.origin(outside, Ned::zero()), None, "{outside}");
        }
    }
}
