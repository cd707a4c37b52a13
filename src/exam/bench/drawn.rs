//! What a case's vehicle has beyond its file: drawn, and given the size at which it shows as strongly
//! as wanted.

use vehicle::effects::EffectId;

use super::size::{Shown, Wanted};
use super::truth::{Truth, ids};
use super::{Bench, NEED_DRAG};
use crate::exam::draw::Draw;
use crate::exam::flight::FlightError;
use crate::exam::magnitude::Direction;
use crate::exam::order::{Kind, Order};
use crate::exam::stranger::Stranger;

/// A pair's effects show at least and at most so strongly by themselves.
const PAIR_RATIOS: [f64; 2] = [2.0, 10.0];
/// The same of an effect that the catalogue is to lack: what hardly shows is not missed.
const LEFT_OUT_RATIOS: [f64; 2] = [1.0, 10.0];
/// The same of a disturbance from outside.
const FOREIGN_RATIOS: [f64; 2] = [1.0, 10.0];
/// And of what a trap hides, on flights that would show it.
const TRAP_RATIOS: [f64; 2] = [3.0, 12.0];
/// Sizes of a pair's effects and of what a trap hides, and of what is not in the catalogue.
const PAIR_SIZES: [f64; 2] = [1.15, 4.0];
const UNKNOWN_SIZES: [f64; 2] = [1.3, 4.0];
/// A truth as it was drawn.
#[derive(Debug, Default)]
pub(super) struct Drawn {
    pub truth: Truth,
    /// Its effects, and how strongly each shows by itself, where that was measured.
    pub sizes: Vec<(EffectId, Option<Shown>)>,
    /// What a trap's flights cannot tell from it.
    pub candidates: Vec<EffectId>,
    /// How strongly all of it shows.
    pub whole: Option<Shown>,
}

impl Bench {
    /// A truth that `order` asks for.
    pub(super) fn truth(&self, draw: &mut Draw, order: &Order) -> Result<Drawn, FlightError> {
        let mut drawn = Drawn::default();
        if order.kind == Kind::Null {
            return Ok(drawn);
        }
        let baseline = self.baseline()?;
        match order.kind {
            Kind::Foreign | Kind::OtherLaw => {
                let (stranger, wanted) = match order.kind {
                    Kind::Foreign => {
                        let stranger = Stranger::disturbance(draw, &self.nominal);
                        (stranger, self.measure(FOREIGN_RATIOS, UNKNOWN_SIZES))
                    }
                    _ => {
                        let stranger = Stranger::law(draw, &self.nominal, self.has_drag());
                        (stranger, self.single(draw))
                    }
                };
                let (truth, shown) = self.sized_stranger(draw, &baseline, &stranger, wanted)?;
                (drawn.truth, drawn.whole) = (truth, Some(shown));
            }
            Kind::Trap => {
                let effect = self.trap.map_or(EffectId::GroundEffect, |trap| trap.effect);
                drawn.candidates = self.trap.map_or(&[][..], |trap| trap.candidates).to_vec();
                let (sized, shown) = if drawn.candidates.is_empty() {
                    // As much as other flights would show plainly.
                    (Direction::draw(draw, &self.nominal, effect).at(0.5), None)
                } else {
                    let wanted = self.measure(TRAP_RATIOS, PAIR_SIZES);
                    let (sized, shown) = self.sized_effect(draw, &baseline, effect, wanted)?;
                    (sized, Some(shown))
                };
                drawn.truth.effects = sized;
                drawn.sizes.push((effect, shown));
            }
            _ => {
                for (effect, wanted) in self.wanted(draw, order) {
                    let (sized, shown) = self.sized_effect(draw, &baseline, effect, wanted)?;
                    drawn.truth.effects = drawn.truth.effects.overlay(&sized);
                    drawn.sizes.push((effect, Some(shown)));
                }
            }
        }
        if drawn.whole.is_none() {
            drawn.whole = match drawn.sizes.as_slice() {
                [(_, Some(one))] => Some(one.clone()),
                _ => Some(self.shown(&baseline, &drawn.truth)?),
            };
        }
        Ok(drawn)
    }

    /// The effects of a case, and how strongly each is to show.
    fn wanted(&self, draw: &mut Draw, order: &Order) -> Vec<(EffectId, Wanted)> {
        if let Some(trip) = &order.round_trip {
            return vec![(trip.effect, Wanted::Ratio([trip.ratio; 2]))];
        }
        let first = self.effect(draw, |_| true);
        match order.kind {
            Kind::LeftOut => vec![(first, self.measure(LEFT_OUT_RATIOS, UNKNOWN_SIZES))],
            Kind::Pair => {
                let second = self.effect(draw, |other| other.class() != first.class());
                let wanted = self.measure(PAIR_RATIOS, PAIR_SIZES);
                vec![(first, wanted), (second, wanted)]
            }
            Kind::Modelled => {
                let modelled = ids(&self.nominal.modelled_effects).first().copied();
                let effect = modelled.filter(|_| draw.chance(0.5)).unwrap_or(EffectId::Wind);
                vec![(effect, self.single(draw))]
            }
            _ => vec![(first, self.single(draw))],
        }
    }

    /// An effect that this vehicle may have.
    pub(in crate::exam) fn effect(
        &self,
        draw: &mut Draw,
        wanted: impl Fn(EffectId) -> bool,
    ) -> EffectId {
        let has_drag = self.has_drag();
        loop {
            let effect = EffectId::ALL[draw.below(EffectId::ALL.len())];
            let possible = match effect {
                _ if NEED_DRAG.contains(&effect) => has_drag,
                EffectId::RotorGyroscopic => self.nominal.rotor_max_rpm.is_some(),
                // Between setpoints and outputs nothing is known.
                EffectId::PdGain | EffectId::CommandDelay => self.setting.on_board.is_known(),
                _ => !self.nominal.modelled_effects.contains(effect),
            };
            if possible && wanted(effect) {
                return effect;
            }
        }
    }
}
