//! Misfit: what an explanation leaves beyond what twins of its own vehicle leave, against what it
//! explains.
//!
//! The cost of a fit is `sum n/2 ln(Q/n)` over channels and bands. Twins of the explanation's own
//! vehicle say which cost noise alone would leave; what lies between is what a perfect explanation
//! would still gain, in nats (a posterior predictive check; Gelman, Meng and Stern 1996). A
//! neighbour of the true cause explains a part and leaves the rest; the cause itself leaves
//! nothing.

use serde::Serialize;

use super::fit::{Fit, Z90};
use super::layout::Place;
use super::observed::noise_cost;
use super::residuals::{CHANNELS, COMMAND, FORCE, RATE, VELOCITY};
use super::spectrum::BANDS;
use super::twins::TwinFits;

/// Equations that are told apart: name, first channel and the end. The yaw moment that was
/// commanded is left out: twins do not have all the noise that is in it.
const GROUPS: [(&str, usize, usize); 4] = [
    ("acceleration", VELOCITY, VELOCITY + 3),
    ("specific force", FORCE, FORCE + 3),
    ("angular acceleration", RATE, RATE + 3),
    (COMMANDS, COMMAND, CHANNELS - 1),
];
const COMMANDS: &str = "command";
/// What an explanation gains by leaving the vehicle file's numbers where they are: the nuisances
/// alone may fit as well, but only by numbers that are further off than files are.
const NUMBERS: &str = "numbers of the file";
/// Above this, sensors' noise and its colour outweigh any motion, Hz.
const MAX_HZ: f64 = 3.2;
/// Standard errors up to which it may be chance: the twins' own noise is not quite the flights'.
const CHANCE: f64 = 2.5;
/// Standard errors from which on what is left is a cause's. In the commands, of 240 vehicles
/// without an effect in two exams four had 8 to 20; causes that nuisances had passed over began at
/// 14.
const STANDS_OUT: f64 = 12.0;
/// The same of all groups but the command's together: of 70 vehicles without an effect none had
/// more than 1.8.
const STAND_OUT_TOGETHER: f64 = 3.5;
/// An explanation is answerable for the equations that give it so much of its evidence.
const ANSWERABLE: f64 = 0.2;

/// Costs in one group of channels below [`MAX_HZ`], nats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Misfit {
    /// Which equations, or that it is the numbers of the file.
    pub equations: &'static str,
    /// What the explanation gains over the nuisances alone.
    pub explained: f64,
    /// What a perfect one would gain beyond it; below 0 by chance only.
    pub left: f64,
    /// Standard error of what is left.
    pub error: f64,
}

/// The misfit of `best`, with `null` the fit of the nuisances alone and `twins` of the vehicle of
/// `best`, which may be the null itself. `counts`: coefficients at each place.
pub fn misfit(null: &Fit, best: &Fit, twins: &TwinFits, counts: &[f64]) -> Vec<Misfit> {
    let moments = twins.moments();
    let group = |(equations, first, end): (&'static str, usize, usize)| {
        let mut misfit = Misfit { equations, explained: 0.0, left: 0.0, error: 0.0 };
        let bands = BANDS.iter().filter(|upper| **upper <= MAX_HZ).count();
        let places = (first..end)
            .flat_map(|channel| (0..bands).map(move |band| Place::index_of(channel, band)));
        let places: Vec<usize> =
            places.filter(|place| counts[*place] >= 1.0 && moments[*place][0] > 0.0).collect();
        let cost = |power: &[f64]| -> f64 {
            let of_one = |place: &usize| {
                let ratio = power[*place].max(f64::MIN_POSITIVE) / moments[*place][0];
                0.5 * counts[*place] * ratio.ln()
            };
            places.iter().map(of_one).sum()
        };
        misfit.explained = cost(&null.power) - cost(&best.power);
        // Of the twins' sums, for what is left at one place may go with what is left at others: the
        // noise at a block's ends is in all of its low frequencies.
        let [mean, deviation] = twins.moments_of(cost);
        misfit.left = cost(&best.power) - mean;
        misfit.error = deviation;
        misfit
    };
    let pulled = |fit: &Fit| fit.cost - noise_cost(&fit.power, counts);
    let explained = pulled(null) - pulled(best);
    let numbers = Misfit { equations: NUMBERS, explained, left: 0.0, error: 0.0 };
    GROUPS.into_iter().map(group).chain((explained != 0.0).then_some(numbers)).collect()
}

impl Misfit {
    /// What is left at least: the lower end of its 90 % interval, where it is more than chance.
    fn surely_left(&self) -> f64 {
        if self.left > CHANCE * self.error { self.left - Z90 * self.error } else { 0.0 }
    }
}

/// Share of what could be explained that is surely left, 0..1, in the equations that the explanation
/// is answerable for.
pub fn share_left(misfits: &[Misfit]) -> f64 {
    let total: f64 = misfits.iter().map(|misfit| misfit.explained.max(0.0)).sum();
    let answerable = misfits.iter().filter(|misfit| misfit.explained > ANSWERABLE * total);
    let left: f64 = answerable.map(Misfit::surely_left).sum();
    if left > 0.0 { left / (left + total) } else { 0.0 }
}

/// The group of equations that stands out most by what is left there, where it stands out beyond
/// what sets twins off from flights, alone or with the others of the motion. The command's counts
/// where the on-board loop's numbers are at their limits as well (`is_loop_held`): a link or a
/// clock that twins do not have is left there, too.
pub fn standing_out(misfits: &[Misfit], is_loop_held: bool) -> Option<&Misfit> {
    let in_errors = |misfit: &Misfit| misfit.left / misfit.error.max(f64::MIN_POSITIVE);
    let of_motion = misfits.iter().filter(|misfit| misfit.equations != COMMANDS);
    let sums = of_motion.clone().fold([0.0; 2], |[left, squares], misfit| {
        [left + misfit.left, squares + misfit.error.powi(2)]
    });
    if sums[0] > STAND_OUT_TOGETHER * sums[1].sqrt() {
        return of_motion.max_by(|a, b| in_errors(a).total_cmp(&in_errors(b)));
    }
    let counted = misfits.iter().filter(|misfit| misfit.equations != COMMANDS || is_loop_held);
    let most = counted.max_by(|a, b| in_errors(a).total_cmp(&in_errors(b)));
    most.filter(|misfit| in_errors(misfit) > STANDS_OUT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn misfit(equations: &'static str, explained: f64, left: f64) -> Misfit {
        Misfit { equations, explained, left, error: 10.0 }
    }

    #[test]
    fn what_is_left_counts_where_the_explanation_is_answerable() {
        let forces = misfit("acceleration", 160.0, 40.0 + 10.0 * Z90);
        let share = share_left(std::slice::from_ref(&forces));
        assert!((share - 0.2).abs() < 1e-12, "{share}");
        // Within the standard errors of chance, or in an equation that it says nothing about.
        assert_eq!(share_left(&[misfit("acceleration", 160.0, 24.0)]), 0.0);
        assert_eq!(share_left(&[forces, misfit("command", 0.0, 500.0)]), share);
        assert_eq!(share_left(&[misfit("command", 0.0, 0.0)]), 0.0);
    }

    #[test]
    fn the_equations_that_stand_out_most_are_told() {
        let forces = misfit("acceleration", 0.0, 30.0);
        assert_eq!(standing_out(std::slice::from_ref(&forces), true), None);
        let command = misfit("command", 0.0, 130.0);
        assert_eq!(standing_out(&[forces.clone(), command.clone()], true), Some(&command));
        assert_eq!(standing_out(&[forces, command], false), None);
        assert_eq!(standing_out(&[], true), None);
        // Little in each equation, but in all of them.
        let motion = ["acceleration", "specific force", "angular acceleration"];
        let three = motion.map(|equations| misfit(equations, 0.0, 30.0));
        assert!(standing_out(&three, false).is_some());
        let mixed = [misfit(motion[0], 0.0, 60.0), misfit(motion[1], 0.0, -30.0)];
        assert_eq!(standing_out(&mixed, false), None);
    }
}
