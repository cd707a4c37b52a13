//! What makes an effect the one that it is, whatever it explains.

use sitl::effects::EffectId;

use super::fit::{Fit, Z90};
use super::hypothesis::Catalogue;
use super::selection::TESTABLE;

/// Effects of the body that are a number, the same however the vehicle flies. The others are laws,
/// which hold more or less: a pack of another make sags by another one and is still the cause.
const CONSTANT: [EffectId; 7] = [
    EffectId::Mass,
    EffectId::ThrustScale,
    EffectId::Inertia,
    EffectId::ComOffset,
    EffectId::RotorLoss,
    EffectId::YawTorque,
    EffectId::AttitudeTrim,
];
/// Effects of the link and the loop that are.
const OF_LOOP: [EffectId; 3] =
    [EffectId::CommandDelay, EffectId::EstimatorLatency, EffectId::PdGain];

/// Whether an effect of the body is a number, the same however the vehicle flies.
pub(super) fn is_constant(effect: EffectId) -> bool {
    CONSTANT.contains(&effect)
}

/// Whether an effect may follow another law than the catalogue's and still be itself.
pub(super) fn has_law(effect: EffectId) -> bool {
    !is_constant(effect) && !OF_LOOP.contains(&effect)
}

/// Whether what is fitted acts as its effects do, rather than stand for something else.
pub(super) fn acts_by_its_law(catalogue: &Catalogue, fit: &Fit) -> bool {
    let effects = || fit.hypotheses.iter().map(|h| catalogue.hypotheses[*h].effect);
    let blows = effects().any(|effect| effect == EffectId::Wind);
    (!blows || is_along_the_floor(catalogue, fit))
        && effects().all(|effect| may_have_its_parts(catalogue, fit, effect))
}

/// A steady wind blows along the floor: one that clearly blows more downwards or upwards is none.
fn is_along_the_floor(catalogue: &Catalogue, fit: &Fit) -> bool {
    let component = |slot: usize| {
        let number = catalogue.number_of(EffectId::Wind, slot);
        number.map_or([0.0, 0.0], |number| [fit.values[number], fit.deviation[number]])
    };
    let [[north, _], [east, _], [down, error]] = [0, 1, 2].map(component);
    down.abs() - 2.0 * error <= north.hypot(east)
}

/// Parts, by their slots, without which an effect is another: blades that flap turn the body as well
/// as drag it, and rotors drag in their plane first.
const PARTS: [(EffectId, usize); 3] =
    [(EffectId::BladeFlapping, 0), (EffectId::BladeFlapping, 1), (EffectId::RotorDrag, 0)];

/// What roll and pitch change of their moments of inertia, of what yaw changes of its, at least: mass
/// at (x, y, z) adds x^2 + y^2 to yaw's, and that and 2 z^2 to the sum of the other two. Yaw's alone
/// is off where it is the yaw torque that is.
const BESIDE_YAW_MIN: f64 = 0.2;

/// Whether a fit that is freed of what it is off by itself has what makes an effect the one that it
/// is.
pub(super) fn is_itself(catalogue: &Catalogue, fit: &Fit, effect: EffectId) -> bool {
    let is_about_yaw = effect == EffectId::Inertia && is_about_yaw_alone(catalogue, fit);
    may_have_its_parts(catalogue, fit, effect) && !is_about_yaw
}

/// Whether the inertia is off about the yaw axis alone, which no mass brings about.
fn is_about_yaw_alone(catalogue: &Catalogue, fit: &Fit) -> bool {
    let change = |axis: usize| {
        catalogue.number_of(EffectId::Inertia, axis).map_or(0.0, |number| {
            let off = fit.values[number] - catalogue.numbers[number].reference;
            (off * catalogue.vehicle.inertia[axis]).abs()
        })
    };
    change(0) + change(1) < BESIDE_YAW_MIN * change(2)
}

/// Whether each part of an effect is off the vehicle file, as far as the flights would show it.
fn may_have_its_parts(catalogue: &Catalogue, fit: &Fit, effect: EffectId) -> bool {
    let parts = PARTS.iter().filter(|(of, _)| *of == effect);
    parts.filter_map(|(of, slot)| catalogue.number_of(*of, *slot)).all(|number| {
        let deviation = fit.deviation[number];
        let is_seen = deviation < TESTABLE * catalogue.numbers[number].magnitude;
        let off = fit.values[number] - catalogue.numbers[number].reference;
        !is_seen || off.abs() > Z90 * deviation
    })
}

#[cfg(test)]
mod tests {
    use sitl::vehicle::VehicleParams;

    use super::*;

    #[test]
    fn an_inertia_is_not_off_about_the_yaw_axis_alone() {
        let text = include_str!("../../config/vehicles/quad1200.toml");
        let catalogue = Catalogue::new(&VehicleParams::from_toml_str(text).unwrap(), true);
        let inertia = catalogue.hypotheses.iter().position(|h| h.effect == EffectId::Inertia);
        let is_it = |scales: [f64; 3]| {
            let mut values = catalogue.references();
            for (axis, scale) in scales.into_iter().enumerate() {
                values[catalogue.number_of(EffectId::Inertia, axis).unwrap()] = scale;
            }
            let fit = Fit {
                hypotheses: inertia.into_iter().collect(),
                deviation: vec![0.001; values.len()],
                values,
                evidence: 0.0,
                cost: 0.0,
                power: Vec::new(),
            };
            assert!(acts_by_its_law(&catalogue, &fit));
            is_itself(&catalogue, &fit, EffectId::Inertia)
        };
        assert!(is_it([1.2, 1.15, 1.3]));
        // Mass along the yaw axis, or nearer to it.
        assert!(is_it([1.2, 1.2, 1.0]));
        assert!(is_it([1.0, 1.1, 0.9]));
        assert!(!is_it([1.004, 0.998, 0.87]));
    }
}
