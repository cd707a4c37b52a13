//! The table: one row per change and feedback.

use crate::change::Change;
use crate::feedback::Feedback;
use crate::flight::{AFTER_S, BEFORE_S, Flown};

/// Errors are averaged over this time and all flights, s.
const WINDOW_S: f64 = 0.25;
/// The error has recovered within this factor of the oracle's.
const BACK: f64 = 1.2;
/// Normal quantile of a two-sided 95 % interval.
const NORMAL_95: f64 = 1.96;

pub fn head() {
    println!(
        "{:<8} {:<19} {:>10} {:>10} {:>10} {:>10} {:>8} {:>16}",
        "change",
        "feedback",
        "before [m]",
        "peak [m]",
        "after [m]",
        "of oracle",
        "back [s]",
        "lost (95 %)"
    );
}

/// Root mean square over all flights, in windows from `from_s` to `to_s` after the change.
fn windows(flown: &[Flown], from_s: f64, to_s: f64) -> Vec<f64> {
    let count = ((to_s - from_s) / WINDOW_S).round() as usize;
    let mut sums = vec![(0.0, 0.0); count];
    for (time_s, error) in flown.iter().flat_map(|flown| &flown.errors) {
        let window = ((time_s - from_s) / WINDOW_S).floor();
        if window >= 0.0
            && let Some((sum, number)) = sums.get_mut(window as usize)
        {
            *sum += error * error;
            *number += 1.0;
        }
    }
    sums.into_iter().map(|(sum, number)| f64::sqrt(sum / number)).collect()
}

fn rms(windows: &[f64]) -> f64 {
    (windows.iter().map(|error| error * error).sum::<f64>() / windows.len() as f64).sqrt()
}

/// Mean over the flights of the largest error after the change, m.
fn peak(flown: &[Flown]) -> f64 {
    let largest = |flown: &Flown| {
        let after = flown.errors.iter().filter(|(time_s, _)| (0.0..AFTER_S).contains(time_s));
        after.map(|(_, error)| *error).fold(0.0, f64::max)
    };
    flown.iter().map(largest).sum::<f64>() / flown.len() as f64
}

/// Wilson's interval of a proportion.
fn interval(lost: usize, of: usize) -> [f64; 2] {
    let (n, p, z) = (of as f64, lost as f64 / of as f64, NORMAL_95);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// Prints the error of every window, mm, and of the same window of the oracle's flights.
pub fn windows_of(flown: &[Flown], oracle: &[Flown]) {
    let (after, known) = (windows(flown, 0.0, AFTER_S), windows(oracle, 0.0, AFTER_S));
    for (window, (after, known)) in after.into_iter().zip(known).enumerate() {
        let (from_s, after_mm, known_mm) = (window as f64 * WINDOW_S, after * 1e3, known * 1e3);
        println!("    {from_s:>5.2} s {after_mm:>8.2} mm {known_mm:>8.2} mm");
    }
}

pub fn row(change: Change, feedback: &Feedback, flown: &[Flown], oracle: &[Flown]) {
    let before = rms(&windows(flown, -BEFORE_S, 0.0));
    let (after, known) = (windows(flown, 0.0, AFTER_S), windows(oracle, 0.0, AFTER_S));
    let late = after.len() / 2;
    let ratio = rms(&after[late..]) / rms(&known[late..]);
    let is_back = |(after, known): (&f64, &f64)| *after <= BACK * *known;
    let beyond = after.iter().zip(&known).rposition(|pair| !is_back(pair));
    let back = match beyond {
        None => "0.00".to_owned(),
        Some(last) if last + 1 == after.len() => "never".to_owned(),
        Some(last) => format!("{:.2}", (last + 1) as f64 * WINDOW_S),
    };
    let lost = flown.iter().filter(|flown| flown.is_lost).count();
    let [low, high] = interval(lost, flown.len()).map(|share| 100.0 * share);
    println!(
        "{:<8} {:<19} {before:>10.4} {:>10.4} {:>10.4} {ratio:>10.2} {back:>8} {:>16}",
        change.name(),
        feedback.name,
        peak(flown),
        rms(&after[late..]),
        format!("{lost} ({low:.1}-{high:.1} %)"),
    );
}
