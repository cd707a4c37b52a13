//! The frame of every plot: what is drawn is SVG that stretches with the page, what is read is text
//! of the page beside it, as large on a phone as on a wide screen.

use std::fmt::Write;

use super::axis::Axis;
use super::page::escape;

/// Size of the drawing in its own units: what is drawn is what the page's script reads back, so a
/// unit is how finely a page tells values.
const WIDTH: f64 = 20_000.0;
const HEIGHT: f64 = 5_000.0;
/// Numbers along x on a wide screen; every second one is left out on a narrow one.
const X_TICKS: f64 = 9.0;
/// Pixels between numbers along y.
const Y_SPACING: f64 = 26.0;

/// One frame: its axes, its names, and the marks within.
#[derive(Clone, Debug)]
pub(super) struct Frame<'a> {
    pub(super) x: Axis,
    pub(super) y: Axis,
    /// Pixels.
    pub(super) height: f64,
    /// Name, with the unit.
    pub(super) name: &'a str,
    /// Name and unit of x, below; nothing where another frame below says it.
    pub(super) x_label: Option<&'a str>,
    /// Charts that share x share a group: a look at one is a look at all.
    pub(super) group: Option<&'a str>,
    /// What the picture shows, for who cannot see it.
    pub(super) description: &'a str,
}

impl Frame<'_> {
    /// The figure around `marks`, which [`curve`](Self::curve) and its neighbours make; `texts` are
    /// labels over the drawing.
    pub(super) fn to_html(&self, marks: &str, texts: &str) -> String {
        let Self { x, y, height, .. } = self;
        let name = escape(self.name);
        let mut html = format!(
            "<figure class=\"plot\" data-x=\"{} {}\" data-y=\"{} {}\"",
            x.low, x.high, y.low, y.high
        );
        if let Some(group) = self.group {
            let _ = write!(html, " data-group=\"{}\"", escape(group));
        }
        let _ = write!(
            html,
            "><figcaption><b>{name}</b><span class=\"read\" aria-hidden=\"true\"></span></figcaption>\
             <div class=\"frame\" style=\"height:{height}px\">\
             <svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{}\">",
            escape(self.description)
        );
        self.grid(&mut html);
        let _ = write!(html, "{marks}</svg><div class=\"ticks\" aria-hidden=\"true\">");
        self.numbers(&mut html);
        let _ = write!(html, "</div>{texts}</div>");
        if let Some(label) = self.x_label {
            let _ =
                write!(html, "<div class=\"along\" aria-hidden=\"true\">{}</div>", escape(label));
        }
        html + "</figure>"
    }

    fn grid(&self, html: &mut String) {
        let mut lines = String::new();
        for (value, _) in self.y.ticks(self.y_ticks()) {
            let _ = write!(lines, "M0 {}h{WIDTH}", self.down(value));
        }
        for (value, _) in self.x.ticks(X_TICKS) {
            let _ = write!(lines, "M{} 0v{HEIGHT}", self.across(value));
        }
        let _ = write!(html, "<path class=\"grid\" d=\"{lines}\"/>");
    }

    fn numbers(&self, html: &mut String) {
        for (value, text) in self.y.ticks(self.y_ticks()) {
            let top = 100.0 * (1.0 - self.y.at(value));
            let _ = write!(html, "<span class=\"y\" style=\"top:{top:.1}%\">{text}</span>");
        }
        for (number, (value, text)) in self.x.ticks(X_TICKS).into_iter().enumerate() {
            let (left, class) = (100.0 * self.x.at(value), ["x", "x more"][number % 2]);
            let _ = write!(html, "<span class=\"{class}\" style=\"left:{left:.1}%\">{text}</span>");
        }
    }

    fn y_ticks(&self) -> f64 {
        self.height / Y_SPACING
    }

    fn across(&self, value: f64) -> i64 {
        (WIDTH * self.x.at(value)).round() as i64
    }

    fn down(&self, value: f64) -> i64 {
        (HEIGHT * (1.0 - self.y.at(value))).round() as i64
    }

    /// A curve through points, broken at those that are not finite. `class` is its look, `name`
    /// what it is.
    pub(super) fn curve(
        &self,
        points: impl Iterator<Item = (f64, f64)>,
        class: &str,
        name: &str,
    ) -> String {
        let name = escape(name);
        let data = self.path(points);
        format!(
            "<path class=\"{class}\" data-name=\"{name}\" d=\"{data}\"><title>{name}</title></path>"
        )
    }

    /// Path data: absolute where a part begins, then steps from point to point.
    fn path(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let mut data = String::new();
        let mut pen: Option<(i64, i64)> = None;
        for (x, y) in points {
            if !(x.is_finite() && y.is_finite()) {
                pen = None;
                continue;
            }
            let (across, down) = (self.across(x), self.down(y));
            match pen {
                None => {
                    let _ = write!(data, "M{across} {down}l0 0");
                }
                Some((before, above)) => {
                    let (right, lower) = (across - before, down - above);
                    // A minus parts numbers as well as a space does.
                    let gap = if right < 0 { "" } else { " " };
                    let between = if lower < 0 { "" } else { " " };
                    let _ = write!(data, "{gap}{right}{between}{lower}");
                }
            }
            pen = Some((across, down));
        }
        data
    }

    /// The area between two curves over the same points.
    pub(super) fn ribbon(
        &self,
        x: &[f64],
        low: &[f64],
        high: &[f64],
        class: &str,
        name: &str,
    ) -> String {
        let finite = |i: &usize| x[*i].is_finite() && low[*i].is_finite() && high[*i].is_finite();
        let kept: Vec<usize> = (0..x.len().min(low.len()).min(high.len())).filter(finite).collect();
        let there = kept.iter().map(|i| (x[*i], high[*i]));
        let back = kept.iter().rev().map(|i| (x[*i], low[*i]));
        let data = self.path(there.chain(back));
        if data.is_empty() {
            return data;
        }
        format!("<path class=\"{class}\" data-of=\"{}\" d=\"{data}z\"/>", escape(name))
    }

    /// A dot with what it says when it is pointed at.
    pub(super) fn dot(&self, x: f64, y: f64, class: &str, title: &str) -> String {
        if !(x.is_finite() && y.is_finite()) {
            return String::new();
        }
        let (across, down, title) = (self.across(x), self.down(y), escape(title));
        format!(
            "<path class=\"dot {class}\" d=\"M{across} {down}h0\"><title>{title}</title></path>"
        )
    }

    /// Many dots of one look.
    pub(super) fn dots(&self, points: &[(f64, f64)], class: &str) -> String {
        let mut data = String::new();
        for (x, y) in points.iter().filter(|(x, y)| x.is_finite() && y.is_finite()) {
            let _ = write!(data, "M{} {}h0", self.across(*x), self.down(*y));
        }
        format!("<path class=\"{class}\" d=\"{data}\"/>")
    }

    /// A rectangle.
    pub(super) fn area(&self, x: [f64; 2], y: [f64; 2], class: &str, title: &str) -> String {
        let (left, right) = (self.across(x[0]), self.across(x[1]));
        let (top, bottom) = (self.down(y[1]), self.down(y[0]));
        format!(
            "<path class=\"{class}\" d=\"M{left} {top}H{right}V{bottom}H{left}z\"><title>{}</title></path>",
            escape(title)
        )
    }

    /// A line over the whole height.
    pub(super) fn upright(&self, x: f64, class: &str, title: &str) -> String {
        let (at, title) = (self.across(x), escape(title));
        format!("<path class=\"{class}\" d=\"M{at} 0v{HEIGHT}\"><title>{title}</title></path>")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_path_encodes_the_curve() {
        let axis = |high| Axis { low: 0.0, high };
        let frame = Frame {
            x: axis(2.0),
            y: axis(1.0),
            height: 100.0,
            name: "n",
            x_label: None,
            group: None,
            description: "d",
        };
        let points = [(0.0, 0.0), (1.0, 1.0), (f64::NAN, 0.0), (1.5, 0.5), (2.0, 0.25)];
        let path = frame.path(points.into_iter());
        assert_eq!(path, "M0 5000l0 0 10000-5000M15000 2500l0 0 5000 1250");
    }
}
