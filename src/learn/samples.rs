//! Rows of normalised inputs and targets, laid out for the kernel.

use rand::Rng;
use rand::seq::SliceRandom;

use super::lanes::{Packet, WIDTH};

/// Rows of inputs and targets, both normalised, as `f32`.
///
/// In memory sixteen rows lie side by side: a packet an input, a packet that holds 1 for a row and
/// 0 for padding (the input of the biases, and the weight of the row), a packet a target.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    inputs: usize,
    outputs: usize,
    rows: usize,
    packets: Vec<Packet>,
}

/// A row that cannot be learned from.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RowError {
    /// The row has another size than the set.
    #[error(
        "row {row}: expected {inputs} inputs and {outputs} targets, \
         found {found_inputs} and {found_outputs}"
    )]
    Size {
        /// Index of the row.
        row: usize,
        /// Inputs of the set.
        inputs: usize,
        /// Targets of the set.
        outputs: usize,
        /// Inputs of the row.
        found_inputs: usize,
        /// Targets of the row.
        found_outputs: usize,
    },
    /// A value is NaN or infinite; the columns are the inputs, then the targets.
    #[error("row {row}, column {column}: expected a finite number, found {value}")]
    NotFinite {
        /// Index of the row.
        row: usize,
        /// Index of the column.
        column: usize,
        /// What was found.
        value: f32,
    },
}

impl Samples {
    /// An empty set of rows of `inputs` inputs and `outputs` targets, with room for `rows`.
    pub fn with_capacity(inputs: usize, outputs: usize, rows: usize) -> Self {
        let stride = inputs + 1 + outputs;
        let packets = Vec::with_capacity(rows.div_ceil(WIDTH) * stride);
        Self { inputs, outputs, rows: 0, packets }
    }

    /// Adds a row, unless it has the wrong size or a value that is no finite number.
    pub fn push(&mut self, inputs: &[f32], targets: &[f32]) -> Result<(), RowError> {
        if inputs.len() != self.inputs || targets.len() != self.outputs {
            return Err(RowError::Size {
                row: self.rows,
                inputs: self.inputs,
                outputs: self.outputs,
                found_inputs: inputs.len(),
                found_outputs: targets.len(),
            });
        }
        let values = inputs.iter().chain(targets).copied();
        if let Some((column, value)) = values.enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(RowError::NotFinite { row: self.rows, column, value });
        }
        let lane = self.rows % WIDTH;
        if lane == 0 {
            self.packets.resize(self.packets.len() + self.stride(), Packet::ZERO);
        }
        let first = self.packets.len() - self.stride();
        let values = inputs.iter().chain(&[1.0]).chain(targets);
        for (packet, value) in self.packets[first..].iter_mut().zip(values) {
            packet.0[lane] = *value;
        }
        self.rows += 1;
        Ok(())
    }

    /// Inputs of a row.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Targets of a row.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// The same rows in a random order.
    pub(super) fn shuffled(&self, random: &mut impl Rng) -> Self {
        let mut order: Vec<usize> = (0..self.rows).collect();
        order.shuffle(random);
        let stride = self.stride();
        let mut packets = vec![Packet::ZERO; self.packets.len()];
        for (to, from) in order.into_iter().enumerate() {
            let from_packets = &self.packets[from / WIDTH * stride..][..stride];
            let to_packets = &mut packets[to / WIDTH * stride..][..stride];
            for (to_packet, from_packet) in to_packets.iter_mut().zip(from_packets) {
                to_packet.0[to % WIDTH] = from_packet.0[from % WIDTH];
            }
        }
        Self { packets, ..*self }
    }

    /// A hash of all values (FNV-1a over words), by which a checkpoint knows its rows.
    pub(super) fn fingerprint(&self) -> u64 {
        let values = self.packets.iter().flat_map(|packet| packet.0);
        let words = [self.inputs, self.outputs, self.rows].map(|size| size as u64);
        let words = words.into_iter().chain(values.map(|value| u64::from(value.to_bits())));
        words.fold(0xcbf2_9ce4_8422_2325, |hash, word| {
            (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }

    /// Packets of sixteen rows.
    pub(super) fn stride(&self) -> usize {
        self.inputs + 1 + self.outputs
    }

    /// All packets, sixteen rows after sixteen rows.
    pub(super) fn packets(&self) -> &[Packet] {
        &self.packets
    }
}
