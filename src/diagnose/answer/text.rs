//! The answer as text: sentences, and the report for a terminal.

use std::collections::BTreeSet;

use vehicle::effects::EffectId;

use crate::diagnose::answer::quantities::{bounded, numbered, one, short};
use crate::diagnose::answer::{Answer, ExplanationAnswer, FullVerdict, Gap};
use crate::diagnose::discovery::law::LawAnswer;
use crate::diagnose::next_flight::NextFlight;
use crate::diagnose::simulate::reflight::ClosedLoop;
use crate::diagnose::verdict::Unexplained;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::verdict::evidence::FileNumber;

/// The finding of an answer in a sentence or two.
pub fn finding(answer: &Answer) -> String {
    match answer.verdict {
        Verdict::None => none(answer) + &wander(answer),
        Verdict::Effect => effect(answer) + &wander(answer),
        Verdict::Unknown => unknown(answer),
    }
}

/// What the floor holds beyond white noise, where that is much: residuals that no effect, number or
/// learner predicts, and which therefore count as the estimator's.
fn wander(answer: &Answer) -> String {
    let Some(floor) = answer.gap.as_ref().map(|gap| gap.floor) else { return String::new() };
    if floor < REPORTED_FLOOR_MIN {
        return String::new();
    }
    let more = match answer.unmodelled_force {
        Some(_) => "",
        None => "; without an accelerometer these logs cannot tell one from the other",
    };
    format!(
        " The noise floor is {floor:.1} times what the sensors' white noise gives: an estimate that \
         wanders, or a force that changes with time{more}."
    )
}

/// Least multiple of the floor that counts as a gap for the file's numbers to close.
const REPORTED_GAP_MIN: f64 = 1.5;
/// Floor, in units of the sensors' white noise, from which the text says what else it holds.
const REPORTED_FLOOR_MIN: f64 = 3.0;
/// Most numbers of the vehicle file in a sentence.
const NUMBERS_LISTED: usize = 3;

/// For the verdict `none`: how well the simulator predicts, and how the file's numbers contribute.
fn none(answer: &Answer) -> String {
    let Some(gap) = &answer.gap else {
        return "No effect that these logs can show stands out.".to_owned();
    };
    let before = gap.times(gap.before);
    let after = gap.nuisances_only.map(|after| gap.times(after));
    let Some(after) = after.filter(|after| before > REPORTED_GAP_MIN && 2.0 * after < before)
    else {
        let mut text = format!(
            "No effect stands out: the simulator predicts the held-out flights to {before:.2} \
             times the noise floor."
        );
        if before > REPORTED_GAP_MIN && gap.with_learner.is_none() {
            text += " The floor is sensor noise only: too little flight to measure how much \
                     estimator drift adds.";
        }
        return text;
    };
    let mut text = format!(
        "No effect stands out: changing the vehicle file's numbers within their tolerances brings \
         predictions of the held-out flights from {before:.2} to {after:.2} times the noise floor."
    );
    if !answer.file_numbers.is_empty() {
        text += &format!(" Furthest off: {}.", furthest_off(&answer.file_numbers));
    }
    text
}

/// The vehicle file's numbers that are furthest off.
fn furthest_off(numbers: &[FileNumber]) -> String {
    let one = |number: &FileNumber| {
        let FileNumber { name, value, expected, tolerances } = number;
        let [value, expected] = [*value, *expected].map(short);
        format!("{name} {value} instead of {expected} ({tolerances:+.1} tolerances)")
    };
    numbers.iter().take(NUMBERS_LISTED).map(one).collect::<Vec<_>>().join(", ")
}

/// For the verdict `unknown`: why the gap counts as unexplained.
fn unknown(answer: &Answer) -> String {
    let head = "These flights show something that no listed effect explains";
    let gap = answer.gap.as_ref();
    let why = match answer.finding.because {
        Some(Unexplained::Force) => answer.unmodelled_force.as_ref().map(|[_, after]| {
            format!(
                "{:.2} m/s^2 of force per mass remains, on which velocity and accelerometer agree",
                after.rms()
            )
        }),
        Some(Unexplained::Doubt) => gap.map(|gap| {
            format!(
                "the nearest brings predictions from {:.2} to {:.2} times the noise floor, and is \
                 less likely than not to be the cause",
                gap.times(gap.before),
                gap.times(gap.after)
            )
        }),
        Some(Unexplained::Remainder) => gap.map(|gap| {
            format!(
                "the held-out flights are predicted to {:.2} times the noise floor, and to {:.2} \
                 with the nearest explanation",
                gap.times(gap.before),
                gap.times(gap.with_nuisances.unwrap_or(gap.after))
            )
        }),
        None => None,
    };
    why.map_or_else(|| format!("{head}."), |why| format!("{head}: {why}."))
}

/// Least probability of an effect that is mentioned where none is named.
const LIKELY_PROBABILITY_MIN: f64 = 0.1;

fn effect(answer: &Answer) -> String {
    let named: Vec<String> = answer.named().map(one).collect();
    let mut text = if named.is_empty() {
        let likely =
            answer.effects.iter().filter(|effect| effect.probability >= LIKELY_PROBABILITY_MIN);
        let likely: Vec<String> = likely.map(one).collect();
        format!("One of these acts, and these flights cannot show which: {}.", likely.join(", or "))
    } else {
        format!("Found: {}.", named.join(", and "))
    };
    if let Some(gap) = &answer.gap {
        text += &gap_change([gap.before, gap.after].map(|value| gap.times(value)), gap.closure);
        if gap.with_file {
            text +=
                " That is with the vehicle file's numbers refitted; its errors hide the effects.";
        }
    }
    if answer.finding.verdict == FullVerdict::OtherLaw {
        text += " Its equation differs from the catalogue's: part of the gap stays open.";
    }
    if !answer.ambiguous_with.is_empty() {
        let others = listed(answer.ambiguous_with.iter().copied());
        text += &format!(" It cannot be distinguished from {others}.");
    }
    text
}

/// The gap before and after the effects, in units of the floor.
fn gap_change(gaps: [f64; 2], closure: Option<f64>) -> String {
    let Some(closure) = closure else { return String::new() };
    let [before, after] = gaps.map(|gap| format!("{gap:.2}"));
    if before == after || gaps[1] > gaps[0] {
        return format!(
            " On the held-out flights this does not close the gap: it is {before} times the noise \
             floor with the file as shipped, and {after} with the effects."
        );
    }
    format!(
        " On the held-out flights the gap shrinks from {before} to {after} times the noise floor: \
         {:.0} % of what can be closed.",
        100.0 * closure
    )
}

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

/// Ids of effects, separated by commas.
pub(in crate::diagnose) fn listed(effects: impl Iterator<Item = EffectId>) -> String {
    let ids: Vec<&str> = effects.map(EffectId::name).collect();
    ids.join(", ")
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
    use crate::diagnose::likelihood::noise::ReportNoise;
    use crate::diagnose::simulate::gap::Errors;

    #[test]
    fn gap_closed_by_file_numbers_names_the_furthest_off() {
        let mut answer = Answer::data_fault(Vec::new());
        answer.verdict = Verdict::None;
        let gap = Gap {
            metric: "mean",
            before: 8.0,
            after: 8.0,
            with_file: false,
            floor: 1.0,
            scatter: 0.02,
            closure: Some(0.0),
            nuisances_only: Some(1.2),
            with_nuisances: None,
            with_learner: None,
            errors: [Errors([[0.0; 4]; 3]); 3],
            noise: ReportNoise::default(),
        };
        answer.gap = Some(gap);
        let name = "inertia scale[0]".to_owned();
        answer.file_numbers =
            vec![FileNumber { name, value: 1.12, expected: 1.0, tolerances: 1.6 }];
        let text = finding(&answer);
        assert!(text.contains("from 8.00 to 1.20 times"), "{text}");
        assert!(
            text.contains("inertia scale[0] 1.120 instead of 1.000 (+1.6 tolerances)"),
            "{text}"
        );
        // A gap that those numbers leave open is not reported as closed.
        answer.gap.as_mut().unwrap().nuisances_only = Some(7.0);
        assert!(finding(&answer).contains("to 8.00 times"));
        // A floor of white noise alone needs no words.
        assert!(!finding(&answer).contains("wanders"), "{}", finding(&answer));
        answer.gap.as_mut().unwrap().floor = 6.2;
        let text = finding(&answer);
        assert!(text.contains("6.2 times what the sensors' white noise gives"), "{text}");
        assert!(text.contains("without an accelerometer"), "{text}");
    }

    #[test]
    fn growing_gap_is_not_reported_as_shrinking() {
        assert!(gap_change([1.29, 1.23], Some(0.3)).contains("shrinks from 1.29 to 1.23"));
        for gaps in [[1.23, 1.29], [1.231, 1.229]] {
            let text = gap_change(gaps, Some(0.3));
            assert!(text.contains("does not close the gap"), "{text}");
        }
    }

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
