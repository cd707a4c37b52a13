//! An exam's result: a table for the terminal and a page.

use crate::exam::interval::Rate;
use crate::exam::score::Row;
use crate::exam::summary::{Bound, Summary};

/// The table for the terminal.
pub fn text(summary: &Summary, rows: &[Row]) -> String {
    let mut text = String::new();
    for row in rows {
        let found: Vec<String> = row
            .probabilities
            .iter()
            .filter(|(_, p)| *p >= 0.05)
            .map(|(id, p)| format!("{id} {p:.2}"))
            .collect();
        let right = if row.verdict_right() && (row.truth.is_empty() || row.top_right) {
            "ok"
        } else {
            "--"
        };
        text += &format!(
            "{right} {} {:9} {:28} snr {:6.2}  {:7} {}{}\n",
            row.case,
            name(row),
            row.truth.join("+"),
            row.ratio,
            row.verdict,
            found.join(", "),
            if row.ambiguous_with.is_empty() {
                String::new()
            } else {
                format!("  or {}", row.ambiguous_with.join(", "))
            },
        );
    }
    text += "\n";
    for measure in &summary.measures {
        let wanted = match measure.wanted {
            Some(Bound::AtLeast(least)) => format!(">= {:.0} %", 100.0 * least),
            Some(Bound::AtMost(most)) => format!("<= {:.0} %", 100.0 * most),
            None => String::new(),
        };
        let mark = if measure.holds() { "" } else { "  missed" };
        text += &format!("{:42} {:30} {wanted}{mark}\n", measure.name, percent(&measure.rate));
    }
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
    text += &format!("{:42} {}  (<= 0.08)\n", "Brier", number(summary.brier));
    text += &format!("{:42} {}\n", "median relative parameter error", number(summary.error));
    text += &format!("{:42} {}\n", "90 % intervals that hold", percent(&summary.covered));
    text += &format!(
        "{:42} {} claimed, {} true, {} apart\n",
        "median closure",
        number(summary.closure[0]),
        number(summary.closure[1]),
        number(summary.closure_off)
    );
    text += "\nprobability     mean   true\n";
    for line in &summary.reliability {
        let [low, high] = line.probabilities;
        text += &format!("{low:.2} - {high:.2}   {:.3}   {}\n", line.mean, percent(&line.is_true));
    }
    text += "\nstrength        named                           noticed\n";
    for line in &summary.detection {
        let [low, high] = line.strengths;
        let range = format!("{low:.1} - {high:.1}");
        text += &format!("{range:14}  {:30}  {}\n", percent(&line.named), percent(&line.noticed));
    }
    text +=
        "\neffect              named where detectable          error   90 % intervals that hold\n";
    for effect in &summary.effects {
        text += &format!(
            "{:18}  {:30}  {:6}  {}\n",
            effect.id,
            percent(&effect.named),
            number(effect.error),
            percent(&effect.covered)
        );
    }
    text
}

/// The page.
pub fn html(summary: &Summary, rows: &[Row], seed: u64, commitment: &str) -> String {
    format!(
        "<!doctype html><meta charset=utf-8><title>exam</title><p>seed {seed}, key {commitment}</p><pre>{}</pre>",
        text(summary, rows)
    )
}

fn name(row: &Row) -> String {
    format!("{:?}", row.kind).to_lowercase()
}

/// A rate with its counts and its interval.
fn percent(rate: &Rate) -> String {
    let Some(value) = rate.rate else { return "-".to_owned() };
    let [low, high] = rate.interval.map(|bound| 100.0 * bound);
    format!("{:5.1} % [{low:.1}, {high:.1}] {}/{}", 100.0 * value, rate.count, rate.of)
}
