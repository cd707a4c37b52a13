//! The size of a truth: its strength over noise, and the strength that remains after the vehicle
//! file's numbers have moved within their tolerances to explain it.

use sitl::autopilot::VehicleRefused;
use vehicle::VehicleParams;
use vehicle::effects::{AttitudeTrim, EffectId, EffectSet, RotorDrag, Slots};
use vehicle::foreign::Foreign;
use vehicle::frame::{Attitude, Euler};

use super::truth::ids;
use super::{Bench, Truth};
use crate::diagnose::catalogue::number::CONTRASTS;
use crate::exam::direction::Direction;
use crate::exam::draw::Draw;
use crate::exam::flight::FlightError;
use crate::exam::foreign::ForeignDirection;
use crate::exam::strength::{DETECTABLE, Errors, Model, Moved, Predictor, Strength};
use crate::exam::world::World;

/// Most trials to find a size with the wanted strength.
const SEARCHES: usize = 4;
/// A strength within this factor of the wanted one is accepted.
const CLOSE: f64 = 1.35;
/// Sizes of effects relative to the practical one: of most cases, and of small ones.
const PRACTICAL: [f64; 2] = [1.15, 7.0];
const SMALL: [f64; 2] = [0.15, 0.9];
/// Share of single effects that are smaller than the practical size.
const SMALL_SHARE: f64 = 0.2;
/// The practical size: this many tolerances off the file, and this ratio over noise after every
/// number of the file has moved by as many.
const PRACTICAL_TOLERANCES: f64 = 3.0;
const PRACTICAL_RATIO: f64 = 3.0;
/// Half of a typical drag, which a file may lack, divided by the mass, 1/s; and the drag along the
/// thrust, as a share of that across.
const LACKING_DRAG: f64 = 0.15;
const LACKING_DRAG_ALONG: f64 = 0.4;

/// The strength of a truth.
#[derive(Clone, Debug)]
pub(in crate::exam) struct TruthStrength {
    /// Strength of the truth alone.
    pub strength: Strength,
    /// Strength that remains after the file's numbers have moved.
    pub beyond: Strength,
    /// Distance of each effect from the file in tolerances; `None` where the file has no such
    /// number.
    pub tolerances: Vec<Option<f64>>,
}

impl TruthStrength {
    /// Its size relative to the practical one.
    pub fn size(&self) -> f64 {
        let off = self.tolerances.iter().flatten().map(|off| off / PRACTICAL_TOLERANCES);
        off.fold(self.beyond.ratio / PRACTICAL_RATIO, f64::min)
    }
}

/// The target strength of a truth.
#[derive(Clone, Copy)]
pub(in crate::exam) enum TargetStrength {
    /// Ratio over noise alone.
    Ratio([f64; 2]),
    /// Size relative to the practical one.
    Size([f64; 2]),
}

impl Bench {
    /// A predictor with the vehicle without the truth, as if its differences from the file were
    /// known. `change` modifies its numbers and effects.
    fn predictor(
        &self,
        truth: &Truth,
        change: impl FnOnce(&mut VehicleParams, &mut EffectSet),
    ) -> Result<Predictor, VehicleRefused> {
        let deviations = self.deviations_beside(truth);
        let (mut body, mut effects) = (deviations.body(&self.believed), deviations.effects());
        // Reports are compared without latency and trim.
        let trim =
            effects.get::<AttitudeTrim>().map_or(Attitude::default(), |trim| trim.rotation());
        effects.remove(EffectId::AttitudeTrim);
        effects.remove(EffectId::EstimatorLatency);
        change(&mut body, &mut effects);
        let foreign: Vec<Foreign> = deviations.foreign().into_iter().cloned().collect();
        let model = Model {
            believed: &self.believed,
            body: &body,
            effects: &effects,
            foreign: &foreign,
            trim,
            outputs_hz: (!self.setting.on_board.is_known()).then_some(self.setting.outputs_hz),
        };
        Ok(Predictor::new(&model, self.configs[0].sensors)?)
    }

    /// Predictors with each number of the file moved by a tolerance.
    fn moved(&self, truth: &Truth) -> Result<Vec<Moved>, VehicleRefused> {
        let sigma = self.deviations.tolerances;
        let by = |most: f64, change: &dyn Fn(&mut VehicleParams, &mut EffectSet)| {
            Ok::<_, VehicleRefused>(Moved::of(self.predictor(truth, change)?, most))
        };
        let most = PRACTICAL_TOLERANCES;
        let mut moved = Vec::new();
        // Logs do not distinguish a common thrust error from a mass error.
        let level = sigma.thrust_common + sigma.mass;
        moved.push(by(most, &|body, _| {
            body.rotors.iter_mut().for_each(|rotor| rotor.thrust_max_n *= 1.0 + level);
        })?);
        for contrast in CONTRASTS {
            moved.push(by(most, &|body, _| {
                for (rotor, share) in body.rotors.iter_mut().zip(contrast) {
                    rotor.thrust_max_n *= 1.0 + sigma.thrust_each * share;
                }
            })?);
        }
        for axis in 0..3 {
            moved.push(by(most, &|body, _| body.inertia[axis] *= 1.0 + sigma.inertia)?);
        }
        for axis in 0..2 {
            moved.push(by(most, &|body, _| {
                body.rotors.iter_mut().for_each(|rotor| rotor.position_m[axis] -= sigma.centre_m);
            })?);
        }
        moved.push(by(most, &|body, _| {
            let torques = body.rotors.iter_mut().map(|rotor| &mut rotor.drag_torque_per_thrust_m);
            torques.for_each(|torque| *torque *= 1.0 + sigma.drag_torque);
        })?);
        if self.nominal.motor_time_constant_s > 0.0 {
            moved.push(by(most, &|body, _| body.motor_time_constant_s *= 1.0 + sigma.lag)?);
        }
        if self.setting.on_board.is_known() {
            moved.push(by(most, &|body, _| body.command_delay_s += sigma.delay_s)?);
        }
        let same = || self.predictor(truth, |_, _| {});
        for [roll, pitch] in [[sigma.trim_rad, 0.0], [0.0, sigma.trim_rad]] {
            let trim = Euler::new(roll, pitch, 0.0).attitude();
            moved.push(Moved::of(same()?, most).trim(trim));
        }
        moved.push(Moved::of(same()?, 1.0).latency(sigma.pose_s[1]));
        if !self.has_drag() {
            let mass = self.nominal.mass;
            moved.push(by(1.0, &|_, effects| {
                let drag = effects.get::<RotorDrag>();
                let (across, along) = drag.map_or((0.0, 0.0), |drag| (drag.d_xy, drag.d_z));
                let more = LACKING_DRAG * mass;
                let mut slots = Slots::default();
                (slots[0], slots[1]) = (across + more, along + LACKING_DRAG_ALONG * more);
                // The catalogue accepts a drag of this size.
                let _ = effects.insert(EffectId::RotorDrag, slots);
            })?);
        }
        Ok(moved)
    }

    /// Prediction errors without any truth.
    pub(in crate::exam) fn baseline(&self) -> Result<Errors, FlightError> {
        let nothing = Truth::default();
        let predictor = self.predictor(&nothing, |_, _| {})?;
        Ok(predictor.errors(&self.tracks(&nothing)?, &EffectSet::new(), self.seed))
    }

    /// The strength of a truth, from flights without sensor noise. In [`World::Builders`] this
    /// includes the part that the file's numbers cannot explain.
    pub(in crate::exam) fn truth_strength(
        &self,
        baseline: &Errors,
        truth: &Truth,
    ) -> Result<TruthStrength, FlightError> {
        let predictor = self.predictor(truth, |_, _| {})?;
        let tracks = self.tracks(truth)?;
        let errors = predictor.errors(&tracks, &truth.effects, self.seed);
        let strength = errors.strength(baseline);
        let (beyond, tolerances) = match self.world {
            World::Exact => (strength.clone(), Vec::new()),
            World::Builders => {
                let moved = self.moved(truth)?;
                let beyond = predictor.beyond(&tracks, &truth.effects, &moved, &errors, baseline);
                // Under another law, only the cause is a number that the file has off.
                let cause = |id: &EffectId| truth.causes.first().is_none_or(|cause| cause == id);
                let sigma = &self.deviations.tolerances;
                let off = |id: EffectId| sigma.beyond(&self.nominal, &truth.effects, id);
                (beyond, ids(&truth.effects).into_iter().filter(cause).map(off).collect())
            }
        };
        Ok(TruthStrength { strength, beyond, tolerances })
    }

    /// The truth at a size that shows about as strongly as wanted, within sensible sizes.
    fn sized(
        &self,
        draw: &mut Draw,
        baseline: &Errors,
        at: &dyn Fn(f64) -> Truth,
        power: f64,
        target: TargetStrength,
    ) -> Result<(Truth, TruthStrength), FlightError> {
        let (TargetStrength::Ratio(range) | TargetStrength::Size(range)) = target;
        let goal = draw.log_within(range);
        let mut size: f64 = 0.3;
        let mut last = Err(FlightError::Lost(0.0));
        for _ in 0..SEARCHES {
            let truth = at(size);
            let shown = match self.truth_strength(baseline, &truth) {
                Ok(shown) => shown,
                Err(error) => {
                    last = Err(error);
                    size *= 0.4;
                    continue;
                }
            };
            let reached = match target {
                TargetStrength::Ratio(_) => shown.strength.ratio,
                TargetStrength::Size(_) => shown.size(),
            };
            last = Ok((truth, shown));
            let off = goal / reached.max(1e-6);
            // The size must be on the right side of the practical one.
            let is_close = (1.0 / CLOSE..CLOSE).contains(&off)
                && (matches!(target, TargetStrength::Ratio(_)) || (goal < 1.0) == (reached < 1.0));
            if is_close || (size >= 1.0 && off > 1.0) {
                break;
            }
            size = (size * off.powf(power)).min(1.0);
        }
        last
    }

    pub(in crate::exam) fn sized_effect(
        &self,
        draw: &mut Draw,
        baseline: &Errors,
        effect: EffectId,
        target: TargetStrength,
    ) -> Result<(EffectSet, TruthStrength), FlightError> {
        let direction = Direction::draw(draw, &self.nominal, effect);
        let power = if direction.quadratic { 0.5 } else { 1.0 };
        let at = |size| direction.at(size).into();
        let (truth, shown) = self.sized(draw, baseline, &at, power, target)?;
        Ok((truth.effects, shown))
    }

    pub(in crate::exam) fn sized_foreign(
        &self,
        draw: &mut Draw,
        baseline: &Errors,
        foreign: &ForeignDirection,
        target: TargetStrength,
    ) -> Result<(Truth, TruthStrength), FlightError> {
        let at = |size: f64| Truth {
            effects: foreign.effects(size),
            foreign: Some(foreign.at(size)),
            causes: foreign.causes,
            rotor: foreign.rotor(),
        };
        self.sized(draw, baseline, &at, 1.0, target)
    }

    /// The wanted strength in this world: a ratio over noise, or a size relative to the practical
    /// one.
    pub(in crate::exam) fn measure(&self, ratio: [f64; 2], size: [f64; 2]) -> TargetStrength {
        match self.world {
            World::Exact => TargetStrength::Ratio(ratio),
            World::Builders => TargetStrength::Size(size),
        }
    }

    /// The wanted strength of a single effect, which may be below the practical size.
    pub(in crate::exam) fn single(&self, draw: &mut Draw) -> TargetStrength {
        let is_small = self.world == World::Builders && draw.chance(SMALL_SHARE);
        self.measure(self.ratios, if is_small { SMALL } else { PRACTICAL })
    }

    /// Whether an answer should name a truth of this strength.
    pub(in crate::exam) fn is_practical(&self, shown: &TruthStrength) -> bool {
        match self.world {
            World::Exact => shown.strength.ratio >= DETECTABLE,
            World::Builders => shown.size() >= 1.0,
        }
    }
}
