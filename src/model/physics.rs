//! The nominal vehicle's physics with parameters identified from logs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::effects::{AttitudeTrim, EffectSet};
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::physics::{Environment, Physics};
use vehicle::rigid_body::State;
use vehicle::scalar::{Dual, Scalar};
use vehicle::{VehicleError, VehicleParams};

use super::{ACCELERATIONS, Jacobian, Model, Point, VARIABLES};

/// Height at which the model evaluates the physics, m: out of ground effect, because a model has no
/// position input.
const HEIGHT: f64 = 1e3;

/// Changes to a vehicle file's physics.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct PhysicsParameters {
    /// Effects that override the vehicle file's modelled ones.
    #[schemars(
        with = "std::collections::BTreeMap<String, std::collections::BTreeMap<String, serde_json::Value>>"
    )]
    pub effects: EffectSet,
    /// Additional moment against the body rate per axis, N m s.
    pub angular_damping_nms: [f64; 3],
}

/// The physics as a model of accelerations.
#[derive(Clone, Debug)]
pub struct PhysicsModel {
    physics: Physics,
    environment: Environment,
    /// Rotation from the reported to the true attitude: the inverse of the trim.
    untrim: Option<Attitude>,
}

impl PhysicsModel {
    /// The vehicle file's physics with `parameters`.
    ///
    /// # Errors
    /// The vehicle's mixer cannot be inverted, or it lacks a parameter that an effect needs.
    pub fn new(
        vehicle: &VehicleParams,
        parameters: &PhysicsParameters,
    ) -> Result<Self, VehicleError> {
        let mut vehicle = vehicle.clone();
        let shipped = vehicle.angular_damping_nms.unwrap_or_default();
        let damping: [f64; 3] =
            std::array::from_fn(|i| shipped[i] + parameters.angular_damping_nms[i]);
        vehicle.angular_damping_nms = damping.iter().any(|k| *k != 0.0).then_some(damping);
        let physics = Physics::new(&vehicle, &parameters.effects)?;
        let untrim = vehicle
            .modelled_effects
            .overlay(&parameters.effects)
            .get::<AttitudeTrim>()
            .map(|trim| trim.rotation().inverse());
        let environment = physics.calm();
        Ok(Self { physics, environment, untrim })
    }

    /// The accelerations for variables of any scalar type, in the order of [`Point::to_array`].
    pub fn evaluate<T: Scalar>(&self, at: &[T; VARIABLES]) -> [T; ACCELERATIONS] {
        let [vn, ve, vd, p, q, r, roll, pitch, yaw, u1, u2, u3, u4] = *at;
        let mut attitude = Euler { roll, pitch, yaw }.attitude();
        if let Some(untrim) = self.untrim {
            attitude = attitude.compose(untrim.lift());
        }
        let state = State {
            position: Ned::new(T::default(), T::default(), T::from(-HEIGHT)),
            velocity: Ned::new(vn, ve, vd),
            attitude,
            body_rate: Frd::new(p, q, r),
        };
        let wrench = [u1, u2, u3, u4];
        let (linear, angular) =
            self.physics.accelerations_for_wrench(&state, &wrench, &self.environment);
        let [an, ae, ad] = linear.to_array();
        let [ap, aq, ar] = angular.to_array();
        [an, ae, ad, ap, aq, ar]
    }
}

impl Model for PhysicsModel {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.evaluate(&at.to_array())
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let values = at.to_array();
        let dual: [Dual<VARIABLES>; VARIABLES] =
            std::array::from_fn(|i| Dual::variable(values[i], i));
        let result = self.evaluate(&dual);
        (result.map(Scalar::value), result.map(|dual| *dual.gradient()))
    }
}
