//! What an autopilot's own log says about its vehicle.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::kind::{StatedKind, VehicleKind};
use super::ranges::OutputRange;
pub use message::parameters::RotorFact;

/// Facts that a log states, or that its reader found in it.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default)]
pub struct VehicleFacts {
    /// Autopilot and its version.
    pub autopilot: Option<String>,
    /// Frame, as the autopilot names it.
    pub frame: Option<String>,
    /// What the log states that the vehicle is, each with what states it.
    pub kinds: Vec<StatedKind>,
    /// Motors that the autopilot drives.
    pub motors: Option<u32>,
    /// Where the autopilot believes its rotors to be, in the order of the outputs.
    pub rotors: Vec<RotorFact>,
    /// Parameters that say what outputs, thrust and estimates mean.
    pub parameters: BTreeMap<String, f64>,
    /// What the motors' outputs span, where parameters say so and the stream is as it was logged.
    pub output_ranges: Option<[OutputRange; 4]>,
    /// Which topic each stream is from, and what it means where that is not plain.
    pub notes: Vec<String>,
    /// Texts of the log for a person, each with its time.
    pub texts: Vec<String>,
}

impl VehicleFacts {
    /// What states that the vehicle is no multirotor, if anything does.
    pub fn stated_otherwise(&self) -> Option<&StatedKind> {
        self.kinds.iter().find(|stated| stated.kind != VehicleKind::Multirotor)
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}
