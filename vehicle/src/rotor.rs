//! The rotors: the mixer between outputs, force and moments, and the lag of the rotors' states.

use crate::params::{ROTORS, RotorParams};
use crate::scalar::Scalar;

/// The firmware's mixer, which distributes the wrench among the rotors: the collective thrust along
/// -z body (N), and the moments about body front, right and down (N m).
///
/// Rotor thrusts f solve `[T, Mx, My, Mz] = A f`; the columns of A are
/// `(1, -y_i, x_i, spin_i drag_torque_per_thrust_i)`, and outputs are `u_i = f_i / thrust_max_i`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allocation {
    effectiveness: [[f64; ROTORS]; 4],
    inverse: [[f64; 4]; ROTORS],
    thrust_max: [f64; ROTORS],
}

impl Allocation {
    /// The allocation of these rotors. Returns `None` if A is singular, or if its condition number
    /// is 1e6 or more, with lengths scaled by the largest arm and drag torques by the largest
    /// torque per thrust.
    pub fn new(rotors: &[RotorParams; ROTORS]) -> Option<Self> {
        let yaw = |r: &RotorParams| f64::from(r.spin) * r.drag_torque_per_thrust_m;
        let arm = rotors.iter().flat_map(|r| [r.position_m[0], r.position_m[1]]);
        let arm = arm.fold(0.0_f64, |a, c| a.max(c.abs()));
        let torque = rotors.iter().map(yaw).fold(0.0_f64, |a, c| a.max(c.abs()));
        let rows = [1.0, arm, arm, torque];
        let effectiveness = [
            rotors.map(|_| 1.0),
            rotors.map(|r| -r.position_m[1]),
            rotors.map(|r| r.position_m[0]),
            rotors.each_ref().map(yaw),
        ];
        let scaled: [[f64; 4]; 4] =
            std::array::from_fn(|i| effectiveness[i].map(|value| value / rows[i]));
        let inverse = inverse(scaled)?;
        let condition = infinity_norm(&scaled) * infinity_norm(&inverse);
        // Also false for NaN, as when every arm or torque is 0.
        (condition < 1e6).then(|| Self {
            effectiveness,
            inverse: inverse.map(|row| std::array::from_fn(|j| row[j] / rows[j])),
            thrust_max: rotors.map(|r| r.thrust_max_n),
        })
    }

    /// Outputs that produce collective (N) and moments (N m); each is clipped to 0..=1.
    pub fn outputs(&self, wrench: [f64; 4]) -> [f64; ROTORS] {
        self.unclipped_outputs(wrench).map(|u| u.clamp(0.0, 1.0))
    }

    /// Outputs before clipping; one outside 0..=1 means that the wrench is unattainable.
    pub fn unclipped_outputs(&self, wrench: [f64; 4]) -> [f64; ROTORS] {
        let thrusts = product(&self.inverse, wrench);
        std::array::from_fn(|i| thrusts[i] / self.thrust_max[i])
    }

    /// Collective (N) and moments (N m) of the nominal vehicle at these outputs, without lag.
    pub fn wrench(&self, outputs: [f64; ROTORS]) -> [f64; 4] {
        product(&self.effectiveness, std::array::from_fn(|i| outputs[i] * self.thrust_max[i]))
    }

    /// Collective thrust at full output in N.
    pub fn collective_max(&self) -> f64 {
        self.thrust_max.iter().sum()
    }

    /// Each rotor's thrust at full output in N.
    pub fn thrust_max(&self) -> &[f64; ROTORS] {
        &self.thrust_max
    }

    /// d(thrust of rotor i)/d(wrench component j), the inverse of A.
    pub fn inverse(&self) -> &[[f64; 4]; ROTORS] {
        &self.inverse
    }
}

fn product(matrix: &[[f64; 4]; 4], vector: [f64; 4]) -> [f64; 4] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, x)| a * x).sum())
}

fn infinity_norm(matrix: &[[f64; 4]; 4]) -> f64 {
    matrix.iter().map(|row| row.iter().map(|a| a.abs()).sum()).fold(0.0, f64::max)
}

/// Gauss-Jordan elimination with row pivoting; `None` if a pivot vanishes.
fn inverse(mut a: [[f64; 4]; 4]) -> Option<[[f64; 4]; 4]> {
    let mut b: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)));
    for column in 0..4 {
        let pivot =
            (column..4).max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()))?;
        a.swap(column, pivot);
        b.swap(column, pivot);
        let divisor = a[column][column];
        if !divisor.is_normal() {
            return None;
        }
        a[column] = a[column].map(|value| value / divisor);
        b[column] = b[column].map(|value| value / divisor);
        for row in (0..4).filter(|&row| row != column) {
            let factor = a[row][column];
            for j in 0..4 {
                a[row][j] -= factor * a[column][j];
                b[row][j] -= factor * b[column][j];
            }
        }
    }
    Some(b)
}

/// Exact first-order lag of the rotors' states over a fixed step: s(t + h) = u + (s(t) - u) exp(-h
/// / tau).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    tau: f64,
    step: f64,
    half: f64,
    full: f64,
}

impl Lag {
    /// A lag of `tau` seconds over steps of `step` seconds; `tau` = 0 means no lag.
    pub fn new(tau: f64, step: f64) -> Self {
        let decay = |time: f64| if tau > 0.0 { (-time / tau).exp() } else { 0.0 };
        Self { tau, step, half: decay(0.5 * step), full: decay(step) }
    }

    /// Whether the states follow the outputs without lag.
    pub fn is_none(&self) -> bool {
        self.tau <= 0.0
    }

    /// The states at the middle and end of a step with `outputs` held.
    #[inline(always)]
    pub fn advance<T: Scalar>(
        &self,
        states: &[T; ROTORS],
        outputs: &[T; ROTORS],
    ) -> [[T; ROTORS]; 2] {
        let after =
            |decay: f64| std::array::from_fn(|i| outputs[i] + (states[i] - outputs[i]) * decay);
        [after(self.half), after(self.full)]
    }

    /// The states' mean over a step and their values at its end, where outputs move linearly from
    /// the first to the last. With r = (last - first) / h, s(t) = first + r (t - tau) + (s(0) -
    /// first + r tau) exp(-t / tau), which is smooth in tau down to 0.
    pub fn follow(
        &self,
        states: &[f64; ROTORS],
        [first, last]: [&[f64; ROTORS]; 2],
    ) -> [[f64; ROTORS]; 2] {
        let late = self.tau / self.step;
        let of_rotor = |i: usize| {
            let change = (last[i] - first[i]) * late;
            let off = states[i] - first[i] + change;
            let mean = 0.5 * (first[i] + last[i]) - change + off * late * (1.0 - self.full);
            [mean, last[i] - change + off * self.full]
        };
        let found: [[f64; 2]; ROTORS] = std::array::from_fn(of_rotor);
        [found.map(|[mean, _]| mean), found.map(|[_, end]| end)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn x_layout() -> [RotorParams; 4] {
        [(0.1, 0.12, 1), (-0.1, 0.12, -1), (-0.1, -0.12, 1), (0.1, -0.12, -1)].map(
            |(x, y, spin)| RotorParams {
                position_m: [x, y, 0.0],
                spin,
                thrust_max_n: 5.0,
                drag_torque_per_thrust_m: 0.016,
            },
        )
    }

    #[test]
    fn left_rotors_roll_right_and_front_rotors_pitch_up() {
        let allocation = Allocation::new(&x_layout()).unwrap();
        let roll = allocation.outputs([10.0, 0.1, 0.0, 0.0]);
        assert!(roll[2] > roll[0] && roll[3] > roll[1]);
        let pitch = allocation.outputs([10.0, 0.0, 0.1, 0.0]);
        assert!(pitch[0] > pitch[1] && pitch[3] > pitch[2]);
        let yaw = allocation.outputs([10.0, 0.0, 0.0, 0.01]);
        assert!(yaw[0] > yaw[1] && yaw[2] > yaw[3]);
    }

    #[test]
    fn layout_without_control_authority_is_refused() {
        let mut same_spin = x_layout();
        same_spin.iter_mut().for_each(|r| r.spin = 1);
        assert!(Allocation::new(&same_spin).is_none());
        let mut in_line = x_layout();
        in_line.iter_mut().for_each(|r| r.position_m[1] = 0.0);
        assert!(Allocation::new(&in_line).is_none());
        let mut one_point = x_layout();
        one_point.iter_mut().for_each(|r| r.position_m = [0.0; 3]);
        assert!(Allocation::new(&one_point).is_none());
    }

    proptest! {
        #[test]
        fn unclipped_outputs_reproduce_the_wrench(t in 0.0..20.0, x in -1.0..1.0, y in -1.0..1.0, z in -0.2..0.2) {
            let allocation = Allocation::new(&x_layout()).unwrap();
            let wrench = [t, x, y, z];
            let back = allocation.wrench(allocation.unclipped_outputs(wrench));
            for (found, expected) in back.iter().zip(wrench) {
                prop_assert!((found - expected).abs() < 1e-12);
            }
            prop_assert!(allocation.outputs(wrench).iter().all(|u| (0.0..=1.0).contains(u)));
        }
    }

    #[test]
    fn lag_step_response_is_exponential() {
        let lag = Lag::new(0.04, 1e-3);
        let mut states = [0.2; 4];
        for _ in 0..40 {
            states = lag.advance(&states, &[1.0, 0.2, 0.0, 0.5])[1];
        }
        let e = (-1.0_f64).exp();
        let expected = [1.0 - 0.8 * e, 0.2, 0.2 * e, 0.5 - 0.3 * e];
        for (s, expected) in states.iter().zip(expected) {
            assert!((s - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn lag_of_a_ramp_matches_many_held_steps() {
        let (first, last) = ([0.2, 0.5, 0.9, 0.4], [0.6, 0.5, 0.1, 0.5]);
        let start = [0.3, 0.4, 0.9, 0.0];
        for tau in [0.0, 1e-4, 0.003, 0.04] {
            let [mean, end] = Lag::new(tau, 0.01).follow(&start, [&first, &last]);
            let fine = Lag::new(tau, 1e-6);
            let (mut state, mut sum) = (start, [0.0; 4]);
            for k in 0..10_000 {
                let share = (f64::from(k) + 0.5) * 1e-4;
                let u = std::array::from_fn(|i| first[i] + share * (last[i] - first[i]));
                let [middle, after] = fine.advance(&state, &u);
                sum.iter_mut().zip(middle).for_each(|(sum, s)| *sum += s * 1e-4);
                state = after;
            }
            for i in 0..4 {
                assert!((mean[i] - sum[i]).abs() < 1e-5, "{tau}: {} {}", mean[i], sum[i]);
                assert!((end[i] - state[i]).abs() < 1e-4, "{tau}");
            }
        }
    }
}
