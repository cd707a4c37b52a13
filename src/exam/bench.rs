//! What a case is flown on: a vehicle, its sensors, its link and the motions, and how a truth is
//! given the size at which it shows as strongly as wanted.

use std::collections::BTreeMap;

use sitl::config::{ImuNoise, SensorConfig, SitlConfig};
use sitl::effects::{EffectId, EffectSet, ParameterValue};
use sitl::foreign::Foreign;
use sitl::vehicle::{VehicleError, VehicleParams};

use super::airframe;
use super::case::{Case, Kind, Order, Settings};
use super::condition::Condition;
use super::draw::{Draw, rounded};
use super::flight::{FlightError, Link, Sortie, Track};
use super::ground::Rates;
use super::key::{KeyEntry, TrueEffect};
use super::magnitude::Direction;
use super::motion::Motion;
use super::programme::{Restriction, Vigour, programme};
use super::stranger::Stranger;
use super::strength::{Errors, Predictor, Strength};
use super::trap::{STEADY_PACK, TRAPS, Trap};
use crate::diagnose::answer::{Parameter, Verdict, parameters};
use crate::diagnose::hypothesis::reference;
use crate::diagnose::noise::ReportNoise;

/// Searches for a size of the wanted strength.
const SEARCHES: usize = 4;
/// A strength within this factor of the wanted one is as good.
const CLOSE: f64 = 1.35;
/// A pair's effects show at least and at most so strongly by themselves.
const PAIR_RATIOS: [f64; 2] = [2.0, 10.0];
/// The same of an effect that the catalogue is to lack: what hardly shows is not missed.
const LEFT_OUT_RATIOS: [f64; 2] = [1.0, 10.0];
/// The same of a disturbance from outside.
const FOREIGN_RATIOS: [f64; 2] = [1.0, 10.0];
/// And of what a trap hides, on flights that would show it.
const TRAP_RATIOS: [f64; 2] = [3.0, 12.0];
/// Effects that act on the velocity relative to the air.
const DRAGS: [EffectId; 2] = [EffectId::RotorDrag, EffectId::ParasiticDrag];
/// And those that act through them.
const NEED_DRAG: [EffectId; 2] = [EffectId::Wind, EffectId::Gusts];

/// What the vehicle has beyond its file.
#[derive(Clone, Debug, Default)]
struct Truth {
    effects: EffectSet,
    foreign: Option<Foreign>,
}

impl From<EffectSet> for Truth {
    fn from(effects: EffectSet) -> Self {
        Self { effects, foreign: None }
    }
}

/// What strengths are measured with.
struct Judge {
    predictor: Predictor,
    /// Of the nominal vehicle itself.
    nominal: Errors,
}

/// All of a case but what the vehicle has beyond its file.
pub(super) struct Bench {
    nominal: VehicleParams,
    /// By flight: pack and sensors.
    configs: Vec<SitlConfig>,
    rates: Rates,
    link: Link,
    motions: Vec<Motion>,
    seconds: f64,
    ratios: [f64; 2],
    seed: u64,
    notes: Vec<String>,
    trap: Option<&'static Trap>,
}

impl Bench {
    /// Everything about a case that chance decides but its truth.
    pub(super) fn draw(
        draw: &mut Draw,
        settings: &Settings,
        name: &str,
        order: &Order,
    ) -> Result<Self, VehicleError> {
        let kind = order.kind;
        let mut nominal = airframe::vehicle(draw, name);
        let mut notes = Vec::new();
        if let Some(trip) = &order.round_trip {
            nominal = VehicleParams { name: name.to_owned(), ..trip.vehicle.clone() };
        }
        let trap = (kind == Kind::Trap).then(|| &TRAPS[draw.below(TRAPS.len())]);
        let must = kind == Kind::Modelled || trap.is_some_and(|trap| trap.models_drag);
        let is_free = order.round_trip.is_none();
        let lacks = order.round_trip.as_ref().is_some_and(|trip| {
            NEED_DRAG.contains(&trip.effect)
                && !DRAGS.iter().any(|drag| nominal.modelled_effects.contains(*drag))
        });
        if must || lacks || is_free && draw.chance(0.2) {
            let drag = if draw.chance(0.7) { DRAGS[0] } else { DRAGS[1] };
            let size = draw.within([0.15, 0.5]);
            nominal.modelled_effects = Direction::draw(draw, &nominal, drag).at(size);
            notes.push(format!("the vehicle file models {drag}"));
        }
        let noise = if draw.chance(0.15) {
            notes.push("noisy sensors".to_owned());
            draw.within([2.0, 4.0])
        } else {
            draw.within([0.7, 1.4])
        };
        let sensors = noisier(SensorConfig::default(), noise);
        let rates = Rates {
            attitude: if draw.chance(0.5) { 250.0 } else { 125.0 },
            imu: match draw.chance(0.3) {
                _ if trap.is_some_and(|trap| !trap.has_imu) => 0.0,
                true => 250.0,
                false => 100.0,
            },
            position: 100.0,
            outputs: if draw.chance(0.2) { 250.0 } else { 100.0 },
            battery: 5.0,
            rpm: if draw.chance(0.4) { 50.0 } else { 0.0 },
        };
        let link = Link {
            delay_s: 1.5e-3,
            jitter_s: draw.within([0.8e-3, 1.5e-3]),
            offset_s: draw.within([-1e4, 1e4]),
            skew: draw.within([-2e-5, 2e-5]),
        };
        let vigour = Vigour::draw(draw, nominal.rotor_radius_m);
        let restriction = trap.map_or(Restriction::None, |trap| trap.restriction);
        let motions = programme(draw, &vigour, restriction, settings.flights, settings.seconds);
        let configs = motions
            .iter()
            .map(|_| {
                let mut config = SitlConfig { sensors, ..SitlConfig::default() };
                config.battery.charge = draw.within([0.45, 1.0]);
                if trap.is_some_and(|trap| trap.steady_pack) {
                    config.battery = STEADY_PACK;
                }
                config
            })
            .collect();
        Ok(Self {
            nominal: nominal.checked()?,
            configs,
            rates,
            link,
            motions,
            seconds: settings.seconds,
            ratios: settings.ratios,
            seed: draw.seed(),
            notes,
            trap,
        })
    }

    fn sorties<'a>(&'a self, truth: &'a Truth, ideal: bool) -> impl Iterator<Item = Sortie<'a>> {
        self.motions.iter().zip(&self.configs).enumerate().map(move |(number, flight)| {
            let (motion, config) = flight;
            let mut config = config.clone();
            if ideal {
                config.sensors = SensorConfig::IDEAL;
            }
            Sortie {
                nominal: &self.nominal,
                effects: &truth.effects,
                foreign: truth.foreign.as_ref(),
                config,
                rates: self.rates,
                link: self.link,
                motion,
                seconds: self.seconds,
                seed: self.seed ^ (number as u64 + 1),
            }
        })
    }

    /// How strongly the truth shows, flown without sensor noise.
    fn strength(&self, judge: &Judge, truth: &Truth) -> Result<Strength, FlightError> {
        Ok(self.errors(&judge.predictor, truth)?.strength(&judge.nominal))
    }

    fn errors(&self, predictor: &Predictor, truth: &Truth) -> Result<Errors, FlightError> {
        let tracks: Vec<Track> = self
            .sorties(truth, true)
            .map(|sortie| sortie.fly().map(|flown| flown.track))
            .collect::<Result<_, _>>()?;
        Ok(predictor.errors(&tracks, &truth.effects, self.seed))
    }

    /// A truth of a size that shows about as strongly as wanted, as far as that is sensible.
    fn sized(
        &self,
        judge: &Judge,
        at: &dyn Fn(f64) -> Truth,
        power: f64,
        wanted: f64,
    ) -> Result<(Truth, f64), FlightError> {
        let mut size: f64 = 0.3;
        let mut last = Err(FlightError::Lost(0.0));
        for _ in 0..SEARCHES {
            let truth = at(size);
            let ratio = match self.strength(judge, &truth) {
                Ok(strength) => strength.ratio,
                Err(error) => {
                    last = Err(error);
                    size *= 0.4;
                    continue;
                }
            };
            last = Ok((truth, ratio));
            let off = wanted / ratio.max(1e-6);
            let is_close = (1.0 / CLOSE..CLOSE).contains(&off);
            if is_close || (size >= 1.0 && off > 1.0) {
                break;
            }
            size = (size * off.powf(power)).min(1.0);
        }
        last
    }

    fn sized_effect(
        &self,
        draw: &mut Draw,
        judge: &Judge,
        effect: EffectId,
        ratios: [f64; 2],
    ) -> Result<(EffectSet, f64), FlightError> {
        let direction = Direction::draw(draw, &self.nominal, effect);
        let power = if direction.quadratic { 0.5 } else { 1.0 };
        let wanted = draw.log_within(ratios);
        let (truth, ratio) = self.sized(judge, &|size| direction.at(size).into(), power, wanted)?;
        Ok((truth.effects, ratio))
    }

    fn sized_stranger(
        &self,
        draw: &mut Draw,
        judge: &Judge,
        stranger: &Stranger,
        ratios: [f64; 2],
    ) -> Result<Truth, FlightError> {
        let at = |size: f64| Truth { foreign: Some(stranger.at(size)), ..Truth::default() };
        Ok(self.sized(judge, &at, 1.0, draw.log_within(ratios))?.0)
    }

    /// Flies the case with a truth that `order` asks for.
    pub(super) fn case(mut self, draw: &mut Draw, order: &Order) -> Result<Case, FlightError> {
        let kind = order.kind;
        let Ok(Some(predictor)) = Predictor::new(&self.nominal, self.configs[0].sensors) else {
            return Err(FlightError::Lost(0.0));
        };
        let nominal = self.errors(&predictor, &Truth::default())?;
        let judge = Judge { predictor, nominal };
        let mut truth = Truth::default();
        let mut ratios = BTreeMap::new();
        let mut causes: &[EffectId] = &[];
        let mut candidates = Vec::new();
        match kind {
            Kind::Null => {}
            Kind::Foreign => {
                let stranger = Stranger::disturbance(draw, &self.nominal);
                truth = self.sized_stranger(draw, &judge, &stranger, FOREIGN_RATIOS)?;
            }
            Kind::OtherLaw => {
                let stranger = Stranger::law(draw, &self.nominal, self.has_drag());
                causes = stranger.causes;
                truth = self.sized_stranger(draw, &judge, &stranger, self.ratios)?;
            }
            Kind::Trap => {
                let effect = self.trap.map_or(EffectId::GroundEffect, |trap| trap.effect);
                candidates = self.trap.map_or(&[][..], |trap| trap.candidates).to_vec();
                let (sized, ratio) = if candidates.is_empty() {
                    // As much as other flights would show plainly.
                    (Direction::draw(draw, &self.nominal, effect).at(0.5), 0.0)
                } else {
                    self.sized_effect(draw, &judge, effect, TRAP_RATIOS)?
                };
                truth.effects = sized;
                ratios.insert(effect, ratio);
            }
            _ => {
                for (effect, range) in self.wanted(draw, order) {
                    let (sized, ratio) = self.sized_effect(draw, &judge, effect, range)?;
                    truth.effects = truth.effects.overlay(&sized);
                    ratios.insert(effect, ratio);
                }
            }
        }
        let snr = self.strength(&judge, &truth)?;
        let condition = order.round_trip.as_ref().map_or(Condition::Plain, |trip| trip.condition);
        let logs = self
            .sorties(&truth, false)
            .map(|sortie| Ok(condition.apply(&sortie.fly()?.tlog, sortie.seed)))
            .collect::<Result<_, FlightError>>()?;
        let verdict = match kind {
            Kind::Null => Verdict::None,
            Kind::Trap if candidates.is_empty() => Verdict::None,
            Kind::LeftOut | Kind::Foreign => Verdict::Unknown,
            _ => Verdict::Effect,
        };
        let mut effects: Vec<TrueEffect> = ratios
            .iter()
            .map(|(effect, ratio)| true_effect(&self.nominal, &truth.effects, *effect, *ratio))
            .collect();
        effects.extend(causes.first().map(|cause| TrueEffect {
            id: cause.name().to_owned(),
            parameters: BTreeMap::new(),
            neutral: BTreeMap::new(),
            ratio: rounded(snr.ratio),
        }));
        let names = |ids: &[EffectId]| ids.iter().map(|id| id.name().to_owned()).collect();
        let sensors = self.configs[0].sensors;
        let key = KeyEntry {
            kind,
            condition,
            verdict: verdict.name().to_owned(),
            effects,
            also_right: names(causes.get(1..).unwrap_or_default()),
            candidates: names(&candidates),
            foreign: truth.foreign,
            without: if kind == Kind::LeftOut { names(&ids(&truth.effects)) } else { Vec::new() },
            is_weak: snr.ratio < 1.0,
            snr,
            nominal_mass_kg: self.nominal.mass,
            tags: std::mem::take(&mut self.notes),
        };
        let noise = ReportNoise {
            position: sensors.position_noise_m,
            velocity: sensors.velocity_noise_m_s,
            attitude: sensors.attitude_noise_rad,
            body_rate: sensors.gyro.noise,
            specific_force: sensors.accelerometer.noise,
        };
        Ok(Case { nominal: self.nominal, logs, truth: truth.effects, noise, key })
    }

    /// The effects of a case, and how strongly each is to show.
    fn wanted(&self, draw: &mut Draw, order: &Order) -> Vec<(EffectId, [f64; 2])> {
        if let Some(trip) = &order.round_trip {
            return vec![(trip.effect, [trip.ratio; 2])];
        }
        let first = self.effect(draw, |_| true);
        match order.kind {
            Kind::LeftOut => vec![(first, LEFT_OUT_RATIOS)],
            Kind::Pair => {
                let second = self.effect(draw, |other| other.class() != first.class());
                vec![(first, PAIR_RATIOS), (second, PAIR_RATIOS)]
            }
            Kind::Modelled => {
                let modelled = ids(&self.nominal.modelled_effects).first().copied();
                let effect = modelled.filter(|_| draw.chance(0.5)).unwrap_or(EffectId::Wind);
                vec![(effect, self.ratios)]
            }
            _ => vec![(first, self.ratios)],
        }
    }

    fn has_drag(&self) -> bool {
        DRAGS.iter().any(|drag| self.nominal.modelled_effects.contains(*drag))
    }

    /// An effect that this vehicle may have.
    fn effect(&self, draw: &mut Draw, wanted: impl Fn(EffectId) -> bool) -> EffectId {
        let has_drag = self.has_drag();
        loop {
            let effect = EffectId::ALL[draw.below(EffectId::ALL.len())];
            let possible = match effect {
                _ if NEED_DRAG.contains(&effect) => has_drag,
                EffectId::RotorGyroscopic => self.nominal.rotor_max_rpm.is_some(),
                _ => !self.nominal.modelled_effects.contains(effect),
            };
            if possible && wanted(effect) {
                return effect;
            }
        }
    }
}

fn ids(effects: &EffectSet) -> Vec<EffectId> {
    effects.iter().map(|(effect, _)| effect).collect()
}

fn true_effect(
    nominal: &VehicleParams,
    effects: &EffectSet,
    effect: EffectId,
    ratio: f64,
) -> TrueEffect {
    let values = |set: &EffectSet| {
        let all = parameters(set, effect);
        all.iter().map(|(name, value)| ((*name).to_owned(), value_of(value))).collect()
    };
    let mut neutral = EffectSet::new();
    let mut slots = sitl::effects::Slots::default();
    for slot in effect.spec().slots() {
        slots[slot.index] = reference(nominal, effect, slot.index);
    }
    let _ = neutral.insert(effect, slots);
    TrueEffect {
        id: effect.name().to_owned(),
        parameters: values(effects),
        neutral: values(&neutral),
        ratio: rounded(ratio),
    }
}

fn value_of(parameter: &Parameter) -> ParameterValue {
    parameter.into()
}

/// The same sensors with so many times the noise.
fn noisier(sensors: SensorConfig, factor: f64) -> SensorConfig {
    let imu = |imu: ImuNoise| ImuNoise { noise: factor * imu.noise, ..imu };
    SensorConfig {
        position_noise_m: factor * sensors.position_noise_m,
        velocity_noise_m_s: factor * sensors.velocity_noise_m_s,
        attitude_noise_rad: factor * sensors.attitude_noise_rad,
        gyro: imu(sensors.gyro),
        accelerometer: imu(sensors.accelerometer),
        ..sensors
    }
}
