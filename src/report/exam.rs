//! An exam's result: a table for the terminal, and a page with the reliability picture and the
//! detection curves.

use std::fmt::Write;

use super::axis::Axis;
use super::frame::Frame;
use super::page::{Mood, Page};
use super::table::{Table, definitions};
use crate::exam::interval::Rate;
use crate::exam::score::Row;
use crate::exam::summary::{
    BRIER_MAX, Bound, CALIBRATION_MAX, Detection, FamilySummary, Measure, Summary, TargetResult,
};
use crate::exam::world::{FileKind, LoopKind};

/// Height of a figure's frame, pixels.
const HEIGHT: f64 = 220.0;

/// Where an exam's numbers come from.
#[derive(Clone, Copy, Debug)]
pub struct Provenance<'a> {
    /// Seed of the exam.
    pub seed: u64,
    /// SHA-256 of the key.
    pub commitment: &'a str,
    /// Wall time of the flights and of the diagnoses, s.
    pub wall_s: [f64; 2],
}

/// The table for the terminal.
pub fn text(summary: &Summary, rows: &[Row]) -> String {
    let mut text = String::new();
    for row in rows {
        let [case, kind, truth, ratio, verdict, found] = cells(row);
        let (grade, world) = (row.grade.name(), world(row));
        let _ = writeln!(
            text,
            "{grade:10} {case} {kind:9} {world:22} {truth:30} {ratio:>6}  {verdict:7} {found}"
        );
    }
    text.push('\n');
    for measure in &summary.measures {
        let mark = mark(measure.result());
        let (name, rate) = (measure.name, percent(&measure.rate));
        let _ = writeln!(text, "{name:42} {rate:30} {}{mark}", bound_text(measure));
    }
    let mark = mark(summary.brier_result());
    let _ = writeln!(text, "{:42} {}{mark}", brier_name(), number(summary.brier));
    let mark = self::mark(summary.calibration_result());
    let error = number(summary.calibration_error);
    let _ = writeln!(text, "{:42} {error}{mark}", calibration_name());
    for (name, value) in numbers(summary) {
        let _ = writeln!(text, "{name:42} {value}");
    }
    if summary.has_few_cases() {
        text += &format!("\n{}\n", too_few(summary));
    }
    text += "\nprobability     mean   true\n";
    for line in &summary.reliability {
        let [low, high] = line.probabilities;
        let share = percent(&line.is_true);
        let off = if line.holds() { "" } else { "  off" };
        let _ = writeln!(text, "{low:.2} - {high:.2}   {:.3}   {share}{off}", line.mean);
    }
    if !summary.families.is_empty() {
        let _ = writeln!(
            text,
            "\n{:48} {:30} {:30} {:30} Brier",
            "family", "right or acceptable", "named first", "confidently wrong"
        );
        for family in &summary.families {
            let (good, named) = (percent(&family.good), percent(&family.named));
            let (wrong, brier) = (percent(&family.confidently_wrong), number(family.brier));
            let name = family_name(family);
            let _ = writeln!(text, "{name:48} {good:30} {named:30} {wrong:30} {brier}");
        }
    }
    text += "\nstrength        named                           noticed\n";
    for line in &summary.detection {
        let (named, noticed) = (percent(&line.named), percent(&line.noticed));
        let _ = writeln!(text, "{:14}  {named:30}  {noticed}", strengths(line));
    }
    text +=
        "\neffect              named where detectable          error   90 % intervals that hold\n";
    for effect in &summary.effects {
        let (named, covered) = (percent(&effect.named), percent(&effect.covered));
        let error = number(effect.error);
        let _ = writeln!(text, "{:18}  {named:30}  {error:6}  {covered}", effect.id);
    }
    if summary.conditions.iter().any(|line| line.condition != summary.conditions[0].condition) {
        text += "\nround trip                        named                           90 % intervals that hold\n";
        for line in &summary.conditions {
            let (named, covered) = (percent(&line.named), percent(&line.covered));
            let _ = writeln!(
                text,
                "{:18} {:12}  {named:30}  {covered}",
                line.id,
                line.condition.name()
            );
        }
    }
    text
}

/// The page, self-contained.
pub fn html(summary: &Summary, rows: &[Row], provenance: &Provenance<'_>) -> String {
    let result = |result: TargetResult| -> Vec<String> {
        let lines = |measure: &Measure| {
            format!("{}: {} ({})", measure.name, percent(&measure.rate), bound_text(measure))
        };
        let mut all: Vec<String> = summary.of(result).map(lines).collect();
        let scores = [
            (summary.brier_result(), brier_name(), summary.brier),
            (summary.calibration_result(), calibration_name(), summary.calibration_error),
        ];
        let lines =
            scores.into_iter().filter(|(is, ..)| *is == result && *is != TargetResult::Kept);
        all.extend(lines.map(|(_, name, value)| format!("{name}: {}", number(value))));
        all
    };
    let (failures, open) = (result(TargetResult::Missed), result(TargetResult::TooFew));
    let subtitle = format!("{} cases, seed {}", rows.len(), provenance.seed);
    let mut page = Page::new("Exam of the diagnosis", &subtitle);
    if failures.is_empty() && (summary.has_few_cases() || !open.is_empty()) {
        page.verdict(Mood::Plain, &too_few(summary), &open);
    } else if failures.is_empty() {
        page.verdict(Mood::Good, "Every rate meets its target.", &[]);
    } else {
        let count = failures.len();
        let miss = if count == 1 { "figure misses" } else { "figures miss" };
        page.verdict(Mood::Warning, &format!("{count} {miss} the target."), &failures);
    }
    page.section(
        "Rates",
        "As counted, with Wilson's 95 % interval. An effect is of practical size at three \
         tolerances of the vehicle file, and three times noise when every number of the file has \
         moved by that much; with an exact file, at twice noise.",
        &measures(summary),
    );
    page.section(
        "Reliability",
        "How often an effect is present, by its stated probability: on the line, probabilities are \
         calibrated.",
        &reliability(summary),
    );
    if !summary.families.is_empty() {
        page.section(
            "By family",
            "By law, loop and file, then by all three. Named first: of causes of practical size.",
            &families(summary),
        );
    }
    if !summary.effects.is_empty() {
        page.section(
            "Detection",
            "Share of single effects that are named first, by how strongly they show; at 1 the nominal simulator's prediction error due to the effect equals that of noise.",
            &detection(summary),
        );
        page.section(
            "By effect",
            "Singles; errors and intervals where detectable. The last columns give how many were \
             named first, by strength from the heading's up to the next.",
            &effects(summary),
        );
    }
    if !summary.conditions.is_empty() {
        page.section("By effect and state of the log", "", &conditions(summary));
    }
    page.section("Cases", "", &cases(rows));
    let [flying, diagnosing] = provenance.wall_s.map(|s| format!("{s:.0} s"));
    let check =
        "sha256sum key.json: commitment.txt held the same digits before the first diagnosis";
    page.section(
        "How the exam was run",
        "A separate process diagnosed each case, in a folder with only that case's vehicle file \
         and logs.",
        &definitions([
            ("key", provenance.commitment),
            ("to check", check),
            ("flying took", flying.as_str()),
            ("diagnosing took", diagnosing.as_str()),
        ]),
    );
    page.into_html()
}

/// Says that the cases are too few to decide the rates.
fn too_few(summary: &Summary) -> String {
    format!(
        "{} cases are too few to tell whether the diagnosis meets its targets: with so few, a \
         single case decides.",
        summary.count
    )
}

fn mood(result: TargetResult) -> Mood {
    match result {
        TargetResult::Kept => Mood::Good,
        TargetResult::TooFew => Mood::Plain,
        TargetResult::Missed => Mood::Bad,
    }
}

/// The remark after a rate in the table.
fn mark(result: TargetResult) -> &'static str {
    match result {
        TargetResult::Kept => "",
        TargetResult::TooFew => "  too few to tell",
        TargetResult::Missed => "  missed",
    }
}

/// The loop and the file of a case.
fn world(row: &Row) -> String {
    let on_board = match row.on_board {
        LoopKind::Pd => "PD",
        LoopKind::Cascade => "cascade",
        LoopKind::CascadeUnlogged => "cascade unlogged",
    };
    let file = match row.file {
        FileKind::Exact => "exact",
        FileKind::Claimed => "off",
        FileKind::Unclaimed => "off unclaimed",
    };
    format!("{on_board}, {file}")
}

/// Case, kind, truth, strength, verdict, what was found.
fn cells(row: &Row) -> [String; 6] {
    let mut found: Vec<String> = row
        .probabilities
        .iter()
        .filter(|(_, p)| *p >= 0.05)
        .map(|(id, p)| format!("{id} {p:.2}"))
        .collect();
    if !row.ambiguous_with.is_empty() {
        found.push(format!("or {}", row.ambiguous_with.join(", ")));
    }
    if row.verdict == "missing" {
        found.push(row.finding.clone());
    }
    [
        row.case.clone(),
        row.kind.name().to_owned(),
        row.truth.join(" + "),
        format!("{:.2}", row.ratio),
        row.verdict.clone(),
        found.join(", "),
    ]
}

fn bound_text(measure: &Measure) -> String {
    match measure.wanted {
        Some(Bound::AtLeast(least)) => format!(">= {:.0} %", 100.0 * least),
        Some(Bound::AtMost(most)) => format!("<= {:.0} %", 100.0 * most),
        None => String::new(),
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.3}"))
}

fn brier_name() -> String {
    format!("Brier score, practical causes and nulls (<= {BRIER_MAX})")
}

fn calibration_name() -> String {
    format!("expected calibration error (<= {CALIBRATION_MAX})")
}

fn numbers(summary: &Summary) -> [(&'static str, String); 5] {
    let [claimed, truly] = summary.closure.map(number);
    let apart = number(summary.closure_off);
    [
        ("Brier score of every case", number(summary.brier_of_all)),
        ("median relative parameter error", number(summary.error)),
        ("90 % intervals that hold", percent(&summary.covered)),
        ("median closure", format!("{claimed} claimed, {truly} true, {apart} apart")),
        ("median time of a diagnosis, s", number(summary.seconds)),
    ]
}

/// A rate with its interval and its counts.
fn percent(rate: &Rate) -> String {
    let Some(value) = rate.rate else { return "-".to_owned() };
    let [low, high] = rate.interval.map(|bound| 100.0 * bound);
    format!("{:.1} % [{low:.1}, {high:.1}] {}/{}", 100.0 * value, rate.count, rate.of)
}

/// As [`percent`], without line breaks on a page.
fn unbroken(rate: &Rate) -> String {
    percent(rate).replace(' ', "\u{a0}")
}

fn strengths(line: &Detection) -> String {
    let [low, high] = line.strengths;
    if high.is_finite() { format!("{low:.1} - {high:.1}") } else { format!("{low:.1} -") }
}

fn measures(summary: &Summary) -> String {
    let mut table = Table::new(&[("", false), ("measured", false), ("target", false)]);
    for measure in &summary.measures {
        let mood = match (measure.wanted, measure.rate.of) {
            (None, _) | (_, 0) => Mood::Plain,
            _ => mood(measure.result()),
        };
        let cells = [measure.name.to_owned(), unbroken(&measure.rate), bound_text(measure)];
        table.row(mood, &cells);
    }
    table.row(mood(summary.brier_result()), &[brier_name(), number(summary.brier), String::new()]);
    let error = number(summary.calibration_error);
    let cells = [calibration_name(), error, String::new()];
    table.row(mood(summary.calibration_result()), &cells);
    for (name, value) in numbers(summary) {
        table.row(Mood::Plain, &[name.to_owned(), value, String::new()]);
    }
    table.into_html()
}

/// A point of a figure with its interval.
struct Point {
    x: f64,
    rate: Rate,
    label: String,
}

/// Shares over something, with their intervals, and a dashed line to compare them with.
fn figure(name: &str, x_label: &str, x: Axis, points: &[Point], line: [[f64; 2]; 2]) -> String {
    let known = points.iter().filter(|point| point.rate.rate.is_some());
    let lines: Vec<String> =
        known.map(|point| format!("{}: {}", point.label, percent(&point.rate))).collect();
    let description = format!("{name} over {x_label}. {}.", lines.join("; "));
    let frame = Frame {
        x,
        y: Axis::exact(Some((0.0, 1.0))),
        height: HEIGHT,
        name,
        x_label: Some(x_label),
        group: None,
        description: &description,
    };
    let mut marks = frame.curve(line.iter().map(|[x, y]| (*x, *y)), "curve ref", "to compare with");
    let curve = points.iter().filter_map(|point| Some((point.x, point.rate.rate?)));
    marks += &frame.curve(curve, "curve c1", name);
    for point in points {
        let Some(rate) = point.rate.rate else { continue };
        let [low, high] = point.rate.interval;
        marks += &frame.curve(
            [(point.x, low), (point.x, high)].into_iter(),
            "interval",
            "95 % interval",
        );
        let title = format!("{}: {}", point.label, percent(&point.rate));
        marks += &frame.dot(point.x, rate, "c1", &title);
    }
    frame.to_html(&marks, "")
}

fn reliability(summary: &Summary) -> String {
    let points: Vec<Point> = summary
        .reliability
        .iter()
        .map(|line| {
            let [low, high] = line.probabilities;
            Point { x: line.mean, rate: line.is_true, label: format!("{low:.2} to {high:.2}") }
        })
        .collect();
    let x = Axis::exact(Some((0.0, 1.0)));
    let line = [[0.0, 0.0], [1.0, 1.0]];
    figure("share that is true", "stated probability, mean", x, &points, line)
}

fn detection(summary: &Summary) -> String {
    let points: Vec<Point> = summary
        .detection
        .iter()
        .map(|line| {
            let [low, high] = line.strengths;
            let middle = (low.max(0.35) * if high.is_finite() { high } else { 2.0 * low }).sqrt();
            Point { x: middle.log10(), rate: line.named, label: strengths(line) }
        })
        .collect();
    let x = Axis::exact(Some((-0.5, 1.4)));
    let threshold = [[2.0_f64.log10(), 0.0], [2.0_f64.log10(), 1.0]];
    let label = "strength, log10 of signal over noise (dashed: twice the threshold)";
    figure("share named first", label, x, &points, threshold)
}

fn effects(summary: &Summary) -> String {
    let curves: Vec<String> =
        summary.detection.iter().map(|line| format!("{:.1}+", line.strengths[0])).collect();
    let mut columns = vec![
        ("", false),
        ("named where detectable", false),
        ("median error", true),
        ("90 % intervals that hold", false),
    ];
    columns.extend(curves.iter().map(|heading| (heading.as_str(), true)));
    let mut table = Table::new(&columns);
    for effect in &summary.effects {
        let mut cells = vec![
            effect.id.clone(),
            unbroken(&effect.named),
            number(effect.error),
            unbroken(&effect.covered),
        ];
        for pooled in &summary.detection {
            let own = effect.detection.iter().find(|line| line.strengths == pooled.strengths);
            cells.push(
                own.map_or(String::new(), |line| format!("{}/{}", line.named.count, line.named.of)),
            );
        }
        table.row(Mood::Plain, &cells);
    }
    table.into_html()
}

fn family_name(family: &FamilySummary) -> String {
    let parts = [
        family.law.map(|law| law.name()),
        family.on_board.map(|on_board| on_board.name()),
        family.file.map(|file| file.name()),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" / ")
}

fn families(summary: &Summary) -> String {
    let columns = [
        ("", false),
        ("right or acceptable", false),
        ("named first", false),
        ("confidently wrong", false),
        ("Brier", true),
    ];
    let mut table = Table::new(&columns);
    for family in &summary.families {
        let cells = [
            family_name(family),
            unbroken(&family.good),
            unbroken(&family.named),
            unbroken(&family.confidently_wrong),
            number(family.brier),
        ];
        table.row(Mood::Plain, &cells);
    }
    table.into_html()
}

fn conditions(summary: &Summary) -> String {
    let columns =
        [("", false), ("log", false), ("named", false), ("90 % intervals that hold", false)];
    let mut table = Table::new(&columns);
    for line in &summary.conditions {
        let condition = line.condition.name().to_owned();
        let cells = [line.id.clone(), condition, unbroken(&line.named), unbroken(&line.covered)];
        table.row(Mood::Plain, &cells);
    }
    table.into_html()
}

fn cases(rows: &[Row]) -> String {
    let columns = [
        ("case", false),
        ("kind", false),
        ("loop and file", false),
        ("truth", false),
        ("strength", true),
        ("grade", false),
        ("verdict", false),
        ("found", false),
    ];
    let mut table = Table::new(&columns);
    for row in rows {
        let [case, kind, truth, ratio, verdict, found] = cells(row);
        let cells =
            [case, kind, world(row), truth, ratio, row.grade.name().to_owned(), verdict, found];
        table.row(if row.grade.is_good() { Mood::Good } else { Mood::Bad }, &cells);
    }
    table.into_html()
}
