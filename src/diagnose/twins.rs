//! Twins of the flights without any effect: how large chance makes the evidence.
//!
//! A twin is the same motion with other noise: what the nuisances leave is drawn again from its
//! spectrum, channel by channel and band by band, and goes through the same screening. The largest
//! gain of evidence over the catalogue, over many twins, is what an effect must exceed; it holds
//! the multiple tests, the noise's colour and the excitation of these very flights.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::Serialize;

use super::linearised::Linearised;
use super::observed::Residuals;
use super::selection::{Scored, Selector};

/// Share of twins that may exceed the threshold.
const EXCEEDED: f64 = 0.01;

/// What the twins say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Twins {
    /// How many there were.
    pub count: u32,
    /// The largest gain of evidence of each, ascending, nats.
    pub largest: Vec<f64>,
    /// Gain that one in a hundred exceeds: beyond the largest by the twins' exponential tail.
    pub threshold: f64,
}

/// Draws `count` twins of the flights that are fitted.
pub fn twins(
    selector: &Selector<'_>,
    null: &Scored,
    about: &Linearised,
    count: u32,
    seed: u64,
) -> Twins {
    let observed = selector.fitted;
    let noise = null.fit.noise(observed.counts());
    let mut largest: Vec<f64> = (0..count)
        .into_par_iter()
        .map(|twin| {
            let mut rng = Pcg64Mcg::seed_from_u64(seed.wrapping_add(u64::from(twin) << 20));
            let drawn: Residuals = observed
                .layouts
                .iter()
                .map(|layout| {
                    let places = layout.places.iter();
                    places
                        .map(|place| {
                            let z: f64 = StandardNormal.sample(&mut rng);
                            z * noise[place.index()].sqrt()
                        })
                        .collect()
                })
                .collect();
            let mut twin = about.clone();
            twin.values = selector.catalogue.references();
            twin.rest_on(observed, &drawn);
            selector.screen(&twin, &[]).first().map_or(0.0, |(_, gain)| *gain)
        })
        .collect();
    largest.sort_by(f64::total_cmp);
    let threshold = threshold(&largest);
    Twins { count, largest, threshold }
}

/// The point that a share of [`EXCEEDED`] exceeds. The upper half of the maxima falls off
/// exponentially, and carries on so beyond the largest that was drawn.
fn threshold(largest: &[f64]) -> f64 {
    let n = largest.len();
    if n < 2 {
        return 0.0;
    }
    let median = largest[n / 2];
    let upper = &largest[n / 2..];
    let slope = upper.iter().map(|gain| gain - median).sum::<f64>() / upper.len() as f64;
    median + slope * (0.5 / EXCEEDED).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_threshold_of_exponential_maxima_is_their_hundredth() {
        let n = 2000;
        // Quantiles of an exponential distribution with mean 3.
        let largest: Vec<f64> =
            (0..n).map(|i| -3.0 * (1.0 - (f64::from(i) + 0.5) / f64::from(n)).ln()).collect();
        let expected = 3.0 * 100.0_f64.ln();
        assert!((threshold(&largest) / expected - 1.0).abs() < 0.02, "{}", threshold(&largest));
    }
}
