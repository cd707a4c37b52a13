//! The answer as text: the report for a terminal, and its sentences beside the finding.

use std::collections::BTreeSet;

use vehicle::effects::EffectId;

use crate::diagnose::answer::finding::{furthest_off, gap_change, listed};
use crate::diagnose::answer::quantities::{bounded, numbered, short};
use crate::diagnose::answer::{Answer, ExplanationAnswer, FullVerdict, Gap};
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::next_flight::NextFlight;
use crate::diagnose::simulate::reflight::ClosedLoop;
use crate::diagnose::verdict::Verdict;

/// The differences of flights flown again in simulation from their logs: as shipped, and with an
/// [`explanation`].
pub fn closed_loop(closed_loop: &ClosedLoop, explanation: &str) -> String {
    let ClosedLoop { position_m, thrust_n, moment_nm, .. } = closed_loop;
    format!(
        "Flown again in closed loop, the simulator differs from the held-out flights by {} m in \
         position, {} N in thrust and {} N m in moment; {explanation} by {} m, {} N and {} N m; \
         noise alone accounts for {} m, {} N and {} N m.",
        short(position_m.before),
        short(thrust_n.before),
        short(moment_nm.before),
        short(position_m.after),
        short(thrust_n.after),
        short(moment_nm.after),
        short(position_m.floor),
        short(thrust_n.floor),
        short(moment_nm.floor),
    )
}

/// The next flight, its reason, and the expected result.
pub fn next_flight(next: &NextFlight) -> String {
    let mut text = format!("Fly {} ({:.0} s), {}.", next.manoeuvre, next.seconds, next.why);
    let name = |ids: &[&str]| if ids.is_empty() { "no effect".into() } else { ids.join(" and ") };
    for outlook in &next.outlook {
        let rivals: Vec<String> = outlook
            .evidence
            .iter()
            .map(|rival| format!("{:.0} nats against {}", rival.nats, name(&rival.rival)))
            .collect();
        text += &format!(
            " If {} is true, its expected probability after that flight is {:.0} % instead of \
             {:.0} %: {}.",
            name(&outlook.truth),
            100.0 * outlook.expected,
            100.0 * outlook.now,
            rivals.join(", ")
        );
    }
    text += " Diagnose the old and the new flight together, and pass the new one with --new.";
    text
}

/// A sentence about a law.
pub fn law_sentence(law: &LawAnswer) -> String {
    let formulas: Vec<String> =
        law.formulas.iter().map(|(at, formula)| format!("{at} = {formula}")).collect();
    let formulas = formulas.join("; ");
    let Some(because) = &law.because else {
        let mut text = format!("A law explains them: {formulas}.");
        if let (Some([before, after, _]), Some(closure)) = (law.gap, law.closure) {
            text += &gap_change([before, after], Some(closure));
        }
        return text;
    };
    format!(
        "The nearest law is not named, because {because}; it depends on {}.",
        law.depends_on.join(", ")
    )
}

/// Report lines of a law: its terms, its range of validity, and the nearest effects.
fn law(law: &LawAnswer) -> String {
    let mut text = String::new();
    for (line, term) in law.terms.iter().enumerate() {
        let head = if line == 0 { "law" } else { "" };
        let [low, high] = term.interval.map(short);
        text += &format!(
            "{head:10} {}\n{:10}   {} {low} .. {high} {}",
            term.term, "", term.name, term.unit
        );
        if let Some(shape) = term.shape {
            let [low, high] = shape.interval.map(short);
            text += &format!(", with {low} .. {high} inside");
        }
        text += &format!(" ({:.0} nats)\n", term.evidence);
    }
    let range: Vec<String> = law
        .range
        .iter()
        .map(|(quantity, [low, high])| format!("{quantity} {} .. {}", short(*low), short(*high)))
        .collect();
    text += &format!("known for  {}\n", range.join(", "));
    for near in law.nearest.iter().take(1) {
        text += &format!(
            "near it    {} with {:.0} nats of evidence; the law has {:.0}\n",
            near.effects.join(" and "),
            near.evidence,
            law.evidence
        );
    }
    text
}

/// Least posterior mass of an equivalent explanation that the answer mentions.
const EQUIVALENT_MASS_MIN: f64 = 0.05;

/// The most probable explanation by other effects that act through the same ratio as the named
/// ones, such as a mass in place of a thrust scale ([`EffectId::class`]).
pub fn equivalent(answer: &Answer) -> Option<&ExplanationAnswer> {
    let named: BTreeSet<EffectId> = answer.named().map(|effect| effect.id).collect();
    let classes = |ids: &BTreeSet<EffectId>| -> BTreeSet<EffectId> {
        ids.iter().map(|id| id.class()).collect()
    };
    let is_equivalent = |explanation: &&ExplanationAnswer| {
        let ids: BTreeSet<EffectId> =
            explanation.effects.iter().filter_map(|id| id.parse().ok()).collect();
        !named.is_empty()
            && explanation.mass >= EQUIVALENT_MASS_MIN
            && explanation.effects.len() == named.len()
            && ids != named
            && classes(&ids) == classes(&named)
    };
    let found = answer.explanations.iter().filter(is_equivalent);
    found.max_by(|a, b| a.mass.total_cmp(&b.mass))
}

/// An [`equivalent`] explanation with its probability.
pub fn alternative(other: &ExplanationAnswer) -> String {
    format!(
        "{}, {:.0} %: these flights cannot distinguish them",
        numbered(other),
        100.0 * other.mass
    )
}

/// The phrase for a gap after the search: effects are named only where they explain it.
pub fn explanation(finding: FullVerdict) -> &'static str {
    match finding {
        FullVerdict::Named | FullVerdict::Ambiguous | FullVerdict::OtherLaw => "with the effects",
        _ => "with the nearest explanation",
    }
}

/// The answer for a terminal: the finding first, then where, which, how far, and what these logs
/// cannot show.
pub fn report(answer: &Answer) -> String {
    let mut text = format!("{}\n", answer.finding.sentence);
    if !answer.map.sentence.is_empty() {
        text += &format!("\nwhere      {}\n", answer.map.sentence);
    }
    text += &effects(answer);
    if !answer.attribution.is_empty() {
        let shares = answer.attribution.iter();
        let shares: Vec<String> =
            shares.map(|share| format!("{} {:.0} %", share.of, 100.0 * share.share)).collect();
        text += &format!("shares     of the squared gap: {}\n", shares.join(", "));
    }
    if !answer.file_numbers.is_empty() {
        text += &format!("file       {}\n", furthest_off(&answer.file_numbers));
    }
    let with = explanation(answer.finding.verdict);
    text += &answer.gap.as_ref().map(|gap| gap_line(gap, with)).unwrap_or_default();
    text += &answer.closed_loop.as_ref().map(|it| closed_loop_lines(it, with)).unwrap_or_default();
    if let Some(missing) = &answer.closed_loop_missing {
        text += &format!("again      not flown: {missing}\n");
    }
    if let Some([before, after]) = &answer.unmodelled_force {
        text += &format!(
            "left over  {:.3} m/s^2 of force per mass, {:.3} before\n",
            after.rms(),
            before.rms()
        );
    }
    if let Some(found) = &answer.law {
        text += &law(found);
    }
    if let Some(next) = &answer.next_flight {
        text += &format!("next       {}\n", next_flight(next));
    }
    if !answer.not_testable.is_empty() {
        let not_shown = listed(answer.not_testable.iter().map(|effect| effect.id));
        text += &format!("not shown  {not_shown}\n");
    }
    if let Some(twins) = &answer.twins {
        text += &format!(
            "chance     {} twins without an effect: up to {:.0} % of the required evidence\n",
            twins.count,
            100.0 * twins.largest.last().copied().unwrap_or(0.0)
        );
    }
    text
}

/// Report lines of the effects with their intervals; without any, of the nearest explanations.
fn effects(answer: &Answer) -> String {
    let mut text = String::new();
    for (line, effect) in answer.effects.iter().enumerate() {
        let head = match (line, answer.verdict) {
            (0, Verdict::None) => "trace",
            (0, _) => "which",
            _ => "",
        };
        text += &format!("{head:10} {:18} {:3.0} %", effect.id, 100.0 * effect.probability);
        for (name, [low, high]) in &effect.intervals {
            text += &format!("  {}", bounded(effect.id.name(), name, [*low, *high]));
        }
        text += "\n";
    }
    if let Some(other) = equivalent(answer) {
        text += &format!("or         {}\n", alternative(other));
    }
    if answer.effects.is_empty() {
        for (line, tried) in answer.explanations.iter().take(3).enumerate() {
            let head = if line == 0 { "nearest" } else { "" };
            let set = tried.effects.join(" and ");
            text += &format!("{head:10} {set:18} {:.1} nats of evidence\n", tried.evidence);
        }
    }
    text
}

/// The report line of the gap, as shipped and `with` the [`explanation`].
fn gap_line(gap: &Gap, with: &str) -> String {
    let mut text = format!("how far    held-out gap {:.2}", gap.before);
    if let Some(nuisances) = gap.nuisances_only {
        text += &format!(", {nuisances:.2} with the file's numbers alone");
    }
    text += &format!(", {:.2} {with}", gap.after);
    if let Some(learner) = gap.with_learner {
        text += &format!(", {learner:.2} with a flexible learner");
    }
    text + &format!(", {:.2} from noise alone\n", gap.floor)
}

/// Report lines of flights flown again, as shipped and `with` the [`explanation`].
fn closed_loop_lines(closed_loop: &ClosedLoop, with: &str) -> String {
    let ClosedLoop { position_m, thrust_n, moment_nm, .. } = closed_loop;
    let quantities =
        [("position", "m", position_m), ("thrust", "N", thrust_n), ("moment", "N m", moment_nm)];
    let mut text = String::new();
    for (line, (name, unit, difference)) in quantities.into_iter().enumerate() {
        let head = if line == 0 { "again" } else { "" };
        text += &format!(
            "{head:10} {name} off by {} {unit}, {} {with}, {} from noise alone\n",
            short(difference.before),
            short(difference.after),
            short(difference.floor)
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use vehicle::effects::ParameterValue;

    use super::*;
    use crate::diagnose::answer::EffectAnswer;

    #[test]
    fn equivalent_mass_is_listed_beside_thrust_scale() {
        let explained = |id: &str, name: &str, value: f64, mass: f64| ExplanationAnswer {
            effects: vec![id.to_owned()],
            evidence: 50.0,
            mass,
            numbers: vec![value],
            parameters: [(
                id.to_owned(),
                [(name.to_owned(), ParameterValue::Number(value))].into(),
            )]
            .into(),
        };
        let mut answer = Answer::data_fault(Vec::new());
        answer.verdict = Verdict::Effect;
        answer.effects = vec![EffectAnswer {
            id: EffectId::ThrustScale,
            probability: 0.97,
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
            deviations: BTreeMap::new(),
        }];
        answer.explanations = vec![
            explained("thrust_scale", "scale", 0.88, 0.6),
            explained("battery_sag", "exponent", 1.0, 0.2),
        ];
        assert!(equivalent(&answer).is_none());
        answer.explanations.push(explained("mass", "mass_kg", 0.034, 0.3));
        let text = report(&answer);
        assert!(text.contains("or         mass (mass_kg 0.03400), 30 %"), "{text}");
    }
}
