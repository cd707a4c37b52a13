//! The vehicle's state from its messages: which messages fire a control tick, which are accepted,
//! and what else is known about the vehicle.

mod fault;
mod lateness;
mod motion;
mod rate;
mod status;

use message::{AttitudeSource, Inbound, LandedState};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rigid_body::State;

pub use self::fault::TelemetryFault;
pub use self::lateness::LateMessages;
use self::lateness::Lateness;
use self::motion::{Pose, Slide, Turn, carried};
use self::rate::RateMeter;
pub use self::status::VehicleStatus;
use crate::clock::{HostTime, VehicleTime};
use crate::link::received::Received;
use crate::link::vehicle_clock::Delay;

/// When a control tick fires, and which telemetry is rejected.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TelemetrySettings {
    /// Control rate, Hz, to which ticks are thinned. Not a setting here: the feedback's rate
    /// applies.
    #[serde(skip)]
    pub rate_hz: f64,
    /// Least delay beyond that of the fastest messages, by the link's estimate of the vehicle's
    /// clock, from which a message is ignored, s.
    pub late_after_s: f64,
    /// A position this far from where the velocity leads is a jump, m.
    pub position_jump_m: f64,
    /// A position that departs from its velocity at this speed for half a second is a jump too,
    /// however small its steps, m/s.
    pub position_slide_m_s: f64,
    /// A sudden velocity change of this size is a jump, m/s.
    pub velocity_jump_m_s: f64,
    /// An attitude this far from where the body rate leads is a jump, rad.
    pub attitude_jump_rad: f64,
    /// A step of the vehicle's clock against the host's beyond this is a jump, s.
    pub clock_jump_s: f64,
}

impl Default for TelemetrySettings {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            late_after_s: 0.2,
            position_jump_m: 0.4,
            position_slide_m_s: 2.0,
            velocity_jump_m_s: 2.0,
            attitude_jump_rad: 0.4,
            clock_jump_s: 1.0,
        }
    }
}

/// Share of a rate at which a source still counts as keeping it.
const KEEPS_TO: f64 = 0.9;
/// Samples faster than this many times the control rate are thinned.
const THIN_ABOVE: f64 = 1.25;
/// Longest time for which a vehicle with running motors reports an unchanged state, s. Beyond it,
/// the estimator counts as frozen.
const FROZEN_S: f64 = 0.2;
/// A vehicle that reports less motion than this over that time may be at rest, m or rad.
const STILL: f64 = 1e-4;
/// Longest tolerated gap between a pair's stamps before a rate is measured, s.
const PAIR_GAP_MAX_S: f64 = 0.05;

/// A state that control acts on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The state at `vehicle`; position NED, m.
    pub state: State,
    /// Vehicle time of the state.
    pub vehicle: VehicleTime,
    /// Host time at which its last message arrived.
    pub host: HostTime,
    /// The messages it was made from.
    pub source: SampleSource,
    /// How much longer it took to arrive than the fastest messages, s: its age less the minimum
    /// delay.
    pub excess_delay_s: f64,
}

/// The messages that a sample was made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleSource {
    /// ODOMETRY.
    Odometry,
    /// LOCAL_POSITION_NED and one of the attitude messages.
    Pair(AttitudeSource),
}

/// One kind of message: its newest value, whether that is still unused, and its rate.
#[derive(Clone, Debug)]
struct Stream<T> {
    newest: Option<T>,
    unused: bool,
    /// Since when the values are unchanged under new stamps.
    same_since: Option<VehicleTime>,
    rate: RateMeter,
}

impl<T> Default for Stream<T> {
    fn default() -> Self {
        Self { newest: None, unused: false, same_since: None, rate: RateMeter::default() }
    }
}

/// Turns messages into samples. Deterministic: the messages bring the time.
#[derive(Clone, Debug)]
pub struct Telemetry {
    settings: TelemetrySettings,
    status: VehicleStatus,
    position: Stream<Pose>,
    position_slide: Slide,
    quaternion: Stream<Turn>,
    euler: Stream<Turn>,
    attitude_source: Option<AttitudeSource>,
    odometry: Stream<(Pose, Turn)>,
    odometry_slide: Slide,
    reset_counter: Option<u8>,
    newest_stamp: Option<VehicleTime>,
    lateness: Lateness,
    due: Option<VehicleTime>,
    last: Option<Sample>,
}

impl Telemetry {
    /// Starts with no message received.
    pub fn new(settings: TelemetrySettings) -> Self {
        Self {
            settings,
            status: VehicleStatus::default(),
            position: Stream::default(),
            position_slide: Slide::default(),
            quaternion: Stream::default(),
            euler: Stream::default(),
            attitude_source: None,
            odometry: Stream::default(),
            odometry_slide: Slide::default(),
            reset_counter: None,
            newest_stamp: None,
            lateness: Lateness::default(),
            due: None,
            last: None,
        }
    }

    /// What is known about the vehicle besides its state.
    pub fn status(&self) -> &VehicleStatus {
        &self.status
    }

    /// The newest sample that fired a tick.
    pub fn last_sample(&self) -> Option<&Sample> {
        self.last.as_ref()
    }

    /// Seconds since the newest sample arrived; infinite before the first.
    pub fn age_s(&self, now: HostTime) -> f64 {
        self.last.map_or(f64::INFINITY, |sample| now.since(sample.host).as_secs_f64())
    }

    /// State messages since the newest sample that arrived too late to act on.
    pub fn late(&self) -> LateMessages {
        self.lateness.since_sample
    }

    /// The late messages to report now, at most every two seconds.
    pub fn take_late(&mut self, now: HostTime) -> Option<LateMessages> {
        self.lateness.take(now)
    }

    /// Measured rates in Hz of ODOMETRY, of the attitude source in use, and of position.
    pub fn rates_hz(&self) -> [f64; 3] {
        [self.odometry.rate.hz(), self.attitude_rate().hz(), self.position.rate.hz()]
    }

    /// Rate in Hz at which the messages can fire ticks, at most the control rate.
    pub fn tick_rate_hz(&self) -> f64 {
        let [odometry, attitude, position] = self.rates_hz();
        odometry.max(attitude.min(position)).min(self.settings.rate_hz)
    }

    /// Forgets the state, the mode and the clocks after a lost link or a restart of the vehicle.
    pub fn forget(&mut self) {
        let mut status = std::mem::take(&mut self.status);
        status.forget_mode();
        *self = Self { status, ..Self::new(self.settings) };
    }

    /// Marks the last reported mode as possibly outdated, such as after a pause of this process.
    pub fn doubt_mode(&mut self) {
        self.status.doubt_mode();
    }

    /// Takes a message, and returns a sample if the message fires a tick.
    ///
    /// # Errors
    /// [`TelemetryFault`] says why a state message was rejected. The next message is still compared
    /// with it, so that a jump is reported once.
    pub fn update(&mut self, received: &Received) -> Result<Option<Sample>, TelemetryFault> {
        self.status.update(received);
        let Some(stamp) = received.vehicle else { return Ok(None) };
        match received.message {
            Inbound::Attitude { source, attitude, body_rate } => {
                let turn = Turn { stamp, attitude, body_rate };
                finite(Ned::zero(), Ned::zero(), attitude, body_rate)?;
                let delay = self.advance_clock(received, stamp)?;
                let limit = self.settings.attitude_jump_rad;
                let stream = match source {
                    AttitudeSource::Quaternion => &mut self.quaternion,
                    AttitudeSource::Euler => &mut self.euler,
                };
                stream.accept(
                    turn,
                    stamp,
                    |t| t.stamp,
                    |before| before.is_like(&turn),
                    |before| before.jump(&turn, limit),
                )?;
                let same_since = stream.same_since;
                self.not_frozen(same_since, stamp, body_rate.norm())?;
                self.choose_attitude(source, stamp);
                self.not_late(delay)?;
                Ok(self.pair(received.host, delay))
            }
            Inbound::LocalPosition { position, velocity } => {
                let pose = Pose { stamp, position, velocity };
                finite(position, velocity, Attitude::default(), Frd::zero())?;
                let delay = self.advance_clock(received, stamp)?;
                let settings = self.settings;
                let slide = &mut self.position_slide;
                self.position.accept(
                    pose,
                    stamp,
                    |p| p.stamp,
                    |p| p.is_like(&pose),
                    |p| p.jump(&pose, &settings).and_then(|()| slide.advance(p, &pose, &settings)),
                )?;
                self.not_frozen(self.position.same_since, stamp, velocity.norm())?;
                self.not_late(delay)?;
                Ok(self.pair(received.host, delay))
            }
            Inbound::Odometry { position, velocity, attitude, body_rate, reset_counter } => {
                let both =
                    (Pose { stamp, position, velocity }, Turn { stamp, attitude, body_rate });
                finite(position, velocity, attitude, body_rate)?;
                let delay = self.advance_clock(received, stamp)?;
                let reset = self.reset_counter.replace(reset_counter);
                let settings = self.settings;
                let slide = &mut self.odometry_slide;
                self.odometry.accept(
                    both,
                    stamp,
                    |(p, _)| p.stamp,
                    |(pose, turn)| pose.is_like(&both.0) && turn.is_like(&both.1),
                    |(pose, turn)| {
                        if reset.is_some_and(|before| before != reset_counter) {
                            return Err(TelemetryFault::EstimateReset);
                        }
                        pose.jump(&both.0, &settings)?;
                        slide.advance(pose, &both.0, &settings)?;
                        turn.jump(&both.1, settings.attitude_jump_rad)
                    },
                )?;
                let speed = velocity.norm().max(body_rate.norm());
                self.not_frozen(self.odometry.same_since, stamp, speed)?;
                self.not_late(delay)?;
                if !self.odometry_drives(stamp) {
                    return Ok(None);
                }
                let state = State { position, velocity, attitude, body_rate };
                Ok(self.fire(state, stamp, received.host, SampleSource::Odometry, delay))
            }
            _ => Ok(None),
        }
    }

    /// Follows the vehicle's clock; returns the message's delay.
    ///
    /// Queues delay messages by any amount and then release them at once, which is no jump of the
    /// clock. But no message arrives before it was sent, so a delay far below the minimum so far is
    /// a jump.
    fn advance_clock(
        &mut self,
        received: &Received,
        stamp: VehicleTime,
    ) -> Result<Delay, TelemetryFault> {
        let limit = self.settings.clock_jump_s;
        let passed = self.newest_stamp.map_or(0.0, |newest| stamp.seconds_since(newest));
        let delay = received.delay.unwrap_or_default();
        if passed < -limit || delay.seconds < -limit {
            self.forget();
            self.newest_stamp = Some(stamp);
            return Err(if passed < -limit {
                TelemetryFault::Reboot { seconds: -passed }
            } else {
                TelemetryFault::ClockJump { seconds: -delay.seconds }
            });
        }
        self.newest_stamp = self.newest_stamp.max(Some(stamp));
        Ok(delay)
    }

    /// Checks that a vehicle that may move does not repeat one state. A vehicle with its motors off
    /// may be at rest, and so may one that hovers in a noiseless simulation. With running motors it
    /// may have lifted off, and the message that reports it may be lost. `speed` is its own report,
    /// m/s or rad/s.
    fn not_frozen(
        &self,
        same_since: Option<VehicleTime>,
        stamp: VehicleTime,
        speed: f64,
    ) -> Result<(), TelemetryFault> {
        let is_aloft = matches!(
            self.status.landed,
            LandedState::InAir | LandedState::TakingOff | LandedState::Landing
        );
        let may_move = is_aloft || self.status.armed == Some(true);
        let seconds = same_since.map_or(0.0, |since| stamp.seconds_since(since));
        if may_move && seconds > FROZEN_S && speed * seconds > STILL {
            return Err(TelemetryFault::Frozen { seconds });
        }
        Ok(())
    }

    fn not_late(&mut self, delay: Delay) -> Result<(), TelemetryFault> {
        if delay.at_least_s > self.settings.late_after_s {
            let seconds = delay.seconds;
            self.lateness.count(seconds);
            return Err(TelemetryFault::Late { seconds });
        }
        Ok(())
    }

    /// Selects the attitude source. Two estimates are never mixed: the first one received stays in
    /// use until it is silent, or until only the other keeps the control rate.
    fn choose_attitude(&mut self, source: AttitudeSource, stamp: VehicleTime) {
        let Some(used) = self.attitude_source else {
            self.attitude_source = Some(source);
            return;
        };
        if used == source {
            return;
        }
        let (mine, other) = match used {
            AttitudeSource::Quaternion => (&self.quaternion, &self.euler),
            AttitudeSource::Euler => (&self.euler, &self.quaternion),
        };
        let needed_hz = KEEPS_TO * self.settings.rate_hz;
        if mine.rate.is_silent(stamp)
            || (mine.rate.hz() < needed_hz && other.rate.hz() >= needed_hz)
        {
            self.attitude_source = Some(source);
        }
    }

    /// Whether ODOMETRY fires the ticks: while it keeps the control rate, or where the pair is no
    /// faster. The rates are compared with each other because a pause of the vehicle slows both.
    fn odometry_drives(&self, stamp: VehicleTime) -> bool {
        let odometry = self.odometry.rate.live_hz(stamp);
        let attitude = self.attitude_rate().live_hz(stamp);
        let pair = attitude.min(self.position.rate.live_hz(stamp));
        odometry > 0.0 && odometry >= KEEPS_TO * pair.min(self.settings.rate_hz)
    }

    fn attitude_rate(&self) -> &RateMeter {
        match self.attitude_source {
            Some(AttitudeSource::Euler) => &self.euler.rate,
            _ => &self.quaternion.rate,
        }
    }

    /// A sample at the later stamp from the newest attitude and position. `None` if either was
    /// used, their stamps are more than one period of the slower apart, or ODOMETRY drives the
    /// ticks.
    fn pair(&mut self, host: HostTime, delay: Delay) -> Option<Sample> {
        let source = self.attitude_source?;
        let attitude = match source {
            AttitudeSource::Quaternion => &mut self.quaternion,
            AttitudeSource::Euler => &mut self.euler,
        };
        if !(attitude.unused && self.position.unused) {
            return None;
        }
        let (turn, pose) = (attitude.newest?, self.position.newest?);
        let gap = turn.stamp.seconds_since(pose.stamp);
        let slower = attitude.rate.hz().min(self.position.rate.hz());
        // Stamps are often rounded to milliseconds.
        let gap_max = if slower > 0.0 { 1.0 / slower + 1e-3 } else { PAIR_GAP_MAX_S };
        if gap.abs() > gap_max {
            return None;
        }
        (attitude.unused, self.position.unused) = (false, false);
        let stamp = turn.stamp.max(pose.stamp);
        if self.odometry_drives(stamp) {
            return None;
        }
        let state = State {
            position: pose.position + pose.velocity * gap.max(0.0),
            velocity: pose.velocity,
            attitude: carried(turn.attitude, turn.body_rate, (-gap).max(0.0)),
            body_rate: turn.body_rate,
        };
        self.fire(state, stamp, host, SampleSource::Pair(source), delay)
    }

    /// Thins samples to the control rate. The due time advances by whole periods, so that the mean
    /// rate does not drift and a slower source loses no tick.
    fn fire(
        &mut self,
        state: State,
        vehicle: VehicleTime,
        host: HostTime,
        source: SampleSource,
        delay: Delay,
    ) -> Option<Sample> {
        let period_us = (1e6 / self.settings.rate_hz).round() as u64;
        let [odometry, attitude, position] = self.rates_hz();
        let rate_hz = match source {
            SampleSource::Odometry => odometry,
            SampleSource::Pair(_) => attitude.min(position),
        };
        // A source close to the control rate sets the pace itself. Held to a fixed phase, it would
        // lose a tick with each sample that arrives slightly early.
        let due = match self.due {
            Some(due) if rate_hz > THIN_ABOVE * self.settings.rate_hz => due,
            _ => vehicle,
        };
        let close =
            self.last.is_some_and(|last| vehicle.as_us() < last.vehicle.as_us() + period_us / 2);
        if close || vehicle.as_us() + period_us / 4 < due.as_us() {
            return None;
        }
        let behind = vehicle.as_us() > due.as_us() + period_us;
        let from = if behind { vehicle } else { due };
        self.due = Some(VehicleTime::from_us(from.as_us() + period_us));
        let excess_delay_s = delay.seconds.max(0.0);
        let sample = Sample { state, vehicle, host, source, excess_delay_s };
        self.last = Some(sample);
        self.lateness.since_sample = LateMessages::default();
        Some(sample)
    }
}

impl<T: Copy> Stream<T> {
    /// Takes `value` as the newest unless its stamp is old; `check` compares it with the one
    /// before.
    fn accept(
        &mut self,
        value: T,
        stamp: VehicleTime,
        stamp_of: impl Fn(&T) -> VehicleTime,
        is_same: impl Fn(&T) -> bool,
        check: impl FnOnce(&T) -> Result<(), TelemetryFault>,
    ) -> Result<(), TelemetryFault> {
        let before = self.newest;
        if before.is_some_and(|before| stamp <= stamp_of(&before)) {
            return Err(TelemetryFault::OutOfOrder);
        }
        self.newest = Some(value);
        self.rate.count(stamp);
        let same = before.filter(|before| is_same(before));
        self.same_since = same.map(|before| self.same_since.unwrap_or(stamp_of(&before)));
        let judged = before.map_or(Ok(()), |before| check(&before));
        self.unused = judged.is_ok();
        judged
    }
}

fn finite(p: Ned, v: Ned, q: Attitude, rate: Frd) -> Result<(), TelemetryFault> {
    let norm = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
    let sound = p.is_finite() && v.is_finite() && rate.is_finite() && (norm - 1.0).abs() < 0.02;
    if sound { Ok(()) } else { Err(TelemetryFault::NotFinite) }
}
