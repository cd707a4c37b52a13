//! The plan file: written plans are read back, and anything else is refused.

use std::path::PathBuf;
use std::sync::Arc;

use crate::planning::{attitude_pd, physics, planned_vehicle, planner, rest, turning};
use downwash::plan::flyable::NotFlyable;
use downwash::plan::planned::{Answer, Found, Plan, PlannedReference, PlannedThrough};
use downwash::plan::planner::PlanSettings;
use downwash::plan::reference::ReferenceSource;
use downwash::plan::scp::Status;
use proptest::prelude::*;

fn a_plan() -> Plan {
    let settings = PlanSettings { rate_hz: 50.0, ..PlanSettings::default() };
    let planner = planner(Arc::new(physics()), &settings);
    let desire = planner.desire(&turning()).expect("desired states");
    let outcome = planner.plan(&desire, rest(&desire.states[0]), None, &|_| false);
    let found = Found {
        trajectory: "turning".to_owned(),
        vehicle: "crazyflie".to_owned(),
        body: planned_vehicle().body,
        model: PlannedThrough { kind: "physics".to_owned(), sha256: Some("ab".repeat(32)) },
        period_s: planner.period_s(),
        answer: Answer {
            delay_s: 0.02,
            lag_s: 0.04,
            voltage_exponent: 0.0,
            attitude_pd: attitude_pd(),
        },
        desired: desire.states,
    };
    Plan::new(found, outcome)
}

/// A file for one test.
struct Kept(PathBuf);

impl Kept {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path =
            std::env::temp_dir().join(format!("downwash-plan-{}-{name}.json", std::process::id()));
        std::fs::write(&path, bytes).expect("a file");
        Self(path)
    }
}

impl Drop for Kept {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn read(name: &str, bytes: &[u8]) -> Result<Plan, String> {
    let kept = Kept::new(name, bytes);
    let read = Plan::load(&kept.0).map_err(|error| error.to_string());
    if let Err(error) = &read {
        assert!(error.contains(&kept.0.display().to_string()), "{error}");
    }
    read
}

#[test]
fn plan_file_round_trips() {
    let plan = a_plan();
    let text = plan.to_json().expect("a text");
    assert_eq!(read("whole", text.as_bytes()), Ok(plan.clone()));
    assert_eq!(plan.check_flyable(), Ok(()));
    let missing = Plan::load(&std::env::temp_dir().join("downwash-no-such-plan.json"));
    assert!(missing.expect_err("refused").to_string().contains("downwash-no-such-plan.json"));
}

#[test]
fn damaged_plan_is_refused_with_the_reason() {
    let text = a_plan().to_json().expect("a text");
    let changed = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    };
    let cases = [
        ("empty", String::new(), "EOF"),
        ("version", changed("\"schema_version\":2", "\"schema_version\":3"), "version 3"),
        ("schema", changed("downwash.plan", "downwash.plane"), "downwash.plane"),
        ("field", changed("\"cost\"", "\"price\""), "price"),
        ("period", changed("\"period_s\":0.02", "\"period_s\":0.0"), "times"),
        ("delay", changed("\"delay_s\":0.02", "\"delay_s\":-1.0"), "times"),
        ("null", changed("\"lag_s\":0.04", "\"lag_s\":null"), "null"),
        ("huge", changed("\"kp\":[", "\"kp\":[1e999,"), "line 1"),
        ("other", "{\"schema\":\"downwash.fly\"}".to_owned(), "missing"),
        // From a version without this check: a missing statement does not mean that nothing is
        // there.
        ("silent", text.replace(",\"trespass_m\":0.0", ""), "trespass_m"),
    ];
    for (name, text, reason) in cases {
        let error = read(name, text.as_bytes()).expect_err(name);
        assert!(error.contains(reason) && error.contains("plan it again"), "{name}: {error}");
    }
    let mut fewer: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    fewer["states"].as_array_mut().expect("states").pop();
    let error = read("fewer", fewer.to_string().as_bytes()).expect_err("refused");
    assert!(error.contains("101 states") && error.contains("found 100"), "{error}");
    let mut slack: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    slack["answer"]["attitude_pd"]["kp"][2] = serde_json::json!(0.0);
    let error = read("slack", slack.to_string().as_bytes()).expect_err("refused");
    assert!(error.contains("kp above 0"), "{error}");
    let mut none = fewer.clone();
    none["inputs"] = serde_json::json!([]);
    assert!(read("none", none.to_string().as_bytes()).expect_err("refused").contains("found 0"));
    let error = read("binary", &[0xff, 0xfe, 0x00, 0x01]).expect_err("refused");
    assert!(error.contains("UTF-8"), "{error}");
}

#[test]
fn violated_plan_is_not_flyable() {
    let mut plan = a_plan();
    plan.violation.defect = 2e-4;
    assert!(matches!(plan.check_flyable(), Err(NotFlyable::Violated { .. })));
    plan.violation.defect = f64::NAN;
    assert!(matches!(plan.check_flyable(), Err(NotFlyable::Violated { .. })));
    plan.violation.defect = 0.0;
    plan.violation.overrun = 0.02;
    assert!(matches!(plan.check_flyable(), Err(NotFlyable::Violated { .. })));
    plan.violation.overrun = 0.0;
    for trespass_m in [0.002, f64::NAN] {
        plan.violation.trespass_m = trespass_m;
        assert!(matches!(plan.check_flyable(), Err(NotFlyable::Trespass { .. })));
    }
    plan.violation.trespass_m = 0.0;
    assert_eq!(plan.check_flyable(), Ok(()));
    let mut torn = plan.clone();
    torn.states[50][0] += 0.5;
    assert!(matches!(torn.check_flyable(), Err(NotFlyable::Torn { .. })));
    torn.states[50] = plan.states[50];
    torn.states[70][8] = f64::INFINITY;
    assert!(matches!(torn.check_flyable(), Err(NotFlyable::Torn { .. })));
    plan.status = Status::Failed;
    assert_eq!(plan.check_flyable(), Err(NotFlyable::Failed));
}

#[test]
fn reference_passes_through_the_plan() {
    let plan = a_plan();
    let reference = PlannedReference::new(&plan);
    assert!((reference.duration() - plan.duration()).abs() < 1e-12);
    for (n, state) in plan.states.iter().enumerate() {
        let sample = reference.sample(n as f64 * plan.period_s);
        let position = sample.position.to_array();
        for i in 0..3 {
            assert!((position[i] - state[i]).abs() < 1e-9);
        }
    }
    // The reference holds before the beginning and after the end.
    assert_eq!(reference.sample(-1.0), reference.sample(0.0));
    assert_eq!(reference.sample(99.0), reference.sample(plan.duration()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn truncated_or_corrupted_plan_never_panics(cut in 0.0_f64..1.0, flip in any::<(f64, u8)>()) {
        static TEXT: std::sync::LazyLock<Vec<u8>> =
            std::sync::LazyLock::new(|| a_plan().to_json().expect("a text").into_bytes());
        let place = |share: f64| ((TEXT.len() - 1) as f64 * share.fract().abs()) as usize;
        let error = read("cut", &TEXT[..place(cut)]).expect_err("refused");
        prop_assert!(error.contains("plan it again"), "{}", error);
        let mut flipped = TEXT.clone();
        flipped[place(if flip.0.is_finite() { flip.0 } else { 0.5 })] ^= flip.1;
        if let Ok(plan) = read("flipped", &flipped) {
            let reference = PlannedReference::new(&plan);
            reference.sample(0.5 * reference.duration());
        }
    }
}
