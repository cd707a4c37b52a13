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
            rotation: rotation(observed, power),
            command: std::array::from_fn(|i| mean_square(observed, power, COMMAND + i, 1)),
        }
    }
}

/// Bands of a channel with coefficients, from the band `first` up to [`MAX_HZ`].
fn bands<'a>(
    observed: &'a Observed<'_>,
    channel: usize,
    first: usize,
) -> impl Iterator<Item = usize> + 'a {
    let is_used = move |band: &usize| observed.counts()[Bin::index_of(channel, *band)] >= 1.0;
    (first..BANDS.len()).filter(|band| BANDS[*band] <= MAX_HZ).filter(is_used)
}

/// Mean square of a channel in these bands, from sums of squares in each bin.
fn mean_square(observed: &Observed<'_>, power: &[f64], channel: usize, first: usize) -> f64 {
    let of_band = |band: usize| {
        let bin = Bin::index_of(channel, band);
        power[bin] / observed.counts()[bin] * mean_square_share(band)
    };
    bands(observed, channel, first).map(of_band).sum()
}

/// Mean squares of the rotation's channels below [`MAX_HZ`], about front, right and down,
/// rad^2/s^4, from sums of squares in each bin.
pub(in crate::diagnose) fn rotation(observed: &Observed<'_>, power: &[f64]) -> [f64; 3] {
    std::array::from_fn(|axis| mean_square(observed, power, RATE + axis, 0))
}

/// Mean square of the angular acceleration about `axis` that gyro noise of `deviation` rad/s causes
/// below [`MAX_HZ`], rad^2/s^4.
pub(in crate::diagnose) fn gyro_noise(observed: &Observed<'_>, deviation: f64, axis: usize) -> f64 {
    let flights = observed.flights;
    let rate = flights.iter().map(|flight| flight.body_rate.rate()).sum::<f64>()
        / flights.len().max(1) as f64;
    bands(observed, RATE + axis, 0)
        .map(|band| increments_of_white(deviation, rate, band) * mean_square_share(band))
        .sum()
}

/// Mean squares of the measured angular acceleration below [`MAX_HZ`], about front, right and down,
/// rad^2/s^4.
pub(in crate::diagnose) fn measured_rotation(observed: &Observed<'_>) -> [f64; 3] {
    let layouts = observed.flights.iter().zip(&observed.layouts);
    let measured = layouts
        .map(|(flight, layout)| observed.evaluator.angular_acceleration(flight, layout))
        .collect();
    rotation(observed, &observed.power_of(&measured))
}
