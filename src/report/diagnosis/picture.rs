//! The picture of a diagnosis, before any table: what is unexplained against what it depends on,
//! where the gap comes from, and flights held out as logged and as simulated.

use super::waterfall;
use crate::diagnose::answer::Answer;
use crate::diagnose::answer::text;
use crate::diagnose::residual_analysis::map::Regime;
use crate::report::axis::{Axis, range_of, significant};
use crate::report::chart::{Chart, Curve, Panel, Style, legend};
use crate::report::frame::Frame;
use crate::report::page::escape;

/// Quantities that are drawn, the steepest first.
const DRAWN: usize = 4;

/// The three pictures, as far as there is anything to draw.
pub(super) fn html(answer: &Answer) -> String {
    let explanation = text::explanation(answer.finding.verdict);
    let mut html = String::new();
    let regimes = &answer.map.regimes;
    if !regimes.is_empty() {
        html += "<h3>Unexplained acceleration against possible dependences</h3><p \
                 class=\"note\">Root mean square in quarters of the time, m/s\u{b2}; quantities in \
                 the order of their effect.</p>";
        html += &legend(
            [("as shipped", "curve c1".to_owned()), (explanation, "curve c2".to_owned())]
                .into_iter(),
        );
        let most = regimes.iter().take(DRAWN).flat_map(|r| r.rms.into_iter().chain(r.rms_after));
        let y = Axis::padded(range_of(most.chain([0.0])));
        let frames = regimes.iter().take(DRAWN).map(|regime| against(regime, y, explanation));
        html += &format!("<div class=\"side\">{}</div>", frames.collect::<String>());
    }
    if !answer.attribution.is_empty() {
        html += "<h3>Where the squared gap comes from</h3>";
        html += &waterfall::html(&answer.attribution);
    }
    if let Some(flight) = answer.closed_loop.as_ref().and_then(|flown| flown.flights.first()) {
        let traces = &flight.traces;
        let names = ["north (m)", "east (m)", "down (m)", "thrust (N)"];
        let panels = names.iter().enumerate().map(|(i, name)| {
            let curve =
                |name: &str, style, y: &Vec<f64>| Curve { name: name.into(), style, y: y.clone() };
            let [before, after] = &traces.simulated;
            Panel {
                name: (*name).to_owned(),
                curves: vec![
                    curve("as shipped", Style::Colour(1), &before[i]),
                    curve(explanation, Style::Colour(2), &after[i]),
                    curve("logged", Style::Reference, &traces.logged[i]),
                ],
            }
        });
        html += &format!("<h3>Logged over simulated: {}</h3>", escape(&flight.name));
        html += &Chart::new("time (s)", &traces.time_s, 92.0, panels.collect()).to_html();
    }
    html
}

/// One quantity: the quarters at their middles, before and after.
fn against(regime: &Regime, y: Axis, explanation: &str) -> String {
    let Regime { quantity, bounds, rms, rms_after } = regime;
    let quantity = quantity.replace('[', "(").replace(']', ")");
    let list = |values: &[f64; 4]| values.map(significant).join(", ");
    let description = format!(
        "Unexplained acceleration against {quantity}, from {} to {}, in quarters. As shipped: {} m/s\u{b2}. {explanation}: {} m/s\u{b2}.",
        significant(bounds[0]),
        significant(bounds[4]),
        list(rms),
        list(rms_after)
    );
    let frame = Frame {
        x: Axis::padded(Some((bounds[0], bounds[4]))),
        y,
        height: 150.0,
        name: "unexplained (m/s\u{b2})",
        x_label: Some(&quantity),
        group: None,
        description: &description,
    };
    let middles = [0, 1, 2, 3].map(|k| 0.5 * (bounds[k] + bounds[k + 1]));
    let mut marks = String::new();
    for (values, class, name) in [(rms, "c1", "as shipped"), (rms_after, "c2", explanation)] {
        let points = || middles.into_iter().zip(*values);
        marks += &frame.curve(points(), &format!("curve {class}"), name);
        for (k, (x, value)) in points().enumerate() {
            let [from, to] = [bounds[k], bounds[k + 1]].map(significant);
            let title = format!("{from} to {to}: {} m/s\u{b2} {name}", significant(value));
            marks += &frame.dot(x, value, class, &title);
        }
    }
    frame.to_html(&marks, "")
}
