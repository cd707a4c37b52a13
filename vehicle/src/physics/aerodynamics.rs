//! What the air does to a vehicle in motion.

use super::wiring::FlowEffects;
use super::{BodyLaws, Environment, Loads, Physics};
use crate::effects::{Flow, Wrench};
use crate::frame::Frd;
use crate::rigid_body::State;
use crate::scalar::Scalar;

/// The effects that depend on the airflow past the vehicle, linear drag and angular damping.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Aerodynamics {
    pub effects: FlowEffects,
    /// Linear drag in N per m/s.
    pub linear_drag: Option<f64>,
    /// Damping moment per body rate in N m s.
    pub angular_damping: Option<[f64; 3]>,
}

impl Aerodynamics {
    pub fn is_empty(&self) -> bool {
        self.effects.is_empty() && self.linear_drag.is_none() && self.angular_damping.is_none()
    }

    /// The same with every effect present and inactive ones neutral.
    #[inline(always)]
    pub fn dense(&self) -> Self {
        Self {
            effects: self.effects.dense(),
            linear_drag: Some(self.linear_drag.unwrap_or_default()),
            angular_damping: Some(self.angular_damping.unwrap_or_default()),
        }
    }
}

impl<L: BodyLaws> Physics<L> {
    /// Scales and adds to the rotors' `wrench` what the air does to the vehicle.
    #[inline(always)]
    pub(super) fn add_aerodynamics<T: Scalar>(
        &self,
        aerodynamics: &Aerodynamics,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
        wrench: &mut Wrench<T>,
    ) {
        let air_relative = state.velocity - env.air_velocity.map(T::from);
        let air_relative = state.attitude.to_body(air_relative);
        let (x, y) = (air_relative.front(), air_relative.right());
        let flow = Flow {
            air_relative,
            horizontal_speed2: x * x + y * y,
            rotor_speed_ratio: loads.rotor_speed_ratio,
            thrust: loads.thrust,
            height: -state.position.down() + env.floor,
            air_density: self.air_density,
            inverse_induced_velocity: self.inverse_induced_velocity,
        };

        let factor = aerodynamics.effects.thrust_factor(&flow);
        let [roll, pitch, yaw] = wrench.moment.to_array();
        wrench.moment = Frd::new(roll * factor, pitch * factor, yaw);
        wrench.force = wrench.force * factor;

        aerodynamics.effects.add(&flow, wrench);
        if let Some(coefficient) = aerodynamics.linear_drag {
            wrench.force += air_relative * T::from(-coefficient);
        }
        if let Some(damping) = aerodynamics.angular_damping {
            wrench.moment += state.body_rate.scale_by(damping.map(|k| T::from(-k)));
        }
    }
}
