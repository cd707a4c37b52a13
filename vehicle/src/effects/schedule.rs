//! Effects that set in at an instant: a chip in a blade, a load that drops, a wind that begins.

use std::path::Path;

use serde::Serialize;

use super::{EffectError, EffectId, EffectSet, EffectsRefused};
use crate::law::Law;

/// Effects from an instant on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Onset {
    /// When, s of the vehicle's clock since it was switched on.
    pub at_s: f64,
    /// Over those that act before.
    pub effects: EffectSet,
}

/// Effects from the start, and those that set in later.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schedule {
    /// From the start.
    pub effects: EffectSet,
    /// Later, in the order of time.
    pub onsets: Vec<Onset>,
}

/// Why effects cannot set in.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OnsetError {
    /// The instant is none.
    #[error("@{0}: expected the time of an onset in s, 0 or more")]
    Time(String),
    /// The effect belongs to a sensor, a link or a loop, or has a state of its own.
    #[error(
        "{0} cannot set in during a flight: only forces, moments and constants of the vehicle can"
    )]
    Fixed(EffectId),
}

/// Effects outside the plant, or with a state that begins with the flight.
const FIXED: [EffectId; 5] = [
    EffectId::CommandDelay,
    EffectId::AttitudeTrim,
    EffectId::EstimatorLatency,
    EffectId::PdGain,
    EffectId::Gusts,
];

impl Schedule {
    /// What is asked for on a command line, as by [`EffectSet::requested`]; an argument that ends in
    /// `@41.2` sets in at 41.2 s.
    ///
    /// # Errors
    /// As [`EffectSet::requested`], and an effect that cannot set in, or no time.
    pub fn requested(file: Option<&Path>, arguments: &[String]) -> Result<Self, EffectsRefused> {
        let (later, first): (Vec<_>, Vec<_>) =
            arguments.iter().cloned().partition(|argument| split(argument).is_some());
        let mut schedule =
            Self { effects: EffectSet::requested(file, &first)?, onsets: Vec::new() };
        for argument in later {
            let refused = |source| EffectsRefused::Argument { argument: argument.clone(), source };
            if let Some((effect, at)) = split(&argument) {
                schedule.insert(effect, at).map_err(refused)?;
            }
        }
        Ok(schedule)
    }

    /// Lets an effect set in, as `--effect` has it, at a time in s.
    ///
    /// # Errors
    /// What is no effect, cannot set in, or is no time.
    pub fn insert(&mut self, effect: &str, at: &str) -> Result<(), EffectError> {
        let at_s = at.trim().parse().map_err(|_| OnsetError::Time(at.to_owned()))?;
        let mut effects = EffectSet::new();
        effects.insert_argument(effect)?;
        Ok(self.add(effects, at_s)?)
    }

    /// Lets effects set in at a time in s.
    ///
    /// # Errors
    /// What cannot set in, or no time.
    pub fn add(&mut self, effects: EffectSet, at_s: f64) -> Result<(), OnsetError> {
        if !(at_s.is_finite() && at_s >= 0.0) {
            return Err(OnsetError::Time(at_s.to_string()));
        }
        if let Some(fixed) = FIXED.into_iter().find(|id| effects.contains(*id)) {
            return Err(OnsetError::Fixed(fixed));
        }
        let place = self.onsets.partition_point(|onset| onset.at_s <= at_s);
        self.onsets.insert(place, Onset { at_s, effects });
        Ok(())
    }
}

/// An argument and its time; `None` of one that acts from the start, of a file, and of a law, whose
/// formula may hold any sign.
fn split(argument: &str) -> Option<(&str, &str)> {
    if argument.starts_with('@') || Law::is_line(argument) {
        return None;
    }
    argument.rsplit_once('@')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requested(arguments: &[&str]) -> Result<Schedule, EffectsRefused> {
        let arguments: Vec<String> = arguments.iter().map(|text| (*text).to_owned()).collect();
        Schedule::requested(None, &arguments)
    }

    #[test]
    fn an_argument_with_a_time_sets_in_then() {
        let schedule = requested(&[
            "rotor_loss:rotor=1,scale=0.92@41.2",
            "motor_lag:tau_s=0.03",
            "thrust_scale:scale=0.9@7",
        ])
        .unwrap();
        assert!(schedule.effects.contains(EffectId::MotorLag));
        assert!(!schedule.effects.contains(EffectId::RotorLoss));
        let times: Vec<_> = schedule.onsets.iter().map(|onset| onset.at_s).collect();
        assert_eq!(times, [7.0, 41.2]);
        assert_eq!(schedule.onsets[1].effects.value(EffectId::RotorLoss, "scale", 0), Some(0.92));
    }

    #[test]
    fn what_cannot_set_in_is_refused_by_name() {
        let message = |text: &str| requested(&[text]).unwrap_err().to_string();
        assert!(message("command_delay:delay_s=0.02@3").contains("command_delay cannot set in"));
        assert!(message("thrust_scale:scale=0.9@soon").contains("time of an onset"));
        assert!(message("thrust_scale:scale=0.9@-1").contains("time of an onset"));
    }
}
