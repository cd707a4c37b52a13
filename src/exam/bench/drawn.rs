//! Draws a case's truth, and searches for the size at which it shows as strongly as wanted.

use vehicle::effects::EffectId;

use super::size::{TargetStrength, TruthStrength};
use super::truth::{Truth, ids};
use super::{Bench, NEED_DRAG};
use crate::exam::direction::Direction;
use crate::exam::draw::Draw;
use crate::exam::flight::FlightError;
use crate::exam::foreign::ForeignDirection;
use crate::exam::order::{Kind, Order};

/// Range of the ratio over noise of each effect of a pair alone.
const PAIR_RATIOS: [f64; 2] = [2.0, 10.0];
/// Range of the ratio for an effect left out of the catalogue: one that hardly shows is not missed.
const LEFT_OUT_RATIOS: [f64; 2] = [1.0, 10.0];
/// Range of the ratio for a disturbance from outside.
const FOREIGN_RATIOS: [f64; 2] = [1.0, 10.0];
/// Range of the ratio for a trap's hidden effect, on flights that would show it.
const TRAP_RATIOS: [f64; 2] = [3.0, 12.0];
/// Sizes relative to the practical one: of a pair's or a trap's effects, and of effects outside the
/// catalogue.
const PAIR_SIZES: [f64; 2] = [1.15, 4.0];
const UNKNOWN_SIZES: [f64; 2] = [1.3, 4.0];

/// A drawn truth.
#[derive(Debug, Default)]
pub(super) struct Drawn {
    pub truth: Truth,
    /// Its effects with how strongly each shows alone, where that was measured.
    pub sizes: Vec<(EffectId, Option<TruthStrength>)>,
    /// Effects that a trap's flights do not distinguish from it.
    pub candidates: Vec<EffectId>,
    /// How strongly the whole truth shows.
    pub total: Option<TruthStrength>,
}

impl Bench {
    /// Draws a truth according to `order`.
    pub(super) fn truth(&self, draw: &mut Draw, order: &Order) -> Result<Drawn, FlightError> {
        let mut drawn = Drawn::default();
        if order.kind == Kind::Null {
            return Ok(drawn);
        }
        let baseline = self.baseline()?;
        match order.kind {
            Kind::Foreign | Kind::OtherLaw => {
                let (foreign, target) = match order.kind {
                    Kind::Foreign => {
                        let foreign = ForeignDirection::disturbance(draw, &self.nominal);
                        (foreign, self.measure(FOREIGN_RATIOS, UNKNOWN_SIZES))
                    }
                    _ => {
                        let foreign = ForeignDirection::law(draw, &self.nominal, self.has_drag());
                        (foreign, self.single(draw))
                    }
                };
                let (truth, shown) = self.sized_foreign(draw, &baseline, &foreign, target)?;
                (drawn.truth, drawn.total) = (truth, Some(shown));
            }
            Kind::Trap => {
                let effect = self.trap.map_or(EffectId::GroundEffect, |trap| trap.effect);
                drawn.candidates = self.trap.map_or(&[][..], |trap| trap.candidates).to_vec();
                let (sized, shown) = if drawn.candidates.is_empty() {
                    // Of a size that other flights would show clearly.
                    (Direction::draw(draw, &self.nominal, effect).at(0.5), None)
                } else {
                    let target = self.measure(TRAP_RATIOS, PAIR_SIZES);
                    let (sized, shown) = self.sized_effect(draw, &baseline, effect, target)?;
                    (sized, Some(shown))
                };
                drawn.truth.effects = sized;
                drawn.sizes.push((effect, shown));
            }
            _ => {
                for (effect, target) in self.targets(draw, order) {
                    let (sized, shown) = self.sized_effect(draw, &baseline, effect, target)?;
                    drawn.truth.effects = drawn.truth.effects.overlay(&sized);
                    drawn.sizes.push((effect, Some(shown)));
                }
            }
        }
        if drawn.total.is_none() {
            drawn.total = match drawn.sizes.as_slice() {
                [(_, Some(one))] => Some(one.clone()),
                _ => Some(self.truth_strength(&baseline, &drawn.truth)?),
            };
        }
        Ok(drawn)
    }

    /// The effects of a case, with the strength that each should have.
    fn targets(&self, draw: &mut Draw, order: &Order) -> Vec<(EffectId, TargetStrength)> {
        if let Some(trip) = &order.round_trip {
            return vec![(trip.effect, TargetStrength::Ratio([trip.ratio; 2]))];
        }
        let first = self.effect(draw, |_| true);
        match order.kind {
            Kind::LeftOut => vec![(first, self.measure(LEFT_OUT_RATIOS, UNKNOWN_SIZES))],
            Kind::Pair => {
                let second = self.effect(draw, |other| other.class() != first.class());
                let target = self.measure(PAIR_RATIOS, PAIR_SIZES);
                vec![(first, target), (second, target)]
            }
            Kind::Modelled => {
                let modelled = ids(&self.nominal.modelled_effects).first().copied();
                let effect = modelled.filter(|_| draw.chance(0.5)).unwrap_or(EffectId::Wind);
                vec![(effect, self.single(draw))]
            }
            _ => vec![(first, self.single(draw))],
        }
    }

    /// Draws an effect that this vehicle may have and that satisfies `allows`.
    pub(in crate::exam) fn effect(
        &self,
        draw: &mut Draw,
        allows: impl Fn(EffectId) -> bool,
    ) -> EffectId {
        let has_drag = self.has_drag();
        loop {
            let effect = EffectId::ALL[draw.below(EffectId::ALL.len())];
            let possible = match effect {
                _ if NEED_DRAG.contains(&effect) => has_drag,
                EffectId::RotorGyroscopic => self.nominal.rotor_max_rpm.is_some(),
                // With an unknown loop, nothing is known between setpoints and outputs.
                EffectId::PdGain | EffectId::CommandDelay => self.setting.on_board.is_known(),
                _ => !self.nominal.modelled_effects.contains(effect),
            };
            if possible && allows(effect) {
                return effect;
            }
        }
    }
}
