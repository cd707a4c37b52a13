//! Predicted against observed, axis by axis and by how hard the vehicle moves, and in a sentence
//! which model is best and where each fails.

use super::AXES;
use crate::learn::summary::{Series, TrainingSummary};
use crate::model::file::ModelKind;
use crate::report::axis::{Axis, range_of, significant};
use crate::report::chart::{Style, legend};
use crate::report::frame::Frame;
use crate::report::page::Mood;
use crate::report::table::Table;

/// Points of a model that are drawn on one axis.
const POINTS: usize = 250;
/// Regimes: thirds of the rows, by the magnitude of what was observed.
const REGIMES: [&str; 3] = ["gentle", "middle", "hard"];
/// A model fails where it leaves more than this share of what was observed.
const FAILS: f64 = 0.5;
const PLAIN: [&str; 6] = ["north", "east", "down", "roll", "pitch", "yaw"];

/// The class of a model's colour, the same as in every other chart.
fn colour(place: usize) -> String {
    let name = ModelKind::ALL.get(place).map_or("", |kind| kind.name());
    Style::of(name, place).class().replace("curve ", "")
}

/// Errors of one model on one axis.
struct Fit {
    model: ModelKind,
    acceleration: usize,
    /// Root mean square error in each regime, over the deviation of what was observed.
    regimes: [f64; 3],
    /// And of all rows.
    all: f64,
}

/// What is observed with what a model says, of every piece on one axis.
fn pairs(summary: &TrainingSummary, acceleration: usize, model: usize) -> Vec<(f64, f64)> {
    let pieces = summary.series.iter().filter(|series| series.acceleration == acceleration);
    let of = |series: &Series| -> Vec<(f64, f64)> {
        let Some(predicted) = series.predicted.get(model) else { return Vec::new() };
        let both = series.observed.iter().copied().zip(predicted.iter().copied());
        both.filter(|(seen, prediction)| seen.is_finite() && prediction.is_finite()).collect()
    };
    pieces.flat_map(of).collect()
}

fn fits(summary: &TrainingSummary) -> Vec<Fit> {
    let mut fits = Vec::new();
    for (place, model) in ModelKind::ALL.into_iter().enumerate() {
        for acceleration in 0..AXES.len() {
            let mut pairs = pairs(summary, acceleration, place);
            let n = pairs.len();
            if n < 3 * REGIMES.len() {
                continue;
            }
            let mean = pairs.iter().map(|(seen, _)| seen).sum::<f64>() / n as f64;
            let square: f64 = pairs.iter().map(|(seen, _)| (seen - mean).powi(2)).sum();
            let deviation = (square / n as f64).sqrt();
            pairs.sort_by(|a, b| (a.0 - mean).abs().total_cmp(&(b.0 - mean).abs()));
            let error = |part: &[(f64, f64)]| {
                let square: f64 =
                    part.iter().map(|(seen, prediction)| (prediction - seen).powi(2)).sum();
                (square / part.len() as f64).sqrt() / deviation.max(f64::MIN_POSITIVE)
            };
            let regimes = [0, 1, 2].map(|k| error(&pairs[k * n / 3..(k + 1) * n / 3]));
            fits.push(Fit { model, acceleration, regimes, all: error(&pairs) });
        }
    }
    fits
}

/// Which model is best, and where each fails.
pub(super) fn sentence(summary: &TrainingSummary) -> String {
    let fits = fits(summary);
    let mean = |model: ModelKind| {
        let of: Vec<f64> =
            fits.iter().filter(|fit| fit.model == model).map(|fit| fit.all).collect();
        of.iter().sum::<f64>() / of.len().max(1) as f64
    };
    let models =
        ModelKind::ALL.into_iter().filter(|model| fits.iter().any(|fit| fit.model == *model));
    let mut ranked: Vec<(ModelKind, f64)> = models.map(|model| (model, mean(model))).collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    let Some((best, error)) = ranked.first() else { return String::new() };
    let failures: Vec<String> = ranked
        .iter()
        .map(|(model, _)| {
            let own = fits.iter().filter(|fit| fit.model == *model);
            let worst = own.max_by(|a, b| a.all.total_cmp(&b.all));
            let Some(worst) = worst else { return String::new() };
            let name = PLAIN[worst.acceleration];
            let share = 100.0 * worst.all;
            match worst.all > FAILS {
                true => format!("{} fails in {name}, where it leaves {share:.0} %", model.name()),
                false => {
                    format!("{} is weakest in {name}, where it leaves {share:.0} %", model.name())
                }
            }
        })
        .collect();
    format!(
        "On the test flight the {} model is closest, with {:.0} % of the deviation left on \
         average; {}. Exact predictions are on the line.",
        best.name(),
        100.0 * error,
        failures.join("; ")
    )
}

/// A frame for each axis, and the table of regimes.
pub(super) fn html(summary: &TrainingSummary) -> String {
    let frames: String = (0..AXES.len()).map(|axis| one(summary, axis)).collect();
    if frames.is_empty() {
        return frames;
    }
    let names = ModelKind::ALL.iter().enumerate();
    let items =
        names.map(|(place, kind)| (kind.name(), format!("curve thin key {}", colour(place))));
    let mut html = legend(items);
    html += &format!("<div class=\"side\">{frames}</div>");
    html += "<h3>Remaining error, by how hard the vehicle moves</h3><p class=\"note\">Root mean \
             square error over the deviation of the observed acceleration, in thirds of the rows \
             by the magnitude of the acceleration.</p>";
    let mut columns = vec![("model", false), ("axis", false)];
    columns.extend(REGIMES.map(|regime| (regime, true)));
    columns.push(("all", true));
    let mut table = Table::new(&columns);
    for fit in fits(summary) {
        let mut cells = vec![fit.model.name().to_owned(), PLAIN[fit.acceleration].to_owned()];
        cells.extend(fit.regimes.map(|error| format!("{:.0} %", 100.0 * error)));
        cells.push(format!("{:.0} %", 100.0 * fit.all));
        table.row(if fit.all > FAILS { Mood::Warning } else { Mood::Plain }, &cells);
    }
    html + &table.into_html()
}

fn one(summary: &TrainingSummary, acceleration: usize) -> String {
    let all: Vec<Vec<(f64, f64)>> =
        (0..ModelKind::ALL.len()).map(|model| pairs(summary, acceleration, model)).collect();
    let values = all.iter().flatten().flat_map(|(seen, prediction)| [*seen, *prediction]);
    let Some(range) = range_of(values) else { return String::new() };
    let axis = Axis::padded(Some(range));
    let label = format!("observed {}", AXES[acceleration]);
    let name = format!("predicted {}", AXES[acceleration]);
    let description = format!(
        "{name} against observed, {} to {}; the table below has the errors.",
        significant(range.0),
        significant(range.1)
    );
    let frame = Frame {
        x: axis,
        y: axis,
        height: 220.0,
        name: &name,
        x_label: Some(&label),
        group: None,
        description: &description,
    };
    let ends = [axis.low, axis.high];
    let mut marks = frame.curve(ends.into_iter().map(|end| (end, end)), "curve ref", "exact");
    for (place, pairs) in all.iter().enumerate() {
        let step = pairs.len().div_ceil(POINTS).max(1);
        let points: Vec<(f64, f64)> = pairs.iter().copied().step_by(step).collect();
        marks += &frame.dots(&points, &format!("cloud {}", colour(place)));
    }
    frame.to_html(&marks, "")
}
