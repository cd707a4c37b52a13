//! The page of a diagnosis: verdict first, then where, which, how far, what the logs cannot tell.

mod law;
mod next_flight;
mod picture;
mod reflight;
mod waterfall;

use std::fmt::Write;

use super::axis::significant;
use super::bars::{self, Bar};
use super::page::{Mood, Page, escape};
use super::table::{Table, definitions};
use crate::diagnose::answer::quantities::{bounded, numbered, one};
use crate::diagnose::answer::text::{self, closed_loop};
use crate::diagnose::answer::{Answer, Gap};
use crate::diagnose::residual_analysis::map::Regime;
use crate::diagnose::simulate::gap::QUANTITIES;
use crate::diagnose::simulate::open_loop::HORIZONS_S;
use crate::diagnose::verdict::Verdict;
use crate::onset::detector::Settings;
use crate::report::onset::{self, SeenFlight};

/// Cells of the map and hypotheses that are drawn.
const SHOWN: usize = 10;
/// Share of a gap from which on it counts as closed.
const CLOSED: f64 = 0.5;

/// The whole page, self-contained; `seen` is what a search for changes saw of each flight.
pub fn html(answer: &Answer, vehicle: &str, seen: &[SeenFlight<'_>]) -> String {
    let seconds: f64 = answer.flights.iter().map(|flight| flight.seconds).sum();
    let subtitle = format!("{} flights, {seconds:.0} s in the air", answer.flights.len());
    let mut page = Page::new(&format!("Diagnosis: {vehicle}"), &subtitle);
    verdict(answer, &mut page);
    let picture = picture::html(answer);
    if !picture.is_empty() {
        page.section("The picture", "", &picture);
    }
    page.section("Where", &answer.map.sentence, &place(answer));
    page.section(
        "Which",
        "Evidence that each hypothesis adds to the file's numbers (delay, lag, thrust, trims, \
         biases within their tolerances), on the fitted flights, and how much more likely it makes \
         the held-out flights. An effect must also improve open-loop predictions.",
        &which(answer),
    );
    if !seen.is_empty() {
        let bound = Settings::LOG.bound();
        let of = |flight: &SeenFlight<'_>| {
            format!("<h3>{}</h3>{}", escape(flight.log), onset::picture(bound, flight.seen))
        };
        page.section("When", onset::EXPLANATION, &seen.iter().map(of).collect::<String>());
    }
    if let Some(found) = &answer.law {
        page.section("The law", law::INTRODUCTION, &law::html(found));
    }
    if let Some(gap) = &answer.gap {
        page.section(
            "How far",
            "Open-loop predictions of the held-out flights, started every quarter of a second: \
             root mean square errors with the vehicle file as shipped, with the effects, and from \
             noise alone. The learner is a network trained on the residual of the fitted flights \
             with the vehicle file as shipped.",
            &how_far(answer, gap),
        );
    }
    if let Some(flown) = &answer.closed_loop {
        page.section(
            "Flown again",
            &format!(
                "{} Feedback hides a plant's errors in the trajectory and shows them in the commands.",
                closed_loop(flown, text::explanation(answer.finding.verdict))
            ),
            &reflight::html(flown, text::explanation(answer.finding.verdict)),
        );
    }
    page.section("What these logs cannot show", "", &open_effects(answer));
    if let Some(next) = &answer.next_flight {
        page.section("Next flight", &text::next_flight(next), &next_flight::html(next));
    }
    page.section("How this was computed", "", &provenance(answer));
    page.into_html()
}

fn verdict(answer: &Answer, page: &mut Page) {
    let mood = match answer.verdict {
        Verdict::None => Mood::Good,
        Verdict::Effect => Mood::Plain,
        Verdict::Unknown => Mood::Warning,
    };
    let mut reasons: Vec<String> = answer
        .named()
        .map(|effect| format!("{}: probability {:.0} %", one(effect), 100.0 * effect.probability))
        .collect();
    reasons
        .extend(text::equivalent(answer).map(|other| format!("or {}", text::alternative(other))));
    page.verdict(mood, &answer.finding.sentence, &reasons);
    if let Some(gap) = &answer.gap {
        let mut figures = vec![
            ("gap before, times the floor", significant(gap.times(gap.before)), Mood::Plain),
            ("gap after, times the floor", significant(gap.times(gap.after)), Mood::Plain),
            ("the floor, times the sensors' noise", significant(gap.floor), Mood::Plain),
        ];
        if let Some(closure) = gap.closure {
            let mood = if closure >= CLOSED { Mood::Good } else { Mood::Plain };
            figures.push(("closed", format!("{:.0} %", 100.0 * closure), mood));
        }
        page.figures(&figures);
    }
}

/// Bars of what is not below nothing, each with a mark.
fn bars(rows: &[(String, f64, Option<f64>)]) -> String {
    let bar = |(label, value, mark): &(String, f64, Option<f64>)| Bar {
        mark: *mark,
        ..Bar::new(label.as_str(), value.max(0.0), significant(*value))
    };
    bars::to_html(&rows.iter().map(bar).collect::<Vec<_>>())
}

fn place(answer: &Answer) -> String {
    let rows: Vec<(String, f64, Option<f64>)> = answer
        .map
        .cells
        .iter()
        .take(SHOWN)
        .map(|cell| {
            let label = format!("{}, {}", cell.channel, cell.scale);
            (label, (1.0 + cell.excess.max(-1.0)).sqrt(), Some(1.0))
        })
        .collect();
    let mut html = String::from(
        "<h3>Root mean square as shipped, in units of the floor (mark: the floor)</h3>",
    );
    html += &bars(&rows);
    if let Some((world, body)) = answer.map.constant_in_world.zip(answer.map.constant_in_body) {
        let list = |v: [f64; 3]| v.map(|x| format!("{x:.3}")).join(", ");
        html += &definitions([
            ("constant in the world, N E D (m/s\u{b2})", list(world).as_str()),
            ("constant in the body, F R D (m/s\u{b2})", list(body).as_str()),
        ]);
    }
    if !answer.map.regimes.is_empty() {
        html += "<h3>Unexplained acceleration by regime (m/s\u{b2}), in quarters of the time: as shipped, and with the best explanation</h3>";
        let mut table = Table::new(&[
            ("quantity", false),
            ("range", true),
            ("1st quarter", true),
            ("2nd", true),
            ("3rd", true),
            ("4th", true),
        ]);
        for Regime { quantity, bounds, rms, rms_after } in &answer.map.regimes {
            let range = format!("{} .. {}", significant(bounds[0]), significant(bounds[4]));
            let mut cells = vec![(*quantity).to_owned(), range];
            let both = rms.iter().zip(rms_after);
            cells.extend(
                both.map(|(x, y)| format!("{} \u{2192} {}", significant(*x), significant(*y))),
            );
            table.row(Mood::Plain, &cells);
        }
        html += &table.into_html();
    }
    html
}

fn which(answer: &Answer) -> String {
    let set = |effects: &[String]| effects.join(" and ");
    let rows: Vec<(String, f64, Option<f64>)> = answer
        .explanations
        .iter()
        .take(SHOWN)
        .map(|explanation| (set(&explanation.effects), explanation.evidence, None))
        .collect();
    let mut html = String::from(
        "<h3>Evidence of each set of effects over the vehicle file within its tolerances, nats</h3>",
    );
    html += &bars(&rows);
    let mut table = Table::new(&[
        ("effects with their fitted numbers", false),
        ("evidence (nats)", true),
        ("posterior mass", true),
    ]);
    for explanation in &answer.explanations {
        table.row(
            Mood::Plain,
            &[
                numbered(explanation),
                format!("{:.1}", explanation.evidence),
                format!("{:.1} %", 100.0 * explanation.mass),
            ],
        );
    }
    html += &table.into_html();
    if !answer.effects.is_empty() {
        html += "<h3>Named and considered</h3>";
        let mut table =
            Table::new(&[("effect", false), ("probability", true), ("90 % intervals", false)]);
        for effect in &answer.effects {
            let intervals: Vec<String> = effect
                .intervals
                .iter()
                .map(|(name, interval)| bounded(effect.id.name(), name, *interval))
                .collect();
            table.row(
                Mood::Plain,
                &[
                    one(effect),
                    format!("{:.1} %", 100.0 * effect.probability),
                    intervals.join("; "),
                ],
            );
        }
        html += &table.into_html();
    }
    html
}

fn how_far(answer: &Answer, gap: &Gap) -> String {
    let explanation = text::explanation(answer.finding.verdict);
    let floor_mark = Some(gap.floor);
    let mut rows = vec![
        ("as shipped".to_owned(), gap.before, floor_mark),
        (explanation.to_owned(), gap.after, floor_mark),
        ("noise alone".to_owned(), gap.floor, floor_mark),
    ];
    if let Some(nuisances) = gap.nuisances_only {
        rows.insert(1, ("the file's numbers alone".to_owned(), nuisances, floor_mark));
    }
    if let Some(learner) = gap.with_learner {
        rows.insert(rows.len() - 1, ("with a learner".to_owned(), learner, floor_mark));
    }
    let mut html = String::new();
    let _ = write!(html, "<h3>{}, in multiples of the noise floor</h3>", metric_text(gap.metric));
    html += &bars(&rows);
    let mut table = Table::new(&[
        ("quantity", false),
        ("as shipped", true),
        (explanation, true),
        ("noise alone", true),
    ]);
    let [before, after, floor] = &gap.errors;
    for (q, (quantity, unit)) in QUANTITIES.iter().enumerate() {
        for (h, horizon) in HORIZONS_S.iter().enumerate() {
            let cells = [before, after, floor].map(|errors| significant(errors.0[h][q]));
            let mut row = vec![format!("{quantity} ({unit}) after {horizon} s")];
            row.extend(cells);
            table.row(Mood::Plain, &row);
        }
    }
    html + &table.into_html()
}

/// What a gap's metric is the mean of.
fn metric_text(metric: &str) -> &'static str {
    match metric {
        "guided" => {
            "Mean of position and velocity at 0.5 and 1 s, with the body turning as reported, and \
             of attitude and body rate at 0.1 s"
        }
        "forces" => {
            "Mean of position and velocity at 0.5 and 1 s, with the body turning as reported"
        }
        _ => "Mean of position, velocity and attitude at 0.5 and 1 s",
    }
}

fn open_effects(answer: &Answer) -> String {
    let mut table = Table::new(&[("effect", false), ("why", false)]);
    for effect in &answer.not_testable {
        table.row(Mood::Plain, &[effect.id.to_string(), effect.reason.clone()]);
    }
    for id in &answer.ambiguous_with {
        table.row(
            Mood::Warning,
            &[id.to_string(), "cannot be distinguished from the named effects".into()],
        );
    }
    let mut html = String::new();
    if answer.not_testable.is_empty() && answer.ambiguous_with.is_empty() {
        html += "<p>These logs can show every effect in the catalogue that was searched for.</p>";
    } else {
        html += &table.into_html();
    }
    if let Some(reason) = &answer.closed_loop_missing {
        let _ = write!(html, "<p>Not flown again in closed loop: {}.</p>", escape(reason));
    }
    if let Some([before, after]) = &answer.unmodelled_force {
        let _ = write!(
            html,
            "<p>Unexplained force per mass on which velocity and accelerometer agree, 0.1 to 4.5 \
             Hz: {} m/s\u{b2} before, {} m/s\u{b2} after.</p>",
            significant(before.rms()),
            significant(after.rms())
        );
    }
    html
}

fn provenance(answer: &Answer) -> String {
    let mut table = Table::new(&[
        ("flight", false),
        ("part", false),
        ("used (s)", true),
        ("gap as shipped", true),
        ("log holds", false),
    ]);
    for flight in &answer.flights {
        let c = &flight.channels;
        let holds: Vec<&str> = [
            (c.velocity, "position and velocity"),
            (c.attitude, "attitude"),
            (c.body_rate, "body rate"),
            (c.specific_force, "accelerometer"),
            (c.outputs, "motor outputs"),
            (c.setpoint, "setpoints"),
            (c.voltage, "voltage"),
            (c.rotor_speed, "rotor speeds"),
        ]
        .into_iter()
        .filter_map(|(has, name)| has.then_some(name))
        .collect();
        let part = if flight.held_out { "held out" } else { "fitted" };
        table.row(
            Mood::Plain,
            &[
                flight.name.clone(),
                part.to_owned(),
                format!("{:.1}", flight.seconds),
                flight.over_noise.map_or_else(|| "-".to_owned(), |over| format!("{:.2}", over.gap)),
                holds.join(", "),
            ],
        );
    }
    let mut html = table.into_html();
    html += "<p>Each equation of motion and measurement is compared with the reports over cells of \
             10 ms and weighted over frequency by the residual noise, whose spectrum is not \
             assumed. Every set of effects is fitted with the vehicle file's numbers free within \
             their tolerances.</p>";
    if let Some(twins) = &answer.twins {
        let _ = write!(
            html,
            "<p>{} twins of the flights without any effect reached up to {:.0} % of the evidence \
             required of an effect.</p>",
            twins.count,
            100.0 * twins.largest.last().copied().unwrap_or(0.0)
        );
    }
    html
}
