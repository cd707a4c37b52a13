//! The networks' input features of a point, and the axes in which they are expressed.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ACCELERATIONS, VARIABLES};

/// Outputs of each network.
pub const OUTPUTS: usize = ACCELERATIONS / 2;
/// Largest number of features of a network.
pub const FEATURES_MAX: usize = 15;
/// First index of roll, pitch and yaw in a [`Point`](super::Point)'s array, and of the input, which
/// follows them.
pub(super) const ANGLE: usize = 6;
pub(super) const INPUT: usize = 9;

/// One of the two networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Head {
    /// NN1: linear acceleration, from the collective thrust.
    Linear,
    /// NN2: angular acceleration, from the moments.
    Angular,
}

impl Head {
    /// Both, in the order of the accelerations.
    pub const BOTH: [Head; 2] = [Head::Linear, Head::Angular];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Head::Linear => "nn1",
            Head::Angular => "nn2",
        }
    }

    /// Its range among the accelerations.
    pub fn rows(self) -> std::ops::Range<usize> {
        match self {
            Head::Linear => 0..3,
            Head::Angular => 3..6,
        }
    }

    /// Its range of u among the variables.
    fn inputs(self) -> std::ops::Range<usize> {
        match self {
            Head::Linear => INPUT..INPUT + 1,
            Head::Angular => INPUT + 1..VARIABLES,
        }
    }
}

/// The input features of a network at a point of motion, attitude and input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Features {
    /// (v, omega, sin zeta, cos zeta) and u1 or (u2, u3, u4), all in the frames of the point
    /// (Bansal et al. 2016, section V-B).
    #[default]
    World,
    /// The same relative to the vehicle's heading: v turned by -yaw, no yaw, and the linear
    /// acceleration turned back by yaw. The model is then the same at every heading.
    Heading,
    /// The same relative to the vehicle: v and the direction of down in body axes, and the linear
    /// acceleration turned back by the attitude. Gravity, thrust and rotor drag are linear in these
    /// features.
    Body,
}

impl Features {
    /// All, in order.
    pub const ALL: [Features; 3] = [Features::World, Features::Heading, Features::Body];

    /// Names of the features, in their order.
    pub fn names(self, head: Head) -> Vec<&'static str> {
        let mut names = match self {
            Features::World => vec!["v_n", "v_e", "v_d"],
            Features::Heading => vec!["v_ahead", "v_right", "v_d"],
            Features::Body => vec!["v_x", "v_y", "v_z"],
        };
        names.extend(["p", "q", "r"]);
        names.extend(match self {
            Features::World => {
                ["sin_roll", "sin_pitch", "sin_yaw", "cos_roll", "cos_pitch", "cos_yaw"].as_slice()
            }
            Features::Heading => &["sin_roll", "sin_pitch", "cos_roll", "cos_pitch"],
            Features::Body => &["down_x", "down_y", "down_z"],
        });
        names.extend(match head {
            Head::Linear => ["u1"].as_slice(),
            Head::Angular => &["u2", "u3", "u4"],
        });
        names
    }

    /// Number of angles, in the order roll, pitch, yaw, whose sine and cosine are features.
    fn angles(self) -> usize {
        match self {
            Features::World => 3,
            Features::Heading => 2,
            Features::Body => 0,
        }
    }

    /// Writes the features of a point to the front of `out`; returns their number.
    pub fn extract(
        self,
        head: Head,
        at: &[f64; VARIABLES],
        out: &mut [f64; FEATURES_MAX],
    ) -> usize {
        self.extract_in(&Axes::of(self, at), head, at, out)
    }

    /// The same with precomputed axes, which both heads share.
    pub(super) fn extract_in(
        self,
        axes: &Axes,
        head: Head,
        at: &[f64; VARIABLES],
        out: &mut [f64; FEATURES_MAX],
    ) -> usize {
        out[..3].copy_from_slice(&axes.in_axes([at[0], at[1], at[2]]));
        out[3..ANGLE].copy_from_slice(&at[3..ANGLE]);
        let mut length = ANGLE;
        match self {
            Features::Body => {
                out[length..length + 3].copy_from_slice(&axes.in_axes(DOWN));
                length += 3;
            }
            Features::World | Features::Heading => {
                let count = self.angles();
                for i in 0..count {
                    let (sin, cos) = at[ANGLE + i].sin_cos();
                    out[length + i] = sin;
                    out[length + count + i] = cos;
                }
                length += 2 * count;
            }
        }
        for i in head.inputs() {
            out[length] = at[i];
            length += 1;
        }
        length
    }

    /// Derivatives with respect to the point's variables, from those with respect to the features;
    /// `axes` are those at the point.
    pub(super) fn pull_back(
        self,
        axes: &Axes,
        head: Head,
        at: &[f64; VARIABLES],
        slope: &[f64],
    ) -> [f64; VARIABLES] {
        let mut row = [0.0; VARIABLES];
        let (by_velocity, by_rate) = (&slope[..3], &slope[3..ANGLE]);
        row[..3].copy_from_slice(&axes.to_world([by_velocity[0], by_velocity[1], by_velocity[2]]));
        row[3..ANGLE].copy_from_slice(by_rate);
        axes.add_turning([at[0], at[1], at[2]], by_velocity, &mut row);
        let mut length = ANGLE;
        match self {
            Features::Body => {
                axes.add_turning(DOWN, &slope[length..length + 3], &mut row);
                length += 3;
            }
            Features::World | Features::Heading => {
                let count = self.angles();
                for i in 0..count {
                    let (sin, cos) = at[ANGLE + i].sin_cos();
                    row[ANGLE + i] += cos * slope[length + i] - sin * slope[length + count + i];
                }
                length += 2 * count;
            }
        }
        for (i, slope) in head.inputs().zip(&slope[length..]) {
            row[i] = *slope;
        }
        row
    }

    /// The training target for an acceleration of this head at a point, in the axes of the
    /// features.
    pub fn target(
        self,
        head: Head,
        at: &[f64; VARIABLES],
        acceleration: [f64; OUTPUTS],
    ) -> [f64; OUTPUTS] {
        match head {
            Head::Linear => Axes::of(self, at).in_axes(acceleration),
            Head::Angular => acceleration,
        }
    }
}

/// Down, in world axes.
const DOWN: [f64; 3] = [0.0, 0.0, 1.0];

/// The axes in which velocity and linear acceleration are expressed at a point.
pub(super) struct Axes {
    /// Rotation from these axes to the world's.
    to_world: Matrix3<f64>,
    /// Rotation vectors of the axes per radian of roll, pitch and yaw, in these axes.
    turns: [Vector3<f64>; 3],
}

impl Axes {
    pub fn of(features: Features, at: &[f64; VARIABLES]) -> Self {
        let turn = |i: usize| at[ANGLE + i].sin_cos();
        let about_down = || {
            let (sin, cos) = turn(2);
            Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
        };
        let still = Vector3::zeros();
        match features {
            Features::World => Self { to_world: Matrix3::identity(), turns: [still; 3] },
            Features::Heading => {
                Self { to_world: about_down(), turns: [still, still, Vector3::z()] }
            }
            Features::Body => {
                let (roll, pitch) = (turn(0), turn(1));
                let tilt = Matrix3::new(
                    pitch.1,
                    pitch.0 * roll.0,
                    pitch.0 * roll.1,
                    0.0,
                    roll.1,
                    -roll.0,
                    -pitch.0,
                    pitch.1 * roll.0,
                    pitch.1 * roll.1,
                );
                // Body rates per rate of each angle.
                let down = tilt.row(2).transpose();
                let turns = [Vector3::x(), Vector3::new(0.0, roll.1, -roll.0), down];
                Self { to_world: about_down() * tilt, turns }
            }
        }
    }

    /// A world vector in these axes.
    pub fn in_axes(&self, vector: [f64; 3]) -> [f64; 3] {
        self.to_world.tr_mul(&Vector3::from(vector)).into()
    }

    /// A vector in these axes, in world axes.
    pub fn to_world(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.to_world * Vector3::from(vector)).into()
    }

    /// Derivatives of [`Axes::to_world`] of a fixed vector with respect to roll, pitch and yaw.
    pub fn to_world_slopes(&self, vector: [f64; 3]) -> [[f64; 3]; 3] {
        self.turns.map(|turn| (self.to_world * turn.cross(&Vector3::from(vector))).into())
    }

    /// Adds the effect of the angles on a fixed vector in these axes, given the derivatives with
    /// respect to its components.
    fn add_turning(&self, vector: [f64; 3], slope: &[f64], row: &mut [f64; VARIABLES]) {
        let seen = Vector3::from(self.in_axes(vector));
        let slope = Vector3::new(slope[0], slope[1], slope[2]);
        for (sum, turn) in row[ANGLE..].iter_mut().zip(&self.turns) {
            *sum += slope.dot(&seen.cross(turn));
        }
    }
}
