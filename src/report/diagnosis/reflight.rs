//! The section on flights that were flown again in simulation.

use crate::diagnose::simulate::reflight::{ClosedLoop, Difference, ReferenceOrigin, Reflown};
use crate::report::axis::significant;
use crate::report::chart::{Chart, Curve, Panel, Style};
use crate::report::page::{Mood, escape};
use crate::report::table::Table;

/// Flights that are drawn.
const DRAWN: usize = 2;

/// The table and the pictures; `explanation`: what the second simulation has.
pub(super) fn html(closed_loop: &ClosedLoop, explanation: &str) -> String {
    let mut table = Table::new(&[
        ("root mean square difference to the log", false),
        ("as shipped", true),
        (explanation, true),
        ("noise alone", true),
        ("closed", true),
    ]);
    let ClosedLoop { position_m, attitude_rad, thrust_n, moment_nm, output, flights } = closed_loop;
    for (name, difference) in [
        ("position (m)", position_m),
        ("attitude (rad)", attitude_rad),
        ("commanded thrust (N)", thrust_n),
        ("commanded moment (N m)", moment_nm),
        ("motor output (0..1)", output),
    ] {
        let Difference { before, after, floor } = difference;
        let mut cells = vec![name.to_owned()];
        cells.extend([before, after, floor].map(|value| significant(*value)));
        let percent = |closure: f64| format!("{:.0} %", 100.0 * closure);
        cells.push(difference.closure().map_or_else(|| "\u{2013}".to_owned(), percent));
        table.row(Mood::Plain, &cells);
    }
    let mut html = table.into_html();
    for flight in flights.iter().take(DRAWN) {
        html += &picture(flight, explanation);
    }
    html
}

fn picture(flight: &Reflown, explanation: &str) -> String {
    let reference = match flight.reference {
        ReferenceOrigin::Logged => "the logged reference",
        ReferenceOrigin::Setpoints => "the logged setpoints and the reported motion",
        ReferenceOrigin::Reported => "the flight as it was reported",
    };
    let heading =
        format!("<h3>{}, {:.0} s along {reference}</h3>", escape(&flight.name), flight.seconds);
    let curves = |[before, after]: &[Vec<f64>; 2]| {
        vec![
            Curve { name: "as shipped".into(), style: Style::Colour(1), y: before.clone() },
            Curve { name: explanation.into(), style: Style::Colour(2), y: after.clone() },
        ]
    };
    let panels = vec![
        Panel {
            name: "distance between simulated and logged position (m)".into(),
            curves: curves(&flight.traces.position_m),
        },
        Panel {
            name: "simulated minus logged thrust (N)".into(),
            curves: curves(&flight.traces.thrust_n),
        },
    ];
    let x = &flight.traces.time_s;
    heading + &Chart::new("time (s)", x, 110.0, panels).to_html()
}
