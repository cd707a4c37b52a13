//! Random draws of an exam: its seed and a case's number determine everything about the case.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use vehicle::effects::Chance;

/// A random source.
#[derive(Clone, Debug)]
pub struct Draw(Pcg64Mcg);

impl Draw {
    /// Stream `number` of `seed`.
    pub fn new(seed: u64, number: u64) -> Self {
        // Seeding spreads its argument over the generator's whole state.
        Self(Pcg64Mcg::seed_from_u64(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// A uniform draw from a range.
    pub fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A log-uniform draw from a range of positive numbers.
    pub fn log_within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.within([low.ln(), high.ln()]).exp()
    }

    /// A draw from the standard normal distribution.
    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// -1 or 1 with equal probability.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// A draw from several items with shares that sum to 1.
    pub fn one_of<T: Copy>(&mut self, shares: &[(T, f64)]) -> T {
        let mut left = self.0.random::<f64>();
        let found = shares.iter().find(|(_, share)| {
            left -= share;
            left < 0.0
        });
        // Rounding may leave a rest, which goes to the last item.
        found.unwrap_or(&shares[shares.len() - 1]).0
    }

    /// A uniform integer below `count`; 0 if that is 0.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1))
    }

    /// A seed for another generator.
    pub fn seed(&mut self) -> u64 {
        self.0.random()
    }

    /// Shuffles items uniformly.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

impl Chance for Draw {
    fn within(&mut self, range: [f64; 2]) -> f64 {
        self.within(range)
    }

    fn sign(&mut self) -> f64 {
        self.sign()
    }

    fn below(&mut self, count: usize) -> usize {
        self.below(count)
    }
}

/// A number to five digits, as vehicle files and keys state it.
pub fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    format!("{value:.4e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_streams_are_reproducible_and_distinct() {
        let first = |number| Draw::new(7, number).seed();
        assert_eq!(first(3), first(3));
        assert_ne!(first(3), first(4));
    }

    #[test]
    fn rounding_keeps_five_digits() {
        assert_eq!(rounded(0.0123456789), 0.012346);
        assert_eq!(rounded(-9.80661), -9.8066);
        assert_eq!(rounded(0.0), 0.0);
    }
}
