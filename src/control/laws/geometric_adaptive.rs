//! Geometric tracking with an adaptive term, which learns the external force from the tracking
//! errors.

use vehicle::frame::Ned;
use vehicle::rigid_body::State;

use super::geometric::{Geometric, POSITION, TrackingError, VELOCITY, per_axis};
use super::{Command, ControlLaw, ControlProblem, DesignError, Gain, LawSpec};
use crate::setpoint::Reference;

/// The law in the table of laws.
pub(super) static SPEC: LawSpec = LawSpec {
    id: "geometric-adaptive",
    summary: "The geometric law with an adaptive force (Goodarzi, Lee, Lee 2015).",
    gains: &[
        POSITION,
        VELOCITY,
        Gain {
            key: "gains.adaptation_per_s2",
            unit: "1/s^2",
            values: 2,
            meaning: "rate of adaptation, horizontal and vertical: gamma_x/m",
        },
        Gain {
            key: "gains.mixing_per_s",
            unit: "1/s",
            values: 2,
            meaning: "share of the position error in adaptation, horizontal and vertical: c1",
        },
    ],
    design: |problem| Ok(Box::new(GeometricAdaptive::design(problem)?)),
};

/// The largest learned force over mass along each axis, m/s^2: the paper's `B_theta`.
const FORCE_MAX_M_S2: f64 = 6.0;
/// `gamma c1` over `kx kv`. By Routh, the linear loop is stable for `gamma c1 < kv (kx + gamma)`, and
/// so for every share up to 1.
const INTEGRAL_SHARE: f64 = 0.15;

/// The position part of Goodarzi, Lee and Lee ("Geometric adaptive tracking control of a quadrotor
/// unmanned aerial vehicle on SE(3) for agile maneuvers", ASME J. Dyn. Sys. Meas. Control 137,
/// 2015): [`Geometric`] with the uncertainty `W theta`, `W = I`, cancelled:
///
/// ```text
/// f         = f* - kx e_p - kv e_v - theta            wanted force over mass (m/s^2)
/// dtheta/dt = gamma (e_v + c1 e_p), |theta_i| <= B    world axes
/// ```
///
/// About an equilibrium this is a PID controller whose integral acts on the mixed error. The
/// paper's attitude part adapts moments, which belong to the on-board loop here. Gains that are not
/// set follow from the geometric law's: `c1` is its natural frequency, and `gamma c1` a fraction of
/// `kx kv`, below which the linear loop is stable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometricAdaptive {
    law: Geometric,
    /// Horizontal and vertical.
    adaptation_per_s2: [f64; 2],
    mixing_per_s: [f64; 2],
    theta: Ned,
}

impl GeometricAdaptive {
    /// Designs the law for a vehicle.
    ///
    /// # Errors
    /// As [`Geometric::design`].
    pub fn design(problem: &ControlProblem) -> Result<Self, DesignError> {
        let law = Geometric::design(problem)?;
        let (stiffness, damping) = (law.position_per_s2(), law.velocity_per_s());
        let gains = &problem.settings.gains;
        let mixing_per_s = gains.get("mixing_per_s").unwrap_or(stiffness.map(f64::sqrt));
        let adaptation =
            std::array::from_fn(|i| INTEGRAL_SHARE * stiffness[i] * damping[i] / mixing_per_s[i]);
        Ok(Self {
            law,
            adaptation_per_s2: gains.get("adaptation_per_s2").unwrap_or(adaptation),
            mixing_per_s,
            theta: Ned::zero(),
        })
    }
}

impl ControlLaw for GeometricAdaptive {
    fn command(&mut self, state: &State, reference: &Reference, dt_s: f64) -> Command {
        let TrackingError { position, velocity, .. } = self.law.error(state, reference);
        let mixed = velocity + position.scale_by(per_axis(self.mixing_per_s));
        let learned = self.theta + mixed.scale_by(per_axis(self.adaptation_per_s2)) * dt_s;
        if learned.is_finite() {
            self.theta = learned.map(|force| force.clamp(-FORCE_MAX_M_S2, FORCE_MAX_M_S2));
        }
        self.law.command_with_force(state, reference, -self.theta)
    }

    fn reset(&mut self) {
        self.theta = Ned::zero();
    }
}

#[cfg(test)]
mod tests {
    use super::super::quad::{QUAD, designed};
    use super::*;
    use crate::setpoint::Setpoint;

    fn law() -> GeometricAdaptive {
        designed(GeometricAdaptive::design).expect("a law")
    }

    fn hover() -> Reference {
        let feedforward = Setpoint { thrust_n: QUAD.hover_thrust_n(), ..Setpoint::default() };
        Reference { feedforward, ..Reference::default() }
    }

    #[test]
    fn heavier_vehicle_is_held_without_steady_state_error() {
        // A point mass whose thrust acts at once and is a fifth too weak.
        let (mut law, mut state, dt) = (law(), State::default(), 0.01);
        for _ in 0..3000 {
            let sent = law.command(&state, &hover(), dt).setpoint;
            let down = QUAD.gravity - 0.8 * sent.thrust_n / QUAD.mass_kg;
            state.velocity += Ned::new(0.0, 0.0, down * dt);
            state.position += state.velocity * dt;
        }
        assert!(state.position.norm() < 1e-3, "{:?}", state.position);
        assert!((law.theta.down() - QUAD.gravity * 0.25).abs() < 0.05, "{:?}", law.theta);
    }

    #[test]
    fn learned_force_is_bounded_and_cleared_by_reset() {
        let mut law = law();
        let far = State { position: Ned::new(5.0, -5.0, 5.0), ..State::default() };
        for _ in 0..100_000 {
            law.command(&far, &hover(), 0.01);
        }
        let largest = law.theta.to_array().map(f64::abs);
        assert_eq!(largest, [FORCE_MAX_M_S2; 3]);
        law.reset();
        assert_eq!(law.theta, Ned::zero());
    }
}
