//! The law that was found: formulas, terms with intervals, what it is known for, what comes near it.

use crate::diagnose::discovery::law::LawAnswer;
use crate::report::axis::significant;
use crate::report::page::{Mood, escape};
use crate::report::table::{Table, definitions};

/// What stands above it.
pub const INTRODUCTION: &str = "A formula of terms that units and the airframe's symmetry allow. \
                                The fitted flights select it, and the rules for effects judge it. \
                                Beyond the range of the flights it keeps its value at the end of \
                                the range.";

/// The section.
pub fn html(law: &LawAnswer) -> String {
    let mut html = String::new();
    for (at, formula) in &law.formulas {
        html += &format!("<p><code>{} = {}</code></p>", escape(at), escape(formula));
    }
    let mut table = Table::new(&[
        ("coefficient", false),
        ("value", true),
        ("90 % interval", true),
        ("power or length", true),
        ("evidence (nats)", true),
        ("term", false),
    ]);
    for term in &law.terms {
        let [low, high] = term.interval.map(significant);
        let shape = term.shape.map_or(String::new(), |shape| {
            let [low, high] = shape.interval.map(significant);
            format!("{} ({low} .. {high})", significant(shape.value))
        });
        let cells = [
            term.name.clone(),
            format!("{} {}", significant(term.value), term.unit),
            format!("{low} .. {high}"),
            shape,
            format!("{:.0}", term.evidence),
            term.term.clone(),
        ];
        table.row(Mood::Plain, &cells);
    }
    html += &table.into_html();
    let range: Vec<String> = law
        .range
        .iter()
        .map(|(name, [low, high])| {
            format!("{name} {} .. {}", significant(*low), significant(*high))
        })
        .collect();
    let near: Vec<String> = law
        .nearest
        .iter()
        .map(|near| format!("{} ({:.0})", near.effects.join(" and "), near.evidence))
        .collect();
    let verdict = match &law.because {
        None => format!("yes, with probability {:.0} %", 100.0 * law.probability),
        Some(because) => format!("no: {because}"),
    };
    let gap = law.gap.map_or("not predicted".to_owned(), |gap| {
        let [before, after, both] = gap.map(significant);
        format!("{before} as shipped, {after} with the law, {both} with the file's numbers too")
    });
    html += &definitions([
        ("named", verdict.as_str()),
        ("depends on", law.depends_on.join(", ").as_str()),
        ("known for", range.join(", ").as_str()),
        ("held-out gap, times the floor", gap.as_str()),
        ("evidence (nats)", format!("{:.0}", law.evidence).as_str()),
        ("nearest in the catalogue (nats)", near.join(", ").as_str()),
    ]);
    html
}
