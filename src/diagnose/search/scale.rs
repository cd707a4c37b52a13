//! The quality of a vehicle file: the scale of its numbers' tolerances, estimated from the flights.

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::search::Search;

/// Scales to try, from a careful builder's file to an exact one.
const SCALES: [f64; 6] = [1.0, 0.4, 0.15, 0.05, 0.015, 0.005];
/// Effects that may act beside the file's errors while the scale is estimated.
const EFFECTS: usize = 2;
/// Least evidence of such an effect, nats: the price of choosing it.
const EFFECT_MIN: f64 = 4.0;

/// The most likely scale of the flights, with up to two effects beside the file's errors, and the
/// log evidence of each scale (empirical Bayes). `at` returns the catalogue at a scale; `about`
/// holds the derivatives at the fit of the file's numbers.
pub fn scale(
    search: &Search<'_>,
    about: &Linearised,
    at: impl Fn(f64) -> Catalogue,
) -> (f64, Vec<[f64; 2]>) {
    let evidence = |scale: f64| {
        let catalogue = at(scale);
        let search = Search { catalogue: &catalogue, chance: search.chance.clone(), ..*search };
        let base = about.solve(&catalogue, search.fitted.counts(), &[])?;
        let mut evidence = base.evidence;
        let mut set = Vec::new();
        for _ in 0..EFFECTS {
            let Some((best, gain)) = search.screen(about, &set).into_iter().next() else { break };
            if gain < EFFECT_MIN {
                break;
            }
            evidence += gain - EFFECT_MIN;
            set.push(best);
        }
        Some([scale, evidence])
    };
    let found: Vec<[f64; 2]> = SCALES.into_iter().filter_map(evidence).collect();
    let best = found.iter().max_by(|a, b| a[1].total_cmp(&b[1])).map_or(1.0, |best| best[0]);
    (best, found)
}
