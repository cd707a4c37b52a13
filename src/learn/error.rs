//! Why there is no model.

use vehicle::VehicleError;

/// Why there is no model.
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
    /// Nothing to choose or to judge by.
    #[error(
        "the {part} part has no rows: each part of a flight must be longer than {border_s} s, which \
         are left out at its borders; give more or longer flights"
    )]
    EmptyPart {
        /// `validation` or `test`.
        part: &'static str,
        /// What is left out between two parts, s.
        border_s: f64,
    },
    /// Every model's open loop leads to what is no number.
    #[error(
        "{reason}; look at the logs with `downwash log audit`, or change --regularization, --features or \
         --method"
    )]
    NotFinite {
        /// What is not finite.
        reason: &'static str,
    },
    /// The vehicle's physics does not work.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// A network could not be trained.
    #[error("network {network} of the {model} model: {reason}")]
    Network {
        /// The model that it is part of.
        model: &'static str,
        /// `nn1` or `nn2`.
        network: &'static str,
        /// Why.
        reason: String,
    },
    /// Nothing to try.
    #[error("no regularisation is given to try")]
    NoRegularization,
    /// The checkpoint is of another training.
    #[error("the checkpoint is of other data or settings; train without --resume")]
    Checkpoint,
}
