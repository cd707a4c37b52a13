//! Why there is no answer.

use vehicle::VehicleError;
use vehicle::law::LawError;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The vehicle is refused.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The law that was found is refused.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The answer is no longer wanted.
    #[error("interrupted")]
    Stopped,
    /// Nothing can be fitted.
    #[error("the flights hold nothing that a model could be compared with")]
    Nothing,
}
