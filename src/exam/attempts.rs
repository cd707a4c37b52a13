//! Draws a case repeatedly until its flights succeed.

use vehicle::VehicleError;

use super::bench::Bench;
use super::case::Case;
use super::draw::Draw;
use super::flight::FlightError;
use super::order::{Order, Settings};

/// Most draws for a case.
const ATTEMPTS: u64 = 8;

/// Reasons that a case cannot be flown.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The physics rejects the vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle was lost in every attempt.
    #[error("no flyable case after {ATTEMPTS} draws; the last failed with: {0}")]
    Unflyable(FlightError),
}

impl Case {
    /// Draws and flies case `number` of the exam with this seed.
    ///
    /// # Errors
    /// [`CaseError`].
    pub fn fly(
        settings: &Settings,
        seed: u64,
        number: u64,
        name: &str,
        order: &Order,
    ) -> Result<Self, CaseError> {
        let mut last = FlightError::Lost(0.0);
        for attempt in 0..ATTEMPTS {
            let mut draw = Draw::new(seed, number * ATTEMPTS + attempt + 1);
            match Bench::draw(&mut draw, settings, name, order)?.case(&mut draw, order) {
                Ok(case) => return Ok(case),
                Err(error) => last = error,
            }
        }
        Err(CaseError::Unflyable(last))
    }
}
