//! The file's on-board loop compared with the one that the log's parameters state.

use vehicle::{AttitudeCascade, VehicleParams};

use super::{Held, Verdict, brief};
use crate::log::import::Flight;
use crate::parameters::Parameters;
use crate::vehicle_init::{Draft, Measured};

/// Share by which a gain may differ, because the file's gains are rounded.
const TOLERANCE: f64 = 0.02;

/// Compares the file's loop with the loop that the log's parameters give for the file's rotors.
/// `None` where either is missing.
pub(super) fn held(flight: &Flight, vehicle: &VehicleParams) -> Option<Held> {
    let own = vehicle.attitude_cascade.as_ref()?;
    let parameters = Parameters::from(flight.facts.parameters.clone());
    let rotors = &vehicle.rotors;
    let measured = Measured {
        mass_kg: Some(vehicle.mass),
        inertia: Some(vehicle.inertia),
        arm_m: Some(vehicle.arm_m()),
        thrust_max_n: Some(rotors.iter().map(|r| r.thrust_max_n).sum::<f64>() / 4.0),
        torque_ratio_m: Some(rotors.iter().map(|r| r.drag_torque_per_thrust_m).sum::<f64>() / 4.0),
        ..Measured::default()
    };
    let draft = Draft::new("the log", &parameters, &measured).ok()?;
    let stated = draft.cascade?.value;
    let worst = triples(own)
        .into_iter()
        .zip(triples(&stated))
        .flat_map(|((name, own), (_, stated))| (0..3).map(move |i| (name, own[i], stated[i])))
        .map(|(name, own, stated)| {
            let size = own.abs().max(stated.abs()).max(f64::MIN_POSITIVE);
            ((own - stated).abs() / size, name, own, stated)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let (share, name, own, stated) = worst;
    let differs = share > TOLERANCE;
    let what = if differs {
        format!(
            "gains: attitude_cascade.{name} is {}, the log's parameters give {}: run `vehicle \
             init` on this log to write the loop again",
            brief(own),
            brief(stated)
        )
    } else {
        format!(
            "gains: attitude_cascade matches the log's parameters to within {} %",
            100.0 * TOLERANCE
        )
    };
    Some(Held {
        check: "gains",
        field: "attitude_cascade",
        verdict: if differs { Verdict::Differs } else { Verdict::Fits },
        expected: own,
        found: Some(stated),
        half_width: None,
        unit: "",
        what,
    })
}

/// The gains that decide the loop's response, with their names.
fn triples(cascade: &AttitudeCascade) -> [(&'static str, [f64; 3]); 5] {
    [
        ("angle_p_per_s", cascade.angle_p_per_s),
        ("rate_p_Nms", cascade.rate_p_nms),
        ("rate_i_Nm", cascade.rate_i_nm),
        ("rate_d_Nms2", cascade.rate_d_nms2),
        ("rate_ff_Nms", cascade.rate_ff_nms),
    ]
}
