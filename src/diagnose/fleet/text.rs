//! The answer on a fleet as text.

use crate::diagnose::answer::quantities::{bounded, quantity, short, unit};
use crate::diagnose::fleet::answer::{
    CauseAnswer, FleetAnswer, FleetNumber, OwnEffect, State, VehicleAnswer,
};

fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

fn values(cause: &CauseAnswer) -> String {
    let numbers =
        cause.numbers.iter().map(|number| quantity(&cause.id, &number.name, short(number.value)));
    format!("{} ({})", cause.id, numbers.collect::<Vec<_>>().join(", "))
}

fn list(causes: &[CauseAnswer]) -> String {
    causes.iter().map(values).collect::<Vec<_>>().join(" and ")
}

/// The finding in a sentence or two.
pub fn sentence(answer: &FleetAnswer) -> String {
    let of = counted(answer.looked_at, "vehicle");
    let mut text = match answer.shared.as_slice() {
        [] => format!("The {of} share no effect that the vehicle file lacks."),
        shared => format!("The type has {}, according to {of}.", list(shared)),
    };
    for group in &answer.groups {
        text += &format!(" {} have {}.", counted(group.vehicles.len(), "vehicle"), values(group));
    }
    for open in &answer.open {
        text += &format!(
            " {} have {}: too few to show whether it belongs to the type or to them alone.",
            counted(open.vehicles.len(), "vehicle"),
            values(open)
        );
    }
    // Vehicles with only an open effect are mentioned above.
    let is_open = |vehicle: &VehicleAnswer, effect: &OwnEffect| {
        answer.open.iter().any(|o| o.id == effect.id && o.vehicles.contains(&vehicle.name))
    };
    let has_own = |vehicle: &&VehicleAnswer| {
        matches!(vehicle.state, State::Own | State::Ambiguous)
            && !vehicle.effects.iter().all(|effect| is_open(vehicle, effect))
    };
    let own = answer.vehicles.iter().filter(has_own).count();
    text += &match own {
        0 => " No vehicle has an effect of its own.".to_owned(),
        1 => " One has an effect of its own.".to_owned(),
        own => format!(" {own} have effects of their own."),
    };
    text
}

/// The name of a cause's number, with its unit in brackets.
pub fn with_unit(cause: &CauseAnswer, number: &FleetNumber) -> String {
    match unit(&cause.id, &number.name) {
        Some(unit) => format!("{} ({unit})", number.name),
        None => number.name.clone(),
    }
}

fn cause_lines(title: &str, cause: &CauseAnswer) -> String {
    let percent = |p: f64| format!("{:.0} %", 100.0 * p);
    let mut text = format!(
        "{title:10} {:18} {:>5}  type-wide {:>5}  {} vehicles have it\n",
        cause.id,
        percent(cause.probability),
        percent(cause.of_type),
        cause.vehicles.len()
    );
    for number in &cause.numbers {
        let [low, high] = number.interval.map(short);
        text += &format!(
            "           {:18} {} ({low} .. {high}), file {}, spread between vehicles {}\n",
            with_unit(cause, number),
            short(number.value),
            short(number.file),
            short(number.spread)
        );
    }
    if !cause.ambiguous_with.is_empty() {
        text += &format!("           or {}\n", cause.ambiguous_with.join(", "));
    }
    text
}

fn effect(effect: &OwnEffect) -> String {
    let numbers =
        effect.intervals.iter().map(|(name, interval)| bounded(&effect.id, name, *interval));
    let numbers: Vec<String> = numbers.collect();
    format!("{} {:.0} %  {}", effect.id, 100.0 * effect.probability, numbers.join("  "))
}

/// A vehicle's state in a line.
pub fn state_line(vehicle: &VehicleAnswer) -> String {
    let effects: Vec<String> = vehicle.effects.iter().map(effect).collect();
    let effects = effects.join("; ");
    match vehicle.state {
        State::AsType => "like its type".to_owned(),
        State::Group => format!("like its group: {effects}"),
        State::Own => effects,
        State::Ambiguous => format!("{effects}; or {}", vehicle.ambiguous_with.join(", ")),
        State::Unknown => format!("unknown: {}", vehicle.sentence),
        State::Faulty => format!("faulty logs: {}", vehicle.faults.join("; ")),
        State::Unusable => format!("left out: {}", vehicle.sentence),
    }
}

/// The answer for the terminal: the type's effects, the groups' effects, then every vehicle that
/// differs from its type.
pub fn report(answer: &FleetAnswer) -> String {
    let mut text = answer.sentence.clone() + "\n\n";
    for (title, causes) in
        [("type", &answer.shared), ("group", &answer.groups), ("open", &answer.open)]
    {
        for cause in causes {
            text += &cause_lines(title, cause);
            if title != "type" {
                text += &format!("           {}\n", cause.vehicles.join(" "));
            }
        }
    }
    for number in &answer.file_numbers {
        text += &format!(
            "file       {:18} {} instead of {} on average ({:+.1} tolerances), spread {}\n",
            number.name,
            short(number.mean),
            short(number.expected),
            number.tolerances,
            short(number.spread)
        );
    }
    for vehicle in answer.vehicles.iter().filter(|vehicle| vehicle.state != State::AsType) {
        text += &format!("vehicle    {:18} {}\n", vehicle.name, state_line(vehicle));
    }
    text += &format!(
        "vehicles   {} like the type, {} in a group, {} with effects of their own, {} ambiguous, \
         {} unknown, {} with faulty logs, {} left out\n",
        answer.count(State::AsType),
        answer.count(State::Group),
        answer.count(State::Own),
        answer.count(State::Ambiguous),
        answer.count(State::Unknown),
        answer.count(State::Faulty),
        answer.count(State::Unusable)
    );
    text
}
