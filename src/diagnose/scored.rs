//! A fit with its score: evidence where it was fitted, density and predictions where it was not.

use std::sync::OnceLock;

use super::fit::Fit;
use super::gap::Window;

/// A fit with its score on the flights that were held out.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The fit.
    pub fit: Fit,
    /// Its log evidence without what chance gives its hypotheses, nats.
    pub evidence: f64,
    /// Log density of each block held out, nats.
    pub density: Vec<f64>,
    /// Open-loop errors on all flights, window by window: of its effects alone, and with its
    /// nuisances.
    windows: [OnceLock<Windows>; 2],
}

/// Errors by window, horizon and quantity.
pub(super) type Windows = Vec<Window>;

impl Scored {
    /// A fit with its evidence [nats] and its log density on the flights held out, block by block
    /// [nats].
    pub(super) fn new(fit: Fit, evidence: f64, density: Vec<f64>) -> Self {
        Self { fit, evidence, density, windows: Default::default() }
    }

    /// How much likelier it makes the flights held out than `other`: nats, and the standard error
    /// by the scatter between blocks.
    pub fn gain_over(&self, other: &Scored) -> (f64, f64) {
        let gains: Vec<f64> = self.density.iter().zip(&other.density).map(|(a, b)| a - b).collect();
        let n = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / n.max(1.0);
        // One block does not tell how much blocks scatter.
        if n < 2.0 {
            return (mean, mean.abs());
        }
        let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean * n, (variance * n).sqrt())
    }

    /// Whether it makes the flights held out no less likely than `other`: what does is no cause of
    /// theirs.
    pub(super) fn predicts_as_well_as(&self, other: &Scored) -> bool {
        self.gain_over(other).0 >= 0.0
    }

    /// Evidence and held-out density together.
    pub fn score(&self) -> f64 {
        self.evidence + self.density.iter().sum::<f64>()
    }

    /// Open-loop errors of its effects alone, or with its nuisances; found by `find` when they are
    /// first asked for.
    pub(super) fn windows(&self, nuisances: bool, find: impl FnOnce() -> Windows) -> &Windows {
        self.windows[usize::from(nuisances)].get_or_init(find)
    }
}

#[cfg(test)]
impl Scored {
    /// Hypotheses of which only the evidence and the density are known.
    pub(super) fn of(hypotheses: Vec<usize>, evidence: f64, density: Vec<f64>) -> Self {
        let fit = Fit {
            hypotheses,
            values: Vec::new(),
            deviation: Vec::new(),
            evidence,
            cost: 0.0,
            power: Vec::new(),
        };
        Self::new(fit, evidence, density)
    }
}
