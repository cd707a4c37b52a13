//! A network's parameters in the kernel's layout.

use crate::model::net::Mlp;

/// Largest number of outputs of a network.
pub(super) const MOST_OUTPUTS: usize = 8;

/// Sizes of a network.
///
/// The parameters as one list are W (`hidden` rows of `inputs`), b, V (`outputs` rows of `hidden`)
/// and c.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub inputs: usize,
    pub hidden: usize,
    pub outputs: usize,
}

impl Shape {
    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.hidden * (self.inputs + 1 + self.outputs) + self.outputs
    }

    /// The network with these parameters.
    pub fn network(&self, parameters: &[f32]) -> Mlp {
        let Self { inputs, hidden, outputs } = *self;
        let (hidden_weights, rest) = parameters.split_at(hidden * inputs);
        let (hidden_biases, rest) = rest.split_at(hidden);
        let (output_weights, output_biases) = rest.split_at(outputs * hidden);
        Mlp {
            inputs,
            hidden,
            outputs,
            hidden_weights: hidden_weights.to_vec(),
            hidden_biases: hidden_biases.to_vec(),
            output_weights: output_weights.to_vec(),
            output_biases: output_biases.to_vec(),
        }
    }

    /// Packets per group of sixteen rows in a set of samples.
    pub fn stride(&self) -> usize {
        self.inputs + 1 + self.outputs
    }
}

/// The widest vector instructions that the machine supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Instructions {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

impl Instructions {
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// Number of hidden units in a tile.
    pub fn tile(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => 10,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => 6,
            Self::Portable => 4,
        }
    }
}

/// A network's parameters in the order in which the kernel reads them: tile after tile of hidden
/// units, the last one padded with zeros.
pub(super) struct Packed {
    pub shape: Shape,
    pub instructions: Instructions,
    /// A tile: for each input its weights to the units, then the biases, then for each output its
    /// weights.
    pub tiles: Vec<f32>,
    /// c.
    pub biases: [f32; MOST_OUTPUTS],
}

impl Packed {
    pub fn new(shape: Shape, instructions: Instructions, parameters: &[f32]) -> Self {
        let Shape { inputs, hidden, outputs } = shape;
        let tile = instructions.tile();
        let rows = shape.stride();
        let mut tiles = vec![0.0; hidden.div_ceil(tile) * tile * rows];
        let (weights, rest) = parameters.split_at(hidden * inputs);
        let (hidden_biases, rest) = rest.split_at(hidden);
        let (output_weights, output_biases) = rest.split_at(outputs * hidden);
        for unit in 0..hidden {
            let first = unit / tile * tile * rows + unit % tile;
            for input in 0..inputs {
                tiles[first + input * tile] = weights[unit * inputs + input];
            }
            tiles[first + inputs * tile] = hidden_biases[unit];
            for output in 0..outputs {
                tiles[first + (inputs + 1 + output) * tile] =
                    output_weights[output * hidden + unit];
            }
        }
        let mut biases = [0.0; MOST_OUTPUTS];
        biases[..outputs].copy_from_slice(output_biases);
        Self { shape, instructions, tiles, biases }
    }
}
