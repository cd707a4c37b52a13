//! An explanation of flights: a set of effects with its fit, and the likelihood of each block.

use crate::diagnose::likelihood::fit::Fit;
use crate::diagnose::likelihood::observed::Observed;

/// A set of effects, fitted; the empty set is the vehicle file within its tolerances.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The fit, on the flights for fitting.
    pub fit: Fit,
    /// Log evidence of the flights for fitting, less the evidence that chance gives its hypotheses,
    /// nats.
    pub evidence: f64,
    /// Log density of each block, nats. The blocks of the flights for fitting come first and sum to
    /// the evidence; the fit predicts those of the flights for choosing.
    pub blocks: Vec<f64>,
}

impl Explanation {
    /// Scores a fit. `chance` is the evidence that chance gives its hypotheses, nats.
    pub fn new(
        fit: Fit,
        chance: f64,
        fitted: &Observed<'_>,
        choosing: &Observed<'_>,
    ) -> Option<Self> {
        let density =
            |observed: &Observed<'_>| Some(observed.log_density(&observed.residuals(&fit.values)?));
        let (mut blocks, mut chosen) = (density(fitted)?, density(choosing)?);
        let size = |observed: &Observed<'_>| observed.counts().iter().sum::<f64>().max(1.0);
        // Chance acts on every flight, in proportion to its coefficients.
        let of_choosing = chance * size(choosing) / size(fitted) / chosen.len().max(1) as f64;
        chosen.iter_mut().for_each(|density| *density -= of_choosing);
        let evidence = fit.evidence - chance;
        let count = blocks.len().max(1) as f64;
        let rest = (evidence - blocks.iter().sum::<f64>()) / count;
        blocks.iter_mut().for_each(|density| *density += rest);
        blocks.append(&mut chosen);
        Some(Self { fit, evidence, blocks })
    }

    /// Log evidence of all flights except the held-out ones, nats.
    pub fn score(&self) -> f64 {
        self.blocks.iter().sum()
    }
}
