//! The page of what changed, and when.

use super::chart::{Band, Chart, Curve, Mark, Panel, Style};
use super::page::{Mood, Page};
use super::table::Table;
use crate::diagnose::onset::OnsetReport;
use crate::onset::change::Change;
use crate::onset::history::Step;
use crate::onset::text::{line, step_line, what};

/// Looks further apart than this have a gap between them, s.
const PAUSE_S: f64 = 1.5;

/// A flight with what a detector saw of it.
#[derive(Clone, Copy, Debug)]
pub struct SeenFlight<'a> {
    /// The log.
    pub log: &'a str,
    /// What was seen.
    pub seen: &'a OnsetReport,
}

/// The whole page, self-contained.
pub fn html(vehicle: &str, bound: f64, flights: &[SeenFlight<'_>], steps: &[Step]) -> String {
    let seconds: f64 = flights.iter().map(|flight| flight.seen.seconds).sum();
    let subtitle = format!("{}, {seconds:.0} s in the air", counted(flights.len(), "flight"));
    let mut page = Page::new(&format!("When it changed: {vehicle}"), &subtitle);
    let count: usize = flights.iter().map(|flight| flight.seen.changes.len()).sum();
    let lines = flights.iter().flat_map(|flight| {
        flight.seen.changes.iter().map(move |change| format!("{}: {}", flight.log, line(change)))
    });
    let lines: Vec<String> = lines.chain(steps.iter().map(step_line)).collect();
    match (count, steps.len()) {
        (0, 0) => page.verdict(Mood::Good, "No change stands out from the noise.", &[]),
        _ => page.verdict(
            Mood::Warning,
            &format!("{} in flight, {} between flights.", counted(count, "change"), steps.len()),
            &lines,
        ),
    }
    for flight in flights {
        page.section(flight.log, EXPLANATION, &picture(bound, flight.seen));
    }
    page.into_html()
}

fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// What the picture shows.
pub const EXPLANATION: &str = "How much more likely the flight is with a change in the last \
                               seconds than with none, for the most likely cause. Above the dashed \
                               bound a change is reported; the vertical line marks when it began, \
                               the shading its 90 % interval.";

/// The statistic over time, with onsets and their intervals, and a table of the changes.
pub fn picture(bound: f64, seen: &OnsetReport) -> String {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    for look in &seen.looks {
        // After a change, and after a pause, nothing is examined for a while.
        if let Some(last) = x.last().copied().filter(|last| look.time_s > last + PAUSE_S) {
            x.push(0.5 * (last + look.time_s));
            y.push(f64::NAN);
        }
        x.push(look.time_s);
        // What lies far below the bound is all the same.
        y.push(look.evidence.max(-bound));
    }
    let bands: Vec<Band> = seen.changes.iter().map(band).collect();
    let marks: Vec<Mark> = seen
        .changes
        .iter()
        .map(|change| Mark { at: change.at_s, text: line(change), bad: false })
        .collect();
    let curves = vec![
        Curve { name: "evidence".into(), style: Style::Colour(1), y },
        Curve { name: "bound".into(), style: Style::Reference, y: vec![bound; x.len()] },
    ];
    let panels = vec![Panel { name: "evidence (nats)".into(), curves }];
    let chart = Chart { bands: &bands, marks: &marks, ..Chart::new("time (s)", &x, 260.0, panels) };
    let mut html = if x.is_empty() { String::new() } else { chart.to_html() };
    if !seen.changes.is_empty() {
        let mut table = Table::new(&[
            ("began (s)", true),
            ("90 % interval (s)", true),
            ("probability", true),
            ("evidence (nats)", true),
            ("what", false),
        ]);
        for change in &seen.changes {
            let [low, high] = change.interval_s;
            table.row(
                Mood::Plain,
                &[
                    format!("{:.2}", change.at_s),
                    format!("{low:.2} .. {high:.2}"),
                    format!("{:.0} %", 100.0 * change.probability),
                    format!("{:.0}", change.evidence),
                    what(change),
                ],
            );
        }
        html += &table.into_html();
    }
    html
}

fn band(change: &Change) -> Band {
    let [from, to] = change.interval_s;
    Band { from, to, name: "began".to_owned() }
}
