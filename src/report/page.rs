//! The page around the figures.

use std::fmt::Write;

/// Text as it may stand in HTML and SVG.
pub fn escape(text: &str) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // Not allowed in XML, and invisible.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{FFFD}'),
            c => out.push(c),
        }
        out
    })
}

/// How a key figure is to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mood {
    /// A number like any other.
    Plain,
    /// As it should be.
    Good,
    /// Worth a look.
    Warning,
    /// Wrong.
    Bad,
}

impl Mood {
    /// The class in the style sheet.
    pub(crate) fn class(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Good => "good",
            Self::Warning => "warning",
            Self::Bad => "bad",
        }
    }
}

/// A page that grows from top to bottom.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// A page with a heading and a line below it.
    pub fn new(title: &str, subtitle: &str) -> Self {
        let (title, subtitle) = (escape(title), escape(subtitle));
        let body = format!("<header><h1>{title}</h1><p class=\"sub\">{subtitle}</p></header>\n");
        Self { title, body }
    }

    /// The sentence that says it all, with the reasons below.
    pub fn verdict(&mut self, mood: Mood, sentence: &str, reasons: &[String]) {
        let class = mood.class();
        let _ = write!(self.body, "<div class=\"verdict {class}\"><p>{}</p>", escape(sentence));
        if !reasons.is_empty() {
            let items: String = reasons.iter().map(|r| format!("<li>{}</li>", escape(r))).collect();
            let _ = write!(self.body, "<ul>{items}</ul>");
        }
        self.body.push_str("</div>\n");
    }

    /// Key figures side by side: label, value with its unit, mood.
    pub fn figures(&mut self, figures: &[(&str, String, Mood)]) {
        self.body.push_str("<div class=\"figures\">");
        for (label, value, mood) in figures {
            let (label, value, class) = (escape(label), escape(value), mood.class());
            let _ = write!(
                self.body,
                "<div class=\"figure {class}\"><b>{value}</b><span>{label}</span></div>"
            );
        }
        self.body.push_str("</div>\n");
    }

    /// A section: heading, a line of explanation, and HTML made by this module's neighbours.
    pub fn section(&mut self, heading: &str, explanation: &str, html: &str) {
        let _ = write!(self.body, "<section><h2>{}</h2>", escape(heading));
        if !explanation.is_empty() {
            let _ = write!(self.body, "<p class=\"note\">{}</p>", escape(explanation));
        }
        let _ = writeln!(self.body, "{html}</section>");
    }

    /// The whole document.
    pub fn into_html(self) -> String {
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <title>{}</title>\n<style>{STYLE}</style></head>\n<body><main>\n{}</main></body></html>\n",
            self.title, self.body
        )
    }
}

/// Colours are Okabe and Ito's, told apart with any colour vision; lighter on dark.
const STYLE: &str = "
:root{color-scheme:light dark;--bg:#fff;--card:#f6f7f9;--ink:#1b1f24;--soft:#5b6572;--line:#d5dae1;
--grid:#e6e9ee;--band:#eef1f6;--c1:#0072b2;--c2:#d55e00;--c3:#00855f;--c4:#a8518a;
--c5:#8a6d00;--ref:#3b4048;
--good:#00855f;--warning:#b26b00;--bad:#c62828}
@media (prefers-color-scheme:dark){:root{--bg:#14171c;--card:#1d2229;--ink:#e6e9ee;--soft:#9aa5b3;
--line:#39414c;--grid:#272d36;--band:#1d232c;--c1:#56b4e9;--c2:#ff9248;--c3:#2fc79a;--c4:#e29cc8;
--c5:#e6c229;--ref:#c9d0da;--good:#2fc79a;--warning:#f0ad4e;--bad:#ff7b72}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,sans-serif}
main{max-width:960px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:26px;margin:0;line-height:1.25}h2{font-size:18px;margin:0 0 4px}
h3{font-size:14px;margin:14px 0 2px;font-weight:600}
.sub,.note{color:var(--soft);margin:2px 0 10px}.note{font-size:13.5px;max-width:76ch}
section{margin-top:34px}
.verdict{margin:18px 0;padding:12px 16px;border-left:4px solid var(--soft);background:var(--card);
border-radius:0 8px 8px 0}
.verdict p{margin:0;font-size:17px}.verdict ul{margin:6px 0 0;padding-left:20px;color:var(--soft)}
.verdict.good{border-color:var(--good)}.verdict.warning{border-color:var(--warning)}
.verdict.bad{border-color:var(--bad)}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(142px,1fr));gap:10px}
.figure{background:var(--card);border-radius:8px;padding:10px 12px}
.figure b{display:block;font-size:19px;font-variant-numeric:tabular-nums;white-space:nowrap}
.figure span{color:var(--soft);font-size:12.5px}
.figure.good b{color:var(--good)}.figure.warning b{color:var(--warning)}.figure.bad b{color:var(--bad)}
.legend{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:13px;color:var(--soft);margin:4px 0 2px 64px}
.legend svg{width:24px;height:10px;margin-right:6px;vertical-align:0}
svg.chart{display:block;width:100%;height:auto;font:12px system-ui,-apple-system,'Segoe UI',Roboto,Arial,sans-serif}
svg text{fill:var(--soft)}svg .name{fill:var(--ink);font-weight:600}
.grid{stroke:var(--grid);fill:none}.axis{stroke:var(--line);fill:none}.band{fill:var(--band)}
.curve{fill:none;stroke-width:1.5;stroke-linejoin:round}
.c1{stroke:var(--c1);stroke-width:2}.c2{stroke:var(--c2);stroke-dasharray:9 3}
.c3{stroke:var(--c3);stroke-dasharray:3 3}.c4{stroke:var(--c4);stroke-dasharray:10 3 2 3}
.c5{stroke:var(--c5);stroke-dasharray:1.5 2.5}
.ref{stroke:var(--ref);stroke-dasharray:5 4;stroke-width:1.3}
.shadow{fill:none;stroke:var(--soft);stroke-opacity:.5;stroke-width:1.2}
.bar{fill:var(--c1)}.mark{fill:var(--bg);stroke:var(--ink);stroke-width:1.5}
.hover{fill:transparent}.hover:hover{fill:var(--soft);fill-opacity:.16}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:14px;margin-top:8px;font-variant-numeric:tabular-nums}
th,td{padding:4px 14px 4px 0;text-align:left;border-bottom:1px solid var(--grid);vertical-align:top}
td.text:first-child,td.text:nth-child(2):not(:last-child){white-space:nowrap}
th{color:var(--soft);font-weight:600;font-size:13px}td.num,th.num{text-align:right}
td.good{color:var(--good)}td.warning{color:var(--warning)}td.bad{color:var(--bad)}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 18px;margin:8px 0;font-size:14px}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere}
@media print{:root{--bg:#fff;--card:#f6f7f9;--ink:#000;--soft:#444}main{max-width:none;padding:0}
section,svg,.verdict{break-inside:avoid}}
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_from_outside_cannot_become_markup() {
        let mut page = Page::new("<script>", "a & b");
        page.verdict(Mood::Bad, "\"x\"", &["<b>".into()]);
        let html = page.into_html();
        assert!(!html.contains("<script>") && html.contains("&lt;script&gt;"));
        assert!(html.contains("a &amp; b") && html.contains("&lt;b&gt;"));
        assert_eq!(escape("\u{1b}[31m"), "\u{FFFD}[31m");
    }
}
