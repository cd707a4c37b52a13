//! Histograms.

use super::axis::{Axis, significant};
use super::frame::Frame;
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
        let mut sorted: Vec<f64> = self.values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (Some(&low), Some(&most), Some(high), Some(median)) =
            (sorted.first(), sorted.last(), quantile(&sorted, 0.995), quantile(&sorted, 0.5))
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
        let x = Axis::padded(Some((low, high)));
        let mut counts = vec![0usize; self.bars.max(1)];
        let last = counts.len() - 1;
        for value in &sorted {
            let bar = x.at(*value) * counts.len() as f64;
            counts[(bar.max(0.0) as usize).min(last)] += 1;
        }
        let peak = counts.iter().copied().max().unwrap_or(1) as f64;
        let [least, middle, greatest] = [low, median, most].map(significant);
        let description = format!(
            "{}, {} values of {}: {least} to {greatest}, half of them below {middle}.",
            self.name,
            sorted.len(),
            self.x_label
        );
        let frame = Frame {
            x,
            y: Axis::exact(Some((0.0, peak * 1.05))),
            height: 120.0,
            name: self.name,
            x_label: Some(self.x_label),
            group: None,
            description: &description,
        };
        let width = 1.0 / counts.len() as f64;
        let mut bars = String::new();
        for (bar, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let edges = [0.06, 0.94].map(|part| x.value((bar as f64 + part) * width));
            let [from, to] =
                [0.0, 1.0].map(|part| significant(x.value((bar as f64 + part) * width)));
            let title = format!("{from} to {to}: {count}");
            bars += &frame.area(edges, [0.0, *count as f64], "bar", &title);
        }
        frame.to_html(&bars, "")
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
    fn equal_values_are_stated_and_others_drawn() {
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
    fn quantiles_use_the_nearest_rank() {
        assert_eq!(quantile(&[1.0, 2.0, 3.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
