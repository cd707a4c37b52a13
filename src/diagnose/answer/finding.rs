//! The finding: an answer in a sentence or two.

use vehicle::effects::EffectId;

use super::quantities::{one, short};
use super::{Answer, FullVerdict};
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
pub(super) fn furthest_off(numbers: &[FileNumber]) -> String {
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
        Some(Unexplained::Force) => remaining_force(answer),
        Some(Unexplained::SlungLoad) => remaining_force(answer).map(|force| {
            force
                + ". It follows from the vehicle's motion like the pull of a load that hangs and \
                   swings"
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

/// The size of the force that nothing explains.
fn remaining_force(answer: &Answer) -> Option<String> {
    let [_, after] = answer.unmodelled_force.as_ref()?;
    Some(format!(
        "{:.2} m/s^2 of force per mass remains, on which velocity and accelerometer agree",
        after.rms()
    ))
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

/// Ids of effects, separated by commas.
pub(in crate::diagnose) fn listed(effects: impl Iterator<Item = EffectId>) -> String {
    let ids: Vec<&str> = effects.map(EffectId::name).collect();
    ids.join(", ")
}

/// The gap before and after the effects, in units of the floor.
pub(super) fn gap_change(gaps: [f64; 2], closure: Option<f64>) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::answer::Gap;
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
}
