//! Turns values of a catalogue's numbers into a vehicle: its physics, its inputs and its reports.

use vehicle::effects::{AttitudeTrim, CommandDelay, EffectId, EffectSet, EstimatorLatency, PdGain};
use vehicle::law::{Law, LawText};
use vehicle::physics::Physics;
use vehicle::{VehicleError, VehicleParams};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::number::{CONTRASTS, Target};
use crate::diagnose::catalogue::reference::reference_slots;
use crate::diagnose::catalogue::term::{law_of, name_of};

/// A vehicle to explain flights with.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Forces and moments on the body.
    pub physics: Physics,
    /// Delay from a logged output to its action, s.
    pub output_delay: f64,
    /// Time constant of the first-order lag after that delay, s.
    pub lag: f64,
    /// Latency of the reported pose, s.
    pub latency: f64,
    /// Trim of the reported attitude.
    pub trim: Option<AttitudeTrim>,
    /// Variance of the times over which the reported velocity is smoothed, s^2.
    pub velocity_smoothing: f64,
    /// Delay from sending a setpoint to its use, s.
    pub command_delay: f64,
    /// Scales of the on-board gains.
    pub gains: Option<PdGain>,
}

impl Catalogue {
    /// The effects in `values` beyond the vehicle file, limited to `which` if given: those with a
    /// number off its reference.
    pub fn effects(&self, values: &[f64], which: Option<&[EffectId]>) -> EffectSet {
        let mut set = EffectSet::new();
        for effect in EffectId::ALL {
            if which.is_some_and(|which| !which.contains(&effect)) {
                continue;
            }
            let mut slots = reference_slots(&self.vehicle, effect);
            let mut off = false;
            for (number, value) in self.numbers.iter().zip(values) {
                match number.target {
                    Target::Effect(id, slot) if id == effect => {
                        off |= *value != number.reference;
                        slots[slot] = *value;
                    }
                    Target::RotorScale(rotor)
                        if effect == EffectId::RotorLoss && *value != number.reference =>
                    {
                        off = true;
                        slots[0] = rotor as f64;
                        slots[1] = *value;
                    }
                    Target::OutputDelay
                        if effect == EffectId::CommandDelay
                            && self.outputs_late
                            && *value != number.reference =>
                    {
                        off = true;
                        slots[0] = value.max(0.0);
                    }
                    _ => {}
                }
            }
            if off {
                // A number outside the accepted range leaves the file's value in force.
                let _ = set.insert(effect, slots);
            }
        }
        set
    }

    /// The law in `values`; `None` where no term has a coefficient.
    pub fn law(&self, values: &[f64]) -> Option<LawText> {
        let terms = self.numbers.iter().zip(values).filter_map(|(number, value)| {
            let Target::Term(index) = number.target else { return None };
            self.terms.get(index).filter(|_| *value != 0.0).map(|term| (term, *value))
        });
        law_of(terms)
    }

    /// The vehicle file according to `values`, and the effects to put over it.
    pub fn vehicle_of(&self, values: &[f64]) -> (VehicleParams, EffectSet) {
        let mut vehicle = self.vehicle.clone();
        for (number, value) in self.numbers.iter().zip(values) {
            match number.target {
                Target::Imbalance(contrast) => {
                    for (rotor, share) in vehicle.rotors.iter_mut().zip(CONTRASTS[contrast]) {
                        rotor.thrust_max_n *= 1.0 + share * value;
                    }
                }
                Target::Damping(axis) if *value != 0.0 => {
                    vehicle.angular_damping_nms.get_or_insert_default()[axis] += value;
                }
                _ => {}
            }
        }
        let mut effects = self.effects(values, None);
        if let Some(law) = self
            .law(values)
            .and_then(|text| Law::new(&name_of(&vehicle.modelled_effects), text).ok())
        {
            // A law beyond the most that a vehicle may have is rejected, which leaves the file's
            // laws in force.
            let _ = effects.insert_law(law);
        }
        (vehicle, effects)
    }

    /// The vehicle according to `values`, with its inputs and its reports.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn candidate(&self, values: &[f64]) -> Result<Candidate, VehicleError> {
        let of_target = |target: Target| {
            let numbers = self.numbers.iter().zip(values);
            numbers.filter(move |(number, _)| number.target == target).map(|(_, value)| *value)
        };
        let (vehicle, overlay) = self.vehicle_of(values);
        let effects = vehicle.modelled_effects.overlay(&overlay);
        let physics = Physics::new(&vehicle, &overlay)?;
        Ok(Candidate {
            output_delay: of_target(Target::OutputDelay).sum(),
            velocity_smoothing: of_target(Target::VelocitySmoothing).sum(),
            lag: physics.constants().motor_time_constant,
            latency: effects.get::<EstimatorLatency>().map_or(0.0, |e| e.latency_s),
            trim: effects.get::<AttitudeTrim>(),
            command_delay: effects
                .get::<CommandDelay>()
                .map_or(self.vehicle.command_delay_s, |e| e.delay_s),
            gains: effects.get::<PdGain>(),
            physics,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vehicle() -> VehicleParams {
        let text = include_str!("../../../config/vehicles/quad1200.toml");
        VehicleParams::from_toml_str(text).unwrap()
    }

    #[test]
    fn number_off_its_reference_becomes_its_requested_effect() {
        let catalogue = Catalogue::new(&vehicle(), true);
        let mut values = catalogue.references();
        let target = Target::Effect(EffectId::YawTorque, 0);
        let number = catalogue.numbers.iter().position(|n| n.target == target).unwrap();
        values[number] = 1.3;
        let set = catalogue.effects(&values, None);
        assert_eq!(set.value(EffectId::YawTorque, "scale", 0), Some(1.3));
        assert!(catalogue.effects(&values, Some(&[EffectId::Mass])).is_empty());
    }

    #[test]
    fn command_delay_spans_output_to_thrust_without_setpoints() {
        let catalogue = Catalogue::new(&vehicle(), false);
        let mut values = catalogue.references();
        let number =
            catalogue.numbers.iter().position(|n| n.target == Target::OutputDelay).unwrap();
        values[number] = 0.031;
        assert_eq!(catalogue.candidate(&values).unwrap().output_delay, 0.031);
        let set = catalogue.effects(&values, Some(&[EffectId::CommandDelay]));
        assert_eq!(set.value(EffectId::CommandDelay, "delay_s", 0), Some(0.031));
        assert!(catalogue.hypotheses.iter().all(|h| h.effect != EffectId::PdGain));
    }
}
