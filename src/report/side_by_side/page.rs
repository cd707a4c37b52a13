//! The page of a comparison.

use vehicle::frame::Ned;

use super::{Alignment, Comparison, Difference, Entry, Outcome, Sample, Tested};
use crate::report::bars::{self, Bar};
use crate::report::chart::{Chart, Curve, Panel, Ribbon, Style};
use crate::report::page::{Mood, Page, escape};
use crate::report::scene::Scene;
use crate::report::table::{Table, definitions};
use crate::report::text::{self, length, smallness};

/// Places along the shared axis.
const PLACES: usize = 400;
/// Single flights that are drawn of each group.
const DRAWN: usize = 8;
/// Facts that are listed.
const FACTS: usize = 80;

impl Comparison {
    /// The page, self-contained, of the flights that were compared.
    pub fn to_html(&self, a: &[&Entry], b: &[&Entry]) -> String {
        let mut page = Page::new(
            "Flights side by side",
            &format!("A: {} flights; B: {} flights", a.len(), b.len()),
        );
        self.verdict(&mut page);
        page.section(
            "Differences",
            "B minus A as a share of A, with the 95 % interval over flights; the mark is the mean. \
             B is smaller to the left of zero.",
            &(self.bars() + &self.table()),
        );
        let errors = self.errors(a, b);
        if !errors.is_empty() {
            page.section(
                "Errors along the flights",
                "Signed errors: means over the flights, with their 95 % intervals where there are \
                 several; thin lines are single flights.",
                &errors,
            );
        }
        let path = path(a, b);
        if !path.is_empty() {
            page.section(
                "Paths",
                "The first flight of each, to scale, seen from the south-west.",
                &path,
            );
        }
        page.section(
            "What else differs",
            "Vehicles, settings and versions, as the logs state them. A value that varies within a \
             group cannot alone explain a difference between A and B.",
            &self.facts_table(),
        );
        page.section("Flights", "", &self.flights(a, b));
        page.section("How this was computed", "", &self.provenance());
        page.into_html()
    }

    fn verdict(&self, page: &mut Page) {
        let mood = match self.outcome {
            Outcome::Worse => Mood::Bad,
            Outcome::Better => Mood::Good,
            Outcome::NoDifference => Mood::Plain,
            Outcome::Undecided => Mood::Warning,
        };
        let others = self.differences.iter().skip(1).filter(|d| d.stands());
        let reasons: Vec<String> = others.filter_map(difference_text).collect();
        page.verdict(mood, &self.sentence, &reasons);
    }

    fn bars(&self) -> String {
        let bar = |d: &Difference| {
            let (tested, mean) = (d.tested?, d.a.mean.abs());
            let share = |v: f64| 100.0 * v / mean;
            let [low, high] = tested.interval.map(share);
            let class = match (d.stands(), d.more_is_worse) {
                (false, _) | (_, None) => "noise",
                (true, Some(more)) if (tested.difference > 0.0) == more => "c2",
                (true, Some(_)) => "c3",
            };
            let text = format!("{:+.1} %", share(tested.difference));
            let all = [low, high].iter().all(|v| v.is_finite());
            all.then(|| Bar {
                from: low,
                to: high,
                mark: Some(share(tested.difference)),
                class,
                ..Bar::new(d.metric, 0.0, text)
            })
        };
        bars::to_html(&self.differences.iter().filter_map(bar).collect::<Vec<_>>())
    }

    fn table(&self) -> String {
        let mut table = Table::new(&[
            ("", false),
            ("A", true),
            ("B", true),
            ("B minus A", true),
            ("95 % interval", true),
            ("p", true),
            ("adjusted p", true),
        ]);
        for d in &self.differences {
            let (scale, unit) = shown_unit(d.unit);
            let number = |v: f64| short(scale * v);
            let to_digits_of = |half: f64, v: f64| digits(scale * v, scale * half);
            let mood = match (d.stands(), d.outcome()) {
                (true, Outcome::Worse) => Mood::Bad,
                (true, Outcome::Better) => Mood::Good,
                _ => Mood::Plain,
            };
            let group = |sample: &Sample| match sample.flights {
                1 => number(sample.mean),
                _ => {
                    let [mean, deviation] =
                        [sample.mean, sample.deviation].map(|v| to_digits_of(sample.deviation, v));
                    format!("{mean} \u{b1} {deviation}")
                }
            };
            let name = match unit {
                "" => d.metric.to_owned(),
                unit => format!("{} ({unit})", d.metric),
            };
            let mut cells = vec![name, group(&d.a), group(&d.b)];
            match d.tested {
                Some(tested) => {
                    let half = tested.half_width();
                    let [low, high] = tested.interval.map(|v| to_digits_of(half, v));
                    cells.push(to_digits_of(half, tested.difference));
                    cells.push(format!("{low} to {high}"));
                    cells.push(probability(tested.p));
                    cells.push(d.p_of_all.map_or_else(String::new, probability));
                }
                None => {
                    cells.push(number(d.b.mean - d.a.mean));
                    cells.extend(["unknown"; 3].map(str::to_owned));
                }
            }
            table.row(mood, &cells);
        }
        table.into_html()
    }

    fn errors(&self, a: &[&Entry], b: &[&Entry]) -> String {
        let reach = a.iter().chain(b).map(|entry| entry.reach(self.alignment)).fold(0.0, f64::max);
        if reach <= 0.0 || !reach.is_finite() {
            return String::new();
        }
        let places: Vec<f64> = (0..=PLACES).map(|k| reach * k as f64 / PLACES as f64).collect();
        let mut axes: Vec<(&'static str, &'static str)> = Vec::new();
        for signal in a.iter().chain(b).flat_map(|entry| &entry.signals) {
            if !axes.contains(&(signal.axis, signal.unit)) {
                axes.push((signal.axis, signal.unit));
            }
        }
        let (mut panels, mut ribbons) = (Vec::new(), Vec::new());
        for (axis, unit) in axes {
            let (scale, unit) = shown_unit(unit);
            let (mut curves, mut areas) = (Vec::new(), Vec::new());
            for (group, name, colour) in [(a, "A", 1), (b, "B", 2)] {
                let lines: Vec<Vec<f64>> = group
                    .iter()
                    .filter_map(|entry| entry.along(axis, self.alignment, &places))
                    .map(|line| line.into_iter().map(|error| scale * error).collect())
                    .collect();
                let [mean, low, high] = mean_of(&lines);
                if lines.len() > 1 {
                    for line in lines.into_iter().take(DRAWN) {
                        let name = format!("{name}, single flights");
                        curves.push(Curve { name, style: Style::Thin(colour), y: line });
                    }
                    areas.push(Ribbon { of: name.to_owned(), colour, low, high });
                }
                curves.push(Curve { name: name.to_owned(), style: Style::Colour(colour), y: mean });
            }
            panels.push(Panel { name: format!("{axis} ({unit})"), curves });
            ribbons.push(areas);
        }
        Chart { ribbons, ..Chart::new(self.alignment.label(), &places, 110.0, panels) }.to_html()
    }

    fn facts_table(&self) -> String {
        if self.facts.is_empty() {
            return "<p class=\"note\">The logs state no differences.</p>".into();
        }
        let mut table =
            Table::new(&[("", false), ("A", false), ("B", false), ("varies within", false)]);
        let join = |values: &[String]| {
            let shown: Vec<&str> = values.iter().take(4).map(String::as_str).collect();
            let more = values.len().saturating_sub(4);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            shown.join(", ") + &more
        };
        for fact in self.facts.iter().take(FACTS) {
            let mood = if fact.varies_within { Mood::Plain } else { Mood::Warning };
            let within = if fact.varies_within { "yes" } else { "" };
            table.row(mood, &[fact.key.clone(), join(&fact.a), join(&fact.b), within.to_owned()]);
        }
        let more = self.facts.len().saturating_sub(FACTS);
        let more = match more {
            0 => String::new(),
            n => format!("<p class=\"note\">And {n} more, in the JSON.</p>"),
        };
        table.into_html() + &more
    }

    fn flights(&self, a: &[&Entry], b: &[&Entry]) -> String {
        let shown: Vec<&Difference> = self.differences.iter().take(5).collect();
        let mut columns = vec![("", false), ("flight", false), ("length (s)", true)];
        columns.extend(shown.iter().map(|d| (d.metric, true)));
        columns.push(("pair", true));
        let mut table = Table::new(&columns);
        for (side, (name, group)) in [("A", a), ("B", b)].into_iter().enumerate() {
            for (place, entry) in group.iter().enumerate() {
                let mut cells =
                    vec![name.to_owned(), entry.name.clone(), format!("{:.1}", entry.duration_s)];
                for d in &shown {
                    let found = entry.metrics.iter().find(|(metric, _)| metric.name == d.metric);
                    cells.push(found.map_or_else(|| "-".to_owned(), |(_, v)| value(*v, d.unit)));
                }
                let pair = self.pairs.iter().position(|pair| pair[side] == place);
                cells.push(pair.map_or_else(|| "-".to_owned(), |pair| (pair + 1).to_string()));
                table.row(Mood::Plain, &cells);
            }
        }
        table.into_html()
    }

    fn provenance(&self) -> String {
        let pairing = match self.paired_by {
            Some(by) => format!("{} pairs, by {by}", self.pairs.len()),
            None => {
                "none: not every flight has one partner with its trajectory and seed".to_owned()
            }
        };
        let test = self
            .differences
            .iter()
            .find_map(|d| d.tested)
            .map_or("none: too few flights", |t| t.test.text());
        definitions([
            ("pairs", pairing.as_str()),
            (
                "test",
                &format!(
                    "{test} on one number per flight; the interval excludes zero in one of twenty \
                     comparisons of flights that do not differ"
                ),
            ),
            (
                "adjusted p",
                "adjusted after Holm for all rows: below 0.05 a row differs, whatever the others \
                 do. The first row alone decides whether B is worse, by its own interval",
            ),
            (
                "errors",
                "flown minus desired along the trajectory; for a log without one, reported minus \
                 setpoint, while airborne",
            ),
            (
                "aligned by",
                match self.alignment {
                    Alignment::Time => "time",
                    Alignment::Position => "position",
                    Alignment::Phase => "phase",
                },
            ),
        ])
    }
}

fn difference_text(difference: &Difference) -> Option<String> {
    let tested = difference.tested?;
    let [by, low, high] = signed(&tested, difference.unit);
    Some(format!("{}: {by} ({low} to {high})", difference.metric))
}

/// Degrees for people.
fn shown_unit(unit: &str) -> (f64, &str) {
    match unit {
        "rad" => (1_f64.to_degrees(), "deg"),
        "rad/s" => (1_f64.to_degrees(), "deg/s"),
        "0..1" => (1.0, ""),
        other => (1.0, other),
    }
}

/// A number with its unit.
pub(super) fn value(value: f64, unit: &str) -> String {
    let (scale, unit) = shown_unit(unit);
    match unit {
        "m" if value < 0.0 => format!("-{}", length(-value)),
        "m" => length(value),
        unit => format!("{} {unit}", short(scale * value)).trim_end().to_owned(),
    }
}

/// A probability to three decimals.
fn probability(p: f64) -> String {
    if p < 5e-4 { "< 0.001".to_owned() } else { format!("{p:.3}") }
}

/// Four digits, without zeros at the end; a tiny number by its power of ten.
fn short(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-4 { smallness(value) } else { text::short(value) }
}

/// A number to two digits of the half width of its interval: further digits say nothing.
fn digits(value: f64, half: f64) -> String {
    if half < 1e-9 {
        return short(value);
    }
    let decimals = (1.0 - half.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

/// A difference and the ends of its interval, each with its sign and unit.
pub(super) fn signed(tested: &Tested, unit: &str) -> [String; 3] {
    let (scale, shown) = shown_unit(unit);
    let [low, high] = tested.interval;
    [tested.difference, low, high].map(|difference| {
        let sign = if difference > 0.0 { "+" } else { "" };
        match unit {
            "m" => sign.to_owned() + &value(difference, unit),
            _ => {
                let number = digits(scale * difference, scale * tested.half_width());
                format!("{sign}{number} {shown}").trim_end().to_owned()
            }
        }
    })
}

/// Mean of lines at each place, and its interval's edges; NaN where fewer than half of them are.
fn mean_of(lines: &[Vec<f64>]) -> [Vec<f64>; 3] {
    let places = lines.iter().map(Vec::len).min().unwrap_or(0);
    let mut all = [const { Vec::new() }; 3];
    for place in 0..places {
        let there: Vec<f64> =
            lines.iter().map(|line| line[place]).filter(|v| v.is_finite()).collect();
        let sample = Sample::of(&there).filter(|sample| 2 * sample.flights >= lines.len());
        let (mean, half) = sample.map_or((f64::NAN, f64::NAN), |sample| {
            (sample.mean, sample.half_interval().unwrap_or(f64::NAN))
        });
        for (edge, value) in all.iter_mut().zip([mean, mean - half, mean + half]) {
            edge.push(value);
        }
    }
    all
}

fn path(a: &[&Entry], b: &[&Entry]) -> String {
    let (Some(a), Some(b)) = (a.first(), b.first()) else { return String::new() };
    let points = |path: &[(f64, Ned)]| path.iter().map(|(_, point)| *point).collect::<Vec<Ned>>();
    let (of_a, of_b, desired) = (points(&a.flown), points(&b.flown), points(&a.desired));
    if of_a.is_empty() && of_b.is_empty() {
        return String::new();
    }
    let paths: [(&str, &[Ned]); 2] = [("A", &of_a), ("B", &of_b)];
    let scene = Scene { paths: &paths, desired: &desired }.to_html();
    let names = format!("A: {}; B: {}.", a.name, b.name);
    format!("{scene}<p class=\"note\">{}</p>", escape(&names))
}
