//! Every effect of the catalogue acts on the simulated vehicle, in the models' physics and in the
//! equations of the diagnosis.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::lockstep::{NANO, config_file, fly, ideal, params, settings, toml_trajectory};
use downwash::diagnose::catalogue::hypothesis::Catalogue;
use downwash::diagnose::catalogue::number::Target;
use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::likelihood::column::Residuals;
use downwash::diagnose::likelihood::observed::Observed;
use downwash::diagnose::likelihood::residuals::Evaluator;
use downwash::log::import;
use downwash::log::record::Record;
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::model::{Model, Point};
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use vehicle::effects::{Chance, EffectId, EffectSet, Growth, Place};
use vehicle::frame::{Euler, Frd, Ned};

/// Along, up, and down faster than the rotors tolerate.
const COURSE: &str = "family = \"waypoints\"\npace = { speed_m_s = 1.5 }\npoints = [\
    { north_m = 0.0, east_m = 0.0, altitude_m = 1.0 },\
    { north_m = 1.0, east_m = 0.0, altitude_m = 2.5 },\
    { north_m = 2.0, east_m = 1.0, altitude_m = 1.0, hold_s = 0.5 },\
]\n";

/// The middle of every range.
struct Middle;

impl Chance for Middle {
    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        0.5 * (low + high)
    }

    fn sign(&mut self) -> f64 {
        1.0
    }

    fn below(&mut self, count: usize) -> usize {
        count / 2
    }
}

/// An effect at half of its plausible size.
fn strong(vehicle: &VehicleParams, id: EffectId) -> EffectSet {
    let mut growth = Growth::default();
    for slot in id.spec().slots() {
        growth.from[slot.index] =
            downwash::diagnose::catalogue::reference::reference(vehicle, id, slot.index);
    }
    (id.spec().strong)(vehicle, &mut Middle, &mut growth);
    let mut slots = growth.from;
    for (slot, by) in slots.iter_mut().zip(growth.by) {
        *slot += 0.5 * by;
    }
    let mut set = EffectSet::new();
    set.insert(id, slots).expect("within its range");
    set
}

#[test]
fn every_effect_moves_the_simulated_vehicle() {
    let vehicle = params(NANO);
    // A drained pack sags, and a floor is near.
    let config = || {
        let mut config: SitlConfig = ideal();
        config.battery.charge = 0.4;
        config
    };
    let states = |effects: &EffectSet| {
        let flown = VehicleParams { modelled_effects: effects.clone(), ..vehicle.clone() };
        let settings = settings(&vehicle, toml_trajectory(COURSE));
        let (_, records) = fly(settings, &flown, &[], config(), 5);
        let state = |record: &Record| match record {
            Record::Truth { truth, .. } => Some(format!("{:?}", truth.state)),
            _ => None,
        };
        records.iter().filter_map(state).collect::<Vec<_>>()
    };
    // Moving air acts through drag.
    let drag = strong(&vehicle, EffectId::RotorDrag);
    let (still, dragged) = (states(&EffectSet::new()), states(&drag));
    assert!(still.len() > 500);
    for id in EffectId::ALL {
        let is_air = matches!(id, EffectId::Wind | EffectId::Gusts);
        let effects = strong(&vehicle, id);
        let (effects, without) =
            if is_air { (drag.overlay(&effects), &dragged) } else { (effects, &still) };
        assert!(states(&effects) != *without, "{id} does nothing");
    }
}

#[test]
fn every_effect_on_forces_moves_the_models_physics() {
    let vehicle = params(NANO);
    let accelerations = |effects: EffectSet| {
        let parameters = PhysicsParameters { effects, ..PhysicsParameters::default() };
        let model = PhysicsModel::new(&vehicle, &parameters).expect("a model");
        model.accelerations(&Point {
            velocity: Ned::new(1.5, -1.0, 1.2),
            body_rate: Frd::new(0.5, -0.4, 0.3),
            attitude: Euler::new(0.1, -0.2, 0.7),
            input: [1.1 * vehicle.weight_n(), 1e-4, -1e-4, 5e-5],
        })
    };
    let nominal = accelerations(EffectSet::new());
    // A model sees no floor, and handles rotor lag separately from the accelerations.
    let beside = [EffectId::GroundEffect, EffectId::MotorLag];
    for id in EffectId::ALL.into_iter().filter(|id| id.place() != Place::Elsewhere) {
        let moved = accelerations(strong(&vehicle, id));
        let is_moved = moved.iter().zip(nominal).any(|(a, b)| (a - b).abs() > 1e-6);
        assert_eq!(is_moved, !beside.contains(&id), "{id}");
    }
}

/// A flight of the shipped nano quadrotor that moves in all directions.
fn flight() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("effects-everywhere");
    let _ = fs::remove_dir_all(&folder);
    let output = Command::new(env!("CARGO_BIN_EXE_downwash"))
        .env("XDG_CONFIG_HOME", &folder)
        .args(["collect", "--seconds", "40", "--out"])
        .arg(&folder)
        .output()
        .expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let paths = fs::read_dir(&folder).expect("the folder").map(|entry| entry.expect("it").path());
    paths.filter(|path| path.extension() == Some("mcap".as_ref())).min().expect("a log")
}

#[test]
fn every_effect_moves_the_diagnosis_equations() {
    let vehicle = VehicleParams::load(config_file("vehicles", NANO)).expect("a vehicle file");
    let flight = import::open(&flight(), None).expect("a log");
    let flights = [PreparedFlight::new(flight, &vehicle).expect("a flight")];
    let catalogue = Catalogue::new(&vehicle, true);
    let evaluator = Evaluator::new(&vehicle).observing(&flights);
    let observed = Observed::new(&flights, &evaluator, &catalogue);
    // Moving air acts through drag.
    let mut base = catalogue.references();
    let drag = catalogue.number_of(EffectId::RotorDrag, 0).expect("a number");
    base[drag] += catalogue.numbers[drag].magnitude;
    let nominal: Residuals = observed.residuals(&base).expect("a vehicle");
    let is_idle = |index: usize| {
        let (mut values, number) = (base.clone(), &catalogue.numbers[index]);
        // Up, or down if up is out of bounds.
        let [low, high] = number.bounds;
        let up = base[index] + number.magnitude;
        values[index] = if up <= high { up } else { (base[index] - number.magnitude).max(low) };
        observed.residuals(&values).expect("a vehicle") == nominal
    };
    let idle: Vec<Target> = (0..catalogue.numbers.len())
        .filter(|index| is_idle(*index))
        .map(|index| catalogue.numbers[index].target)
        .collect();
    // This flight never sinks as fast as the induced velocity.
    assert_eq!(idle, [Target::Effect(EffectId::VortexRing, 0)]);
    // The diagnosis finds gusts in the residual force, not by a fit; every other effect has
    // numbers.
    let is_there = |id: EffectId| {
        catalogue.numbers.iter().any(|number| match number.target {
            Target::Effect(of, _) => of == id,
            Target::RotorScale(_) => id == EffectId::RotorLoss,
            _ => false,
        })
    };
    let absent: Vec<EffectId> = EffectId::ALL.into_iter().filter(|id| !is_there(*id)).collect();
    assert_eq!(absent, [EffectId::Gusts]);
}
