//! Errors of a training.

use vehicle::VehicleError;

/// Why a training gives no model.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Too little data.
    #[error("only {found} rows to train on; at least {least} are needed (5 s of flight)")]
    TooFewRows {
        /// Rows in the training part.
        found: usize,
        /// Rows that a training needs.
        least: usize,
    },
    /// No rows to select or evaluate on.
    #[error(
        "the {part} part has no rows: each part of a flight must be longer than the {border_s} s \
         excluded at its borders; give more or longer flights"
    )]
    EmptyPart {
        /// `validation` or `test`.
        part: &'static str,
        /// Time left out between two parts, s.
        border_s: f64,
    },
    /// Every model's open loop leads to values that are not finite.
    #[error(
        "{reason}; look at the logs with `downwash log audit`, or change --regularization, --features or \
         --method"
    )]
    NotFinite {
        /// The values that are not finite.
        reason: &'static str,
    },
    /// The vehicle's physics is invalid.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// A network could not be trained.
    #[error("network {network} of the {model} model: {reason}")]
    Network {
        /// The model that it is part of.
        model: &'static str,
        /// `nn1` or `nn2`.
        network: &'static str,
        /// The cause.
        reason: String,
    },
    /// No regularisation to try.
    #[error("no regularisation value is given")]
    NoRegularization,
    /// The checkpoint belongs to another training.
    #[error("the checkpoint belongs to other data or settings; train without --resume")]
    Checkpoint,
}
