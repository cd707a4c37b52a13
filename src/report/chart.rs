//! Charts: curves over a shared x axis.

use std::fmt::Write;

use super::axis::{Axis, range_of, significant};
use super::frame::Frame;
use super::page::escape;

/// Columns of a chart within which only the smallest and the largest value are drawn.
const BUCKETS: usize = 1500;
/// Widths of a frame on a phone and on a desk, pixels.
const PHONE: f64 = 310.0;
const DESK: f64 = 880.0;

/// How a curve looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// One of five colours, 1 to 5, each with a dash pattern of its own.
    Colour(u8),
    /// One of them, thin, without dashes: one of many of a kind.
    Thin(u8),
    /// Dashed and neutral: what was wanted.
    Reference,
}

impl Style {
    /// The colour of what a controller, a model or a vehicle file did: the same in every chart of a
    /// page. `place` is its own among those that have no fixed one, from 0 on.
    pub fn of(name: &str, place: usize) -> Self {
        let names = ["model-free", "net", "physics", "hybrid", "replanned"];
        let fixed = names.iter().position(|fixed| *fixed == name);
        Self::Colour((fixed.unwrap_or(place) % names.len()) as u8 + 1)
    }

    /// Its class in the page's style sheet.
    pub(super) fn class(self) -> String {
        match self {
            Self::Colour(number) => format!("curve c{number}"),
            Self::Thin(number) => format!("curve thin c{number}"),
            Self::Reference => "curve ref".into(),
        }
    }
}

/// One curve; NaN leaves a gap.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Looks.
    pub style: Style,
    /// One value for each x of the chart.
    pub y: Vec<f64>,
}

/// An area around a curve, in its colour.
#[derive(Clone, Debug)]
pub struct Ribbon {
    /// Name of the curve.
    pub of: String,
    /// Its colour, 1 to 5.
    pub colour: u8,
    /// Lower edge.
    pub low: Vec<f64>,
    /// Upper edge.
    pub high: Vec<f64>,
}

/// A part of the x axis with a name, drawn as a background.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Where it begins.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Its name.
    pub name: String,
}

/// An instant that is worth a look.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// When.
    pub at: f64,
    /// What happened.
    pub text: String,
    /// Whether it is an error, not a warning.
    pub bad: bool,
}

/// Panels of curves below one another that share an x axis.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// Name and unit of x. Charts of a page with the same one zoom together.
    pub x_label: &'a str,
    /// Values of x, ascending.
    pub x: &'a [f64],
    /// Background.
    pub bands: &'a [Band],
    /// Instants over all panels.
    pub marks: &'a [Mark],
    /// The part of x that is shown; all of it where it is not said.
    pub span: Option<(f64, f64)>,
    /// Whether y begins at zero.
    pub from_zero: bool,
    /// Height of a panel's frame in pixels.
    pub height: f64,
    /// Panels.
    pub panels: Vec<Panel>,
    /// Areas below the curves, for each panel; none where there are fewer.
    pub ribbons: Vec<Vec<Ribbon>>,
}

/// One frame of a [`Chart`].
#[derive(Clone, Debug)]
pub struct Panel {
    /// Name, with the unit.
    pub name: String,
    /// Curves; each is drawn over those before it, which show through the gaps of its dashes.
    pub curves: Vec<Curve>,
}

impl<'a> Chart<'a> {
    /// Panels over all of `x`, without a background.
    pub fn new(x_label: &'a str, x: &'a [f64], height: f64, panels: Vec<Panel>) -> Self {
        let (bands, marks, ribbons) = (&[], &[], Vec::new());
        Self { x_label, x, bands, marks, span: None, from_zero: false, height, panels, ribbons }
    }

    /// The legend and the panels. Curves of one name and look share a line of the legend; a curve
    /// that is alone in its panel needs none.
    pub fn to_html(&self) -> String {
        let mut html = {
            let class = if self.bands.is_empty() { "chart" } else { "chart phases" };
            format!("<div class=\"{class}\">{}", self.legend())
        };
        let last = self.panels.len().saturating_sub(1);
        for (number, panel) in self.panels.iter().enumerate() {
            let ribbons = self.ribbons.get(number).map_or(&[][..], Vec::as_slice);
            html += &self.panel(panel, ribbons, number == 0, number == last);
        }
        html + "</div>"
    }

    fn legend(&self) -> String {
        let mut seen: Vec<(&str, Style)> = Vec::new();
        let crowded = self.panels.iter().filter(|p| p.curves.len() > 1);
        for curve in crowded.flat_map(|p| &p.curves) {
            // Many of a kind are named once, by the first.
            let known = seen.iter().any(|(name, style)| {
                *style == curve.style && (*name == curve.name || matches!(style, Style::Thin(_)))
            });
            if !known {
                seen.push((&curve.name, curve.style));
            }
        }
        legend(seen.iter().map(|(name, style)| (*name, style.class())))
    }

    fn panel(&self, panel: &Panel, ribbons: &[Ribbon], first: bool, last: bool) -> String {
        let values = panel.curves.iter().flat_map(|c| &c.y);
        let edges = ribbons.iter().flat_map(|r| r.low.iter().chain(&r.high));
        let zero = self.from_zero.then_some(0.0);
        let description = self.description(panel);
        let frame = Frame {
            x: Axis::exact(self.span.or(range_of(self.x.iter().copied()))),
            y: Axis::padded(range_of(values.chain(edges).copied().chain(zero))),
            height: self.height,
            name: &panel.name,
            x_label: last.then_some(self.x_label),
            group: Some(self.x_label),
            description: &description,
        };
        let (mut marks, texts) = self.background(&frame, first);
        for ribbon in ribbons {
            let class = format!("ribbon c{}", ribbon.colour);
            marks += &frame.ribbon(self.x, &ribbon.low, &ribbon.high, &class, &ribbon.of);
        }
        for curve in &panel.curves {
            let points = thinned(self.x, &curve.y).into_iter();
            marks += &frame.curve(points, &curve.style.class(), &curve.name);
        }
        frame.to_html(&marks, &texts)
    }

    /// A panel in words.
    fn description(&self, panel: &Panel) -> String {
        let mut text = panel.name.clone();
        if let Some((from, to)) = range_of(self.x.iter().copied()) {
            let _ = write!(
                text,
                " over {}, {} to {}.",
                self.x_label,
                significant(from),
                significant(to)
            );
        }
        const DESCRIBED_CURVES: usize = 6;
        for curve in panel.curves.iter().take(DESCRIBED_CURVES) {
            let name = &curve.name;
            let Some((low, high)) = range_of(curve.y.iter().copied()) else {
                let _ = write!(text, " {name}: no data.");
                continue;
            };
            let finite: Vec<f64> = curve.y.iter().copied().filter(|y| y.is_finite()).collect();
            let mean = finite.iter().sum::<f64>() / finite.len() as f64;
            let [low, high, mean] = [low, high, mean].map(significant);
            let _ = write!(text, " {name}: {low} to {high}, mean {mean}.");
        }
        let more = panel.curves.len().saturating_sub(DESCRIBED_CURVES);
        if more > 0 {
            let _ = write!(text, " And {more} more curves.");
        }
        text
    }

    /// Every second band is shaded; names stand over the first panel.
    fn background(&self, frame: &Frame<'_>, named: bool) -> (String, String) {
        let (mut drawn, mut texts) = (String::new(), String::new());
        let (x, y) = (frame.x, frame.y);
        for (number, band) in self.bands.iter().enumerate() {
            let (from, to) = (band.from.max(x.low), band.to.min(x.high));
            if (to - from).is_nan() || to <= from {
                continue;
            }
            if number % 2 == 0 {
                drawn += &frame.area([from, to], [y.low, y.high], "band", &band.name);
            }
            if named {
                let (left, width) = (100.0 * x.at(from), 100.0 * (x.at(to) - x.at(from)));
                let name = escape(&band.name);
                // What a name needs of a frame as wide as on a phone, and as on a desk.
                let needs = 7.2 * band.name.chars().count() as f64;
                let fits = match 0.01 * width {
                    share if needs < share * PHONE => "",
                    share if needs < share * DESK => " more",
                    _ => " off",
                };
                let _ = write!(
                    texts,
                    "<span class=\"phase{fits}\" data-x=\"{from} {to}\" title=\"{name}\" \
                     style=\"left:{left:.2}%;width:{width:.2}%\">{name}</span>"
                );
            }
        }
        for mark in self.marks.iter().filter(|mark| (x.low..=x.high).contains(&mark.at)) {
            let class = if mark.bad { "instant bad" } else { "instant" };
            drawn += &frame.upright(mark.at, class, &mark.text);
        }
        (drawn, texts)
    }
}

/// A legend: names with the classes of their curves.
pub(super) fn legend<'a>(items: impl Iterator<Item = (&'a str, String)>) -> String {
    let items: String = items
        .map(|(name, class)| {
            let name = escape(name);
            format!(
                "<span data-name=\"{name}\"><svg viewBox=\"0 0 24 10\" aria-hidden=\"true\">\
                 <path class=\"{class}\" d=\"M0 5H24\"/></svg>{name}</span>"
            )
        })
        .collect();
    if items.is_empty() { items } else { format!("<div class=\"legend\">{items}</div>") }
}

/// The points that are drawn: within each bucket only the extremes, in their order; a gap stays one.
fn thinned(xs: &[f64], ys: &[f64]) -> Vec<(f64, f64)> {
    let points = xs.len().min(ys.len());
    let per_bucket = points.div_ceil(BUCKETS).max(1);
    // Two points of two need no bucket.
    if per_bucket <= 2 {
        return xs.iter().copied().zip(ys.iter().copied()).collect();
    }
    let mut kept = Vec::with_capacity(2 * BUCKETS);
    for start in (0..points).step_by(per_bucket) {
        let bucket = start..(start + per_bucket).min(points);
        let mut extremes: Option<(usize, usize)> = None;
        for i in bucket.clone() {
            let finite = xs[i].is_finite() && ys[i].is_finite();
            if finite {
                let (least, most) = extremes.unwrap_or((i, i));
                extremes = Some((
                    if ys[i] < ys[least] { i } else { least },
                    if ys[i] > ys[most] { i } else { most },
                ));
                if i + 1 < bucket.end {
                    continue;
                }
            }
            // The bucket's end, or a gap in it.
            if let Some((least, most)) = extremes.take() {
                let (first, second) = (least.min(most), least.max(most));
                kept.push((xs[first], ys[first]));
                if second > first {
                    kept.push((xs[second], ys[second]));
                }
            }
            if !finite && kept.last().is_some_and(|(_, y)| y.is_finite()) {
                kept.push((f64::NAN, f64::NAN));
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controller_colour_does_not_depend_on_its_neighbours() {
        assert_eq!(Style::of("net", 0), Style::of("net", 3));
        assert_ne!(Style::of("physics", 0), Style::of("hybrid", 0));
        assert_eq!(Style::of("as shipped", 0), Style::Colour(1));
        assert_eq!(Style::of("improved", 1), Style::Colour(2));
        assert_eq!(Style::of("another", 7), Style::Colour(3));
    }

    #[test]
    fn decimation_keeps_a_lone_spike_and_breaks_at_nan() {
        let xs: Vec<f64> = (0..100_000).map(f64::from).collect();
        let mut ys = vec![0.0; xs.len()];
        ys[54_321] = 1.0;
        ys[70_000] = f64::NAN;
        let drawn = thinned(&xs, &ys);
        assert!(drawn.contains(&(54_321.0, 1.0)) && drawn.len() < 2 * BUCKETS + 4);
        assert_eq!(drawn.iter().filter(|(_, y)| y.is_nan()).count(), 1);
    }

    #[test]
    fn empty_and_constant_curves_draw_without_nan() {
        for y in [vec![], vec![f64::NAN; 3], vec![5.0; 3], vec![f64::INFINITY; 3]] {
            let curve = Curve { name: "a".into(), style: Style::Reference, y };
            let panel = Panel { name: "p".into(), curves: vec![curve] };
            let chart = Chart::new("t", &[0.0, 1.0, 2.0], 100.0, vec![panel]);
            let html = chart.to_html();
            assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        }
    }

    #[test]
    fn chart_description_states_its_numbers() {
        let curve = Curve { name: "flown".into(), style: Style::Colour(1), y: vec![1.0, 3.0] };
        let panel = Panel { name: "north (m)".into(), curves: vec![curve] };
        let chart = Chart::new("time (s)", &[0.0, 2.0], 100.0, vec![panel]);
        let expected = "north (m) over time (s), 0 to 2.000. flown: 1.000 to 3.000, mean 2.000.";
        assert!(chart.to_html().contains(expected), "{}", chart.to_html());
    }
}
