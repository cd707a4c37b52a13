//! Summarises all answers of an exam.

mod measures;

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use self::measures::{Cases, measures};
use super::condition::Condition;
use super::interval::{Rate, median, ranges};
use super::order::Kind;
use super::reliability::{Reliability, calibration_error, reliability};
use super::score::{Law, Row};
use super::world::{FileKind, LoopKind};

/// Borders between strengths in the detection curves.
const STRENGTHS: [f64; 9] = [0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 4.0, 8.0, 15.0];

/// Upper limit of the Brier score.
pub const BRIER_MAX: f64 = 0.05;
/// Upper limit of the expected calibration error.
pub const CALIBRATION_MAX: f64 = 0.03;

/// A rate with a target.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Measure {
    /// Name of the measure.
    pub name: &'static str,
    /// The measured rate.
    #[serde(flatten)]
    pub rate: Rate,
    /// Target of the rate, if any.
    pub wanted: Option<Bound>,
}

/// A target of a rate.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// The rate must be at least this.
    AtLeast(f64),
    /// The rate must be at most this.
    AtMost(f64),
}

/// The result of comparing a rate with its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetResult {
    /// The rate meets its target, or has none.
    Kept,
    /// The rate misses its target, but a single case decides that, and chance may have.
    TooFew,
    /// The rate misses its target.
    Missed,
}

impl Bound {
    /// Fewest cases at which a single one does not decide the result.
    fn cases_min(self) -> f64 {
        let (Self::AtLeast(bound) | Self::AtMost(bound)) = self;
        let share = bound.min(1.0 - bound);
        // With a target of 0 or 1, any number of cases decides.
        if share > 0.0 { 1.0 / share } else { 0.0 }
    }

    fn keeps(self, rate: f64) -> bool {
        match self {
            Self::AtLeast(least) => rate >= least,
            Self::AtMost(most) => rate <= most,
        }
    }
}

impl Measure {
    /// Compares the rate with its target.
    pub fn result(&self) -> TargetResult {
        let (Some(rate), Some(bound)) = (self.rate.rate, self.wanted) else {
            return TargetResult::Kept;
        };
        if bound.keeps(rate) {
            return TargetResult::Kept;
        }
        let by_chance = self.rate.interval.into_iter().any(|end| bound.keeps(end));
        match (self.rate.of as f64) < bound.cases_min() && by_chance {
            true => TargetResult::TooFew,
            false => TargetResult::Missed,
        }
    }
}

/// Detection within a range of strengths.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Detection {
    /// Lower and upper strength.
    pub strengths: [f64; 2],
    /// Share of right names.
    pub named: Rate,
    /// Share of verdicts other than none.
    pub noticed: Rate,
}

/// Scores of a family of cases: those with the given law, loop and kind of file. A missing field
/// means any.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FamilySummary {
    /// The law of the truth.
    pub law: Option<Law>,
    /// The loop on board.
    pub on_board: Option<LoopKind>,
    /// Quality of the vehicle files.
    pub file: Option<FileKind>,
    /// Share that is right or acceptable.
    pub good: Rate,
    /// Share that names its effect first, among those of practical size.
    pub named: Rate,
    /// Share that names a false effect.
    pub confidently_wrong: Rate,
    /// Mean Brier score of causes of practical size and of nulls.
    pub brier: Option<f64>,
}

impl FamilySummary {
    fn new(
        rows: &[Row],
        law: Option<Law>,
        on_board: Option<LoopKind>,
        file: Option<FileKind>,
    ) -> Self {
        let is = |row: &&Row| {
            law.is_none_or(|law| row.law == law)
                && on_board.is_none_or(|on_board| row.on_board == on_board)
                && file.is_none_or(|file| row.file == file)
        };
        let all: Vec<&Row> = rows.iter().filter(is).collect();
        let has_cause = |row: &&&Row| row.is_practical && row.law != Law::Unknown;
        let counted = |row: &&&Row| row.is_practical || row.kind == Kind::Null;
        Self {
            law,
            on_board,
            file,
            good: Rate::of(all.iter().map(|row| row.grade.is_good())),
            named: Rate::of(all.iter().filter(has_cause).map(|row| row.top_right)),
            confidently_wrong: Rate::of(all.iter().map(|row| row.confidently_wrong.is_some())),
            brier: mean(all.iter().filter(counted).map(|row| row.brier)),
        }
    }
}

/// Every law, loop and kind of file alone, then every combination of all three that occurs.
fn families(rows: &[Row]) -> Vec<FamilySummary> {
    let mut laws: Vec<Law> = rows.iter().map(|row| row.law).collect();
    let mut loops: Vec<LoopKind> = rows.iter().map(|row| row.on_board).collect();
    let mut files: Vec<FileKind> = rows.iter().map(|row| row.file).collect();
    let mut all: Vec<_> = rows.iter().map(|row| (row.law, row.on_board, row.file)).collect();
    laws.sort_unstable();
    laws.dedup();
    loops.sort_unstable();
    loops.dedup();
    files.sort_unstable();
    files.dedup();
    all.sort_unstable();
    all.dedup();
    if loops.len() < 2 && files.len() < 2 {
        return Vec::new();
    }
    let laws = laws.into_iter().map(|law| (Some(law), None, None));
    let loops = loops.into_iter().map(|on_board| (None, Some(on_board), None));
    let files = files.into_iter().map(|file| (None, None, Some(file)));
    let all = all.into_iter().map(|(law, on_board, file)| (Some(law), Some(on_board), Some(file)));
    laws.chain(loops)
        .chain(files)
        .chain(all)
        .map(|(law, on_board, file)| FamilySummary::new(rows, law, on_board, file))
        .collect()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Scores of one effect.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct EffectSummary {
    /// The effect's id.
    pub id: String,
    /// Share of its detectable singles that are named.
    pub named: Rate,
    /// Median relative error of its parameters where it is detectable.
    pub error: Option<f64>,
    /// Share of the 90 % intervals that contain the truth.
    pub covered: Rate,
    /// Detection by strength.
    pub detection: Vec<Detection>,
}

/// The id for all effects together.
const EVERY_EFFECT: &str = "every effect";

/// Scores of one effect, or of all together, with logs in one condition.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct ConditionSummary {
    /// The effect's id; `every effect` for all together.
    pub id: String,
    /// Condition of the logs.
    pub condition: Condition,
    /// Share that is named first.
    pub named: Rate,
    /// Share of the 90 % intervals that contain the truth.
    pub covered: Rate,
}

/// The scores of an exam.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Summary {
    /// Number of cases.
    #[serde(skip)]
    pub count: usize,
    /// Rates with their targets.
    pub measures: Vec<Measure>,
    /// Mean Brier score of causes of practical size and of nulls; at most 0.05. No answer can be
    /// sure of a truth that hardly shows.
    pub brier: Option<f64>,
    /// Mean Brier score of every case.
    pub brier_of_all: Option<f64>,
    /// Mean difference between stated probabilities and true shares over the bins of the
    /// reliability table; at most 0.03.
    pub calibration_error: Option<f64>,
    /// Median relative error of parameters.
    pub error: Option<f64>,
    /// Share of the 90 % intervals that contain the truth.
    pub covered: Rate,
    /// Median closure: as claimed, and true.
    pub closure: [Option<f64>; 2],
    /// Median difference between the two.
    pub closure_off: Option<f64>,
    /// Reliability of stated probabilities, by bin.
    pub reliability: Vec<Reliability>,
    /// Scores by law, loop and file.
    pub families: Vec<FamilySummary>,
    /// Detection by strength, all effects together.
    pub detection: Vec<Detection>,
    /// Scores by effect.
    pub effects: Vec<EffectSummary>,
    /// Scores by effect and condition of the logs, in a round trip.
    pub conditions: Vec<ConditionSummary>,
    /// Median duration of a diagnosis, s.
    pub seconds: Option<f64>,
}

impl Summary {
    /// Summarises all rows.
    pub fn new(rows: &[Row]) -> Self {
        let cases = Cases(rows);
        let known: Vec<&Row> = cases.known().collect();
        let errors = |rows: &mut dyn Iterator<Item = &Row>| -> Option<f64> {
            median(rows.flat_map(|row| row.errors.values().flatten().copied()).collect())
        };
        let covered = |rows: &mut dyn Iterator<Item = &Row>| {
            Rate::of(rows.flat_map(|row| row.covered.values().flatten().copied()))
        };
        // Both over the same cases, to be comparable.
        let closed =
            || known.iter().filter_map(|row| Some([row.claimed_closure?, row.true_closure?]));
        let closure = |i: usize| median(closed().map(|both| both[i]).collect());
        let shows = |row: &&Row| row.is_practical || row.kind == Kind::Null;
        let bins = reliability(rows);
        let off = closed().map(|[claimed, is]| (claimed - is).abs()).collect();
        Self {
            count: rows.len(),
            measures: measures(cases),
            brier: mean(rows.iter().filter(shows).map(|row| row.brier)),
            brier_of_all: mean(rows.iter().map(|row| row.brier)),
            calibration_error: calibration_error(&bins),
            error: errors(&mut known.iter().copied().filter(|row| row.top_right)),
            covered: covered(&mut known.iter().copied()),
            closure: [closure(0), closure(1)],
            closure_off: median(off),
            reliability: bins,
            families: families(rows),
            detection: detection(&cases.singles().collect::<Vec<_>>()),
            effects: effects(rows),
            conditions: conditions(rows),
            seconds: median(rows.iter().map(|row| row.seconds).collect()),
        }
    }

    /// Compares the Brier score with its limit, which a single confident mistake may exceed.
    pub fn brier_result(&self) -> TargetResult {
        match self.brier {
            Some(brier) if brier > BRIER_MAX && self.has_few_cases() => TargetResult::TooFew,
            Some(brier) if brier > BRIER_MAX => TargetResult::Missed,
            _ => TargetResult::Kept,
        }
    }

    /// Whether the exam has so few cases that a single one decides the result.
    pub fn has_few_cases(&self) -> bool {
        (self.count as f64) < 1.0 / BRIER_MAX
    }

    /// Compares the expected calibration error with its limit.
    pub fn calibration_result(&self) -> TargetResult {
        match self.calibration_error {
            Some(error) if error > CALIBRATION_MAX && self.has_few_cases() => TargetResult::TooFew,
            Some(error) if error > CALIBRATION_MAX => TargetResult::Missed,
            _ => TargetResult::Kept,
        }
    }

    /// Whether no measure misses its target, and the Brier score and the calibration meet theirs.
    pub fn holds(&self) -> bool {
        self.brier_result() != TargetResult::Missed
            && self.calibration_result() != TargetResult::Missed
            && self.reliability.iter().all(Reliability::holds)
            && self.of(TargetResult::Missed).next().is_none()
    }

    /// The measures with this result.
    pub fn of(&self, result: TargetResult) -> impl Iterator<Item = &Measure> {
        self.measures.iter().filter(move |measure| measure.result() == result)
    }
}

fn effects(rows: &[Row]) -> Vec<EffectSummary> {
    let mut by_effect: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in rows
        .iter()
        .filter(|row| matches!(row.kind, Kind::Single | Kind::Modelled | Kind::RoundTrip))
    {
        for id in &row.truth {
            by_effect.entry(id).or_default().push(row);
        }
    }
    by_effect
        .into_iter()
        .map(|(id, rows)| {
            let seen = || rows.iter().filter(|row| row.is_practical);
            let found = seen().filter(|row| row.top_right);
            EffectSummary {
                named: Rate::of(seen().map(|row| row.top_right)),
                error: median(
                    found.flat_map(|row| row.errors.values().flatten().copied()).collect(),
                ),
                covered: Rate::of(seen().flat_map(|row| row.covered.values().flatten().copied())),
                detection: detection(&rows),
                id: id.to_owned(),
            }
        })
        .collect()
}

/// All effects together first, then each.
fn conditions(rows: &[Row]) -> Vec<ConditionSummary> {
    let mut pooled: BTreeMap<(&str, Condition), Vec<&Row>> = BTreeMap::new();
    let mut single = pooled.clone();
    for row in rows.iter().filter(|row| row.kind == Kind::RoundTrip) {
        pooled.entry((EVERY_EFFECT, row.condition)).or_default().push(row);
        for id in &row.truth {
            single.entry((id, row.condition)).or_default().push(row);
        }
    }
    pooled
        .into_iter()
        .chain(single)
        .map(|((id, condition), rows)| ConditionSummary {
            id: id.to_owned(),
            condition,
            named: Rate::of(rows.iter().map(|row| row.top_right)),
            covered: Rate::of(rows.iter().flat_map(|row| row.covered.values().flatten().copied())),
        })
        .collect()
}

fn detection(rows: &[&Row]) -> Vec<Detection> {
    ranges(&STRENGTHS)
        .map(|[low, high]| {
            let here = || rows.iter().filter(move |row| (low..high).contains(&row.ratio));
            Detection {
                strengths: [low, high],
                named: Rate::of(here().map(|row| row.top_right)),
                noticed: Rate::of(here().map(|row| row.verdict != "none")),
            }
        })
        .filter(|detection| detection.named.of > 0)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brier_score_beyond_its_bound_fails() {
        let mut summary = Summary { count: 60, ..Summary::new(&[]) };
        assert!(summary.holds());
        summary.brier = Some(2.0 * BRIER_MAX);
        assert!(!summary.holds());
        // With six cases, a single confident mistake does as much.
        summary.count = 6;
        assert_eq!(summary.brier_result(), TargetResult::TooFew);
        assert!(summary.holds());
    }

    #[test]
    fn few_cases_fail_a_bound_only_beyond_chance() {
        let result = |count, of, wanted| {
            Measure { name: "rate", rate: Rate::new(count, of), wanted: Some(wanted) }.result()
        };
        let (nine_tenths, none) = (Bound::AtLeast(0.9), Bound::AtMost(0.0));
        assert_eq!(result(6, 6, nine_tenths), TargetResult::Kept);
        assert_eq!(result(5, 6, nine_tenths), TargetResult::TooFew);
        assert_eq!(result(0, 6, nine_tenths), TargetResult::Missed);
        assert_eq!(result(40, 60, nine_tenths), TargetResult::Missed);
        assert_eq!(result(1, 6, none), TargetResult::Missed);
        assert_eq!(result(1, 10, Bound::AtMost(0.03)), TargetResult::TooFew);
        // Both of two, where at most 95 % may: deciding takes twenty cases.
        assert_eq!(result(2, 2, Bound::AtMost(0.95)), TargetResult::TooFew);
        assert_eq!(result(60, 60, Bound::AtMost(0.95)), TargetResult::Missed);
        assert_eq!(result(0, 0, nine_tenths), TargetResult::Kept);
    }
}
