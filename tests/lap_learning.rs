//! Laps of a course in lockstep, each planned with a model learned from the laps before. The
//! simulated vehicle has effects that its file does not describe.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use downwash::control::Limits;
use downwash::lap_learning::{Lap, LapLearner, LapSettings, Pace};
use downwash::learn::in_flight::{InFlight, Learned};
use downwash::lockstep;
use downwash::log::record::{FrameRecord, Record};
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::model::{ACCELERATIONS, Jacobian, Model, Point};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::planned::Answer;
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::receding::{RecedingReference, RecedingSettings};
use downwash::station::{End, Station, StationSettings};
use sitl::autopilot::Vehicle;
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use wire::dialect::MavMessage;
use wire::{Encoder, Frame};

use crate::lockstep::{NANO, effects, params, toml_trajectory};

/// Effects that the vehicle file does not contain.
const HIDDEN: [&str; 2] = ["rotor_drag:d_xy=0.012,d_z=0.008", "thrust_curve:a=0.25"];
/// One lap: 20 s.
const LAP: &str = "family = 'figure-8'\naltitude_m = 1.0\nduration_s = 18.0\nlength_m = 3.0\n\
                   width_m = 1.5\nperiod_s = 6.0\nclimb_m = 0.5\n";
const LAP_S: f64 = 20.0;

fn planner(params: &VehicleParams, model: Arc<dyn Model>) -> Planner {
    let vehicle = PlannedVehicle {
        body: EffectiveVehicle::new(params).expect("a vehicle").body(),
        attitude_pd: params.attitude_pd.expect("a loop"),
        limits: Limits::default(),
    };
    Planner::new(model, vehicle, PlanSettings::default()).expect("a planner")
}

/// A model whose accelerations are NaN.
struct NoNumbers;

impl Model for NoNumbers {
    fn accelerations(&self, _: &Point) -> [f64; ACCELERATIONS] {
        [f64::NAN; ACCELERATIONS]
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (_, jacobian) = PhysicsModel::new(&params(NANO), &PhysicsParameters::default())
            .expect("physics")
            .linearize(at);
        ([f64::NAN; ACCELERATIONS], jacobian)
    }
}

/// Physics for the first [`ASKED_MAX`] linearisations, then NaN.
struct Fading {
    physics: PhysicsModel,
    asked: AtomicUsize,
}

/// More than a first plan needs, fewer than the plans of one second need.
const ASKED_MAX: usize = 4000;

impl Model for Fading {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.physics.accelerations(at)
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let (mut value, jacobian) = self.physics.linearize(at);
        if self.asked.fetch_add(1, Ordering::Relaxed) > ASKED_MAX {
            value = [f64::NAN; ACCELERATIONS];
        }
        (value, jacobian)
    }
}

/// A flight in laps: its end, its laps, and the learner's events.
struct Flown {
    end: End,
    laps: Vec<Lap>,
    said: Vec<String>,
}

impl Flown {
    fn reported(&self, words: &str) -> bool {
        self.said.iter().any(|text| text.contains(words))
    }
}

/// Flies `laps`. The learner receives the records as `tampered` changes them, and plans with the
/// model that `model` returns for the learned one.
fn fly(
    laps: u32,
    mut tampered: impl FnMut(&Record) -> Option<Record>,
    model: impl Fn(&Learned) -> Arc<dyn Model> + Send + 'static,
) -> Flown {
    let params = params(NANO);
    let lap = toml_trajectory(LAP);
    let settings =
        LapSettings { lap_s: lap.duration(), laps, newest_s: 60.0, is_nominal_first: true };
    assert!((settings.lap_s - LAP_S).abs() < 0.1);
    let goal = lap.laps(laps).expect("a closed course");
    let attitude_pd = params.attitude_pd.expect("a loop");
    let nominal = PhysicsModel::new(&params, &PhysicsParameters::default()).expect("physics");
    let answer = Answer {
        delay_s: params.command_delay_s,
        lag_s: params.motor_time_constant_s,
        voltage_exponent: 0.0,
        attitude_pd,
    };
    let reference = RecedingReference::inline(
        goal.clone(),
        planner(&params, Arc::new(nominal)),
        answer,
        RecedingSettings::default().for_loop(true),
    );
    let own = params.clone();
    let planning = move |learned: &Learned| {
        let actuation = learned.actuation;
        let (delay_s, lag_s) = (actuation.delay_s, actuation.lag_s);
        let answer = Answer { delay_s, lag_s, ..answer };
        Ok((planner(&own, model(learned)), answer))
    };
    let mut learner = LapLearner::new(
        settings,
        InFlight::new(params.clone()).expect("a learner"),
        Box::new(planning),
        reference.exchange(),
        Pace::Stated(Duration::from_secs(1)),
    );
    let flight = StationSettings {
        reference: Arc::new(reference),
        ..crate::lockstep::settings(&params, goal)
    };
    let mut vehicle =
        Vehicle::new(params, effects(&HIDDEN), SitlConfig::default(), 1).expect("a vehicle");
    let mut station = Station::new(flight, lockstep::host_time(0));
    let mut said = Vec::new();
    let hear = |record: Record| {
        if let Some(record) = tampered(&record) {
            learner.on_record(&record);
        }
        while let Some(Record::Event { text, .. }) = learner.take_event() {
            said.push(text);
        }
    };
    let end = lockstep::fly(&mut vehicle, &mut station, 300.0, hear, |_, _| {}).expect("an end");
    Flown { end, laps: learner.laps().to_vec(), said }
}

fn whole(learned: &Learned) -> Arc<dyn Model> {
    Arc::new(learned.model.clone())
}

#[test]
fn lap_after_learning_tracks_the_course_better() {
    let flown = fly(2, |record| Some(record.clone()), whole);
    assert_eq!(flown.end, End::Done, "{:?}", flown.said);
    let [first, second] = &flown.laps[..] else { panic!("{:?}", flown.said) };
    assert!(second.rms_m < 0.5 * first.rms_m, "{:?}", flown.said);
    assert!(flown.reported("lap 2 now uses the model learned"), "{:?}", flown.said);
    // The stated second plus the planner's lead.
    assert!(flown.reported("first setpoint 1."), "{:?}", flown.said);
}

#[test]
#[ignore = "long: tests/run --all"]
fn each_lap_tracks_the_course_at_least_as_well() {
    let flown = fly(4, |record| Some(record.clone()), whole);
    assert_eq!(flown.end, End::Done);
    let rms: Vec<f64> = flown.laps.iter().map(|lap| lap.rms_m).collect();
    assert_eq!(rms.len(), 4);
    // Once noise limits the laps, they differ only by the noise.
    assert!(rms.windows(2).all(|pair| pair[1] < pair[0].max(0.02)), "{rms:?} {:?}", flown.said);
}

/// The motion readings are NaN.
#[test]
fn model_learned_from_nan_samples_is_discarded_in_flight() {
    let poison = |record: &Record| {
        let Record::Frame(frame) = record else { return Some(record.clone()) };
        Some(Record::Frame(poisoned(frame, f32::NAN)))
    };
    let flown = fly(2, poison, whole);
    assert_eq!(flown.end, End::Done, "{:?}", flown.said);
    assert!(flown.reported("cannot learn yet"), "{:?}", flown.said);
    assert!(!flown.reported("lap 2 now uses the model learned"), "{:?}", flown.said);
    assert_eq!(flown.laps.len(), 2);
}

/// A constant sensor error passes the check on held-out samples, but shows in the lap.
#[test]
fn model_whose_lap_strays_is_withdrawn_in_flight() {
    let wrong = |record: &Record| {
        let Record::Frame(frame) = record else { return Some(record.clone()) };
        Some(Record::Frame(poisoned(frame, 3.0)))
    };
    let flown = fly(3, wrong, whole);
    assert_eq!(flown.end, End::Done, "{:?}", flown.said);
    let [first, second, third] = &flown.laps[..] else { panic!("{:?}", flown.said) };
    assert!(flown.reported("strays further from the course"), "{:?}", flown.said);
    assert!(second.most_m > 1.5 * first.most_m, "{:?}", flown.said);
    assert!(third.rms_m < 1.2 * first.rms_m, "{:?}", flown.said);
}

#[test]
fn non_finite_model_gives_no_plan_and_flight_continues() {
    let flown = fly(2, |record| Some(record.clone()), |_| Arc::new(NoNumbers));
    assert_eq!(flown.end, End::Done, "{:?}", flown.said);
    assert!(flown.reported("no flyable plan with it"), "{:?}", flown.said);
    let [first, second] = &flown.laps[..] else { panic!("{:?}", flown.said) };
    assert!((second.rms_m / first.rms_m - 1.0).abs() < 0.1, "{:?}", flown.said);
}

#[test]
fn model_whose_later_plans_fail_is_withdrawn_in_flight() {
    let fading = |_: &Learned| -> Arc<dyn Model> {
        let physics = PhysicsModel::new(&params(NANO), &PhysicsParameters::default());
        Arc::new(Fading { physics: physics.expect("physics"), asked: AtomicUsize::new(0) })
    };
    let flown = fly(2, |record| Some(record.clone()), fading);
    assert_eq!(flown.end, End::Done, "{:?}", flown.said);
    assert!(flown.reported("lap 2 now uses the model learned"), "{:?}", flown.said);
    assert!(flown.reported("no flyable plan with it"), "{:?}", flown.said);
    let [first, second] = &flown.laps[..] else { panic!("{:?}", flown.said) };
    assert!(second.rms_m < 1.2 * first.rms_m, "{:?}", flown.said);
}

/// The frame with `value` in place of the accelerometer, gyro and velocity readings.
fn poisoned(frame: &FrameRecord, value: f32) -> FrameRecord {
    let whole = Frame::parse(frame.bytes()).expect("a frame");
    let mut message = whole.message().expect("a message");
    match &mut message {
        MavMessage::HIGHRES_IMU(imu) => {
            (imu.xacc, imu.yacc, imu.xgyro, imu.zgyro) = (value, -value, value, value);
        }
        MavMessage::ODOMETRY(pose) => pose.vx = value,
        MavMessage::LOCAL_POSITION_NED(pose) => pose.vx = value,
        _ => return *frame,
    }
    let mut encoder = Encoder::new(frame.system as u8, frame.component);
    encoder.set_sequence(frame.sequence);
    let mut bytes = Vec::new();
    assert!(encoder.encode(&message, &mut bytes));
    FrameRecord::from_bytes(frame.direction, frame.host, &bytes).expect("a frame")
}
