use super::*;
use crate::exam::deviations::Deviation;
use crate::exam::deviations::Parameters;
use crate::exam::strength::Strength;

fn parameters(text: &str) -> Parameters {
    serde_json::from_str(text).expect("parameters")
}

fn key(kind: Kind, effects: &[(&str, &str, &str)]) -> KeyEntry {
    let effects = effects.iter().map(|(id, truth, neutral)| TrueEffect {
        id: (*id).to_owned(),
        parameters: parameters(truth),
        neutral: parameters(neutral),
        ratio: 5.0,
    });
    KeyEntry {
        kind,
        condition: Condition::Plain,
        file: FileKind::Claimed,
        on_board: LoopKind::Pd,
        outputs_hz: 100.0,
        deviations: Vec::new(),
        beyond_tolerances: vec![Some(4.0)],
        ratio_beyond_file: Some(5.0),
        is_practical: true,
        verdict: "effect".to_owned(),
        effects: effects.collect(),
        also_right: Vec::new(),
        candidates: Vec::new(),
        foreign: None,
        without: Vec::new(),
        snr: Strength { ratio: 5.0, channel: String::new() },
        is_weak: false,
        nominal_mass_kg: 1.2,
        tags: Vec::new(),
    }
}

fn row(key: &KeyEntry, answer: &str) -> Row {
    let given: GivenAnswer = serde_json::from_str(answer).expect("an answer");
    Row::new("case", key, Ok(&given), None, 1.0)
}

#[test]
fn right_effect_is_scored_by_its_numbers_and_intervals() {
    let key = key(
        Kind::Single,
        &[("wind", r#"{"north_m_s":3,"east_m_s":4}"#, r#"{"north_m_s":0,"east_m_s":0}"#)],
    );
    let row = row(
        &key,
        r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9,
        "parameters":{"north_m_s":3.0,"east_m_s":3.5},
        "intervals":{"north_m_s":[2.9,3.1],"east_m_s":[3.4,3.6]}}]}"#,
    );
    assert!(row.top_right && row.in_set && row.is_definite && row.exact);
    assert!((row.errors["wind"][0] - 0.1).abs() < 1e-12);
    assert_eq!(row.covered["wind"], [false, true]);
    assert!((row.brier - 0.01).abs() < 1e-12);
}

#[test]
fn undetectable_effect_may_go_unnamed_without_penalty() {
    let key = key(Kind::Trap, &[("vortex_ring", r#"{"loss_max":0.2}"#, r#"{"loss_max":0}"#)]);
    let none = row(&key, r#"{"verdict":"none","effects":[]}"#);
    assert!(none.trap_right && none.brier == 0.0);
    let by_luck = r#"{"verdict":"effect","effects":[{"id":"vortex_ring","probability":0.9}]}"#;
    assert_eq!(row(&key, by_luck).brier, 0.0);
    let other = r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9}]}"#;
    assert!((row(&key, other).brier - 0.81).abs() < 1e-12);
}

#[test]
fn equivalent_effect_is_right_and_its_number_converted() {
    let key = key(Kind::Single, &[("mass", r#"{"mass_kg":1.5}"#, r#"{"mass_kg":1.2}"#)]);
    let row = row(
        &key,
        r#"{"verdict":"effect","effects":[
        {"id":"thrust_scale","probability":0.95,"parameters":{"scale":0.8}}]}"#,
    );
    assert!(row.top_right && row.errors["mass"][0] < 1e-9, "{row:?}");
}

#[test]
fn confident_wrong_name_is_distinguished_from_ambiguity() {
    let key = key(Kind::Single, &[("wind", "{}", "{}")]);
    let wrong = row(
        &key,
        r#"{"verdict":"effect",
        "effects":[{"id":"attitude_trim","probability":0.97}]}"#,
    );
    assert_eq!(wrong.confidently_wrong.as_deref(), Some("attitude_trim"));
    assert!(!wrong.in_set && !wrong.admits_ignorance());
    let unsure = row(
        &key,
        r#"{"verdict":"effect","ambiguous_with":["wind"],
        "effects":[{"id":"attitude_trim","probability":0.6}]}"#,
    );
    assert!(unsure.in_set && !unsure.top_right && unsure.admits_ignorance());
    assert!(unsure.confidently_wrong.is_none());
}

#[test]
fn naming_an_effect_missing_from_the_catalogue_is_wrong() {
    let mut key = key(Kind::LeftOut, &[("wind", "{}", "{}")]);
    key.without = vec!["wind".to_owned()];
    key.verdict = "unknown".to_owned();
    let named = row(&key, r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9}]}"#);
    assert_eq!(named.confidently_wrong.as_deref(), Some("wind"));
    let unknown = row(&key, r#"{"verdict":"unknown"}"#);
    assert!(unknown.verdict_right() && unknown.admits_ignorance() && unknown.brier == 0.0);
}

#[test]
fn trap_requires_the_truth_among_the_candidates() {
    let mut key = key(Kind::Trap, &[("wind", "{}", "{}")]);
    key.candidates = ["wind", "attitude_trim"].map(str::to_owned).to_vec();
    let is_right = |answer: &str| row(&key, answer).trap_right;
    assert!(is_right(
        r#"{"verdict":"effect","ambiguous_with":["wind"],
        "effects":[{"id":"attitude_trim","probability":0.6}]}"#
    ));
    assert!(is_right(r#"{"verdict":"none","not_testable":[{"id":"wind"}]}"#));
    assert!(!is_right(r#"{"verdict":"none"}"#));
    assert!(!is_right(
        r#"{"verdict":"effect","ambiguous_with":["gusts"],
        "effects":[{"id":"wind","probability":0.9}]}"#
    ));
}

/// A mass 10 % above a file whose thrust and inertia are off.
fn off_file(kind: Kind) -> KeyEntry {
    let deviation = |id: &str, is: &str, stated: &str| Deviation {
        id: id.to_owned(),
        parameters: parameters(is),
        neutral: parameters(stated),
        alternatives: Vec::new(),
        tolerances: Some(1.0),
    };
    let effects: &[_] = match kind {
        Kind::Null => &[],
        _ => &[("mass", r#"{"mass_kg":1.32}"#, r#"{"mass_kg":1.2}"#)],
    };
    let inertia = deviation("inertia", r#"{"scale":[1.08,1.0,0.95]}"#, r#"{"scale":[1,1,1]}"#);
    let verdict = if kind == Kind::Null { "none" } else { "effect" };
    KeyEntry { deviations: vec![inertia], verdict: verdict.to_owned(), ..key(kind, effects) }
}

#[test]
fn deviation_is_acceptable_only_with_its_right_value() {
    let null = off_file(Kind::Null);
    let graded = |scale: &str, intervals: &str| {
        let effect = format!(
            r#"{{"id":"inertia","probability":0.9,"parameters":{{"scale":{scale}}}{intervals}}}"#
        );
        row(&null, &format!(r#"{{"verdict":"effect","effects":[{effect}]}}"#))
    };
    let right = graded("[1.07,1.01,0.96]", "");
    assert_eq!(right.grade, Grade::Acceptable);
    assert!(right.confidently_wrong.is_none() && right.brier == 0.0 && right.verdict_right());
    let wrong = graded("[1.3,1.01,0.96]", "");
    assert_eq!(wrong.grade, Grade::Wrong);
    assert_eq!(wrong.confidently_wrong.as_deref(), Some("inertia"));
    let wide = r#","intervals":{"scale[0]":[1.0,1.1],"scale[1]":[0.95,1.1],"scale[2]":[0.9,1.0]}"#;
    assert_eq!(graded("[1.05,1.04,0.95]", "").grade, Grade::Wrong);
    assert_eq!(graded("[1.05,1.04,0.95]", wide).grade, Grade::Acceptable);
    let unknown = row(&null, r#"{"verdict":"unknown"}"#);
    assert!(unknown.grade == Grade::Wrong && !unknown.verdict_right());
}

#[test]
fn truth_with_a_deviation_is_right_otherwise_mixed() {
    let case = off_file(Kind::Single);
    let mass = r#"{"id":"mass","probability":0.95,"parameters":{"mass_kg":1.3}}"#;
    let inertia = r#"{"id":"inertia","probability":0.97,"parameters":{"scale":[1.08,1,0.95]}}"#;
    let wind = r#"{"id":"wind","probability":0.7}"#;
    let graded =
        |effects: &str| row(&case, &format!(r#"{{"verdict":"effect","effects":[{effects}]}}"#));
    assert_eq!(graded(mass).grade, Grade::Right);
    let both = graded(&format!("{mass},{inertia}"));
    assert!(both.grade == Grade::Acceptable && both.top_right && both.exact, "{both:?}");
    let mixed = graded(&format!("{mass},{wind}"));
    assert_eq!(
        (mixed.grade, mixed.false_named.as_slice()),
        (Grade::Mixed, &["wind".to_owned()][..])
    );
    assert_eq!(graded(wind).grade, Grade::Wrong);
    assert_eq!(row(&case, r#"{"verdict":"unknown"}"#).grade, Grade::Missed);
}

#[test]
fn naming_or_none_is_right_below_the_practical_size() {
    let case = KeyEntry { is_practical: false, ..off_file(Kind::Single) };
    let mass = r#"{"verdict":"effect","effects":[{"id":"mass","probability":0.8}]}"#;
    assert_eq!(row(&case, r#"{"verdict":"none"}"#).grade, Grade::Right);
    assert_eq!(row(&case, mass).grade, Grade::Right);
    let wind = r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.8}]}"#;
    assert_eq!(row(&case, wind).grade, Grade::Wrong);
}
