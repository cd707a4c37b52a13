//! The initial guess: a spline through the centres of the passages and around the regions to avoid,
//! at a pace within the thrust limits, with attitudes that point the thrust along it.

use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::rigid_body::State;

use super::course::Course;
use super::knots::{Knots, Period};
use super::spline::{Moment, Spline};
use crate::plan::detour::bend;
use crate::plan::problem::StateLimits;
use crate::plan::state_vector::{STATES, StateVector, VELOCITY};

/// Time of a segment, relative to full acceleration from end to end.
const PACE: f64 = 1.6;
/// Least length of a segment, m.
const WAY_MIN_M: f64 = 0.05;
/// Fraction of the sampled instants at which the spline may exceed the available thrust.
const OVER: f64 = 0.1;
/// Most times that the spline is slowed.
const SLOWINGS: usize = 12;
/// Sampled instants per segment.
const LOOKS: usize = 8;

/// The vehicle parameters of the guess.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agility {
    /// Greatest thrust over mass, m/s^2.
    pub thrust_m_s2: f64,
    /// m/s^2
    pub gravity: f64,
    /// Usable range of the rotors, as fractions of their largest thrusts.
    pub rotor: [f64; 2],
    /// m/s
    pub speed_m_s: f64,
    /// Greatest angle of the thrust from up, rad.
    pub tilt_rad: f64,
}

impl Agility {
    /// Largest horizontal acceleration at constant height, m/s^2.
    fn sideways_m_s2(&self) -> f64 {
        let by_thrust = (self.thrust_m_s2.powi(2) - self.gravity.powi(2)).max(0.01).sqrt();
        let by_tilt = self.gravity * self.tilt_rad.min(1.5).tan();
        by_thrust.min(by_tilt)
    }

    /// Factor by which time must stretch for a moment of the spline to be feasible.
    fn haste(&self, moment: &Moment) -> f64 {
        let force = (moment.acceleration - Ned::new(0.0, 0.0, self.gravity)).norm();
        let level = moment.acceleration.north().hypot(moment.acceleration.east());
        let by_force = (force / self.thrust_m_s2).max(level / self.sideways_m_s2()).sqrt();
        by_force.max(moment.velocity.norm() / self.speed_m_s)
    }
}

/// The guess with `periods` periods between consecutive passages.
pub(super) fn guess(course: &Course, agility: &Agility, periods: usize) -> Knots {
    let spline = paced(course, agility);
    let mut moments = Vec::new();
    let mut passed = Vec::new();
    for way in 0..spline.ways() {
        let length_s = spline.length_s(way) / periods as f64;
        for k in 1..=periods {
            moments.push((spline.at(way, k as f64 / periods as f64), length_s));
        }
        passed.push(moments.len());
    }
    if !course.keep_out.is_empty() {
        go_round(course, &spline, &mut moments);
    }
    let mut knots = Knots {
        states: vec![State {
            position: course.start.position,
            velocity: course.start.velocity,
            attitude: Euler::new(0.0, 0.0, course.start.yaw).attitude(),
            body_rate: Frd::zero(),
        }],
        periods: Vec::new(),
        passed,
    };
    let mut attitude = Euler::new(0.0, 0.0, course.start.yaw).attitude();
    for (moment, length_s) in moments {
        let force = moment.acceleration - Ned::new(0.0, 0.0, agility.gravity);
        let turn = least_turn(attitude.to_body(force));
        let [x, y, z] = turn;
        let half = 0.5 * (x * x + y * y + z * z).sqrt();
        let share = if half < 1e-9 { 0.5 } else { 0.5 * half.sin() / half };
        let turned = Attitude { w: half.cos(), x: x * share, y: y * share, z: z * share };
        attitude = attitude.compose(turned).normalized();
        knots.states.push(State {
            position: moment.position,
            velocity: moment.velocity,
            attitude,
            body_rate: Frd::from(turn) * (1.0 / length_s),
        });
        let [least, most] = agility.rotor;
        let share = (force.norm() / agility.thrust_m_s2 * most).clamp(least, most);
        knots.periods.push(Period { rotors: [share; 4], length_s });
    }
    knots
}

/// The spline at a pace that is feasible in thrust and speed at most of its moments.
fn paced(course: &Course, agility: &Agility) -> Spline {
    let places = course.places();
    let mut ways: Vec<f64> = places
        .windows(2)
        .map(|pair| {
            let way = (pair[1] - pair[0]).norm().max(WAY_MIN_M);
            (PACE * (way / agility.sideways_m_s2()).sqrt()).max(way / agility.speed_m_s)
        })
        .collect();
    let ends = [course.start.velocity, course.finish.velocity];
    let mut spline = Spline::new(places.clone(), &ways, ends);
    for _ in 0..SLOWINGS {
        let looks = (0..spline.ways()).flat_map(|way| (0..LOOKS).map(move |look| (way, look)));
        let mut hastes: Vec<f64> = looks
            .map(|(way, look)| agility.haste(&spline.at(way, (look as f64 + 0.5) / LOOKS as f64)))
            .collect();
        hastes.sort_by(f64::total_cmp);
        let high = hastes[((1.0 - OVER) * hastes.len() as f64) as usize];
        if high <= 1.0 {
            break;
        }
        let slower = high.clamp(1.02, 1.3);
        ways.iter_mut().for_each(|way| *way *= slower);
        spline = Spline::new(places.clone(), &ways, ends);
    }
    spline
}

/// The rotation in body axes, angle times axis (rad), that points body up along a force.
fn least_turn(force: Frd) -> [f64; 3] {
    let [x, y, z] = force.to_array();
    let level = x.hypot(y);
    if level < 1e-9 {
        return [0.0; 3];
    }
    let angle = level.atan2(-z);
    [angle * y / level, -angle * x / level, 0.0]
}

/// Bends the moments around the regions. Where they change, the accelerations are derived from the
/// new velocities.
fn go_round(course: &Course, spline: &Spline, moments: &mut [(Moment, f64)]) {
    let vector = |position: Ned, velocity: Ned| {
        let mut vector: StateVector = [0.0; STATES];
        vector[..VELOCITY].copy_from_slice(&position.to_array());
        vector[VELOCITY..2 * VELOCITY].copy_from_slice(&velocity.to_array());
        vector
    };
    let duration: f64 = (0..spline.ways()).map(|way| spline.length_s(way)).sum();
    let period = duration / moments.len() as f64;
    let mut states = vec![vector(course.start.position, course.start.velocity)];
    states.extend(moments.iter().map(|(moment, _)| vector(moment.position, moment.velocity)));
    let limits = StateLimits { position: course.room, ..StateLimits::default() };
    if !bend(&mut states, period, &course.keep_out, &limits) {
        return;
    }
    for ((moment, length_s), pair) in moments.iter_mut().zip(states.windows(2)) {
        let [before, after] = pair else { continue };
        let part = |state: &StateVector, from: usize| {
            Ned::new(state[from], state[from + 1], state[from + 2])
        };
        moment.position = part(after, 0);
        moment.velocity = part(after, VELOCITY);
        moment.acceleration = (part(after, VELOCITY) - part(before, VELOCITY)) * (1.0 / *length_s);
    }
}
