//! Causes of a change, and the parameters that the equations are linear in.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;

/// Number of parameters in which the equations are linear.
pub const COLUMNS: usize = 24;

/// Excess of each rotor's thrust over the vehicle file's, as a fraction; four of them.
pub(super) const ROTOR: usize = 0;
/// Position of the centre of mass, front and right, m.
pub(super) const CENTRE: usize = 4;
/// Moment about down, N m.
pub(super) const YAW: usize = 6;
/// Force fixed in the world, north and east, N.
pub(super) const WIND: usize = 7;
/// Force against the horizontal velocity in body axes, kg/s.
pub(super) const DRAG: usize = 9;
/// Bias of the accelerometer, m/s^2.
pub(super) const ACCELEROMETER: usize = 10;
/// Tilt of the reported attitude relative to the true one, about front and right, rad.
pub(super) const TILT: usize = 13;
/// Moment proportional to the velocity, N m per m/s.
pub(super) const FLAPPING: usize = 15;
/// Relative thrust per squared horizontal speed, (m/s)^-2.
pub(super) const LIFT: usize = 16;
/// Force against the velocity along down in body axes, kg/s.
pub(super) const SINK: usize = 17;
/// Change in ten seconds of thrust, both coordinates of the centre of mass, yaw moment and both
/// forces.
pub(super) const DRIFT: usize = 18;
/// The column that each of those drifts belongs to; the thrust's drift is of all rotors.
pub(super) const DRIFTING: [usize; 6] = [ROTOR, CENTRE, CENTRE + 1, YAW, WIND, WIND + 1];

/// A direction of change in the space of the columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// All rotors by the same fraction.
    Thrust,
    /// One column.
    Column(usize),
}

/// All directions: thrust, each rotor, the centre of mass, the wind, drag.
pub const DIRECTIONS: [Direction; 10] = [
    Direction::Thrust,
    Direction::Column(ROTOR),
    Direction::Column(ROTOR + 1),
    Direction::Column(ROTOR + 2),
    Direction::Column(ROTOR + 3),
    Direction::Column(CENTRE),
    Direction::Column(CENTRE + 1),
    Direction::Column(WIND),
    Direction::Column(WIND + 1),
    Direction::Column(DRAG),
];

/// A possible cause of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Thrust over weight: the mass, the level of the thrust, or the pack under load.
    Thrust,
    /// The thrust of rotor 0.
    Rotor0,
    /// The thrust of rotor 1.
    Rotor1,
    /// The thrust of rotor 2.
    Rotor2,
    /// The thrust of rotor 3.
    Rotor3,
    /// The position of the centre of mass.
    CentreOfMass,
    /// Thrust over weight and the centre of mass together: an off-centre load.
    Payload,
    /// A force fixed in the world.
    Wind,
    /// Drag along the horizontal velocity.
    Drag,
}

impl Cause {
    /// All causes.
    pub const ALL: [Self; 9] = [
        Self::Thrust,
        Self::Rotor0,
        Self::Rotor1,
        Self::Rotor2,
        Self::Rotor3,
        Self::CentreOfMass,
        Self::Payload,
        Self::Wind,
        Self::Drag,
    ];

    /// Its directions, as indices into [`DIRECTIONS`].
    pub fn directions(self) -> &'static [usize] {
        match self {
            Self::Thrust => &[0],
            Self::Rotor0 => &[1],
            Self::Rotor1 => &[2],
            Self::Rotor2 => &[3],
            Self::Rotor3 => &[4],
            Self::CentreOfMass => &[5, 6],
            Self::Payload => &[0, 5, 6],
            Self::Wind => &[7, 8],
            Self::Drag => &[9],
        }
    }

    /// The effects of the catalogue that have this result.
    pub fn effects(self) -> &'static [&'static str] {
        match self {
            Self::Thrust => &["thrust_scale", "mass", "battery_sag"],
            Self::Rotor0 | Self::Rotor1 | Self::Rotor2 | Self::Rotor3 => &["rotor_loss"],
            Self::CentreOfMass => &["com_offset"],
            Self::Payload => &["mass", "com_offset"],
            Self::Wind => &["wind"],
            Self::Drag => &["rotor_drag", "parasitic_drag"],
        }
    }

    /// The rotor, with the vehicle file's index from 0.
    pub fn rotor(self) -> Option<usize> {
        match self {
            Self::Rotor0 => Some(0),
            Self::Rotor1 => Some(1),
            Self::Rotor2 => Some(2),
            Self::Rotor3 => Some(3),
            _ => None,
        }
    }
}

/// Name and unit of a direction's quantity.
pub fn quantity(direction: usize) -> (&'static str, &'static str) {
    match direction {
        0 => ("thrust", "1"),
        1..=4 => ("rotor_thrust", "1"),
        5 => ("centre_front", "m"),
        6 => ("centre_right", "m"),
        7 => ("force_north", "N"),
        8 => ("force_east", "N"),
        _ => ("drag", "kg/s"),
    }
}

/// Least error of a law over a stretch of flight, as fractions of the weight and of its moment at
/// the arms.
const LAW_ERROR_MIN: [f64; 2] = [1e-3, 3e-4];

/// Prior standard deviations of the parameters; the columns are in these units.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    columns: [f64; COLUMNS],
    least: [f64; 6],
}

impl Sizes {
    /// The sizes for a vehicle. Rotors and thrust: 20 %; the centre of mass: 20 % of the arm;
    /// forces: 20 % of the weight, at 1 m/s if proportional to velocity. Accelerometer bias: 0.5
    /// m/s^2; tilt: 3 degrees. Drifts of what may change: 2 % in 10 s, more than a pack sags.
    pub fn of(vehicle: &VehicleParams) -> Self {
        let weight = vehicle.mass * vehicle.gravity;
        let arms = vehicle.rotors.map(|rotor| rotor.position_m[0].hypot(rotor.position_m[1]));
        let arm = arms.into_iter().fold(0.0, f64::max);
        let torque = vehicle.rotors.map(|rotor| rotor.drag_torque_per_thrust_m);
        let torque = torque.into_iter().fold(0.0, f64::max) * weight;
        let mut sizes = [1.0; COLUMNS];
        sizes[ROTOR..CENTRE].fill(0.2);
        sizes[CENTRE..YAW].fill(0.2 * arm);
        sizes[YAW] = 0.2 * torque;
        sizes[WIND..DRAG].fill(0.2 * weight);
        sizes[DRAG] = 0.2 * weight;
        sizes[ACCELEROMETER..TILT].fill(0.5);
        sizes[TILT..FLAPPING].fill(0.05);
        sizes[FLAPPING] = 0.02 * weight * arm;
        sizes[LIFT] = 0.01;
        sizes[SINK] = 0.2 * weight;
        for (place, of) in DRIFTING.into_iter().enumerate() {
            sizes[DRIFT + place] = 0.1 * sizes[of];
        }
        let force = LAW_ERROR_MIN[0] * vehicle.gravity;
        let moment = |axis: usize| LAW_ERROR_MIN[1] * weight * arm / vehicle.inertia[axis];
        let least = [force, force, force, moment(0), moment(1), moment(2)];
        Self { columns: sizes, least }
    }

    /// Size of a column, in its unit.
    pub fn column(&self, column: usize) -> f64 {
        self.columns[column]
    }

    /// Least error of an equation over a stretch of flight: accelerations in m/s^2, angular ones in
    /// rad/s^2.
    pub fn least(&self, equation: usize) -> f64 {
        self.least[if equation < 6 { equation % 3 } else { equation - 3 }]
    }

    /// Size of a direction, in its unit.
    pub fn direction(&self, direction: usize) -> f64 {
        match DIRECTIONS[direction] {
            Direction::Thrust => self.columns[ROTOR],
            Direction::Column(column) => self.columns[column],
        }
    }
}

#[cfg(test)]
mod tests {
    use vehicle::effects::EffectId;

    use super::*;

    #[test]
    fn drag_has_the_unit_of_vehicle_files() {
        let drag = EffectId::RotorDrag.spec().find("d_xy").expect("a parameter").parameter;
        assert_eq!(quantity(DIRECTIONS.len() - 1), ("drag", drag.unit));
    }
}
