//! Facts about a vehicle from an autopilot's log.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::kind::{StatedKind, VehicleKind};
use super::ranges::OutputRange;
pub use message::parameters::RotorFact;

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
