//! Accelerations by two networks: NN1 gives the linear ones, NN2 the angular ones.

use serde::{Deserialize, Serialize};

use super::net::{Mlp, Normalization};
use super::{ACCELERATIONS, Jacobian, Model, Point, VARIABLES};

/// Outputs of each network.
pub const OUTPUTS: usize = ACCELERATIONS / 2;
/// Most features of a network.
pub const FEATURES_MAX: usize = 15;
/// Where a [`Point`]'s variables begin in its array.
const ANGLE: usize = 6;
const YAW: usize = 8;
const INPUT: usize = 9;

/// Which of the two networks.
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

    /// Its accelerations among all.
    pub fn rows(self) -> std::ops::Range<usize> {
        match self {
            Head::Linear => 0..3,
            Head::Angular => 3..6,
        }
    }

    /// Its share of u.
    fn inputs(self) -> std::ops::Range<usize> {
        match self {
            Head::Linear => INPUT..INPUT + 1,
            Head::Angular => INPUT + 1..VARIABLES,
        }
    }
}

/// What a network is given of a [`Point`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Features {
    /// (v, omega, sin zeta, cos zeta) and u1 or (u2, u3, u4), all in the frames of the point
    /// (Bansal et al. 2016, section V-A).
    #[default]
    World,
    /// The same seen from the vehicle's heading: v turned by -yaw, no yaw, and the linear
    /// acceleration turned back by yaw. What holds at one heading then holds at every other.
    Heading,
}

impl Features {
    /// Names of the features, which are also their order.
    pub fn names(self, head: Head) -> Vec<&'static str> {
        let mut names = match self {
            Features::World => vec!["v_n", "v_e", "v_d"],
            Features::Heading => vec!["v_ahead", "v_right", "v_d"],
        };
        names.extend(["p", "q", "r"]);
        names.extend(match self {
            Features::World => {
                ["sin_roll", "sin_pitch", "sin_yaw", "cos_roll", "cos_pitch", "cos_yaw"].as_slice()
            }
            Features::Heading => &["sin_roll", "sin_pitch", "cos_roll", "cos_pitch"],
        });
        names.extend(match head {
            Head::Linear => ["u1"].as_slice(),
            Head::Angular => &["u2", "u3", "u4"],
        });
        names
    }

    /// Angles that are features, as indices among roll, pitch and yaw.
    fn angles(self) -> std::ops::Range<usize> {
        match self {
            Features::World => 0..3,
            Features::Heading => 0..2,
        }
    }

    /// Writes the features of a point to the front of `out`; returns how many there are.
    pub fn extract(
        self,
        head: Head,
        at: &[f64; VARIABLES],
        out: &mut [f64; FEATURES_MAX],
    ) -> usize {
        out[..ANGLE].copy_from_slice(&at[..ANGLE]);
        if self == Features::Heading {
            let (sin, cos) = at[YAW].sin_cos();
            out[0] = cos * at[0] + sin * at[1];
            out[1] = cos * at[1] - sin * at[0];
        }
        let angles = self.angles();
        let count = angles.len();
        for i in angles {
            let (sin, cos) = at[ANGLE + i].sin_cos();
            out[ANGLE + i] = sin;
            out[ANGLE + count + i] = cos;
        }
        let mut length = ANGLE + 2 * count;
        for i in head.inputs() {
            out[length] = at[i];
            length += 1;
        }
        length
    }

    /// Derivatives with respect to the point's variables, from those with respect to the
    /// features.
    fn pull_back(self, head: Head, at: &[f64; VARIABLES], slope: &[f64]) -> [f64; VARIABLES] {
        let mut row = [0.0; VARIABLES];
        row[..ANGLE].copy_from_slice(&slope[..ANGLE]);
        if self == Features::Heading {
            let (sin, cos) = at[YAW].sin_cos();
            row[0] = cos * slope[0] - sin * slope[1];
            row[1] = sin * slope[0] + cos * slope[1];
            // d(v_ahead)/d(yaw) = v_right, d(v_right)/d(yaw) = -v_ahead.
            let (ahead, right) = (cos * at[0] + sin * at[1], cos * at[1] - sin * at[0]);
            row[YAW] = slope[0] * right - slope[1] * ahead;
        }
        let angles = self.angles();
        let count = angles.len();
        for i in angles {
            let (sin, cos) = at[ANGLE + i].sin_cos();
            row[ANGLE + i] += cos * slope[ANGLE + i] - sin * slope[ANGLE + count + i];
        }
        for (i, slope) in head.inputs().zip(&slope[ANGLE + 2 * count..]) {
            row[i] = *slope;
        }
        row
    }

    /// The target of training for an acceleration of this head: seen as the features are.
    pub fn target(self, head: Head, yaw: f64, acceleration: [f64; OUTPUTS]) -> [f64; OUTPUTS] {
        match (self, head) {
            (Features::Heading, Head::Linear) => turned(acceleration, -yaw),
            _ => acceleration,
        }
    }
}

/// A vector turned about down by `angle`.
fn turned([x, y, z]: [f64; OUTPUTS], angle: f64) -> [f64; OUTPUTS] {
    let (sin, cos) = angle.sin_cos();
    [cos * x - sin * y, sin * x + cos * y, z]
}

/// A network with the normalisation of its inputs and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Of the features.
    pub inputs: Normalization,
    /// Of the accelerations.
    pub outputs: Normalization,
    /// From normalised features to normalised accelerations.
    pub mlp: Mlp,
}

/// Calls a method for the number of features that a network has.
macro_rules! sized {
    ($network:ident . $method:ident ($features:ident, $count:ident)) => {
        match $count {
            11 => $network.$method::<11>($features),
            13 => $network.$method::<13>($features),
            15 => $network.$method::<15>($features),
            _ => unreachable!("features are 11, 13 or 15"),
        }
    };
}

impl Network {
    fn evaluate(&self, features: &[f64; FEATURES_MAX], count: usize) -> [f64; OUTPUTS] {
        sized!(self.evaluate_sized(features, count))
    }

    fn evaluate_sized<const N: usize>(&self, features: &[f64; FEATURES_MAX]) -> [f64; OUTPUTS] {
        let x = self.inputs.apply::<N>(&std::array::from_fn(|i| features[i]));
        self.denormalised(self.mlp.evaluate(&x))
    }

    /// Outputs and, row by row, their derivatives with respect to the features.
    fn linearize(
        &self,
        features: &[f64; FEATURES_MAX],
        count: usize,
    ) -> ([f64; OUTPUTS], [[f64; FEATURES_MAX]; OUTPUTS]) {
        sized!(self.linearize_sized(features, count))
    }

    fn linearize_sized<const N: usize>(
        &self,
        features: &[f64; FEATURES_MAX],
    ) -> ([f64; OUTPUTS], [[f64; FEATURES_MAX]; OUTPUTS]) {
        let x = self.inputs.apply::<N>(&std::array::from_fn(|i| features[i]));
        let (y, jacobian): (_, [[f64; N]; OUTPUTS]) = self.mlp.linearize(&x);
        let mut slope = [[0.0; FEATURES_MAX]; OUTPUTS];
        for (row, (slope, jacobian)) in slope.iter_mut().zip(&jacobian).enumerate() {
            for ((slope, value), deviation) in
                slope.iter_mut().zip(jacobian).zip(&self.inputs.deviation)
            {
                *slope = value * self.outputs.deviation[row] / deviation;
            }
        }
        (self.denormalised(y), slope)
    }

    fn denormalised(&self, y: [f64; OUTPUTS]) -> [f64; OUTPUTS] {
        std::array::from_fn(|i| y[i] * self.outputs.deviation[i] + self.outputs.mean[i])
    }
}

/// NN1 and NN2 together.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkModel {
    /// What both are given.
    pub features: Features,
    /// NN1.
    pub linear: Network,
    /// NN2.
    pub angular: Network,
}

impl NetworkModel {
    /// The same networks with these shares of their accelerations, linear and angular.
    pub fn scaled(&self, [linear, angular]: [f64; 2]) -> Self {
        let scale = |network: &Network, share: f64| {
            let Normalization { mean, deviation } = &network.outputs;
            let outputs = Normalization {
                mean: mean.iter().map(|m| share * m).collect(),
                // A deviation of 0 is no normalisation; this one leaves nothing either.
                deviation: deviation.iter().map(|d| (share * d).max(f64::MIN_POSITIVE)).collect(),
            };
            Network { outputs, ..network.clone() }
        };
        Self {
            features: self.features,
            linear: scale(&self.linear, linear),
            angular: scale(&self.angular, angular),
        }
    }

    fn network(&self, head: Head) -> &Network {
        match head {
            Head::Linear => &self.linear,
            Head::Angular => &self.angular,
        }
    }
}

impl Model for NetworkModel {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        let at = at.to_array();
        let mut out = [0.0; ACCELERATIONS];
        let mut features = [0.0; FEATURES_MAX];
        for head in Head::BOTH {
            let n = self.features.extract(head, &at, &mut features);
            let mut y = self.network(head).evaluate(&features, n);
            if (self.features, head) == (Features::Heading, Head::Linear) {
                y = turned(y, at[YAW]);
            }
            out[head.rows()].copy_from_slice(&y);
        }
        out
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let at = at.to_array();
        let mut value = [0.0; ACCELERATIONS];
        let mut jacobian = [[0.0; VARIABLES]; ACCELERATIONS];
        let mut features = [0.0; FEATURES_MAX];
        for head in Head::BOTH {
            let n = self.features.extract(head, &at, &mut features);
            let (mut y, slope) = self.network(head).linearize(&features, n);
            let mut rows = slope.map(|row| self.features.pull_back(head, &at, &row[..n]));
            if (self.features, head) == (Features::Heading, Head::Linear) {
                y = turned(y, at[YAW]);
                for column in 0..VARIABLES {
                    let turned = turned(rows.map(|row| row[column]), at[YAW]);
                    for (row, value) in rows.iter_mut().zip(turned) {
                        row[column] = value;
                    }
                }
                // Turning the output itself depends on yaw: d(R y)/d(yaw) = z x (R y).
                rows[0][YAW] -= y[1];
                rows[1][YAW] += y[0];
            }
            value[head.rows()].copy_from_slice(&y);
            jacobian[head.rows()].copy_from_slice(&rows);
        }
        (value, jacobian)
    }
}
