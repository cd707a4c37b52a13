//! A station and the simulated vehicle on one virtual clock, over a link that a test can cut, delay
//! or corrupt, and a pilot with a separate ground station.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use downwash::clock::HostTime;
use downwash::control::{Actuation, ControlSettings, HoverVehicle};
use downwash::link::attitude_target::ThrustMap;
use downwash::link::session;
use downwash::lockstep;
use downwash::log::record::{Direction, Record};
use downwash::offboard::OffboardSettings;
use downwash::plan::{ModelFreeReference, Trajectory};
use downwash::setpoint::State;
use downwash::station::{End, Station, StationSettings};
use downwash::supervisor::{EngagePolicy, FlightState};
use sitl::autopilot::{self, LinkKind, Mode, Vehicle};
use sitl::config::{SensorConfig, SitlConfig};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::physics::Physics;
use wire::dialect::*;
use wire::transport::Peer;
use wire::{Decoder, Encoder};

pub const NANO: &str = "crazyflie.toml";
pub const QUAD: &str = "quad1200.toml";
pub const VEHICLES: [&str; 2] = [NANO, QUAD];

/// Transport delay and rotor lag that both vehicles must tolerate.
pub const SLOW: [&str; 2] = ["command_delay:delay_s=0.02", "motor_lag:tau_s=0.06"];

/// The message that carries setpoints.
const SET_ATTITUDE_TARGET: u32 = 82;
/// The station's peer number for the vehicle, and the vehicle's for the station and for the pilot.
const VEHICLE: Peer = Peer::new(0);
const STATION: autopilot::Peer = autopilot::Peer(0);
const PILOT: autopilot::Peer = autopilot::Peer(1);

pub fn config_file(folder: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(folder).join(name)
}

pub fn params(name: &str) -> VehicleParams {
    VehicleParams::load(config_file("vehicles", name)).expect("a vehicle file")
}

pub fn trajectory(name: &str) -> Trajectory {
    Trajectory::load(&config_file("trajectories", name)).expect("a trajectory")
}

pub fn toml_trajectory(text: &str) -> Trajectory {
    Trajectory::parse(text, Path::new("test.toml")).expect("a trajectory")
}

/// Hovers at 1 m.
pub fn hover(seconds: f64) -> Trajectory {
    toml_trajectory(&format!("family = \"hover\"\naltitude_m = 1.0\nduration_s = {seconds:.1}\n"))
}

pub fn effects(arguments: &[&str]) -> EffectSet {
    let mut effects = EffectSet::new();
    for argument in arguments {
        effects.insert_argument(argument).expect("an effect");
    }
    effects
}

/// The daemon's settings for a vehicle file and a trajectory, with defaults.
pub fn settings(params: &VehicleParams, trajectory: Trajectory) -> StationSettings {
    let physics = Physics::new(params, &EffectSet::new()).expect("sound numbers");
    let constants = physics.constants();
    let thrust_full_n = constants.rotors.iter().map(|rotor| rotor.thrust_max).sum();
    let hover = HoverVehicle {
        mass_kg: constants.mass,
        inertia: constants.inertia,
        gravity: params.gravity,
    };
    let reference = ModelFreeReference::new(trajectory, hover.hover_thrust_n());
    StationSettings {
        session: session::Settings {
            vehicle_has_attitude_pd: params.attitude_pd.is_some(),
            ..session::Settings::new(ThrustMap::linear(thrust_full_n).expect("a thrust"))
        },
        offboard: OffboardSettings::default(),
        control: ControlSettings::default(),
        policy: EngagePolicy::Command,
        hover,
        drag_kg_s: [0.0; 2],
        thrust_full_n,
        battery_full_v: params.battery.full_v,
        attitude_pd: params.attitude_pd,
        actuation: Actuation {
            command_delay_s: params.command_delay_s,
            motor_time_constant_s: constants.motor_time_constant,
        },
        reference: Arc::new(reference),
        search_timeout_s: Some(20.0),
    }
}

/// Perfect sensors.
pub fn ideal() -> SitlConfig {
    SitlConfig { sensors: SensorConfig::IDEAL, ..SitlConfig::default() }
}

/// A whole flight: its end and all records.
pub fn fly(
    settings: StationSettings,
    params: &VehicleParams,
    effects: &[&str],
    config: SitlConfig,
    seed: u64,
) -> (End, Vec<Record>) {
    let mut vehicle = Vehicle::new(params.clone(), self::effects(effects), config, seed)
        .expect("a vehicle that flies");
    let mut station = Station::new(settings, lockstep::host_time(0));
    let mut records = Vec::new();
    let end = lockstep::fly(&mut vehicle, &mut station, 300.0, |r| records.push(r), |_, _| {})
        .expect("an end");
    (end, records)
}

/// One tracked tick: time along the trajectory, state, distance from the reference, saturation.
#[derive(Clone, Copy)]
pub struct Tracked {
    pub t: f64,
    pub state: State,
    pub error_m: f64,
    pub saturation: u32,
}

/// The ticks along the trajectory.
pub fn tracked(records: &[Record]) -> Vec<Tracked> {
    let row = |record: &Record| {
        let Record::Tick(tick) = record else { return None };
        let reference = tick.reference?;
        Some(Tracked {
            t: tick.trajectory_time?,
            state: tick.state,
            error_m: (tick.state.position - reference.position).norm(),
            saturation: tick.saturation,
        })
    };
    records.iter().filter_map(row).collect()
}

/// Root mean square and largest distance from the reference, m.
pub fn errors(records: &[Record]) -> (f64, f64) {
    let rows = tracked(records);
    let square: f64 = rows.iter().map(|row| row.error_m * row.error_m).sum();
    let largest = rows.iter().map(|row| row.error_m).fold(0.0, f64::max);
    ((square / rows.len() as f64).sqrt(), largest)
}

/// The setpoints' frames, byte by byte.
pub fn setpoint_frames(records: &[Record]) -> Vec<Vec<u8>> {
    let frame = |record: &Record| match record {
        Record::Frame(frame)
            if frame.direction == Direction::Tx && frame.message_id == SET_ATTITUDE_TARGET =>
        {
            Some(frame.bytes().to_vec())
        }
        _ => None,
    };
    records.iter().filter_map(frame).collect()
}

/// The type masks of the setpoints sent.
pub fn masks(records: &[Record]) -> Vec<u8> {
    let mut masks: Vec<u8> = records
        .iter()
        .filter_map(|record| match record {
            Record::Frame(frame) if frame.message_id == SET_ATTITUDE_TARGET => {
                let mut decoder = Decoder::new();
                decoder.push(frame.bytes());
                match decoder.next_frame()?.message().ok()? {
                    MavMessage::SET_ATTITUDE_TARGET(data) => Some(data.type_mask.bits()),
                    _ => None,
                }
            }
            _ => None,
        })
        .collect();
    masks.dedup();
    masks
}

/// Maps one frame on its way to the station to the datagrams that arrive instead.
pub type Downlink = Box<dyn FnMut(u64, &[u8]) -> Vec<Vec<u8>>>;

/// Station, vehicle, link and pilot.
pub struct Bench {
    pub vehicle: Vehicle,
    pub station: Station,
    pub records: Vec<Record>,
    /// Times at which a setpoint left the station, us of simulation.
    pub setpoints_us: Vec<u64>,
    /// What happens to frames on their way to the station.
    pub downlink: Downlink,
    /// Whether frames reach the vehicle.
    pub uplink: bool,
    /// Whether the transport takes no frames.
    pub is_jammed: bool,
    /// Simulated time before the vehicle's last boot, and now, us.
    booted_us: u64,
    simulated_us: u64,
    pilot: Encoder,
}

impl Bench {
    pub fn new(settings: StationSettings, params: &VehicleParams) -> Self {
        Self::with(settings, params, &[], SitlConfig::default())
    }

    pub fn with(
        settings: StationSettings,
        params: &VehicleParams,
        effects: &[&str],
        config: SitlConfig,
    ) -> Self {
        let vehicle = Vehicle::new(params.clone(), self::effects(effects), config, 1)
            .expect("a vehicle that flies");
        let mut bench = Self {
            vehicle,
            station: Station::new(settings, lockstep::host_time(0)),
            records: Vec::new(),
            setpoints_us: Vec::new(),
            downlink: Box::new(|_, frame| vec![frame.to_vec()]),
            uplink: true,
            is_jammed: false,
            booted_us: 0,
            simulated_us: 0,
            pilot: Encoder::new(200, 190),
        };
        bench.vehicle.connect(STATION, LinkKind::Datagrams);
        bench
    }

    /// A commanded hover of a vehicle.
    pub fn hovering(vehicle: &str, seconds: f64) -> Self {
        let params = params(vehicle);
        Self::new(settings(&params, hover(seconds)), &params)
    }

    pub fn now_us(&self) -> u64 {
        self.simulated_us
    }

    pub fn now(&self) -> HostTime {
        lockstep::EPOCH + Duration::from_micros(self.now_us())
    }

    /// One turn of the loop in `lockstep::fly`.
    fn turn(&mut self, until_us: u64) {
        let (now, now_us) = (self.now(), self.now_us());
        let Self { vehicle, station, downlink, .. } = self;
        vehicle.take_output(|peer, frame| {
            if peer == STATION {
                for datagram in downlink(now_us, frame) {
                    station.receive(now, VEHICLE, &datagram, true);
                }
            }
        });
        station.poll(now);
        self.transmit();
        self.station.take_records(|record| self.records.push(record));
        self.advance(until_us);
    }

    fn transmit(&mut self) {
        let (now, now_us) = (self.now(), self.now_us());
        let Self { vehicle, station, setpoints_us, uplink, is_jammed, .. } = self;
        station.transmit(now, |_, frame| {
            if *is_jammed {
                return false;
            }
            if message_id(frame) == Some(SET_ATTITUDE_TARGET) {
                setpoints_us.push(now_us);
            }
            if *uplink {
                vehicle.receive(STATION, frame);
            }
            true
        });
    }

    fn advance(&mut self, until_us: u64) {
        let clock = self.vehicle.clock();
        let due_us = self.booted_us + clock.host_us(self.vehicle.next_event_us());
        self.simulated_us = due_us.min(until_us).min(self.simulated_us + 20_000);
        let vehicle_us = clock.vehicle_us(self.simulated_us - self.booted_us);
        self.vehicle.advance_to(vehicle_us);
    }

    /// The station's process stalls while the vehicle continues, then reads the backlog one by one
    /// and answers as it reads.
    pub fn stall(&mut self, seconds: f64) {
        let until_us = self.now_us() + (seconds * 1e6) as u64;
        let mut unread = Vec::new();
        while self.now_us() < until_us {
            self.advance(until_us);
            self.vehicle.take_output(|peer, frame| {
                if peer == STATION {
                    unread.push(frame.to_vec());
                }
            });
        }
        let now = self.now();
        for frame in unread {
            self.station.receive(now, VEHICLE, &frame, true);
            self.transmit();
        }
    }

    pub fn run(&mut self, seconds: f64) {
        let until_us = self.now_us() + (seconds * 1e6) as u64;
        while self.now_us() < until_us {
            self.turn(until_us);
        }
    }

    pub fn phase(&self) -> Option<FlightState> {
        self.station.status().phase
    }

    /// Runs until the state is reached, at most `seconds`.
    pub fn until(&mut self, state: FlightState, seconds: f64) {
        let limit_us = self.now_us() + (seconds * 1e6) as u64;
        while self.phase() != Some(state) {
            assert!(
                self.now_us() < limit_us,
                "{state:?} not reached in {seconds} s but {:?}: {:#?}",
                self.phase(),
                self.texts()
            );
            self.turn(limit_us);
        }
    }

    /// Two seconds into the trajectory.
    pub fn in_track(mut self) -> Self {
        self.until(FlightState::Track, 30.0);
        self.run(2.0);
        self
    }

    /// The pilot of a vehicle on the ground switches to OFFBOARD and arms, and the trajectory begins.
    pub fn engage(&mut self) {
        self.until(FlightState::Standby, 10.0);
        self.run(0.5);
        self.pilot_mode(Mode::Offboard);
        self.run(0.2);
        self.pilot_arms();
        self.until(FlightState::Track, 30.0);
    }

    /// Runs until the motors are stopped, at most `seconds`.
    pub fn until_disarmed(&mut self, seconds: f64) {
        let limit_us = self.now_us() + (seconds * 1e6) as u64;
        while self.vehicle.flight().armed() {
            assert!(self.now_us() < limit_us, "still armed: {:#?}", self.texts());
            self.turn(limit_us);
        }
    }

    /// Runs until recording ends, at most `seconds`.
    pub fn until_over(&mut self, seconds: f64) {
        let limit_us = self.now_us() + (seconds * 1e6) as u64;
        while !self.station.is_over() {
            assert!(self.now_us() < limit_us, "still recording: {:#?}", self.texts());
            self.turn(limit_us);
        }
    }

    /// Whether the sinks were notified that the flight is over.
    pub fn has_recorded_end(&self) -> bool {
        self.records.iter().any(|record| matches!(record, Record::FlightEnds))
    }

    pub fn position(&self) -> vehicle::frame::Ned {
        self.vehicle.plant().state().position
    }

    /// Lines of the log.
    pub fn texts(&self) -> Vec<&str> {
        self.records
            .iter()
            .filter_map(|record| match record {
                Record::Event { text, .. } => Some(text.as_str()),
                _ => None,
            })
            .collect()
    }

    pub fn logged(&self, words: &str) -> bool {
        self.texts().iter().any(|text| text.contains(words))
    }

    /// Number of setpoints that left after `us` of simulation.
    pub fn setpoints_after(&self, us: u64) -> usize {
        self.setpoints_us.iter().filter(|at| **at > us).count()
    }

    /// The pilot's ground station sends a command.
    fn command(&mut self, command: MavCmd, params: [f32; 3]) {
        let data = COMMAND_LONG_DATA {
            param1: params[0],
            param2: params[1],
            param3: params[2],
            command,
            target_system: autopilot::SYSTEM_ID,
            target_component: autopilot::COMPONENT_ID,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        assert!(self.pilot.encode(&MavMessage::COMMAND_LONG(data), &mut bytes));
        self.vehicle.receive(PILOT, &bytes);
    }

    /// The pilot requests a mode; the vehicle may refuse.
    pub fn pilot_mode(&mut self, mode: Mode) {
        let [main, sub] = self.vehicle.mode_command(mode);
        self.command(MavCmd::MAV_CMD_DO_SET_MODE, [1.0, main.into(), sub.into()]);
    }

    /// The pilot arms.
    pub fn pilot_arms(&mut self) {
        self.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0]);
    }

    /// The vehicle reboots on the ground with its clock at 0.
    pub fn reboot(&mut self, vehicle: Vehicle) {
        self.booted_us = self.now_us();
        self.vehicle = vehicle;
        self.vehicle.connect(STATION, LinkKind::Datagrams);
    }

    /// The daemon restarts.
    pub fn restart(&mut self, settings: StationSettings) {
        self.station = Station::new(settings, self.now());
    }
}

/// Message id of a MAVLink 2 frame.
pub fn message_id(frame: &[u8]) -> Option<u32> {
    match *frame {
        [0xFD, _, _, _, _, _, _, a, b, c, ..] => Some(u32::from_le_bytes([a, b, c, 0])),
        [0xFE, _, _, _, _, id, ..] => Some(id.into()),
        _ => None,
    }
}
