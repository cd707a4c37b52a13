//! A slack and its multiplier, and the soft bounds built from them.

use super::problem::StateRow;

/// Complementarity at the start, in units of the cost.
const START: f64 = 0.1;

/// A complementary pair: a slack and its multiplier, both above 0.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pair {
    pub slack: f64,
    pub multiplier: f64,
    /// Steps of the current Newton direction.
    pub slack_step: f64,
    pub multiplier_step: f64,
}

impl Pair {
    pub fn new(slack: f64) -> Self {
        Self { slack, multiplier: START / slack, ..Self::default() }
    }

    /// multiplier / slack.
    #[inline(always)]
    pub fn ratio(&self) -> f64 {
        self.multiplier / self.slack
    }

    /// The multiplier at complementarity `target`, before the slack moves.
    #[inline(always)]
    pub fn aim(&self, target: f64) -> f64 {
        target / self.slack
    }

    /// Sets the direction: the slack moves by `step`, the multiplier follows from complementarity.
    #[inline(always)]
    pub fn point(&mut self, step: f64, target: f64) {
        self.slack_step = step;
        self.multiplier_step = self.aim(target) - self.ratio() * step - self.multiplier;
    }

    /// Largest fraction of the direction that keeps both above 0.
    #[inline(always)]
    pub fn reach(&self) -> f64 {
        let share = |value: f64, step: f64| if step < 0.0 { -value / step } else { f64::INFINITY };
        share(self.slack, self.slack_step).min(share(self.multiplier, self.multiplier_step))
    }

    /// Complementarity after a fraction of the direction.
    #[inline(always)]
    pub fn after(&self, share: f64) -> f64 {
        (self.slack + share * self.slack_step) * (self.multiplier + share * self.multiplier_step)
    }

    /// The corrector's target: `centre` less the predictor's second-order term.
    #[inline(always)]
    pub fn corrected(&self, centre: f64) -> f64 {
        centre - self.slack_step * self.multiplier_step
    }

    #[inline(always)]
    pub fn advance(&mut self, share: f64) {
        self.slack += share * self.slack_step;
        self.multiplier += share * self.multiplier_step;
    }
}

/// A bound of the state with its slack: `excess + gradient . d <= overrun`, `overrun >= 0`.
#[derive(Clone, Copy, Debug)]
pub(super) struct SoftRow {
    pub row: StateRow,
    /// Room below the bound, and the bound's force.
    pub room: Pair,
    /// The overrun, and the rest of the penalty.
    pub overrun: Pair,
    pub room_target: f64,
    pub overrun_target: f64,
}

impl SoftRow {
    /// The overrun's step for a fixed state: the excess of the two target multipliers over the
    /// penalty, divided by the sum of their ratios.
    pub fn relaxation(&self) -> f64 {
        let penalty = self.room.multiplier + self.overrun.multiplier;
        let aimed = self.room.aim(self.room_target) + self.overrun.aim(self.overrun_target);
        (aimed - penalty) / (self.room.ratio() + self.overrun.ratio())
    }

    /// The Newton multiplier for a fixed state.
    pub fn force(&self) -> f64 {
        self.room.aim(self.room_target) - self.room.ratio() * self.relaxation()
    }

    /// Derivative of the Newton multiplier with respect to the excess.
    pub fn curvature(&self) -> f64 {
        let (room, overrun) = (self.room.ratio(), self.overrun.ratio());
        room * overrun / (room + overrun)
    }

    /// Sets the directions for a change of the excess by `moved`.
    pub fn point(&mut self, moved: f64) {
        let (room, overrun) = (self.room.ratio(), self.overrun.ratio());
        let step = self.relaxation() + room / (room + overrun) * moved;
        self.overrun.point(step, self.overrun_target);
        self.room.point(step - moved, self.room_target);
    }
}
