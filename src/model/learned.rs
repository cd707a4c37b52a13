//! Accelerations from two networks: NN1 gives the linear ones, NN2 the angular ones.

use super::features::{ANGLE, Axes, FEATURES_MAX, Features, Head, INPUT, OUTPUTS};
use super::net::{Mlp, Normalization};
use super::{ACCELERATIONS, Jacobian, Model, Point, VARIABLES};

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

/// A slope of one acceleration along one feature, both normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearTerm {
    /// Index of the feature.
    pub feature: usize,
    /// Index of the network's output.
    pub output: usize,
    /// The slope.
    pub slope: f64,
}

/// Calls a method that is generic over the number of features.
macro_rules! sized {
    ($network:ident . $method:ident ($features:ident, $count:ident)) => {
        match $count {
            10 => $network.$method::<10>($features),
            11 => $network.$method::<11>($features),
            12 => $network.$method::<12>($features),
            13 => $network.$method::<13>($features),
            15 => $network.$method::<15>($features),
            _ => unreachable!("`Features::names` gives a head 10 to 13 or 15 features"),
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

    /// This network with its accelerations scaled by `gains`, and with normalised constants and
    /// linear terms added. A ReLU layer represents `c x = c relu(x) - c relu(-x)` exactly: each
    /// term takes two additional hidden units.
    pub fn corrected(
        &self,
        gains: [f64; OUTPUTS],
        constants: [f64; OUTPUTS],
        terms: &[LinearTerm],
    ) -> Self {
        let Self { inputs, outputs, mlp } = self;
        let units = mlp.hidden + 2 * terms.len();
        let mut hidden_weights = mlp.hidden_weights.clone();
        let mut output_weights = vec![0.0; OUTPUTS * units];
        for (output, (new, old)) in
            output_weights.chunks_mut(units).zip(mlp.output_weights.chunks(mlp.hidden)).enumerate()
        {
            for (new, old) in new.iter_mut().zip(old) {
                *new = (gains[output] * f64::from(*old)) as f32;
            }
        }
        for (term, LinearTerm { feature, output, slope }) in terms.iter().enumerate() {
            for (unit, sign) in [1.0, -1.0].into_iter().enumerate() {
                let mut row = vec![0.0; mlp.inputs];
                row[*feature] = sign;
                hidden_weights.extend(row);
                let unit = mlp.hidden + 2 * term + unit;
                output_weights[output * units + unit] = sign * *slope as f32;
            }
        }
        let mut hidden_biases = mlp.hidden_biases.clone();
        hidden_biases.resize(units, 0.0);
        let bias = |i: usize| {
            // The gain also applies to the mean of the accelerations.
            let mean = (gains[i] - 1.0) * outputs.mean[i] / outputs.deviation[i];
            (gains[i] * f64::from(mlp.output_biases[i]) + constants[i] + mean) as f32
        };
        Self {
            inputs: inputs.clone(),
            outputs: outputs.clone(),
            mlp: Mlp {
                inputs: mlp.inputs,
                hidden: units,
                outputs: OUTPUTS,
                hidden_weights,
                hidden_biases,
                output_weights,
                output_biases: (0..OUTPUTS).map(bias).collect(),
            },
        }
    }

    fn denormalised(&self, y: [f64; OUTPUTS]) -> [f64; OUTPUTS] {
        std::array::from_fn(|i| y[i] * self.outputs.deviation[i] + self.outputs.mean[i])
    }
}

/// NN1 and NN2 together.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkModel {
    /// The input features of both.
    pub features: Features,
    /// NN1.
    pub linear: Network,
    /// NN2.
    pub angular: Network,
}

impl NetworkModel {
    /// The same networks with their linear and angular accelerations scaled by these factors.
    pub fn scaled(&self, [linear, angular]: [f64; 2]) -> Self {
        let scale = |network: &Network, share: f64| {
            let Normalization { mean, deviation } = &network.outputs;
            let outputs = Normalization {
                mean: mean.iter().map(|m| share * m).collect(),
                // A deviation of 0 is not a valid normalisation; this one has the same effect.
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
        let axes = Axes::of(self.features, &at);
        let mut out = [0.0; ACCELERATIONS];
        let mut features = [0.0; FEATURES_MAX];
        for head in Head::BOTH {
            let n = self.features.extract_in(&axes, head, &at, &mut features);
            let mut y = self.network(head).evaluate(&features, n);
            if head == Head::Linear {
                y = axes.to_world(y);
            }
            out[head.rows()].copy_from_slice(&y);
        }
        out
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let at = at.to_array();
        let axes = Axes::of(self.features, &at);
        let mut value = [0.0; ACCELERATIONS];
        let mut jacobian = [[0.0; VARIABLES]; ACCELERATIONS];
        let mut features = [0.0; FEATURES_MAX];
        for head in Head::BOTH {
            let n = self.features.extract_in(&axes, head, &at, &mut features);
            let (mut y, slope) = self.network(head).linearize(&features, n);
            let mut rows = slope.map(|row| self.features.pull_back(&axes, head, &at, &row[..n]));
            if head == Head::Linear {
                for column in 0..VARIABLES {
                    let rotated = axes.to_world(rows.map(|row| row[column]));
                    for (row, value) in rows.iter_mut().zip(rotated) {
                        row[column] = value;
                    }
                }
                // The output's axes turn with the angles.
                for (column, slope) in (ANGLE..INPUT).zip(axes.to_world_slopes(y)) {
                    for (row, value) in rows.iter_mut().zip(slope) {
                        row[column] += value;
                    }
                }
                y = axes.to_world(y);
            }
            value[head.rows()].copy_from_slice(&y);
            jacobian[head.rows()].copy_from_slice(&rows);
        }
        (value, jacobian)
    }
}
