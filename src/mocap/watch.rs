//! Whether to accept a pose of a body, from what a body can do and from where the others are.
//!
//! A pose continues the last one if it is within `jump_m + a/2 dt^2` of the expected position. If
//! it does not, no pose is accepted until the body has been seen steadily for a while. While the
//! vehicle is armed, that must be near the place of the loss. While it is disarmed, it may be
//! anywhere, except where another body was mistaken for this one.

use std::collections::BTreeMap;

use vehicle::frame::{Attitude, Ned};

use super::fault::Fault;
use super::settings::WatchSettings;

/// Time constant of the estimated velocity of a body, s.
const VELOCITY_TIME_S: f64 = 0.05;
/// Largest speed of a body with a single known pose, m/s.
const FIRST_SPEED: f64 = 5.0;
/// Time for which an unseen body is assumed to keep its velocity, s.
const COAST_S: f64 = 0.5;
/// Longest loss after which an armed vehicle's body is accepted again, s.
const LOST_MAX_S: f64 = 2.0;
/// Largest rotation of a body during a loss, rad.
const RETURN_TURN: f64 = 0.8;
/// Most other bodies whose places are kept.
pub const OTHERS_MAX: usize = 64;
/// Time for which the place of another body is valid, s.
const OTHER_AGE_MAX_S: f64 = 0.5;
/// Distance to another body's place within which a jump is a swap, m: that body's motion in
/// between.
const OTHER_WITHIN_M: f64 = 0.15;

/// A pose with its time, s on the room's clock. The host time of that shifts as the clock estimate
/// improves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Time on the room's clock, s.
    pub at_s: f64,
    /// Position, m.
    pub position: Ned,
    /// Attitude of the body.
    pub attitude: Attitude,
}

/// An accepted pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// Whether it does not continue the pose before: the vehicle must treat it as a restart.
    pub is_anew: bool,
}

/// Poses that continue one another.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: Seen,
    latest: Seen,
    /// Estimated velocity; `None` for a single pose.
    velocity: Option<Ned>,
}

impl Run {
    fn new(seen: Seen) -> Self {
        Self { first: seen, latest: seen, velocity: None }
    }

    /// The expected position at `at_s`.
    fn expected(&self, at_s: f64) -> Ned {
        let velocity = self.velocity.unwrap_or_else(Ned::zero);
        self.latest.position + velocity * (at_s - self.latest.at_s).clamp(0.0, COAST_S)
    }

    fn continues_with(&self, seen: &Seen, settings: &WatchSettings) -> bool {
        let dt = seen.at_s - self.latest.at_s;
        let unknown = if self.velocity.is_none() { FIRST_SPEED * dt } else { 0.0 };
        let far = settings.jump_m + unknown + 0.5 * settings.acceleration_max_m_s2 * dt * dt;
        let turn = settings.turn_rad + settings.turn_max_rad_s * dt;
        dt <= settings.gap_s
            && (seen.position - self.expected(seen.at_s)).norm() <= far
            && self.latest.attitude.angle_to(seen.attitude) <= turn
    }

    fn extend(&mut self, seen: Seen) {
        let dt = seen.at_s - self.latest.at_s;
        if dt > 0.0 {
            let slope = (seen.position - self.latest.position) * (1.0 / dt);
            let known = self.velocity.unwrap_or(slope);
            self.velocity = Some(known + (slope - known) * (dt / (dt + VELOCITY_TIME_S)));
        }
        self.latest = seen;
    }

    fn length_s(&self) -> f64 {
        self.latest.at_s - self.first.at_s
    }
}

/// The end of a run.
#[derive(Clone, Copy, Debug)]
struct Loss {
    run: Run,
    why: Fault,
}

/// State of the body's track.
#[derive(Clone, Copy, Debug)]
enum Track {
    /// Its poses are accepted.
    Held(Run),
    /// Its poses are not accepted, or not yet.
    Lost {
        /// The end of the last accepted run, if there was one.
        last: Option<Loss>,
        /// The run since then.
        coming: Option<Run>,
    },
}

/// Watches one body among others.
#[derive(Clone, Debug)]
pub struct Watch {
    settings: WatchSettings,
    track: Track,
    /// The newest pose, and since when it has been unchanged.
    newest: Option<(Seen, f64)>,
    others: BTreeMap<String, Other>,
}

/// The place of another body in its two newest frames.
#[derive(Clone, Copy, Debug)]
struct Other {
    latest: Seen,
    before: Option<Seen>,
}

impl Watch {
    /// A watch that has seen nothing.
    pub fn new(settings: WatchSettings) -> Self {
        let track = Track::Lost { last: None, coming: None };
        Self { settings, track, newest: None, others: BTreeMap::new() }
    }

    /// Whether the body's poses are accepted at present.
    pub fn holds(&self) -> bool {
        matches!(self.track, Track::Held(_))
    }

    /// Takes a pose of another body.
    pub fn see_other(&mut self, body: &str, seen: Seen) {
        if let Some(known) = self.others.get_mut(body) {
            *known = Other { latest: seen, before: Some(known.latest) };
        } else if self.others.len() < OTHERS_MAX {
            self.others.insert(body.to_owned(), Other { latest: seen, before: None });
        }
    }

    /// Takes a pose of the body, newer than the one before.
    ///
    /// # Errors
    /// Why it is rejected: [`Fault::Frozen`], [`Fault::Jumped`], [`Fault::Swapped`] or
    /// [`Fault::Settling`].
    pub fn see(&mut self, seen: Seen, is_armed: bool) -> Result<Accepted, Fault> {
        if let Some((newest, since_s)) = self.newest
            && (newest.position, newest.attitude) == (seen.position, seen.attitude)
        {
            if seen.at_s - since_s >= self.settings.frozen_s {
                self.lose(Fault::Frozen);
            }
            return Err(Fault::Frozen);
        }
        self.newest = Some((seen, seen.at_s));
        match self.track {
            Track::Held(run) => self.follow(run, seen),
            Track::Lost { last, coming } => self.take_back(last, coming, seen, is_armed),
        }
    }

    /// Whether the pose has been unchanged long enough to count as frozen at `at_s`.
    pub fn is_frozen(&self, at_s: f64) -> bool {
        self.newest.is_some_and(|(_, since_s)| at_s - since_s >= self.settings.frozen_s)
    }

    /// Stops accepting poses, such as after a gap, until the body has returned.
    pub fn lose(&mut self, why: Fault) {
        if let Track::Held(run) = self.track {
            self.track = Track::Lost { last: Some(Loss { run, why }), coming: None };
        }
    }

    /// Notes that the room's clock was set forward by `by_s`. The body is lost, but the place and
    /// time of the loss are kept.
    pub fn shift(&mut self, by_s: f64) {
        self.lose(Fault::Ahead);
        if let Track::Lost { last, coming } = &mut self.track {
            *coming = None;
            if let Some(Loss { run, .. }) = last {
                run.latest.at_s += by_s;
                run.first.at_s += by_s;
            }
        }
        self.newest = None;
        self.others.clear();
    }

    fn follow(&mut self, mut run: Run, seen: Seen) -> Result<Accepted, Fault> {
        if run.continues_with(&seen, &self.settings) {
            run.extend(seen);
            self.track = Track::Held(run);
            return Ok(Accepted { is_anew: false });
        }
        let why = if seen.at_s - run.latest.at_s > self.settings.gap_s {
            Fault::Settling
        } else if self.is_anothers(&seen) {
            Fault::Swapped
        } else {
            Fault::Jumped
        };
        self.track = Track::Lost { last: Some(Loss { run, why }), coming: Some(Run::new(seen)) };
        Err(why)
    }

    fn take_back(
        &mut self,
        mut last: Option<Loss>,
        coming: Option<Run>,
        seen: Seen,
        is_armed: bool,
    ) -> Result<Accepted, Fault> {
        let settings = &self.settings;
        // A body that reappears at another body's place, such as after an occlusion, is that other
        // body.
        if coming.is_none()
            && self.is_anothers(&seen)
            && let Some(Loss { run, why }) = &mut last
            && (seen.position - run.expected(seen.at_s)).norm() > settings.return_m
        {
            *why = Fault::Swapped;
        }
        let run = match coming {
            Some(mut run) if run.continues_with(&seen, settings) => {
                run.extend(seen);
                run
            }
            _ => Run::new(seen),
        };
        let (is_accepted, is_anew) = match last {
            None => (run.length_s() >= settings.settle_anew_s, false),
            Some(Loss { run: lost, why }) => {
                let dt = seen.at_s - lost.latest.at_s;
                // It returns to its expected position; another body may pass there.
                let is_near = |seen: &Seen| {
                    let dt = seen.at_s - lost.latest.at_s;
                    let off = (seen.position - lost.expected(seen.at_s)).norm();
                    let reach = settings.jump_m + 0.5 * settings.acceleration_max_m_s2 * dt * dt;
                    off <= reach.min(settings.return_m)
                };
                let is_back = is_near(&run.first)
                    && is_near(&seen)
                    && lost.latest.attitude.angle_to(seen.attitude) <= RETURN_TURN
                    && (dt <= LOST_MAX_S || !is_armed)
                    && run.length_s() >= settings.settle_s;
                let is_moved =
                    !is_armed && why != Fault::Swapped && run.length_s() >= settings.settle_anew_s;
                // A step that the vehicle's filter can absorb is not a restart.
                (is_back || is_moved, !is_back)
            }
        };
        if !is_accepted {
            self.track = Track::Lost { last, coming: Some(run) };
            return Err(Fault::Settling);
        }
        self.track = Track::Held(run);
        Ok(Accepted { is_anew })
    }

    fn is_anothers(&self, seen: &Seen) -> bool {
        // A tracker may report the other body first; then that body's earlier place shows the swap.
        let places = self.others.values().flat_map(|other| [Some(other.latest), other.before]);
        places.flatten().any(|other| {
            (seen.at_s - other.at_s).abs() <= OTHER_AGE_MAX_S
                && (seen.position - other.position).norm() <= OTHER_WITHIN_M
        })
    }
}

#[cfg(test)]
mod tests;
