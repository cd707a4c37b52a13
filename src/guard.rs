//! The last check before the wire, and the only maker of the setpoints that the link sends.
//!
//! Whatever comes in, every outgoing setpoint is finite, within the limits and their rates of
//! change, permitted, and the only answer to a fresh sample. The guard trusts no part before it:
//! neither the controller, nor that the control path runs on time. It allocates no memory after it
//! is created.

use std::time::Duration;

use vehicle::frame::{Euler, wrap_angle};

use crate::clock::{HostTime, VehicleTime};
use crate::control::{Limits, Saturation};
#[cfg(test)]
use crate::planted::{self, Planted};
use crate::setpoint::Setpoint;

/// Gap between two turns of the control path that counts as a stall: what it reads next may have
/// been unread for as long. It is also the age at which a sample no longer gets a setpoint.
pub const STALL: Duration = Duration::from_millis(50);

/// Time after a stall within which everything unread is read: a socket's buffer takes about a
/// millisecond.
const DRAIN: Duration = Duration::from_millis(10);

/// A setpoint that left longer ago than this no longer bounds the change.
const FORGOTTEN: Duration = Duration::from_millis(500);
/// Shortest interval over which changes are bounded: two answers are never closer.
const SPACING: Duration = Duration::from_millis(5);

/// What the supervisor permits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stance {
    /// Nothing may leave.
    #[default]
    Silent,
    /// A hold may be offered, which the vehicle does not obey yet.
    Offer,
    /// The controller may fly the vehicle.
    Control,
}

/// Whether the vehicle obeys setpoints, according to a recently reported mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Obeys {
    /// No mode was reported recently, or none since a silence.
    #[default]
    Unknown,
    /// The vehicle is in another mode.
    No,
    /// The vehicle is in the mode that obeys setpoints.
    Yes,
}

/// Whether setpoints may leave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Order {
    /// What the supervisor permits.
    pub stance: Stance,
    /// What the vehicle would do with them. Where this is unknown nothing leaves, because the
    /// vehicle may obey an offer.
    pub obeys: Obeys,
}

/// The sample that a setpoint answers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answered {
    /// Arrival of its last message.
    pub host: HostTime,
    /// Vehicle time of the state.
    pub vehicle: VehicleTime,
    /// How much longer it took to arrive than the fastest messages, s.
    pub excess_delay_s: f64,
    /// The vehicle's yaw, rad.
    pub yaw: f64,
}

/// The setpoint that the controller wants to send.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Proposal {
    /// The setpoint before any limit.
    pub setpoint: Setpoint,
    /// The sample that it answers.
    pub sample: Answered,
}

/// Why nothing leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Withheld {
    /// There is nothing to send.
    #[error("nothing was proposed")]
    Nothing,
    /// The supervisor does not permit it, or the vehicle did not recently report that it obeys.
    #[error("setpoints are not permitted now")]
    NotPermitted,
    /// The sample is too old by now.
    #[error("the sample is too old")]
    Stale,
    /// The sample may be older than the control path's last stall.
    #[error("the sample may be from before this process stalled")]
    Stalled,
    /// The sample, or a newer one, was already answered.
    #[error("the sample was already answered")]
    Answered,
    /// A component is NaN or infinite.
    #[error("the setpoint is not finite")]
    NotFinite,
}

/// A setpoint that may leave now. Only a [`Guard`] makes one, and the link sends nothing else. It
/// cannot be copied, so each leaves at most once.
#[derive(Debug, PartialEq)]
pub struct Cleared {
    setpoint: Setpoint,
    body_rate_max_rad_s: f64,
}

impl Cleared {
    /// The setpoint to send.
    pub fn setpoint(&self) -> &Setpoint {
        &self.setpoint
    }

    /// The largest body rate about each axis that a message may carry for this setpoint, rad/s: one
    /// form of the message adds to the rates.
    pub fn body_rate_max_rad_s(&self) -> f64 {
        self.body_rate_max_rad_s
    }
}

/// The guard of one vehicle's setpoints.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    thrust_full_n: f64,
    /// When the control path last ran.
    turned: HostTime,
    /// End of the last stall: a sample that left the vehicle earlier may be outdated.
    woke: HostTime,
    stalled: Duration,
    pending: Option<Proposal>,
    answered: Option<VehicleTime>,
    last: Option<(HostTime, Setpoint)>,
}

impl Guard {
    /// A guard that has cleared nothing yet. `thrust_full_n` is the full thrust of all rotors
    /// together, N.
    pub fn new(limits: Limits, thrust_full_n: f64, now: HostTime) -> Self {
        Self {
            limits,
            thrust_full_n,
            turned: now,
            woke: now,
            stalled: Duration::ZERO,
            pending: None,
            answered: None,
            last: None,
        }
    }

    /// Notes that the control path runs at `now`. Call it on every turn, even when nothing was
    /// received.
    pub fn turn(&mut self, now: HostTime) {
        let passed = now.since(self.turned);
        #[cfg(test)]
        let passed = if planted::is(Planted::StallDoubled) { passed / 2 } else { passed };
        if passed > STALL {
            (self.woke, self.stalled, self.pending) = (now, passed, None);
        }
        self.turned = self.turned.max(now);
    }

    /// Duration of the last stall; zero if there was none.
    pub fn stalled(&self) -> Duration {
        self.stalled
    }

    /// Forgets all samples, because the vehicle's clock starts again and new stamps do not compare
    /// with old ones.
    pub fn forget(&mut self) {
        (self.pending, self.answered, self.last) = (None, None, None);
    }

    /// Keeps a proposal in place of the last one. Returns the setpoint as it would leave, and the
    /// limits that it met.
    ///
    /// # Errors
    /// [`Withheld`]; then no proposal is kept.
    pub fn propose(
        &mut self,
        now: HostTime,
        proposal: &Proposal,
        order: Order,
    ) -> Result<(Setpoint, Saturation), Withheld> {
        self.turn(now);
        let checked = self.check(now, proposal, order);
        self.pending = checked.is_ok().then_some(*proposal);
        checked
    }

    /// Clears the proposal, once, if it may still leave.
    ///
    /// # Errors
    /// [`Withheld`]; the proposal is dropped.
    pub fn clear(&mut self, now: HostTime, order: Order) -> Result<Cleared, Withheld> {
        self.turn(now);
        let proposal = self.pending.take().ok_or(Withheld::Nothing)?;
        let (setpoint, _) = self.check(now, &proposal, order)?;
        self.answered = Some(proposal.sample.vehicle);
        self.last = Some((now, setpoint));
        Ok(Cleared { setpoint, body_rate_max_rad_s: self.limits.body_rate_max_rad_s })
    }

    fn check(
        &self,
        now: HostTime,
        Proposal { setpoint, sample }: &Proposal,
        order: Order,
    ) -> Result<(Setpoint, Saturation), Withheld> {
        let permitted = match order.stance {
            Stance::Silent => false,
            Stance::Offer => order.obeys != Obeys::Unknown,
            Stance::Control => order.obeys == Obeys::Yes,
        };
        #[cfg(test)]
        let permitted = permitted || planted::is(Planted::GuardRemoved);
        if !permitted {
            return Err(Withheld::NotPermitted);
        }
        if now.since(sample.host) > STALL {
            return Err(Withheld::Stale);
        }
        if !self.is_after_stall(sample) {
            return Err(Withheld::Stalled);
        }
        if self.answered.is_some_and(|answered| sample.vehicle <= answered) {
            return Err(Withheld::Answered);
        }
        self.bounded(now, setpoint, sample.yaw).ok_or(Withheld::NotFinite)
    }

    /// Whether the sample left the vehicle after the last stall, given its delay over the fastest
    /// samples. A delay that is NaN proves nothing. A clock alone does not either: a sample that
    /// arrives while the backlog is still being read does not count.
    fn is_after_stall(&self, sample: &Answered) -> bool {
        let late_s = if sample.excess_delay_s < 0.0 { 0.0 } else { sample.excess_delay_s };
        let is_drained = self.stalled.is_zero() || sample.host.since(self.woke) >= DRAIN;
        let left = Duration::try_from_secs_f64(late_s).map(|late| sample.host - late);
        is_drained && left.is_ok_and(|left| left >= self.woke)
    }

    /// Applies the limits, and bounds the change from a recent setpoint as far as the limits allow.
    fn bounded(
        &self,
        now: HostTime,
        setpoint: &Setpoint,
        yaw: f64,
    ) -> Option<(Setpoint, Saturation)> {
        let (limited, mut met) = self.limits.apply(*setpoint, self.thrust_full_n, yaw)?;
        #[cfg(test)]
        if planted::is(Planted::LimitsRemoved) {
            return Some((*setpoint, met));
        }
        let Some((at, before)) = self.last.filter(|(at, _)| now.since(*at) <= FORGOTTEN) else {
            return Some((limited, met));
        };
        let dt_s = now.since(at).max(SPACING).as_secs_f64();
        let slow = self.changed_by_at_most(&before, &limited, dt_s, &mut met);
        let (bounded, again) = self.limits.apply(slow, self.thrust_full_n, yaw)?;
        Some((bounded, met.and(again)))
    }

    fn changed_by_at_most(
        &self,
        before: &Setpoint,
        requested: &Setpoint,
        dt_s: f64,
        met: &mut Saturation,
    ) -> Setpoint {
        let Limits { thrust_change_max_per_s, attitude_change_max_rad_s, .. } = self.limits;
        let body_rate_step = self.limits.body_rate_change_max_rad_s2 * dt_s;
        let angle_step = attitude_change_max_rad_s * dt_s;
        let towards = |before: f64, change: f64, step: f64, met: &mut bool| {
            *met |= change.abs() > step;
            before + change.clamp(-step, step)
        };
        let (from, to) = (before.attitude, requested.attitude);
        let mut body_rate = [0.0; 3];
        let rates = before.body_rate.to_array().into_iter().zip(requested.body_rate.to_array());
        for (rate, (from, to)) in body_rate.iter_mut().zip(rates) {
            *rate = towards(from, to - from, body_rate_step, &mut met.body_rate);
        }
        let yaw = towards(from.yaw, wrap_angle(to.yaw - from.yaw), angle_step, &mut met.yaw_error);
        Setpoint {
            thrust_n: towards(
                before.thrust_n,
                requested.thrust_n - before.thrust_n,
                thrust_change_max_per_s * self.thrust_full_n * dt_s,
                &mut met.thrust,
            ),
            attitude: Euler::new(
                towards(from.roll, wrap_angle(to.roll - from.roll), angle_step, &mut met.tilt),
                towards(from.pitch, wrap_angle(to.pitch - from.pitch), angle_step, &mut met.tilt),
                wrap_angle(yaw),
            ),
            body_rate: body_rate.into(),
        }
    }
}

#[cfg(test)]
mod tests;
