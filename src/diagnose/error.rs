//! Reasons for a diagnosis without an answer.

use vehicle::VehicleError;
use vehicle::law::LawError;

/// A reason for a diagnosis without an answer.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The physics rejects the vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The law that was found is not valid.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The caller stopped the diagnosis.
    #[error("interrupted")]
    Stopped,
    /// No flight has data to fit.
    #[error("the flights contain no data to compare a model with")]
    Nothing,
}
