//! The autopilot's mixer: motor thrusts for a normalised torque of 1.

use nalgebra::{Matrix4, Vector4};

use super::{Autopilot, Parameters, RotorFact};

/// Thrust of each motor, as a share of full thrust, for a normalised torque of 1 about front, right
/// and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixer {
    /// Shares by axis, then by motor.
    pub shares: [[f64; 4]; 3],
}

/// Shares below this fraction of the largest count as 0; they come from rounding of angles.
const NO_SIDE: f64 = 1e-3;

impl Mixer {
    /// The mixer of a quadrotor's autopilot. Returns `None` if the parameters do not determine it,
    /// or the rotors have no authority about an axis.
    pub fn of(parameters: &Parameters) -> Option<Self> {
        let rotors: [RotorFact; 4] = parameters.rotors().try_into().ok()?;
        match parameters.autopilot()? {
            Autopilot::Px4 => Self::px4(parameters, &rotors),
            Autopilot::ArduCopter => Some(Self::arducopter(&rotors)),
        }
    }

    /// The moment of a normalised torque of 1 about front, right and down, N m. `levers` are by
    /// axis, in N m per N of a rotor's thrust.
    pub fn moments(&self, levers: &[[f64; 4]; 3], thrust_max_n: [f64; 4]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            (0..4).map(|i| self.shares[axis][i] * levers[axis][i] * thrust_max_n[i]).sum()
        })
    }

    /// PX4's control allocation: the inverse of the effectiveness matrix from CA_ROTORn_PX, _PY,
    /// _KM and _CT, with scaled columns. Roll and pitch have the norm sqrt(n/2) over the n motors
    /// that act on the axis, where the larger of the two scales applies to both. Yaw has a largest
    /// entry of 1.
    fn px4(parameters: &Parameters, rotors: &[RotorFact; 4]) -> Option<Self> {
        let number = |at: usize, end: &str| parameters.number(&format!("CA_ROTOR{at}_{end}"));
        let mut does = Matrix4::zeros();
        for (at, rotor) in rotors.iter().enumerate() {
            let thrust = number(at, "CT").filter(|ct| *ct > 0.0).unwrap_or(6.5);
            let torque = number(at, "KM")?;
            let column = Vector4::new(-rotor.right, rotor.front, torque, -1.0) * thrust;
            does.set_column(at, &column);
        }
        let mix = does.try_inverse().filter(|mix| mix.iter().all(|m| m.is_finite()))?;
        let column = |axis: usize| -> [f64; 4] { std::array::from_fn(|i| mix[(i, axis)]) };
        let scale = |axis: usize| {
            let column = column(axis);
            let turning = column.iter().filter(|m| m.abs() > NO_SIDE).count();
            let squares: f64 = column.iter().map(|m| m * m).sum();
            (turning > 0).then(|| (squares / (turning as f64 / 2.0)).sqrt())
        };
        let tilt = scale(0)?.max(scale(1)?);
        let yaw = column(2).into_iter().fold(0.0, f64::max);
        if yaw <= 0.0 {
            return None;
        }
        let scaled = |axis: usize, by: f64| column(axis).map(|m| m / by);
        Some(Self { shares: [scaled(0, tilt), scaled(1, tilt), scaled(2, yaw)] })
    }

    /// ArduPilot's factors: each axis in proportion to the motors' positions or spins, scaled to a
    /// largest magnitude of 0.5.
    fn arducopter(rotors: &[RotorFact; 4]) -> Self {
        let halved = |sides: [f64; 4]| {
            let largest = sides.iter().fold(0.0, |most: f64, side| most.max(side.abs()));
            sides.map(|side| {
                let share = if largest > 0.0 { side / largest } else { 0.0 };
                if share.abs() < NO_SIDE { 0.0 } else { 0.5 * share }
            })
        };
        Self {
            shares: [
                halved(rotors.map(|rotor| -rotor.right)),
                halved(rotors.map(|rotor| rotor.front)),
                halved(rotors.map(|rotor| f64::from(rotor.spin))),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{COPTER, SIH, parameters};
    use super::*;

    fn close(found: [f64; 3], expected: [f64; 3]) {
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9 * expected.abs(), "{found} {expected}");
        }
    }

    #[test]
    fn px4_square_quad_roll_share_is_sqrt_half() {
        let mixer = Mixer::of(&parameters(SIH)).expect("a mixer");
        let half = 0.5f64.sqrt();
        let expected =
            [[-half, half, half, -half], [half, -half, half, -half], [1.0, 1.0, -1.0, -1.0]];
        for (found, expected) in mixer.shares.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-12, "{mixer:?}");
        }
        // SIH: arms of 0.2 m, 5 N and 0.1 N m per rotor.
        let levers = [[-0.2, 0.2, 0.2, -0.2], [0.2, -0.2, 0.2, -0.2], [0.02, 0.02, -0.02, -0.02]];
        close(mixer.moments(&levers, [5.0; 4]), [2.0 * 2f64.sqrt(), 2.0 * 2f64.sqrt(), 0.4]);
    }

    #[test]
    fn wide_px4_frame_scales_roll_and_pitch_alike() {
        let wide = SIH.replace("_PY 1", "_PY 2").replace("_PY -1", "_PY -2");
        let mixer = Mixer::of(&parameters(&wide)).expect("a mixer");
        let half = 0.5f64.sqrt();
        // The inverse's roll column is half its pitch column; the scale of pitch divides both.
        assert!((mixer.shares[0][0] + 0.5 * half).abs() < 1e-12, "{mixer:?}");
        assert!((mixer.shares[1][0] - half).abs() < 1e-12, "{mixer:?}");
    }

    #[test]
    fn arducopter_plus_frame_rolls_with_two_motors_at_half() {
        let mixer = Mixer::of(&parameters(COPTER)).expect("a mixer");
        assert_eq!(mixer.shares[0], [-0.5, 0.5, 0.0, 0.0]);
        assert_eq!(mixer.shares[1], [0.0, 0.0, 0.5, -0.5]);
        assert_eq!(mixer.shares[2], [0.5, 0.5, -0.5, -0.5]);
    }

    #[test]
    fn collinear_rotors_have_no_mixer() {
        let line = SIH.replace("_PX -1", "_PX 1");
        assert_eq!(Mixer::of(&parameters(&line)), None);
    }
}
