//! What is done of a vehicle, as a row that a later run goes on with.

use serde::{Deserialize, Serialize};

use crate::command::rows::Numbered;
use crate::diagnose::fleet::answer::VehicleAnswer;
use crate::diagnose::fleet::survey::Survey;

/// What is done of a vehicle in a stage.
#[derive(Serialize, Deserialize)]
pub(super) struct Row {
    /// Number of the stage times that of the vehicles, plus the vehicle's.
    pub number: usize,
    /// The vehicle's name.
    pub vehicle: String,
    #[serde(flatten)]
    pub done: Done,
}

/// What came of it.
#[derive(Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Done {
    /// Log evidence of each scale of the file's tolerances.
    Scales(Vec<[f64; 2]>),
    /// What its flights say beside the effects of the type.
    Survey(Box<Survey>),
    /// What it has beyond its type.
    Own(Box<VehicleAnswer>),
    /// Why there is nothing.
    Failed(String),
}

impl Numbered for Row {
    fn number(&self) -> usize {
        self.number
    }
}
