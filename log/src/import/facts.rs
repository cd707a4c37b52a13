//! Facts about a vehicle from an autopilot's log.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::kind::{StatedKind, VehicleKind};
use super::ranges::OutputRange;
pub use message::parameters::RotorFact;

/// Largest number of texts kept; half of it is reserved for warnings.
const TEXTS_MAX: usize = 40;
/// Texts at this level of syslog and worse are warnings.
const WARNING: u8 = 4;

/// The first texts of a log.
#[derive(Clone, Debug, Default)]
pub(super) struct Texts {
    kept: Vec<String>,
    /// Number of texts that were not kept.
    more: usize,
}

impl Texts {
    /// Adds a text with its level of syslog, 0 being the worst. In a log without levels, any may be
    /// a warning.
    pub fn add(&mut self, level: Option<u8>, text: String) {
        let is_warning = level.is_none_or(|level| level <= WARNING);
        if self.kept.len() < if is_warning { TEXTS_MAX } else { TEXTS_MAX / 2 } {
            self.kept.push(text);
        } else {
            self.more += 1;
        }
    }

    pub fn iter(&self) -> impl Iterator<Item = &String> {
        self.kept.iter()
    }

    /// Moves the texts to `facts`, and notes how many more there were.
    pub fn give(self, facts: &mut VehicleFacts) {
        if self.more > 0 {
            let (kept, more) = (self.kept.len(), self.more);
            facts.notes.push(format!("{kept} texts are kept, {more} more are not"));
        }
        facts.texts = self.kept;
    }
}

/// Facts that a log states or that the importer derives from it.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default)]
pub struct VehicleFacts {
    /// Name and version of the autopilot.
    pub autopilot: Option<String>,
    /// Airframe, as the autopilot names it.
    pub frame: Option<String>,
    /// Kinds of vehicle that the log states, each with its source.
    pub kinds: Vec<StatedKind>,
    /// Number of motors that the autopilot drives.
    pub motors: Option<u32>,
    /// Rotors as configured in the autopilot, in the order of the outputs.
    pub rotors: Vec<RotorFact>,
    /// Parameters that define outputs, thrust and estimates.
    pub parameters: BTreeMap<String, f64>,
    /// Ranges of the motor outputs, if parameters state them and the stream is as logged.
    pub output_ranges: Option<[OutputRange; 4]>,
    /// Source topic of each stream, and its meaning if not obvious.
    pub notes: Vec<String>,
    /// Text messages in the log, for people.
    pub texts: Vec<String>,
}

impl VehicleFacts {
    /// The first statement that the vehicle is not a multirotor, if any.
    pub fn stated_otherwise(&self) -> Option<&StatedKind> {
        self.kinds.iter().find(|stated| stated.kind != VehicleKind::Multirotor)
    }

    /// Whether there are no facts.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_warnings_are_kept_and_the_other_late_texts_counted() {
        let kept = |levels: [Option<u8>; 2]| {
            let mut texts = Texts::default();
            (0..30).for_each(|n| texts.add(levels[0], format!("text {n}")));
            texts.add(levels[1], "the last".to_owned());
            let mut facts = VehicleFacts::default();
            texts.give(&mut facts);
            (facts.texts.len(), facts.texts.contains(&"the last".to_owned()), facts.notes.join(" "))
        };
        let note = "21 texts are kept, 10 more are not".to_owned();
        assert_eq!(kept([Some(6), Some(4)]), (21, true, note));
        let note = "20 texts are kept, 11 more are not".to_owned();
        assert_eq!(kept([Some(6), Some(6)]), (20, false, note));
        assert_eq!(kept([None, None]), (31, true, String::new()));
    }
}
