//! Effects with a direction and a size: one number that grows from nothing to as much as a vehicle
//! may sensibly have, so that a wanted strength can be searched for.

use vehicle::effects::{EffectId, EffectSet, Slots};
use vehicle::{ROTORS, VehicleParams};

use super::draw::{Draw, rounded};
use crate::diagnose::hypothesis::reference;

/// An effect along a drawn direction.
#[derive(Clone, Debug)]
pub struct Direction {
    /// Which.
    pub effect: EffectId,
    /// The slots at size 0.
    base: Slots,
    /// What size 1 adds: as much as a vehicle may sensibly have.
    step: Slots,
    /// Whether the effect grows with the square of its size.
    pub quadratic: bool,
}

impl Direction {
    /// Draws a direction. An effect that the vehicle file models goes off from there.
    pub fn draw(draw: &mut Draw, vehicle: &VehicleParams, effect: EffectId) -> Self {
        use EffectId::*;
        let mut base = Slots::default();
        for slot in effect.spec().slots() {
            base[slot.index] = reference(vehicle, effect, slot.index);
        }
        let weight = vehicle.mass * vehicle.gravity;
        let arms = vehicle.rotors.map(|r| r.position_m[0].hypot(r.position_m[1]));
        let arm = arms.iter().sum::<f64>() / ROTORS as f64;
        let modelled = vehicle.modelled_effects.contains(effect);
        let scales =
            |draw: &mut Draw, range: [f64; 2]| (draw.sign() * draw.within(range)).max(-0.4);
        let mut step = Slots::default();
        match effect {
            ThrustScale => step[0] = draw.sign() * 0.2,
            Mass => step[0] = draw.sign() * 0.2 * vehicle.mass,
            ThrustCurve => step[0] = 0.7,
            BatterySag => step[0] = 2.5,
            RotorLoss => {
                base[0] = draw.below(ROTORS) as f64;
                base[1] = 1.0;
                step[1] = -0.25;
            }
            MotorLag => step[0] = 0.06,
            CommandDelay => step[0] = 0.05,
            RotorDrag => {
                step[0] = vehicle.mass * draw.within([0.4, 0.7]);
                step[1] = step[0] * draw.within([0.2, 0.6]);
            }
            ParasiticDrag => {
                let at_8_m_s = 0.5 * vehicle.air_density * 64.0;
                step[0] = 0.6 * weight / at_8_m_s;
            }
            Wind => {
                let direction = draw.within([0.0, std::f64::consts::TAU]);
                (step[0], step[1]) = (8.0 * direction.cos(), 8.0 * direction.sin());
            }
            Gusts => {
                step[0] = 4.0;
                base[1] = rounded(draw.log_within([2.0, 20.0]));
                base[2] = rounded(draw.within([2.0, 8.0]));
            }
            GroundEffect => step[0] = 10.0 * vehicle.rotor_radius_m,
            TranslationalLift => step[0] = 0.03,
            BladeFlapping => {
                step[0] = 0.03 * weight * arm * draw.within([0.5, 1.0]);
                step[1] = 0.03 * draw.within([0.3, 1.0]);
            }
            VortexRing => {
                step[0] = 0.7;
                (base[1], base[2]) = (0.2, 0.8);
            }
            Inertia => {
                for axis in step.iter_mut().take(3) {
                    *axis = scales(draw, [0.3, 0.8]);
                }
            }
            ComOffset => {
                let direction = draw.within([0.0, std::f64::consts::TAU]);
                (step[0], step[1]) = (0.12 * arm * direction.cos(), 0.12 * arm * direction.sin());
            }
            RotorGyroscopic => {
                let most = vehicle.rotor_max_rpm.unwrap_or(1e4) * std::f64::consts::TAU / 60.0;
                step[0] = 30.0 * vehicle.inertia[2] / most;
            }
            YawTorque => step[0] = scales(draw, [0.6, 1.0]),
            AttitudeTrim => {
                let direction = draw.within([0.0, std::f64::consts::TAU]);
                (step[0], step[1]) = (0.06 * direction.cos(), 0.06 * direction.sin());
            }
            EstimatorLatency => step[0] = 0.09,
            PdGain => {
                let [tilt, yaw] = [scales(draw, [0.3, 0.6]), scales(draw, [0.2, 0.5])];
                (step[0], step[1], step[2]) = (tilt, tilt * draw.within([0.8, 1.2]), yaw);
                let damping = scales(draw, [0.1, 0.4]);
                (step[3], step[4]) = (damping, damping);
            }
        }
        // Off a modelled value in either direction, but never to the other side of nothing.
        if modelled && draw.chance(0.5) {
            for (step, base) in step.iter_mut().zip(base) {
                *step = if base > 0.0 { -step.abs().min(base) } else { -*step };
            }
        }
        Self { effect, base, step, quadratic: effect == GroundEffect && !modelled }
    }

    /// The effect at a size.
    pub fn at(&self, size: f64) -> EffectSet {
        let mut slots = self.base;
        for slot in self.effect.spec().slots() {
            let value = self.base[slot.index] + size * self.step[slot.index];
            slots[slot.index] = rounded(value.clamp(slot.parameter.min, slot.parameter.max));
        }
        let mut set = EffectSet::new();
        // Clamped and of its own kind: it is accepted.
        let _ = set.insert(self.effect, slots);
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_grows_from_nothing() {
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
            assert!((slots[1] - rounded(direction.base[1])).abs() < 1e-12, "{effect}");
        }
    }
}
