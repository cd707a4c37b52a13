//! Regions that a plan avoids, at its states and between them.

use vehicle::frame::Ned;

use super::state_vector::{STATES, StateRow, StateVector};

/// A region that the vehicle's position must not enter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KeepOut {
    /// A ball.
    Sphere {
        /// m
        centre: Ned,
        /// m
        radius: f64,
    },
    /// A box aligned with the world's axes.
    Box {
        /// Corner with the least coordinates, m.
        lower: Ned,
        /// Corner with the greatest coordinates, m.
        upper: Ned,
    },
}

impl KeepOut {
    /// The point of the segment from a position (m) along `way` (m) that is deepest in the region,
    /// or nearest to it.
    fn deepest(&self, from: [f64; 3], way: [f64; 3]) -> Deepest {
        let at = |share: f64| {
            let (depth, gradient) = self.depth(along(from, way, share));
            Deepest { share, depth, gradient }
        };
        let mut best = at(0.0);
        let mut look = |share: f64| {
            if (0.0..=1.0).contains(&share) {
                let there = at(share);
                if there.depth > best.depth {
                    best = there;
                }
            }
        };
        look(1.0);
        match self {
            Self::Sphere { centre, .. } => {
                let off = std::array::from_fn(|i| from[i] - centre.to_array()[i]);
                look(-dot(&off, &way) / dot(&way, &way));
            }
            Self::Box { lower, upper } => {
                // Signed distances to the faces, positive inside, are linear along the segment.
                let (lower, upper) = (lower.to_array(), upper.to_array());
                let faces: [[f64; 2]; 6] = std::array::from_fn(|face| match (face / 2, face % 2) {
                    (i, 0) => [from[i] - lower[i], way[i]],
                    (i, _) => [upper[i] - from[i], -way[i]],
                });
                // Inside, the least of them counts; it is greatest where two are equal.
                for (k, [a, slope]) in faces.iter().enumerate() {
                    faces[k + 1..].iter().for_each(|[b, other]| look((b - a) / (slope - other)));
                }
                // Outside, the sum of squares of the negative ones counts, between two crossings.
                let crossing = |[a, slope]: [f64; 2]| {
                    if slope == 0.0 { 0.0 } else { (-a / slope).clamp(0.0, 1.0) }
                };
                let mut ends = faces.map(crossing);
                ends.sort_by(f64::total_cmp);
                for (start, end) in [0.0].iter().chain(&ends).zip(ends.iter().chain(&[1.0])) {
                    let middle = 0.5 * (start + end);
                    let (mut cross, mut square) = (0.0, 0.0);
                    for [a, slope] in faces.iter().filter(|[a, slope]| a + middle * slope < 0.0) {
                        cross += a * slope;
                        square += slope * slope;
                    }
                    // `clamp` would panic on a NaN bound.
                    look((-cross / square).max(*start).min(*end));
                }
            }
        }
        best
    }

    /// Depth (m) of the deepest position between `from` and `to` (m), ends included; negative if
    /// all are outside.
    pub fn depth_between(&self, from: [f64; 3], to: [f64; 3]) -> f64 {
        self.deepest(from, std::array::from_fn(|i| to[i] - from[i])).depth
    }

    /// The bound of a state that continues with its velocity for `ahead_s` seconds: the vehicle
    /// must stay `margin_m` or more away, between states too. The gradient is that of the deepest
    /// point, at its fraction of the segment: between two faces, the depth itself may have no
    /// gradient that leads out.
    pub(super) fn row(&self, state: &StateVector, ahead_s: f64, margin_m: f64) -> StateRow {
        let way = [3, 4, 5].map(|i| state[i] * ahead_s);
        let Deepest { share, depth, gradient: slopes } = self.deepest(position(state), way);
        let mut gradient = [0.0; STATES];
        for (i, slope) in slopes.into_iter().enumerate() {
            gradient[i] = slope;
            gradient[3 + i] = share * ahead_s * slope;
        }
        StateRow { excess: depth + margin_m, gradient }
    }

    /// The region enlarged by `margin_m` (a box grows along each axis).
    pub(super) fn inflated(&self, margin_m: f64) -> Self {
        match *self {
            Self::Sphere { centre, radius } => Self::Sphere { centre, radius: radius + margin_m },
            Self::Box { lower, upper } => {
                let out = Ned::new(margin_m, margin_m, margin_m);
                Self::Box { lower: lower - out, upper: upper + out }
            }
        }
    }

    /// Depth (m) of a position (m) inside the region, negative outside, and its gradient
    /// (dimensionless).
    pub(super) fn depth(&self, position: [f64; 3]) -> (f64, [f64; 3]) {
        match self {
            Self::Sphere { centre, radius } => {
                let from = std::array::from_fn(|i| position[i] - centre.to_array()[i]);
                let distance = norm(&from);
                // At the exact centre, every direction out is equally short.
                let out =
                    if distance > 0.0 { from.map(|c| c / distance) } else { [0.0, 0.0, -1.0] };
                (radius - distance, out.map(|c| -c))
            }
            Self::Box { lower, upper } => {
                let (lower, upper) = (lower.to_array(), upper.to_array());
                // Beyond each face: positive outside.
                let beyond: [(f64, f64); 3] = std::array::from_fn(|i| {
                    let (under, over) = (lower[i] - position[i], position[i] - upper[i]);
                    if under > over { (under, -1.0) } else { (over, 1.0) }
                });
                let outside: [f64; 3] = std::array::from_fn(|i| beyond[i].0.max(0.0) * beyond[i].1);
                let distance = norm(&outside);
                if distance > 0.0 {
                    return (-distance, outside.map(|c| -c / distance));
                }
                let (nearest, (face, side)) = beyond
                    .into_iter()
                    .enumerate()
                    .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
                    .unwrap_or((0, (0.0, 1.0)));
                let mut gradient = [0.0; 3];
                gradient[nearest] = -side;
                (-face, gradient)
            }
        }
    }
}

/// The point of a segment that is deepest in a region, or nearest to it.
#[derive(Clone, Copy, Debug)]
struct Deepest {
    /// Fraction of the segment up to it.
    share: f64,
    /// m, negative outside.
    depth: f64,
    /// Gradient of the depth with respect to the position.
    gradient: [f64; 3],
}

/// A state's position, m.
pub(super) fn position(state: &StateVector) -> [f64; 3] {
    [state[0], state[1], state[2]]
}

/// The point at a fraction of the segment.
fn along(from: [f64; 3], way: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|i| from[i] + share * way[i])
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(v: &[f64; 3]) -> f64 {
    dot(v, v).sqrt()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn regions() -> Vec<KeepOut> {
        vec![
            KeepOut::Sphere { centre: Ned::new(0.3, -0.2, 0.1), radius: 0.7 },
            KeepOut::Box { lower: Ned::new(-0.5, -0.4, -0.6), upper: Ned::new(0.2, 0.6, 0.3) },
        ]
    }

    #[test]
    fn depths_match_hand_calculations() {
        let [ball, block] = [regions()[0], regions()[1]];
        assert_eq!(ball.depth([0.3, -0.2, 1.8]), (0.7 - 1.7, [0.0, 0.0, -1.0]));
        // Inside, the nearest face counts; outside, the nearest corner, edge or face.
        let (depth, gradient) = block.depth([0.1, 0.0, 0.0]);
        assert!((depth - 0.1).abs() < 1e-15);
        assert_eq!(gradient, [-1.0, 0.0, 0.0]);
        let (depth, gradient) = block.depth([0.5, 1.0, 0.0]);
        assert!((depth + 0.5).abs() < 1e-12);
        assert!((gradient[0] + 0.6).abs() < 1e-12 && (gradient[1] + 0.8).abs() < 1e-12);
        // At the centre every direction out is equally short; one is returned.
        let (depth, gradient) = ball.depth([0.3, -0.2, 0.1]);
        assert_eq!(depth, 0.7);
        assert_eq!(norm(&gradient), 1.0);
    }

    #[test]
    fn segment_between_positions_is_checked() {
        let [ball, block] = [regions()[0], regions()[1]];
        // Along a face, or at rest on it.
        assert_eq!(block.depth_between([-0.5, 0.0, 0.0], [-0.5, 0.3, 0.0]), 0.0);
        assert_eq!(block.depth_between([-0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]), 0.0);
        // A wall a few millimetres thick, far thinner than the length of a step.
        let wall =
            KeepOut::Box { lower: Ned::new(0.0, -1.0, -1.0), upper: Ned::new(0.004, 1.0, 1.0) };
        let through = wall.depth_between([-0.01, 0.0, 0.0], [0.03, 0.1, 0.0]);
        assert!((through - 0.002).abs() < 1e-12, "{through}");
        assert!(wall.depth_between([-0.03, 0.0, 0.0], [-0.01, 0.1, 0.0]) < 0.0);
        let chord = ball.depth_between([-1.0, -0.2, 0.7], [1.5, -0.2, 0.7]);
        assert!((chord - 0.1).abs() < 1e-12, "{chord}");
        // A segment that cuts a corner.
        let cut = block.depth_between([0.1, 0.7, 0.0], [0.3, 0.5, 0.0]);
        assert!(cut.abs() < 1e-9, "{cut}");
        let cut = block.depth_between([0.0, 0.7, 0.0], [0.3, 0.4, 0.0]);
        assert!((cut - 0.05).abs() < 1e-9, "{cut}");
    }

    #[test]
    fn non_finite_positions_never_panic() {
        for region in regions() {
            for at in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
                for axis in 0..3 {
                    let mut strange = [0.1; 3];
                    strange[axis] = at;
                    region.depth_between(strange, [0.0; 3]);
                    region.depth_between([0.0; 3], strange);
                    region.depth_between(strange, strange);
                }
            }
        }
    }

    proptest! {
        #[test]
        fn no_point_on_the_segment_is_deeper(
            from in prop::array::uniform3(-1.0_f64..1.0),
            to in prop::array::uniform3(-1.0_f64..1.0),
            share in 0.0_f64..1.0,
        ) {
            let way = std::array::from_fn(|i| to[i] - from[i]);
            for region in regions() {
                let here = region.depth(along(from, way, share)).0;
                let deepest = region.depth_between(from, to);
                prop_assert!(here <= deepest + 1e-12, "{here} {deepest}");
            }
        }
    }

    proptest! {
        #[test]
        fn gradients_match_finite_differences(
            state in prop::array::uniform12(-1.0_f64..1.0),
        ) {
            for region in regions() {
                let way = |state: &StateVector| [3, 4, 5].map(|i| 0.1 * state[i]);
                let share = region.deepest(position(&state), way(&state)).share;
                let depth =
                    |state: &StateVector| region.depth(along(position(state), way(state), share)).0;
                let row = region.row(&state, 0.1, 0.0);
                prop_assert_eq!(region.row(&state, 0.1, 0.25).excess, row.excess + 0.25);
                prop_assert_eq!(row.excess, depth(&state));
                prop_assert_ne!(row.is_slope_of(depth, &state), Some(false));
            }
        }
    }
}
