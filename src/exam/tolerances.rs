//! A builder's tolerances of a vehicle file's numbers: standard deviations, as in `provenance`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use vehicle::VehicleParams;
use vehicle::effects::{
    AttitudeTrim, ComOffset, CommandDelay, EffectId, EffectSet, EstimatorLatency, Inertia, Mass,
    MotorLag, RotorLoss, ThrustScale, YawTorque,
};

use super::draw::{Draw, rounded};

/// Standard deviations common to all builders, as shares of the number: a load cell's scale, a
/// kitchen scale, a torque stand, a step on the bench.
const THRUST_COMMON: f64 = 0.02;
const MASS: f64 = 0.005;
const DRAG_TORQUE: f64 = 0.05;
const LAG: f64 = 0.1;
/// A centre of mass balanced on an edge, as a share of the arm.
const CENTRE_OF_MASS: f64 = 0.01;
/// A delay measured by ping, s.
const DELAY_S: f64 = 0.002;
/// Half a degree of roll and pitch, levelled by eye, rad.
const TRIM_RAD: f64 = 0.0087;
/// Range of a reported pose's age according to its data sheet, s.
const POSE_S: [f64; 2] = [0.001, 0.002];
/// Ranges over builders, as shares: thrust from rotor to rotor, and inertia by a bifilar pendulum.
const THRUST_EACH: [f64; 2] = [0.01, 0.02];
const INERTIA: [f64; 2] = [0.05, 0.1];

/// Standard deviations of a vehicle file's numbers, in their own units or as shares.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Tolerances {
    /// Thrust common to all rotors, a share.
    pub thrust_common: f64,
    /// Thrust from rotor to rotor, a share.
    pub thrust_each: f64,
    /// Mass, a share.
    pub mass: f64,
    /// Moment of inertia about each axis, a share.
    pub inertia: f64,
    /// Centre of mass along each axis, m.
    pub centre_m: f64,
    /// Drag torque per thrust, a share.
    pub drag_torque: f64,
    /// Time constant of the rotors, a share.
    pub lag: f64,
    /// Delay of commands, s.
    pub delay_s: f64,
    /// Trim of roll and pitch, rad.
    pub trim_rad: f64,
    /// Least and largest age of a reported pose, s.
    pub pose_s: [f64; 2],
}

impl Tolerances {
    /// A typical builder's: the middle of each range.
    pub fn typical(file: &VehicleParams) -> Self {
        let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
        Self::of(file, middle(THRUST_EACH), middle(INERTIA))
    }

    fn of(file: &VehicleParams, thrust_each: f64, inertia: f64) -> Self {
        Self {
            thrust_common: THRUST_COMMON,
            thrust_each,
            mass: MASS,
            inertia,
            centre_m: rounded(CENTRE_OF_MASS * file.arm_m()),
            drag_torque: DRAG_TORQUE,
            lag: LAG,
            delay_s: DELAY_S,
            trim_rad: TRIM_RAD,
            pose_s: POSE_S,
        }
    }

    /// A random builder's.
    pub fn draw(draw: &mut Draw, file: &VehicleParams) -> Self {
        let thousandths = |value: f64| (value * 1e3).round() * 1e-3;
        let thrust_each = thousandths(draw.within(THRUST_EACH));
        Self::of(file, thrust_each, thousandths(draw.within(INERTIA)))
    }

    /// The `provenance` of a vehicle file with these tolerances.
    pub fn provenance(&self) -> Map<String, Value> {
        let entries = json!({
            "mass": {"from": "kitchen scale", "sigma_share": self.mass},
            "inertia": {"from": "bifilar pendulum", "sigma_share": self.inertia},
            "rotors.thrust_max_N": {
                "from": "load cell, one motor",
                "sigma_share_common": self.thrust_common,
                "sigma_share_each": self.thrust_each,
            },
            "rotors.position_m": {
                "from": "drawing; centre of mass balanced",
                "sigma_com_m": self.centre_m,
            },
            "rotors.drag_torque_per_thrust_m": {
                "from": "torque stand",
                "sigma_share": self.drag_torque,
            },
            "motor_time_constant_s": {"from": "step on the bench", "sigma_share": self.lag},
            "command_delay_s": {"from": "ping", "sigma_s": self.delay_s},
            "attitude": {"from": "levelled by eye", "sigma_rad": self.trim_rad},
            "pose_latency_s": {"from": "data sheet", "range_s": self.pose_s},
            "rotor_drag": {"from": "not measured"},
        });
        match entries {
            Value::Object(entries) => entries,
            _ => Map::new(),
        }
    }

    /// Distance of an effect's numbers from the file's in standard deviations, the largest of its
    /// components; `None` for an effect that the file has no number for.
    pub fn beyond(&self, file: &VehicleParams, effects: &EffectSet, id: EffectId) -> Option<f64> {
        let largest = |values: &[f64]| values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        Some(match id {
            EffectId::Mass => {
                let mass = effects.get::<Mass>()?.mass_kg;
                // A log shows the ratio of thrust to mass.
                let share = self.mass.hypot(self.thrust_common);
                (mass / file.mass - 1.0).abs() / share
            }
            EffectId::ThrustScale => {
                let share = self.mass.hypot(self.thrust_common);
                (effects.get::<ThrustScale>()?.scale - 1.0).abs() / share
            }
            EffectId::RotorLoss => {
                let share = self.thrust_each.hypot(self.thrust_common);
                (effects.get::<RotorLoss>()?.scale - 1.0).abs() / share
            }
            EffectId::Inertia => {
                let off = effects.get::<Inertia>()?.scale.map(|scale| scale - 1.0);
                largest(&off) / self.inertia
            }
            EffectId::ComOffset => {
                let ComOffset { x_m, y_m } = effects.get()?;
                x_m.hypot(y_m) / self.centre_m
            }
            EffectId::YawTorque => {
                (effects.get::<YawTorque>()?.scale - 1.0).abs() / self.drag_torque
            }
            EffectId::MotorLag if file.motor_time_constant_s > 0.0 => {
                let off = effects.get::<MotorLag>()?.tau_s / file.motor_time_constant_s - 1.0;
                off.abs() / self.lag
            }
            EffectId::CommandDelay => {
                let off = effects.get::<CommandDelay>()?.delay_s - file.command_delay_s;
                off.abs() / self.delay_s
            }
            EffectId::AttitudeTrim => {
                let trim = effects.get::<AttitudeTrim>()?.trim;
                trim.roll.hypot(trim.pitch) / self.trim_rad
            }
            EffectId::EstimatorLatency => {
                effects.get::<EstimatorLatency>()?.latency_s / self.pose_s[1]
            }
            _ => return None,
        })
    }
}
