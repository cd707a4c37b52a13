//! Gaps that no effect explains: noise, a force, or a cause outside the catalogue.

use super::*;

/// A gap that neither the file nor an effect closes.
fn open(shipped: f64) -> Evidence {
    let file = explained(&[], 0.0, [shipped; 2]);
    evidence(shipped, vec![file, explained(&["rotor_drag"], 3.0, [shipped; 2])])
}

#[test]
fn gap_within_its_scatter_is_noise() {
    let verdict = |shipped: f64, scatter: f64| {
        let decision = decide(&Evidence { scatter, ..open(shipped) });
        assert!(decision.explanation == 0 && decision.effects.is_empty(), "{decision:?}");
        decision.verdict
    };
    assert_eq!([1.1, 1.3].map(|gap| verdict(gap, 0.02)), [Verdict::None, Verdict::Unknown]);
    assert_eq!([1.5, 1.6].map(|gap| verdict(gap, 0.1)), [Verdict::None, Verdict::Unknown]);
}

#[test]
fn effect_that_closes_less_than_the_scatter_is_not_named() {
    let named_with = |scatter: f64| {
        let file = explained(&[], 0.0, [1.25, 1.25]);
        let drag = explained(&["rotor_drag"], 300.0, [1.1, 1.1]);
        let all = evidence(1.25, vec![file, drag]);
        named(&decide(&Evidence { scatter, ..all })).join(" ")
    };
    assert_eq!([0.02, 0.1].map(named_with), ["rotor_drag", ""]);
}

#[test]
fn effect_that_closes_a_fifth_of_the_gap_is_no_explanation() {
    let verdict = |left: f64| {
        let file = explained(&[], 0.0, [8.0, 6.0]);
        let drag = explained(&["rotor_drag"], 300.0, [left, left]);
        let decision = decide(&evidence(8.0, vec![file, drag]));
        (decision.because, decision.explanation)
    };
    // Of 36 - 1 that the file leaves open, 6.4 are closed, and then 8.
    assert_eq!(verdict(5.44), (Some(Unexplained::Remainder), 0));
    assert_eq!(verdict(5.29), (Some(Unexplained::Doubt), 1));
}

#[test]
fn effect_that_worsens_the_held_out_predictions_is_not_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let mut sag = explained(&["battery_sag"], 300.0, [1.1, 1.05]);
    sag.reported = sag.reported.map(|gaps| Gaps { effects: 20.0, ..gaps });
    let decision = decide(&evidence(8.0, vec![file, sag]));
    assert!(decision.effects.is_empty(), "{decision:?}");
    assert_eq!(decision.because, Some(Unexplained::Remainder));
}

#[test]
fn file_that_closes_little_leaves_the_gap_open_below_twice_the_noise() {
    let verdict = |shipped: f64, by_file: f64| {
        let file = explained(&[], 0.0, [shipped, by_file]);
        decide(&evidence(shipped, vec![file])).verdict
    };
    // Of 2.61 it leaves 1.25, and of 24 it leaves 1.25.
    assert_eq!(verdict(1.9, 1.5), Verdict::Unknown);
    assert_eq!(verdict(5.0, 1.5), Verdict::None);
}

#[test]
fn noise_is_reported_where_a_learner_predicts_less_than_all() {
    let noise = |learned| decide(&Evidence { learned, ..open(8.0) }).noise;
    assert_eq!([None, Some(3.0), Some(0.5)].map(noise), [1.0, 3.0, 1.0]);
}

#[test]
fn force_is_the_cause_only_of_an_open_gap() {
    let because = |shipped: f64, significance: f64| {
        let force = Some(ForceLeft { rms: 1.0, significance, size: 3.0 });
        decide(&Evidence { force, ..open(shipped) }).because
    };
    assert_eq!(because(8.0, 9.0), Some(Unexplained::Force));
    assert_eq!(because(8.0, 3.0), Some(Unexplained::Remainder));
    assert_eq!(because(1.1, 9.0), None);
    // Gusts as well.
    let force = Some(ForceLeft { rms: 1.0, significance: 9.0, size: 3.0 });
    let calm = Evidence { force, gusts_m_s: Some(1.5), ..open(1.1) };
    assert_eq!(decide(&calm).verdict, Verdict::None);
    let weak = Evidence { force: None, gusts_m_s: Some(1.5), ..open(8.0) };
    assert_eq!(decide(&weak).because, Some(Unexplained::Remainder));
}

#[test]
fn nothing_is_decided_without_explanations() {
    let decision = decide(&Evidence::default());
    assert_eq!((decision.verdict, decision.because), (Verdict::None, None));
    assert!(decision.effects.is_empty() && decision.masses.is_empty());
}
