//! A model of accelerations whose input is the requested thrust instead of the sent one.
//!
//! Models take the nominal vehicle's thrust, as the firmware's mixer does. The daemon maps a
//! requested thrust (N) through the vehicle file's modelled effects, so that the rotors give the
//! requested thrust. A plan contains requested thrusts. Without the map between the two, the plan
//! would compensate for thrust effects twice. An autopilot that linearises its motors' curve itself
//! does so for each rotor, behind its mixer.

use std::sync::Arc;

use crate::link::attitude_target::ThrustMap;
use crate::model::{ACCELERATIONS, Jacobian, Model, Point};
use crate::offboard::{EffectiveVehicle, Uncontrollable};
use vehicle::effects::ThrustCurve;
use vehicle::rotor::Allocation;
use vehicle::{ROTORS, VehicleParams};

/// Column of the thrust in a [`Jacobian`]; the moments follow.
const INPUT: usize = 9;
/// Least divisor: slope of a rotor's thrust over its output, both relative to full.
const SLOPE_MIN: f64 = 1e-3;
/// Half width of the difference quotient of the map's slope, as a share of full thrust.
const SLOPE_SHARE: f64 = 1e-4;

/// `model` with the requested thrust as its input; unchanged if the vehicle file has no effect on
/// the thrust.
pub(super) fn behind_the_map(
    model: Arc<dyn Model>,
    params: &VehicleParams,
    vehicle: &EffectiveVehicle,
) -> Result<Arc<dyn Model>, Uncontrollable> {
    let curve = params.modelled_effects.get::<ThrustCurve>();
    if let Some(curve) = curve.filter(|curve| !vehicle.is_pd && curve.a > 0.0) {
        return Ok(Arc::new(LinearisedRotors::new(model, params, vehicle, curve.a)?));
    }
    let sent = SentThrust::new(model, params, vehicle);
    if ThrustMap::linear(sent.nominal_full_n).is_ok_and(|linear| linear == sent.map) {
        return Ok(sent.model);
    }
    Ok(Arc::new(sent))
}

/// A model whose input is the requested thrust.
struct SentThrust {
    model: Arc<dyn Model>,
    map: ThrustMap,
    requested_full_n: f64,
    /// Full thrust according to the firmware's mixer.
    nominal_full_n: f64,
}

impl SentThrust {
    fn new(model: Arc<dyn Model>, params: &VehicleParams, vehicle: &EffectiveVehicle) -> Self {
        let nominal_full_n = params.thrust_full_n();
        let (map, requested_full_n) = (vehicle.thrust, vehicle.thrust_full_n);
        Self { model, map, requested_full_n, nominal_full_n }
    }

    fn nominal(&self, requested_n: f64) -> f64 {
        self.nominal_full_n * self.map.fraction(requested_n)
    }

    fn behind(&self, at: &Point) -> Point {
        let [requested_n, roll, pitch, yaw] = at.input;
        Point { input: [self.nominal(requested_n), roll, pitch, yaw], ..*at }
    }
}

impl Model for SentThrust {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.model.accelerations(&self.behind(at))
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (accelerations, mut jacobian) = self.model.linearize(&self.behind(at));
        let step = SLOPE_SHARE * self.requested_full_n;
        // Within the range of the map, which is flat at its ends.
        let middle = at.input[0].clamp(step, self.requested_full_n - step);
        let slope = (self.nominal(middle + step) - self.nominal(middle - step)) / (2.0 * step);
        for row in &mut jacobian {
            row[INPUT] *= slope;
        }
        (accelerations, jacobian)
    }
}

/// A model whose input is a wrench that the autopilot realises rotor by rotor: it corrects each
/// output so that the rotor gives the mixer's thrust.
struct LinearisedRotors {
    model: Arc<dyn Model>,
    mixer: Allocation,
    /// From a rotor's thrust, over full, to its output.
    map: ThrustMap,
    square_share: f64,
    /// Thrust at full output over that of the mixer.
    scale: f64,
}

impl LinearisedRotors {
    fn new(
        model: Arc<dyn Model>,
        params: &VehicleParams,
        vehicle: &EffectiveVehicle,
        square_share: f64,
    ) -> Result<Self, Uncontrollable> {
        let mixer = params.allocation()?;
        let scale = vehicle.thrust_full_n / mixer.collective_max();
        let map = ThrustMap::curve(1.0, square_share)?;
        Ok(Self { model, mixer, map, square_share, scale })
    }

    /// Outputs for a wrench, and the slope of each over its rotor's share of full thrust.
    fn outputs(&self, wrench: [f64; 4]) -> ([f64; ROTORS], [f64; ROTORS]) {
        let shares = self.mixer.outputs(wrench);
        let outputs = std::array::from_fn(|i| self.map.fraction(shares[i] / self.scale));
        let slopes = std::array::from_fn(|i| {
            let slope = 1.0 - self.square_share + 2.0 * self.square_share * outputs[i];
            1.0 / (slope.max(SLOPE_MIN) * self.scale)
        });
        (outputs, slopes)
    }

    fn behind(&self, at: &Point) -> Point {
        Point { input: self.mixer.wrench(self.outputs(at.input).0), ..*at }
    }
}

impl Model for LinearisedRotors {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.model.accelerations(&self.behind(at))
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (accelerations, mut jacobian) = self.model.linearize(&self.behind(at));
        let (_, slopes) = self.outputs(at.input);
        let inverse = self.mixer.inverse();
        // Derivative of the outputs' nominal wrench by each requested component.
        let by_requested: [[f64; 4]; 4] = std::array::from_fn(|j| {
            let full = self.mixer.thrust_max();
            self.mixer.wrench(std::array::from_fn(|i| slopes[i] * inverse[i][j] / full[i]))
        });
        for row in &mut jacobian {
            let by_nominal: [f64; 4] = std::array::from_fn(|k| row[INPUT + k]);
            for (j, by_requested) in by_requested.iter().enumerate() {
                row[INPUT + j] = by_nominal.iter().zip(by_requested).map(|(a, b)| a * b).sum();
            }
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
    fn commanding_the_weight_hovers_despite_weak_rotors() {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let mut params = VehicleParams::from_toml_str(text).expect("a vehicle");
        let mut effects = EffectSet::new();
        for effect in ["thrust_scale:scale=0.9", "thrust_curve:a=0.3"] {
            effects.insert_argument(effect).expect("an effect");
        }
        params.modelled_effects = effects;
        let vehicle = EffectiveVehicle::new(&params).expect("a vehicle");
        let physics = PhysicsModel::new(&params, &PhysicsParameters::default()).expect("physics");
        let model = behind_the_map(Arc::new(physics), &params, &vehicle).expect("a mixer");
        let weight = params.mass * params.gravity;
        let hover = Point { input: [weight, 0.0, 0.0, 0.0], ..Point::default() };
        let (accelerations, jacobian) = model.linearize(&hover);
        assert!(accelerations.iter().all(|a| a.abs() < 1e-9), "{accelerations:?}");
        // A newton more lifts by a newton.
        assert!((jacobian[2][INPUT] * params.mass + 1.0).abs() < 1e-5, "{}", jacobian[2][INPUT]);
    }

    /// The nano under an autopilot's own loop that linearises the motors.
    fn straightened() -> Arc<dyn Model> {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let mut params = VehicleParams::from_toml_str(text).expect("a vehicle");
        params.attitude_pd = None;
        params.modelled_effects = EffectSet::new();
        params.modelled_effects.insert_argument("thrust_curve:a=0.65").expect("an effect");
        let vehicle = EffectiveVehicle::new(&params).expect("a vehicle");
        let physics = PhysicsModel::new(&params, &PhysicsParameters::default()).expect("physics");
        behind_the_map(Arc::new(physics), &params, &vehicle).expect("a mixer")
    }

    #[test]
    fn autopilot_that_linearises_its_motors_gives_the_commanded_wrench() {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let params = VehicleParams::from_toml_str(text).expect("a vehicle");
        let weight = params.mass * params.gravity;
        let moments = [2e-4, -3e-4, 5e-5];
        let [roll, pitch, yaw] = moments;
        let at = Point { input: [1.1 * weight, roll, pitch, yaw], ..Point::default() };
        let [_, _, down, turn @ ..] = straightened().accelerations(&at);
        assert!((down + 0.1 * params.gravity).abs() < 1e-9, "{down}");
        for ((turn, moment), inertia) in turn.into_iter().zip(moments).zip(params.inertia) {
            assert!((turn * inertia - moment).abs() < 1e-12, "{turn}");
        }
    }

    #[test]
    fn jacobian_behind_linearised_motors_matches_finite_differences() {
        let model = straightened();
        let at = Point { input: [0.33, 2e-4, -3e-4, 5e-5], ..Point::default() };
        let (_, jacobian) = model.linearize(&at);
        for (j, step) in [1e-5, 1e-8, 1e-8, 1e-8].into_iter().enumerate() {
            let moved = |by: f64| {
                let mut at = at;
                at.input[j] += by;
                model.accelerations(&at)
            };
            for (i, (after, before)) in moved(step).into_iter().zip(moved(-step)).enumerate() {
                let slope = (after - before) / (2.0 * step);
                let found = jacobian[i][INPUT + j];
                assert!((found - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{i} {j}: {found}");
            }
        }
    }
}
