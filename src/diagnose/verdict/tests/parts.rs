//! Which effects of an explanation count.

use super::*;

/// Evidence without predictions.
fn unpredicted(mut explanations: Vec<Explained>) -> Evidence {
    explanations.iter_mut().for_each(|one| (one.choosing, one.reported) = (None, None));
    Evidence { shipped: [None; 2], ..evidence(1.0, explanations) }
}

#[test]
fn effect_counts_by_its_evidence_where_nothing_is_predicted() {
    let names = |alone: f64, both: f64| {
        let file = explained(&[], 0.0, [1.0; 2]);
        let drag = explained(&["rotor_drag"], alone, [1.0; 2]);
        let beside = explained(&["rotor_drag", "wind"], both, [1.0; 2]);
        named(&decide(&unpredicted(vec![file, drag, beside]))).join(" ")
    };
    assert_eq!(names(60.0, 78.0), "rotor_drag wind");
    // Less than an eighth of it is negligible, and so is less than ten nats.
    assert_eq!(names(160.0, 178.0), "rotor_drag");
    assert_eq!(names(30.0, 39.5), "rotor_drag");
}

#[test]
fn effect_within_its_tolerance_is_not_named_without_predictions() {
    let file = explained(&[], 0.0, [1.0; 2]);
    let mut lag = explained(&["motor_lag"], 200.0, [1.0; 2]);
    lag.numbers[0].unremarkable = 0.5;
    let decision = decide(&unpredicted(vec![file, lag]));
    assert_eq!((decision.verdict, decision.because), (Verdict::None, None));
}

#[test]
fn difference_near_the_floor_means_little() {
    let names = |[shipped, both, alone]: [f64; 3]| {
        let file = explained(&[], 0.0, [shipped; 2]);
        let both = explained(&["rotor_drag", "wind"], 320.0, [both; 2]);
        let drag = explained(&["rotor_drag"], 300.0, [alone; 2]);
        named(&decide(&evidence(shipped, vec![file, both, drag]))).join(" ")
    };
    // In both cases the wind closes 18 % of the squared gap beyond the floor.
    assert_eq!(names([1.15, 1.02, 1.048]), "rotor_drag");
    assert_eq!(names([5.0, 2.0, 2.89]), "rotor_drag wind");
}
