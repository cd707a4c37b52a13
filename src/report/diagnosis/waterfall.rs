//! The waterfall of shares: from the squared gap as shipped down to what noise leaves.

use std::fmt::Write;

use super::{LEFT, ROW, WIDTH};
use crate::diagnose::attribution::Share;
use crate::report::page::escape;

/// One bar a share, each from where the one above ends; what makes predictions worse goes back.
pub fn svg(shares: &[Share]) -> String {
    let finite = shares.iter().all(|share| share.share.is_finite());
    if shares.is_empty() || !finite {
        return String::new();
    }
    // Where each bar begins and ends, in shares of the gap as shipped.
    let mut at = 1.0;
    let bars: Vec<[f64; 2]> = shares
        .iter()
        .map(|share| {
            let from = at;
            at -= share.share;
            [from, at]
        })
        .collect();
    let ends = || bars.iter().flatten().copied();
    let most = ends().fold(1.0, f64::max);
    let least = ends().fold(0.0, f64::min);
    let scale = (WIDTH - LEFT - 80.0) / (most - least);
    let x = |share: f64| LEFT + (share - least) * scale;
    let height = ROW * shares.len() as f64 + 6.0;
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {height}\" width=\"100%\" role=\"img\" font-size=\"13\">\
         <title>Shares of the squared gap</title>"
    );
    for (row, (share, [from, to])) in shares.iter().zip(bars).enumerate() {
        let y = ROW * row as f64 + 4.0;
        let (left, right) = (x(from.min(to)), x(from.max(to)));
        let fill = match share.of.as_str() {
            "noise" => "var(--line)",
            "remainder" => "var(--c2)",
            _ => "var(--c1)",
        };
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"currentColor\">{}</text>\
             <rect x=\"{left:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{fill}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" fill=\"currentColor\">{:.0} %</text>",
            LEFT - 8.0,
            y + 14.0,
            escape(label(&share.of)),
            (right - left).max(1.0),
            ROW - 10.0,
            right + 6.0,
            y + 14.0,
            100.0 * share.share,
        );
    }
    svg + "</svg>"
}

/// A share in words.
fn label(of: &str) -> &str {
    match of {
        "file" => "the file's numbers",
        "remainder" => "nothing that was tried",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_follow_one_another_and_go_back_where_a_share_is_negative() {
        let share = |of: &str, share: f64| Share { of: of.to_owned(), share, interval: [share; 2] };
        let shares =
            [share("mass", 0.9), share("file", -0.1), share("remainder", 0.1), share("noise", 0.1)];
        let svg = svg(&shares);
        assert_eq!(svg.matches("<rect").count(), 4);
        assert!(svg.contains("-10 %"), "{svg}");
        assert!(super::svg(&[]).is_empty());
        assert!(super::svg(&[share("mass", f64::NAN)]).is_empty());
    }
}
