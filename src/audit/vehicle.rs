//! Checks that the log is of a quadrotor: other vehicles support no conclusion.

use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// Number of a quadrotor's motors.
const MOTORS: u32 = 4;

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    if let Some(stated) = flight.facts.stated_otherwise() {
        audit.findings.push(Finding {
            severity: Severity::Fault,
            check: "vehicle_kind",
            stream: None,
            found: 0.0,
            expected: 1.0,
            unit: "",
            what: format!("the log is of {}: {}", stated.kind, stated.by),
            advice: "only quadrotors are supported: this log supports no conclusion",
        });
    }
    if let Some(motors) = flight.facts.motors.filter(|motors| *motors != MOTORS) {
        audit.findings.push(Finding {
            severity: Severity::Fault,
            check: "motor_count",
            stream: Some("outputs"),
            found: f64::from(motors),
            expected: f64::from(MOTORS),
            unit: "",
            what: format!("the autopilot drives {motors} motors"),
            advice: "only quadrotors are supported: the log is from another kind of vehicle",
        });
    }
}
