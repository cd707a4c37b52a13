//! Plays a log to viewers, who may pause it, change its speed and seek in it.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use foxglove::websocket::{PlaybackCommand, PlaybackControlRequest, PlaybackState, PlaybackStatus};
use foxglove::{PartialMetadata, RawChannel, Schema};
use prost::Message;

use super::feed::{PLAN_COLOUR, TRAIL_COLOUR};
use super::recording::Recording;
use super::server::{Server, ViewError, ViewSettings};
use crate::clock::HostTime;
use crate::log::encoder::Topic;
use crate::log::viewer;

/// Period at which messages are sent while it plays.
const STEP: Duration = Duration::from_millis(20);
/// Periods at which viewers receive the time and the trail, on the wall clock.
const TIME_PERIOD: Duration = Duration::from_millis(100);
const TRAIL_PERIOD: Duration = Duration::from_millis(500);
/// Number of earlier events that are sent after a seek.
const EVENTS: usize = 100;
/// Speeds that a viewer may request.
const SPEED: std::ops::RangeInclusive<f32> = 0.01..=100.0;

/// The state of the playback.
#[derive(Debug)]
struct Progress {
    status: PlaybackStatus,
    speed: f32,
    /// The log's time at `since`.
    time: HostTime,
    since: Instant,
    has_sought: bool,
    span: (HostTime, HostTime),
}

impl Progress {
    /// The log's time now.
    fn now(&self, wall: Instant) -> HostTime {
        if self.status != PlaybackStatus::Playing {
            return self.time;
        }
        let passed = wall.saturating_duration_since(self.since).mul_f32(self.speed);
        (self.time + passed).min(self.span.1)
    }

    /// Applies a request; times outside the log are clamped to it.
    fn take(&mut self, request: &PlaybackControlRequest, wall: Instant) {
        let (first, last) = self.span;
        self.time = self.now(wall);
        self.since = wall;
        if let Some(seek) = request.seek_time {
            self.time = HostTime::from_ns(seek).clamp(first, last);
            self.has_sought = true;
        }
        if SPEED.contains(&request.playback_speed) {
            self.speed = request.playback_speed;
        }
        self.status = match request.playback_command {
            PlaybackCommand::Pause => PlaybackStatus::Paused,
            PlaybackCommand::Play => {
                // From the end it starts again at the beginning.
                if self.time >= last {
                    self.time = first;
                    self.has_sought = true;
                }
                PlaybackStatus::Playing
            }
        };
    }

    fn state(&self, wall: Instant, did_seek: bool, request_id: Option<String>) -> PlaybackState {
        PlaybackState {
            status: self.status,
            current_time: self.now(wall).as_ns(),
            playback_speed: self.speed,
            did_seek,
            request_id,
        }
    }
}

/// State shared by the player's thread and the server's.
#[derive(Debug)]
struct Player {
    progress: Mutex<Progress>,
    changed: Condvar,
    is_over: AtomicBool,
}

impl Player {
    fn lock(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A log that is being played, until this is dropped.
pub struct Playback {
    player: Arc<Player>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

impl Playback {
    /// Plays a recording from its beginning, or waits there for a viewer to play it.
    ///
    /// # Errors
    /// [`ViewError`], mostly because the address is taken.
    pub fn start(
        settings: ViewSettings,
        recording: Recording,
        is_paused: bool,
    ) -> Result<Self, ViewError> {
        let span = recording.span().unwrap_or_default();
        let status = if is_paused { PlaybackStatus::Paused } else { PlaybackStatus::Playing };
        let progress = Progress {
            status,
            speed: 1.0,
            time: span.0,
            since: Instant::now(),
            has_sought: false,
            span,
        };
        let player = Arc::new(Player {
            progress: Mutex::new(progress),
            changed: Condvar::new(),
            is_over: AtomicBool::new(false),
        });
        let shared = Arc::clone(&player);
        let answer = move |request: PlaybackControlRequest| {
            let wall = Instant::now();
            let mut progress = shared.lock();
            progress.take(&request, wall);
            let did_seek = progress.has_sought;
            shared.changed.notify_one();
            progress.state(wall, did_seek, Some(request.request_id))
        };
        let mut settings = settings;
        settings.playback = Some((span.0.as_ns(), span.1.as_ns()));
        settings.parameters.extend(recording.run.clone());
        let server = Server::start(settings, Some(Box::new(answer)))?;
        let address = server.address();
        let stage = Stage::new(server, recording)?;
        let play = Arc::clone(&player);
        let thread =
            thread::Builder::new().name("playback".into()).spawn(move || stage.play(&play))?;
        Ok(Self { player, address, thread: Some(thread) })
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Playback {
    fn drop(&mut self) {
        self.player.is_over.store(true, Ordering::Release);
        self.player.changed.notify_one();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The player's thread.
struct Stage {
    server: Server,
    recording: Recording,
    channels: Vec<Arc<RawChannel>>,
    scene: Arc<RawChannel>,
    /// Index of the next message to send.
    next: usize,
    time_due: Instant,
    trail_due: Instant,
}

impl Stage {
    fn new(server: Server, recording: Recording) -> Result<Self, ViewError> {
        let scene = Topic::Scene.definition();
        let mut channels: Vec<Arc<RawChannel>> = Vec::with_capacity(recording.channels.len());
        for channel in &recording.channels {
            let schema = (!channel.schema.is_empty()).then(|| {
                let data = channel.schema_data.clone();
                Schema::new(&*channel.schema, &*channel.schema_encoding, data)
            });
            channels.push(server.channel(&channel.topic, &channel.message_encoding, schema)?);
        }
        let drawn = channels.iter().find(|channel| channel.topic() == scene.topic);
        let scene = match drawn {
            Some(channel) => Arc::clone(channel),
            None => server.advertise(&scene)?,
        };
        let now = Instant::now();
        Ok(Self { server, recording, channels, scene, next: 0, time_due: now, trail_due: now })
    }

    fn play(mut self, player: &Player) {
        while !player.is_over.load(Ordering::Acquire) {
            let wall = Instant::now();
            let mut progress = player.lock();
            let has_sought = std::mem::take(&mut progress.has_sought);
            let now = progress.now(wall);
            let has_ended = progress.status == PlaybackStatus::Playing && now >= progress.span.1;
            if has_ended {
                progress.status = PlaybackStatus::Ended;
                progress.time = now;
            }
            let state = (has_sought || has_ended).then(|| progress.state(wall, has_sought, None));
            drop(progress);
            if let Some(state) = state {
                self.server.send_playback(state);
            }
            if has_sought {
                self.next = self.recording.up_to(now);
                self.show_before(None);
                self.trail_due = wall;
            }
            self.greet();
            self.give(now);
            self.send_positions(wall, now);
            let progress = player.lock();
            // A viewer that joins a paused playback receives what it missed within this time.
            let wait = if progress.status == PlaybackStatus::Playing { STEP } else { TIME_PERIOD };
            if !progress.has_sought && !player.is_over.load(Ordering::Acquire) {
                drop(player.changed.wait_timeout(progress, wait));
            }
        }
    }

    /// Sends the messages that were logged up to `now`.
    fn give(&mut self, now: HostTime) {
        let end = self.recording.up_to(now);
        for index in self.next..end {
            self.give_one(index, None);
        }
        self.next = end.max(self.next);
    }

    fn give_one(&self, index: usize, only: Option<foxglove::SinkId>) {
        let Some(message) = self.recording.messages.get(index) else { return };
        let Some(channel) = self.channels.get(message.channel) else { return };
        let time = PartialMetadata { log_time: Some(message.time.as_ns()) };
        channel.log_with_meta_to_sink(self.recording.body(message), time, only);
    }

    /// Sends again what was sent once before this instant and is still valid: the vehicle's shape
    /// and the latest events.
    fn show_before(&self, only: Option<(foxglove::SinkId, &str)>) {
        let sink = only.map(|(sink, _)| sink);
        for (topic, most) in [("/scene", usize::MAX), ("/log", EVENTS)] {
            if only.is_some_and(|(_, only)| only != topic) {
                continue;
            }
            let is_of = |index: &usize| {
                let message = self.recording.messages.get(*index);
                message
                    .and_then(|message| self.recording.channels.get(message.channel))
                    .is_some_and(|channel| channel.topic == topic)
            };
            let mut found: Vec<usize> = (0..self.next).rev().filter(is_of).take(most).collect();
            found.reverse();
            found.into_iter().for_each(|index| self.give_one(index, sink));
        }
    }

    fn greet(&mut self) {
        for (sink, topic) in self.server.take_newcomers() {
            self.show_before(Some((sink, &topic)));
            self.trail_due = Instant::now();
        }
    }

    /// Sends the time, the trail and the plan when they are due.
    fn send_positions(&mut self, wall: Instant, now: HostTime) {
        if wall >= self.time_due {
            self.time_due = wall + TIME_PERIOD;
            self.server.send_time(now.as_ns());
        }
        if wall < self.trail_due || !self.scene.has_sinks() {
            return;
        }
        self.trail_due = wall + TRAIL_PERIOD;
        let time = PartialMetadata { log_time: Some(now.as_ns()) };
        let trail = self.recording.trail(now).iter().map(|(_, position)| *position);
        let trail = viewer::line(now, "trail", TRAIL_COLOUR, 2.0, trail);
        self.scene.log_with_meta(&trail.encode_to_vec(), time);
        let plan = self.recording.plan.iter().copied();
        if plan.len() > 1 {
            let plan = viewer::line(now, "plan", PLAN_COLOUR, 1.5, plan);
            self.scene.log_with_meta(&plan.encode_to_vec(), time);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress() -> (Progress, Instant) {
        let wall = Instant::now();
        let span = (HostTime::from_ns(10_000_000_000), HostTime::from_ns(20_000_000_000));
        let status = PlaybackStatus::Paused;
        let (speed, has_sought) = (1.0, false);
        (Progress { status, speed, time: span.0, since: wall, has_sought, span }, wall)
    }

    fn request(command: PlaybackCommand, speed: f32, seek: Option<f64>) -> PlaybackControlRequest {
        PlaybackControlRequest {
            playback_command: command,
            playback_speed: speed,
            seek_time: seek.map(|s| (s * 1e9) as u64),
            request_id: "a".to_owned(),
        }
    }

    #[test]
    fn playback_runs_at_its_speed_and_ends_with_the_log() {
        let (mut progress, wall) = progress();
        let at = |progress: &Progress, s: u64| {
            progress.now(wall + Duration::from_secs(s)).as_ns() / 1_000_000_000
        };
        assert_eq!(at(&progress, 5), 10);
        progress.take(&request(PlaybackCommand::Play, 2.0, None), wall);
        assert_eq!((at(&progress, 3), at(&progress, 30)), (16, 20));
        progress.take(&request(PlaybackCommand::Pause, 2.0, None), wall + Duration::from_secs(3));
        assert_eq!(at(&progress, 9), 16);
        progress.take(&request(PlaybackCommand::Pause, 2.0, Some(12.5)), wall);
        assert_eq!((at(&progress, 9), progress.has_sought), (12, true));
    }

    #[test]
    fn out_of_range_seek_is_clamped_and_invalid_speed_ignored() {
        let (mut progress, wall) = progress();
        for (seek, expected) in [(0.0, 10), (1e9, 20)] {
            for speed in [f32::NAN, -1.0, 0.0, f32::INFINITY, 1e9] {
                progress.take(&request(PlaybackCommand::Pause, speed, Some(seek)), wall);
                assert_eq!(progress.now(wall).as_ns(), expected * 1_000_000_000);
                assert_eq!(progress.speed, 1.0);
            }
        }
        progress.take(&request(PlaybackCommand::Play, 1.0, None), wall);
        assert_eq!(
            progress.time, progress.span.0,
            "playing at the end restarts from the beginning"
        );
    }
}
