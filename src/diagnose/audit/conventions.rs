//! Units, axes and orders, by how streams fit each other; and delays, rotations and biases.

use sitl::frame::Attitude;

use super::kinematics::{Agreement, Estimate, Reading, turning_explained, turning_follows, turns};
use super::timing::is_logged;
use super::{Audit, Finding, Severity};
use crate::diagnose::series::median;
use crate::log::import::Flight;

/// Rates, root mean square, at which a turning vehicle shows whether its attitude follows, rad/s.
const TURNS: f64 = 0.2;
/// A reading that explains this much where the stated one fails is the right one.
const READS: f64 = 0.8;
/// Less than this is no following at all, but other motion.
const FOLLOWS: f64 = 0.3;
/// Where a shorter log does not show whether it does, that is no fault, s.
const SHORT_S: f64 = 10.0;
/// Rotations between streams beyond this are other axes, not a mounting, rad.
const OTHER_AXES: f64 = 0.3;
/// Scales beyond these are other units.
const UNIT: std::ops::Range<f64> = 0.5..2.0;
/// How sure a value must be to be told: this many times its interval. With little motion, noise
/// that the vehicle's own loop answers looks like a delay or a rotation.
const SURE: f64 = 3.0;
/// For the same reason a delay must be longer by this much if nothing is explained, s.
const NOISE_DELAY: f64 = 0.05;
/// Delays that matter: between attitude and gyro, position and velocity, velocity and
/// accelerometer, s.
const DELAY: [f64; 3] = [0.004, 0.006, 0.008];
/// Change of a delay within a log that matters, s.
const DRIFT: f64 = 0.015;
/// Rotations that matter, rad: the estimates of position and velocity, and the heading against the
/// accelerometer, show theirs less sharply.
const ROTATION: [f64; 3] = [0.006, 0.02, 0.05];
/// Biases that matter: gyro rad/s, velocity m/s, accelerometer m/s^2.
const BIAS: [f64; 3] = [0.02, 0.05, 0.15];
/// Specific forces of a vehicle that flies or stands, m/s^2.
const FORCE: std::ops::Range<f64> = 7.0..13.0;

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    let pairs = [
        ("attitude", "the gyro", audit.kinematics.attitude),
        ("position", "the velocity", audit.kinematics.position),
        ("velocity", "the accelerometer", audit.kinematics.velocity),
    ];
    for (at, (stream, other, agreement)) in pairs.into_iter().enumerate() {
        if let Some(agreement) = agreement {
            let pair = Pair { at, stream, other, agreement };
            if !pair.check_axes(audit) {
                pair.check_numbers(audit);
            }
        }
    }
    if audit.kinematics.attitude.is_none_or(|a| a.is_mirrored || a.angle().value > OTHER_AXES) {
        check_readings(flight, audit);
    }
    check_force(flight, audit);
    check_voltage(flight, audit);
}

impl Agreement {
    /// Angle of the rotation as far as it is shown, rad, and its interval.
    fn angle(&self) -> Estimate {
        let shown = || self.rotation_rad.iter().flatten();
        Estimate {
            value: shown().map(|r| r.value.powi(2)).sum::<f64>().sqrt(),
            half_width: shown().map(|r| r.half_width.powi(2)).sum::<f64>().sqrt(),
        }
    }
}

/// One of the pairs.
struct Pair {
    at: usize,
    stream: &'static str,
    other: &'static str,
    agreement: Agreement,
}

impl Pair {
    /// Other axes or units than stated. Returns whether there are.
    fn check_axes(&self, audit: &mut Audit) -> bool {
        let Self { stream, other, agreement, .. } = self;
        let finding = |check, found, expected, unit, what, advice| Finding {
            severity: Severity::Fault,
            check,
            stream: Some(stream),
            found,
            expected,
            unit,
            what,
            advice,
        };
        if agreement.is_mirrored {
            audit.findings.push(finding(
                "axes",
                -1.0,
                1.0,
                "",
                format!("its axes are of another handedness than those of {other}"),
                "one axis has the wrong sign: check the frames that the log was said to have",
            ));
            return true;
        }
        if !UNIT.contains(&agreement.scale) {
            audit.findings.push(finding(
                "unit",
                agreement.scale,
                1.0,
                "",
                format!(
                    "changes {:.3} times as fast as {other} says{}",
                    agreement.scale,
                    unit_of(agreement.scale)
                ),
                "check the units that the log was said to have",
            ));
            return true;
        }
        // Of the accelerometer only the heading is looked for.
        let angle = agreement.angle();
        if angle.value > OTHER_AXES && angle.differs_from_zero(SURE) {
            let [x, y, z] = agreement.rotation_rad.map(|r| r.map_or(0.0, |r| r.value.to_degrees()));
            audit.findings.push(finding(
                "axes",
                angle.value,
                0.0,
                "rad",
                format!("is turned against {other} by ({x:.0}, {y:.0}, {z:.0}) degrees"),
                "check the frames that the log was said to have",
            ));
            return true;
        }
        false
    }

    /// Delay, rotation and bias that matter and are sure.
    fn check_numbers(&self, audit: &mut Audit) {
        let Self { at, stream, other, agreement } = self;
        let mut tell = |check, estimate: Estimate, unit, what: String, advice| {
            audit.findings.push(Finding {
                severity: Severity::Measurement,
                check,
                stream: Some(stream),
                found: estimate.value,
                expected: 0.0,
                unit,
                what,
                advice,
            });
        };
        let matters = |e: &Estimate, limit: f64| e.value.abs() > limit && e.differs_from_zero(SURE);
        let noise = NOISE_DELAY * (1.0 - agreement.explained);
        let lasts =
            |e: &Estimate, limit: f64| e.value.abs() > limit + noise && e.differs_from_zero(SURE);
        let delay = agreement.delay_s;
        if lasts(&delay, DELAY[*at]) {
            let (ms, width) = (1e3 * delay.value.abs(), 1e3 * delay.half_width);
            let side = if delay.value > 0.0 { "late" } else { "early" };
            let what = format!("{ms:.1} +- {width:.1} ms {side} against {other}");
            tell("delay", delay, "s", what, "shift the stream by as much before any fit");
        }
        if let Some(drift) = agreement.delay_drift_s.filter(|drift| lasts(drift, DRIFT)) {
            let what = format!(
                "its delay against {other} changes by {:.1} +- {:.1} ms within the log",
                1e3 * drift.value,
                1e3 * drift.half_width
            );
            tell(
                "clock_drift",
                drift,
                "s",
                what,
                "the two are on clocks of different rates, or one was resampled",
            );
        }
        let shown = |of: [Option<Estimate>; 3]| {
            ["x", "y", "z"].into_iter().zip(of).filter_map(|(axis, of)| Some((axis, of?)))
        };
        for (axis, estimate) in shown(agreement.rotation_rad) {
            if matters(&estimate, ROTATION[*at]) {
                let what = format!(
                    "turned by {:.2} +- {:.2} degrees about {axis} against {other}",
                    estimate.value.to_degrees(),
                    estimate.half_width.to_degrees()
                );
                tell(
                    "rotation",
                    estimate,
                    "rad",
                    what,
                    "a trim of the attitude or a mounting: no force of the vehicle",
                );
            }
        }
        let (unit, advice) = [
            ("rad/s", "the gyro's bias: subtract it"),
            ("m/s", "position and velocity are of different estimates"),
            (
                "m/s^2",
                "the accelerometer's bias, or a tilt of the reported attitude that the gyro does not show (0.17 m/s^2 a degree)",
            ),
        ][*at];
        for (axis, estimate) in shown(agreement.bias) {
            if matters(&estimate, BIAS[*at]) {
                let what = format!(
                    "{other} is off by {:.3} +- {:.3} {unit} in {axis}",
                    estimate.value, estimate.half_width
                );
                tell("bias", estimate, unit, what, advice);
            }
        }
    }
}

/// What a scale may come from.
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

/// Quaternions read in another direction or order, where they do not turn by the gyro as stated.
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
        // So short a log may not show it.
        (None, None) if is_short => return,
        (None, follows) => match follows.unwrap_or(0.0) {
            follows if follows < FOLLOWS => ("does not turn as the gyro says".to_owned(), follows),
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
        advice: "check order, direction and frames of the attitude, and that both are of one vehicle",
    });
}

/// Gravity is in every specific force: its size tells the unit, its direction the axes.
fn check_force(flight: &Flight, audit: &mut Audit) {
    if !is_logged(&flight.specific_force) {
        return;
    }
    let forces = flight.specific_force.values();
    let size = median(forces.iter().map(|f| f.norm()).collect());
    let down = median(forces.iter().map(|f| f.to_array()[2]).collect());
    let mut tell = |found: f64, expected: f64, what: String| {
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
        tell(size, 9.8, format!("its median size is {size:.2}: in g?"));
    } else if size < 3.0 {
        tell(size, 9.8, format!("its median size is {size:.2}: was gravity removed?"));
    } else if !FORCE.contains(&size) {
        tell(size, 9.8, format!("its median size is {size:.2}"));
    } else if down > 3.0 {
        tell(down, -9.8, format!("it points down ({down:.2}): are its axes front, left, up?"));
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
        what: format!("at most {highest:.2} V, as no pack of a quadrotor has"),
        advice: "check the unit, millivolts perhaps",
    });
}
