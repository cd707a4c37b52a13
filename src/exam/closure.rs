//! The true closure of an answer's effects, whatever the answer claims.

use vehicle::effects::EffectSet;
use vehicle::{VehicleError, VehicleParams};

use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::diagnose::simulate::open_loop::Simulator;

/// Least closable gap, in units of the noise.
const GAP_MIN: f64 = 0.05;

/// (before - after) / (before - least): prediction errors of the vehicle file as shipped, with the
/// answer's effects, and with the true ones, by the metric `mean`. `None` where there is no gap.
///
/// # Errors
/// A vehicle that the physics rejects.
pub fn closure(
    nominal: &VehicleParams,
    truth: &EffectSet,
    answer: &EffectSet,
    held_out: &[PreparedFlight],
    noise: &ReportNoise,
) -> Result<Option<f64>, VehicleError> {
    let leg = held_out.iter().all(|flight| flight.channels.setpoint);
    let simulator = |effects: &EffectSet| Simulator::new(nominal, effects, leg);
    let best = simulator(truth)?;
    let Some(floor) = best.floor(held_out, noise, 1) else { return Ok(None) };
    let mean = |simulator: &Simulator| Some(simulator.errors(held_out)?.mean_over(&floor.errors));
    let (Some(least), Some(before), Some(after)) =
        (mean(&best), mean(&simulator(&EffectSet::new())?), mean(&simulator(answer)?))
    else {
        return Ok(None);
    };
    let gap = before - least;
    Ok((gap > GAP_MIN).then(|| (before - after) / gap))
}
