//! Effects that set in during a flight: a chipped blade, a dropped load, a rising wind.

use std::path::Path;

use serde::Serialize;

use super::{EffectError, EffectId, EffectSet, EffectsRefused, Parameter};
use crate::law::Law;

/// Effects that act from an instant on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Onset {
    /// Onset in s on the vehicle's clock, which starts at power-on.
    pub at_s: f64,
    /// The effects to add; they override those that already act.
    pub effects: EffectSet,
}

/// The effects that act from the start, and those that set in later.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schedule {
    /// Effects from the start.
    pub effects: EffectSet,
    /// Later onsets, in order of time.
    pub onsets: Vec<Onset>,
}

/// Why an onset is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OnsetError {
    /// The onset time is not a number of at least 0.
    #[error("@{0}: expected the time of an onset in s, 0 or more")]
    Time(String),
    /// The effect acts in a sensor, a link or a loop, or carries its own state.
    #[error(
        "{0} cannot start during a flight: only forces, moments and constants of the vehicle can"
    )]
    Fixed(EffectId),
    /// Two arguments let one effect set in at one time.
    #[error("{0} is given twice for {1} s; give it once, with all its numbers")]
    Twice(String, f64),
}

/// Effects outside the plant, or with a state that starts with the flight.
const FIXED: [EffectId; 5] = [
    EffectId::CommandDelay,
    EffectId::AttitudeTrim,
    EffectId::EstimatorLatency,
    EffectId::PdGain,
    EffectId::Gusts,
];

impl Schedule {
    /// The effects that a command line requests, as in [`EffectSet::requested`]. An argument that
    /// ends in `@41.2` sets in at 41.2 s.
    ///
    /// # Errors
    /// As [`EffectSet::requested`]; also an effect that cannot set in, one that sets in twice at one
    /// time, or an invalid time.
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

    /// One line for each argument that names an effect without numbers: those that it takes.
    pub fn defaults_taken(arguments: &[String]) -> Vec<String> {
        let taken = |argument: &String| {
            let effect = split(argument).map_or(argument.as_str(), |(effect, _)| effect);
            let id: EffectId = effect.trim().trim_end_matches(':').trim_end().parse().ok()?;
            let number = |parameter: &Parameter| {
                let unit = if parameter.unit == "-" { "" } else { parameter.unit };
                let text = format!("{} {} {unit}", parameter.name, parameter.default?);
                Some(text.trim_end().to_owned())
            };
            let numbers: Option<Vec<String>> = id.spec().parameters.iter().map(number).collect();
            Some(format!(
                "--effect {argument}: no numbers are given; taking {}, which mean no effect",
                numbers?.join(", ")
            ))
        };
        arguments.iter().filter_map(taken).collect()
    }

    /// Adds an onset of the effect `effect`, written as in `--effect`, at the time `at` in s.
    ///
    /// # Errors
    /// The effect or the time is invalid, or the effect cannot set in during a flight.
    pub fn insert(&mut self, effect: &str, at: &str) -> Result<(), EffectError> {
        let at_s = at.trim().parse().map_err(|_| OnsetError::Time(at.to_owned()))?;
        let mut effects = EffectSet::new();
        effects.insert_argument(effect)?;
        Ok(self.add(effects, at_s)?)
    }

    /// Adds an onset of `effects` at `at_s`.
    ///
    /// # Errors
    /// An effect cannot set in during a flight or already sets in at that time, or the time is
    /// negative or not finite.
    pub fn add(&mut self, effects: EffectSet, at_s: f64) -> Result<(), OnsetError> {
        if !(at_s.is_finite() && at_s >= 0.0) {
            return Err(OnsetError::Time(at_s.to_string()));
        }
        if let Some(fixed) = FIXED.into_iter().find(|id| effects.contains(*id)) {
            return Err(OnsetError::Fixed(fixed));
        }
        let mut at_once = self.onsets.iter().filter(|onset| onset.at_s == at_s);
        if let Some(name) = at_once.find_map(|onset| onset.effects.shared(&effects)) {
            return Err(OnsetError::Twice(name.to_owned(), at_s));
        }
        let place = self.onsets.partition_point(|onset| onset.at_s <= at_s);
        self.onsets.insert(place, Onset { at_s, effects });
        Ok(())
    }
}

/// Splits an argument into effect and onset time. Returns `None` for an effect that acts from the
/// start, for a file, and for a law, whose formula may hold any character.
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
    fn timed_argument_starts_at_its_time() {
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
    fn effects_that_cannot_start_in_flight_are_refused_by_name() {
        let message = |text: &str| requested(&[text]).unwrap_err().to_string();
        assert!(message("command_delay:delay_s=0.02@3").contains("command_delay cannot start"));
        assert!(message("thrust_scale:scale=0.9@soon").contains("time of an onset"));
        assert!(message("thrust_scale:scale=0.9@-1").contains("time of an onset"));
    }

    #[test]
    fn effect_sets_in_once_at_a_time() {
        let (first, second) = ("thrust_scale:scale=0.9@7", "thrust_scale:scale=0.8@7.0");
        let text = requested(&[first, second]).unwrap_err().to_string();
        assert!(text.contains("thrust_scale is given twice for 7 s"), "{text}");
        assert_eq!(requested(&[first, "thrust_scale:scale=0.8@8"]).unwrap().onsets.len(), 2);
    }

    #[test]
    fn effect_without_numbers_is_reported_with_those_that_it_takes() {
        let lines = |text: &str| Schedule::defaults_taken(&[text.to_owned()]);
        let all = lines("rotor_drag:");
        assert!(all[0].contains("d_xy 0 kg/s, d_z 0 kg/s"), "{all:?}");
        assert!(lines("thrust_scale@7")[0].contains("scale 1"), "{:?}", lines("thrust_scale@7"));
        for text in ["rotor_drag:d_xy=0.02", "@rotor_drag", "mass", "force_x = -1[kg/s] * air_x"] {
            assert!(lines(text).is_empty(), "{text}");
        }
    }
}
