//! Decisions on constructed evidence and on evidence stored from flights.

use super::*;
use crate::diagnose::likelihood::equation_residual::EquationResidual;
use crate::diagnose::search::rotation_prediction::RotationPrediction;
use crate::diagnose::verdict::evidence::{Explained, Found, Gaps, MeasuredRotation};

mod evidence;
mod open_gap;
mod parts;
mod rivals;

/// A set of effects with its evidence over the file's in each of four blocks, and its gaps:
/// with the effects alone, and with the file's numbers as well.
fn explained(effects: &[&str], nats: f64, [of_effects, both]: [f64; 2]) -> Explained {
    let gaps = Gaps { effects: of_effects, both, ..Gaps::default() };
    let number = |effect: &&str| Found {
        effect: (*effect).to_owned(),
        name: "number".to_owned(),
        value: 2.0,
        deviation: 0.01,
        reference: 1.0,
        ..Found::default()
    };
    Explained {
        effects: effects.iter().map(|effect| (*effect).to_owned()).collect(),
        numbers: effects.iter().map(number).collect(),
        blocks: vec![nats / 4.0; 4],
        choosing: Some(gaps),
        reported: Some(gaps),
        ..Explained::default()
    }
}

/// The evidence of explanations, the file within its tolerances first, on flights with a gap of
/// `shipped`.
fn evidence(shipped: f64, explanations: Vec<Explained>) -> Evidence {
    Evidence {
        loop_known: true,
        metric: "mean".to_owned(),
        scale: 1.0,
        turning: [RotationPrediction { is_usable: true, ..RotationPrediction::default() }; 3],
        fitted_blocks: 4,
        chosen_s: 20.0,
        explanations,
        shipped: [Some(shipped); 2],
        scatter: 0.02,
        voltage_differs: true,
        outputs_logged: true,
        ..Evidence::default()
    }
}

/// A fixed calibration, so that a new one does not change these tests.
fn decide(evidence: &Evidence) -> Decision {
    let calibration = Calibration { version: 0, law: 0.06, discrepancy: [-3.5, 8.0] };
    decide_with(evidence, &calibration)
}

fn named(decision: &Decision) -> Vec<&str> {
    let named = decision.effects.iter().filter(|(_, p)| *p >= NAMED);
    let mut named: Vec<&str> = named.map(|(id, _)| id.as_str()).collect();
    named.sort_unstable();
    named
}

#[test]
fn verdicts_have_the_names_of_the_json() {
    for verdict in [Verdict::Effect, Verdict::None, Verdict::Unknown] {
        let json = serde_json::to_value(verdict).expect("a word");
        assert_eq!(json, verdict.name());
    }
}

#[test]
fn nothing_is_named_if_file_numbers_close_the_gap() {
    let file = explained(&[], 0.0, [8.0, 1.05]);
    let drag = explained(&["rotor_drag"], 12.0, [7.0, 1.04]);
    let decision = decide(&evidence(8.0, vec![file, drag]));
    assert_eq!((decision.verdict, decision.explanation), (Verdict::None, 0));
    assert!((decision.masses.iter().sum::<f64>() - 1.0).abs() < 1e-9);
}

#[test]
fn effect_that_closes_most_of_the_gap_is_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let whole = explained(&["rotor_drag"], 300.0, [1.1, 1.05]);
    let decision = decide(&evidence(8.0, vec![file.clone(), whole]));
    assert_eq!(decision.verdict, Verdict::Effect);
    assert_eq!(named(&decision), ["rotor_drag"]);
    assert!(!decision.is_inexact && decision.effects[0].1 > 0.9);
    let most = explained(&["rotor_drag"], 300.0, [2.6, 2.5]);
    let decision = decide(&evidence(8.0, vec![file, most]));
    assert_eq!(named(&decision), ["rotor_drag"]);
    assert!(decision.is_inexact, "{decision:?}");
    // Of the 36 - 1 that can be closed, 2.5^2 - 1 stays open.
    assert!((decision.signs[1] - 0.15).abs() < 1e-12, "{decision:?}");
}

#[test]
fn effect_without_influence_on_predictions_is_not_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let drag = explained(&["rotor_drag"], 300.0, [1.1, 1.05]);
    let beside = explained(&["rotor_drag", "motor_lag"], 330.0, [1.1, 1.05]);
    let sets = vec![file.clone(), beside.clone(), drag.clone()];
    assert_eq!(named(&decide(&evidence(8.0, sets))), ["rotor_drag"]);
    // Unless it carries much of the evidence and closes a part of the gap.
    let mut carries = explained(&["rotor_drag", "motor_lag"], 600.0, [1.1, 1.05]);
    let sets = vec![file.clone(), carries.clone(), drag.clone()];
    assert_eq!(named(&decide(&evidence(8.0, sets))), ["rotor_drag"]);
    let with_rate = |gaps: Option<Gaps>, rate| gaps.map(|gaps| Gaps { parts: [rate; 6], ..gaps });
    carries.choosing = with_rate(carries.choosing, 1.1);
    let named_beside = |rate: f64| {
        let mut drag = drag.clone();
        drag.choosing = with_rate(drag.choosing, rate);
        let sets = vec![file.clone(), carries.clone(), drag];
        named(&decide(&evidence(8.0, sets))).join(" ")
    };
    assert_eq!([1.35, 1.6].map(named_beside), ["rotor_drag", "motor_lag rotor_drag"]);
    // Or much of the prediction.
    let less = explained(&["rotor_drag"], 300.0, [4.0, 4.0]);
    let sets = vec![file, beside, less];
    assert_eq!(named(&decide(&evidence(8.0, sets))), ["motor_lag", "rotor_drag"]);
}

#[test]
fn effect_that_closes_an_equation_is_named_though_predictions_hardly_show_it() {
    let residual = |rotation: f64| {
        let rotation = [rotation; 3];
        [Some(EquationResidual { rotation, ..EquationResidual::default() }); 2]
    };
    let decision = |left: f64| {
        let file = Explained { equations: residual(2.6), ..explained(&[], 0.0, [13.2, 13.2]) };
        let inertia = explained(&["inertia"], 300.0, [12.9, 12.9]);
        let inertia = Explained { equations: residual(left), ..inertia };
        let rotation = [MeasuredRotation { measured: [10.4; 3], noise: [0.03; 3] }; 2];
        let all = evidence(13.2, vec![file, inertia]);
        decide(&Evidence { loop_known: false, learned: Some(12.95), rotation, ..all })
    };
    assert_eq!(named(&decision(0.3)), ["inertia"]);
    // Half of the residual is too little.
    assert_eq!(decision(1.3).verdict, Verdict::None);
}

#[test]
fn equation_of_the_on_board_loop_counts_like_that_of_rotation() {
    let residual = |command: [f64; 4]| [Some(EquationResidual { rotation: [0.0; 3], command }); 2];
    let file = explained(&[], 0.0, [13.2, 13.2]);
    let file = Explained { equations: residual([1.0, 4.0, 4.0, 1.0]), ..file };
    let names = |command: [f64; 4]| {
        let gain = explained(&["pd_gain"], 300.0, [13.1, 13.1]);
        let gain = Explained { equations: residual(command), ..gain };
        let all = evidence(13.2, vec![file.clone(), gain]);
        named(&decide(&Evidence { learned: Some(13.05), ..all })).join(" ")
    };
    assert_eq!(names([1.0, 0.5, 0.5, 0.5]), "pd_gain");
    // The rule adds the moments up; it judges the collective alone.
    assert_eq!(names([1.0, 0.1, 7.0, 1.0]), "");
    assert_eq!(names([0.2, 4.0, 4.0, 1.0]), "pd_gain");
}

#[test]
fn shrinking_wrong_moments_explains_no_rotation() {
    let hover = MeasuredRotation { measured: [0.2, 0.2, 0.002], noise: [0.001; 3] };
    // The moment about z is wrong: it says more than the vehicle turns.
    assert_eq!(hover.share([0.0, 0.0, 0.15], [0.0, 0.0, 2.0]), 0.0);
    assert!(hover.share([0.01, 0.15, 0.15], [0.1, 0.15, 2.0]) > 0.9);
    // What one effect explains and another ruins counts against the other.
    assert_eq!(hover.share([0.01, 0.4, 0.0], [0.1, 0.05, 0.0]), 0.0);
}

#[test]
fn gap_above_a_healthy_vehicles_noise_stays_open() {
    let leaves = |predicted: f64, gap: f64| {
        let file = explained(&[], 0.0, [24.0, gap]);
        let wind = explained(&["wind"], -2.0, [24.0, gap]);
        let (learned, structure) = (Some(1.0), [0.0, predicted]);
        let all = evidence(24.0, vec![file, wind]);
        decide(&Evidence { learned, structure, ..all }).verdict
    };
    let learned = |gap| leaves(0.4, gap);
    assert_eq!([1.25, 1.35].map(learned), [Verdict::None, Verdict::Unknown]);
    let not_learned = |gap| leaves(0.0, gap);
    assert_eq!([1.9, 2.4].map(not_learned), [Verdict::None, Verdict::Unknown]);
}

#[test]
fn effect_within_file_tolerance_is_not_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let mut both = explained(&["command_delay", "wind"], 400.0, [1.1, 1.05]);
    both.numbers[0].unremarkable = 0.5;
    let mut delay = explained(&["command_delay"], 300.0, [3.1, 3.05]);
    delay.numbers[0].unremarkable = 0.5;
    let sets = vec![file.clone(), both, delay.clone()];
    assert_eq!(named(&decide(&evidence(8.0, sets))), ["wind"]);
    // Where the file's numbers can close the gap, a fit of the file that missed it leaves no
    // open gap.
    delay.reported = Some(Gaps { effects: 1.1, both: 1.05, ..Gaps::default() });
    let decision = decide(&evidence(8.0, vec![file, delay]));
    assert_eq!((decision.verdict, decision.explanation), (Verdict::None, 0));
}

#[test]
fn effect_that_the_file_hides_in_a_twin_is_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    // Its fit moved the thrust to the end of its tolerance.
    let mut mass = explained(&["mass"], 400.0, [1.1, 1.05]);
    mass.numbers[0].unremarkable = 0.5;
    let level = explained(&["thrust_scale"], 370.0, [1.1, 1.05]);
    let sets = vec![file.clone(), mass.clone(), level.clone()];
    let decision = decide(&evidence(8.0, sets));
    assert_eq!((decision.verdict, named(&decision)), (Verdict::Effect, vec!["thrust_scale"]));
    // Not if it predicts worse, or is within its tolerance too.
    let worse = explained(&["thrust_scale"], 370.0, [1.5, 1.5]);
    let mut within = level;
    within.numbers[0].unremarkable = 0.5;
    for twin in [worse, within] {
        let sets = vec![file.clone(), mass.clone(), twin];
        assert_eq!(decide(&evidence(8.0, sets)).verdict, Verdict::None);
    }
}

#[test]
fn effect_smaller_than_its_own_error_is_not_named() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let mut both = explained(&["command_delay", "wind"], 400.0, [1.1, 1.05]);
    both.numbers[0].deviation = 3.0;
    let wind = explained(&["wind"], 300.0, [3.1, 3.05]);
    assert_eq!(named(&decide(&evidence(8.0, vec![file, both, wind]))), ["wind"]);
}

#[test]
fn best_predicting_part_of_an_explanation_is_named() {
    let file = explained(&[], 0.0, [40.0, 30.0]);
    let both = explained(&["battery_sag", "thrust_scale"], 400.0, [4.0, 4.0]);
    let sag = explained(&["battery_sag"], 320.0, [6.0, 6.0]);
    let level = explained(&["thrust_scale"], 340.0, [7.0, 7.0]);
    // Acts like a part, but was not predicted on the held-out flights.
    let mut mass = explained(&["mass"], 330.0, [2.0, 2.0]);
    mass.reported = None;
    let sets = vec![file.clone(), both, level, sag, mass];
    assert_eq!(named(&decide(&evidence(40.0, sets))), ["battery_sag"]);
    // A difference that means nothing does not outweigh the evidence.
    let both = explained(&["ground_effect", "parasitic_drag"], 400.0, [4.0, 4.0]);
    let ground = explained(&["ground_effect"], 390.0, [4.1, 4.1]);
    let drag = explained(&["parasitic_drag"], 20.0, [4.0, 4.0]);
    let sets = vec![file, both, ground, drag];
    assert_eq!(named(&decide(&evidence(40.0, sets))), ["ground_effect"]);
}

#[test]
fn implausible_value_is_no_explanation() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let mut far = explained(&["inertia"], 900.0, [1.1, 1.05]);
    far.numbers[0].is_at_bound = true;
    let decision = decide(&evidence(8.0, vec![file.clone(), far]));
    assert!(decision.effects.is_empty() && decision.verdict == Verdict::Unknown);
    // Neither is an effect that worsens predictions until the file's numbers compensate it.
    let worse = explained(&["battery_sag"], 900.0, [20.0, 1.05]);
    let decision = decide(&evidence(8.0, vec![file, worse]));
    assert!(decision.effects.is_empty(), "{decision:?}");
}

#[test]
fn unclosed_gap_is_unknown_or_unpredictable_noise() {
    let file = explained(&[], 0.0, [8.0, 7.9]);
    let drag = explained(&["rotor_drag"], 3.0, [7.9, 7.9]);
    let mut open = evidence(8.0, vec![file, drag]);
    let decision = decide(&open);
    assert_eq!(decision.because, Some(Unexplained::Remainder));
    // Half is explained by an effect that is less likely than not the cause.
    let half = explained(&["rotor_drag"], 300.0, [6.6, 6.6]);
    let mut doubtful = open.clone();
    doubtful.explanations[1] = half;
    assert_eq!(decide(&doubtful).because, Some(Unexplained::Doubt));
    open.loop_known = false;
    assert_eq!(decide(&open).verdict, Verdict::None);
    open.learned = Some(2.0);
    assert_eq!(decide(&open).because, Some(Unexplained::Remainder));
}

/// Stored evidence of flights of the exam, with the best explanations and their parts.
fn of_flights(text: &str) -> Decision {
    decide(&serde_json::from_str(text).expect("evidence"))
}

#[test]
fn stored_exam_flights_keep_their_verdicts() {
    let mass = of_flights(include_str!("../snapshots/mass.json"));
    assert_eq!((mass.verdict, named(&mass)), (Verdict::Effect, vec!["mass"]));
    let null = of_flights(include_str!("../snapshots/null.json"));
    assert_eq!((null.verdict, null.explanation), (Verdict::None, 0));
    let pair = of_flights(include_str!("../snapshots/pair.json"));
    assert_eq!(named(&pair), ["parasitic_drag", "rotor_gyroscopic"]);
    // A gyroscopic moment whose effect was taken out: an inertia closes the gap, beside a delay
    // within the file's tolerance, and the residual shows nothing. This is a miss: no sign yet
    // shows that the cause is outside the catalogue.
    let left_out = of_flights(include_str!("../snapshots/left_out.json"));
    assert_eq!(named(&left_out), ["inertia"]);
}

#[test]
fn force_confirmed_by_two_sensors_is_unknown_or_gusts() {
    let mut forced = evidence(8.0, vec![explained(&[], 0.0, [8.0, 7.9])]);
    forced.force = Some(ForceLeft { rms: 1.0, significance: 9.0, size: 3.0 });
    assert_eq!(decide(&forced).because, Some(Unexplained::Force));
    forced.slung_load = 0.8;
    assert_eq!(decide(&forced).because, Some(Unexplained::SlungLoad));
    forced.gusts_m_s = Some(1.5);
    assert_eq!(named(&decide(&forced)), ["gusts"]);
    forced.structure[0] = 0.7;
    assert_eq!(decide(&forced).because, Some(Unexplained::SlungLoad));
}

#[test]
fn evidence_alone_decides_without_predictions() {
    let unseen = |nats: f64| {
        let mut all = [explained(&[], 0.0, [1.0; 2]), explained(&["motor_lag"], nats, [1.0; 2])];
        all.iter_mut().for_each(|one| (one.choosing, one.reported) = (None, None));
        let mut evidence = evidence(1.0, all.into());
        evidence.shipped = [None; 2];
        decide(&evidence)
    };
    assert_eq!(unseen(200.0).verdict, Verdict::Effect);
    assert_eq!(named(&unseen(200.0)), ["motor_lag"]);
    assert_eq!(unseen(8.0).because, Some(Unexplained::Doubt));
    assert_eq!(unseen(0.0).verdict, Verdict::None);
}

#[test]
fn moment_effect_is_ambiguous_without_motor_outputs() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let inertia = explained(&["inertia"], 300.0, [1.1, 1.1]);
    let mut moment = evidence(8.0, vec![file, inertia]);
    assert!(decide(&moment).ambiguous_with.is_empty());
    moment.outputs_logged = false;
    let decision = decide(&moment);
    assert_eq!(decision.ambiguous_with, ["pd_gain", "yaw_torque"]);
    assert!(decision.effects[0].1 < 0.6);
}

#[test]
fn thrust_level_is_ambiguous_without_a_voltage_change() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let mass = explained(&["mass"], 300.0, [1.1, 1.05]);
    let mut level = evidence(8.0, vec![file, mass]);
    assert!(decide(&level).ambiguous_with.is_empty());
    level.voltage_differs = false;
    let decision = decide(&level);
    assert_eq!(decision.ambiguous_with, ["battery_sag", "thrust_curve"]);
    assert_eq!(named(&decision), ["mass"]);
}

#[test]
fn equally_good_explanations_are_ambiguous() {
    let file = explained(&[], 0.0, [8.0, 6.0]);
    let wind = explained(&["wind"], 100.0, [1.1, 1.05]);
    let trim = explained(&["attitude_trim"], 99.5, [1.1, 1.05]);
    let decision = decide(&evidence(8.0, vec![file, wind, trim]));
    assert_eq!(decision.verdict, Verdict::Effect);
    assert_eq!(decision.ambiguous_with.len(), 1);
}
