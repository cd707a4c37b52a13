//! The effects' equations against flights of vehicles that have them.
//!
//! The practice flights come from a simulation that shares no code with this one. From many
//! instants of a flight, the plant predicts half a second from the reported state and the logged
//! motor outputs. With the vehicle's true effects, the prediction error must match the noise;
//! without them it is larger.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use crate::common::practice_folders;
use serde::Deserialize;
use vehicle::VehicleParams;
use vehicle::effects::{AttitudeTrim, EffectId, EffectSet, EstimatorLatency, ParameterValue};
use vehicle::frame::{Attitude, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;
use wire::Decoder;
use wire::dialect::MavMessage;
use wire::tlog::Reader;

/// Length of a prediction in ms: position and attitude are reported together every 40 ms.
const HORIZON_MS: u32 = 520;
/// Least time between the starts of predictions in ms.
const SPACING_MS: u32 = 900;
/// How far rotors and latency may reach back before the log's start, in ms.
const MARGIN_MS: u32 = 300;
/// The least factor by which the true effects reduce the nominal vehicle's error where they show.
const GAIN: f64 = 1.5;
/// Rotors forget their states within this many time constants.
const LAG_MEMORY: f64 = 5.0;

#[derive(Deserialize)]
struct Key {
    cases: BTreeMap<String, Case>,
}

#[derive(Deserialize)]
struct Case {
    verdict: String,
    effects: Vec<TrueEffect>,
    snr: SignalToNoise,
}

#[derive(Deserialize)]
struct TrueEffect {
    id: String,
    parameters: BTreeMap<String, ParameterValue>,
}

#[derive(Deserialize)]
struct SignalToNoise {
    ratio: f64,
    noise: BTreeMap<String, f64>,
}

impl Case {
    fn truth(&self) -> EffectSet {
        let mut set = EffectSet::new();
        for effect in &self.effects {
            let parameters = effect.parameters.iter().map(|(name, value)| (name.as_str(), value));
            set.insert_named(effect.id.parse().unwrap(), parameters).unwrap();
        }
        set
    }
}

/// Samples over vehicle time (s), interpolated linearly.
struct Series<const N: usize>(Vec<(f64, [f64; N])>);

impl<const N: usize> Series<N> {
    /// The value at `time`; beyond the ends, the nearest sample.
    fn at(&self, time: f64) -> [f64; N] {
        let after = self.0.partition_point(|(stamp, _)| *stamp <= time);
        let (before, after) = (after.saturating_sub(1), after.min(self.0.len() - 1));
        let ((t0, a), (t1, b)) = (self.0[before], self.0[after]);
        let share = if t1 > t0 { (time - t0) / (t1 - t0) } else { 0.0 };
        std::array::from_fn(|i| a[i] + (b[i] - a[i]) * share)
    }
}

/// The pose that the vehicle reported at one timestamp.
#[derive(Clone, Copy)]
struct Report {
    position: Ned,
    velocity: Ned,
    attitude: Attitude,
}

/// Of the two quaternions of a rotation, the one closer to `last`, for interpolation.
fn nearer(Attitude { w, x, y, z }: Attitude, last: Option<[f64; 4]>) -> [f64; 4] {
    let q = [w, x, y, z];
    let product: f64 = q.iter().zip(last.unwrap_or(q)).map(|(a, b)| a * b).sum();
    if product < 0.0 { q.map(|c| -c) } else { q }
}

/// The contents of a flight log, on the vehicle's clock.
struct Flight {
    /// By stamp in ms, where position and attitude were reported together.
    reports: BTreeMap<u32, Report>,
    /// Stamps from which predictions start.
    starts: Vec<u32>,
    attitude: Series<4>,
    body_rate: Series<3>,
    outputs: Series<4>,
    voltage: Series<1>,
}

impl Flight {
    fn read(path: &Path) -> Self {
        let mut log = Reader::new(File::open(path).unwrap());
        let mut decoder = Decoder::new();
        let (mut positions, mut attitudes) = (BTreeMap::new(), BTreeMap::new());
        let (mut attitude, mut body_rate) = (vec![], vec![]);
        let (mut outputs, mut voltage) = (vec![], vec![]);
        // Battery messages carry no vehicle timestamp: they take that of the last message that
        // does.
        let mut now = 0.0;
        while let Some(entry) = log.read().unwrap() {
            decoder.push(&entry.frame);
            let Some(message) = decoder.next_frame().and_then(|frame| frame.message().ok()) else {
                continue;
            };
            match message {
                MavMessage::LOCAL_POSITION_NED(m) => {
                    let position = [m.x, m.y, m.z].map(f64::from).into();
                    let velocity = [m.vx, m.vy, m.vz].map(f64::from).into();
                    positions.insert(m.time_boot_ms, (position, velocity));
                }
                MavMessage::ATTITUDE_QUATERNION(m) => {
                    let reported = Attitude::from_wire([m.q1, m.q2, m.q3, m.q4]).unwrap();
                    attitudes.insert(m.time_boot_ms, reported);
                    now = f64::from(m.time_boot_ms) * 1e-3;
                    attitude.push((now, nearer(reported, attitude.last().map(|(_, q)| *q))));
                    body_rate.push((now, [m.rollspeed, m.pitchspeed, m.yawspeed].map(f64::from)));
                }
                MavMessage::ACTUATOR_OUTPUT_STATUS(m) => {
                    let values = std::array::from_fn(|i| f64::from(m.actuator[i]));
                    outputs.push((m.time_usec as f64 * 1e-6, values));
                }
                MavMessage::BATTERY_STATUS(m) if now > 0.0 => {
                    let cells = m.voltages.iter().filter(|&&cell| cell != u16::MAX);
                    voltage.push((now, [cells.map(|&cell| f64::from(cell) * 1e-3).sum()]));
                }
                _ => {}
            }
        }
        let reports: BTreeMap<_, _> = positions
            .into_iter()
            .filter_map(|(stamp, (position, velocity))| {
                let attitude = *attitudes.get(&stamp)?;
                Some((stamp, Report { position, velocity, attitude }))
            })
            .collect();
        Self {
            starts: starts(&reports),
            reports,
            attitude: Series(attitude),
            body_rate: Series(body_rate),
            outputs: Series(outputs),
            voltage: Series(voltage),
        }
    }

    /// The reported attitude between its samples.
    fn attitude_at(&self, time: f64) -> Attitude {
        let [w, x, y, z] = self.attitude.at(time);
        Attitude { w, x, y, z }.normalized()
    }
}

/// Stamps (ms) from which predictions start, away from the log's ends.
fn starts(reports: &BTreeMap<u32, Report>) -> Vec<u32> {
    let mut starts = vec![];
    let mut next = reports.keys().next().map_or(0, |first| first + MARGIN_MS);
    for &stamp in reports.keys() {
        if stamp >= next && reports.contains_key(&(stamp + HORIZON_MS)) {
            starts.push(stamp);
            next = stamp + SPACING_MS;
        }
    }
    starts
}

/// A vehicle to predict with.
struct Model {
    plant: Plant,
    trim: Attitude,
    latency: f64,
}

impl Model {
    fn new(vehicle: &VehicleParams, effects: &EffectSet) -> Self {
        let effects_of_reports = vehicle.modelled_effects.overlay(effects);
        let trim = effects_of_reports.get::<AttitudeTrim>();
        let latency = effects_of_reports.get::<EstimatorLatency>();
        Self {
            plant: Plant::new(vehicle, effects, &Setup::default(), 0).unwrap(),
            trim: trim.map_or(Attitude::default(), |trim| trim.rotation()),
            latency: latency.map_or(0.0, |effect| effect.latency_s),
        }
    }

    /// Errors of the report predicted [`HORIZON_MS`] after `start` (ms).
    ///
    /// Latency and trim are removed at the start and applied again at the end; the rotors lag
    /// behind the logged outputs. The body rotates according to the outputs or, if `guided`,
    /// according to the log, which tests forces alone.
    fn error(&self, flight: &Flight, start: u32, guided: bool) -> [f64; 3] {
        let report = flight.reports[&start];
        let end = flight.reports[&(start + HORIZON_MS)];
        let start = f64::from(start) * 1e-3 - self.latency;
        let true_attitude = |reported: Attitude| reported.compose(self.trim.inverse());
        let mut plant = self.plant.clone();
        let memory = LAG_MEMORY * plant.physics().constants().motor_time_constant;
        let before = (memory / Plant::STEP).ceil() as u32;
        let time = |step: u32| start + (f64::from(step) - f64::from(before)) * Plant::STEP;
        plant.set_rotor_states(flight.outputs.at(time(0)));
        for step in 0..before + HORIZON_MS {
            let time = time(step);
            if step == before {
                plant.set_state(State {
                    position: report.position,
                    velocity: report.velocity,
                    attitude: true_attitude(report.attitude),
                    body_rate: flight.body_rate.at(time).into(),
                });
            } else if guided {
                plant.set_state(State {
                    attitude: true_attitude(flight.attitude_at(time + self.latency)),
                    body_rate: flight.body_rate.at(time).into(),
                    ..*plant.state()
                });
            }
            plant.hold_voltage(flight.voltage.at(time)[0]);
            plant.step(flight.outputs.at(time));
        }
        let State { position, velocity, attitude, .. } = *plant.state();
        [
            (position - end.position).norm(),
            (velocity - end.velocity).norm(),
            attitude.compose(self.trim).angle_to(end.attitude),
        ]
    }

    /// RMS errors over the predictions of `flights`.
    fn errors(&self, flights: &[Flight]) -> Errors {
        let root_mean_square = |guided: bool| {
            let (mut sums, mut count) = ([0.0; 3], 0.0);
            for flight in flights {
                for &start in &flight.starts {
                    for (sum, error) in sums.iter_mut().zip(self.error(flight, start, guided)) {
                        *sum += error * error;
                    }
                    count += 1.0;
                }
            }
            sums.map(|sum| (sum / count).sqrt())
        };
        let [position, velocity, _] = root_mean_square(true);
        let [_, _, attitude] = root_mean_square(false);
        Errors { position, velocity, attitude }
    }
}

/// RMS errors of predictions over [`HORIZON_MS`].
#[derive(Clone, Copy)]
struct Errors {
    /// Position in m, the body rotating according to the log.
    position: f64,
    /// Velocity in m/s, the body rotating according to the log.
    velocity: f64,
    /// Attitude in rad, the body rotating according to the outputs.
    attitude: f64,
}

/// Which motion reveals an effect if the outputs are known.
enum Shows {
    Velocity,
    Attitude,
    Both,
    /// It acts before the outputs.
    Nowhere,
}

fn shows(effect: EffectId) -> Shows {
    use EffectId::*;
    match effect {
        PdGain | CommandDelay => Shows::Nowhere,
        Inertia | ComOffset | YawTorque | RotorGyroscopic => Shows::Attitude,
        RotorLoss | BladeFlapping | MotorLag | EstimatorLatency => Shows::Both,
        _ => Shows::Velocity,
    }
}

/// With the true effects, velocity and position errors match the noise of the reports. Attitude
/// errors exceed it: the loop's 250 outputs a second are logged at 100 Hz, in step with the
/// setpoints, so changes in between are lost.
#[test]
fn true_effects_explain_the_practice_flights() {
    let folder = practice_folders().swap_remove(0);
    let Ok(key) = std::fs::read_to_string(folder.join("key.json")) else {
        eprintln!("skipped: no practice flights; set DOWNWASH_PRACTICE to their folder");
        return;
    };
    let key: Key = serde_json::from_str(&key).unwrap();
    println!("RMS errors after {HORIZON_MS} ms, nominal / with the true effects");
    for (name, case) in &key.cases {
        let vehicle = VehicleParams::load(folder.join(name).join("vehicle.json")).unwrap();
        let flights: Vec<_> = (1..=4)
            .map(|number| Flight::read(&folder.join(name).join(format!("flight_{number}.tlog"))))
            .collect();
        let truth = case.truth();
        let found = Model::new(&vehicle, &truth).errors(&flights);
        let nominal = Model::new(&vehicle, &EffectSet::new()).errors(&flights);
        let ids: Vec<_> = case.effects.iter().map(|effect| effect.id.as_str()).collect();
        let column = |of: fn(&Errors) -> f64| format!("{:.4} / {:.4}", of(&nominal), of(&found));
        println!(
            "{name} {:7} {:24}  {} m  {} m/s  {} rad",
            case.verdict,
            ids.join(" + "),
            column(|e| e.position),
            column(|e| e.velocity),
            column(|e| e.attitude),
        );

        let noise = |channel: &str| case.snr.noise[channel];
        if case.verdict == "unknown" {
            assert!(found.velocity > 2.0 * noise("vel_0.5"), "{name}: nothing is left unexplained");
            continue;
        }
        assert!(found.velocity < 1.2 * noise("vel_0.5"), "{name}: more than noise in velocity");
        assert!(found.position < 1.2 * noise("pos_0.5"), "{name}: more than noise in position");
        assert!(found.attitude < 1.05 * nominal.attitude, "{name}: attitude is worse");
        let is_strong = case.snr.ratio > 1.0;
        for shown in truth.iter().filter(|_| is_strong).map(|(id, _)| shows(id)) {
            if matches!(shown, Shows::Velocity | Shows::Both) {
                assert!(nominal.velocity > GAIN * found.velocity, "{name}: velocity is no better");
            }
            if matches!(shown, Shows::Attitude | Shows::Both) {
                assert!(nominal.attitude > GAIN * found.attitude, "{name}: attitude is no better");
            }
        }
    }
}
