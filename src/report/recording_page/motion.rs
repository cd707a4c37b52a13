//! How the vehicle moved, and how far it was off the desired motion.

use super::{Timeline, axes, curve, panel};
use crate::report::axis::significant;
use crate::report::chart::{Curve, Panel, Style};
use crate::report::page::Mood;
use crate::report::recording::{Recording, Tracked};
use crate::report::table::Table;

/// Values for people: angles in degrees.
pub(super) fn with_unit(value: f64, unit: &str) -> String {
    match unit {
        "rad" => format!("{} deg", significant(value.to_degrees())),
        "rad/s" => format!("{} deg/s", significant(value.to_degrees())),
        _ => format!("{} {unit}", significant(value)),
    }
}

fn scale(unit: &str) -> (f64, &str) {
    match unit {
        "rad" => (1_f64.to_degrees(), "deg"),
        "rad/s" => (1_f64.to_degrees(), "deg/s"),
        other => (1.0, other),
    }
}

/// Signed errors of each tracked signal.
pub(super) fn errors(
    recording: &Recording,
    tracked: &[Tracked],
    timeline: &Timeline<'_>,
) -> String {
    let mut table =
        Table::new(&[("axis", false), ("bias", true), ("RMS", true), ("greatest", true)]);
    for error in &recording.summary().errors {
        let values = [error.mean, error.rms, error.max].map(|v| with_unit(v, error.unit));
        let mut cells = vec![error.axis.to_owned()];
        cells.extend(values);
        table.row(Mood::Plain, &cells);
    }
    let mut html = table.into_html();
    for group in tracked.chunks(3) {
        let panels = group.iter().map(|signal| {
            let (factor, unit) = scale(signal.unit);
            let errors = signal.errors().into_iter().map(|e| factor * e).collect();
            panel(&format!("{} ({unit})", signal.axis), vec![curve("error", 1, errors)])
        });
        html += &timeline.chart(&group[0].time, 80.0, panels.collect());
    }
    html
}

/// Angles broken where they wrap.
fn unwrapped(mut degrees: Vec<f64>) -> Vec<f64> {
    for i in (1..degrees.len()).rev() {
        if (degrees[i] - degrees[i - 1]).abs() > 180.0 {
            degrees[i] = f64::NAN;
        }
    }
    degrees
}

/// Position, velocity, attitude, rate and force over time.
pub(super) fn motion(
    recording: &Recording,
    tracked: &[Tracked],
    timeline: &Timeline<'_>,
) -> String {
    let flight = &recording.flight;
    let mut html = String::new();
    let mut add = |heading: &str, times: &[f64], panels: Vec<Panel>| {
        if !times.is_empty() {
            html += &format!("<h3>{heading}</h3>{}", timeline.chart(times, 92.0, panels));
        }
    };
    // The desired motion stands beside it, where the log holds one.
    let with_desired = |first: &str, mut panels: Vec<Panel>| -> Vec<Panel> {
        let desired = tracked.iter().skip_while(|signal| !signal.axis.starts_with(first));
        for (panel, signal) in panels.iter_mut().zip(desired) {
            let (factor, _) = scale(signal.unit);
            let y: Vec<f64> = signal.desired.iter().map(|v| factor * v).collect();
            let y = if signal.unit == "rad" { unwrapped(y) } else { y };
            panel.curves.push(Curve { name: "desired".into(), style: Style::Reference, y });
        }
        panels
    };
    let position =
        axes(&flight.position, ["north (m)", "east (m)", "down (m)"], |p| p.to_array(), 1.0);
    add("Position", flight.position.times(), with_desired("position", position));
    let velocity = ["north (m/s)", "east (m/s)", "down (m/s)"];
    add(
        "Velocity",
        flight.velocity.times(),
        axes(&flight.velocity, velocity, |v| v.to_array(), 1.0),
    );
    let degrees = 1_f64.to_degrees();
    let euler = |q: &vehicle::frame::Attitude| {
        let angles = q.euler();
        [angles.roll, angles.pitch, angles.yaw]
    };
    let mut attitude =
        axes(&flight.attitude, ["roll (deg)", "pitch (deg)", "yaw (deg)"], euler, degrees);
    for curve in attitude.iter_mut().flat_map(|panel| &mut panel.curves) {
        curve.y = unwrapped(std::mem::take(&mut curve.y));
    }
    add("Attitude", flight.attitude.times(), with_desired("attitude", attitude));
    let rate = ["roll (deg/s)", "pitch (deg/s)", "yaw (deg/s)"];
    let rate = axes(&flight.body_rate, rate, |w| w.to_array(), degrees);
    add("Body rate", flight.body_rate.times(), with_desired("body rate", rate));
    let force = ["front (m/s\u{b2})", "right (m/s\u{b2})", "down (m/s\u{b2})"];
    let force = axes(&flight.specific_force, force, |f| f.to_array(), 1.0);
    add("Specific force", flight.specific_force.times(), force);
    html
}
