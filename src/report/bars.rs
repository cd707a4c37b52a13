//! Horizontal bars with their labels and numbers, one a line.

use std::fmt::Write;

use super::page::escape;

/// One bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// What it is of.
    pub label: String,
    /// Where it begins and ends.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Where a mark stands across it.
    pub mark: Option<f64>,
    /// Class of its colour: `c1`, `c2`, `c3`, `noise`.
    pub class: &'static str,
    /// Its number, with the unit.
    pub text: String,
}

impl Bar {
    /// From zero on.
    pub fn new(label: impl Into<String>, value: f64, text: impl Into<String>) -> Self {
        let (label, text) = (label.into(), text.into());
        Self { label, from: 0.0, to: value, mark: None, class: "c1", text }
    }
}

/// All on one scale; nothing where there is nothing to draw.
pub fn to_html(bars: &[Bar]) -> String {
    let ends = || bars.iter().flat_map(|bar| [bar.from, bar.to].into_iter().chain(bar.mark));
    if bars.is_empty() || ends().any(|end| !end.is_finite()) {
        return String::new();
    }
    let (least, most) = ends().fold((0.0_f64, 0.0_f64), |(a, b), end| (a.min(end), b.max(end)));
    if most <= least {
        return String::new();
    }
    let share = |value: f64| 100.0 * (value - least) / (most - least);
    let mut html = String::from("<div class=\"bars\" role=\"list\">");
    for bar in bars {
        let (left, right) = (share(bar.from.min(bar.to)), share(bar.from.max(bar.to)));
        let _ = write!(
            html,
            "<div role=\"listitem\"><span>{}</span><span class=\"room\">\
             <i class=\"{}\" style=\"left:{left:.2}%;width:{:.2}%\"></i>",
            escape(&bar.label),
            bar.class,
            right - left
        );
        if least < -1e-6 * most && most > 0.0 {
            let _ = write!(html, "<i class=\"zero\" style=\"left:{:.2}%\"></i>", share(0.0));
        }
        if let Some(mark) = bar.mark {
            let _ = write!(html, "<i class=\"at\" style=\"left:{:.2}%\"></i>", share(mark));
        }
        let _ = write!(html, "</span><span class=\"num\">{}</span></div>", escape(&bar.text));
    }
    html + "</div>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_share_a_scale_and_show_their_numbers() {
        let back = Bar { from: 1.0, to: -1.0, ..Bar::new("b", 0.0, "-2") };
        let html = to_html(&[Bar::new("a", 3.0, "3 m"), back]);
        assert!(html.contains("left:25.00%;width:75.00%") && html.contains("3 m"), "{html}");
        assert!(html.contains("left:0.00%;width:50.00%"), "{html}");
        assert!(to_html(&[]).is_empty() && to_html(&[Bar::new("a", f64::NAN, "")]).is_empty());
    }
}
