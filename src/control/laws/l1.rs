//! L1 adaptive augmentation of the geometric law.

use vehicle::frame::{Frd, Ned};
use vehicle::rigid_body::State;

use super::geometric::{Geometric, POSITION, TrackingError, VELOCITY, per_axis};
use super::{Command, ControlLaw, ControlProblem, DesignError, Gain, LawSpec};
use crate::setpoint::Reference;

/// The law in the table of laws.
pub(super) static SPEC: LawSpec = LawSpec {
    id: "l1",
    summary: "The geometric law with L1 adaptive augmentation (Wu et al. 2022).",
    gains: &[
        POSITION,
        VELOCITY,
        Gain {
            key: "gains.predictor_per_s",
            unit: "1/s",
            values: 1,
            meaning: "pole of the state predictor: -A_s",
        },
        Gain {
            key: "gains.filter_per_s",
            unit: "1/s",
            values: 2,
            meaning: "cut-off of the low-pass filter, horizontal and vertical",
        },
    ],
    design: |problem| Ok(Box::new(L1::design(problem)?)),
};

/// Pole of the state predictor, 1/s.
const PREDICTOR_PER_S: f64 = 5.0;
/// Cut-off of the filter, over the natural frequency of the geometric law's position loop.
const FILTER_SHARE: f64 = 0.5;
/// The largest uncertainty that is cancelled along each axis, m/s^2.
const UNCERTAINTY_MAX_M_S2: f64 = 6.0;
/// The predictor restarts after a longer time between samples, s.
const GAP_MAX_S: f64 = 0.2;

/// The translational part of Wu, Cheng, Ackerman, Gahlawat, Lakshmanan, Zhao and Hovakimyan ("L1
/// adaptive augmentation for geometric tracking control of quadrotors", ICRA 2022), around
/// [`Geometric`]:
///
/// ```text
/// de_hat/dt = -(T/m) R e3 - f* + sigma + A_s (e_hat - e)      state predictor, A_s = -a I
/// sigma     = -Phi^-1 exp(A_s dt) (e_hat - e)                  piecewise constant, each sample
/// Phi       = A_s^-1 (exp(A_s dt) - I)
/// f         = f_geometric - C(s) sigma                        C a first-order low pass
/// ```
///
/// `e = v - v*`, and `f*` is the reference's own force.
///
/// Differences from the paper: the predictor predicts the velocity error in place of the velocity,
/// so it does not learn again what the reference's force already compensates; the angular part is
/// left out, because the on-board loop makes the moments; and all of `C sigma` is subtracted from
/// the wanted force, including the part across the thrust, since the attitude turns to it. The
/// cut-off is a fraction of the position loop's natural frequency, because an attitude loop, delay
/// and rotor lag lie between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct L1 {
    law: Geometric,
    mass_kg: f64,
    predictor_per_s: f64,
    /// Horizontal and vertical.
    filter_per_s: [f64; 2],
    memory: Option<Memory>,
}

/// State carried from one sample to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Memory {
    /// Velocity error, predicted; `velocity` is the measured one.
    predicted: Ned,
    velocity: Ned,
    sigma: Ned,
    filtered: Ned,
    /// Acceleration of the last command less the reference's.
    acceleration: Ned,
}

impl L1 {
    /// Designs the law for a vehicle.
    ///
    /// # Errors
    /// As [`Geometric::design`].
    pub fn design(problem: &ControlProblem) -> Result<Self, DesignError> {
        let law = Geometric::design(problem)?;
        let gains = &problem.settings.gains;
        let cut_off = law.position_per_s2().map(|stiffness| FILTER_SHARE * stiffness.sqrt());
        let [predictor_per_s] = gains.get("predictor_per_s").unwrap_or([PREDICTOR_PER_S]);
        Ok(Self {
            law,
            mass_kg: problem.vehicle.mass_kg,
            predictor_per_s,
            filter_per_s: gains.get("filter_per_s").unwrap_or(cut_off),
            memory: None,
        })
    }

    /// The predictor, uncertainty and filter after a step of `dt` seconds that ended at `velocity`.
    fn learn(&self, memory: &Memory, velocity: Ned, dt: f64) -> Memory {
        let pole = -self.predictor_per_s;
        let decay = (pole * dt).exp();
        // The exact solution of the predictor over the step.
        let drive = memory.acceleration + memory.sigma - memory.velocity * pole;
        let predicted = memory.predicted * decay + drive * ((decay - 1.0) / pole);
        let sigma = (predicted - velocity) * (-pole * decay / (decay - 1.0));
        let sigma = sigma.map(|it| it.clamp(-UNCERTAINTY_MAX_M_S2, UNCERTAINTY_MAX_M_S2));
        let share = self.filter_per_s.map(|cut_off| 1.0 - (-cut_off * dt).exp());
        let step = (sigma - memory.filtered).scale_by(per_axis(share));
        Memory { predicted, velocity, sigma, filtered: memory.filtered + step, ..*memory }
    }
}

impl ControlLaw for L1 {
    fn command(&mut self, state: &State, reference: &Reference, dt_s: f64) -> Command {
        let TrackingError { velocity, .. } = self.law.error(state, reference);
        let fresh = Memory {
            predicted: velocity,
            velocity,
            sigma: Ned::zero(),
            filtered: Ned::zero(),
            acceleration: Ned::zero(),
        };
        let mut memory = match self.memory {
            Some(memory) if dt_s > 0.0 && dt_s < GAP_MAX_S => self.learn(&memory, velocity, dt_s),
            Some(memory) => Memory { filtered: memory.filtered, ..fresh },
            None => fresh,
        };
        if !memory.filtered.is_finite() || !memory.predicted.is_finite() {
            memory = fresh;
        }
        let command = self.law.command_with_force(state, reference, -memory.filtered);
        let thrust = command.setpoint.thrust_n / self.mass_kg;
        memory.acceleration = state.attitude.to_world(Frd::new(0.0, 0.0, -thrust))
            - self.law.reference_force(reference);
        self.memory = memory.acceleration.is_finite().then_some(memory);
        command
    }

    fn reset(&mut self) {
        self.memory = None;
    }
}

#[cfg(test)]
mod tests {
    use super::super::quad::{QUAD, designed};
    use super::*;
    use crate::setpoint::Setpoint;

    fn law() -> L1 {
        designed(L1::design).expect("a law")
    }

    #[test]
    fn point_mass_disturbance_is_estimated_and_cancelled() {
        let feedforward = Setpoint { thrust_n: QUAD.hover_thrust_n(), ..Setpoint::default() };
        let reference = Reference { feedforward, ..Reference::default() };
        let (mut law, mut state, dt) = (law(), State::default(), 0.01);
        for _ in 0..2000 {
            let sent = law.command(&state, &reference, dt).setpoint;
            // A push down of 1.5 m/s^2.
            let down = QUAD.gravity + 1.5 - sent.thrust_n / QUAD.mass_kg;
            state.velocity += Ned::new(0.0, 0.0, down * dt);
            state.position += state.velocity * dt;
        }
        let memory = law.memory.expect("a memory");
        assert!((memory.filtered.down() - 1.5).abs() < 0.1, "{memory:?}");
        assert!(state.position.norm() < 0.02, "{:?}", state.position);
        law.reset();
        assert_eq!(law.memory, None);
    }
}
