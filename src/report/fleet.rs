//! The page of a fleet.

use super::bars::{self, Bar};
use super::page::{Mood, Page};
use super::table::Table;
use crate::diagnose::answer::quantities::short;
use crate::diagnose::fleet::answer::{CauseAnswer, FleetAnswer, FleetNumber, State};
use crate::diagnose::fleet::text::{state_line, with_unit};

/// 90 % of a normal distribution lie within so many standard deviations.
const Z90: f64 = 1.645;

/// What the picture shows.
const PICTURE: &str = "Each vehicle's value from its flights alone, as the distance from the \
                       vehicle file, with its 90 % interval; the mark is the value. The first bar \
                       is the fleet: nine of ten vehicles are within it. Vehicles that differ from \
                       the fleet have another colour.";

/// The whole page, self-contained.
pub fn html(answer: &FleetAnswer, vehicle: &str) -> String {
    let subtitle = format!("{} vehicles, {} examined", answer.vehicles.len(), answer.looked_at);
    let mut page = Page::new(&format!("A fleet of {vehicle}"), &subtitle);
    let is_clear = answer.shared.is_empty()
        && answer.vehicles.iter().all(|vehicle| vehicle.state == State::AsType);
    let mood = if is_clear { Mood::Good } else { Mood::Warning };
    page.verdict(mood, &answer.sentence, &[]);
    for (what, causes) in [
        ("the type has", &answer.shared),
        ("a group has", &answer.groups),
        ("a few have", &answer.open),
    ] {
        for cause in causes {
            let heading = format!("What {what}: {}", cause.id);
            page.section(&heading, PICTURE, &pictures(cause));
        }
    }
    page.section("The vehicles", "What each has beyond its type.", &vehicles(answer));
    if !answer.file_numbers.is_empty() {
        let mut table = Table::new(&[
            ("number", false),
            ("mean", true),
            ("file", true),
            ("tolerances", true),
            ("spread", true),
        ]);
        for number in &answer.file_numbers {
            table.row(
                Mood::Plain,
                &[
                    number.name.clone(),
                    short(number.mean),
                    short(number.expected),
                    format!("{:+.1}", number.tolerances),
                    short(number.spread),
                ],
            );
        }
        page.section(
            "Numbers of the vehicle file",
            "Shared deviations within the tolerances of the vehicle file: no effect.",
            &table.into_html(),
        );
    }
    page.into_html()
}

fn pictures(cause: &CauseAnswer) -> String {
    cause.numbers.iter().map(|number| picture(cause, number)).collect()
}

fn picture(cause: &CauseAnswer, number: &FleetNumber) -> String {
    let off = |value: f64| value - number.file;
    let mut bars = vec![Bar {
        label: format!("fleet, {}", with_unit(cause, number)),
        from: off(number.value - Z90 * number.spread),
        to: off(number.value + Z90 * number.spread),
        mark: Some(off(number.value)),
        class: "c2",
        text: format!("{}, {} vehicles", short(number.value), cause.vehicles.len()),
    }];
    bars.extend(number.vehicles.iter().map(|vehicle| Bar {
        label: vehicle.vehicle.clone(),
        from: off(vehicle.interval[0]),
        to: off(vehicle.interval[1]),
        mark: Some(off(vehicle.value)),
        class: if vehicle.has > 0.5 { "c1" } else { "c3" },
        text: format!("{}{}", short(vehicle.value), if vehicle.has > 0.5 { "" } else { " !" }),
    }));
    bars::to_html(&bars)
}

fn vehicles(answer: &FleetAnswer) -> String {
    let mut table = Table::new(&[
        ("vehicle", false),
        ("what", false),
        ("gap with its type", true),
        ("gap with its own effects", true),
    ]);
    for vehicle in &answer.vehicles {
        let mood = match vehicle.state {
            State::AsType | State::Group => Mood::Plain,
            State::Own | State::Ambiguous | State::Unknown => Mood::Warning,
            State::Faulty | State::Unusable => Mood::Bad,
        };
        let [before, after] =
            vehicle.gap.map(|gap| gap.map_or("-".to_owned(), |gap| format!("{gap:.2}")));
        table.row(mood, &[vehicle.name.clone(), state_line(vehicle), before, after]);
    }
    table.into_html()
}
