//! A vehicle on a virtual clock, and peers that exchange frames with it.

use mavlink::{MavlinkVersion, Message};
use sitl::autopilot::{LinkKind, Mode, Peer, Vehicle};
use sitl::config::{Autopilot, SensorConfig, SitlConfig};
use vehicle::VehicleParams;
use wire::dialect::*;
use wire::{Decoder, Encoder};

pub const GROUND: Peer = Peer(0);

/// A message as a peer received it, with the vehicle's time.
pub struct Received {
    pub time_us: u64,
    pub message: MavMessage,
    pub version: MavlinkVersion,
}

struct Station {
    peer: Peer,
    encoder: Encoder,
    decoder: Decoder,
    received: Vec<Received>,
}

/// The vehicle and its peers, with an optional stream of setpoints while time passes.
pub struct Bench {
    pub vehicle: Vehicle,
    stations: Vec<Station>,
    stream: Option<SET_ATTITUDE_TARGET_DATA>,
    /// Interval between streamed setpoints, us.
    pub period_us: u64,
    pub bytes_out: Vec<u8>,
}

pub fn params() -> VehicleParams {
    let rotor = |x: f64, y: f64, spin: i8| {
        serde_json::json!({
            "position_m": [0.1 * x, 0.1 * y, 0.0], "spin": spin,
            "thrust_max_N": 2.5, "drag_torque_per_thrust_m": 0.015,
        })
    };
    let file = serde_json::json!({
        "name": "bench",
        "mass": 0.5,
        "inertia": [0.003, 0.003, 0.005],
        "rotors": [rotor(1.0, 1.0, 1), rotor(-1.0, 1.0, -1), rotor(-1.0, -1.0, 1), rotor(1.0, -1.0, -1)],
        "motor_time_constant_s": 0.03,
        "command_delay_s": 0.005,
        "attitude_pd": {"kp": [0.6, 0.6, 0.3], "kd": [0.075, 0.075, 0.06], "rate_hz": 250.0},
        "hover_thrust": 0.4905,
        "gravity": 9.81,
        "air_density": 1.2,
        "rotor_radius_m": 0.06,
        "rotor_max_rpm": 20000.0,
        "battery": {"cells": 3, "full_V": 12.6, "nominal_V": 11.1},
    });
    serde_json::from_value(file).expect("a vehicle file")
}

impl Bench {
    /// A vehicle with one peer that has sent its hello.
    pub fn new() -> Self {
        Self::with_seed(1)
    }

    pub fn with_seed(seed: u64) -> Self {
        Self::with(SitlConfig::default(), seed)
    }

    /// A vehicle that hovers 20 m up with perfect sensors.
    pub fn hovering(autopilot: Autopilot) -> Self {
        Self::hovering_as(params(), autopilot)
    }

    pub fn hovering_as(params: VehicleParams, autopilot: Autopilot) -> Self {
        let mut config =
            SitlConfig { autopilot, sensors: SensorConfig::IDEAL, ..SitlConfig::default() };
        config.start.position_m = [0.0, 0.0, -20.0];
        let mut bench = Self::of(params, config, 1);
        bench.run(2.0);
        bench
    }

    pub fn with(config: SitlConfig, seed: u64) -> Self {
        Self::of(params(), config, seed)
    }

    pub fn of(params: VehicleParams, config: SitlConfig, seed: u64) -> Self {
        let vehicle =
            Vehicle::new(params, Default::default(), config, seed).expect("a vehicle that flies");
        let mut bench = Self {
            vehicle,
            stations: Vec::new(),
            stream: None,
            period_us: 10_000,
            bytes_out: Vec::new(),
        };
        bench.join(GROUND, MavlinkVersion::V2);
        bench
    }

    /// Adds a peer, which sends its hello.
    pub fn join(&mut self, peer: Peer, version: MavlinkVersion) {
        let mut encoder = Encoder::new(255, 190);
        encoder.set_version(version);
        let decoder = Decoder::new();
        self.stations.push(Station { peer, encoder, decoder, received: Vec::new() });
        self.vehicle.connect(peer, LinkKind::Datagrams);
        self.send_from(
            peer,
            &MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                mavtype: MavType::MAV_TYPE_GCS,
                autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
                ..Default::default()
            }),
        );
    }

    pub fn send_from(&mut self, peer: Peer, message: &MavMessage) {
        let station = self.stations.iter_mut().find(|s| s.peer == peer).expect("a known peer");
        let mut bytes = Vec::new();
        assert!(station.encoder.encode(message, &mut bytes));
        self.vehicle.receive(peer, &bytes);
        self.collect();
    }

    pub fn send(&mut self, message: &MavMessage) {
        self.send_from(GROUND, message);
    }

    fn collect(&mut self) {
        let Self { vehicle, stations, bytes_out, .. } = self;
        let time_us = vehicle.now_us();
        vehicle.take_output(|peer, bytes| {
            bytes_out.extend_from_slice(bytes);
            let Some(station) = stations.iter_mut().find(|s| s.peer == peer) else { return };
            station.decoder.push(bytes);
            let frame = station.decoder.next_frame().expect("one whole frame");
            assert_eq!(frame.bytes(), bytes);
            let message = frame.message().expect("a message of the dialect");
            station.received.push(Received { time_us, message, version: frame.version() });
        });
    }

    /// Advances time in steps of the stream's period, with a setpoint in each if one is streamed.
    pub fn run(&mut self, seconds: f64) {
        let end = self.vehicle.now_us() + (seconds * 1e6) as u64;
        while self.vehicle.now_us() < end {
            if let Some(setpoint) = self.stream.clone() {
                self.send(&MavMessage::SET_ATTITUDE_TARGET(setpoint));
            }
            let next = (self.vehicle.now_us() + self.period_us).min(end);
            while self.vehicle.now_us() < next {
                let event = self.vehicle.next_event_us().min(next);
                self.vehicle.advance_to(event);
                self.collect();
            }
        }
    }

    /// Advances time until `done`, at most `seconds`; returns whether it became true.
    pub fn run_until(&mut self, seconds: f64, done: impl Fn(&Self) -> bool) -> bool {
        let end = self.vehicle.now_us() + (seconds * 1e6) as u64;
        while self.vehicle.now_us() < end && !done(self) {
            self.run(0.01);
        }
        done(self)
    }

    /// Streams a setpoint from now on.
    pub fn stream(&mut self, setpoint: SET_ATTITUDE_TARGET_DATA) {
        self.stream = Some(setpoint);
    }

    pub fn stop_stream(&mut self) {
        self.stream = None;
    }

    /// What a peer has received since the last call.
    pub fn received_by(&mut self, peer: Peer) -> Vec<Received> {
        let station = self.stations.iter_mut().find(|s| s.peer == peer).expect("a known peer");
        std::mem::take(&mut station.received)
    }

    pub fn received(&mut self) -> Vec<Received> {
        self.received_by(GROUND)
    }

    pub fn texts(&mut self) -> String {
        self.received()
            .into_iter()
            .filter_map(|received| match received.message {
                MavMessage::STATUSTEXT(text) => text.text.to_str().ok().map(str::to_owned),
                _ => None,
            })
            .collect()
    }

    /// Sends a command; returns its answer and the texts that came with it.
    pub fn command_and_texts(&mut self, command: MavCmd, params: &[f32]) -> (MavResult, String) {
        let (results, texts) = self.answers(command, params);
        assert_eq!(results.len(), 1, "one answer");
        (results[0], texts)
    }

    /// Sends a command; returns all answers to it and the texts that came with them.
    pub fn answers(&mut self, command: MavCmd, params: &[f32]) -> (Vec<MavResult>, String) {
        self.received();
        self.send(&command_long(command, params));
        let mut texts = String::new();
        let mut results = Vec::new();
        for received in self.received() {
            match received.message {
                MavMessage::COMMAND_ACK(ack) => {
                    assert_eq!(ack.command, command);
                    assert_eq!((ack.target_system, ack.target_component), (255, 190));
                    results.push(ack.result);
                }
                MavMessage::STATUSTEXT(text) => texts.push_str(text.text.to_str().unwrap()),
                _ => {}
            }
        }
        (results, texts)
    }

    pub fn command(&mut self, command: MavCmd, params: &[f32]) -> MavResult {
        self.command_and_texts(command, params).0
    }

    pub fn set_mode(&mut self, mode: Mode) -> MavResult {
        let [_, _, main, sub] = mode.custom_mode().to_le_bytes();
        self.command(MavCmd::MAV_CMD_DO_SET_MODE, &[1.0, main.into(), sub.into()])
    }

    /// Selects an ArduCopter mode.
    pub fn set_mode_number(&mut self, number: u8) -> MavResult {
        self.command(MavCmd::MAV_CMD_DO_SET_MODE, &[1.0, number.into()])
    }

    /// The value of a parameter as the protocol's float; `None` if unanswered.
    pub fn parameter(&mut self, name: &str) -> Option<f32> {
        self.received();
        self.send(&MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
            param_index: -1,
            target_system: 1,
            target_component: 1,
            param_id: name.into(),
        }));
        self.received().into_iter().find_map(|received| match received.message {
            MavMessage::PARAM_VALUE(value) => Some(value.param_value),
            _ => None,
        })
    }

    /// Requests message `id` at `hz`.
    pub fn request(&mut self, id: u32, hz: f32) -> MavResult {
        self.command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, &[id as f32, 1e6 / hz])
    }

    /// Rate of message `id`, measured over two seconds, Hz.
    pub fn rate_of(&mut self, id: u32) -> f64 {
        self.received();
        self.run(2.0);
        0.5 * count(&self.received(), id) as f64
    }

    /// Roll of the vehicle in degrees.
    pub fn roll_deg(&self) -> f64 {
        self.vehicle.plant().state().attitude.euler().roll.to_degrees()
    }

    /// Time until the roll reaches 63 % of a step to `degrees`, s.
    pub fn roll_step_s(&mut self, degrees: f64, hover: f32, mask: u8) -> f64 {
        let start = self.vehicle.now_us();
        self.stream(setpoint(degrees.to_radians(), 0.0, hover, mask));
        let arrived = |bench: &Self| bench.roll_deg() >= 0.63 * degrees;
        assert!(self.run_until(2.0, arrived), "rolls");
        (self.vehicle.now_us() - start) as f64 * 1e-6
    }

    pub fn arm(&mut self) -> MavResult {
        self.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0])
    }

    pub fn set_parameter(&mut self, name: &str, param_value: f32, param_type: MavParamType) {
        self.send(&MavMessage::PARAM_SET(PARAM_SET_DATA {
            param_value,
            target_system: 1,
            target_component: 1,
            param_id: name.into(),
            param_type,
        }));
    }

    pub fn mode(&self) -> Mode {
        self.vehicle.flight().mode()
    }

    pub fn armed(&self) -> bool {
        self.vehicle.flight().armed()
    }

    /// Height of the plant above the floor, m.
    pub fn height(&self) -> f64 {
        -self.vehicle.plant().state().position.down()
    }

    /// Takes off and waits for HOLD.
    pub fn fly(&mut self) {
        assert_eq!(self.arm(), MavResult::MAV_RESULT_ACCEPTED);
        let take_off = self.command(MavCmd::MAV_CMD_NAV_TAKEOFF, &[0.0; 7]);
        assert_eq!(take_off, MavResult::MAV_RESULT_ACCEPTED);
        assert!(self.run_until(15.0, |bench| bench.mode() == Mode::Hold), "take-off ends");
        self.run(2.0);
    }
}

pub fn command_long(command: MavCmd, params: &[f32]) -> MavMessage {
    let param = |n: usize| params.get(n).copied().unwrap_or(0.0);
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        param1: param(0),
        param2: param(1),
        param3: param(2),
        param4: param(3),
        param5: param(4),
        param6: param(5),
        param7: param(6),
        command,
        target_system: 1,
        target_component: 1,
        confirmation: 0,
    })
}

/// A setpoint: roll in rad, body roll rate in rad/s, thrust, type mask.
pub fn setpoint(roll: f64, roll_rate: f32, thrust: f32, mask: u8) -> SET_ATTITUDE_TARGET_DATA {
    SET_ATTITUDE_TARGET_DATA {
        q: vehicle::frame::Euler::new(roll, 0.0, 0.0).attitude().to_wire(),
        body_roll_rate: roll_rate,
        thrust,
        target_system: 1,
        target_component: 1,
        type_mask: AttitudeTargetTypemask::from_bits_retain(mask),
        ..Default::default()
    }
}

/// Number of messages of `id`.
pub fn count(received: &[Received], id: u32) -> usize {
    received.iter().filter(|received| received.message.message_id() == id).count()
}
