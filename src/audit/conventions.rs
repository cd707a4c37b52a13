//! Checks units, axes and orders by how streams fit each other, and reports delays, rotations and
//! biases.

use vehicle::frame::Attitude;

use super::agreement::{Agreement, Estimate};
use super::frames::{self, READS};
use super::kinematics::{Reading, moving_follows, turning_explained, turning_follows, turns};
use super::timing::is_logged;
use super::weak::median;
use super::{Audit, Finding, Severity};
use crate::log::import::Flight;

/// Typical rates and velocities above which motion shows whether one stream follows the other,
/// rad/s and m/s.
const TURNS: f64 = 0.2;
const MOVES: f64 = 0.3;
/// Below this explained share, the streams do not follow each other at all.
const FOLLOWS: f64 = 0.3;
/// A log shorter than this need not show that a stream follows, s.
const SHORT_S: f64 = 10.0;
/// Scales outside this range come from another unit.
const UNIT: std::ops::Range<f64> = 0.5..2.0;
/// Intervals by which a value must differ from zero to be reported.
const SURE: f64 = 3.0;
/// Median specific force of a vehicle in flight or at rest, m/s^2.
const FORCE: std::ops::Range<f64> = 7.0..13.0;

/// Two streams with the differences that they may have.
struct Pair {
    stream: &'static str,
    other: &'static str,
    agreement: Option<Agreement>,
    /// Limits for reports; `None` where the pair is only accurate enough to find faults.
    matters: Option<Matters>,
    /// Limits beyond any trim, filter, calibration or mounting.
    fault: Limits,
}

/// Least values that are reported.
struct Matters {
    delay_s: f64,
    rotation_rad: f64,
    scale: f64,
    bias: f64,
    /// Unit of the bias, and advice on it.
    unit: &'static str,
    advice: &'static str,
}

/// Largest plausible values.
struct Limits {
    /// Estimates are late by up to 0.08 s, those of a satellite receiver by 0.25 s.
    delay_s: f64,
    /// Trims and mountings are off by a few degrees, a compass by 15.
    rotation_rad: f64,
    /// Sensors' scales are off by up to 3 %, estimators' velocities by up to 12 %.
    scale: f64,
}

impl Limits {
    /// Whether a scale is certainly beyond sensors and filters. A filter as slow as the largest
    /// delay attenuates changes at `pace`, 1/s.
    fn is_no_scale(&self, scale: &Estimate, pace: f64) -> bool {
        let filtered = 1.0 / (self.delay_s * pace).hypot(1.0);
        let (low, high) = (1.0 - self.scale, 1.0 + self.scale);
        let reach = SURE * scale.half_width;
        scale.value - reach > high || scale.value + reach < low * filtered
    }
}

/// Change of a delay within a log that is reported, s.
const DRIFT_S: f64 = 0.015;

fn pairs(audit: &Audit) -> [Pair; 5] {
    let kinematics = &audit.kinematics;
    [
        Pair {
            stream: "attitude",
            other: "the gyro",
            agreement: kinematics.attitude,
            matters: Some(Matters {
                delay_s: 0.004,
                rotation_rad: 0.006,
                scale: 0.03,
                bias: 0.02,
                unit: "rad/s",
                advice: "the gyro's bias: subtract it",
            }),
            fault: Limits { delay_s: 0.15, rotation_rad: 0.3, scale: 0.3 },
        },
        Pair {
            stream: "position",
            other: "the velocity",
            agreement: kinematics.position,
            matters: Some(Matters {
                delay_s: 0.006,
                rotation_rad: 0.02,
                scale: 0.03,
                bias: 0.05,
                unit: "m/s",
                advice: "position and velocity come from different estimates",
            }),
            fault: Limits { delay_s: 0.15, rotation_rad: 0.3, scale: 0.3 },
        },
        Pair {
            stream: "velocity",
            other: "the accelerometer",
            agreement: kinematics.velocity,
            matters: Some(Matters {
                delay_s: 0.008,
                rotation_rad: 0.05,
                scale: 0.03,
                bias: 0.15,
                unit: "m/s^2",
                advice: "the accelerometer's bias, or a tilt of the reported attitude that the gyro does not show (0.17 m/s^2 a degree)",
            }),
            fault: Limits { delay_s: 0.3, rotation_rad: 0.3, scale: 0.3 },
        },
        Pair {
            stream: "velocity",
            other: "the lean",
            agreement: kinematics.lean,
            matters: None,
            fault: Limits { delay_s: f64::INFINITY, rotation_rad: 0.5, scale: 1.0 },
        },
        Pair {
            stream: "attitude",
            other: "its setpoint",
            agreement: kinematics.setpoint,
            matters: None,
            fault: Limits { delay_s: f64::INFINITY, rotation_rad: 0.7, scale: f64::INFINITY },
        },
    ]
}

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    for pair in pairs(audit) {
        let Some(agreement) = pair.agreement else { continue };
        if pair.has_fault(&agreement, &mut audit.findings) {
            continue;
        }
        if let Some(matters) = &pair.matters {
            pair.report(&agreement, matters, &mut audit.findings);
        }
    }
    let turned = |a: Agreement| {
        a.coarse_rad.iter().flatten().any(|r| r.is_beyond(0.3, 0.0))
            || a.contrary().next().is_some()
    };
    if audit.kinematics.attitude.is_none_or(turned) {
        check_readings(flight, audit);
    }
    if audit.kinematics.position.is_none() {
        check_moving(flight, audit);
    }
    frames::check(flight, audit);
    check_force(flight, audit);
    check_voltage(flight, audit);
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Agreement {
    /// Axes that are certainly reversed.
    fn contrary(&self) -> impl Iterator<Item = &'static str> {
        let axes = AXES.into_iter().zip(self.scale);
        axes.filter(|(_, scale)| scale.is_some_and(|s| s.value < 0.0 && s.differs_from_zero(SURE)))
            .map(|(axis, _)| axis)
    }
}

impl Pair {
    /// Reports other axes, units or times than stated, and returns whether there are any.
    fn has_fault(&self, agreement: &Agreement, findings: &mut Vec<Finding>) -> bool {
        let Self { stream, other, fault, .. } = self;
        let finding = |check, found, expected, unit, what, advice| Finding {
            severity: Severity::Fault,
            check,
            stream: Some(*stream),
            found,
            expected,
            unit,
            what,
            advice,
        };
        let frames = "check the frames stated for the log";
        let contrary: Vec<&str> = agreement.contrary().collect();
        if !contrary.is_empty() {
            let what = if contrary.len() % 2 == 1 {
                format!(
                    "its axes and those of {other} differ in handedness: {} is reversed",
                    contrary.join(", ")
                )
            } else {
                format!("is reversed against {other} in {}", contrary.join(" and "))
            };
            findings.push(finding("axes", -1.0, 1.0, "", what, frames));
            return true;
        }
        let common = agreement.common_scale;
        let pace = agreement.pace.into_iter().fold(0.0, f64::max);
        if !UNIT.contains(&common.value) && fault.is_no_scale(&common, pace) {
            let what = format!(
                "changes {:.3} times as fast as {other} says{}",
                common.value,
                unit_of(common.value)
            );
            let advice = "check the units stated for the log";
            findings.push(finding("unit", common.value, 1.0, "", what, advice));
            return true;
        }
        let is_turned = |r: &Estimate| r.is_beyond(fault.rotation_rad, 0.0);
        if agreement.coarse_rad.iter().flatten().any(is_turned) {
            let [x, y, z] = agreement.coarse_rad.map(|r| r.map_or(0.0, |r| r.value));
            let angle = (x * x + y * y + z * z).sqrt();
            let what = format!(
                "is rotated against {other} by ({:.0}, {:.0}, {:.0}) degrees",
                x.to_degrees(),
                y.to_degrees(),
                z.to_degrees()
            );
            findings.push(finding("axes", angle, 0.0, "rad", what, frames));
            return true;
        }
        let own = AXES.into_iter().zip(agreement.scale).zip(agreement.pace);
        let scaled = own.filter_map(|((axis, scale), pace)| {
            let scale = scale?;
            fault.is_no_scale(&scale, pace).then_some((axis, scale))
        });
        let scaled: Vec<(&str, Estimate)> = scaled.collect();
        if let Some((_, worst)) = scaled.first() {
            let each = scaled.iter().map(|(axis, s)| format!("{:.2} in {axis}", s.value));
            let each = each.collect::<Vec<_>>().join(", ");
            let what = format!("changes at a different scale from {other}: {each}");
            let advice = "too much for a filter or a calibration error: check units and columns";
            findings.push(finding("scale", worst.value, 1.0, "", what, advice));
            return true;
        }
        let delay = agreement.worst_delay();
        if delay.is_beyond(fault.delay_s, 0.0) {
            let Estimate { value, half_width } = agreement.delay_s;
            let (ms, width) = (1e3 * value, 1e3 * half_width);
            let drift = agreement.drift.map_or(0.0, |drift| 100.0 * drift.value);
            let what = format!(
                "{ms:+.0} +- {width:.0} ms late against {other} in the middle of the log, drifting \
                 by {drift:+.2} %"
            );
            let advice = "no filter is this late: put both on one clock";
            findings.push(finding("delay", delay.value, 0.0, "s", what, advice));
            return true;
        }
        false
    }

    /// Reports delay, drift, rotation, scale and bias that are large enough and certain.
    fn report(&self, agreement: &Agreement, matters: &Matters, findings: &mut Vec<Finding>) {
        let Self { stream, other, .. } = self;
        let mut report = |check, found: f64, expected, unit, what: String, advice| {
            findings.push(Finding {
                severity: Severity::Measurement,
                check,
                stream: Some(*stream),
                found,
                expected,
                unit,
                what,
                advice,
            });
        };
        let is_significant =
            |e: &Estimate, limit: f64| e.value.abs() > limit && e.differs_from_zero(SURE);
        let delay = agreement.delay_s;
        if is_significant(&delay, matters.delay_s) {
            let (ms, width) = (1e3 * delay.value.abs(), 1e3 * delay.half_width);
            let side = if delay.value > 0.0 { "late" } else { "early" };
            let what = format!("{ms:.1} +- {width:.1} ms {side} against {other}");
            report(
                "delay",
                delay.value,
                0.0,
                "s",
                what,
                "shift the stream by this much before any fit",
            );
        }
        let span = agreement.span_s;
        let drift = agreement.drift.filter(|drift| is_significant(drift, DRIFT_S / span.max(1.0)));
        if let Some(drift) = drift {
            let what = format!(
                "its delay against {other} changes by {:.1} +- {:.1} ms within the log",
                1e3 * drift.value * span,
                1e3 * drift.half_width * span
            );
            let advice = "the two clocks run at different rates, or one stream was resampled";
            report("clock_drift", drift.value, 0.0, "", what, advice);
        }
        let shown = |of: [Option<Estimate>; 3]| {
            AXES.into_iter().zip(of).filter_map(|(axis, of)| Some((axis, of?)))
        };
        for (axis, estimate) in shown(agreement.rotation_rad) {
            if is_significant(&estimate, matters.rotation_rad) {
                let what = format!(
                    "rotated by {:.2} +- {:.2} degrees about {axis} against {other}",
                    estimate.value.to_degrees(),
                    estimate.half_width.to_degrees()
                );
                let advice = "an attitude trim or a mounting angle, not a force on the vehicle";
                report("rotation", estimate.value, 0.0, "rad", what, advice);
            }
        }
        for (axis, scale) in shown(agreement.scale) {
            let off = Estimate { value: scale.value - 1.0, ..scale };
            if is_significant(&off, matters.scale) {
                let what = format!(
                    "changes {:.3} +- {:.3} times as fast in {axis} as {other} says",
                    scale.value, scale.half_width
                );
                let advice = "a scale or a filter of one of the two, not physics";
                report("scale", scale.value, 1.0, "", what, advice);
            }
        }
        for (axis, estimate) in shown(agreement.bias) {
            if is_significant(&estimate, matters.bias) {
                let what = format!(
                    "{other} is off by {:.3} +- {:.3} {} in {axis}",
                    estimate.value, estimate.half_width, matters.unit
                );
                report("bias", estimate.value, 0.0, matters.unit, what, matters.advice);
            }
        }
    }
}

/// The likely cause of a scale.
fn unit_of(scale: f64) -> &'static str {
    let known = [
        (1f64.to_radians(), ": degrees for radians in the rates?"),
        (1f64.to_degrees(), ": degrees for radians in the angles?"),
        (1e3, ": one in mm, the other in m?"),
        (1e-3, ": one in mm, the other in m?"),
        (1e2, ": one in cm, the other in m?"),
        (1e-2, ": one in cm, the other in m?"),
        (9.8, ": an accelerometer in g?"),
    ];
    let near = |value: f64| (scale / value).ln().abs() < 0.25;
    known.into_iter().find(|(value, _)| near(*value)).map_or("", |(_, text)| text)
}

fn span_s(times: &[f64]) -> f64 {
    times.first().zip(times.last()).map_or(0.0, |(first, last)| last - first)
}

/// Reports quaternions in another direction or order, where they do not follow the gyro as stated.
fn check_readings(flight: &Flight, audit: &mut Audit) {
    if !is_logged(&flight.attitude) || !is_logged(&flight.body_rate) {
        return;
    }
    if turns(flight).is_none_or(|turns| turns.iter().any(|rate| *rate < TURNS)) {
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
        .filter_map(|(read, text)| Some((turning_explained(flight, read)?, text)))
        .filter(|(explained, _)| *explained > READS)
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let is_short = span_s(flight.attitude.times()) < SHORT_S;
    let (what, found) = match (found, turning_follows(flight)) {
        (Some((share, text)), _) => (format!("quaternions seem to be {text}"), share),
        // A log this short may not show it.
        (None, None) if is_short => return,
        (None, follows) => match follows.unwrap_or(0.0) {
            follows if follows < FOLLOWS => {
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
    let Some((follows, [seen, expected])) = moving_follows(flight) else { return };
    if seen.max(expected) < MOVES || follows >= FOLLOWS {
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
            "does not follow the velocity: it changes by {seen:.2} m/s, the velocity by \
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
    } else if !FORCE.contains(&size) {
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
