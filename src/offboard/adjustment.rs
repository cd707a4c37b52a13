//! Changes that viewers may make in flight: an offset of the goal, and a factor on the feedback.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::Ned;

use super::OffboardController;
use super::guidance::Extent;
use crate::clock::HostTime;
use crate::supervisor::{SafetySettings, Severity};

/// Bounds of what may be changed in flight.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdjustmentSettings {
    /// Farthest that a goal may be moved from where the flight has it, m.
    pub goal_max_m: f64,
    /// Lowest height above the anchor that a goal may be moved to, m.
    pub height_min_m: f64,
    /// A goal may be moved no nearer to the geofence than this, m.
    pub fence_margin_m: f64,
    /// Largest factor on the law's feedback; the smallest is one over it.
    pub feedback_scale_max: f64,
}

impl Default for AdjustmentSettings {
    fn default() -> Self {
        Self { goal_max_m: 3.0, height_min_m: 0.3, fence_margin_m: 1.0, feedback_scale_max: 1.5 }
    }
}

/// The current values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adjusted {
    /// Offset of the goal, reached or on the way, m.
    pub goal: Ned,
    /// Factor on the law's feedback.
    pub feedback_scale: f64,
}

impl Default for Adjusted {
    fn default() -> Self {
        Self { goal: Ned::zero(), feedback_scale: 1.0 }
    }
}

/// A requested change, applied as a whole or not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adjustment {
    /// Offset of the goal to the north, m.
    pub north_m: Option<f64>,
    /// Offset of the goal to the east, m.
    pub east_m: Option<f64>,
    /// Offset of the goal upwards, m.
    pub up_m: Option<f64>,
    /// Factor on the law's feedback.
    pub feedback_scale: Option<f64>,
}

impl Adjustment {
    fn of(&self, held: &Adjusted) -> Adjusted {
        let [north, east, down] = held.goal.to_array();
        let goal = Ned::new(
            self.north_m.unwrap_or(north),
            self.east_m.unwrap_or(east),
            self.up_m.map_or(down, |up| -up),
        );
        Adjusted { goal, feedback_scale: self.feedback_scale.unwrap_or(held.feedback_scale) }
    }
}

impl fmt::Display for Adjusted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [north, east, down] = self.goal.to_array();
        let up = 0.0 - down;
        write!(f, "goal {north:.2} m north, {east:.2} m east, {up:.2} m up from where it was, ")?;
        write!(f, "feedback x {:.2}", self.feedback_scale)
    }
}

impl AdjustmentSettings {
    /// The reason to refuse a change, if any. `reach` is the extent of the reference with the
    /// change, `now` without: a reference already beyond a bound may come nearer.
    fn objection(
        &self,
        requested: &Adjusted,
        now: &Extent,
        reach: &Extent,
        safety: &SafetySettings,
    ) -> Option<String> {
        let (distance, scale) = (requested.goal.norm(), requested.feedback_scale);
        let most = self.feedback_scale_max;
        let radius = safety.fence_radius_m - self.fence_margin_m;
        let height = safety.fence_height_m - self.fence_margin_m;
        // NaN is within no range.
        let is_within = |value: f64, least: f64, most: f64| value >= least && value <= most;
        if !is_within(distance, 0.0, self.goal_max_m) {
            return Some(format!("a goal moves by at most {} m", self.goal_max_m));
        }
        if !is_within(scale, 1.0 / most, most) {
            return Some(format!("feedback is scaled by {:.2} to {most:.2}", 1.0 / most));
        }
        if !is_within(reach.radius_m, 0.0, radius.max(now.radius_m))
            || !is_within(reach.highest_m, f64::MIN, height.max(now.highest_m))
        {
            return Some("it leads too close to the geofence".to_owned());
        }
        if !is_within(reach.lowest_m, self.height_min_m.min(now.lowest_m), f64::MAX) {
            return Some(format!("it leads below {} m", self.height_min_m));
        }
        None
    }
}

impl OffboardController {
    /// The current values of what viewers may change.
    pub fn adjusted(&self) -> Adjusted {
        Adjusted { goal: self.guidance.goal(), feedback_scale: self.controller.feedback_scale() }
    }

    /// Applies a viewer's change if the supervisor permits it and it is within bounds. An event
    /// reports the outcome.
    pub fn adjust(&mut self, now: HostTime, request: &Adjustment) {
        let held = self.adjusted();
        let requested = request.of(&held);
        let objection = match self.supervisor.accepts_adjustments(self.airborne()) {
            false => {
                Some("goal and feedback change only in track, in hold and before a flight".into())
            }
            true => {
                let here = self.telemetry.last_sample().map(|sample| sample.state.position);
                let here = here.unwrap_or_default();
                let now = self.guidance.extent(held.goal, here);
                let reach = self.guidance.extent(requested.goal, here);
                let safety = &self.settings.safety;
                self.settings.adjustment.objection(&requested, &now, &reach, safety)
            }
        };
        if let Some(why) = objection {
            let text = format!("a viewer's change is refused ({requested}): {why}");
            return self.supervisor.report(now, Severity::Warning, text);
        }
        if requested != held {
            self.guidance.move_goal(requested.goal);
            self.controller.scale_feedback(requested.feedback_scale);
            self.supervisor.report(now, Severity::Info, format!("a viewer's change: {requested}"));
        }
    }

    /// Resets viewers' changes at the end of a flight.
    pub(super) fn end_adjustment(&mut self, now: HostTime) {
        if self.adjusted() != Adjusted::default() {
            self.guidance.forget_goal();
            self.controller.scale_feedback(1.0);
            self.supervisor.report(now, Severity::Info, "the viewers' changes end with the flight");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fence() -> SafetySettings {
        SafetySettings { fence_radius_m: 10.0, fence_height_m: 5.0, ..SafetySettings::default() }
    }

    #[test]
    fn out_of_bounds_adjustment_is_refused_with_the_bound() {
        let settings = AdjustmentSettings::default();
        let now = Extent { radius_m: 1.0, highest_m: 1.0, lowest_m: 1.0 };
        let judge = |request: Adjustment, reach: Extent| {
            settings.objection(&request.of(&Adjusted::default()), &now, &reach, &fence())
        };
        let north = |north| Adjustment { north_m: Some(north), ..Adjustment::default() };
        let scaled = |scale| Adjustment { feedback_scale: Some(scale), ..Adjustment::default() };
        assert_eq!(judge(north(2.9), now), None);
        assert_eq!(judge(scaled(1.5), now), None);
        assert_eq!(judge(scaled(0.67), now), None);
        let far = Extent { radius_m: 9.1, ..now };
        let high = Extent { highest_m: 4.1, ..now };
        let low = Extent { lowest_m: 0.2, ..now };
        for (request, reach, text) in [
            (north(3.1), now, "at most 3 m"),
            (north(f64::NAN), now, "at most 3 m"),
            (north(f64::INFINITY), now, "at most 3 m"),
            (scaled(1.6), now, "0.67 to 1.50"),
            (scaled(0.0), now, "0.67 to 1.50"),
            (scaled(-1.0), now, "0.67 to 1.50"),
            (scaled(f64::NAN), now, "0.67 to 1.50"),
            (north(1.0), far, "geofence"),
            (north(1.0), high, "geofence"),
            (north(1.0), low, "below 0.3 m"),
        ] {
            let found = judge(request, reach).expect("refused");
            assert!(found.contains(text), "{request:?}: {found}");
        }
    }

    #[test]
    fn adjustment_beyond_a_bound_may_move_back_towards_it() {
        let settings = AdjustmentSettings::default();
        let requested = Adjusted { goal: Ned::new(1.0, 0.0, 0.0), feedback_scale: 1.0 };
        let now = Extent { radius_m: 9.5, highest_m: 1.0, lowest_m: 0.0 };
        let nearer = Extent { radius_m: 9.4, ..now };
        assert_eq!(settings.objection(&requested, &now, &nearer, &fence()), None);
    }
}
