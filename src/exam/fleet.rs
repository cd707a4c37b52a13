//! Cases for the diagnosis of a fleet: vehicles of one type that share an effect or none, some with
//! an effect of their own.

use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

use super::attempts::CaseError;
use super::bench::{Bench, Truth};
use super::draw::Draw;
use super::flight::FlightError;
use super::order::{Kind, Order, Settings};
use super::world::{FileKind, LoopKind};

/// Most draws for a type, and for a vehicle.
const ATTEMPTS: u64 = 8;
/// Ratios over noise with exact files, and sizes relative to the practical one.
const RATIOS: [f64; 2] = [3.0, 12.0];
const SIZES: [f64; 2] = [1.15, 5.0];
/// Effects of the weather, which belong to no vehicle.
const WEATHER: [EffectId; 2] = [EffectId::Wind, EffectId::Gusts];

/// A vehicle of a fleet.
#[derive(Clone, Debug)]
pub struct FleetVehicle {
    /// Its logs.
    pub logs: Vec<Vec<u8>>,
    /// The vehicle's own effect, if any.
    pub own: Option<EffectId>,
}

/// A fleet with its flown logs.
#[derive(Clone, Debug)]
pub struct FleetCase {
    /// The file of the type.
    pub nominal: VehicleParams,
    /// The effect that every vehicle has, if any.
    pub shared: Option<EffectSet>,
    /// The vehicles.
    pub vehicles: Vec<FleetVehicle>,
    /// Quality of the file.
    pub file: FileKind,
    /// The loop on board.
    pub on_board: LoopKind,
}

/// The composition of a fleet.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Number of vehicles.
    pub vehicles: usize,
    /// Share of the vehicles with an effect of their own.
    pub damaged: f64,
    /// Whether all vehicles share an effect.
    pub shares: bool,
}

impl FleetCase {
    /// Draws and flies case `number` of the exam with this seed.
    ///
    /// # Errors
    /// [`CaseError`].
    pub fn fly(
        settings: &Settings,
        seed: u64,
        number: u64,
        shape: &Shape,
    ) -> Result<Self, CaseError> {
        let mut last = FlightError::Lost(0.0);
        for attempt in 0..ATTEMPTS {
            let mut draw = Draw::new(seed, number * ATTEMPTS + attempt + 1);
            let name = format!("type_{number:03}");
            let bench = Bench::draw(&mut draw, settings, &name, &Order::from(Kind::Null))?;
            match Self::of(&bench, &mut draw, shape) {
                Ok(case) => return Ok(case),
                Err(error) => last = error,
            }
        }
        Err(CaseError::Unflyable(last))
    }

    fn of(bench: &Bench, draw: &mut Draw, shape: &Shape) -> Result<Self, FlightError> {
        let target = bench.measure(RATIOS, SIZES);
        let is_build = |effect: EffectId| !WEATHER.contains(&effect);
        let shared = if shape.shares {
            let effect = bench.effect(draw, is_build);
            Some(bench.sized_effect(draw, &bench.baseline()?, effect, target)?.0)
        } else {
            None
        };
        let count = (shape.damaged * shape.vehicles as f64).round() as usize;
        let mut damaged: Vec<bool> = (0..shape.vehicles).map(|v| v < count).collect();
        draw.shuffle(&mut damaged);
        let mut vehicles = Vec::with_capacity(shape.vehicles);
        for is_damaged in damaged {
            let mut flown = Err(FlightError::Lost(0.0));
            for _ in 0..ATTEMPTS {
                let sibling = bench.sibling(draw);
                flown = Self::vehicle(&sibling, draw, shared.as_ref(), is_damaged);
                if flown.is_ok() {
                    break;
                }
            }
            vehicles.push(flown?);
        }
        let (file, on_board) = (bench.setting.file, bench.setting.on_board);
        Ok(Self { nominal: bench.nominal.clone(), shared, vehicles, file, on_board })
    }

    fn vehicle(
        bench: &Bench,
        draw: &mut Draw,
        shared: Option<&EffectSet>,
        is_damaged: bool,
    ) -> Result<FleetVehicle, FlightError> {
        let class = shared.and_then(|set| Some(set.iter().next()?.0.class()));
        let mut effects = shared.cloned().unwrap_or_default();
        let mut own = None;
        if is_damaged {
            let effect = bench
                .effect(draw, |effect| !WEATHER.contains(&effect) && Some(effect.class()) != class);
            let target = bench.measure(RATIOS, SIZES);
            let (sized, _) = bench.sized_effect(draw, &bench.baseline()?, effect, target)?;
            effects = effects.overlay(&sized);
            own = Some(effect);
        }
        Ok(FleetVehicle { logs: bench.logs(&Truth::from(effects))?, own })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exam::world::World;

    #[test]
    fn fleet_matches_its_request_and_is_reproducible() {
        let settings =
            Settings { flights: 1, seconds: 12.0, world: World::Builders, ..Settings::default() };
        let shape = Shape { vehicles: 3, damaged: 0.34, shares: true };
        let fly = || FleetCase::fly(&settings, 5, 0, &shape).expect("a fleet");
        let case = fly();
        assert_eq!(case.vehicles.iter().filter(|v| v.own.is_some()).count(), 1);
        let shared = case.shared.as_ref().and_then(|set| set.iter().next()).map(|(id, _)| id);
        assert!(shared.is_some_and(|id| !WEATHER.contains(&id)));
        assert!(case.vehicles.iter().all(|v| v.own.is_none_or(|id| Some(id) != shared)));
        assert_ne!(case.vehicles[0].logs, case.vehicles[1].logs);
        assert_eq!(case.vehicles[2].logs, fly().vehicles[2].logs);
    }
}
