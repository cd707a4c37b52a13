//! The section on the flight that would tell what these logs leave open.

use crate::diagnose::next_flight::NextFlight;
use crate::report::axis::significant;
use crate::report::page::Mood;
use crate::report::table::Table;

/// The tables.
pub(super) fn html(next: &NextFlight) -> String {
    let names = |ids: &[&str]| if ids.is_empty() { "no effect".into() } else { ids.join(", ") };
    let mut table = Table::new(&[
        ("if this is true", false),
        ("probability now (%)", true),
        ("expected after the flight (%)", true),
        ("against", false),
        ("expected evidence (nats)", true),
    ]);
    for outlook in &next.outlook {
        for rival in &outlook.evidence {
            table.row(
                Mood::Plain,
                &[
                    names(&outlook.truth),
                    format!("{:.0}", 100.0 * outlook.now),
                    format!("{:.1}", 100.0 * outlook.expected),
                    names(&rival.rival),
                    significant(rival.nats),
                ],
            );
        }
    }
    let mut html = table.into_html();
    html += "<h3>Manoeuvres that were tried in simulation</h3>";
    let mut table = Table::new(&[
        ("manoeuvre", false),
        ("length (s)", true),
        ("least expected evidence (nats)", true),
    ]);
    for tried in &next.tried {
        let mood = if tried.manoeuvre == next.manoeuvre { Mood::Good } else { Mood::Plain };
        let nats = tried.least_nats.map_or_else(|| "breaks a limit".to_owned(), significant);
        table.row(mood, &[tried.manoeuvre.to_owned(), format!("{:.0}", tried.seconds), nats]);
    }
    html + &table.into_html()
}
