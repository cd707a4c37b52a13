//! One flight of a case: the simulated vehicle and the ground station run in lockstep, over the
//! bytes of a link with delays, into a telemetry log.

use std::collections::VecDeque;

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::AttitudeSetpoint;
use sitl::autopilot::{LinkKind, Peer, Vehicle, VehicleRefused};
use sitl::config::SitlConfig;
use vehicle::effects::EffectSet;
use vehicle::foreign::Foreign;
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleParams};
use wire::Frame;
use wire::tlog::Writer;

use super::ground::{Ground, GroundError, Rates};
use super::motion::Motion;

/// Hover before the log begins, s.
const SETTLING_S: f64 = 2.0;
/// Time of the request for OFFBOARD, us.
const ENGAGE_US: u64 = 300_000;
/// Period of the ground station's heartbeats, us.
const HEARTBEAT_US: u64 = 1_000_000;
/// Period of the track, us.
const TRACK_US: u64 = 1_000;
/// The ground's clock when the vehicle boots: 2026-01-01 00:00 UTC, us. The date is arbitrary.
const EPOCH_US: f64 = 1_767_225_600e6;
/// Limits of tilt and of distance from the motion, rad and m: beyond either, a flight is lost.
const LOST_TILT: f64 = 1.3;
const LOST_DISTANCE_M: f64 = 4.0;
const STATION: Peer = Peer(0);

/// The link between vehicle and ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Least delay from the vehicle to the ground, s.
    pub delay_s: f64,
    /// Mean of the exponential delay beyond it, s.
    pub jitter_s: f64,
    /// Offset of the ground's clock, s; positive if it is ahead.
    pub offset_s: f64,
    /// Relative rate error of the ground's clock; positive if it is fast.
    pub skew: f64,
}

/// A flight to simulate.
#[derive(Clone, Debug)]
pub struct Sortie<'a> {
    /// The vehicle as the firmware and the ground station know it, its loop included.
    pub believed: &'a VehicleParams,
    /// The vehicle's real numbers.
    pub body: &'a VehicleParams,
    /// Effects beyond those numbers.
    pub effects: &'a EffectSet,
    /// Effects outside the catalogue.
    pub foreign: &'a [Foreign],
    /// Pack, sensors and start, whose position comes from the motion.
    pub config: SitlConfig,
    /// Requested rates of the streams.
    pub rates: Rates,
    /// The link between vehicle and ground.
    pub link: Link,
    /// The motion to fly.
    pub motion: &'a Motion,
    /// Length of the log, s.
    pub seconds: f64,
    /// Seed of noise, gusts and delays.
    pub seed: u64,
}

/// The true course of a flight, every millisecond of the log.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// The vehicle's time at the first state, us.
    pub start_us: u64,
    /// True states.
    pub states: Vec<State>,
    /// Motor outputs in force, 0..1.
    pub outputs: Vec<[f64; ROTORS]>,
    /// Terminal voltage, V.
    pub voltage: Vec<f64>,
    /// Setpoints with their send times, us.
    pub setpoints: Vec<(u64, AttitudeSetpoint)>,
}

/// The result of a flight.
#[derive(Clone, Debug)]
pub struct Flown {
    /// The telemetry log.
    pub tlog: Vec<u8>,
    /// The true course.
    pub track: Track,
}

/// Reasons that a flight fails.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// The simulator rejects the vehicle.
    #[error(transparent)]
    Refused(#[from] VehicleRefused),
    /// The ground station rejects the vehicle.
    #[error(transparent)]
    Ground(#[from] GroundError),
    /// The vehicle touched the floor, turned over or flew away.
    #[error("the vehicle was lost {0:.1} s into the flight")]
    Lost(f64),
}

impl Sortie<'_> {
    /// Simulates the flight.
    ///
    /// # Errors
    /// [`FlightError`].
    pub fn fly(&self) -> Result<Flown, FlightError> {
        let mut config = self.config.clone();
        let [north, east, down, yaw] = self.motion.start();
        config.start.position_m = [north, east, down];
        config.start.heading_rad = yaw;
        let (believed, body) = (self.believed.clone(), self.body.clone());
        let mut vehicle = Vehicle::built(believed, body, self.effects.clone(), config, self.seed)?;
        for foreign in self.foreign {
            vehicle.disturb(foreign.clone(), self.seed);
        }
        let mut ground = Ground::new(self.believed)?;
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed ^ 0x11_9e);
        let mut under_way: VecDeque<(u64, Vec<u8>)> = VecDeque::new();
        let mut log = Writer::new(Vec::new());
        let mut track = Track { start_us: (SETTLING_S * 1e6) as u64, ..Track::default() };
        let end_us = track.start_us + (self.seconds * 1e6) as u64;
        vehicle.connect(STATION, LinkKind::Datagrams);
        for request in ground.requests(&self.rates) {
            vehicle.receive(STATION, &request);
        }
        let (mut heartbeat_us, mut engaged) = (0, false);
        loop {
            let now_us = vehicle.now_us();
            let recording = now_us >= track.start_us;
            // Writing to memory cannot fail.
            let mut note = |now_us: u64, bytes: &[u8]| {
                if recording {
                    let _ = log.write(self.ground_us(now_us), bytes);
                }
            };
            vehicle.take_output(|_, bytes| {
                let jitter: f64 = Exp1.sample(&mut rng);
                let delay_s = self.link.delay_s + self.link.jitter_s * jitter;
                let earliest = under_way.back().map_or(0, |(due, _)| *due);
                let due_us = (now_us + (delay_s * 1e6) as u64).max(earliest);
                under_way.push_back((due_us, bytes.to_vec()));
            });
            while under_way.front().is_some_and(|(due, _)| *due <= now_us) {
                let Some((_, bytes)) = under_way.pop_front() else { break };
                note(now_us, &bytes);
                let time = (now_us as f64 - track.start_us as f64) * 1e-6;
                let frame = Frame::parse(&bytes);
                let answer = frame.and_then(|frame| ground.receive(&frame, self.motion, time));
                if let Some((bytes, setpoint)) = answer {
                    note(now_us, &bytes);
                    vehicle.receive(STATION, &bytes);
                    track.setpoints.push((now_us, setpoint));
                }
            }
            if now_us >= heartbeat_us {
                let heartbeat = ground.heartbeat();
                note(now_us, &heartbeat);
                vehicle.receive(STATION, &heartbeat);
                heartbeat_us += HEARTBEAT_US;
            }
            if !engaged && now_us >= ENGAGE_US {
                engaged = true;
                vehicle.receive(STATION, &ground.offboard());
            }
            if recording && (now_us - track.start_us).is_multiple_of(TRACK_US) {
                self.watch(&vehicle, &mut track)?;
            }
            if now_us >= end_us {
                break;
            }
            let tick_us = (now_us / TRACK_US + 1) * TRACK_US;
            let due_us = under_way.front().map_or(tick_us, |(due, _)| *due);
            vehicle.advance_to(tick_us.min(due_us));
        }
        Ok(Flown { tlog: log.into_inner(), track })
    }

    fn watch(&self, vehicle: &Vehicle, track: &mut Track) -> Result<(), FlightError> {
        let plant = vehicle.plant();
        let state = *plant.state();
        let time = track.states.len() as f64 * TRACK_US as f64 * 1e-6;
        let away = (state.position - self.motion.sample(time).position).norm();
        let lost = plant.on_ground()
            || state.attitude.tilt() > LOST_TILT
            || away.is_nan()
            || away > LOST_DISTANCE_M;
        if lost {
            return Err(FlightError::Lost(time));
        }
        track.states.push(state);
        track.outputs.push(vehicle.flight().outputs());
        track.voltage.push(plant.voltage());
        Ok(())
    }

    /// Time of the ground's clock, us.
    fn ground_us(&self, vehicle_us: u64) -> u64 {
        let time = vehicle_us as f64 * (1.0 + self.link.skew);
        (EPOCH_US + self.link.offset_s * 1e6 + time).round() as u64
    }
}
