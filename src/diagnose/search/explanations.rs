//! Every explanation of the flights, and the twins that measure chance.

use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::search::explanation::Explanation;
use crate::diagnose::search::twins::Twins;

/// Every explanation of the flights, and the twins that measure chance.
#[derive(Debug)]
pub struct Explanations {
    /// The vehicle file within its tolerances.
    pub file: Explanation,
    /// Sets of effects, the best first.
    pub sets: Vec<Explanation>,
    /// Noise of the reported state.
    pub noise: ReportNoise,
    /// Twins without an effect, unless none were requested.
    pub twins: Option<Twins>,
}

impl Explanations {
    /// The explanation with the most evidence.
    pub fn best(&self) -> &Explanation {
        match self.sets.first() {
            Some(best) if best.score() > self.file.score() => best,
            _ => &self.file,
        }
    }
}
