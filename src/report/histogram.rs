//! Histograms as inline SVG.

use std::fmt::Write;

use super::axis::{Axis, LABELLED_BOTTOM, LEFT, RIGHT, TOP, WIDTH, grid, significant};
use super::page::escape;

/// Bars over equal intervals.
#[derive(Clone, Debug)]
pub struct Histogram<'a> {
    /// Name of the figure.
    pub name: &'a str,
    /// Name and unit of x.
    pub x_label: &'a str,
    /// What is counted; what is not finite is left out.
    pub values: &'a [f64],
    /// Number of bars.
    pub bars: usize,
}

impl Histogram<'_> {
    /// The figure. Values beyond the 99.5th percentile are counted in the last bar.
    pub fn to_html(&self) -> String {
        const HEIGHT: f64 = 120.0;
        let mut sorted: Vec<f64> = self.values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (Some(&low), Some(&most), Some(high)) =
            (sorted.first(), sorted.last(), quantile(&sorted, 0.995))
        else {
            return String::from("<p class=\"note\">No data.</p>");
        };
        if most - low <= 1e-6 * most.abs().max(1.0) {
            return format!(
                "<p class=\"note\"><b>{}</b>, {}: {} for all {}.</p>",
                escape(self.name),
                escape(self.x_label),
                significant(low),
                sorted.len()
            );
        }
        let x = Axis::padded(Some((low, high)), LEFT, WIDTH - RIGHT);
        let mut counts = vec![0usize; self.bars.max(1)];
        let last = counts.len() - 1;
        for value in &sorted {
            let bar = (value - x.low) / (x.high - x.low) * counts.len() as f64;
            counts[(bar.max(0.0) as usize).min(last)] += 1;
        }
        let most = counts.iter().copied().max().unwrap_or(1) as f64;
        let y = Axis::exact(Some((0.0, most * 1.05)), TOP + HEIGHT, TOP);
        let (height, name) = (TOP + HEIGHT + LABELLED_BOTTOM, escape(self.name));
        let mut html = format!(
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{name}\">"
        );
        grid(&x, &y, &mut html);
        let width = (WIDTH - RIGHT - LEFT) / counts.len() as f64;
        for (bar, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (left, top) = (LEFT + bar as f64 * width, y.at(*count as f64));
            let (from, to) = (x.value(left), x.value(left + width));
            let _ = write!(
                html,
                "<rect class=\"bar\" x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\">\
                 <title>{} to {}: {count}</title></rect>",
                left + 0.5,
                width - 1.0,
                TOP + HEIGHT - top,
                significant(from),
                significant(to)
            );
        }
        let _ = write!(
            html,
            "<text class=\"name\" x=\"{LEFT}\" y=\"{}\">{name}</text>\
             <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text></svg>",
            TOP - 7.0,
            (LEFT + WIDTH - RIGHT) / 2.0,
            height - 5.0,
            escape(self.x_label)
        );
        html
    }
}

/// The value below which the part `q` of `sorted` lies, by the nearest rank.
pub fn quantile(sorted: &[f64], q: f64) -> Option<f64> {
    let rank = (q * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_are_told_in_words_and_others_drawn() {
        let html = |values: &[f64]| {
            Histogram { name: "h", x_label: "age (ms)", values, bars: 10 }.to_html()
        };
        assert!(html(&[]).contains("No data"));
        assert!(html(&[1.0; 9]).contains("1.000 for all 9"));
        let drawn = html(&[0.0, 0.1, 0.1, 0.3, f64::NAN]);
        assert_eq!(drawn.matches("class=\"bar\"").count(), 3);
        assert!(!drawn.contains("NaN"));
    }

    #[test]
    fn quantiles_are_by_nearest_rank() {
        assert_eq!(quantile(&[1.0, 2.0, 3.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
