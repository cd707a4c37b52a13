//! What chance leaves open in the difference of two means: Student's t, paired or Welch's.

use schemars::JsonSchema;
use serde::Serialize;

/// Probability that an interval is to hold.
const LEVEL: f64 = 0.95;

/// Mean and spread of numbers, one for each flight.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Sample {
    /// How many flights.
    pub flights: usize,
    /// Mean.
    pub mean: f64,
    /// Standard deviation over the flights; of a single one 0.
    pub deviation: f64,
}

impl Sample {
    /// Of these numbers; `None` of none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        (!values.is_empty()).then(|| {
            let mean = values.iter().sum::<f64>() / n;
            let square: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
            let deviation = if n > 1.0 { (square / (n - 1.0)).sqrt() } else { 0.0 };
            Self { flights: values.len(), mean, deviation }
        })
    }

    /// Half of the mean's 95 % interval; `None` of fewer than two.
    pub fn half_interval(&self) -> Option<f64> {
        let n = self.flights as f64;
        (n > 1.0).then(|| quantile(n - 1.0) * self.deviation / n.sqrt())
    }

    fn variance_of_mean(&self) -> f64 {
        self.deviation.powi(2) / self.flights as f64
    }
}

/// How a difference was tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Test {
    /// Student's t of the pairs' differences.
    PairedT,
    /// Welch's t of the two means.
    WelchT,
}

impl Test {
    /// In words.
    pub fn text(self) -> &'static str {
        match self {
            Self::PairedT => "paired t-test",
            Self::WelchT => "Welch's t-test",
        }
    }
}

/// A difference of means with what chance leaves open.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Tested {
    /// Mean of B less mean of A.
    pub difference: f64,
    /// Its 95 % interval.
    pub interval: [f64; 2],
    /// Probability of a difference this large where there is none, on both sides.
    pub p: f64,
    /// How it was tested.
    pub test: Test,
}

impl Tested {
    /// Half the width of the interval.
    pub fn half_width(&self) -> f64 {
        (self.interval[1] - self.interval[0]) / 2.0
    }

    /// Of pairs; `None` of fewer than two.
    pub fn paired(a: &[f64], b: &[f64]) -> Option<Self> {
        let differences: Vec<f64> = b.iter().zip(a).map(|(b, a)| b - a).collect();
        let sample = Sample::of(&differences).filter(|sample| sample.flights > 1)?;
        let freedom = sample.flights as f64 - 1.0;
        Some(Self::new(sample.mean, sample.variance_of_mean().sqrt(), freedom, Test::PairedT))
    }

    /// Of flights that have nothing to do with each other; `None` of fewer than two on either side.
    pub fn unpaired(a: &[f64], b: &[f64]) -> Option<Self> {
        let several = |values| Sample::of(values).filter(|sample| sample.flights > 1);
        let (a, b) = (several(a)?, several(b)?);
        let (va, vb) = (a.variance_of_mean(), b.variance_of_mean());
        let (na, nb) = (a.flights as f64 - 1.0, b.flights as f64 - 1.0);
        let spread = va * va / na + vb * vb / nb;
        let freedom = if spread > 0.0 { (va + vb).powi(2) / spread } else { na + nb };
        Some(Self::new(b.mean - a.mean, (va + vb).sqrt(), freedom, Test::WelchT))
    }

    fn new(difference: f64, error: f64, freedom: f64, test: Test) -> Self {
        let half = quantile(freedom) * error;
        let p = match (difference == 0.0, error > 0.0) {
            (true, _) => 1.0,
            (false, true) => outside(difference.abs() / error, freedom),
            (false, false) => 0.0,
        };
        Self { difference, interval: [difference - half, difference + half], p, test }
    }

    /// Whether the interval leaves out zero.
    pub fn is_more_than_chance(&self) -> bool {
        let [low, high] = self.interval;
        low > 0.0 || high < 0.0
    }
}

/// Holm's p-values: each is at least as large as that of a smaller one, and all together are wrong
/// no more often than one alone.
pub(super) fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut adjusted = vec![1.0; p.len()];
    let mut most: f64 = 0.0;
    for (rank, at) in order.iter().enumerate() {
        most = most.max((p.len() - rank) as f64 * p[*at]).min(1.0);
        adjusted[*at] = most;
    }
    adjusted
}

/// Probability of |t| beyond `t` with so many degrees of freedom.
fn outside(t: f64, freedom: f64) -> f64 {
    incomplete_beta(freedom / (freedom + t * t), freedom / 2.0, 0.5)
}

/// The t within which [`LEVEL`] of all lie.
fn quantile(freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, 2.0);
    while outside(high, freedom) > 1.0 - LEVEL && high < 1e6 {
        high *= 2.0;
    }
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if outside(middle, freedom) > 1.0 - LEVEL { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The regularised incomplete beta function, by its continued fraction (Lentz's way).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    // It converges fast on one side of the mean; the other side is one less it.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let front =
        (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (1.0 - x).ln()).exp() / a;
    let tiny = |value: f64| if value.abs() < 1e-300 { 1e-300 } else { value };
    let (mut c, mut d) = (1.0, 1.0 / tiny(1.0 - (a + b) * x / (a + 1.0)));
    let mut fraction = d;
    for k in 1..400 {
        let m = f64::from(k);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for term in [even, odd] {
            d = 1.0 / tiny(1.0 + term * d);
            c = tiny(1.0 + term / c);
            change = c * d;
            fraction *= change;
        }
        if (change - 1.0).abs() < 1e-14 {
            break;
        }
    }
    (front * fraction).clamp(0.0, 1.0)
}

/// Logarithm of the gamma function, by Stirling's series from 10 on.
fn ln_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 10.0 {
        shift += x.ln();
        x += 1.0;
    }
    let y = 1.0 / (x * x);
    let series = (1.0 / 12.0 - y * (1.0 / 360.0 - y * (1.0 / 1260.0 - y / 1680.0))) / x;
    (x - 0.5) * x.ln() - x + 0.5 * (2.0 * std::f64::consts::PI).ln() + series - shift
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn t_quantiles_match_tables() {
        for (freedom, expected) in [(1.0, 12.7062), (4.0, 2.7764), (10.0, 2.2281), (100.0, 1.9840)]
        {
            assert!((quantile(freedom) - expected).abs() < 1e-4, "{freedom}");
        }
        assert!((outside(2.0, 7.0) - 0.085_617).abs() < 1e-5);
        assert!((ln_gamma(5.0) - 24_f64.ln()).abs() < 1e-10);
    }

    #[test]
    fn equal_samples_do_not_differ_and_constant_offsets_do() {
        let same = Tested::paired(&[1.0, 2.0, 3.0], &[1.0, 2.0, 3.0]).expect("pairs");
        assert!(!same.is_more_than_chance() && same.p == 1.0);
        let apart = Tested::paired(&[1.0, 2.0], &[2.0, 3.0]).expect("pairs");
        assert!(apart.is_more_than_chance() && apart.difference == 1.0);
        assert_eq!(Tested::unpaired(&[1.0], &[2.0, 3.0]), None);
    }

    #[test]
    fn holm_adjustment_keeps_the_order() {
        let adjusted = holm(&[0.01, 0.5, 0.02, 0.03]);
        assert_eq!(
            adjusted.iter().map(|p| (p * 1e6).round() / 1e6).collect::<Vec<_>>(),
            [0.04, 0.5, 0.06, 0.06]
        );
    }

    /// Without a real difference, about one comparison in twenty finds one; intervals cover a known
    /// difference at their stated rate.
    #[test]
    fn false_alarm_rate_and_coverage_match_five_percent() {
        const TRIALS: usize = 4000;
        let mut random = Pcg64::seed_from_u64(1);
        let (own, shared) =
            (Normal::new(0.0, 1.0).expect("a law"), Normal::new(5.0, 3.0).expect("a law"));
        let (mut false_alarms, mut covered) = ([0; 2], [0; 2]);
        for trial in 0..TRIALS {
            let n = 3 + trial % 6;
            let base: Vec<f64> = (0..n).map(|_| shared.sample(&mut random)).collect();
            let mut draw = |spread: f64| -> Vec<f64> {
                base.iter().map(|common| common + spread * own.sample(&mut random)).collect()
            };
            let (a, b) = (draw(1.0), draw(2.0));
            let more: Vec<f64> = b.iter().map(|b| b + 1.5).collect();
            // Without pairs: other samples, with a different spread.
            let c: Vec<f64> = (0..n + 2).map(|_| 5.0 + 2.0 * own.sample(&mut random)).collect();
            let d: Vec<f64> = (0..n).map(|_| 5.0 + own.sample(&mut random)).collect();
            let e: Vec<f64> = d.iter().map(|d| d + 1.5).collect();
            let tested = [
                (Tested::paired(&a, &b), Tested::paired(&a, &more)),
                (Tested::unpaired(&c, &d), Tested::unpaired(&c, &e)),
            ];
            for (kind, (without, with)) in tested.into_iter().enumerate() {
                let (without, with) = (without.expect("several"), with.expect("several"));
                false_alarms[kind] += usize::from(without.is_more_than_chance());
                let [low, high] = with.interval;
                covered[kind] += usize::from(low <= 1.5 && 1.5 <= high);
            }
        }
        for kind in 0..2 {
            let [alarms, held] =
                [false_alarms[kind], covered[kind]].map(|n| n as f64 / TRIALS as f64);
            assert!((0.035..0.065).contains(&alarms), "{kind}: false alarms {alarms}");
            assert!((0.935..0.97).contains(&held), "{kind}: coverage {held}");
        }
    }
}
