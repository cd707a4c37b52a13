//! The rotors' mean vertical thrust compared with the weight.

use std::ops::Range;

use vehicle::VehicleParams;
use vehicle::effects::ThrustCurve;
use vehicle::frame::Frd;

use super::{Held, Verdict, blocks, brief};
use crate::log::import::Flight;

/// Share by which the mean may differ, for the pack's sag and an unmodelled thrust curve.
const TOLERANCE: f64 = 0.08;
/// Fewest samples of a block.
const SAMPLES_MIN: usize = 20;

/// Compares over blocks, where the mean vertical thrust is `m (g - dv/dt)`, with v the velocity
/// down.
pub(super) fn held(flight: &Flight, spans: &[Range<f64>], vehicle: &VehicleParams) -> Held {
    let weight = vehicle.mass * vehicle.gravity;
    let full = vehicle.thrust_full_n();
    let ratios: Vec<f64> =
        blocks(spans).iter().filter_map(|block| ratio(flight, block, vehicle)).collect();
    let held = Held {
        check: "hover",
        field: "mass",
        verdict: Verdict::NotShown,
        expected: weight / full,
        found: None,
        half_width: None,
        unit: "",
        what: String::new(),
    };
    let count = ratios.len() as f64;
    if ratios.len() < 2 {
        let what = "hover: not shown: the log lacks motor outputs, attitude or velocity in the air";
        return Held { what: what.to_owned(), ..held };
    }
    let mean = ratios.iter().sum::<f64>() / count;
    let spread = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let half = 2.0 * (spread / count).sqrt();
    let differs = (mean - 1.0).abs() - half > TOLERANCE;
    let advice = if differs {
        ": mass, thrust_max_N or the thrust curve does not match this vehicle"
    } else {
        ""
    };
    let found = mean * weight / full;
    Held {
        verdict: if differs { Verdict::Differs } else { Verdict::Fits },
        found: Some(found),
        half_width: Some(half * weight / full),
        what: format!(
            "hover: by the outputs the rotors' vertical thrust is {} N ({} to {}), expected {} N \
             for {} kg: {} of full thrust, expected {}{advice}",
            brief(mean * weight),
            brief((mean - half) * weight),
            brief((mean + half) * weight),
            brief(weight),
            brief(vehicle.mass),
            brief(found),
            brief(weight / full)
        ),
        ..held
    }
}

/// Mean vertical thrust according to the outputs, over the thrust that the motion required.
fn ratio(flight: &Flight, block: &Range<f64>, vehicle: &VehicleParams) -> Option<f64> {
    let curve = vehicle.modelled_effects.get::<ThrustCurve>();
    let (mut sum, mut count) = (0.0, 0);
    for (time, outputs) in flight.outputs.iter().filter(|(time, _)| block.contains(time)) {
        let attitude = flight.attitude.held_at(time)?;
        let thrust: f64 = (0..4)
            .map(|i| {
                let share = curve.map_or(outputs[i], |curve| curve.fraction(outputs[i]));
                share * vehicle.rotors[i].thrust_max_n
            })
            .sum();
        sum -= attitude.to_world(Frd::new(0.0, 0.0, -thrust)).down();
        count += 1;
    }
    let down = |time| flight.velocity.held_at(time).map(|v| v.down());
    let sinking = (down(block.end)? - down(block.start)?) / (block.end - block.start);
    let needed = vehicle.mass * (vehicle.gravity - sinking);
    (count >= SAMPLES_MIN).then(|| sum / count as f64 / needed)
}
