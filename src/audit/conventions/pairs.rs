//! The pairs of streams with the limits of their differences, and the findings where an agreement
//! exceeds them.

use crate::audit::agreement::{Agreement, Estimate};
use crate::audit::alignment::{POSE_MIN_S, VELOCITY_MIN_S};
use crate::audit::{Audit, Finding, Severity};

/// Scales outside this range come from another unit.
const SCALE_WITHIN_UNIT: std::ops::Range<f64> = 0.5..2.0;
/// Intervals by which a value must differ from zero to be reported.
const CERTAIN_INTERVALS: f64 = 3.0;

/// Two streams with the differences that they may have.
pub(super) struct CheckedPair {
    stream: &'static str,
    other: &'static str,
    pub agreement: Option<Agreement>,
    /// Limits for reports; `None` where the pair is only accurate enough to find faults.
    pub report: Option<ReportLimits>,
    /// Limits beyond any trim, filter, calibration or mounting.
    fault: FaultLimits,
}

/// Least values that are reported.
pub(super) struct ReportLimits {
    delay_s: f64,
    rotation_rad: f64,
    scale: f64,
    bias: f64,
    /// Unit of the bias, and advice on it.
    unit: &'static str,
    advice: &'static str,
}

/// Largest plausible values.
struct FaultLimits {
    /// Estimates are late by up to 0.08 s, those of a satellite receiver by 0.25 s.
    delay_s: f64,
    /// Trims and mountings are off by a few degrees, a compass by 15.
    rotation_rad: f64,
    /// Sensors' scales are off by up to 3 %, estimators' velocities by up to 12 %.
    scale: f64,
    /// Whether both streams are estimates that the vehicle's loop follows: it turns their errors
    /// into motion, which then looks like motion along another axis.
    are_followed: bool,
}

impl FaultLimits {
    /// Whether a rotation is certainly beyond trims and mountings, where the fit leaves a share of
    /// the motion across its axis unexplained.
    fn is_implausible_rotation(&self, angle: &Estimate, unexplained: f64) -> bool {
        let noise_rad = if self.are_followed { unexplained } else { 0.0 };
        angle.is_beyond(self.rotation_rad + noise_rad, 0.0)
    }

    /// Whether a scale is certainly beyond sensors and filters. A filter as slow as the largest
    /// delay attenuates changes at `pace`, 1/s.
    fn is_implausible_scale(&self, scale: &Estimate, pace: f64) -> bool {
        let filtered = 1.0 / (self.delay_s * pace).hypot(1.0);
        let (low, high) = (1.0 - self.scale, 1.0 + self.scale);
        let reach = CERTAIN_INTERVALS * scale.half_width;
        scale.value - reach > high || scale.value + reach < low * filtered
    }
}

/// Change of a delay within a log that is reported, s.
const DRIFT_S: f64 = 0.015;

/// Every pair of a flight.
pub(super) fn pairs(audit: &Audit) -> [CheckedPair; 5] {
    let kinematics = &audit.kinematics;
    [
        CheckedPair {
            stream: "attitude",
            other: "the gyro",
            agreement: kinematics.attitude,
            report: Some(ReportLimits {
                delay_s: POSE_MIN_S,
                rotation_rad: 0.006,
                scale: 0.03,
                bias: 0.02,
                unit: "rad/s",
                advice: "the gyro's bias: subtract it",
            }),
            fault: FaultLimits {
                delay_s: 0.15,
                rotation_rad: 0.3,
                scale: 0.3,
                are_followed: false,
            },
        },
        CheckedPair {
            stream: "position",
            other: "the velocity",
            agreement: kinematics.position,
            report: Some(ReportLimits {
                delay_s: 0.006,
                rotation_rad: 0.02,
                scale: 0.03,
                bias: 0.05,
                unit: "m/s",
                advice: "position and velocity come from different estimates",
            }),
            fault: FaultLimits { delay_s: 0.15, rotation_rad: 0.3, scale: 0.3, are_followed: true },
        },
        CheckedPair {
            stream: "velocity",
            other: "the accelerometer",
            agreement: kinematics.velocity,
            report: Some(ReportLimits {
                delay_s: VELOCITY_MIN_S,
                rotation_rad: 0.05,
                scale: 0.03,
                bias: 0.15,
                unit: "m/s^2",
                advice: "the accelerometer's bias, or a tilt of the reported attitude that the gyro does not show (0.17 m/s^2 a degree)",
            }),
            fault: FaultLimits { delay_s: 0.3, rotation_rad: 0.3, scale: 0.3, are_followed: false },
        },
        CheckedPair {
            stream: "velocity",
            other: "the lean",
            agreement: kinematics.lean,
            report: None,
            fault: FaultLimits {
                delay_s: f64::INFINITY,
                rotation_rad: 0.5,
                scale: 1.0,
                are_followed: false,
            },
        },
        CheckedPair {
            stream: "attitude",
            other: "its setpoint",
            agreement: kinematics.setpoint,
            report: None,
            fault: FaultLimits {
                delay_s: f64::INFINITY,
                rotation_rad: 0.7,
                scale: f64::INFINITY,
                are_followed: false,
            },
        },
    ]
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Agreement {
    /// Axes that are certainly reversed.
    pub(super) fn reversed_axes(&self) -> impl Iterator<Item = &'static str> {
        let axes = AXES.into_iter().zip(self.scale);
        axes.filter(|(_, scale)| {
            scale.is_some_and(|s| s.value < 0.0 && s.differs_from_zero(CERTAIN_INTERVALS))
        })
        .map(|(axis, _)| axis)
    }
}

/// Advice for axes that contradict the stated ones.
const CHECK_FRAMES: &str = "check the frames stated for the log";

impl CheckedPair {
    /// Reports other axes, units or times than stated, and returns whether there are any.
    pub fn has_fault(&self, agreement: &Agreement, findings: &mut Vec<Finding>) -> bool {
        let fault = self
            .reversed_axes(agreement)
            .or_else(|| self.another_unit(agreement))
            .or_else(|| self.rotated_axes(agreement))
            .or_else(|| self.implausible_scale(agreement))
            .or_else(|| self.implausible_delay(agreement));
        let has_fault = fault.is_some();
        findings.extend(fault);
        has_fault
    }

    /// A finding of the stream.
    fn finding(&self, severity: Severity, check: &'static str, measured: Measured) -> Finding {
        let Measured { found, expected, unit, what, advice } = measured;
        Finding { severity, check, stream: Some(self.stream), found, expected, unit, what, advice }
    }

    fn reversed_axes(&self, agreement: &Agreement) -> Option<Finding> {
        let other = self.other;
        let reversed: Vec<&str> = agreement.reversed_axes().collect();
        if reversed.is_empty() {
            return None;
        }
        let what = if reversed.len() % 2 == 1 {
            format!(
                "its axes and those of {other} differ in handedness: {} is reversed",
                reversed.join(", ")
            )
        } else {
            format!("is reversed against {other} in {}", reversed.join(" and "))
        };
        let measured =
            Measured { found: -1.0, expected: 1.0, unit: "", what, advice: CHECK_FRAMES };
        Some(self.finding(Severity::Fault, "axes", measured))
    }

    fn another_unit(&self, agreement: &Agreement) -> Option<Finding> {
        let common = agreement.common_scale;
        let pace = agreement.pace.into_iter().fold(0.0, f64::max);
        if SCALE_WITHIN_UNIT.contains(&common.value)
            || !self.fault.is_implausible_scale(&common, pace)
        {
            return None;
        }
        let what = format!(
            "changes {:.3} times as fast as {} says{}",
            common.value,
            self.other,
            unit_of(common.value)
        );
        let advice = "check the units stated for the log";
        let measured = Measured { found: common.value, expected: 1.0, unit: "", what, advice };
        Some(self.finding(Severity::Fault, "unit", measured))
    }

    fn rotated_axes(&self, agreement: &Agreement) -> Option<Finding> {
        let mut angles = agreement.coarse_rad.into_iter().zip(agreement.coarse_unexplained);
        let is_rotated = |(angle, unexplained): (Option<Estimate>, f64)| {
            angle.is_some_and(|angle| self.fault.is_implausible_rotation(&angle, unexplained))
        };
        if !angles.any(is_rotated) {
            return None;
        }
        let [x, y, z] = agreement.coarse_rad.map(|r| r.map_or(0.0, |r| r.value));
        let angle = (x * x + y * y + z * z).sqrt();
        let what = format!(
            "is rotated against {} by ({:.0}, {:.0}, {:.0}) degrees",
            self.other,
            x.to_degrees(),
            y.to_degrees(),
            z.to_degrees()
        );
        let measured =
            Measured { found: angle, expected: 0.0, unit: "rad", what, advice: CHECK_FRAMES };
        Some(self.finding(Severity::Fault, "axes", measured))
    }

    fn implausible_scale(&self, agreement: &Agreement) -> Option<Finding> {
        let axes = AXES.into_iter().zip(agreement.scale).zip(agreement.pace);
        let scaled = axes.filter_map(|((axis, scale), pace)| {
            let scale = scale?;
            self.fault.is_implausible_scale(&scale, pace).then_some((axis, scale))
        });
        let scaled: Vec<(&str, Estimate)> = scaled.collect();
        let (_, first) = scaled.first()?;
        let each = scaled.iter().map(|(axis, s)| format!("{:.2} in {axis}", s.value));
        let each = each.collect::<Vec<_>>().join(", ");
        let what = format!("changes at a different scale from {}: {each}", self.other);
        let advice = "too much for a filter or a calibration error: check units and columns";
        let measured = Measured { found: first.value, expected: 1.0, unit: "", what, advice };
        Some(self.finding(Severity::Fault, "scale", measured))
    }

    fn implausible_delay(&self, agreement: &Agreement) -> Option<Finding> {
        let delay = agreement.worst_delay();
        if !delay.is_beyond(self.fault.delay_s, 0.0) {
            return None;
        }
        let Estimate { value, half_width } = agreement.delay_s;
        let (ms, width) = (1e3 * value, 1e3 * half_width);
        let drift = agreement.drift.map_or(0.0, |drift| 100.0 * drift.value);
        let what = format!(
            "{ms:+.0} +- {width:.0} ms late against {} in the middle of the log, drifting by \
             {drift:+.2} %",
            self.other
        );
        let advice = "no filter is this late: put both on one clock";
        let measured = Measured { found: delay.value, expected: 0.0, unit: "s", what, advice };
        Some(self.finding(Severity::Fault, "delay", measured))
    }

    /// Reports delay, drift, rotation, scale and bias that are large enough and certain.
    pub fn report(
        &self,
        agreement: &Agreement,
        limits: &ReportLimits,
        findings: &mut Vec<Finding>,
    ) {
        let measurement = |check, measured| self.finding(Severity::Measurement, check, measured);
        findings.extend(self.late(agreement, limits).map(|m| measurement("delay", m)));
        findings.extend(self.drifting(agreement).map(|m| measurement("clock_drift", m)));
        for (axis, rotation) in by_axis(agreement.rotation_rad) {
            let rotated = self.rotated(axis, rotation, limits);
            findings.extend(rotated.map(|m| measurement("rotation", m)));
        }
        for (axis, scale) in by_axis(agreement.scale) {
            findings.extend(self.scaled(axis, scale, limits).map(|m| measurement("scale", m)));
        }
        for (axis, bias) in by_axis(agreement.bias) {
            findings.extend(self.biased(axis, bias, limits).map(|m| measurement("bias", m)));
        }
    }

    fn late(&self, agreement: &Agreement, limits: &ReportLimits) -> Option<Measured> {
        let delay = agreement.delay_s;
        let (ms, width) = (1e3 * delay.value.abs(), 1e3 * delay.half_width);
        let side = if delay.value > 0.0 { "late" } else { "early" };
        is_significant(&delay, limits.delay_s).then(|| Measured {
            found: delay.value,
            expected: 0.0,
            unit: "s",
            what: format!("{ms:.1} +- {width:.1} ms {side} against {}", self.other),
            advice: "shift the stream by this much before any fit",
        })
    }

    fn drifting(&self, agreement: &Agreement) -> Option<Measured> {
        let span = agreement.span_s;
        let drift =
            agreement.drift.filter(|drift| is_significant(drift, DRIFT_S / span.max(1.0)))?;
        Some(Measured {
            found: drift.value,
            expected: 0.0,
            unit: "",
            what: format!(
                "its delay against {} changes by {:.1} +- {:.1} ms within the log",
                self.other,
                1e3 * drift.value * span,
                1e3 * drift.half_width * span
            ),
            advice: "the two clocks run at different rates, or one stream was resampled",
        })
    }

    fn rotated(&self, axis: &str, angle: Estimate, limits: &ReportLimits) -> Option<Measured> {
        is_significant(&angle, limits.rotation_rad).then(|| Measured {
            found: angle.value,
            expected: 0.0,
            unit: "rad",
            what: format!(
                "rotated by {:.2} +- {:.2} degrees about {axis} against {}",
                angle.value.to_degrees(),
                angle.half_width.to_degrees(),
                self.other
            ),
            advice: "an attitude trim or a mounting angle, not a force on the vehicle",
        })
    }

    fn scaled(&self, axis: &str, scale: Estimate, limits: &ReportLimits) -> Option<Measured> {
        let off = Estimate { value: scale.value - 1.0, ..scale };
        is_significant(&off, limits.scale).then(|| Measured {
            found: scale.value,
            expected: 1.0,
            unit: "",
            what: format!(
                "changes {:.3} +- {:.3} times as fast in {axis} as {} says",
                scale.value, scale.half_width, self.other
            ),
            advice: "a scale or a filter of one of the two, not physics",
        })
    }

    fn biased(&self, axis: &str, bias: Estimate, limits: &ReportLimits) -> Option<Measured> {
        let ReportLimits { unit, advice, .. } = *limits;
        is_significant(&bias, limits.bias).then(|| Measured {
            found: bias.value,
            expected: 0.0,
            unit,
            what: format!(
                "{} is off by {:.3} +- {:.3} {unit} in {axis}",
                self.other, bias.value, bias.half_width
            ),
            advice,
        })
    }
}

/// What a check measured, for its finding.
struct Measured {
    found: f64,
    expected: f64,
    unit: &'static str,
    what: String,
    advice: &'static str,
}

/// Whether a value is large enough to be reported, and certain.
fn is_significant(estimate: &Estimate, limit: f64) -> bool {
    estimate.value.abs() > limit && estimate.differs_from_zero(CERTAIN_INTERVALS)
}

/// The estimates that the motion shows, with their axes.
fn by_axis(estimates: [Option<Estimate>; 3]) -> impl Iterator<Item = (&'static str, Estimate)> {
    AXES.into_iter().zip(estimates).filter_map(|(axis, estimate)| Some((axis, estimate?)))
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
