//! Checks motor outputs: valid values and stuck channels.

use super::tier::FAST_HZ;
use super::weak::median;
use super::{Audit, Finding, Severity};
use crate::log::import::{Flight, MotorUnit};

/// Rounding error of a fraction beyond 0..1.
const ROUNDING: f64 = 0.02;
/// Valid pulses, us, when outputs are pulses.
const PULSES: std::ops::RangeInclusive<f64> = 750.0..=2250.0;
/// Median above which outputs look like pulses.
const PULSE_MEDIAN_MIN: f64 = 500.0;
/// A channel is stuck if its spread is below this share of the largest one.
const SPREAD_SHARE_MIN: f64 = 1e-3;
/// Share of the samples at a limit above which saturation is reported.
const SATURATED_SHARE_MAX: f64 = 0.05;
/// Share of changing samples during motion below which outputs drive no motors.
const CHANGING_SHARE_MAX: f64 = 0.01;
/// Limits of roll and pitch rate or speed above which the vehicle moves, rad/s and m/s.
const ROTATION_RATE_MIN: f64 = 0.05;
const SPEED_MIN: f64 = 0.2;
/// Least time and number of samples in motion for a check, s.
const MOTION_MIN: f64 = 2.0;
const MOTION_SAMPLES: u32 = 20;
/// Mean output, as a share of the full range, below which the vehicle does not fly.
const FLYING_SHARE: f64 = 0.1;

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    if flight.outputs.is_empty() {
        return;
    }
    if has_still_outputs(flight, audit) {
        return;
    }
    check_range(flight, audit);
    check_channels(flight, audit);
    if let Some(rate) = audit.rates.outputs_hz.filter(|rate| *rate < FAST_HZ) {
        audit.findings.push(Finding {
            severity: Severity::Note,
            check: "slow_outputs",
            stream: Some("outputs"),
            found: rate,
            expected: FAST_HZ,
            unit: "Hz",
            what: format!(
                "outputs update at only {rate:.1} Hz: too slow to show lag, delay and inertia"
            ),
            advice: "log outputs at 50 Hz or more, by telemetry (SERVO_OUTPUT_RAW, ACTUATOR_OUTPUT_STATUS) or on board",
        });
    }
}

/// Whether outputs stand still while the vehicle moves. They are then not its motors', and the
/// other checks do not apply.
fn has_still_outputs(flight: &Flight, audit: &mut Audit) -> bool {
    let turns = flight.body_rate.map(|rate| {
        let [p, q, _] = rate.to_array();
        p.hypot(q) > ROTATION_RATE_MIN
    });
    let travels = flight.velocity.map(|velocity| velocity.norm() > SPEED_MIN);
    let in_motion =
        |time: f64| turns.held_at(time) == Some(&true) || travels.held_at(time) == Some(&true);
    let outputs = &flight.outputs;
    let (mut moving_s, mut count, mut changes) = (0.0, 0, 0);
    for (times, values) in outputs.times().windows(2).zip(outputs.values().windows(2)) {
        if in_motion(times[1]) && flight.in_air.held_at(times[1]) != Some(&false) {
            moving_s += times[1] - times[0];
            count += 1;
            changes += usize::from(values[0] != values[1]);
        }
    }
    let share = f64::from(changes as u32) / f64::from(count.max(1));
    if moving_s < MOTION_MIN || count < MOTION_SAMPLES || share > CHANGING_SHARE_MAX {
        return false;
    }
    let [a, b, c, d] = outputs.values().last().copied().unwrap_or_default();
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "still_outputs",
        stream: Some("outputs"),
        found: share,
        expected: CHANGING_SHARE_MAX,
        unit: "",
        what: format!(
            "all four stay at {a:.3}, {b:.3}, {c:.3}, {d:.3} for {moving_s:.1} s while the vehicle \
             moves"
        ),
        advice: "they do not drive this vehicle's motors: log the outputs of the device that does, \
                 and its functions",
    });
    true
}

/// The valid range of outputs in their unit; `None` where it takes a vehicle file to know.
fn valid_range(flight: &Flight) -> Option<(f64, f64, &'static str)> {
    match flight.motor_unit {
        MotorUnit::ThrustFraction => Some((-ROUNDING, 1.0 + ROUNDING, "")),
        MotorUnit::Newton => Some((-ROUNDING, f64::INFINITY, "N")),
        MotorUnit::VehicleFile if flight.outputs.is_empty() => None,
        MotorUnit::VehicleFile => {
            let all = flight.outputs.values().iter().flatten().copied().collect();
            (median(all) > PULSE_MEDIAN_MIN).then_some((*PULSES.start(), *PULSES.end(), "us"))
        }
    }
}

fn check_range(flight: &Flight, audit: &mut Audit) {
    let Some((low, high, unit)) = valid_range(flight) else { return };
    // A pulse of 0 means that the motor is off.
    let is_valid = |u: f64| (low..=high).contains(&u) || u == 0.0;
    let wrong = flight.outputs.values().iter().filter(|u| !u.iter().all(|u| is_valid(*u)));
    let (count, worst) = wrong.fold((0_usize, 0.0_f64), |(count, worst), outputs| {
        let beyond = |u: f64| (u - high).max(low - u);
        let own = outputs.iter().copied().max_by(|a, b| beyond(*a).total_cmp(&beyond(*b)));
        let own = own.unwrap_or(0.0);
        (count + 1, if beyond(own) > beyond(worst) || count == 0 { own } else { worst })
    });
    if count == 0 {
        return;
    }
    let share = count as f64 / flight.outputs.len() as f64;
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "illegal_output",
        stream: Some("outputs"),
        found: worst,
        expected: if worst > high { high } else { low },
        unit,
        what: format!(
            "{:.1} % of the samples have a motor outside {low:.2} to {high:.2} {unit}, at worst \
             {worst:.2}",
            100.0 * share
        ),
        advice: "the stated unit or range is wrong, or rows are damaged",
    });
}

fn check_channels(flight: &Flight, audit: &mut Audit) {
    // In flight, according to the outputs themselves.
    let values = flight.outputs.values();
    let top = values.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
    let bottom = values.iter().flatten().copied().fold(f64::INFINITY, f64::min);
    let floor = bottom + FLYING_SHARE * (top - bottom);
    let flying: Vec<&[f64; 4]> =
        values.iter().filter(|u| u.iter().sum::<f64>() > 4.0 * floor).collect();
    if flying.len() < 50 || top <= bottom {
        return;
    }
    let count = flying.len() as f64;
    let spread: [f64; 4] = std::array::from_fn(|i| {
        let mean = flying.iter().map(|u| u[i]).sum::<f64>() / count;
        (flying.iter().map(|u| (u[i] - mean).powi(2)).sum::<f64>() / count).sqrt()
    });
    let widest = spread.iter().copied().fold(0.0, f64::max);
    for (motor, spread) in spread.into_iter().enumerate() {
        if spread < SPREAD_SHARE_MIN * widest {
            audit.findings.push(Finding {
                severity: Severity::Fault,
                check: "stuck_output",
                stream: Some("outputs"),
                found: spread,
                expected: widest,
                unit: "",
                what: format!("output {} stays constant while the others change", motor + 1),
                advice: "the channel does not drive a motor, or was not logged: check the order of \
                         the outputs",
            });
        }
    }
    if flight.motor_unit != MotorUnit::ThrustFraction {
        return;
    }
    let limits =
        flying.iter().filter(|u| u.iter().any(|u| !(1e-3..1.0 - 1e-3).contains(u))).count();
    let share = limits as f64 / count;
    if share > SATURATED_SHARE_MAX {
        audit.findings.push(Finding {
            severity: Severity::Note,
            check: "saturation",
            stream: Some("outputs"),
            found: share,
            expected: SATURATED_SHARE_MAX,
            unit: "",
            what: format!("a motor is at its limit in {:.0} % of the samples", 100.0 * share),
            advice: "there the logged output is not the command; fly more gently to identify the \
                     plant",
        });
    }
}
