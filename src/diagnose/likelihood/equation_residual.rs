//! What an explanation leaves of the equations of rotation and of the on-board loop, as mean
//! squares.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::diagnose::flights::spectrum::{BANDS, mean_square_share};
use crate::diagnose::likelihood::channels::{COMMAND, RATE};
use crate::diagnose::likelihood::layout::Bin;
use crate::diagnose::likelihood::noise::increments_of_white;
use crate::diagnose::likelihood::observed::Observed;

/// Highest frequency at which the equations are compared, Hz.
const MAX_HZ: f64 = 6.0;

/// Mean squares of the residuals up to 6 Hz; 0 for an equation that is not used.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct EquationResidual {
    /// Angular acceleration about front, right and down, rad^2/s^4.
    pub rotation: [f64; 3],
    /// Collective, N^2, and moments about front, right and down, N^2 m^2, of the motor outputs
    /// beyond those that the on-board loop would send, without the slowest band: trims and balances
    /// differ from flight to flight.
    pub command: [f64; 4],
}

impl EquationResidual {
    /// From sums of squares in each bin.
    pub(in crate::diagnose) fn of(observed: &Observed<'_>, power: &[f64]) -> Self {
        Self {
            rotation: std::array::from_fn(|axis| mean_square(observed, power, RATE + axis)),
            command: std::array::from_fn(|i| mean_square_from(1, observed, power, COMMAND + i)),
        }
    }
}

/// Bands of a channel with coefficients, up to [`MAX_HZ`].
fn bands<'a>(observed: &'a Observed<'_>, channel: usize) -> impl Iterator<Item = usize> + 'a {
    let is_used = move |band: &usize| observed.counts()[Bin::index_of(channel, *band)] >= 1.0;
    (0..BANDS.len()).filter(|band| BANDS[*band] <= MAX_HZ).filter(is_used)
}

/// Mean square of a channel below [`MAX_HZ`], from sums of squares in each bin.
pub(in crate::diagnose) fn mean_square(
    observed: &Observed<'_>,
    power: &[f64],
    channel: usize,
) -> f64 {
    mean_square_from(0, observed, power, channel)
}

/// The same from a band on.
fn mean_square_from(first: usize, observed: &Observed<'_>, power: &[f64], channel: usize) -> f64 {
    let of_band = |band: usize| {
        let bin = Bin::index_of(channel, band);
        power[bin] / observed.counts()[bin] * mean_square_share(band)
    };
    bands(observed, channel).filter(|band| *band >= first).map(of_band).sum()
}

/// Mean square of the angular acceleration about `axis` that gyro noise of `deviation` rad/s causes
/// below [`MAX_HZ`], rad^2/s^4.
pub(in crate::diagnose) fn gyro_noise(observed: &Observed<'_>, deviation: f64, axis: usize) -> f64 {
    let flights = observed.flights;
    let rate = flights.iter().map(|flight| flight.body_rate.rate()).sum::<f64>()
        / flights.len().max(1) as f64;
    bands(observed, RATE + axis)
        .map(|band| increments_of_white(deviation, rate, band) * mean_square_share(band))
        .sum()
}

/// Mean square of the measured angular acceleration about each axis below [`MAX_HZ`], rad^2/s^4.
pub(in crate::diagnose) fn measured_rotation(observed: &Observed<'_>) -> [f64; 3] {
    let layouts = observed.flights.iter().zip(&observed.layouts);
    let measured = layouts
        .map(|(flight, layout)| observed.evaluator.angular_acceleration(flight, layout))
        .collect();
    let power = observed.power_of(&measured);
    std::array::from_fn(|axis| mean_square(observed, &power, RATE + axis))
}
