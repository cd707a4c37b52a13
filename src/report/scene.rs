//! The path in space, as seen from above and the south-west, in a parallel projection.

use std::fmt::Write;

use vehicle::frame::Ned;

use super::axis::significant;
use super::chart::Style;

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 480.0;
const MARGIN: f64 = 44.0;
/// Points of a path that are drawn.
const POINTS: usize = 1500;
/// Direction of view: azimuth from north over east, and elevation, rad.
const AZIMUTH: f64 = 0.6;
const ELEVATION: f64 = 0.5;

/// Paths beside the desired one, the first with its shadow on the ground.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// What is drawn in the colours of [`Style::of`]: name, and positions in m; points that are not finite break
    /// the path.
    pub paths: &'a [(&'a str, &'a [Ned])],
    /// Where they should have led.
    pub desired: &'a [Ned],
}

impl Scene<'_> {
    /// The figure.
    pub fn to_html(&self) -> String {
        let all = || {
            let paths = self.paths.iter().flat_map(|(_, path)| path.iter());
            paths.chain(self.desired).filter(|p| p.is_finite())
        };
        let Some(first) = all().next() else {
            return String::from("<p class=\"note\">No positions.</p>");
        };
        let (mut low, mut high) = (first.to_array(), first.to_array());
        for point in all() {
            for (axis, value) in point.to_array().into_iter().enumerate() {
                low[axis] = low[axis].min(value);
                high[axis] = high[axis].max(value);
            }
        }
        let span = (0..3).map(|i| high[i] - low[i]).fold(0.1, f64::max);
        let step = round_step(span / 4.0);
        // The ground's grid, a whole number of squares around the path.
        let floor = high[2];
        let grid = [0, 1].map(|i| ((low[i] / step).floor() * step, (high[i] / step).ceil() * step));
        let grid = grid.map(|(from, to)| if to > from { (from, to) } else { (from, from + step) });
        let corners = [0, 1, 2, 3].map(|c| {
            let [north, east] = grid;
            let pick = |(from, to): (f64, f64), far: bool| if far { to } else { from };
            Ned::new(pick(north, c & 1 == 1), pick(east, c & 2 == 2), floor)
        });
        let view = View::fit(all().copied().chain(corners));

        let mut svg = String::from("<div class=\"legend\">");
        for (place, (name, _)) in self.paths.iter().enumerate() {
            let class = Style::of(name, place).class();
            let _ = write!(
                svg,
                "<span><svg viewBox=\"0 0 24 10\"><path class=\"{class}\" d=\"M0 5H24\"/></svg>{name}</span>"
            );
        }
        let _ = write!(
            svg,
            "<span><svg viewBox=\"0 0 24 10\"><path class=\"curve ref\" d=\"M0 5H24\"/></svg>desired</span>\
             <span><svg viewBox=\"0 0 24 10\"><path class=\"shadow\" d=\"M0 5H24\"/></svg>shadow on the lowest plane</span></div>\
             <svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"3D path\">"
        );
        ground(&view, grid, floor, step, &mut svg);
        if let Some((_, path)) = self.paths.first() {
            let shadow: Vec<Ned> =
                path.iter().map(|p| Ned::new(p.north(), p.east(), floor)).collect();
            polyline(&view, &shadow, "shadow", &mut svg);
        }
        for (place, (name, path)) in self.paths.iter().enumerate() {
            polyline(&view, path, &Style::of(name, place).class(), &mut svg);
        }
        polyline(&view, self.desired, "curve ref", &mut svg);
        self.ends(&view, &mut svg);
        svg.push_str("</svg>");
        svg
    }

    /// Marks where the first path begins and ends, under one name where that is the same place.
    fn ends(&self, view: &View, svg: &mut String) {
        let first = self.paths.first().map_or(&[][..], |(_, path)| path);
        let mut finite = first.iter().filter(|p| p.is_finite());
        let Some(start) = finite.next() else { return };
        let end = finite.next_back().unwrap_or(start);
        let ((x1, y1), (x2, y2)) = (view.at(*start), view.at(*end));
        let together = (x2 - x1).hypot(y2 - y1) < 20.0;
        let names = if together { ("start, end", "") } else { ("start", "end") };
        for (point, name) in [(start, names.0), (end, names.1)] {
            let (x, y) = view.at(*point);
            let _ = write!(
                svg,
                "<circle class=\"mark\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"><title>north {} m, east {} m, up {} m</title></circle>\
                 <text x=\"{:.1}\" y=\"{:.1}\">{name}</text>",
                significant(point.north()),
                significant(point.east()),
                significant(-point.down()),
                x + 8.0,
                y + 14.0
            );
        }
    }
}

/// Maps points in space to pixels.
struct View {
    scale: f64,
    offset: (f64, f64),
}

impl View {
    /// Right and up on the picture, in metres.
    fn project(point: Ned) -> (f64, f64) {
        let (sin, cos) = AZIMUTH.sin_cos();
        let right = point.east() * cos - point.north() * sin;
        let depth = point.east() * sin + point.north() * cos;
        (right, depth * ELEVATION.sin() - point.down() * ELEVATION.cos())
    }

    /// The largest scale at which every point is in the picture.
    fn fit(points: impl Iterator<Item = Ned>) -> Self {
        let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
        for (x, y) in points.map(Self::project) {
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        let (width, height) = ((high.0 - low.0).max(1e-9), (high.1 - low.1).max(1e-9));
        let scale = ((WIDTH - 2.0 * MARGIN) / width).min((HEIGHT - 2.0 * MARGIN) / height);
        let left = (WIDTH - width * scale) / 2.0 - low.0 * scale;
        let top = (HEIGHT - height * scale) / 2.0 + high.1 * scale;
        Self { scale, offset: (left, top) }
    }

    fn at(&self, point: Ned) -> (f64, f64) {
        let (x, y) = Self::project(point);
        (self.offset.0 + x * self.scale, self.offset.1 - y * self.scale)
    }
}

/// 1, 2 or 5 times a power of ten, at least `rough`.
fn round_step(rough: f64) -> f64 {
    let power = 10f64.powf(rough.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|f| f * power).find(|s| *s >= rough).unwrap_or(10.0 * power)
}

/// The grid on the ground, its labels, and a pole of one step upwards.
fn ground(view: &View, [north, east]: [(f64, f64); 2], floor: f64, step: f64, svg: &mut String) {
    let line = |from: Ned, to: Ned, class: &str, svg: &mut String| {
        let ((x1, y1), (x2, y2)) = (view.at(from), view.at(to));
        let _ = write!(svg, "<path class=\"{class}\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>");
    };
    let label = |at: Ned, shift: (f64, f64), anchor: &str, text: String, svg: &mut String| {
        let (x, y) = view.at(at);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{text}</text>",
            x + shift.0,
            y + shift.1
        );
    };
    let marks = |(from, to): (f64, f64)| {
        let count = ((to - from) / step).round() as u32;
        (0..=count).map(move |i| from + f64::from(i) * step)
    };
    let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    // Zero without a sign.
    let number = |v: f64| format!("{:.decimals$}", if v.abs() < step / 2.0 { 0.0 } else { v });
    for n in marks(north) {
        line(Ned::new(n, east.0, floor), Ned::new(n, east.1, floor), "grid", svg);
        label(Ned::new(n, east.1, floor), (8.0, 5.0), "start", number(n), svg);
    }
    for e in marks(east) {
        line(Ned::new(north.0, e, floor), Ned::new(north.1, e, floor), "grid", svg);
        label(Ned::new(north.0, e, floor), (-4.0, 17.0), "middle", number(e), svg);
    }
    let middle = |(from, to): (f64, f64)| (from + to) / 2.0;
    let beside = Ned::new(middle(north), east.1, floor);
    label(beside, (44.0, 18.0), "start", "north (m)".into(), svg);
    label(Ned::new(north.0, middle(east), floor), (-12.0, 36.0), "middle", "east (m)".into(), svg);
    let corner = Ned::new(north.1, east.0, floor);
    let top = Ned::new(north.1, east.0, floor - step);
    line(corner, top, "axis", svg);
    label(top, (8.0, 4.0), "start", format!("{} m up", number(step)), svg);
}

/// A path of at most [`POINTS`] points.
fn polyline(view: &View, points: &[Ned], class: &str, svg: &mut String) {
    let mut data = String::new();
    let mut pen_down = false;
    for point in points.iter().step_by(points.len().div_ceil(POINTS).max(1)) {
        if !point.is_finite() {
            pen_down = false;
            continue;
        }
        let (x, y) = view.at(*point);
        let _ = write!(data, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
        pen_down = true;
    }
    let _ = write!(svg, "<path class=\"{class}\" d=\"{data}\"/>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_up_and_everything_is_in_the_picture() {
        let path: Vec<Ned> =
            (0..100).map(|i| f64::from(i) * 0.1).map(|t| Ned::new(t.sin(), t.cos(), -t)).collect();
        let view = View::fit(path.iter().copied());
        for point in &path {
            let (x, y) = view.at(*point);
            assert!((0.0..=WIDTH).contains(&x) && (0.0..=HEIGHT).contains(&y));
        }
        let ground = view.at(Ned::zero()).1;
        assert!(view.at(Ned::new(0.0, 0.0, -1.0)).1 < ground);
    }

    #[test]
    fn single_point_and_none_draw_without_nan() {
        for flown in [vec![], vec![Ned::zero()], vec![Ned::new(f64::NAN, 0.0, 0.0)]] {
            let html = Scene { paths: &[("flown", &flown)], desired: &[] }.to_html();
            assert!(!html.contains("NaN") && !html.contains("inf"));
        }
    }
}
