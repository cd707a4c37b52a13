//! The last check before the wire, and the only maker of what the link sends as a setpoint.
//!
//! Whatever comes in, what goes out is finite, within the limits and their rates of change, the one
//! answer to a sample that is fresh, and permitted. It trusts nobody before it: neither the
//! controller, nor that the line runs on time. It takes no memory after it was made.

use std::time::Duration;

use vehicle::frame::{Euler, wrap_angle};

use crate::clock::{HostTime, VehicleTime};
use crate::control::{Limits, Saturation};
#[cfg(test)]
use crate::planted::{self, Planted};
use crate::setpoint::Setpoint;

/// A line that runs again after longer than this stood still: what it reads then may have lain
/// unread for as long. And a setpoint that is older than this does not leave.
pub const STALL: Duration = Duration::from_millis(50);

/// What lay unread in a stall is read within this of its end: a socket's buffer takes about a
/// millisecond.
const DRAIN: Duration = Duration::from_millis(10);

/// A setpoint that left longer ago than this bounds no change any more.
const FORGOTTEN: Duration = Duration::from_millis(500);
/// Changes are bounded as over at least this time: two answers are never closer.
const SPACING: Duration = Duration::from_millis(5);

/// What the supervisor wants to happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stance {
    /// Nothing leaves.
    #[default]
    Silent,
    /// A hold is offered, which the vehicle does not obey yet.
    Offer,
    /// The vehicle is flown.
    Control,
}

/// Whether the vehicle obeys setpoints, by the mode that it told lately.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Obeys {
    /// It told no mode lately, or none since it fell silent.
    #[default]
    Unknown,
    /// It is in another mode.
    No,
    /// It is in the mode in which it does.
    Yes,
}

/// Whether setpoints may leave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Order {
    /// What the supervisor wants.
    pub stance: Stance,
    /// What the vehicle would do with them. Where that is not known none leaves: an offer may be
    /// obeyed.
    pub obeys: Obeys,
}

/// The sample that a setpoint answers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answered {
    /// When its last message came.
    pub host: HostTime,
    /// Vehicle time of the state.
    pub vehicle: VehicleTime,
    /// How much later than the quickest messages it came, s.
    pub excess_delay_s: f64,
    /// The vehicle's yaw, rad.
    pub yaw: f64,
}

/// What the controller wants sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Proposal {
    /// Before any limit.
    pub setpoint: Setpoint,
    /// What it answers.
    pub sample: Answered,
}

/// Why nothing leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Withheld {
    /// There is nothing to send.
    #[error("nothing was proposed")]
    Nothing,
    /// The supervisor does not want it, or the vehicle did not tell lately that it obeys.
    #[error("no setpoint may leave now")]
    NotPermitted,
    /// The sample is too old by now.
    #[error("the sample is too old")]
    Stale,
    /// The sample may be from before the line's last stall.
    #[error("the sample may be from before this process stood still")]
    Stalled,
    /// The sample, or a newer one, was answered before.
    #[error("the sample was answered before")]
    Answered,
    /// A component is NaN or infinite.
    #[error("the setpoint is not finite")]
    NotFinite,
}

/// A setpoint that may leave now. Only a [`Guard`] makes one, and the link sends nothing else; it
/// cannot be copied, so that each leaves once.
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

    /// The largest body rate about each axis that may be made of it, rad/s: a form of the message
    /// adds to the rates.
    pub fn body_rate_max_rad_s(&self) -> f64 {
        self.body_rate_max_rad_s
    }
}

/// The guard of one vehicle's setpoints.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    thrust_full_n: f64,
    /// When the line last ran.
    turned: HostTime,
    /// A sample that left the vehicle before this may be from before a stall.
    woke: HostTime,
    stalled: Duration,
    pending: Option<Proposal>,
    answered: Option<VehicleTime>,
    last: Option<(HostTime, Setpoint)>,
}

impl Guard {
    /// Nothing was sent yet. The rotors give `thrust_full_n` together.
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

    /// Notes that the control line runs at `now`. Call it at every turn, also when nothing was heard.
    pub fn turn(&mut self, now: HostTime) {
        let passed = now.since(self.turned);
        #[cfg(test)]
        let passed = if planted::is(Planted::StallDoubled) { passed / 2 } else { passed };
        if passed > STALL {
            (self.woke, self.stalled, self.pending) = (now, passed, None);
        }
        self.turned = self.turned.max(now);
    }

    /// For how long the line last stood still; zero if it never did.
    pub fn stalled(&self) -> Duration {
        self.stalled
    }

    /// The vehicle's clock begins anew: its stamps say nothing of the samples before.
    pub fn forget(&mut self) {
        (self.pending, self.answered, self.last) = (None, None, None);
    }

    /// Keeps what is to be sent in place of what was proposed before; gives it as it would leave,
    /// with the limits that it met.
    ///
    /// # Errors
    /// [`Withheld`]; nothing is kept then.
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

    /// What was proposed, if it may leave by what is known now. It is given once.
    ///
    /// # Errors
    /// [`Withheld`].
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

    /// Whether the sample, which came so much later than the quickest ones, left the vehicle after
    /// the line's last stall. A delay that is not a number proves nothing, and neither does a clock
    /// alone: what came while the line still read what had lain unread is not after it.
    fn is_after_stall(&self, sample: &Answered) -> bool {
        let late_s = if sample.excess_delay_s < 0.0 { 0.0 } else { sample.excess_delay_s };
        let is_drained = self.stalled.is_zero() || sample.host.since(self.woke) >= DRAIN;
        let left = Duration::try_from_secs_f64(late_s).map(|late| sample.host - late);
        is_drained && left.is_ok_and(|left| left >= self.woke)
    }

    /// Within the limits; what left lately bounds the change, as far as the limits allow.
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
        wanted: &Setpoint,
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
        let (from, to) = (before.attitude, wanted.attitude);
        let mut body_rate = [0.0; 3];
        let rates = before.body_rate.to_array().into_iter().zip(wanted.body_rate.to_array());
        for (rate, (from, to)) in body_rate.iter_mut().zip(rates) {
            *rate = towards(from, to - from, body_rate_step, &mut met.body_rate);
        }
        let yaw = towards(from.yaw, wrap_angle(to.yaw - from.yaw), angle_step, &mut met.yaw_error);
        Setpoint {
            thrust_n: towards(
                before.thrust_n,
                wanted.thrust_n - before.thrust_n,
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
