//! Checks for values that repeat, jump, or are impossible.

use vehicle::frame::{Frd, Ned};

use super::{Audit, Finding, Severity, UnusableSpan};
use crate::log::import::{Flight, Stream};

/// Name of the check for a stream that stands still for some time.
pub(super) const STOOD_STILL: &str = "frozen";

/// Share of repeated samples that is reported.
const REPEATED_NOTE: f64 = 0.05;
/// Time without change during motion after which a stream counts as frozen, s.
const FROZEN_S: f64 = 0.4;
/// Limits of body rate and speed above which the vehicle moves, rad/s and m/s.
const ROTATION_RATE_MIN: f64 = 0.08;
const SPEED_MIN: f64 = 0.15;
/// Steps that no motion explains: position m, velocity m/s, attitude rad.
const POSITION_STEP: f64 = 0.3;
const VELOCITY_STEP: f64 = 0.8;
const ATTITUDE_STEP: f64 = 0.15;
/// Largest acceleration of a quadrotor, m/s^2.
const ACCELERATION_MAX: f64 = 40.0;
/// Longest pause over which steps are checked, s.
const STEP_PAUSE: f64 = 0.3;
/// Least time over which a speed follows from two positions, s: stamps are uneven.
const PACE_S: f64 = 0.1;
/// Largest values that a quadrotor's sensors measure: rad/s, m/s^2, m/s, m.
const RATE_MAX: f64 = 50.0;
const FORCE_MAX: f64 = 400.0;
const SPEED_MAX: f64 = 150.0;
const POSITION_MAX: f64 = 1e5;

/// `fresh` is the flight without repeated values: where a slow source holds a value, the next is a
/// step.
pub(super) fn check(flight: &Flight, fresh: &Flight, audit: &mut Audit) {
    let bits = |v: [f64; 3]| v.map(f64::to_bits).to_vec();
    let ned = |v: &Ned| bits(v.to_array());
    let frd = |v: &Frd| bits(v.to_array());
    repeated(flight, audit, "attitude", &flight.attitude, |q| {
        [q.w, q.x, q.y, q.z].map(f64::to_bits).to_vec()
    });
    repeated(flight, audit, "position", &flight.position, ned);
    repeated(flight, audit, "velocity", &flight.velocity, ned);
    repeated(flight, audit, "body_rate", &flight.body_rate, frd);
    repeated(flight, audit, "specific_force", &flight.specific_force, frd);
    steps(fresh, audit);
    let size = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    impossible(audit, "body_rate", &flight.body_rate, RATE_MAX, "rad/s", |v| size(v.to_array()));
    impossible(audit, "specific_force", &flight.specific_force, FORCE_MAX, "m/s^2", |v| {
        size(v.to_array())
    });
    impossible(audit, "velocity", &flight.velocity, SPEED_MAX, "m/s", |v| size(v.to_array()));
    impossible(audit, "position", &flight.position, POSITION_MAX, "m", |v| size(v.to_array()));
    // Where a velocity is logged, the position is compared with it.
    if flight.velocity.is_empty() {
        impossible(audit, "position", &paces(&flight.position), SPEED_MAX, "m/s", |v| *v);
    }
}

/// Mean speed from each position to the first that is later by [`PACE_S`], m/s.
fn paces(position: &Stream<Ned>) -> Stream<f64> {
    let mut paces = Stream::default();
    let mut ends = position.iter().peekable();
    for (from, start) in position.iter() {
        while ends.next_if(|(to, _)| to - from < PACE_S).is_some() {}
        let Some((to, end)) = ends.peek() else { break };
        paces.push(from, (**end - *start).norm() / (to - from));
    }
    paces
}

/// Mean size of a stream within a time.
fn mean_size<T>(stream: &Stream<T>, from: f64, to: f64, size: impl Fn(&T) -> f64) -> f64 {
    let first = stream.times().partition_point(|t| *t < from);
    let last = stream.times().partition_point(|t| *t <= to);
    let values = stream.values().get(first..last).unwrap_or_default();
    values.iter().map(size).sum::<f64>() / (values.len() as f64).max(1.0)
}

/// Reports samples with the bits of the one before, and marks the times in which a stream stands
/// still while others show motion.
fn repeated<T>(
    flight: &Flight,
    audit: &mut Audit,
    name: &'static str,
    stream: &Stream<T>,
    bits: impl Fn(&T) -> Vec<u64>,
) {
    if !super::timing::is_logged(stream) {
        return;
    }
    // According to streams other than the one in question.
    let moves = |from: f64, to: f64| {
        name != "body_rate"
            && mean_size(&flight.body_rate, from, to, |w| w.norm()) > ROTATION_RATE_MIN
            || name != "velocity" && mean_size(&flight.velocity, from, to, |v| v.norm()) > SPEED_MIN
    };
    let times = stream.times();
    let (mut same, mut frozen) = (0_usize, Vec::new());
    let mut start = 0;
    let mut before: Option<Vec<u64>> = None;
    for (at, value) in stream.values().iter().enumerate() {
        let now = bits(value);
        let is_same = before.as_ref() == Some(&now);
        same += usize::from(is_same);
        let is_last = at + 1 == stream.len();
        if !is_same || is_last {
            let end = if is_same { at } else { at.saturating_sub(1) };
            let few = end <= start + 2;
            if !few && times[end] - times[start] > FROZEN_S && moves(times[start], times[end]) {
                frozen.push((times[start], times[end]));
            }
            start = at;
        }
        before = Some(now);
    }
    let share = same as f64 / stream.len() as f64;
    let stopped: f64 = frozen.iter().map(|(from, to)| to - from).sum();
    for (from_s, to_s) in &frozen {
        let (from_s, to_s) = (*from_s, *to_s);
        audit.unusable.push(UnusableSpan { stream: name, from_s, to_s, reason: STOOD_STILL });
    }
    if !frozen.is_empty() {
        audit.findings.push(Finding {
            severity: Severity::Fault,
            check: STOOD_STILL,
            stream: Some(name),
            found: stopped,
            expected: 0.0,
            unit: "s",
            what: format!(
                "freezes {} times, {stopped:.2} s in all, while the vehicle moves",
                frozen.len()
            ),
            advice: "exclude these times; look for an estimator or a sensor that stopped",
        });
    } else if share > REPEATED_NOTE {
        let rate = stream.rate() * (1.0 - share);
        audit.findings.push(Finding {
            severity: Severity::Note,
            check: "repeated",
            stream: Some(name),
            found: share,
            expected: 0.0,
            unit: "",
            what: format!(
                "{:.0} % of the samples repeat the one before: the source runs at about {rate:.0} Hz",
                100.0 * share
            ),
            advice: "do not rely on the logged rate",
        });
    }
}

/// Steps between neighbours that the motion does not explain: resets of an estimate, or damage.
fn steps(flight: &Flight, audit: &mut Audit) {
    let position = steps_of(&flight.position, |a, b, from, to| {
        let pace = flight.velocity.held_at(from).copied().zip(flight.velocity.held_at(to).copied());
        let (v, w) = pace?;
        Some(((*b - *a) - (v + w) * (0.5 * (to - from))).norm() - POSITION_STEP)
    });
    report(audit, "position", "m", POSITION_STEP, position);
    let velocity = steps_of(&flight.velocity, |a, b, from, to| {
        Some((*b - *a).norm() - ACCELERATION_MAX * (to - from) - VELOCITY_STEP)
    });
    report(audit, "velocity", "m/s", VELOCITY_STEP, velocity);
    let attitude = steps_of(&flight.attitude, |a, b, from, to| {
        let rates = flight.body_rate.held_at(from).zip(flight.body_rate.held_at(to));
        let fastest = rates.map_or(RATE_MAX, |(a, b)| a.norm().max(b.norm()));
        Some(a.angle_to(*b) - 1.5 * fastest * (to - from) - ATTITUDE_STEP)
    });
    report(audit, "attitude", "rad", ATTITUDE_STEP, attitude);
}

/// Steps beyond the limit: start, end, and excess.
fn steps_of<T>(
    stream: &Stream<T>,
    excess: impl Fn(&T, &T, f64, f64) -> Option<f64>,
) -> Vec<(f64, f64, f64)> {
    let pairs = stream.times().windows(2).zip(stream.values().windows(2));
    pairs
        .filter(|(times, _)| times[1] - times[0] < STEP_PAUSE)
        .filter_map(|(times, values)| {
            let excess = excess(&values[0], &values[1], times[0], times[1])?;
            (excess > 0.0).then_some((times[0], times[1], excess))
        })
        .collect()
}

/// Reports steps that exceed `allowed`, in `unit`, and marks their times as unusable.
fn report(
    audit: &mut Audit,
    name: &'static str,
    unit: &'static str,
    allowed: f64,
    steps: Vec<(f64, f64, f64)>,
) {
    let Some(most) = steps.iter().map(|(.., excess)| *excess).reduce(f64::max) else { return };
    for (from_s, to_s, _) in &steps {
        let (from_s, to_s) = (*from_s, *to_s);
        audit.unusable.push(UnusableSpan {
            stream: name,
            from_s,
            to_s,
            reason: "a step that no motion explains",
        });
    }
    audit.findings.push(Finding {
        severity: Severity::Measurement,
        check: "step",
        stream: Some(name),
        found: most + allowed,
        expected: allowed,
        unit,
        what: format!(
            "{} steps that the motion does not explain, the largest {:.2} {unit}, the first at {:.2} s",
            steps.len(),
            most + allowed,
            steps[0].0
        ),
        advice: "an estimate was reset or a row is damaged: no window may span it",
    });
}

/// Reports values of more than `most`, in `unit`, and marks their times as unusable.
fn impossible<T>(
    audit: &mut Audit,
    name: &'static str,
    stream: &Stream<T>,
    most: f64,
    unit: &'static str,
    size: impl Fn(&T) -> f64,
) {
    let beyond: Vec<(f64, f64)> =
        stream.iter().map(|(t, v)| (t, size(v))).filter(|(_, size)| *size > most).collect();
    let Some(largest) = beyond.iter().map(|(_, size)| *size).reduce(f64::max) else { return };
    for (time, _) in &beyond {
        let (from_s, to_s) = (*time, *time);
        audit.unusable.push(UnusableSpan {
            stream: name,
            from_s,
            to_s,
            reason: "an impossible value",
        });
    }
    let share = beyond.len() as f64 / stream.len() as f64;
    audit.findings.push(Finding {
        severity: if share > 0.01 { Severity::Fault } else { Severity::Measurement },
        check: "impossible",
        stream: Some(name),
        found: largest,
        expected: most,
        unit,
        what: format!(
            "{} values that no sensor measures, up to {largest:.3e} {unit}",
            beyond.len()
        ),
        advice: "rows are damaged, or the stated unit is wrong",
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flight of positions only, on a circle of radius `radius` m, once in 3 s.
    fn flight(radius: f64, times: impl IntoIterator<Item = f64>) -> Flight {
        let mut flight = Flight::in_memory("memory", "csv");
        for t in times {
            let (s, c) = (2.1 * t).sin_cos();
            flight.position.push(t, Ned::new(radius * s, radius * c, -radius));
        }
        flight
    }

    #[test]
    fn positions_in_another_unit_are_found_without_a_velocity() {
        let severity = |flight: &Flight| {
            let findings = Audit::of(flight).findings;
            findings.iter().find(|finding| finding.check == "impossible").map(|f| f.severity)
        };
        let even = |rate: f64| (0..3000_u32).map(move |k| f64::from(k) / rate);
        assert_eq!(severity(&flight(1000.0, even(100.0))), Some(Severity::Fault));
        assert_eq!(severity(&flight(1000.0, even(5.0))), Some(Severity::Fault));
        assert_eq!(severity(&flight(1.0, even(100.0))), None);
        assert_eq!(severity(&flight(1.0, even(1.0))), None);
        // Rows that arrive in pairs.
        let pairs = (0..3000_u32).map(|k| 0.02 * f64::from(k / 2) + 2e-5 * f64::from(k % 2));
        let mut hasty = flight(1.0, pairs);
        for (k, position) in hasty.position.values_mut().iter_mut().enumerate() {
            *position = Ned::new(0.1 * k as f64, 0.0, -1.0);
        }
        assert_eq!(severity(&hasty), None);
    }
}
