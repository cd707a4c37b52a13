//! The numbers that decisions rest on.

use super::*;
use crate::diagnose::simulate::gap::Errors;
use crate::diagnose::simulate::metric::Metric;

#[test]
fn score_is_the_evidence_of_the_fit_and_the_gain_in_predicting() {
    let file = explained(&[], 8.0, [8.0, 6.0]);
    let drag = explained(&["rotor_drag"], 20.0, [3.0, 2.0]);
    let mut all = evidence(8.0, vec![file, drag]);
    let has = |all: &Evidence, score: f64| {
        let scores = all.scores();
        scores[0] == 0.0 && (scores[1] - score).abs() < 1e-9
    };
    // A ninth of the variance, with three errors a second over 20 s.
    let gain = 1.5 * 20.0 * 9.0_f64.ln();
    assert!(has(&all, 12.0 + gain));
    // The flights for choosing count by their predictions only.
    all.fitted_blocks = 3;
    assert!(has(&all, 9.0 + gain));
    // Where nothing is predicted, they count by their densities.
    all.explanations[1].choosing = None;
    assert!(has(&all, 12.0));
    assert!(Evidence::default().scores().is_empty());
}

#[test]
fn noise_is_what_no_learner_predicts() {
    let noise = |loop_known, learned, is_forced| {
        Evidence { loop_known, learned, ..Evidence::default() }.noise(9.0, is_forced)
    };
    for loop_known in [true, false] {
        assert_eq!(noise(loop_known, Some(2.0), false), 4.0);
        // It is at most what the explanation leaves, and at least the floor.
        assert_eq!(noise(loop_known, Some(4.0), false), 9.0);
        assert_eq!(noise(loop_known, Some(0.5), false), 1.0);
    }
    // A force that two sensors agree on is no noise.
    assert_eq!(noise(true, Some(2.0), true), 1.0);
    // Without a learner only a known loop shows what noise is.
    assert_eq!([true, false].map(|is_known| noise(is_known, None, false)), [1.0, 9.0]);
}

#[test]
fn effects_may_worsen_predictions_by_half_of_what_the_file_makes_up_for() {
    let is_worse = |[shipped, by_file, by_effects]: [f64; 3]| {
        let file = explained(&[], 0.0, [shipped, by_file]);
        let mass = explained(&["mass"], 300.0, [by_effects, 1.0]);
        let all = evidence(shipped, vec![file, mass.clone()]);
        [0, 1].map(|flights| all.is_worse(&mass, flights))
    };
    // The file makes up for 64 - 36, so the effects may add 14.
    assert_eq!(is_worse([8.0, 6.0, 8.8]), [false; 2]);
    assert_eq!(is_worse([8.0, 6.0, 8.9]), [true; 2]);
    // A file that makes predictions worse makes up for nothing.
    assert_eq!(is_worse([8.0, 9.0, 7.9]), [false; 2]);
    assert_eq!(is_worse([8.0, 9.0, 8.1]), [true; 2]);
}

#[test]
fn most_certain_number_decides_whether_a_value_is_plausible() {
    let mut both = explained(&["inertia", "wind"], 900.0, [1.1, 1.0]);
    both.numbers[0].is_at_bound = true;
    // Both are off by 1; the other one is more certain.
    (both.numbers[0].deviation, both.numbers[1].deviation) = (0.1, 0.01);
    assert!(!both.is_at_bound());
    (both.numbers[0].deviation, both.numbers[1].deviation) = (0.01, 0.1);
    assert!(both.is_at_bound());
    // Or further off, on either side of the file's value.
    both.numbers[0].value = -3.0;
    both.numbers[0].deviation = 0.1;
    assert!(both.is_at_bound());
    both.numbers[1].value = 8.0;
    assert!(!both.is_at_bound());
}

#[test]
fn effect_is_practical_beyond_three_tolerances_of_one_of_its_numbers() {
    let mut inertia = explained(&["inertia", "wind"], 0.0, [1.0; 2]);
    let other = Found { effect: "inertia".to_owned(), ..inertia.numbers[0].clone() };
    inertia.numbers.push(other);
    let with = |tolerance: f64, value: f64| {
        let mut inertia = inertia.clone();
        inertia.numbers[0].unremarkable = 1.0;
        inertia.numbers[2].unremarkable = tolerance;
        inertia.numbers[2].value = value;
        inertia.is_practical("inertia")
    };
    // The file's value is 1.
    assert_eq!([1.29, 1.31].map(|value| with(0.1, value)), [false, true]);
    assert_eq!([0.71, 0.69].map(|value| with(0.1, value)), [false, true]);
}

#[test]
fn gap_with_effects_is_the_smaller_one_and_at_least_the_floor() {
    let square = |effects: f64, both: f64| explained(&[], 0.0, [effects, both]).reported_square();
    assert_eq!(square(3.0, 2.0), Some(4.0));
    assert_eq!(square(2.0, 3.0), Some(4.0));
    assert_eq!(square(2.0, 0.5), Some(1.0));
    // In units of the floor, over the parts of the metric.
    let errors = |error: f64| Errors([[error; 4]; 3]);
    let gaps = Gaps::over([3.0, 1.0].map(errors), &errors(0.5), Metric::Forces);
    assert_eq!([gaps.effects, gaps.both], [6.0, 2.0]);
    assert_eq!(gaps.parts, [2.0, 2.0, 2.0, 2.0, 0.0, 0.0]);
}

#[test]
fn force_counts_if_it_is_both_significant_and_large() {
    let is_practical =
        |significance, size| ForceLeft { rms: 1.0, significance, size }.is_practical();
    assert!(is_practical(6.0, 1.1));
    assert!(!is_practical(4.0, 3.0) && !is_practical(9.0, 0.9));
}

#[test]
fn rotation_counts_beyond_the_gyros_noise() {
    let turning = MeasuredRotation { measured: [1.5, 0.5, 0.5], noise: [0.5; 3] };
    // Of 0.4 beyond the noise, 0.3 are closed; about the others nothing is left to close.
    let share = turning.share([0.6, 0.5, 0.5], [0.9, 0.5, 0.4]);
    assert!((share - 0.75).abs() < 1e-12, "{share}");
    // A hundredth of the rotation is too little to count.
    assert_eq!(turning.share([0.5, 0.5, 0.5], [0.509, 0.5, 0.5]), 0.0);
    assert!(turning.share([0.5, 0.5, 0.5], [0.511, 0.5, 0.5]) > 0.9);
    // Not where both leave more than half of it.
    assert_eq!(turning.share([1.1, 0.5, 0.5], [4.5, 0.5, 0.5]), 0.0);
}
