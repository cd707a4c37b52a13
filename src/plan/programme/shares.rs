//! Allocation of a programme's length to its kinds of flight.

use super::{FlightKind, ProgrammeError};

/// Shares of the training flights: 90,000, 50,000 and 100,000 of 240,000 samples, the sinusoids in
/// equal parts over the planes.
pub(super) const SHARES: [(FlightKind, f64); 5] = [
    (FlightKind::SinusoidXy, 30.0 / 240.0),
    (FlightKind::SinusoidXz, 30.0 / 240.0),
    (FlightKind::SinusoidYz, 30.0 / 240.0),
    (FlightKind::YawRotation, 50.0 / 240.0),
    (FlightKind::Unstructured, 100.0 / 240.0),
];

/// Shares of the test flights.
pub(super) const COMBINED_SHARES: [(FlightKind, f64); 3] = [
    (FlightKind::CombinedSinusoidYaw, 1.0 / 3.0),
    (FlightKind::CombinedFigureEight, 1.0 / 3.0),
    (FlightKind::CombinedUnstructured, 1.0 / 3.0),
];

/// Least length of a flight's trajectory: shorter ones consist of ramps only.
const FLIGHT_MIN_S: f64 = 4.0;
/// Longest programme, s: more than eleven days are a typing error.
const SECONDS_MAX: f64 = 1e6;

/// The place of one flight in the programme.
pub(super) struct Slot {
    pub kind: FlightKind,
    /// Index among the flights of its kind, from 0.
    pub number: usize,
    /// Number of flights of its kind.
    pub of: usize,
    pub length_s: f64,
}

/// Divides a programme of `seconds` into flights of about `flight_s`.
pub(super) fn slots(
    shares: &[(FlightKind, f64)],
    seconds: f64,
    flight_s: f64,
) -> Result<Vec<Slot>, ProgrammeError> {
    let smallest = shares.iter().map(|(_, share)| *share).fold(1.0, f64::min);
    let least = FLIGHT_MIN_S / smallest;
    if !(least..=SECONDS_MAX).contains(&seconds) {
        return Err(ProgrammeError::Length { seconds, least, most: SECONDS_MAX });
    }
    if flight_s.is_nan() || flight_s < FLIGHT_MIN_S {
        return Err(ProgrammeError::NoRoom {
            quantity: "a flight_s",
            found: flight_s,
            expected: "expected at least 4 s",
        });
    }
    let of_kind = |&(kind, share): &(FlightKind, f64)| {
        let of = ((share * seconds / flight_s).round() as usize).max(1);
        let length_s = share * seconds / of as f64;
        (0..of).map(move |number| Slot { kind, number, of, length_s })
    };
    Ok(shares.iter().flat_map(of_kind).collect())
}
