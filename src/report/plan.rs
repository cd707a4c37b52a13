//! The page of a plan's report.

use vehicle::frame::Ned;

use super::axis::significant;
use super::chart::{Chart, Curve, Panel, Style};
use super::page::{Mood, Page};
use super::scene::Scene;
use super::table::{Table, definitions};
use super::text::{length, smallness};
use crate::control::Limits;
use crate::plan::planned::Plan;
use crate::plan::problem::StateVector;
use crate::plan::{PlannedTube, outline};

const STATES: [&str; 12] = [
    "north (m)",
    "east (m)",
    "down (m)",
    "velocity north (m/s)",
    "velocity east (m/s)",
    "velocity down (m/s)",
    "roll (deg)",
    "pitch (deg)",
    "yaw (deg)",
    "roll rate (deg/s)",
    "pitch rate (deg/s)",
    "yaw rate (deg/s)",
];
const INPUTS: [&str; 7] = [
    "thrust (N)",
    "desired roll (deg)",
    "desired pitch (deg)",
    "desired yaw (deg)",
    "desired roll rate (deg/s)",
    "desired pitch rate (deg/s)",
    "desired yaw rate (deg/s)",
];
const TIME: &str = "time since the start of the trajectory (s)";

/// The whole page, self-contained. `not_flyable` says why the plan may not be flown.
pub fn html(plan: &Plan, not_flyable: Option<&str>, limits: &Limits) -> String {
    let mut page = Page::new(
        &format!("Plan: {}", plan.trajectory),
        &format!("vehicle {}, with the {} model", plan.vehicle, plan.model.kind),
    );
    verdict(plan, not_flyable, &mut page);
    let place = |state: &StateVector| Ned::new(state[0], state[1], state[2]);
    let planned: Vec<Ned> = plan.states.iter().map(place).collect();
    let (desired, path, title, axes): (Vec<Ned>, _, _, _) = if plan.is_fastest() {
        let path = "The planned path, to scale, seen from the south-west.";
        (Vec::new(), path, "Planned", "World axes: north, east, down.")
    } else {
        (
            plan.desired.iter().map(place).collect(),
            "The planned path against the desired one, to scale, seen from the south-west.",
            "Planned and desired",
            "World axes: north, east, down. Desired attitude and rates are those of a vehicle without drag.",
        )
    };
    let around = plan.tube.as_ref().map(|tube| outline(&planned, &tube.radius_m));
    let mut paths: Vec<(&str, &[Ned])> = vec![("planned", &planned)];
    paths.extend(around.as_ref().map(|around| ("tube", &around[..])));
    let scene = Scene { paths: &paths, desired: &desired };
    page.section("Path", path, &scene.to_html());
    if let Some(tube) = &plan.tube {
        let description = format!(
            "A flight stays within the tube from beginning to end with a probability of at least {} %, \
             provided that it is of the same kind as the {} calibration flights. The tube bounds {}.",
            100.0 * tube.confidence,
            tube.flights,
            tube.position.text()
        );
        page.section("Tube", &description, &radius(plan, tube));
    }
    page.section(title, axes, &states(plan));
    page.section(
        "Inputs",
        "The input with which the model follows the plan; a flight sends it early by the vehicle's \
         delay and lag.",
        &inputs(plan),
    );
    page.section(
        "Search",
        "For each subproblem, on a logarithmic scale: the cost above its final value, and the size \
         of the trust region.",
        &search(plan),
    );
    page.section("How this was computed", "", &provenance(plan, limits));
    page.into_html()
}

fn verdict(plan: &Plan, not_flyable: Option<&str>, page: &mut Page) {
    let distances = plan.distances();
    let most = distances.iter().copied().fold(0.0, f64::max);
    let rms = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len().max(1) as f64).sqrt();
    let sentence = match plan.is_fastest() {
        true => format!("The fastest flight found takes {:.2} s.", plan.duration()),
        false => format!(
            "A plan of {:.1} s that stays {} RMS from the desired path, {} at most.",
            plan.duration(),
            length(rms),
            length(most)
        ),
    };
    let reasons: Vec<String> = not_flyable.map(str::to_owned).into_iter().collect();
    let mood = if reasons.is_empty() { Mood::Good } else { Mood::Bad };
    page.verdict(mood, &sentence, &reasons);
    page.figures(&[
        ("search", plan.status.text().to_owned(), Mood::Plain),
        ("cost", significant(plan.cost), Mood::Plain),
        ("subproblems", plan.records.len().to_string(), Mood::Plain),
        ("largest defect of the dynamics", smallness(plan.violation.defect), Mood::Plain),
        ("largest overrun of a bound", smallness(plan.violation.overrun), Mood::Plain),
    ]);
}

/// Values of a row's column; angles in degrees.
fn column<const N: usize>(rows: &[[f64; N]], index: usize, is_angle: bool) -> Vec<f64> {
    let unit = if is_angle { 1_f64.to_degrees() } else { 1.0 };
    rows.iter().map(|row| unit * row[index]).collect()
}

fn states(plan: &Plan) -> String {
    let time: Vec<f64> = (0..plan.states.len()).map(|n| n as f64 * plan.period_s).collect();
    let mut kinds = vec![("planned", Style::Colour(1), &plan.states)];
    if !plan.is_fastest() {
        kinds.push(("desired", Style::Reference, &plan.desired));
    }
    let panels = STATES.iter().enumerate().map(|(i, name)| {
        let curves = kinds.iter().map(|(name, style, rows)| Curve {
            name: (*name).into(),
            style: *style,
            y: column(rows, i, i >= 6),
        });
        Panel { name: (*name).to_owned(), curves: curves.collect() }
    });
    let panels = panels.collect();
    Chart::new(TIME, &time, 80.0, panels).to_html()
}

fn radius(plan: &Plan, tube: &PlannedTube) -> String {
    let time: Vec<f64> = (0..tube.radius_m.len()).map(|n| n as f64 * plan.period_s).collect();
    let y = tube.radius_m.clone();
    let curve = Curve { name: "radius".into(), style: Style::Colour(2), y };
    let panel = Panel { name: "radius (m)".to_owned(), curves: vec![curve] };
    Chart::new(TIME, &time, 80.0, vec![panel]).to_html()
}

fn inputs(plan: &Plan) -> String {
    let time: Vec<f64> = (0..plan.inputs.len()).map(|n| n as f64 * plan.period_s).collect();
    let panels = INPUTS.iter().enumerate().map(|(i, name)| Panel {
        name: (*name).to_owned(),
        curves: vec![Curve {
            name: "planned".into(),
            style: Style::Colour(1),
            y: column(&plan.inputs, i, i >= 1),
        }],
    });
    let panels = panels.collect();
    Chart::new(TIME, &time, 80.0, panels).to_html()
}

fn search(plan: &Plan) -> String {
    let number: Vec<f64> = (1..=plan.records.len()).map(|n| n as f64).collect();
    let log = |value: f64| if value > 0.0 { value.log10() } else { f64::NAN };
    let above = plan.records.iter().map(|r| log(r.cost - plan.cost)).collect();
    let trust = plan.records.iter().map(|r| log(r.trust)).collect();
    let panels = vec![
        Panel {
            name: "log10 of the cost above its final value".into(),
            curves: vec![Curve { name: "cost".into(), style: Style::Colour(1), y: above }],
        },
        Panel {
            name: "log10 of the trust region".into(),
            curves: vec![Curve { name: "trust".into(), style: Style::Colour(2), y: trust }],
        },
    ];
    let mut html = Chart::new("subproblem", &number, 100.0, panels).to_html();
    let mut table = Table::new(&[
        ("subproblem", true),
        ("cost", true),
        ("promised", true),
        ("found", true),
        ("share of the step", true),
        ("trust region", true),
        ("overrun", true),
        ("solver's iterations", true),
    ]);
    for (n, record) in plan.records.iter().enumerate() {
        let mood = if record.share > 0.0 { Mood::Plain } else { Mood::Warning };
        table.row(
            mood,
            &[
                (n + 1).to_string(),
                format!("{:.4}", record.cost),
                format!("{:.2e}", record.promised),
                format!("{:.2e}", record.found),
                record.share.to_string(),
                format!("{:.2e}", record.trust),
                smallness(record.violation.overrun),
                record.solver_iterations.to_string(),
            ],
        );
    }
    html += &table.into_html();
    html
}

fn provenance(plan: &Plan, limits: &Limits) -> String {
    let entries = [
        (
            "model",
            match &plan.model.sha256 {
                Some(hash) => {
                    format!("{}, from the model file with SHA-256 {hash}", plan.model.kind)
                }
                None => format!("{}: the vehicle file's own physics", plan.model.kind),
            },
        ),
        (
            "dynamics",
            format!(
                "Euler steps of {:.1} ms with the on-board attitude loop inside",
                1e3 * plan.period_s
            ),
        ),
        (
            "answer",
            format!(
                "delay {:.1} ms, first-order lag {:.1} ms",
                1e3 * plan.answer.delay_s,
                1e3 * plan.answer.lag_s
            ),
        ),
        (
            "bounds",
            format!(
                "tilt {:.0} deg, body rates {:.0} deg/s, thrust {} to {} of the rotors' maximum",
                limits.tilt_max_rad.to_degrees(),
                limits.body_rate_max_rad_s.to_degrees(),
                limits.thrust_min,
                limits.thrust_max
            ),
        ),
    ];
    definitions(entries.iter().map(|(term, value)| (*term, value.as_str())))
}
