//! Compares two readings of the same data, such as two frames of a velocity, by what each leaves
//! unexplained.

use super::agreement::Estimate;
use super::weak::{BLOCKS, blocks, interval, span_s};

/// What two readings leave unexplained of one moment, or of a block of moments.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Misfits {
    /// The data as stated.
    pub stated: f64,
    /// The other reading.
    pub other: f64,
}

impl Misfits {
    /// Of each moment or block.
    pub fn of_each(stated: &[f64], other: &[f64]) -> Vec<Self> {
        stated
            .iter()
            .zip(other)
            .map(|(stated, other)| Self { stated: *stated, other: *other })
            .collect()
    }

    fn sum(all: &[Self]) -> Self {
        all.iter().fold(Self::default(), |sum, one| Self {
            stated: sum.stated + one.stated,
            other: sum.other + one.other,
        })
    }

    /// `(A - B) / (A + B)`: from -1, where the data as stated leave nothing, to 1, where the other
    /// reading does. Bounded, so that a few good seconds do not decide.
    fn contrast(self) -> f64 {
        (self.stated - self.other) / (self.stated + self.other)
    }
}

/// The contrast over blocks of time, if the other reading certainly leaves less than the data as
/// stated. Its interval comes from the jackknife; too few blocks have none.
pub(super) fn certain_contrast(blocks: &[Misfits]) -> Option<f64> {
    let count = blocks.len();
    if count < *BLOCKS.start() {
        return None;
    }
    let total = Misfits::sum(blocks);
    let without = |block: &Misfits| {
        let (stated, other) = (total.stated - block.stated, total.other - block.other);
        Misfits { stated, other }.contrast()
    };
    let each: Vec<f64> = blocks.iter().map(without).collect();
    let mean = each.iter().sum::<f64>() / count as f64;
    let squares = each.iter().map(|one| (one - mean).powi(2)).sum::<f64>();
    let variance = squares * (count - 1) as f64 / count as f64;
    let contrast = Estimate::new(total.contrast(), interval(count) * variance.sqrt());
    // Nothing left to explain is not a number, and not certain.
    (contrast.value > 0.0 && contrast.is_beyond(0.0, 0.0)).then_some(contrast.value)
}

/// Sums moments into blocks of time. `times` ascend, s.
pub(super) fn by_block(times: &[f64], misfits: &[Misfits]) -> Vec<Misfits> {
    let blocks = blocks(span_s(times), misfits.len());
    blocks.into_iter().map(|block| Misfits::sum(&misfits[block])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// Whether the second of two readings with these mean misfits is found to be better.
    fn is_found(seed: u64, [stated, other]: [f64; 2]) -> bool {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let times: Vec<f64> = (0..200).map(|k| 0.1 * f64::from(k)).collect();
        let mut drawn = |mean: f64| mean * rng.random_range(0.0..2.0_f64).powi(2);
        let misfits: Vec<Misfits> =
            times.iter().map(|_| Misfits { stated: drawn(stated), other: drawn(other) }).collect();
        certain_contrast(&by_block(&times, &misfits)).is_some()
    }

    #[test]
    fn better_reading_is_found_and_an_equal_one_is_not() {
        let share =
            |means: [f64; 2]| (0..400).filter(|seed| is_found(*seed, means)).count() as f64 / 400.0;
        assert!(share([2.0, 1.0]) > 0.8, "{}", share([2.0, 1.0]));
        assert!(share([1.0, 1.0]) < 0.01, "{}", share([1.0, 1.0]));
        assert_eq!(share([1.0, 2.0]), 0.0);
    }

    #[test]
    fn nothing_left_or_too_short_is_never_better() {
        assert!(certain_contrast(&[Misfits::default(); 8]).is_none());
        assert!(certain_contrast(&[Misfits { stated: 1.0, other: 0.5 }; 3]).is_none());
    }
}
