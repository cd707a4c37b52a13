//! Calibration: finds the numbers of the decision that score best on stored cases, and tests them
//! on other families of cases.

use std::fmt::{self, Display};

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use super::order::Kind;
use super::score::Row;
use super::stored::StoredCase;
use super::summary::Summary;
use crate::diagnose::verdict::calibration::{Calibration, SIGNS};
use crate::diagnose::verdict::decide_with;

/// Probability that counts for an effect that an answer does not mention.
const UNMENTIONED: f64 = 0.02;
/// Ridge penalty on the weights of the signs, since few cases are outside the catalogue.
const RIDGE: f64 = 0.05;
/// Values of `law` that are tried.
const LAW_CANDIDATES: [f64; 6] = [0.02, 0.03, 0.04, 0.06, 0.1, 0.15];
/// Smallest difference of log scores that separates laws; within it, interval coverage decides.
const SCORE_DIFFERENCE_MIN: f64 = 0.002;
/// Nominal coverage of the intervals.
const NOMINAL_COVERAGE: f64 = 0.9;

/// A calibration with its scores.
#[derive(Debug)]
pub struct Calibrated {
    /// The calibrated numbers.
    pub calibration: Calibration,
    fitted: CaseScores,
    tested: CaseScores,
    /// Scores of the shipped calibration on the same cases.
    before: [CaseScores; 2],
    /// Log score on the fitted cases without each of the signs.
    without: [f64; SIGNS],
}

/// Scores on a set of cases.
#[derive(Debug)]
struct CaseScores {
    cases: usize,
    log_score: f64,
    summary: Summary,
}

impl CaseScores {
    fn of(cases: &[&StoredCase], calibration: &Calibration) -> Self {
        let rows: Vec<Row> = cases.par_iter().map(|case| case.row(calibration)).collect();
        let counted: Vec<&Row> = rows.iter().filter(|row| is_counted(row)).collect();
        Self {
            cases: cases.len(),
            log_score: counted.iter().map(|row| log_score(row)).sum::<f64>()
                / counted.len().max(1) as f64,
            summary: Summary::new(&rows),
        }
    }
}

fn is_counted(row: &Row) -> bool {
    (row.is_practical || row.kind == Kind::Null) && row.kind != Kind::Trap
}

/// Log of the probability that an answer gives to the truth, and against each false effect.
fn log_score(row: &Row) -> f64 {
    let within = |p: f64| p.clamp(UNMENTIONED, 1.0 - 0.5 * UNMENTIONED);
    let is_outside = matches!(row.kind, Kind::LeftOut | Kind::Foreign);
    let is_there = |id: &String| row.kind != Kind::LeftOut && row.is_right(id);
    let given: f64 = row
        .probabilities
        .iter()
        .map(|(id, p)| if is_there(id) { within(*p).ln() } else { within(1.0 - p).ln() })
        .sum();
    let names_one = row.probabilities.iter().any(|(id, _)| is_there(id));
    let is_due = !is_outside && row.kind != Kind::Null;
    let missed = (is_due && !names_one) || (is_outside && row.verdict == "none");
    // At least, unknown shows that something was noticed.
    let noticed = if row.verdict == "unknown" { 0.5_f64.ln() } else { UNMENTIONED.ln() };
    given
        + match (missed, row.kind) {
            (true, _) => noticed,
            (false, Kind::Null) if row.verdict == "unknown" => 0.1_f64.ln(),
            _ => 0.0,
        }
}

/// Calibrates on the families of `cases` for fitting, and tests on the others.
pub fn calibrate(cases: &[StoredCase]) -> Calibrated {
    let (tested, fitted): (Vec<&StoredCase>, Vec<&StoredCase>) =
        cases.iter().partition(|case| case.is_for_testing());
    let shipped = Calibration::shipped();
    let score = |calibration: &Calibration| CaseScores::of(&fitted, calibration).log_score;
    let trials = LAW_CANDIDATES.map(|law| {
        let trial = Calibration { law, ..shipped.clone() };
        let found = with_discrepancy(&fitted, &trial, [true; SIGNS]);
        (CaseScores::of(&fitted, &found), found)
    });
    let top = trials.iter().map(|(fared, _)| fared.log_score).fold(f64::NEG_INFINITY, f64::max);
    let off = |fared: &CaseScores| {
        (fared.summary.covered.rate.unwrap_or(NOMINAL_COVERAGE) - NOMINAL_COVERAGE).abs()
    };
    let best = trials
        .iter()
        .filter(|(fared, _)| fared.log_score > top - SCORE_DIFFERENCE_MIN)
        .min_by(|a, b| off(&a.0).total_cmp(&off(&b.0)));
    let mut calibration = best.map_or_else(|| shipped.clone(), |(_, found)| found.clone());
    let without = std::array::from_fn(|sign| {
        let used = std::array::from_fn(|other| other != sign);
        score(&with_discrepancy(&fitted, &calibration, used))
    });
    calibration.version = shipped.version + 1;
    let fared =
        |calibration: &Calibration| [&fitted, &tested].map(|c| CaseScores::of(c, calibration));
    let before = fared(shipped);
    let [fitted, tested] = fared(&calibration);
    Calibrated { calibration, fitted, tested, before, without }
}

/// The calibration with weights of the signs from a logistic regression of whether the cause is
/// outside the catalogue. It uses Newton's method, and only the first weight may be negative.
fn with_discrepancy(
    cases: &[&StoredCase],
    calibration: &Calibration,
    used: [bool; SIGNS],
) -> Calibration {
    let sign = |case: &&StoredCase| {
        let is_outside = matches!(case.key.kind, Kind::LeftOut | Kind::Foreign);
        let counts = case.key.is_practical || case.key.kind == Kind::Null;
        let decision = decide_with(case.evidence.as_ref()?, calibration);
        let is_counted = counts && case.key.kind != Kind::Trap;
        is_counted.then(|| (SVector::from(decision.signs), f64::from(is_outside)))
    };
    let signs: Vec<(SVector<f64, SIGNS>, f64)> = cases.par_iter().filter_map(sign).collect();
    let mut used = used;
    loop {
        let weights = logistic(&signs, used);
        let Some(below) = (1..SIGNS).find(|i| weights[*i] < 0.0) else {
            return Calibration { discrepancy: weights.into(), ..calibration.clone() };
        };
        used[below] = false;
    }
}

fn logistic(signs: &[(SVector<f64, SIGNS>, f64)], used: [bool; SIGNS]) -> SVector<f64, SIGNS> {
    const STEPS: usize = 30;
    let mut weights = SVector::<f64, SIGNS>::zeros();
    for _ in 0..STEPS {
        let mut gradient = -weights * RIDGE;
        let mut curvature = SMatrix::<f64, SIGNS, SIGNS>::identity() * RIDGE;
        for (x, y) in signs {
            let p = 1.0 / (1.0 + (-weights.dot(x)).exp());
            gradient += x * (y - p);
            curvature += x * x.transpose() * (p * (1.0 - p));
        }
        for sign in (0..SIGNS).filter(|sign| !used[*sign]) {
            gradient[sign] = 0.0;
            curvature.row_mut(sign).fill(0.0);
            curvature.column_mut(sign).fill(0.0);
            curvature[(sign, sign)] = 1.0;
        }
        let Some(step) = curvature.cholesky().map(|factor| factor.solve(&gradient)) else { break };
        weights += step * (4.0 / step.norm().max(4.0));
    }
    weights
}

impl Display for Calibrated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Calibration { version, law, discrepancy } = &self.calibration;
        writeln!(f, "# Made by `downwash exam --decide DIR --calibrate FILE`.")?;
        writeln!(f, "version = {version}")?;
        writeln!(f, "law = {law}")?;
        let rounded = discrepancy.map(|weight| (1e3 * weight).round() / 1e3);
        writeln!(f, "discrepancy = {rounded:?}")?;
        let [fitted_before, tested_before] = &self.before;
        for (name, fared, before) in
            [("made", &self.fitted, fitted_before), ("tested", &self.tested, tested_before)]
        {
            let CaseScores { cases, log_score, summary } = fared;
            writeln!(f, "\n[{name}]\ncases = {cases}")?;
            writeln!(f, "log_score = {log_score:.4}")?;
            writeln!(f, "log_score_before = {:.4}", before.log_score)?;
            if name == "made" {
                writeln!(f, "log_score_without_each_sign = {:.4?}", self.without)?;
            }
            for (what, value) in [("brier", summary.brier), ("error", summary.calibration_error)] {
                if let Some(value) = value {
                    writeln!(f, "{what} = {value:.4}")?;
                }
            }
            let held = &summary.covered;
            writeln!(f, "intervals_that_hold = [{}, {}]", held.count, held.of)?;
            writeln!(f, "# Stated probability, number true, number of cases.\nreliability = [")?;
            for bin in &summary.reliability {
                let is_true = &bin.is_true;
                writeln!(f, "    [{:.3}, {}, {}],", bin.mean, is_true.count, is_true.of)?;
            }
            writeln!(f, "]")?;
        }
        Ok(())
    }
}
