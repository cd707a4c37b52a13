//! Split conformal prediction over whole flights.
//!
//! With the scores of `n` flights and that of a new one exchangeable, the new score is at most the
//! `k`-th smallest of the `n`, `k = ceil((n + 1) confidence)`, with a probability of at least
//! `confidence`, and of at most `confidence + 1 / (n + 1)` if no two scores are equal (Vovk,
//! Gammerman and Shafer 2005, "Algorithmic Learning in a Random World"; Lei et al. 2018,
//! "Distribution-Free Predictive Inference for Regression"). The probability is over the draw of
//! all `n + 1` flights: it is marginal, not conditional on a mission or on a wind.

/// Slack for the rounding of `(n + 1) confidence`, whose exact value may be whole.
const ROUNDING: f64 = 1e-9;

/// Rank, from 1 for the smallest, of the score that bounds a new flight's.
fn rank(flights: usize, confidence: f64) -> usize {
    ((flights as f64 + 1.0) * confidence - ROUNDING).ceil().max(1.0) as usize
}

/// The smallest number of calibration flights that supports a confidence in 0..1: 19 for 0.95.
pub fn flights_needed(confidence: f64) -> usize {
    let about = (confidence / (1.0 - confidence) - ROUNDING).ceil().max(1.0);
    about as usize
}

/// The bound on a new flight's score. `scores` are those of `flights` calibration flights in
/// ascending order; missing scores count as infinite. `None` if no finite score bounds it.
pub fn bound(scores: &[f64], flights: usize, confidence: f64) -> Option<f64> {
    let rank = rank(flights, confidence);
    scores.get(rank - 1).copied().filter(|_| rank <= flights)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn minimum_flight_counts_match_the_textbook() {
        let needed = [0.5, 0.9, 0.95, 0.99, 0.999].map(flights_needed);
        assert_eq!(needed, [1, 9, 19, 99, 999]);
        let scores: Vec<f64> = (1..=19).map(f64::from).collect();
        assert_eq!(bound(&scores, 19, 0.95), Some(19.0));
        assert_eq!(bound(&scores[..18], 18, 0.95), None);
        // A flight that ended early has no score and counts as infinite.
        assert_eq!(bound(&scores[..18], 19, 0.95), None);
        assert_eq!(bound(&scores, 19, 0.5), Some(10.0));
    }

    proptest! {
        #[test]
        fn minimum_flight_count_is_sufficient_and_necessary(
            confidence in 0.5_f64..0.999,
        ) {
            let needed = flights_needed(confidence);
            let scores = vec![1.0; needed];
            prop_assert!(bound(&scores, needed, confidence).is_some());
            prop_assert!(bound(&scores[1..], needed - 1, confidence).is_none());
        }
    }

    /// The coverage of exchangeable scores that are neither independent nor identically distributed
    /// given what they share: a common factor multiplies all of a draw's.
    #[test]
    fn coverage_holds_for_exchangeable_scores() {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        for (flights, confidence) in [(19, 0.95), (40, 0.9), (57, 0.8)] {
            let draws = 20_000;
            let mut covered = 0;
            for _ in 0..draws {
                let common: f64 = random.sample::<f64, _>(StandardNormal).exp();
                let mut score = || common * random.sample::<f64, _>(StandardNormal).abs().powi(3);
                let new = score();
                let mut scores: Vec<f64> = (0..flights).map(|_| score()).collect();
                scores.sort_by(f64::total_cmp);
                let bound = bound(&scores, flights, confidence).expect("enough flights");
                covered += usize::from(new <= bound);
            }
            let rate = covered as f64 / f64::from(draws);
            // Four standard deviations of the rate on either side.
            let chance = 4.0 * (confidence * (1.0 - confidence) / f64::from(draws)).sqrt();
            let most = confidence + 1.0 / (flights as f64 + 1.0);
            assert!((confidence - chance..=most + chance).contains(&rate), "{rate} {confidence}");
        }
    }
}
