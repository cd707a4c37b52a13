//! A motion in the search's form: states, and the periods between them.

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::rigid_body::State;

use crate::plan::state_vector::{STATES, StateVector};

/// The inputs between two states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// Each rotor's thrust over its largest.
    pub rotors: [f64; 4],
    /// s
    pub length_s: f64,
}

/// States, and the periods between them.
#[derive(Clone, Debug, PartialEq)]
pub struct Knots {
    /// One more than periods.
    pub states: Vec<State>,
    /// Inputs between the states.
    pub periods: Vec<Period>,
    /// Index of the state at each passage, with the finish last.
    pub passed: Vec<usize>,
}

impl Knots {
    /// Length, s.
    pub fn duration_s(&self) -> f64 {
        self.periods.iter().map(|period| period.length_s).sum()
    }

    /// Time of each passage, s, without the finish.
    pub fn passed_s(&self) -> Vec<f64> {
        let passages = self.passed.len().saturating_sub(1);
        let until = |at: &usize| -> f64 {
            self.periods.iter().take(*at).map(|period| period.length_s).sum()
        };
        self.passed.iter().take(passages).map(until).collect()
    }

    /// The index of the passage at each state, with the finish included.
    pub(super) fn passages(&self) -> Vec<Option<usize>> {
        let mut passages = vec![None; self.states.len()];
        for (number, at) in self.passed.iter().enumerate() {
            if let Some(passage) = passages.get_mut(*at) {
                *passage = Some(number);
            }
        }
        passages
    }
}

/// `state` moved by a deviation `(p, v, theta, omega)`, where theta is a rotation in body axes.
pub(super) fn moved(state: &State, by: &StateVector) -> State {
    let [pn, pe, pd, vn, ve, vd, a, b, c, p, q, r] = *by;
    let half = 0.5 * (a * a + b * b + c * c).sqrt();
    let share = if half < 1e-6 { 0.5 } else { 0.5 * half.sin() / half };
    let turn = Attitude { w: half.cos(), x: share * a, y: share * b, z: share * c };
    State {
        position: state.position + Ned::new(pn, pe, pd),
        velocity: state.velocity + Ned::new(vn, ve, vd),
        attitude: state.attitude.compose(turn).normalized(),
        body_rate: state.body_rate + Frd::new(p, q, r),
    }
}

/// The deviation from one state to another.
pub(super) fn difference(from: &State, to: &State) -> StateVector {
    let parts = [
        (to.position - from.position).to_array(),
        (to.velocity - from.velocity).to_array(),
        from.attitude.rotation_to(to.attitude).to_array(),
        (to.body_rate - from.body_rate).to_array(),
    ];
    let mut difference = [0.0; STATES];
    for (entry, part) in difference.iter_mut().zip(parts.iter().flatten()) {
        *entry = *part;
    }
    difference
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vehicle::frame::Euler;

    use super::*;

    proptest! {
        #[test]
        fn moving_by_the_difference_recovers_it(by in prop::array::uniform12(-1.0_f64..1.0)) {
            let state = State {
                attitude: Euler::new(0.4, -1.2, 2.0).attitude(),
                velocity: Ned::new(1.0, 2.0, 3.0),
                ..State::default()
            };
            let back = difference(&state, &moved(&state, &by));
            for (back, by) in back.iter().zip(&by) {
                prop_assert!((back - by).abs() < 1e-9, "{back} {by}");
            }
        }
    }
}
