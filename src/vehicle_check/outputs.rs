//! The motors' outputs compared with their range from the file or the autopilot's parameters.

use std::ops::Range;

use vehicle::VehicleParams;

use super::{Held, Verdict, brief};
use crate::log::import::{Flight, MotorUnit};

/// Share of the time in the air at an end of the range, above which the range is doubtful.
const AT_AN_END: f64 = 0.05;
/// Distance to an end of the range that counts as at the end.
const END: f64 = 1e-3;
/// Share of the range by which the file's may differ from the autopilot's.
const RANGE_SHARE: f64 = 0.02;

/// Compares the outputs of `flight` as logged, and as `shares` of the range.
pub(super) fn held(
    flight: &Flight,
    shares: &Flight,
    spans: &[Range<f64>],
    vehicle: &VehicleParams,
) -> Held {
    let held = Held {
        check: "outputs",
        field: "motor_output",
        verdict: Verdict::NotShown,
        expected: 1.0,
        found: None,
        half_width: None,
        unit: "",
        what: "outputs: not shown: the log has none in the air".to_owned(),
    };
    let in_air = |(time, outputs): (f64, &[f64; 4])| {
        spans.iter().any(|span| span.contains(&time)).then_some(*outputs)
    };
    let all: Vec<f64> = shares.outputs.iter().filter_map(in_air).flatten().collect();
    if all.is_empty() {
        return held;
    }
    let (least, most) =
        all.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), u| (a.min(*u), b.max(*u)));
    let ends = all.iter().filter(|u| !(END..=1.0 - END).contains(*u)).count();
    let share_at_end = ends as f64 / all.len() as f64;
    let own = vehicle.motor_output.as_ref().map(|unit| [unit.zero, unit.one]);
    let stated = flight.facts.output_ranges.map(|[first, ..]| [first.zero, first.one]);
    let is_logged = flight.motor_unit == MotorUnit::VehicleFile;
    let range = match (is_logged, own, stated) {
        (true, Some([zero, one]), _) => {
            format!("{} to {} (motor_output)", brief(zero), brief(one))
        }
        (true, None, Some([zero, one])) => {
            format!("{} to {} (the autopilot's parameters)", brief(zero), brief(one))
        }
        _ => "0 to 1".to_owned(),
    };
    let contrary = own
        .zip(stated)
        .filter(|_| is_logged)
        .filter(|([a, b], [c, d])| (a - c).abs().max((b - d).abs()) > RANGE_SHARE * (d - c));
    let doubt = match contrary {
        Some((_, [zero, one])) => Some(format!(
            "; the autopilot's parameters say {} to {}: leave motor_output out of the file",
            brief(zero),
            brief(one)
        )),
        None if share_at_end > AT_AN_END => Some(format!(
            "; {} % of them are at an end of it, expected at most {} %: the range, mass or \
             thrust_max_N does not match this vehicle",
            brief(100.0 * share_at_end),
            100.0 * AT_AN_END
        )),
        None => None,
    };
    Held {
        verdict: if doubt.is_some() { Verdict::Differs } else { Verdict::Fits },
        found: Some(most),
        what: format!(
            "outputs: in the air between {} and {} of their range of {range}, expected within 0 and 1{}",
            brief(least),
            brief(most),
            doubt.unwrap_or_default()
        ),
        ..held
    }
}
