//! The audit finds flights that several files hold, and only those.

use downwash::audit::Audit;
use vehicle::frame::Attitude;

use crate::audit::{LIVELY, fly, unbiased};

/// So slow that repetitions differ little.
const GENTLE: &str = r#"
family = "figure-8"
altitude_m = 1.0
duration_s = 24
length_m = 3.0
width_m = 1.5
period_s = 8.0
"#;

#[test]
fn duplicate_flight_is_found() {
    let first = fly("copied", LIVELY, unbiased(), 7);
    // Another file with the same samples at other times.
    let mut second = first.clone();
    second.origin.sha256 = "other".into();
    second.origin.path = "copy.tlog".into();
    second.attitude = second.attitude.shifted(500.0);
    let other = fly("other", LIVELY, unbiased(), 8);
    let audits = Audit::of_all(&[first, second, other]);
    let twins: Vec<usize> = audits
        .iter()
        .map(|audit| audit.findings.iter().filter(|f| f.check == "duplicate").count())
        .collect();
    assert_eq!(twins, [0, 1, 0]);
}

#[test]
fn second_recording_of_a_flight_is_found_but_no_repetition() {
    let repeat = |seed| fly("repeated", GENTLE, unbiased(), seed);
    let first = repeat(1);
    // Recorded again at a third of the rate, with stamps that are 3 ms late.
    let mut recording = first.clone();
    recording.origin.path = "recording.tlog".into();
    recording.origin.sha256 = "other".into();
    let mut count = 0;
    let thinned = recording.attitude.filter_map(|q| {
        count += 1;
        let noise = 1e-5 * f64::from(count % 7);
        (count % 3 == 0).then(|| Attitude { x: q.x + noise, ..*q }.normalized())
    });
    recording.attitude = thinned.shifted(0.003);
    // The lockstep clock begins anew with each flight, so repetitions share their stamps.
    let audits = Audit::of_all(&[first, recording, repeat(2), repeat(3)]);
    let is_duplicate = |audit: &Audit| audit.findings.iter().any(|f| f.check == "duplicate");
    let found: Vec<bool> = audits.iter().map(is_duplicate).collect();
    assert_eq!(found, [false, true, false, false]);
}
