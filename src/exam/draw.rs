//! Draws of an exam: everything in a case follows from the exam's seed and the case's number.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use vehicle::effects::Chance;

/// A source of random draws.
#[derive(Clone, Debug)]
pub struct Draw(Pcg64Mcg);

impl Draw {
    /// Stream `number` of `seed`.
    pub fn new(seed: u64, number: u64) -> Self {
        // Seeding spreads its argument over the generator's whole state.
        Self(Pcg64Mcg::seed_from_u64(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// Evenly within a range.
    pub fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Evenly in the logarithm within a range of positive numbers.
    pub fn log_within(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.within([low.ln(), high.ln()]).exp()
    }

    /// From the standard normal distribution.
    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// Either sign.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Whether something of this probability happens.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// One of several, by their shares, which sum to 1.
    pub fn one_of<T: Copy>(&mut self, shares: &[(T, f64)]) -> T {
        let mut left = self.0.random::<f64>();
        let found = shares.iter().find(|(_, share)| {
            left -= share;
            left < 0.0
        });
        // Rounding may leave a rest, which is the last one's.
        found.unwrap_or(&shares[shares.len() - 1]).0
    }

    /// A whole number below `count`, which is at least 1.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1))
    }

    /// A seed for something else.
    pub fn seed(&mut self) -> u64 {
        self.0.random()
    }

    /// Puts items into a random order.
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

/// A number as vehicle files and keys state it, to five digits.
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
    fn streams_repeat_themselves_and_differ_from_one_another() {
        let first = |number| Draw::new(7, number).seed();
        assert_eq!(first(3), first(3));
        assert_ne!(first(3), first(4));
    }

    #[test]
    fn five_digits_are_kept() {
        assert_eq!(rounded(0.0123456789), 0.012346);
        assert_eq!(rounded(-9.80661), -9.8066);
        assert_eq!(rounded(0.0), 0.0);
    }
}
