//! An initial guess that leads around the regions to avoid.
//!
//! Where a path crosses a region, the nearest ways out lead forward and back along the path, and a
//! search that follows them ends with a trajectory that would have to jump. The guess is therefore
//! first bent to one side as a whole: from there, every nearest way out leads around the region.

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use super::keep_out::{KeepOut, position};
use super::problem::{StateLimits, StateVector};

/// Clearance of the bent path from a region, m.
const CLEARANCE: f64 = 0.02;
/// Sideways acceleration of the bend, m/s^2.
const ACCELERATION: f64 = 2.0;
/// Most passes over the regions: the detour around one may lead through another.
const ROUNDS: usize = 3;

/// Bends a path with one state per `period_s` around the regions that it crosses, and adjusts its
/// velocities; returns whether any bend was needed. The first position stays.
pub(super) fn bend(
    states: &mut [StateVector],
    period_s: f64,
    regions: &[KeepOut],
    limits: &StateLimits,
) -> bool {
    let mut is_bent = false;
    for _ in 0..ROUNDS {
        let mut again = false;
        for region in regions {
            let mut from = 0;
            while let Some((first, last)) = crossing(states, region, from) {
                if let Some(shift) = way_round(&states[first..=last], region, regions, limits) {
                    shift_about(states, period_s, first..=last, shift);
                    again = true;
                }
                from = last + 1;
            }
        }
        if !again {
            break;
        }
        is_bent = true;
    }
    is_bent
}

/// The first run of states inside the region at or after `from`, with states outside it at both
/// ends.
fn crossing(states: &[StateVector], region: &KeepOut, from: usize) -> Option<(usize, usize)> {
    // Both ends of a step through the region count as inside.
    let enters = |n: usize| states.get(n..n + 2).is_some_and(|step| !is_clear_of(step, region));
    let mut entered = from.checked_sub(1).is_some_and(enters);
    let mut inside = (from..states.len()).map(|n| {
        let before = std::mem::replace(&mut entered, enters(n));
        (n, before || entered)
    });
    inside.find(|(_, inside)| !inside)?;
    let (first, _) = inside.find(|(_, inside)| *inside)?;
    let (after, _) = inside.find(|(_, inside)| !inside)?;
    Some((first, after - 1))
}

/// The shortest sideways shift that takes a crossing out of a region, into no other, and within the
/// limits.
fn way_round(
    crossing: &[StateVector],
    region: &KeepOut,
    regions: &[KeepOut],
    limits: &StateLimits,
) -> Option<[f64; 3]> {
    let (from, to) = (position(crossing.first()?), position(crossing.last()?));
    let along: [f64; 3] = std::array::from_fn(|i| to[i] - from[i]);
    let length = along.iter().map(|c| c * c).sum::<f64>().sqrt();
    let mut best: Option<(f64, [f64; 3])> = None;
    for axis in 0..3 {
        // A shift along the direction of the crossing leads forward or back, not around.
        if along[axis].abs() > 0.7 * length {
            continue;
        }
        for sign in [-1.0, 1.0] {
            let size = crossing.iter().map(|state| exit(region, position(state), axis, sign));
            let size = size.fold(0.0, f64::max) + CLEARANCE;
            let mut shift = [0.0; 3];
            shift[axis] = sign * size;
            let moved: Vec<StateVector> = crossing
                .iter()
                .map(|state| {
                    let mut moved = *state;
                    moved[axis] += shift[axis];
                    moved
                })
                .collect();
            let is_free = moved.iter().all(|state| limits.allow_position(state))
                && regions.iter().all(|region| is_clear_of(&moved, region));
            if is_free && best.is_none_or(|(least, _)| size < least) {
                best = Some((size, shift));
            }
        }
    }
    best.map(|(_, shift)| shift)
}

/// Whether the segments between states, at least two, stay out of a region.
fn is_clear_of(states: &[StateVector], region: &KeepOut) -> bool {
    let mut ways = states.windows(2);
    ways.all(|pair| region.depth_between(position(&pair[0]), position(&pair[1])) <= 0.0)
}

/// Distance from a position inside a region to its surface, along an axis of the world.
fn exit(region: &KeepOut, position: [f64; 3], axis: usize, sign: f64) -> f64 {
    match region {
        KeepOut::Box { lower, upper } => {
            let (lower, upper) = (lower.to_array()[axis], upper.to_array()[axis]);
            if sign > 0.0 { upper - position[axis] } else { position[axis] - lower }
        }
        KeepOut::Sphere { centre, radius } => {
            let from: [f64; 3] = std::array::from_fn(|i| position[i] - centre.to_array()[i]);
            let ahead = sign * from[axis];
            let across = from.iter().map(|c| c * c).sum::<f64>() - ahead * ahead;
            (radius * radius - across).max(0.0).sqrt() - ahead
        }
    }
}

/// Shifts the states of a crossing, and those before and after it by less and less: along half a
/// cosine whose largest acceleration, `size pi^2 / (2 lead^2)`, is [`ACCELERATION`], or over the
/// time available if that is shorter.
fn shift_about(
    states: &mut [StateVector],
    period_s: f64,
    crossing: RangeInclusive<usize>,
    shift: [f64; 3],
) {
    let (first, last) = (*crossing.start(), *crossing.end());
    let size = shift.iter().map(|c| c * c).sum::<f64>().sqrt();
    let lead = PI * (size / (2.0 * ACCELERATION)).sqrt() / period_s;
    let before = lead.min(first as f64);
    let after = lead.min((states.len() - 1 - last) as f64);
    for (n, state) in states.iter_mut().enumerate() {
        // Distance to the crossing as a fraction of the lead, and its change per second.
        let (away, rate) = if n < first {
            ((first - n) as f64 / before, -1.0 / (before * period_s))
        } else if n > last {
            ((n - last) as f64 / after, 1.0 / (after * period_s))
        } else {
            (0.0, 0.0)
        };
        if away < 1.0 {
            let (sin, cos) = (PI * away).sin_cos();
            for (i, shift) in shift.into_iter().enumerate() {
                state[i] += (0.5 + 0.5 * cos) * shift;
                state[3 + i] -= 0.5 * PI * sin * rate * shift;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use vehicle::frame::Ned;

    use super::*;
    use crate::plan::flight_box::FlightBox;

    /// Two metres north in 40 steps.
    fn path() -> Vec<StateVector> {
        (0..=40)
            .map(|n| {
                let mut state = [0.0; 12];
                (state[0], state[2]) = (0.05 * n as f64, -1.0);
                state
            })
            .collect()
    }

    fn block(lower: [f64; 3], upper: [f64; 3]) -> KeepOut {
        let corner = |[n, e, d]: [f64; 3]| Ned::new(n, e, d);
        KeepOut::Box { lower: corner(lower), upper: corner(upper) }
    }

    fn bent(regions: &[KeepOut], limits: &StateLimits) -> Vec<StateVector> {
        let mut states = path();
        bend(&mut states, 0.05, regions, limits);
        states
    }

    fn is_clear(states: &[StateVector], regions: &[KeepOut]) -> bool {
        regions.iter().all(|region| is_clear_of(states, region))
    }

    #[test]
    fn clear_path_is_unchanged() {
        let beside = block([0.5, 0.1, -2.0], [1.0, 1.0, 0.0]);
        assert_eq!(bent(&[beside], &StateLimits::default()), path());
    }

    #[test]
    fn boxes_and_spheres_are_passed_on_the_nearer_side() {
        let regions = [block([0.9, -0.4, -2.0], [1.1, 0.2, 0.5])];
        let states = bent(&regions, &StateLimits::default());
        assert!(is_clear(&states, &regions));
        assert!((states[20][1] - 0.22).abs() < 1e-9 && states[20][2] == -1.0);
        assert_eq!((states[0], states[40]), (path()[0], path()[40]));
        // The velocities match the positions.
        for n in 5..35 {
            let slope = (states[n + 1][1] - states[n - 1][1]) / 0.1;
            assert!((slope - states[n][4]).abs() < 0.05, "{slope} {}", states[n][4]);
        }
        let ball = [KeepOut::Sphere { centre: Ned::new(1.0, 0.1, -1.0), radius: 0.3 }];
        let states = bent(&ball, &StateLimits::default());
        assert!(is_clear(&states, &ball) && states[20][1] < -0.2);
    }

    #[test]
    fn wall_thinner_than_a_step_is_avoided() {
        let wall = [block([1.01, -0.4, -2.0], [1.02, 0.2, 0.5])];
        let states = bent(&wall, &StateLimits::default());
        assert!(is_clear_of(&states, &wall[0]));
        assert!((states[20][1] - 0.22).abs() < 1e-9, "{:?}", states[20]);
    }

    #[test]
    fn limits_and_other_regions_determine_the_side() {
        let wall = block([0.9, -0.4, -2.0], [1.1, 0.2, 0.5]);
        let limits = StateLimits {
            position: Some(FlightBox {
                lower: Ned::new(-1.0, -1.0, -1.5),
                upper: Ned::new(3.0, 0.1, 0.0),
            }),
            ..StateLimits::default()
        };
        assert!(bent(&[wall], &limits)[20][1] < -0.4);
        let beside = block([0.0, 0.15, -3.0], [2.0, 0.5, 1.0]);
        let regions = [wall, beside];
        let states = bent(&regions, &StateLimits::default());
        assert!(is_clear(&states, &regions) && states[20][1] < -0.4);
    }

    #[test]
    fn path_that_starts_or_ends_inside_is_unchanged() {
        for region in [
            block([1.5, -1.0, -2.0], [3.0, 1.0, 0.0]),
            block([-1.0, -1.0, -2.0], [0.5, 1.0, 0.0]),
            block([-9.0; 3], [9.0; 3]),
        ] {
            assert_eq!(bent(&[region], &StateLimits::default()), path());
        }
    }
}
