//! A change as text.

use super::change::{Change, Estimate, Value};
use super::columns::Cause;
use super::history::Step;

/// One line: onset, cause and size.
pub fn line(change: &Change) -> String {
    let [low, high] = change.interval_s;
    let mut text =
        format!("{:.2} s (90 % interval {low:.2} .. {high:.2} s): {}", change.at_s, what(change));
    if change.probability < 0.9 {
        let others: Vec<String> = change
            .others
            .iter()
            .map(|other| format!("{} {:.0} %", name(other.cause), 100.0 * other.probability))
            .collect();
        text += &format!(
            "; {} has {:.0} %, otherwise {}",
            name(change.cause),
            100.0 * change.probability,
            others.join(", ")
        );
    }
    text
}

/// Display name of a cause.
pub fn name(cause: Cause) -> &'static str {
    match cause {
        Cause::Thrust => "thrust over weight",
        Cause::Rotor0 => "rotor 0",
        Cause::Rotor1 => "rotor 1",
        Cause::Rotor2 => "rotor 2",
        Cause::Rotor3 => "rotor 3",
        Cause::CentreOfMass => "the centre of mass",
        Cause::Payload => "a load",
        Cause::Wind => "a force fixed in the world",
        Cause::Drag => "drag",
    }
}

/// The cause and the size of the change.
pub fn what(change: &Change) -> String {
    let [first, ..] = change.values.as_slice() else { return name(change.cause).to_owned() };
    match change.cause {
        Cause::Thrust => {
            let (before, after) = (1.0 + first.before.value, 1.0 + first.after.value);
            let thrust = after / before - 1.0;
            if thrust < 0.0 {
                format!(
                    "thrust falls by {} (a level that drops, a pack that sags), or the mass grows by {:.1} %",
                    percent(first),
                    100.0 * (before / after - 1.0)
                )
            } else {
                format!(
                    "the mass falls by {:.1} % (a load is dropped), or thrust grows by {}",
                    100.0 * (1.0 - before / after),
                    percent(first)
                )
            }
        }
        Cause::Rotor0 | Cause::Rotor1 | Cause::Rotor2 | Cause::Rotor3 => format!(
            "{}'s thrust {} by {}",
            name(change.cause),
            if first.change.value < 0.0 { "falls" } else { "grows" },
            percent(first)
        ),
        Cause::CentreOfMass => format!("the centre of mass moves by {}", vector(&change.values)),
        Cause::Payload => format!(
            "a load changes: thrust over weight by {:+.1} %, the centre of mass by {}",
            100.0 * first.change.value,
            vector(&change.values[1..])
        ),
        Cause::Wind => format!("a force fixed in the world sets in, {}", vector(&change.values)),
        Cause::Drag => format!(
            "drag {} from {:.3} to {:.3} {} beyond the file's",
            if first.change.value < 0.0 { "falls" } else { "grows" },
            first.before.value,
            first.after.value,
            first.unit
        ),
    }
}

/// A relative change with its interval, as percentages of the value before.
fn percent(value: &Value) -> String {
    let before = 1.0 + value.before.value;
    let share = |change: f64| 100.0 * (change / before).abs();
    let [a, b] = value.change.interval.map(share);
    format!("{:.1} % ({:.1} .. {:.1} %)", share(value.change.value), a.min(b), a.max(b))
}

fn vector(values: &[Value]) -> String {
    let parts = values.iter().map(|value| {
        let axis = value.name.rsplit('_').next().unwrap_or(value.name);
        let (scale, unit) = if value.unit == "m" { (1e3, "mm") } else { (1.0, value.unit) };
        let half = 0.5 * (value.change.interval[1] - value.change.interval[0]) * scale;
        format!("{:+.3} +- {half:.3} {unit} {axis}", value.change.value * scale)
    });
    parts.collect::<Vec<_>>().join(", ")
}

/// A step between flights in one line; flights count from 1.
pub fn step_line(step: &Step) -> String {
    let what = match step.rotor {
        Some(rotor) => format!("thrust of rotor {rotor}"),
        None => step.name.replace('_', " "),
    };
    let number = |estimate: &Estimate| match step.unit {
        "1" => format!("{:+.1} %", 100.0 * estimate.value),
        "m" => format!("{:+.2} mm", 1e3 * estimate.value),
        unit => format!("{:+.4} {unit}", estimate.value),
    };
    format!(
        "between flights {} and {}: {what} goes from {} to {} relative to the file (chance {:.1e})",
        step.from,
        step.from + 1,
        number(&step.before),
        number(&step.after),
        step.chance
    )
}
