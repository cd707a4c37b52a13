//! A case is drawn until one flies.

use vehicle::VehicleError;

use super::bench::Bench;
use super::case::Case;
use super::draw::Draw;
use super::flight::FlightError;
use super::order::{Order, Settings};

/// Draws until one flies.
const ATTEMPTS: u64 = 8;

/// Why there is no case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The vehicle is refused.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// Every attempt at flying it was lost.
    #[error("no flyable case after {ATTEMPTS} draws; the last: {0}")]
    Unflyable(FlightError),
}

impl Case {
    /// Case `number` of the exam with this seed.
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
