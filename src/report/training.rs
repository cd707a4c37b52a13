//! The page of a training's report.

mod against;

use super::axis::significant;
use super::chart::{Chart, Curve, Panel, Style};
use super::page::{Mood, Page};
use super::table::{Table, definitions};
use super::text::{effects, smallness};
use crate::learn::evaluation::{ACCELERATION_NAMES, OneStep};
use crate::learn::judgement::{Best, standing};
use crate::learn::summary::{LearningCurve, Series, TrainingSummary};
use crate::model::file::ModelKind;

/// Parts of the rows, in the order of the summary.
const PARTS: [&str; 3] = ["training", "validation", "test"];
/// Accelerations with their units, as on axes.
const AXES: [&str; 6] = [
    "north (m/s\u{b2})",
    "east (m/s\u{b2})",
    "down (m/s\u{b2})",
    "roll (rad/s\u{b2})",
    "pitch (rad/s\u{b2})",
    "yaw (rad/s\u{b2})",
];

/// The whole page, self-contained.
pub fn html(summary: &TrainingSummary) -> String {
    let seconds: f64 = summary.data.logs.iter().map(|log| log.usable_s).sum();
    let mut page = Page::new(
        &format!("Training report: {}", summary.vehicle),
        &format!(
            "networks, physics and their hybrid from {} logs, {seconds:.0} s of flight",
            summary.data.logs.len()
        ),
    );
    verdict(summary, &mut page);
    let against = against::html(summary);
    if !against.is_empty() {
        page.section("Predicted against observed", &against::sentence(summary), &against);
    }
    page.section(
        "Over time",
        "Accelerations of a test flight, which no model was trained on: the label, and each \
         model's prediction at the same state and input.",
        &series(summary, &[0, 1, 2, 3, 4, 5]),
    );
    page.section(
        "One step",
        "Mean squared error of the accelerations over the variance of the training labels: 1 is no \
         better than the mean. Truth is the simulator's, where the logs contain it.",
        &one_step(summary),
    );
    page.section(
        "Open loop",
        "From the reported state at the start of a window and the recorded inputs alone; root mean square over windows of the test part, every 0.25 s.",
        &multi_step(summary),
    );
    page.section(
        "Learning",
        "Normalised mean squared error of each pass, on a logarithmic scale, for the \
         regularisation that validation chose.",
        &learning(summary),
    );
    page.section("Data", "", &data(summary));
    page.section("How this was computed", "", &provenance(summary));
    page.into_html()
}

/// Errors on the test rows: against the truth where it is known.
fn tested(summary: &TrainingSummary, kind: ModelKind) -> Option<(&OneStep, bool)> {
    let errors = summary.one_step.iter().find(|errors| errors.model == kind)?;
    let truth = errors.truth[2].as_ref().map(|errors| (errors, true));
    truth.or(errors.labels[2].as_ref().map(|errors| (errors, false)))
}

fn verdict(summary: &TrainingSummary, page: &mut Page) {
    let kind = summary.preferred;
    let mut reasons = Vec::new();
    let refused = summary.data.refused.len();
    if refused > 0 {
        reasons.push(format!("{refused} logs were excluded entirely; they are listed below"));
    }
    for errors in &summary.one_step {
        if let [Some(training), _, Some(test)] = &errors.labels {
            for (name, training, test) in [
                ("linear", training.linear, test.linear),
                ("angular", training.angular, test.angular),
            ] {
                if test > 1.1 * training {
                    reasons.push(format!(
                        "{}: the {name} test error is {:.0} % above that of training",
                        errors.model.name(),
                        100.0 * (test / training - 1.0)
                    ));
                }
            }
        }
    }
    let best = standing(summary).best;
    reasons.extend(best.reason().map(str::to_owned));
    let sentence = sentence(best, kind, tested(summary, kind));
    let mood = if reasons.is_empty() { Mood::Good } else { Mood::Warning };
    page.verdict(mood, &sentence, &reasons);
    let mut figures = Vec::new();
    for (errors, label) in summary.one_step.iter().zip([
        ["test error, net, linear", "test error, net, angular"],
        ["test error, physics, linear", "test error, physics, angular"],
        ["test error, hybrid, linear", "test error, hybrid, angular"],
    ]) {
        if let Some(test) = &errors.labels[2] {
            figures.push((label[0], percent(test.linear), Mood::Plain));
            figures.push((label[1], percent(test.angular), Mood::Plain));
        }
    }
    figures.push(("delay", format!("{:.1} ms", 1e3 * summary.actuation.delay_s), Mood::Plain));
    figures.push(("rotors' lag", format!("{:.1} ms", 1e3 * summary.actuation.lag_s), Mood::Plain));
    page.figures(&figures);
}

/// How the model stands that is taken, and what it leaves on the test rows.
fn sentence(best: Best, kind: ModelKind, tested: Option<(&OneStep, bool)>) -> String {
    let name = kind.name();
    let praise = match best {
        Best::NotJudged => {
            format!("The models' predictions could not be judged; the {name} model is selected")
        }
        Best::NotFinite => return "No model can be used.".to_owned(),
        Best::NoBetterThanHolding => format!("No model is good; the {name} model is selected"),
        Best::Better => format!("The {name} model predicts best on the validation flights"),
    };
    match tested {
        Some((errors, truth)) => format!(
            "{praise}; on the test flights it leaves {} of the variance of the linear and {} of the angular accelerations{}.",
            percent(errors.linear),
            percent(errors.angular),
            if truth { ", against the simulator's truth" } else { "" }
        ),
        None => format!("{praise}."),
    }
}

fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share))
}

/// Charts of these accelerations, as far as the summary has them, in this order.
pub(super) fn series(summary: &TrainingSummary, shown: &[usize]) -> String {
    let mut html = String::new();
    for acceleration in shown {
        let all = summary.series.iter();
        for series in all.filter(|series| series.acceleration == *acceleration) {
            html += &one_series(series);
        }
    }
    html
}

fn one_series(series: &Series) -> String {
    let mut curves = vec![Curve {
        name: "observed".into(),
        style: Style::Reference,
        y: series.observed.clone(),
    }];
    for (place, (kind, y)) in ModelKind::ALL.iter().zip(&series.predicted).enumerate() {
        let name: String = kind.name().into();
        curves.push(Curve { style: Style::of(&name, place), name, y: y.clone() });
    }
    let name = format!("{} in {}", AXES[series.acceleration], series.run);
    let (x_label, x) = ("time (s)", series.time_s.as_slice());
    let panels = vec![Panel { name, curves }];
    Chart::new(x_label, x, 190.0, panels).to_html()
}

fn one_step(summary: &TrainingSummary) -> String {
    let mut columns = vec![("model", false), ("rows", false), ("linear", true), ("angular", true)];
    columns.extend(ACCELERATION_NAMES.map(|name| (name, true)));
    let mut table = Table::new(&columns);
    let mut row = |name: &str, part: &str, errors: Option<&OneStep>| {
        let Some(errors) = errors else { return };
        let mut cells = vec![name.to_owned(), part.to_owned()];
        cells.extend([errors.linear, errors.angular].map(|e| format!("{e:.4}")));
        cells.extend(errors.each.map(|e| format!("{e:.4}")));
        table.row(Mood::Plain, &cells);
    };
    for errors in &summary.one_step {
        for (part, labels) in PARTS.iter().zip(&errors.labels) {
            row(errors.model.name(), part, labels.as_ref());
        }
        for (part, truth) in PARTS.iter().zip(&errors.truth) {
            row(errors.model.name(), &format!("{part}, truth"), truth.as_ref());
        }
    }
    row("labels", "against truth", summary.data.label_error.as_ref());
    table.into_html()
}

fn multi_step(summary: &TrainingSummary) -> String {
    let Some(first) = summary.multi_step.first() else {
        return "<p class=\"note\">No window fits into the test part.</p>".into();
    };
    let mut table = Table::new(&[
        ("horizon", false),
        ("predictor", false),
        ("position (m)", true),
        ("velocity (m/s)", true),
        ("attitude (rad)", true),
        ("body rate (rad/s)", true),
    ]);
    for (index, horizon) in first.horizons_s.iter().enumerate() {
        for predictor in &summary.multi_step {
            let e = &predictor.errors[index];
            let values = [e.position_m, e.velocity_m_s, e.attitude_rad, e.rate_rad_s];
            let mut cells = vec![format!("{horizon} s"), predictor.predictor.clone()];
            cells.extend(values.map(significant));
            table.row(Mood::Plain, &cells);
        }
    }
    format!("{}<p class=\"note\">{} windows.</p>", table.into_html(), first.windows)
}

fn learning(summary: &TrainingSummary) -> String {
    let mut html = String::new();
    for curve in summary.curves.iter().filter(|curve| curve.chosen) {
        let passes: Vec<f64> = (1..=curve.training.len()).map(|pass| pass as f64).collect();
        let log = |loss: f64| loss.max(f64::MIN_POSITIVE).log10();
        let training = curve.training.iter().map(|loss| log(*loss)).collect();
        let panels = vec![Panel {
            name: format!("{} {}: log10 of the error", curve.model.name(), curve.network),
            curves: vec![
                Curve { name: "training".into(), style: Style::Colour(1), y: training },
                Curve { name: "validation".into(), style: Style::Colour(2), y: held(curve) },
            ],
        }];
        let x = passes.as_slice();
        html += &Chart::new("pass", x, 120.0, panels).to_html();
    }
    let mut table = Table::new(&[
        ("network", false),
        ("regularisation", true),
        ("best pass", true),
        ("training", true),
        ("validation", true),
        ("chosen", false),
    ]);
    for curve in &summary.curves {
        let at = curve.best_pass.saturating_sub(1);
        let error = |value: Option<f64>| value.map_or("unknown".to_owned(), |e| format!("{e:.5}"));
        let cells = [
            format!("{} {}", curve.model.name(), curve.network),
            curve.regularization.to_string(),
            curve.best_pass.to_string(),
            error(curve.training.get(at).copied()),
            error(curve.validation.get(at).copied().flatten()),
            if curve.chosen { "yes" } else { "" }.to_owned(),
        ];
        table.row(Mood::Plain, &cells);
    }
    html + &table.into_html()
}

/// The validation error's logarithm, held from one look to the next.
fn held(curve: &LearningCurve) -> Vec<f64> {
    let mut last = f64::NAN;
    let looks = curve.validation.iter();
    looks
        .map(|look| {
            last = look.map_or(last, |loss| loss.max(f64::MIN_POSITIVE).log10());
            last
        })
        .collect()
}

fn data(summary: &TrainingSummary) -> String {
    let mut table = Table::new(&[
        ("log", false),
        ("used (s)", true),
        ("rows", true),
        ("for", false),
        ("input from", false),
        ("left out", false),
        ("SHA-256", false),
    ]);
    for log in &summary.data.logs {
        let parts: Vec<&str> = log.parts.iter().map(|part| PARTS[*part as usize]).collect();
        let left_out: Vec<String> =
            log.left_out.iter().map(|(why, amount)| format!("{why}: {amount}")).collect();
        table.row(
            Mood::Plain,
            &[
                log.run.clone(),
                format!("{:.1}", log.usable_s),
                log.rows.to_string(),
                parts.join(", "),
                log.source.clone(),
                left_out.join("; "),
                log.sha256.chars().take(12).collect(),
            ],
        );
    }
    let mut html = table.into_html();
    if !summary.data.refused.is_empty() {
        let mut table = Table::new(&[("log excluded entirely", false), ("why", false)]);
        for log in &summary.data.refused {
            let cells = [log.path.display().to_string(), log.reason.clone()];
            table.row(Mood::Warning, &cells);
        }
        html += &table.into_html();
    }
    html
}

fn provenance(summary: &TrainingSummary) -> String {
    let [training, validation, test] = summary.data.rows;
    let settings = &summary.settings;
    let actuation = &summary.actuation;
    let entries = [
        (
            "rows",
            format!("100 per second: {training} training, {validation} validation, {test} test"),
        ),
        (
            "split",
            match summary.data.split {
                crate::learn::split::SplitKind::WholeFlights => "whole flights".to_owned(),
                crate::learn::split::SplitKind::Blocks => {
                    "contiguous blocks of each flight, 1 s apart".to_owned()
                }
            },
        ),
        (
            "labels",
            format!(
                "angular: slope of the least-squares line through the gyro within {:.0} ms; linear: {}. -3 dB bandwidth {:.1} Hz. Inputs are averaged with the window that makes both comparable",
                1e3 * settings.window_half_s,
                summary.data.acceleration.name(),
                summary.data.label_bandwidth_hz
            ),
        ),
        (
            "actuation",
            format!(
                "delay {:.1} ms, first-order lag {:.1} ms, thrust with the voltage ratio to the power {:.2}; found on the training rows",
                1e3 * actuation.delay_s,
                1e3 * actuation.lag_s,
                actuation.voltage_exponent
            ),
        ),
        (
            "networks",
            format!(
                "{} hidden units, {:?} features, at most {} passes of {:?}, seed {}{}",
                settings.hidden,
                settings.features,
                settings.passes,
                settings.method,
                settings.seed,
                if summary.net_corrected { "; the net corrected by its open loop" } else { "" }
            ),
        ),
        (
            "physics",
            format!(
                "{}; angular damping [{}] N m s",
                effects(&summary.physics.effects),
                summary.physics.angular_damping_nms.map(smallness).join(", ")
            ),
        ),
        ("frames", "world north, east, down; body front, right, down; SI, rad".to_owned()),
    ];
    definitions(entries.iter().map(|(term, value)| (*term, value.as_str())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_model_better_than_holding_is_praised() {
        let errors = OneStep { each: [0.1; 6], linear: 0.1, angular: 0.2, rows: 100 };
        let headline = |best| sentence(best, ModelKind::Net, Some((&errors, false)));
        let leaves = "; on the test flights it leaves 10.00 % of the variance";
        let good = format!("The net model predicts best on the validation flights{leaves}");
        assert!(headline(Best::Better).starts_with(&good), "{}", headline(Best::Better));
        let poor = format!("No model is good; the net model is selected{leaves}");
        let found = headline(Best::NoBetterThanHolding);
        assert!(found.starts_with(&poor), "{found}");
        assert_eq!(headline(Best::NotFinite), "No model can be used.");
    }
}
