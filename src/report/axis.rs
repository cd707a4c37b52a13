//! Axes: values to places in a frame, and round numbers beside them.

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

/// What a frame shows of one quantity. Places are shares of the frame, 0 at `low`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Axis {
    /// From the least to the greatest value exactly.
    pub(super) fn exact(range: Option<(f64, f64)>) -> Self {
        match range {
            Some((low, high)) if high > low => Self { low, high },
            Some((only, _)) => Self { low: only - 0.5, high: only + 0.5 },
            None => Self { low: 0.0, high: 1.0 },
        }
    }

    /// Adds a margin on both sides. The axis spans a five-hundredth of its largest value at least, so
    /// that its labels stay short; a constant is drawn flat, without its rounding errors.
    pub(super) fn padded(range: Option<(f64, f64)>) -> Self {
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let size = low.abs().max(high.abs());
        let air = match high - low {
            spread if spread > 1e-6 * size => (0.06 * spread).max(1e-3 * size - 0.5 * spread),
            _ if size > 0.0 => 0.5 * size,
            _ => 1.0,
        };
        Self { low: low - air, high: high + air }
    }

    pub(super) fn at(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    pub(super) fn value(&self, share: f64) -> f64 {
        self.low + share * (self.high - self.low)
    }

    /// About so many round numbers, as value and text.
    pub(super) fn ticks(&self, count: f64) -> Vec<(f64, String)> {
        let rough = (self.high - self.low) / count.max(2.0);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let axis = Axis::exact(Some((-0.013, 0.171)));
        let ticks: Vec<_> = axis.ticks(3.3).into_iter().map(|(_, text)| text).collect();
        assert_eq!(ticks, ["0.00", "0.05", "0.10", "0.15"]);
        let axis = Axis::exact(Some((0.0, 22.5)));
        assert_eq!(axis.ticks(9.0)[1].1, "2");
    }

    #[test]
    fn constant_values_are_centred_with_readable_ticks() {
        for value in [4.0, 0.0, -0.004] {
            let axis = Axis::padded(Some((value, value)));
            assert!((axis.at(value) - 0.5).abs() < 1e-9);
            let ticks = axis.ticks(3.8);
            assert!(ticks.len() >= 3 && ticks.iter().all(|(_, text)| text.len() <= 6), "{ticks:?}");
        }
        let ticks = Axis::padded(Some((-1.000_02, -0.999_98))).ticks(3.8);
        assert!(ticks.len() >= 2 && ticks.iter().all(|(_, text)| text.len() <= 7), "{ticks:?}");
    }
}
