//! The fastest motion through a course.

use vehicle::physics::Physics;
use vehicle::rigid_body::State;

use super::bounds::Bounds;
use super::course::{Course, Limits};
use super::guess::{Agility, guess};
use super::knots::{Knots, Period};
use super::rotor_dynamics::RotorDynamics;
use super::search::{Effort, Search};
use crate::plan::iterate::Violation;
use crate::plan::scp::{Record, Status};

/// Effort of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Initial number of periods between consecutive passages.
    pub periods: usize,
    /// Times that all periods are halved and the search repeated.
    pub refinements: usize,
    /// Shortest period, s: thrusts are held for at least as long.
    pub length_min_s: f64,
    /// The search ends when a subproblem promises less than this, s.
    pub tolerance_s: f64,
    /// Most subproblems of a search.
    pub subproblems_max: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            periods: 10,
            refinements: 0,
            length_min_s: 0.003,
            tolerance_s: 1e-3,
            subproblems_max: 200,
        }
    }
}

/// The fastest motion found; a failed search is an outcome too, not an error.
#[derive(Clone, Debug)]
pub struct TimeOptimal {
    /// How the search ended.
    pub status: Status,
    /// The motion.
    pub knots: Knots,
    /// Its violations, checked every millisecond.
    pub violation: Violation,
    /// The subproblems.
    pub records: Vec<Record>,
}

/// Longest period, relative to the longest of the guess.
const STRETCH_MAX: f64 = 2.0;
/// Integration steps during the search and at the end, s.
const COARSE_S: f64 = 0.03;
const FINE_S: f64 = 0.003;
/// Interval of the checks between the knots, s.
const LOOK_S: f64 = 1e-3;
/// Largest defect of the dynamics and largest overrun of the bounds at the states, m.
const DEFECT_MAX: f64 = 1e-9;
const OVERRUN_MAX: f64 = 1e-6;
/// Most subproblems to close a plan.
const CLOSING: usize = 12;
/// Most times that the bounds are tightened by the overrun between the knots.
const TIGHTENINGS: usize = 4;
/// Cost of a metre, relative to its value.
const PENALTY: f64 = 8.0;
/// Least mean segment length, m.
const WAY_MIN_M: f64 = 0.1;
/// Tolerated overrun between the knots: fraction of a rate, m, rad.
const RATE_SLACK: f64 = 5e-5;
const PLACE_SLACK_M: f64 = 5e-4;
const TILT_SLACK_RAD: f64 = 5e-3;

/// Callbacks that see the subproblems so far before each new one, and may stop the search.
#[derive(Clone, Copy)]
pub struct Stop<'a> {
    /// Stops the search; the result is then closed, which takes a few more subproblems.
    pub search: &'a dyn Fn(&[Record]) -> bool,
    /// Stops the closing too; the result may then violate the dynamics and the bounds.
    pub closing: &'a dyn Fn(&[Record]) -> bool,
}

impl Stop<'_> {
    /// Never stops.
    pub const NEVER: Stop<'static> = Stop { search: &|_| false, closing: &|_| false };
}

/// Plans a course for a vehicle.
pub fn plan(
    course: &Course,
    physics: &Physics,
    limits: &Limits,
    settings: &Settings,
    stop: Stop<'_>,
) -> TimeOptimal {
    let coarse = RotorDynamics::new(physics.clone(), COARSE_S);
    let fine = coarse.in_steps_of(FINE_S);
    let agility = agility(physics, limits);
    let mut bounds = Bounds {
        course,
        limits: *limits,
        acceleration_m_s2: agility.thrust_m_s2 + agility.gravity,
        clearance_m: 0.0,
    };
    let mut knots = guess(course, &agility, settings.periods);
    let lengths = knots.periods.iter().map(|period| period.length_s);
    let longest = lengths.fold(settings.length_min_s, f64::max);
    let effort = Effort {
        subproblems_max: settings.subproblems_max,
        length_s: [settings.length_min_s, STRETCH_MAX * longest],
        tolerance_s: settings.tolerance_s,
        penalty_s_m: penalty_s_m(course, &agility),
    };
    let mut records = Vec::new();
    let mut status = Status::Stopped;
    for level in 0..=settings.refinements {
        if level > 0 {
            if status == Status::Stopped {
                break;
            }
            knots = halved(&knots, &fine, settings.length_min_s);
        }
        let mut search = Search::new(knots, &coarse, &bounds, effort);
        search.records = records;
        status = search.run(stop.search);
        (knots, records) = (search.knots, search.records);
    }
    let mut violation = Violation::default();
    for _ in 0..=TIGHTENINGS {
        let mut search = Search::new(knots, &fine, &bounds, effort);
        search.records = records;
        search.close(DEFECT_MAX, OVERRUN_MAX, CLOSING, stop.closing);
        let merit = search.merit;
        (knots, records) = (search.knots, search.records);
        let between = Between::of(&knots, &fine, course, limits);
        violation = Violation {
            defect: merit.defect_max,
            overrun: merit.overrun_max.max(between.overrun),
            trespass_m: between.trespass_m,
        };
        if (stop.closing)(&records) || !between.tighten(&mut bounds, limits) {
            break;
        }
    }
    TimeOptimal { status, knots, violation, records }
}

/// Cost of a metre: [`PENALTY`] times its value on a segment of the course's mean length, flown in
/// the time of full acceleration, `2 sqrt(d / a)`.
fn penalty_s_m(course: &Course, agility: &Agility) -> f64 {
    let places = course.places();
    let sum: f64 = places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let mean = (sum / (places.len() - 1) as f64).max(WAY_MIN_M);
    PENALTY / (mean * agility.thrust_m_s2).sqrt()
}

fn agility(physics: &Physics, limits: &Limits) -> Agility {
    let body = physics.body();
    let [_, most] = limits.rotor;
    let full = physics.allocation().collective_max();
    Agility {
        thrust_m_s2: most * full / body.mass(),
        gravity: body.gravity(),
        rotor: limits.rotor,
        speed_m_s: limits.speed_m_s.unwrap_or(f64::INFINITY),
        tilt_rad: limits.tilt_rad.unwrap_or(f64::INFINITY),
    }
}

/// Halves the periods, except those that would become too short.
fn halved(knots: &Knots, dynamics: &RotorDynamics, length_min_s: f64) -> Knots {
    let mut halves = Knots { states: vec![knots.states[0]], periods: vec![], passed: vec![] };
    let mut passed = knots.passed.iter().copied().peekable();
    for (n, period) in knots.periods.iter().enumerate() {
        let half = Period { length_s: 0.5 * period.length_s, ..*period };
        if half.length_s > length_min_s {
            halves.states.push(dynamics.end(&knots.states[n], &half));
            halves.periods.push(half);
            halves.periods.push(half);
        } else {
            halves.periods.push(*period);
        }
        halves.states.push(knots.states[n + 1]);
        if passed.next_if_eq(&(n + 1)).is_some() {
            halves.passed.push(halves.periods.len());
        }
    }
    halves
}

/// Overruns of the limits between the knots.
#[derive(Clone, Copy, Debug, Default)]
struct Between {
    /// Excess of each rate, rad/s.
    rate: [f64; 3],
    /// Excess of the tilt, rad.
    tilt: f64,
    /// The largest of the relative excess of a rate and the excess of tilt, rad.
    overrun: f64,
    /// Largest depth of a position in a region, or distance out of the room, m.
    trespass_m: f64,
}

impl Between {
    fn of(knots: &Knots, dynamics: &RotorDynamics, course: &Course, limits: &Limits) -> Self {
        let mut between = Self::default();
        let mut state = knots.states[0];
        for period in &knots.periods {
            let looks = (period.length_s / LOOK_S).ceil().max(1.0);
            let look = Period { length_s: period.length_s / looks, ..*period };
            for _ in 0..looks as usize {
                let next = dynamics.end(&state, &look);
                between.look(&state, &next, course, limits);
                state = next;
            }
        }
        between
    }

    fn look(&mut self, before: &State, state: &State, course: &Course, limits: &Limits) {
        for (i, rate) in state.body_rate.to_array().into_iter().enumerate() {
            let excess = rate.abs() - limits.body_rate_rad_s[i];
            self.rate[i] = self.rate[i].max(excess);
            self.overrun = self.overrun.max(excess / limits.body_rate_rad_s[i]);
        }
        if let Some(tilt) = limits.tilt_rad {
            self.tilt = self.tilt.max(state.attitude.tilt() - tilt);
            self.overrun = self.overrun.max(self.tilt);
        }
        let (from, to) = (before.position.to_array(), state.position.to_array());
        for region in &course.keep_out {
            self.trespass_m = self.trespass_m.max(region.depth_between(from, to));
        }
        if let Some(room) = course.room {
            self.trespass_m = self.trespass_m.max(room.outside_m(state.position));
        }
    }

    /// Tightens the bounds by the excess over the limits; returns whether that was needed.
    fn tighten(&self, bounds: &mut Bounds<'_>, limits: &Limits) -> bool {
        let mut is_tighter = false;
        for (i, excess) in self.rate.into_iter().enumerate() {
            let slack = RATE_SLACK * limits.body_rate_rad_s[i];
            if excess > slack {
                bounds.limits.body_rate_rad_s[i] = (bounds.limits.body_rate_rad_s[i] - excess)
                    .max(0.5 * limits.body_rate_rad_s[i]);
                is_tighter = true;
            }
        }
        if let (Some(tilt), Some(bound)) = (limits.tilt_rad, &mut bounds.limits.tilt_rad)
            && self.tilt > TILT_SLACK_RAD
        {
            *bound = (*bound - self.tilt).max(0.5 * tilt);
            is_tighter = true;
        }
        if self.trespass_m > PLACE_SLACK_M {
            bounds.clearance_m += self.trespass_m + PLACE_SLACK_M;
            is_tighter = true;
        }
        is_tighter
    }
}
