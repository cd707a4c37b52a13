//! The vehicle file's values of effects' slots.

use vehicle::VehicleParams;
use vehicle::effects::{Effect, EffectId, Neutral, RotorDrag, RotorLoss, Slots};

/// The vehicle file's value of a slot, else the neutral one.
pub fn reference(vehicle: &VehicleParams, effect: EffectId, slot: usize) -> f64 {
    if effect == RotorDrag::ID
        && let Some(drag) = vehicle.linear_drag_n_per_m_s
    {
        return drag;
    }
    if let Some(slots) = vehicle.modelled_effects.slots(effect) {
        return slots[slot];
    }
    let found = effect.spec().slots().find(|s| s.index == slot);
    found.map_or(0.0, |s| match s.parameter.neutral {
        Neutral::Value(value) => value,
        Neutral::Vehicle(value) => value(vehicle),
        Neutral::None => s.parameter.default.unwrap_or(0.0),
    })
}

/// The slots of an effect with the vehicle file's values, else the neutral ones.
pub fn reference_slots(vehicle: &VehicleParams, effect: EffectId) -> Slots {
    let mut slots = Slots::default();
    for slot in effect.spec().slots() {
        slots[slot.index] = reference(vehicle, effect, slot.index);
    }
    slots
}

/// The thrust scale of a rotor in the vehicle file.
pub(super) fn modelled_scale(vehicle: &VehicleParams, rotor: usize) -> f64 {
    let loss = vehicle.modelled_effects.get::<RotorLoss>();
    loss.filter(|loss| loss.rotor == rotor).map_or(1.0, |loss| loss.scale)
}
