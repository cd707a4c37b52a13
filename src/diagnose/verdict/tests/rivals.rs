//! Effects that explain the flights as well as the named ones.

use super::*;

#[test]
fn thrust_level_is_ambiguous_with_a_weak_rotor_where_no_moment_is_used() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let loss = explained(&["rotor_loss"], 300.0, [1.1, 1.05]);
    let mut weak = evidence(8.0, vec![file, loss]);
    let rivals = |weak: &Evidence| decide(weak).ambiguous_with;
    // The moment about one level axis is enough.
    weak.turning[0].is_usable = false;
    assert!(rivals(&weak).is_empty());
    // That about the vertical one is not.
    weak.turning[1].is_usable = false;
    assert_eq!(rivals(&weak), ["battery_sag", "thrust_curve", "thrust_scale"]);
}

#[test]
fn one_of_three_equally_good_effects_is_the_cause() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let of = |effect: &str| explained(&[effect], 100.0, [1.1, 1.05]);
    let three = ["wind", "attitude_trim", "rotor_drag"].map(of);
    let decision = decide(&evidence(8.0, [vec![file], three.to_vec()].concat()));
    // None is more likely than not, but nothing of the gap is left.
    assert_eq!((decision.verdict, named(&decision)), (Verdict::Effect, Vec::new()));
    assert_eq!(decision.ambiguous_with.len(), 2);
    assert!(decision.ambiguous_with.is_sorted());
}

#[test]
fn effect_beside_the_named_one_is_no_rival_of_it() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let wind = explained(&["wind"], 100.0, [1.1, 1.05]);
    // Adds nothing to the wind, but has half of the mass.
    let both = explained(&["wind", "attitude_trim"], 103.7, [1.1, 1.05]);
    let decision = decide(&evidence(8.0, vec![file, wind, both]));
    assert_eq!(named(&decision), ["wind"]);
    assert!(decision.ambiguous_with.is_empty(), "{decision:?}");
}

#[test]
fn effects_are_listed_by_probability() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let both = explained(&["attitude_trim", "wind"], 200.0, [1.1, 1.05]);
    let other = explained(&["rotor_drag", "wind"], 198.0, [1.1, 1.05]);
    let trim = explained(&["attitude_trim"], 10.0, [5.0, 5.0]);
    let wind = explained(&["wind"], 10.0, [5.0, 5.0]);
    let decision = decide(&evidence(8.0, vec![file, both, other, trim, wind]));
    let effects: Vec<&str> = decision.effects.iter().map(|(id, _)| id.as_str()).collect();
    assert_eq!(effects, ["wind", "attitude_trim"]);
    assert!(decision.effects[0].1 > decision.effects[1].1 + 0.1);
    assert_eq!(decision.ambiguous_with, ["rotor_drag"]);
}
