//! Effects with a direction and a size: a single number scales an effect from zero to the largest
//! sensible one, to search for a wanted strength.

use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet, Growth};

use super::draw::{Draw, rounded};
use crate::diagnose::catalogue::reference::reference_slots;

/// An effect with a drawn direction.
#[derive(Clone, Debug)]
pub struct Direction {
    /// The effect's id.
    pub effect: EffectId,
    growth: Growth,
    /// Whether the effect grows with the square of its size.
    pub quadratic: bool,
}

impl Direction {
    /// Draws a direction. An effect that the vehicle file models starts at the file's values.
    pub fn draw(draw: &mut Draw, vehicle: &VehicleParams, effect: EffectId) -> Self {
        let spec = effect.spec();
        let from = reference_slots(vehicle, effect);
        let mut growth = Growth { from, ..Growth::default() };
        (spec.strong)(vehicle, draw, &mut growth);
        let modelled = vehicle.modelled_effects.contains(effect);
        // A modelled value may grow or shrink, but does not change sign.
        if modelled && draw.chance(0.5) {
            for (by, from) in growth.by.iter_mut().zip(growth.from) {
                *by = if from > 0.0 { -by.abs().min(from) } else { -*by };
            }
        }
        Self { effect, growth, quadratic: spec.is_quadratic && !modelled }
    }

    /// The effect at `size`, where 1 is the largest sensible one.
    pub fn at(&self, size: f64) -> EffectSet {
        let mut slots = self.growth.from;
        for slot in self.effect.spec().slots() {
            let value = self.growth.from[slot.index] + size * self.growth.by[slot.index];
            slots[slot.index] = rounded(value.clamp(slot.parameter.min, slot.parameter.max));
        }
        let mut set = EffectSet::new();
        // The values are clamped, so the catalogue accepts them.
        let _ = set.insert(self.effect, slots);
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::catalogue::hypothesis::Catalogue;
    use crate::diagnose::catalogue::reference::reference;

    #[test]
    fn drawn_effects_lie_within_the_diagnosis_bounds() {
        let mut draw = Draw::new(5, 0);
        for kind in ["nano", "quad"] {
            let vehicle = super::super::airframe::vehicle(&mut draw, kind);
            let catalogue = Catalogue::new(&vehicle, true);
            for effect in EffectId::ALL.into_iter().cycle().take(20 * EffectId::ALL.len()) {
                let set = Direction::draw(&mut draw, &vehicle, effect).at(1.0);
                let Some(slots) = set.slots(effect) else { continue };
                let drawn = effect.spec().slots().filter_map(|slot| {
                    let number = &catalogue.numbers[catalogue.number_of(effect, slot.index)?];
                    Some((slots[slot.index], number.bounds))
                });
                for (value, [low, high]) in drawn {
                    let near = 1e-3 * (high - low);
                    let is_inside = (low..=high - near).contains(&value);
                    assert!(is_inside, "{effect} {value} of {low} .. {high}");
                }
            }
        }
    }

    #[test]
    fn every_effect_grows_from_zero() {
        let mut draw = Draw::new(3, 0);
        let vehicle = super::super::airframe::vehicle(&mut draw, "quad");
        for effect in EffectId::ALL {
            let direction = Direction::draw(&mut draw, &vehicle, effect);
            let slots = *direction.at(0.5).slots(effect).expect("it is on");
            let moved = effect
                .spec()
                .slots()
                .any(|slot| slots[slot.index] != reference(&vehicle, effect, slot.index));
            assert!(moved, "{effect}");
            let at_0 = direction.at(0.0);
            let slots = at_0.slots(effect).expect("it is on");
            assert!((slots[1] - rounded(direction.growth.from[1])).abs() < 1e-12, "{effect}");
        }
    }
}
