//! An explanation of flights: a set of effects with its fit, and how likely it makes each block of
//! them.

use crate::diagnose::likelihood::fit::Fit;
use crate::diagnose::likelihood::observed::Observed;

/// A set of effects, fitted; the empty set is the vehicle file within its tolerances.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The fit, on the flights for fitting.
    pub fit: Fit,
    /// Log evidence of the flights for fitting, without what chance gives its hypotheses, nats.
    pub evidence: f64,
    /// Log density of each block, nats: of the flights for fitting, whose sum is the evidence, and
    /// then of those for choosing, predicted by the fit.
    pub blocks: Vec<f64>,
}

impl Explanation {
    /// Scores a fit. `chance`: evidence that chance gives its hypotheses, nats.
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
        // What chance gives, it gives to every flight.
        let of_choosing = chance * size(choosing) / size(fitted) / chosen.len().max(1) as f64;
        chosen.iter_mut().for_each(|density| *density -= of_choosing);
        let evidence = fit.evidence - chance;
        let count = blocks.len().max(1) as f64;
        let rest = (evidence - blocks.iter().sum::<f64>()) / count;
        blocks.iter_mut().for_each(|density| *density += rest);
        blocks.append(&mut chosen);
        Some(Self { fit, evidence, blocks })
    }

    /// Log evidence of all flights but those reported on, nats.
    pub fn score(&self) -> f64 {
        self.blocks.iter().sum()
    }
}
