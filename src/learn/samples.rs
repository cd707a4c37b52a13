//! Rows of normalised inputs and targets, in the kernel's layout.

use rand::Rng;
use rand::seq::SliceRandom;

use super::lanes::{Packet, WIDTH};

/// Rows of inputs and targets, both normalised, as `f32`.
///
/// In memory, sixteen rows are side by side: one packet per input, one packet with 1 for a row and
/// 0 for padding (the input of the biases, and the weight of the row), one packet per target.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    inputs: usize,
    outputs: usize,
    rows: usize,
    packets: Vec<Packet>,
}

/// Why a row is rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RowError {
    /// The row has a different size from the set.
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
        /// The value found.
        value: f32,
    },
}

impl Samples {
    /// An empty set of rows with `inputs` inputs and `outputs` targets, and capacity for `rows`.
    pub fn with_capacity(inputs: usize, outputs: usize, rows: usize) -> Self {
        let stride = inputs + 1 + outputs;
        let packets = Vec::with_capacity(rows.div_ceil(WIDTH) * stride);
        Self { inputs, outputs, rows: 0, packets }
    }

    /// Adds a row, unless it has the wrong size or a non-finite value.
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

    /// Number of inputs per row.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of targets per row.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// The inputs and targets of a row, in this order.
    #[cfg(test)]
    pub(super) fn row(&self, row: usize) -> impl Iterator<Item = f32> + '_ {
        let packets = &self.packets[row / WIDTH * self.stride()..][..self.stride()];
        let (inputs, targets) = packets.split_at(self.inputs);
        inputs.iter().chain(&targets[1..]).map(move |packet| packet.0[row % WIDTH])
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

    /// A hash of all values (FNV-1a over words), with which a checkpoint identifies its rows.
    pub(super) fn fingerprint(&self) -> u64 {
        let values = self.packets.iter().flat_map(|packet| packet.0);
        let words = [self.inputs, self.outputs, self.rows].map(|size| size as u64);
        let words = words.into_iter().chain(values.map(|value| u64::from(value.to_bits())));
        words.fold(0xcbf2_9ce4_8422_2325, |hash, word| {
            (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }

    /// Packets per group of sixteen rows.
    pub(super) fn stride(&self) -> usize {
        self.inputs + 1 + self.outputs
    }

    /// All packets, group after group of sixteen rows.
    pub(super) fn packets(&self) -> &[Packet] {
        &self.packets
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn rows_round_trip_and_padding_has_zero_weight() {
        let mut samples = Samples::with_capacity(2, 1, 0);
        for row in 0..19_u8 {
            let value = f32::from(row);
            samples.push(&[value, -value], &[2.0 * value]).expect("a row");
        }
        assert_eq!(samples.len(), 19);
        assert!(samples.row(18).eq([18.0, -18.0, 36.0]));
        let weights: f64 = samples.packets().chunks(4).map(|packets| packets[2].sum()).sum();
        assert_eq!(weights, 19.0);
    }

    #[test]
    fn shuffling_keeps_the_set_of_rows() {
        let mut samples = Samples::with_capacity(1, 1, 0);
        for row in 0..100_u8 {
            samples.push(&[row.into()], &[f32::from(row) + 1.0]).expect("a row");
        }
        let shuffled = samples.shuffled(&mut Pcg64::seed_from_u64(1));
        assert_ne!(shuffled, samples);
        assert_ne!(shuffled.fingerprint(), samples.fingerprint());
        let mut rows: Vec<Vec<f32>> = (0..100).map(|row| shuffled.row(row).collect()).collect();
        rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert!(rows.iter().enumerate().all(|(row, found)| samples.row(row).eq(found.clone())));
    }

    #[test]
    fn non_finite_row_is_refused_without_side_effects() {
        let mut samples = Samples::with_capacity(2, 1, 0);
        samples.push(&[1.0, 2.0], &[3.0]).expect("a row");
        let before = samples.clone();
        let error = samples.push(&[1.0, 2.0], &[f32::INFINITY]).expect_err("infinite");
        assert_eq!(error.to_string(), "row 1, column 2: expected a finite number, found inf");
        assert!(matches!(
            samples.push(&[f32::NAN, 2.0], &[1.0]),
            Err(RowError::NotFinite { row: 1, column: 0, .. })
        ));
        assert!(matches!(samples.push(&[1.0], &[1.0]), Err(RowError::Size { .. })));
        assert_eq!(samples, before);
    }
}
