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
    /// What stands above the contents.
    head: String,
    /// Headings of the sections with the names that links lead to.
    contents: Vec<(String, String)>,
    body: String,
}

impl Page {
    /// A page with a heading and a line below it.
    pub fn new(title: &str, subtitle: &str) -> Self {
        let (title, subtitle) = (escape(title), escape(subtitle));
        let head = format!("<header><h1>{title}</h1><p class=\"sub\">{subtitle}</p></header>\n");
        Self { title, head, contents: Vec::new(), body: String::new() }
    }

    /// The sentence that says it all, with the reasons below.
    pub fn verdict(&mut self, mood: Mood, sentence: &str, reasons: &[String]) {
        let class = mood.class();
        let _ = write!(self.head, "<div class=\"verdict {class}\"><p>{}</p>", escape(sentence));
        if !reasons.is_empty() {
            let items: String = reasons.iter().map(|r| format!("<li>{}</li>", escape(r))).collect();
            let _ = write!(self.head, "<ul>{items}</ul>");
        }
        self.head.push_str("</div>\n");
    }

    /// Key figures side by side: label, value with its unit, mood.
    pub fn figures(&mut self, figures: &[(&str, String, Mood)]) {
        self.head.push_str("<div class=\"figures\">");
        for (label, value, mood) in figures {
            let (label, value, class) = (escape(label), escape(value), mood.class());
            let _ = write!(
                self.head,
                "<div class=\"figure {class}\"><b>{value}</b><span>{label}</span></div>"
            );
        }
        self.head.push_str("</div>\n");
    }

    /// A section: heading, a line of explanation, and HTML made by this module's neighbours.
    pub fn section(&mut self, heading: &str, explanation: &str, html: &str) {
        let (id, heading) = (anchor(heading), escape(heading));
        let _ = write!(self.body, "<section id=\"{id}\"><h2>{heading}</h2>");
        if !explanation.is_empty() {
            let _ = write!(self.body, "<p class=\"note\">{}</p>", escape(explanation));
        }
        let _ = writeln!(self.body, "{html}</section>");
        self.contents.push((id, heading));
    }

    /// The whole document. It may ask nothing of anyone: its own policy forbids it.
    pub fn into_html(self) -> String {
        let Self { title, head, contents, body } = self;
        let links: String = contents
            .iter()
            .map(|(id, heading)| format!("<li><a href=\"#{id}\">{heading}</a></li>"))
            .collect();
        let hint = match body.contains("class=\"plot\"") {
            true => HINT,
            false => "",
        };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; \
             style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <title>{title}</title>\n<style>{STYLE}</style></head>\n<body><main>\n{head}\
             <nav aria-label=\"Contents\"><ul>{links}</ul></nav>{hint}\n{body}</main>\
             <script>{SCRIPT}</script></body></html>\n"
        )
    }
}

/// The name of a section that links lead to.
pub(super) fn anchor(heading: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    heading.chars().map(letter).collect()
}

/// What can be done with charts, where the script runs.
const HINT: &str = "<p class=\"hint\">Charts: drag to zoom, Shift-drag to pan, double-click to \
                    reset; Ctrl and the wheel, two fingers, or the keys + - 0 and arrows also \
                    work. Click a name in a legend to show or hide its curve. Drag the 3D path to \
                    turn it.</p>";
/// Colours are Okabe and Ito's, told apart with any colour vision; lighter on dark.
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn untrusted_text_is_escaped() {
        let mut page = Page::new("<script>", "a & b");
        page.verdict(Mood::Bad, "\"x\"", &["<b>".into()]);
        let html = page.into_html();
        assert!(html.matches("<script>").count() == 1 && html.contains("&lt;script&gt;"));
        assert!(html.contains("a &amp; b") && html.contains("&lt;b&gt;"));
        assert_eq!(escape("\u{1b}[31m"), "\u{FFFD}[31m");
    }

    #[test]
    fn contents_link_to_the_sections() {
        let mut page = Page::new("t", "s");
        page.section("Desired & flown", "", "");
        let html = page.into_html();
        let link = "<a href=\"#desired---flown\">Desired &amp; flown</a>";
        assert!(html.contains(link) && html.contains("<section id=\"desired---flown\">"));
    }
}
