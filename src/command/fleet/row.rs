//! The result of a stage for a vehicle, as a row from which a later run continues.

use serde::{Deserialize, Serialize};

use crate::command::rows::Numbered;
use crate::diagnose::fleet::answer::VehicleAnswer;
use crate::diagnose::fleet::survey::Survey;

/// The result of one stage for one vehicle.
#[derive(Serialize, Deserialize)]
pub(super) struct Row {
    /// Number of the stage times that of the vehicles, plus the vehicle's.
    pub number: usize,
    /// The vehicle's name.
    pub vehicle: String,
    #[serde(flatten)]
    pub done: Done,
}

/// Its result.
#[derive(Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Done {
    /// The log evidence of each scale of the file's tolerances.
    Scales(Vec<[f64; 2]>),
    /// The likelihoods of its flights, besides the effects of the type.
    Survey(Box<Survey>),
    /// Its effects beyond those of its type.
    Own(Box<VehicleAnswer>),
    /// Why there is no result.
    Failed(String),
}

impl Numbered for Row {
    fn number(&self) -> usize {
        self.number
    }
}
