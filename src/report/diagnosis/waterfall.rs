//! The waterfall of shares: from the squared gap as shipped down to what noise leaves.

use crate::diagnose::verdict::attribution::Share;
use crate::report::bars::{self, Bar};

/// One bar a share, each from where the one above ends; what makes predictions worse goes back.
pub fn html(shares: &[Share]) -> String {
    // Where each bar begins and ends, in shares of the gap as shipped.
    let mut at = 1.0;
    let bars: Vec<Bar> = shares
        .iter()
        .map(|share| {
            let from = at;
            at -= share.share;
            let class = match share.of.as_str() {
                "noise" => "noise",
                "remainder" => "c2",
                _ => "c1",
            };
            let text = format!("{:.0} %", 100.0 * share.share);
            Bar { from, class, ..Bar::new(label(&share.of), at, text) }
        })
        .collect();
    bars::to_html(&bars)
}

/// A share in words.
fn label(of: &str) -> &str {
    match of {
        "file" => "the file's numbers",
        "remainder" => "not explained",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waterfall_bars_are_cumulative_with_negative_shares() {
        let share = |of: &str, share: f64| Share { of: of.to_owned(), share, interval: [share; 2] };
        let shares =
            [share("mass", 0.9), share("file", -0.1), share("remainder", 0.1), share("noise", 0.1)];
        let html = html(&shares);
        assert_eq!(html.matches("<i class").count(), 4);
        // The first bar ends at a tenth; the second goes back to two tenths.
        assert!(html.contains("left:10.00%;width:90.00%"), "{html}");
        assert!(html.contains("left:10.00%;width:10.00%") && html.contains("-10 %"), "{html}");
        assert!(super::html(&[]).is_empty());
        assert!(super::html(&[share("mass", f64::NAN)]).is_empty());
    }
}
