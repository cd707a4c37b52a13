//! The bench of a case: a vehicle, its sensors, its link and the motions. `truth` holds what the
//! vehicle has beyond its file, `drawn` chooses it, `size` measures how strongly it shows, and
//! `answer_key` writes the right answer. A `sibling` is another vehicle of the type.

mod answer_key;
mod drawn;
mod sibling;
mod size;
mod truth;

use sitl::config::{EstimatorConfig, ImuNoise, SensorConfig, SitlConfig, Vibration};
use vehicle::effects::{EffectId, EffectSet};
use vehicle::foreign::Foreign;
use vehicle::{VehicleError, VehicleParams};

pub(super) use self::truth::Truth;
use super::airframe;
use super::case::Case;
use super::condition::Condition;
use super::deviations::Deviations;
use super::direction::Direction;
use super::draw::Draw;
use super::flight::{FlightError, Link, Sortie, Track};
use super::ground::Rates;
use super::motion::Motion;
use super::order::{Kind, Order, Settings};
use super::programme::{Restriction, Vigour, programme};
use super::trap::{STEADY_PACK, TRAPS, Trap};
use super::world::{self, FileKind, Setting, World};
use crate::diagnose::likelihood::noise::ReportNoise;

/// Rotor frequency at full speed where the file does not state it, Hz.
const ROTOR_MAX_HZ: f64 = 150.0;
/// Effects that depend on the velocity relative to the air.
const DRAGS: [EffectId; 2] = [EffectId::RotorDrag, EffectId::ParasiticDrag];
/// Effects that act through a drag.
const NEED_DRAG: [EffectId; 2] = [EffectId::Wind, EffectId::Gusts];

/// The real vehicle with a truth.
struct RealVehicle {
    body: VehicleParams,
    effects: EffectSet,
    foreign: Vec<Foreign>,
}

/// A case without its truth.
pub(super) struct Bench {
    /// The vehicle file.
    pub nominal: VehicleParams,
    /// The vehicle file with the loop that is on board.
    pub believed: VehicleParams,
    /// Differences of the vehicle from its file.
    pub deviations: Deviations,
    pub setting: Setting,
    pub world: World,
    /// Pack and sensors of each flight.
    pub configs: Vec<SitlConfig>,
    rates: Rates,
    link: Link,
    motions: Vec<Motion>,
    seconds: f64,
    pub ratios: [f64; 2],
    pub seed: u64,
    notes: Vec<String>,
    trap: Option<&'static Trap>,
}

impl Bench {
    /// Draws everything about a case except its truth.
    pub(super) fn draw(
        draw: &mut Draw,
        settings: &Settings,
        name: &str,
        order: &Order,
    ) -> Result<Self, VehicleError> {
        let mut nominal = airframe::vehicle(draw, name);
        let mut notes = Vec::new();
        if let Some(trip) = &order.round_trip {
            nominal = VehicleParams { name: name.to_owned(), ..trip.vehicle.clone() };
        }
        let is_free = order.round_trip.is_none();
        let trap = (order.kind == Kind::Trap).then(|| &TRAPS[draw.below(TRAPS.len())]);
        if let Some(drag) = model_drag(draw, &mut nominal, order, trap) {
            notes.push(format!("the vehicle file models {drag}"));
        }
        nominal = nominal.checked()?;
        let outputs_hz = if draw.chance(0.2) { 250.0 } else { 100.0 };
        let setting = match settings.world {
            World::Builders if is_free => {
                let full_hz = nominal.rotor_max_rpm.map_or(ROTOR_MAX_HZ, |rpm| rpm / 60.0);
                Setting::draw(draw, full_hz)
            }
            _ => Setting::exact(outputs_hz),
        };
        notes.extend(setting.notes());
        let mut believed = nominal.clone();
        if let (false, Some(pd)) = (setting.on_board.is_known(), nominal.attitude_pd) {
            believed.attitude_cascade = Some(world::cascade(draw, &nominal, &pd));
            believed.attitude_pd = None;
            nominal.attitude_pd = None;
        }
        let deviations = match setting.file {
            FileKind::Exact => Deviations::none(&nominal),
            FileKind::Claimed | FileKind::Unclaimed => Deviations::draw(draw, &nominal),
        };
        if setting.file == FileKind::Claimed {
            nominal.provenance = deviations.tolerances.provenance();
        }
        let noise = if draw.chance(0.15) {
            notes.push("noisy sensors".to_owned());
            draw.within([2.0, 4.0])
        } else {
            draw.within([0.7, 1.4])
        };
        let mut sensors = noisier(SensorConfig::default(), noise);
        if let Some(time_s) = setting.attitude_correlation_s {
            sensors.attitude_correlation_s = time_s;
        }
        let rates = rates(draw, &setting, trap);
        let link = setting.link(Link {
            delay_s: 1.5e-3,
            jitter_s: draw.within([0.8e-3, 1.5e-3]),
            offset_s: draw.within([-1e4, 1e4]),
            skew: draw.within([-2e-5, 2e-5]),
        });
        let vigour = Vigour::draw(draw, nominal.rotor_radius_m);
        let restriction = trap.map_or(Restriction::None, |trap| trap.restriction);
        let motions = programme(draw, &vigour, restriction, settings.flights, settings.seconds);
        let configs = motions.iter().map(|_| config(draw, &setting, sensors, trap)).collect();
        Ok(Self {
            nominal,
            believed,
            deviations,
            setting,
            world: if is_free { settings.world } else { World::Exact },
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

    /// Differences from the file that remain beside a truth.
    pub(super) fn deviations_beside(&self, truth: &Truth) -> Deviations {
        self.deviations.beside(&truth.effects, truth.causes, truth.rotor)
    }

    fn real(&self, truth: &Truth) -> RealVehicle {
        let deviations = self.deviations_beside(truth);
        RealVehicle {
            body: deviations.body(&self.believed),
            effects: deviations.effects().overlay(&truth.effects),
            foreign: deviations.foreign().into_iter().chain(&truth.foreign).cloned().collect(),
        }
    }

    fn sorties<'a>(&'a self, real: &'a RealVehicle) -> impl Iterator<Item = Sortie<'a>> {
        self.motions.iter().zip(&self.configs).enumerate().map(move |(number, flight)| {
            let (motion, config) = flight;
            Sortie {
                believed: &self.believed,
                body: &real.body,
                effects: &real.effects,
                foreign: &real.foreign,
                config: config.clone(),
                rates: self.rates,
                link: self.link,
                motion,
                seconds: self.seconds,
                seed: self.seed ^ (number as u64 + 1),
            }
        })
    }

    /// True courses of all flights of a vehicle with this truth and ideal sensors.
    pub(super) fn tracks(&self, truth: &Truth) -> Result<Vec<Track>, FlightError> {
        let real = self.real(truth);
        self.sorties(&real).map(|sortie| Ok(ideal(sortie).fly()?.track)).collect()
    }

    /// Adds `count` flights of another programme after the others.
    pub(super) fn add_flights(&mut self, draw: &mut Draw, count: usize) {
        let vigour = Vigour::draw(draw, self.nominal.rotor_radius_m);
        self.motions.extend(programme(draw, &vigour, Restriction::None, count, self.seconds));
        let more = self.configs.iter().cycle().take(count).cloned().map(|mut config| {
            config.battery.charge = draw.within([0.45, 1.0]);
            config
        });
        let more: Vec<SitlConfig> = more.collect();
        self.configs.extend(more);
    }

    /// Logs of all flights of a vehicle with this truth.
    pub(super) fn logs(&self, truth: &Truth) -> Result<Vec<Vec<u8>>, FlightError> {
        self.logs_in(truth, Condition::Plain)
    }

    fn logs_in(&self, truth: &Truth, condition: Condition) -> Result<Vec<Vec<u8>>, FlightError> {
        let real = self.real(truth);
        let log = |sortie: Sortie<'_>| {
            let tlog = condition.apply(&sortie.fly()?.tlog, sortie.seed);
            Ok(self.setting.logged(tlog, sortie.seed))
        };
        self.sorties(&real).map(log).collect()
    }

    /// Noise of the reported state.
    pub(super) fn noise(&self) -> ReportNoise {
        let sensors = self.configs[0].sensors;
        ReportNoise {
            position: sensors.position_noise_m,
            velocity: sensors.velocity_noise_m_s,
            attitude: sensors.attitude_noise_rad,
            body_rate: sensors.gyro.noise,
            specific_force: sensors.accelerometer.noise,
        }
    }

    /// The file with the vehicle's numbers, lacking only the truth.
    pub(super) fn known(&self, truth: &Truth) -> VehicleParams {
        let beside = self.deviations_beside(truth);
        let mut known = beside.body(&self.nominal);
        known.modelled_effects = known.modelled_effects.overlay(&beside.effects());
        known
    }

    /// Flies the case with a truth according to `order`.
    pub(super) fn case(self, draw: &mut Draw, order: &Order) -> Result<Case, FlightError> {
        let drawn = self.truth(draw, order)?;
        let condition = order.round_trip.as_ref().map_or(Condition::Plain, |trip| trip.condition);
        let logs = self.logs_in(&drawn.truth, condition)?;
        let key = self.key(order.kind, condition, &drawn);
        let (noise, known) = (self.noise(), self.known(&drawn.truth));
        let truth = match drawn.truth.foreign {
            Some(_) => EffectSet::new(),
            None => drawn.truth.effects,
        };
        Ok(Case { nominal: self.nominal, known, logs, truth, noise, key })
    }

    pub(super) fn has_drag(&self) -> bool {
        DRAGS.iter().any(|drag| self.nominal.modelled_effects.contains(*drag))
    }
}

/// Gives the vehicle file a drag where the case needs one, and else in a fifth of the cases that
/// are free; returns the drag.
fn model_drag(
    draw: &mut Draw,
    nominal: &mut VehicleParams,
    order: &Order,
    trap: Option<&Trap>,
) -> Option<EffectId> {
    let must = order.kind == Kind::Modelled || trap.is_some_and(|trap| trap.models_drag);
    let lacks = order.round_trip.as_ref().is_some_and(|trip| {
        NEED_DRAG.contains(&trip.effect)
            && !DRAGS.iter().any(|drag| nominal.modelled_effects.contains(*drag))
    });
    let is_free = order.round_trip.is_none();
    if !(must || lacks || is_free && draw.chance(0.2)) {
        return None;
    }
    let drag = if draw.chance(0.7) { DRAGS[0] } else { DRAGS[1] };
    let size = draw.within([0.15, 0.5]);
    nominal.modelled_effects = Direction::draw(draw, nominal, drag).at(size);
    Some(drag)
}

/// The rates of the reports.
fn rates(draw: &mut Draw, setting: &Setting, trap: Option<&Trap>) -> Rates {
    Rates {
        attitude: if draw.chance(0.5) { 250.0 } else { 125.0 },
        imu: match draw.chance(0.3) {
            _ if trap.is_some_and(|trap| !trap.has_imu) => 0.0,
            true => 250.0,
            false => 100.0,
        },
        position: 100.0,
        outputs: setting.outputs_hz,
        battery: 5.0,
        rpm: if draw.chance(0.4) { 50.0 } else { 0.0 },
    }
}

/// Pack and sensors of a flight.
fn config(
    draw: &mut Draw,
    setting: &Setting,
    sensors: SensorConfig,
    trap: Option<&Trap>,
) -> SitlConfig {
    let mut config = SitlConfig {
        sensors,
        vibration: setting.vibration,
        estimator: setting.estimator,
        ..SitlConfig::default()
    };
    config.battery.charge = draw.within([0.45, 1.0]);
    if trap.is_some_and(|trap| trap.steady_pack) {
        config.battery = STEADY_PACK;
    }
    config
}

/// The same flight with ideal sensors.
fn ideal(mut sortie: Sortie<'_>) -> Sortie<'_> {
    sortie.config.sensors = SensorConfig::IDEAL;
    sortie.config.vibration = Vibration::default();
    sortie.config.estimator = EstimatorConfig::default();
    sortie
}

/// The same sensors with `factor` times the noise.
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

#[cfg(test)]
mod tests {
    use super::super::world::LoopKind;
    use super::*;
    use crate::exam::condition::rewritten;
    use crate::exam::draw::rounded;
    use mavlink::MessageData;
    use vehicle::effects::ParameterValue;
    use vehicle::plant::Plant;
    use wire::dialect::SET_ATTITUDE_TARGET_DATA;

    const SETTINGS: Settings =
        Settings { flights: 1, seconds: 15.0, ratios: [1.0, 10.0], world: World::Builders };

    fn bench(number: u64) -> Bench {
        let order = Order::from(Kind::Single);
        Bench::draw(&mut Draw::new(3, number), &SETTINGS, "quad", &order).expect("a bench")
    }

    #[test]
    fn flown_vehicle_matches_the_key() {
        let (count, mut lost) = (24, 0);
        for number in 0..count {
            let bench = bench(number);
            let mut effects = EffectSet::new();
            let mass = rounded(1.15 * bench.nominal.mass);
            effects.insert_argument(&format!("mass:mass_kg={mass}")).expect("an effect");
            let truth = Truth::from(effects);
            let real = bench.real(&truth);
            let config = SitlConfig::default();
            let plant = Plant::new(&real.body, &real.effects, &config.plant(), 1).expect("a plant");
            assert_eq!(plant.physics().constants().mass, mass);
            let listed = bench.deviations_beside(&truth).listed(&bench.nominal);
            assert_eq!(listed.is_empty(), bench.setting.file == FileKind::Exact);
            for deviation in listed.iter().filter(|deviation| deviation.id == "inertia") {
                let ParameterValue::Vector(scale) = &deviation.parameters["scale"] else {
                    panic!("{deviation:?}");
                };
                let flown = plant.physics().constants().inertia;
                for axis in 0..3 {
                    let stated = scale[axis] * bench.nominal.inertia[axis];
                    assert!((flown[axis] / stated - 1.0).abs() < 1e-4);
                }
            }
            let (Ok(with), Ok(without)) = (bench.tracks(&truth), bench.tracks(&Truth::default()))
            else {
                eprintln!("{number}: lost, {:?}", bench.setting);
                lost += 1;
                continue;
            };
            let thrust = |tracks: &[Track]| tracks[0].outputs.iter().flatten().sum::<f64>();
            let more = thrust(&with) / thrust(&without);
            assert!((1.05..1.3).contains(&more), "{number}: {more}");
        }
        // A case whose flights are lost is drawn again.
        assert!(lost <= count / 3, "{lost}");
    }

    #[test]
    fn null_cases_have_no_effect_and_matching_files() {
        let mut met = std::collections::BTreeSet::new();
        for number in 0..16 {
            let case = Case::fly(&SETTINGS, 4, number, "quad", &Kind::Null.into()).expect("a case");
            let key = &case.key;
            assert!(key.effects.is_empty() && key.foreign.is_none() && case.truth.is_empty());
            assert_eq!(key.verdict, "none");
            assert!(!key.is_practical);
            assert_eq!(key.deviations.is_empty(), key.file == FileKind::Exact);
            assert_eq!(case.nominal.attitude_pd.is_some(), key.on_board == LoopKind::Pd);
            assert!(case.nominal.attitude_cascade.is_none());
            assert_eq!(case.nominal.provenance.is_empty(), key.file != FileKind::Claimed);
            let mut setpoints = 0;
            rewritten(&case.logs[0], |frame| {
                setpoints += usize::from(frame.id() == SET_ATTITUDE_TARGET_DATA::ID);
                None
            });
            assert_eq!(setpoints == 0, key.on_board == LoopKind::CascadeUnlogged);
            met.insert((key.file, key.on_board));
        }
        assert!(met.len() > 4, "{met:?}");
    }

    #[test]
    fn effect_size_excludes_what_file_tolerances_explain() {
        // A thrust error of 4 % is within the tolerances of a load cell and a scale; 20 % is not.
        let exact = |number: &u64| {
            let bench = bench(*number);
            bench.setting.file == FileKind::Exact && bench.setting.on_board == LoopKind::Pd
        };
        let bench = bench((0..100).find(exact).expect("an exact file"));
        let baseline = bench.baseline().expect("a flight");
        let shown = |scale: f64| {
            let mut effects = EffectSet::new();
            effects.insert_argument(&format!("thrust_scale:scale={scale}")).expect("an effect");
            bench.truth_strength(&baseline, &effects.into()).expect("a flight")
        };
        let (small, large) = (shown(0.96), shown(0.8));
        assert!(small.beyond.ratio < 0.1 * small.strength.ratio, "{small:?}");
        assert!(large.beyond.ratio > 0.3 * large.strength.ratio, "{large:?}");
        assert!(large.beyond.ratio < large.strength.ratio);
        assert!(small.size() < 1.0 && large.size() > 1.0, "{small:?} {large:?}");
    }
}
