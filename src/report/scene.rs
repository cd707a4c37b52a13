//! The path in space, as seen from above and the south-west, in a parallel projection. The page's
//! script turns it.

use std::fmt::Write;

use vehicle::frame::Ned;

use super::axis::significant;
use super::chart::{Style, legend};
use super::page::escape;

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
        let middle = |(from, to): (f64, f64)| (from + to) / 2.0;
        let pole = Ned::new(grid[0].1, grid[1].0, floor - step);
        let mut picture = Picture {
            view: View::fit(all().copied().chain(corners).chain([pole])),
            centre: Ned::new(middle(grid[0]), middle(grid[1]), (low[2] + floor) / 2.0),
            unit: span * 1e-4,
            svg: String::new(),
            labels: String::new(),
        };
        picture.ground(grid, floor, step);
        if let Some((name, path)) = self.paths.first() {
            let shadow: Vec<Ned> =
                path.iter().map(|p| Ned::new(p.north(), p.east(), floor)).collect();
            picture.path(&shadow, "shadow", name);
        }
        for (place, (name, path)) in self.paths.iter().enumerate() {
            picture.path(path, &Style::of(name, place).class(), name);
        }
        picture.path(self.desired, "curve ref", "desired");
        self.ends(&mut picture);
        let named = self.paths.iter().enumerate();
        let mut items: Vec<(&str, String)> =
            named.map(|(place, (name, _))| (*name, Style::of(name, place).class())).collect();
        if self.desired.iter().any(|p| p.is_finite()) {
            items.push(("desired", "curve ref".to_owned()));
        }
        items.push(("shadow on the lowest plane", "shadow".to_owned()));
        let extent = |axis: usize, sign: f64| {
            let ends = [sign * low[axis], sign * high[axis]];
            [ends[0].min(ends[1]), ends[0].max(ends[1])].map(significant).join(" to ")
        };
        let names: Vec<&str> = self.paths.iter().map(|(name, _)| *name).collect();
        let description = format!(
            "3D path: {}. North {} m, east {} m, up {} m.",
            names.join(", "),
            extent(0, 1.0),
            extent(1, 1.0),
            extent(2, -1.0)
        );
        format!(
            "<div class=\"chart\">{}<figure class=\"scene\" data-view=\"{AZIMUTH} {ELEVATION}\">\
             <svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">{}</svg>\
             <div class=\"labels\" aria-hidden=\"true\">{}</div></figure></div>",
            legend(items.iter().map(|(name, class)| (*name, class.clone()))),
            escape(&description),
            picture.svg,
            picture.labels
        )
    }

    /// Marks where the first path begins and ends, under one name where that is the same place.
    fn ends(&self, picture: &mut Picture) {
        let first = self.paths.first().map_or(&[][..], |(_, path)| path);
        let mut finite = first.iter().filter(|p| p.is_finite());
        let Some(start) = finite.next() else { return };
        let end = finite.next_back().unwrap_or(start);
        let ((x1, y1), (x2, y2)) = (picture.view.at(*start), picture.view.at(*end));
        let together = (x2 - x1).hypot(y2 - y1) < 20.0;
        let names = if together { ["start, end", ""] } else { ["start", "end"] };
        for (point, name) in [start, end].into_iter().zip(names) {
            picture.path(&[*point, *point], "dot", name);
            picture.label(*point, "start", name);
        }
    }
}

/// A picture that grows: each of its parts knows its points in space too, for the script.
struct Picture {
    view: View,
    /// What the picture turns about.
    centre: Ned,
    /// Of the points that the script reads, m.
    unit: f64,
    svg: String,
    labels: String,
}

impl Picture {
    /// A point in space, in units around the centre.
    fn point(&self, point: Ned) -> String {
        let [n, e, d] = (point - self.centre).to_array().map(|m| (m / self.unit).round() as i64);
        format!("{n} {e} {d}")
    }

    /// A path of at most [`POINTS`] points.
    fn path(&mut self, points: &[Ned], class: &str, name: &str) {
        let (mut data, mut space) = (String::new(), String::new());
        let mut pen_down = false;
        for point in points.iter().step_by(points.len().div_ceil(POINTS).max(1)) {
            if !point.is_finite() {
                pen_down = false;
                continue;
            }
            let (x, y) = self.view.at(*point);
            let _ = write!(data, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
            let _ = write!(space, "{}{}", if pen_down { ' ' } else { ',' }, self.point(*point));
            pen_down = true;
        }
        let (space, name) = (space.trim_start_matches(','), escape(name));
        let title = match class {
            "grid" | "axis" => String::new(),
            _ => format!("<title>{name}</title>"),
        };
        let _ = write!(
            self.svg,
            "<path class=\"{class}\" data-name=\"{name}\" data-p=\"{space}\" d=\"{data}\">{title}</path>"
        );
    }

    fn label(&mut self, at: Ned, side: &str, text: &str) {
        let (x, y) = self.view.at(at);
        let (left, top) = (100.0 * x / WIDTH, 100.0 * y / HEIGHT);
        let _ = write!(
            self.labels,
            "<span class=\"{side}\" data-p=\"{}\" style=\"left:{left:.1}%;top:{top:.1}%\">{}</span>",
            self.point(at),
            escape(text)
        );
    }

    /// The grid on the ground, its labels, and a pole of one step upwards.
    fn ground(&mut self, [north, east]: [(f64, f64); 2], floor: f64, step: f64) {
        let marks = |(from, to): (f64, f64)| {
            let count = ((to - from) / step).round() as u32;
            (0..=count).map(move |i| from + f64::from(i) * step)
        };
        let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
        // Zero without a sign.
        let number = |v: f64| format!("{:.decimals$}", if v.abs() < step / 2.0 { 0.0 } else { v });
        for n in marks(north) {
            let ends = [Ned::new(n, east.0, floor), Ned::new(n, east.1, floor)];
            self.path(&ends, "grid", "");
            self.label(ends[1], "right", &number(n));
        }
        for e in marks(east) {
            let ends = [Ned::new(north.0, e, floor), Ned::new(north.1, e, floor)];
            self.path(&ends, "grid", "");
            self.label(ends[0], "below", &number(e));
        }
        let middle = |(from, to): (f64, f64)| (from + to) / 2.0;
        let beside = Ned::new(middle(north), east.1, floor);
        self.label(beside, "far", "north (m)");
        self.label(Ned::new(north.0, middle(east), floor), "under", "east (m)");
        let corner = Ned::new(north.1, east.0, floor);
        let top = Ned::new(north.1, east.0, floor - step);
        self.path(&[corner, top], "axis", "");
        self.label(top, "right", &format!("{} m up", number(step)));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scene_points_up_and_fits_the_picture() {
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
    fn single_point_and_empty_paths_draw_without_nan() {
        for flown in [vec![], vec![Ned::zero()], vec![Ned::new(f64::NAN, 0.0, 0.0)]] {
            let html = Scene { paths: &[("flown", &flown)], desired: &[] }.to_html();
            assert!(!html.contains("NaN") && !html.contains("inf"));
        }
    }
}
