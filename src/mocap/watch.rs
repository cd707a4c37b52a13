//! Whether a pose of a body is believed: by what a body can do, and by where the others are.
//!
//! A pose follows the last one where it is within `jump_m + a/2 dt^2` of where the body was on its way to.
//! Where it does not, nothing more is believed until the body has come steadily for a while: while the
//! vehicle is armed only near where it was lost, while it is disarmed anywhere, except where another
//! body was mistaken for it.

use std::collections::BTreeMap;

use vehicle::frame::{Attitude, Ned};

use super::fault::Fault;
use super::settings::WatchSettings;

/// Time constant of the velocity that a body is taken to have, s.
const VELOCITY_TIME_S: f64 = 0.05;
/// How fast a body may be of which one pose is known, m/s.
const FIRST_SPEED: f64 = 5.0;
/// For how long a body that is not seen is taken to go on as it went, s.
const COAST_S: f64 = 0.5;
/// While the vehicle is armed, a body that was lost for longer is not taken back, s.
const LOST_MAX_S: f64 = 2.0;
/// By how much a body may have turned while it was lost, rad.
const RETURN_TURN: f64 = 0.8;
/// Other bodies whose places are known.
pub const OTHERS_MAX: usize = 64;
/// For how long the place of another body counts, s.
const OTHER_AGE_MAX_S: f64 = 0.5;
/// Within this of another body's place a jump is a swap, m: what a body moves meanwhile.
const OTHER_WITHIN_M: f64 = 0.15;

/// A pose with its time, s on the room's clock: what the host makes of that shifts as it learns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// When.
    pub at_s: f64,
    /// Where, m.
    pub position: Ned,
    /// How it lies.
    pub attitude: Attitude,
}

/// A pose that is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Believed {
    /// Whether it does not go on from the one before: the vehicle is to take it as a new beginning.
    pub is_anew: bool,
}

/// Poses that follow each other.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: Seen,
    latest: Seen,
    /// `None` of a single pose.
    velocity: Option<Ned>,
}

impl Run {
    fn new(seen: Seen) -> Self {
        Self { first: seen, latest: seen, velocity: None }
    }

    /// Where the body is to be at `at_s`.
    fn expected(&self, at_s: f64) -> Ned {
        let velocity = self.velocity.unwrap_or_else(Ned::zero);
        self.latest.position + velocity * (at_s - self.latest.at_s).clamp(0.0, COAST_S)
    }

    fn goes_on_with(&self, seen: &Seen, settings: &WatchSettings) -> bool {
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

/// Where the body stands.
#[derive(Clone, Copy, Debug)]
enum Track {
    /// It is believed.
    Held(Run),
    /// It is not, or not yet.
    Lost {
        /// The last that was believed, if any was, and why no more.
        last: Option<(Run, Fault)>,
        /// What comes since.
        coming: Option<Run>,
    },
}

/// Watches one body among others.
#[derive(Clone, Debug)]
pub struct Watch {
    settings: WatchSettings,
    track: Track,
    /// The newest pose, and since when it has been the same.
    newest: Option<(Seen, f64)>,
    others: BTreeMap<String, Other>,
}

/// Where another body was in the two newest frames that had it.
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

    /// Whether the body is believed where it is.
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
    /// Why it is not believed: [`Fault::Frozen`], [`Fault::Jumped`], [`Fault::Swapped`] or
    /// [`Fault::Settling`].
    pub fn see(&mut self, seen: Seen, is_armed: bool) -> Result<Believed, Fault> {
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

    /// Whether a pose has been the same long enough to be called frozen at `at_s`.
    pub fn is_frozen(&self, at_s: f64) -> bool {
        self.newest.is_some_and(|(_, since_s)| at_s - since_s >= self.settings.frozen_s)
    }

    /// Nothing more is believed, as by a gap, until the body has come back.
    pub fn lose(&mut self, why: Fault) {
        if let Track::Held(run) = self.track {
            self.track = Track::Lost { last: Some((run, why)), coming: None };
        }
    }

    /// The room's clock was set, ahead by `by_s`: the body is lost, and where and when it was stays known.
    pub fn shift(&mut self, by_s: f64) {
        self.lose(Fault::Ahead);
        if let Track::Lost { last, coming } = &mut self.track {
            *coming = None;
            if let Some((run, _)) = last {
                run.latest.at_s += by_s;
                run.first.at_s += by_s;
            }
        }
        self.newest = None;
        self.others.clear();
    }

    fn follow(&mut self, mut run: Run, seen: Seen) -> Result<Believed, Fault> {
        if run.goes_on_with(&seen, &self.settings) {
            run.extend(seen);
            self.track = Track::Held(run);
            return Ok(Believed { is_anew: false });
        }
        let why = if seen.at_s - run.latest.at_s > self.settings.gap_s {
            Fault::Settling
        } else if self.is_anothers(&seen) {
            Fault::Swapped
        } else {
            Fault::Jumped
        };
        self.track = Track::Lost { last: Some((run, why)), coming: Some(Run::new(seen)) };
        Err(why)
    }

    fn take_back(
        &mut self,
        mut last: Option<(Run, Fault)>,
        coming: Option<Run>,
        seen: Seen,
        is_armed: bool,
    ) -> Result<Believed, Fault> {
        let settings = &self.settings;
        // What comes back where another body is, as after it was hidden, is that body.
        if coming.is_none()
            && self.is_anothers(&seen)
            && let Some((run, why)) = &mut last
            && (seen.position - run.expected(seen.at_s)).norm() > settings.return_m
        {
            *why = Fault::Swapped;
        }
        let run = match coming {
            Some(mut run) if run.goes_on_with(&seen, settings) => {
                run.extend(seen);
                run
            }
            _ => Run::new(seen),
        };
        let (is_believed, is_anew) = match last {
            None => (run.length_s() >= settings.settle_anew_s, false),
            Some((lost, why)) => {
                let dt = seen.at_s - lost.latest.at_s;
                // It comes back where it was to be; another body may pass there on its way.
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
                // What the vehicle's filter can take in is no new beginning.
                (is_back || is_moved, !is_back)
            }
        };
        if !is_believed {
            self.track = Track::Lost { last, coming: Some(run) };
            return Err(Fault::Settling);
        }
        self.track = Track::Held(run);
        Ok(Believed { is_anew })
    }

    fn is_anothers(&self, seen: &Seen) -> bool {
        // A tracker may tell of the other body first: where that was before is then what tells a swap.
        let places = self.others.values().flat_map(|other| [Some(other.latest), other.before]);
        places.flatten().any(|other| {
            (seen.at_s - other.at_s).abs() <= OTHER_AGE_MAX_S
                && (seen.position - other.position).norm() <= OTHER_WITHIN_M
        })
    }
}

#[cfg(test)]
mod tests;
