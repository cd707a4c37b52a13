//! Checks units, axes and orders by how streams fit each other, and reports delays, rotations and
//! biases.

mod pairs;

use vehicle::frame::Attitude;

use self::pairs::pairs;
use super::agreement::Agreement;
use super::axes;
use super::frames::{self, READING_SHARE_MIN};
use super::kinematics::{
    Reading, rotation_rates, share_explained_as_read, share_explained_by_gyro,
    share_explained_by_velocity,
};
use super::timing::is_logged;
use super::weak::{median, span_s};
use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// Typical rates and velocities above which motion shows whether one stream follows the other,
/// rad/s and m/s.
const ROTATION_RATE_MIN: f64 = 0.2;
const SPEED_MIN: f64 = 0.3;
/// Below this explained share, the streams do not follow each other at all.
const FOLLOWING_SHARE_MIN: f64 = 0.3;
/// A log shorter than this need not show that a stream follows, s.
const SHORT_S: f64 = 10.0;
/// Median specific force of a vehicle in flight or at rest, m/s^2.
const FORCE_RANGE: std::ops::Range<f64> = 7.0..13.0;

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    for pair in pairs(audit) {
        let Some(agreement) = pair.agreement else { continue };
        if pair.has_fault(&agreement, &mut audit.findings) {
            continue;
        }
        if let Some(limits) = &pair.report {
            pair.report(&agreement, limits, &mut audit.findings);
        }
    }
    let turned = |a: Agreement| {
        a.coarse_rad.iter().flatten().any(|r| r.is_beyond(0.3, 0.0))
            || a.reversed_axes().next().is_some()
    };
    if audit.kinematics.attitude.is_none_or(turned) {
        check_readings(flight, audit);
    }
    if audit.kinematics.position.is_none() {
        check_moving(flight, audit);
    }
    axes::check(flight, audit);
    frames::check(flight, audit);
    check_force(flight, audit);
    check_voltage(flight, audit);
}

/// Reports quaternions in another direction or order, where they do not follow the gyro as stated.
fn check_readings(flight: &Flight, audit: &mut Audit) {
    if !is_logged(&flight.attitude) || !is_logged(&flight.body_rate) {
        return;
    }
    if rotation_rates(flight).is_none_or(|turns| turns.iter().any(|rate| *rate < ROTATION_RATE_MIN))
    {
        return;
    }
    let readings: [(Reading, &str); 3] = [
        (|q| q.inverse(), "world to body instead of body to world"),
        (
            |q| Attitude { w: q.z, x: q.w, y: q.x, z: q.y },
            "stored as x, y, z, w and read as w, x, y, z",
        ),
        (
            |q| Attitude { w: q.x, x: q.y, y: q.z, z: q.w },
            "stored as w, x, y, z and read as x, y, z, w",
        ),
    ];
    let found = readings
        .into_iter()
        .filter_map(|(read, text)| Some((share_explained_as_read(flight, read)?, text)))
        .filter(|(explained, _)| *explained > READING_SHARE_MIN)
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let is_short = span_s(flight.attitude.times()) < SHORT_S;
    let (what, found) = match (found, share_explained_by_gyro(flight)) {
        (Some((share, text)), _) => (format!("quaternions seem to be {text}"), share),
        // A log this short may not show it.
        (None, None) if is_short => return,
        (None, follows) => match follows.unwrap_or(0.0) {
            follows if follows < FOLLOWING_SHARE_MIN => {
                ("does not turn as the gyro reports".to_owned(), follows)
            }
            _ => return,
        },
    };
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "quaternion",
        stream: Some("attitude"),
        found,
        expected: 1.0,
        unit: "",
        what,
        advice: "check order, direction and frames of the attitude, and that both are from one \
                 vehicle",
    });
}

/// Reports a position and a velocity that do not follow each other although one of them moves.
fn check_moving(flight: &Flight, audit: &mut Audit) {
    let is_short = span_s(flight.position.times()) < SHORT_S;
    if is_short || !is_logged(&flight.position) || !is_logged(&flight.velocity) {
        return;
    }
    let Some((follows, [measured, expected])) = share_explained_by_velocity(flight) else { return };
    if measured.max(expected) < SPEED_MIN || follows >= FOLLOWING_SHARE_MIN {
        return;
    }
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "motion",
        stream: Some("position"),
        found: follows,
        expected: 1.0,
        unit: "",
        what: format!(
            "does not follow the velocity: it changes by {measured:.2} m/s, the velocity by \
             {expected:.2} m/s, and they share {:.0} %",
            100.0 * follows
        ),
        advice: "check that both are from one vehicle, one flight and one clock",
    });
}

/// Every specific force contains gravity: its size shows the unit, its direction the axes.
fn check_force(flight: &Flight, audit: &mut Audit) {
    if !is_logged(&flight.specific_force) {
        return;
    }
    let forces = flight.specific_force.values();
    let size = median(forces.iter().map(|f| f.norm()).collect());
    let down = median(forces.iter().map(|f| f.to_array()[2]).collect());
    let mut report = |found: f64, expected: f64, what: String| {
        audit.findings.push(Finding {
            severity: Severity::Fault,
            check: "gravity",
            stream: Some("specific_force"),
            found,
            expected,
            unit: "m/s^2",
            what,
            advice: "an accelerometer at rest shows (0, 0, -9.8) m/s^2 in front, right, down",
        });
    };
    if (0.7..1.4).contains(&size) {
        report(size, 9.8, format!("its median size is {size:.2}: in g?"));
    } else if size < 3.0 {
        report(size, 9.8, format!("its median size is {size:.2}: was gravity removed?"));
    } else if !FORCE_RANGE.contains(&size) {
        report(size, 9.8, format!("its median size is {size:.2}"));
    } else if down > 3.0 {
        report(down, -9.8, format!("it points down ({down:.2}): are its axes front, left, up?"));
    }
}

fn check_voltage(flight: &Flight, audit: &mut Audit) {
    let Some(highest) = flight.voltage.values().iter().copied().reduce(f64::max) else { return };
    if (2.0..=120.0).contains(&highest) {
        return;
    }
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "unit",
        stream: Some("voltage"),
        found: highest,
        expected: 2.0_f64.max(highest.min(120.0)),
        unit: "V",
        what: format!("at most {highest:.2} V, which no quadrotor's pack has"),
        advice: "check the unit: it may be millivolts",
    });
}
