//! A model of accelerations behind the map from thrust to what is sent.
//!
//! Models take the rotors' thrust in the nominal vehicle's numbers, as the firmware's mixer has it.
//! The daemon sends a thrust in newton through the map of the vehicle file's modelled effects, so
//! that the rotors give what was asked for. A plan is in what is asked for: between the two is the
//! map, or thrust effects would be made up for twice.

use std::sync::Arc;

use crate::link::attitude_target::ThrustMap;
use crate::model::{ACCELERATIONS, Jacobian, Model, Point};
use crate::pilot::EffectiveVehicle;
use vehicle::VehicleParams;

/// Column of the thrust in a [`Jacobian`].
const THRUST: usize = 9;
/// Over this share of full thrust the map's slope is taken, to each side.
const SLOPE_SHARE: f64 = 1e-4;

/// `model` with the thrust that is asked for as its input; as it is, where the vehicle file has no
/// effect on the thrust.
pub(super) fn behind_the_map(
    model: Arc<dyn Model>,
    params: &VehicleParams,
    vehicle: &EffectiveVehicle,
) -> Arc<dyn Model> {
    let sent = SentThrust::new(model, params, vehicle);
    if ThrustMap::linear(sent.nominal_full_n).is_ok_and(|linear| linear == sent.map) {
        return sent.model;
    }
    Arc::new(sent)
}

/// A model whose thrust is what is asked for, N.
struct SentThrust {
    model: Arc<dyn Model>,
    map: ThrustMap,
    asked_full_n: f64,
    /// Of the firmware's mixer.
    nominal_full_n: f64,
}

impl SentThrust {
    fn new(model: Arc<dyn Model>, params: &VehicleParams, vehicle: &EffectiveVehicle) -> Self {
        let nominal_full_n = params.rotors.iter().map(|rotor| rotor.thrust_max_n).sum();
        let (map, asked_full_n) = (vehicle.thrust, vehicle.thrust_full_n);
        Self { model, map, asked_full_n, nominal_full_n }
    }

    fn nominal(&self, asked_n: f64) -> f64 {
        self.nominal_full_n * self.map.fraction(asked_n)
    }

    fn behind(&self, at: &Point) -> Point {
        let [asked_n, roll, pitch, yaw] = at.input;
        Point { input: [self.nominal(asked_n), roll, pitch, yaw], ..*at }
    }
}

impl Model for SentThrust {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.model.accelerations(&self.behind(at))
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (accelerations, mut jacobian) = self.model.linearize(&self.behind(at));
        let step = SLOPE_SHARE * self.asked_full_n;
        // Within the range of the map, whose ends are flat.
        let middle = at.input[0].clamp(step, self.asked_full_n - step);
        let slope = (self.nominal(middle + step) - self.nominal(middle - step)) / (2.0 * step);
        for row in &mut jacobian {
            row[THRUST] *= slope;
        }
        (accelerations, jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::physics::{PhysicsModel, PhysicsParameters};
    use vehicle::effects::EffectSet;

    #[test]
    fn asking_for_the_weight_hovers_whatever_the_rotors_lack() {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let mut params = VehicleParams::from_toml_str(text).expect("a vehicle");
        let mut effects = EffectSet::new();
        for effect in ["thrust_scale:scale=0.9", "thrust_curve:a=0.3"] {
            effects.insert_argument(effect).expect("an effect");
        }
        params.modelled_effects = effects;
        let vehicle = EffectiveVehicle::new(&params).expect("a vehicle");
        let physics = PhysicsModel::new(&params, &PhysicsParameters::default()).expect("physics");
        let model = behind_the_map(Arc::new(physics), &params, &vehicle);
        let weight = params.mass * params.gravity;
        let hover = Point { input: [weight, 0.0, 0.0, 0.0], ..Point::default() };
        let (accelerations, jacobian) = model.linearize(&hover);
        assert!(accelerations.iter().all(|a| a.abs() < 1e-9), "{accelerations:?}");
        // A newton more lifts by a newton.
        assert!((jacobian[2][THRUST] * params.mass + 1.0).abs() < 1e-5, "{}", jacobian[2][THRUST]);
    }
}
