//! Axes: values to pixels, round numbers beside them, and the grid between.

use std::fmt::Write;

/// Size of every chart and the room around its frame, in pixels.
pub(super) const WIDTH: f64 = 900.0;
pub(super) const LEFT: f64 = 64.0;
pub(super) const RIGHT: f64 = 16.0;
pub(super) const TOP: f64 = 20.0;
/// Room below a frame whose x axis has a name.
pub(super) const LABELLED_BOTTOM: f64 = 40.0;

/// `value` with four significant digits.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let decimals = (3 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

/// Smallest and largest finite value.
pub(super) fn range_of(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.filter(|v| v.is_finite()).fold(None, |range, v| match range {
        None => Some((v, v)),
        Some((low, high)) => Some((v.min(low), v.max(high))),
    })
}

/// Maps values to pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    pub(super) low: f64,
    pub(super) high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    /// From the least to the greatest value exactly.
    pub(super) fn exact(range: Option<(f64, f64)>, from: f64, to: f64) -> Self {
        match range {
            Some((low, high)) if high > low => Self { low, high, from, to },
            Some((only, _)) => Self { low: only - 0.5, high: only + 0.5, from, to },
            None => Self { low: 0.0, high: 1.0, from, to },
        }
    }

    /// With some air on both sides. A constant is drawn as one: rounding errors are not magnified.
    pub(super) fn padded(range: Option<(f64, f64)>, from: f64, to: f64) -> Self {
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let size = low.abs().max(high.abs());
        let air = match high - low {
            spread if spread > 1e-6 * size => 0.06 * spread,
            _ if size > 0.0 => 0.5 * size,
            _ => 1.0,
        };
        Self { low: low - air, high: high + air, from, to }
    }

    pub(super) fn at(&self, value: f64) -> f64 {
        self.from + (value - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    pub(super) fn value(&self, pixel: f64) -> f64 {
        self.low + (pixel - self.from) / (self.to - self.from) * (self.high - self.low)
    }

    /// Round numbers about `spacing` pixels apart, as value and text.
    fn ticks(&self, spacing: f64) -> Vec<(f64, String)> {
        let count = ((self.to - self.from).abs() / spacing).max(2.0);
        let rough = (self.high - self.low) / count;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|f| f * power).into_iter().find(|s| *s >= 0.7 * rough);
        let Some(step) = step.filter(|s| s.is_normal()) else { return Vec::new() };
        let decimals = (-(step * 1.000_001).log10().floor()).clamp(0.0, 9.0) as usize;
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last.min(first.saturating_add(100)))
            .map(|n| n as f64 * step)
            .map(|v| (v, format!("{v:.decimals$}")))
            .collect()
    }
}

/// The frame of a chart: grid lines with their values, and the axes.
pub(super) fn grid(x: &Axis, y: &Axis, html: &mut String) {
    let (top, bottom, right) = (y.to, y.from, WIDTH - RIGHT);
    for (value, text) in y.ticks(26.0) {
        let at = y.at(value);
        let _ = write!(
            html,
            "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\"/>\
             <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
            LEFT - 6.0,
            at + 4.0
        );
    }
    for (value, text) in x.ticks(95.0) {
        let at = x.at(value);
        let _ = write!(
            html,
            "<path class=\"grid\" d=\"M{at:.1} {top}V{bottom}\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{text}</text>",
            bottom + 15.0
        );
    }
    let _ = write!(html, "<path class=\"axis\" d=\"M{LEFT} {top}V{bottom}H{right}\"/>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let axis = Axis::exact(Some((-0.013, 0.171)), 100.0, 0.0);
        let ticks: Vec<_> = axis.ticks(30.0).into_iter().map(|(_, text)| text).collect();
        assert_eq!(ticks, ["0.00", "0.05", "0.10", "0.15"]);
        let axis = Axis::exact(Some((0.0, 22.5)), 0.0, 900.0);
        assert_eq!(axis.ticks(95.0)[1].1, "2");
    }

    #[test]
    fn constants_stand_in_the_middle_with_readable_ticks() {
        for value in [4.0, 0.0, -0.004] {
            let axis = Axis::padded(Some((value, value)), 100.0, 0.0);
            assert!((axis.at(value) - 50.0).abs() < 1e-9);
            let ticks = axis.ticks(26.0);
            assert!(ticks.len() >= 3 && ticks.iter().all(|(_, text)| text.len() <= 6), "{ticks:?}");
        }
    }
}
