//! One flight with a change.

use std::path::Path;
use std::sync::Arc;

use downwash::control::ControlSettings;
use downwash::link::session;
use downwash::lockstep;
use downwash::log::record::{Record, Source};
use downwash::offboard::{EffectiveVehicle, OffboardSettings};
use downwash::plan::{ModelFreeReference, Trajectory};
use downwash::station::{End, Station, StationSettings};
use downwash::supervisor::EngagePolicy;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use sitl::autopilot::Vehicle;
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

use crate::change::Change;
use crate::feedback::Feedback;

/// Earliest time of the change along the trajectory, and the range after it, s.
const CHANGE_S: f64 = 6.0;
const SPAN_S: f64 = 1.0;
/// Length of the evaluation before and after, s.
pub const BEFORE_S: f64 = 3.0;
pub const AFTER_S: f64 = 7.0;
/// A vehicle with a larger error is lost, m.
const LOST_M: f64 = 3.0;
/// Drag over mass of a vehicle whose file has none, so that wind has an effect, 1/s.
const DRAG_PER_S: f64 = 0.25;

/// The trajectory of the flights.
#[derive(Clone, Copy, Debug)]
pub enum Course {
    Hover,
    Circle,
}

impl Course {
    pub fn name(self) -> &'static str {
        match self {
            Self::Hover => "hover",
            Self::Circle => "circle",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        [Self::Hover, Self::Circle].into_iter().find(|course| course.name() == name)
    }

    fn trajectory(self) -> Trajectory {
        let duration = CHANGE_S + SPAN_S + AFTER_S + 0.5;
        let text = match self {
            Self::Hover => {
                format!("family = \"hover\"\naltitude_m = 1.5\nduration_s = {duration:.1}\n")
            }
            Self::Circle => {
                std::fs::read_to_string(file("trajectories", "sinusoid-yaw")).expect("a trajectory")
            }
        };
        Trajectory::parse(&text, Path::new("adapt.toml")).expect("a trajectory")
    }
}

/// The random parameters of a flight.
#[derive(Clone, Copy, Debug)]
pub struct Draw {
    pub seed: u64,
    pub direction_rad: f64,
    pub rotor: usize,
    at_s: f64,
}

impl Draw {
    pub fn new(seed: u64, index: u64) -> Self {
        let seed = seed.wrapping_mul(1_000_003).wrapping_add(index);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        Self {
            seed,
            direction_rad: std::f64::consts::TAU * rng.random::<f64>(),
            rotor: rng.random_range(0..4),
            at_s: CHANGE_S + SPAN_S * rng.random::<f64>(),
        }
    }
}

/// The result of a flight.
#[derive(Clone, Debug)]
pub struct Flown {
    /// Time since the change, s, and distance from the desired position, m.
    pub errors: Vec<(f64, f64)>,
    pub is_lost: bool,
    /// Messages of the adaptation.
    pub words: Vec<String>,
}

fn file(folder: &str, name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(folder).join(format!("{name}.toml"))
}

fn settings(params: &VehicleParams, trajectory: Trajectory) -> StationSettings {
    let effective = EffectiveVehicle::new(params).expect("a vehicle that can be controlled");
    StationSettings {
        session: session::Settings {
            vehicle_has_attitude_pd: params.attitude_pd.is_some(),
            ..session::Settings::new(effective.thrust)
        },
        offboard: OffboardSettings::default(),
        control: ControlSettings::default(),
        policy: EngagePolicy::Command,
        hover: effective.hover,
        drag_kg_s: effective.drag_kg_s,
        thrust_full_n: effective.thrust_full_n,
        battery_full_v: params.battery.full_v,
        attitude_pd: params.attitude_pd,
        actuation: effective.actuation,
        reference: Arc::new(ModelFreeReference::new(trajectory, effective.hover.hover_thrust_n())),
        search_timeout_s: Some(20.0),
    }
}

/// Flies every draw; the change occurs at its time, or `since_start` of the trajectory.
pub fn fly_all(
    vehicle: &str,
    course: Course,
    change: Change,
    feedback: &Feedback,
    draws: &[Draw],
    since_start: bool,
) -> Vec<Flown> {
    let params = VehicleParams::load(file("vehicles", vehicle)).expect("a vehicle file");
    let mut effects = EffectSet::new();
    if params.modelled_effects.get::<vehicle::effects::RotorDrag>().is_none() {
        let drag = format!("rotor_drag:d_xy={},d_z=0.0", DRAG_PER_S * params.mass);
        effects.insert_argument(&drag).expect("an effect");
    }
    let mut settings = settings(&params, course.trajectory());
    feedback.set(&mut settings);
    draws
        .par_iter()
        .map(|draw| fly(&params, &effects, settings.clone(), change, draw, since_start))
        .collect()
}

fn fly(
    params: &VehicleParams,
    effects: &EffectSet,
    settings: StationSettings,
    change: Change,
    draw: &Draw,
    since_start: bool,
) -> Flown {
    let mut vehicle =
        Vehicle::new(params.clone(), effects.clone(), SitlConfig::default(), draw.seed)
            .expect("a vehicle that flies");
    let mut station = Station::new(settings, lockstep::host_time(0));
    let mut flown = Flown { errors: Vec::new(), is_lost: false, words: Vec::new() };
    let mut wanted = None;
    let log = |record: Record| match record {
        Record::Tick(tick) => {
            wanted = tick.trajectory_time.zip(tick.desired);
        }
        Record::Truth { truth, .. } => {
            if let Some((time_s, desired)) = wanted {
                let error = (truth.state.position - desired).norm();
                flown.errors.push((time_s - draw.at_s, error));
                flown.is_lost |= error > LOST_M;
            }
        }
        Record::Event { text, source: Source::Daemon, .. } if text.contains("adapt") => {
            let time_s = wanted.map_or(f64::NAN, |(time_s, _)| time_s - draw.at_s);
            flown.words.push(format!("{time_s:.2} s after: {text}"));
        }
        _ => {}
    };
    let due_s = if since_start { 0.0 } else { draw.at_s };
    let mut has_acted = false;
    let act = |vehicle: &mut Vehicle, station: &mut Station| {
        let time_s = station.status().progress.map(|(time_s, _)| time_s);
        if !has_acted && time_s.is_some_and(|time_s| time_s >= due_s) {
            has_acted = true;
            change.act(vehicle, draw);
        }
    };
    let end = lockstep::fly_disturbed(&mut vehicle, &mut station, 120.0, log, |_, _| {}, act);
    flown.is_lost |= end != Ok(End::Done) || !has_acted;
    flown
}
