//! The demands of a course and its limits on the states, as bounds.

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rigid_body::State;
use vehicle::scalar::{Dual, Scalar};

use super::course::{Course, Finish, Gate, Limits, Passage};
use super::knots::{Period, moved};
use crate::plan::state_vector::{ANGLE, RATE, STATES, StateRow, StateVector, VELOCITY};

/// Weight of a unit beyond a bound, relative to a metre.
const VELOCITY_WEIGHT: f64 = 0.5;
const LEVEL_WEIGHT: f64 = 0.5;
const RATE_WEIGHT: f64 = 0.1;
/// Angle between a ball's nearest tangent plane and four others, rad.
const FACET: f64 = 0.4;
/// Slowest passage of a gate, m/s.
const GATE_SPEED_M_S: f64 = 0.1;

/// The bounds of a course and its limits.
#[derive(Clone, Debug)]
pub(super) struct Bounds<'a> {
    pub course: &'a Course,
    pub limits: Limits,
    /// Largest acceleration, m/s^2; it bounds the bulge of the path between two states.
    pub acceleration_m_s2: f64,
    /// Clearance of the states from the regions to avoid, m.
    pub clearance_m: f64,
}

impl Bounds<'_> {
    /// Calls `visit` with each bound of the state after `period`, scaled to metres. `passes` is the
    /// index of the passage at this state; the finish has the number of passages as its index.
    pub fn visit(
        &self,
        state: &State,
        period: &Period,
        passes: Option<usize>,
        visit: &mut impl FnMut(StateRow),
    ) {
        self.visit_limits(state, period, visit);
        self.visit_places(state, period, visit);
        let Some(number) = passes else { return };
        match self.course.passages.get(number) {
            Some(Passage::Waypoint { centre, tolerance_m }) => {
                visit_ball(state, *centre, *tolerance_m, visit);
            }
            Some(Passage::Gate(gate)) => visit_gate(state, gate, visit),
            None => visit_finish(state, &self.course.finish, visit),
        }
    }

    fn visit_limits(&self, state: &State, period: &Period, visit: &mut impl FnMut(StateRow)) {
        for (i, rate) in state.body_rate.to_array().into_iter().enumerate() {
            visit_both(rate, self.limits.body_rate_rad_s[i], RATE_WEIGHT, RATE, axis(i), visit);
        }
        if let Some(most) = self.limits.yaw_rate_rad_s {
            let rate = yaw_rate(state);
            let [a, b, c, d, e, f] = *rate.gradient();
            for sign in [1.0, -1.0] {
                let mut bound = row(
                    sign * rate.value() - most,
                    RATE_WEIGHT,
                    ANGLE,
                    [a, b, c].map(|s| sign * s),
                );
                for (entry, slope) in bound.gradient[RATE..].iter_mut().zip([d, e, f]) {
                    *entry = RATE_WEIGHT * sign * slope;
                }
                visit(bound);
            }
        }
        if let Some(tilt) = self.limits.tilt_rad {
            let (down, slope) = down_along(state.attitude, 2);
            visit(row(tilt.cos() - down, LEVEL_WEIGHT, ANGLE, slope.map(|s| -s)));
            // The crest of a swing that ends here: its rate has built up since the middle.
            let back = -0.25 * period.length_s;
            let before = moved(state, &turn(state.body_rate * back));
            let (down, slope) = down_along(before.attitude, 2);
            let mut crest = row(tilt.cos() - down, LEVEL_WEIGHT, ANGLE, slope.map(|s| -s));
            for (entry, slope) in crest.gradient[RATE..].iter_mut().zip(slope) {
                *entry = -LEVEL_WEIGHT * back * slope;
            }
            visit(crest);
        }
        if let Some(most) = self.limits.speed_m_s {
            let speed = state.velocity.norm();
            let along = (state.velocity * (1.0 / speed.max(1e-9))).to_array();
            visit(row(speed - most, VELOCITY_WEIGHT, VELOCITY, along));
        }
    }

    fn visit_places(&self, state: &State, period: &Period, visit: &mut impl FnMut(StateRow)) {
        let bulge = 0.125 * self.acceleration_m_s2 * period.length_s * period.length_s;
        if !self.course.keep_out.is_empty() {
            let mut vector: StateVector = [0.0; STATES];
            vector[..VELOCITY].copy_from_slice(&state.position.to_array());
            vector[VELOCITY..ANGLE].copy_from_slice(&state.velocity.to_array());
            for region in &self.course.keep_out {
                // On the segment from the previous state to this one.
                let mut bound = region.row(&vector, -period.length_s, 0.0);
                bound.excess += bulge + self.clearance_m;
                visit(bound);
            }
        }
        if let Some(room) = self.course.room {
            let each = state.position.to_array().into_iter().zip(room.ranges());
            for (i, (at, [low, high])) in each.enumerate() {
                visit(row(at + bulge - high, 1.0, 0, axis(i)));
                visit(row(low + bulge - at, 1.0, 0, axis(i).map(|s| -s)));
            }
        }
    }
}

/// A deviation that rotates by an angle times an axis in body axes.
fn turn(by: Frd) -> StateVector {
    let mut turn = [0.0; STATES];
    turn[ANGLE..RATE].copy_from_slice(&by.to_array());
    turn
}

fn axis(i: usize) -> [f64; 3] {
    let mut axis = [0.0; 3];
    axis[i] = 1.0;
    axis
}

/// A bound with its gradient in three entries of the state.
fn row(excess: f64, weight: f64, from: usize, slope: [f64; 3]) -> StateRow {
    let mut gradient = [0.0; STATES];
    for (entry, slope) in gradient[from..].iter_mut().zip(slope) {
        *entry = weight * slope;
    }
    StateRow { excess: weight * excess, gradient }
}

/// Bounds `value` to `most` on either side.
fn visit_both(
    value: f64,
    most: f64,
    weight: f64,
    from: usize,
    slope: [f64; 3],
    visit: &mut impl FnMut(StateRow),
) {
    visit(row(value - most, weight, from, slope));
    visit(row(-value - most, weight, from, slope.map(|s| -s)));
}

/// The body's down axis along an axis of the world, and its derivative with respect to a rotation
/// in body axes.
fn down_along(attitude: Attitude, axis: usize) -> (f64, [f64; 3]) {
    let along = |v: Frd| attitude.to_world(v).to_array()[axis];
    let front = along(Frd::new(1.0, 0.0, 0.0));
    let right = along(Frd::new(0.0, 1.0, 0.0));
    // A rotation theta moves down by theta x down = (theta_y, -theta_x, 0).
    (along(Frd::new(0.0, 0.0, 1.0)), [-right, front, 0.0])
}

/// The rate of the yaw angle, with its derivatives with respect to a rotation in body axes and to
/// the body rate.
fn yaw_rate(state: &State) -> Dual<6> {
    type Number = Dual<6>;
    let half = |index| Number::variable(0.0, index) * 0.5;
    let turn = Attitude { w: Number::from(1.0), x: half(0), y: half(1), z: half(2) };
    let attitude = state.attitude.lift::<Number>().compose(turn);
    let [p, q, r] = state.body_rate.to_array();
    let rate = Frd::new(Number::variable(p, 3), Number::variable(q, 4), Number::variable(r, 5));
    let [_, _, yaw] = attitude.euler().rates(rate);
    yaw
}

/// The ball's nearest tangent plane and four around it: with one alone, the position would slide
/// along it.
fn visit_ball(state: &State, centre: Ned, radius_m: f64, visit: &mut impl FnMut(StateRow)) {
    let off = state.position - centre;
    let distance = off.norm();
    let out = if distance > 1e-6 { off * (1.0 / distance) } else { Ned::new(1.0, 0.0, 0.0) };
    let aside =
        if out.north().abs() < 0.7 { Ned::new(1.0, 0.0, 0.0) } else { Ned::new(0.0, 1.0, 0.0) };
    let first = out.cross(aside);
    let first = first * (1.0 / first.norm());
    let second = out.cross(first);
    let (sin, cos) = FACET.sin_cos();
    let about = [first, first * -1.0, second, second * -1.0].map(|aside| out * cos + aside * sin);
    for normal in std::iter::once(out).chain(about) {
        visit(row(off.dot(normal) - radius_m, 1.0, 0, normal.to_array()));
    }
}

fn visit_gate(state: &State, gate: &Gate, visit: &mut impl FnMut(StateRow)) {
    let off = state.position - gate.centre;
    let axes =
        [(gate.normal, 0.0), (gate.side, gate.half_width_m), (gate.down(), gate.half_height_m)];
    for (axis, half) in axes {
        visit_both(off.dot(axis), half, 1.0, 0, axis.to_array(), visit);
    }
    let back = gate.normal * -1.0;
    let speed = state.velocity.dot(back);
    visit(row(GATE_SPEED_M_S + speed, VELOCITY_WEIGHT, VELOCITY, back.to_array()));
}

fn visit_finish(state: &State, finish: &Finish, visit: &mut impl FnMut(StateRow)) {
    let off = (state.position - finish.position).to_array();
    let fast = (state.velocity - finish.velocity).to_array();
    for (i, (off, fast)) in off.into_iter().zip(fast).enumerate() {
        visit_both(off, 0.0, 1.0, 0, axis(i), visit);
        visit_both(fast, 0.0, VELOCITY_WEIGHT, VELOCITY, axis(i), visit);
    }
    if !finish.is_level {
        return;
    }
    for (i, rate) in state.body_rate.to_array().into_iter().enumerate() {
        visit_both(rate, 0.0, RATE_WEIGHT, RATE, axis(i), visit);
    }
    for i in 0..2 {
        let (down, slope) = down_along(state.attitude, i);
        visit_both(down, 0.0, LEVEL_WEIGHT, ANGLE, slope, visit);
    }
}
