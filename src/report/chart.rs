//! Charts as inline SVG: curves over a shared x axis.

use std::fmt::Write;

use super::axis::{Axis, LABELLED_BOTTOM, LEFT, RIGHT, TOP, WIDTH, grid, range_of, significant};
use super::page::escape;

/// Room above the first panel for the names of the bands.
const NAMES: f64 = 17.0;
const BOTTOM: f64 = 22.0;
/// Columns of a chart within which only the smallest and the largest value are drawn.
const BUCKETS: usize = 600;
/// Places along x that show their values when pointed at.
const HOVERS: usize = 60;

/// How a curve looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// One of five colours, 1 to 5, each with a dash pattern of its own.
    Colour(u8),
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

/// Panels of curves below one another that share an x axis.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// Name and unit of x.
    pub x_label: &'a str,
    /// Values of x, ascending.
    pub x: &'a [f64],
    /// Background.
    pub bands: &'a [Band],
    /// Height of a panel's frame in pixels.
    pub height: f64,
    /// Panels.
    pub panels: Vec<Panel>,
}

/// One frame of a [`Chart`].
#[derive(Clone, Debug)]
pub struct Panel {
    /// Name, with the unit.
    pub name: String,
    /// Curves; each is drawn over those before it, which show through the gaps of its dashes.
    pub curves: Vec<Curve>,
}

impl Chart<'_> {
    /// The legend and the panels. Curves of one name and look share a line of the legend; a curve
    /// that is alone in its panel needs none.
    pub fn to_html(&self) -> String {
        let mut html = self.legend();
        let last = self.panels.len().saturating_sub(1);
        for (number, panel) in self.panels.iter().enumerate() {
            self.panel(panel, number == 0, number == last, &mut html);
        }
        html
    }

    fn legend(&self) -> String {
        let mut seen: Vec<(&str, Style)> = Vec::new();
        let crowded = self.panels.iter().filter(|p| p.curves.len() > 1);
        for curve in crowded.flat_map(|p| &p.curves) {
            if !seen.contains(&(&curve.name, curve.style)) {
                seen.push((&curve.name, curve.style));
            }
        }
        let items: String = seen
            .iter()
            .map(|(name, style)| {
                format!(
                    "<span><svg viewBox=\"0 0 24 10\"><path class=\"{}\" d=\"M0 5H24\"/></svg>{}</span>",
                    style.class(),
                    escape(name)
                )
            })
            .collect();
        format!("<div class=\"legend\">{items}</div>")
    }

    fn panel(&self, panel: &Panel, first: bool, last: bool, html: &mut String) {
        let bottom = if last { LABELLED_BOTTOM } else { BOTTOM };
        let top = if first && !self.bands.is_empty() { TOP + NAMES } else { TOP };
        let height = top + self.height + bottom;
        let x = Axis::exact(range(self.x), LEFT, WIDTH - RIGHT);
        let values = panel.curves.iter().flat_map(|c| &c.y).copied();
        let y = Axis::padded(range_of(values), top + self.height, top);
        let name = escape(&panel.name);
        let _ = write!(
            html,
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{name}\">"
        );
        self.background(&x, top, first, html);
        grid(&x, &y, html);
        let _ = write!(html, "<text class=\"name\" x=\"{LEFT}\" y=\"{}\">{name}</text>", top - 7.0);
        if last {
            let label = escape(self.x_label);
            let (at, below) = ((LEFT + WIDTH - RIGHT) / 2.0, height - 5.0);
            let _ = write!(
                html,
                "<text x=\"{at}\" y=\"{below}\" text-anchor=\"middle\">{label}</text>"
            );
        }
        for curve in &panel.curves {
            let path = path(self.x, &curve.y, &x, &y);
            let _ = write!(
                html,
                "<path class=\"{}\" d=\"{path}\"><title>{}</title></path>",
                curve.style.class(),
                escape(&curve.name)
            );
        }
        self.hovers(panel, &x, top, html);
        html.push_str("</svg>");
    }

    /// Every second band is shaded; names stand above the first panel, where they fit.
    fn background(&self, x: &Axis, top: f64, named: bool, html: &mut String) {
        for (number, band) in self.bands.iter().enumerate() {
            let (from, to) = (x.at(band.from.max(x.low)), x.at(band.to.min(x.high)));
            let width = to - from;
            if width.is_nan() || width <= 0.0 {
                continue;
            }
            if number % 2 == 0 {
                let _ = write!(
                    html,
                    "<rect class=\"band\" x=\"{from:.1}\" y=\"{top}\" width=\"{width:.1}\" height=\"{}\"/>",
                    self.height
                );
            }
            if named && width > 7.0 * band.name.chars().count() as f64 {
                let _ = write!(
                    html,
                    "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                    (from + to) / 2.0,
                    top - NAMES - 6.0,
                    escape(&band.name)
                );
            }
        }
    }

    fn hovers(&self, panel: &Panel, x: &Axis, top: f64, html: &mut String) {
        let step = (WIDTH - RIGHT - LEFT) / HOVERS as f64;
        for slot in 0..HOVERS {
            let left = LEFT + slot as f64 * step;
            let wanted = x.value(left + step / 2.0);
            let index = self.x.partition_point(|v| *v < wanted);
            let Some(at) = self.x.get(index) else { continue };
            let _ = write!(
                html,
                "<rect class=\"hover\" x=\"{left:.1}\" y=\"{top}\" width=\"{step:.1}\" height=\"{}\"><title>{at:.2}",
                self.height
            );
            for curve in &panel.curves {
                if let Some(value) = curve.y.get(index).filter(|v| v.is_finite()) {
                    let _ = write!(html, "\n{}: {}", escape(&curve.name), significant(*value));
                }
            }
            html.push_str("</title></rect>");
        }
    }
}

fn range(values: &[f64]) -> Option<(f64, f64)> {
    range_of(values.iter().copied())
}

/// The curve as path data: within each bucket only its extremes, in their order.
fn path(xs: &[f64], ys: &[f64], x: &Axis, y: &Axis) -> String {
    let mut data = String::new();
    let mut pen_down = false;
    let points = xs.len().min(ys.len());
    let per_bucket = points.div_ceil(BUCKETS).max(1);
    for start in (0..points).step_by(per_bucket) {
        let bucket = start..(start + per_bucket).min(points);
        let mut extremes: Option<(usize, usize)> = None;
        for i in bucket.clone() {
            if xs[i].is_finite() && ys[i].is_finite() {
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
                for i in (first..=second).step_by((second - first).max(1)) {
                    let command = if pen_down { 'L' } else { 'M' };
                    let _ = write!(data, "{command}{:.1} {:.1}", x.at(xs[i]), y.at(ys[i]));
                    pen_down = true;
                }
            }
            pen_down &= xs[i].is_finite() && ys[i].is_finite();
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_has_its_colour_whoever_is_beside_it() {
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
        let (x, y) = (Axis::exact(range(&xs), 0.0, 900.0), Axis::exact(range(&ys), 100.0, 0.0));
        let drawn = path(&xs, &ys, &x, &y);
        assert!(drawn.contains(" 0.0") && drawn.len() < 20_000);
        let gap = path(&[0.0, 1.0, 2.0], &[0.0, f64::NAN, 1.0], &x, &y);
        assert_eq!(gap.matches('M').count(), 2);
    }

    #[test]
    fn nothing_and_constants_draw_without_nan() {
        for y in [vec![], vec![f64::NAN; 3], vec![5.0; 3], vec![f64::INFINITY; 3]] {
            let curve = Curve { name: "a".into(), style: Style::Reference, y };
            let panel = Panel { name: "p".into(), curves: vec![curve] };
            let chart = Chart {
                x_label: "t",
                x: &[0.0, 1.0, 2.0],
                bands: &[],
                height: 100.0,
                panels: vec![panel],
            };
            assert!(!chart.to_html().contains("NaN"));
        }
    }
}
