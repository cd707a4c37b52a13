//! One vehicle's messages, collected on its clock.
//!
//! Messages are kept by source, so estimates are never mixed; the choice of source for each stream
//! comes at the end. Where the vehicle's clock jumps, as after a reboot, a new epoch begins. By
//! default, the flight is the epoch that flew longest.

mod boots;
mod facts;
mod parameters;
mod raw;

use mavlink::MessageData;
use message::Codec;
use message::{AttitudeSource, Battery, Inbound, LandedState};
use wire::dialect::*;
use wire::{Frame, message_name};

use super::LogFault;
use super::clocks::{Arrival, ClockMap, Exchange, FrameTime};
use super::epoch::{Epoch, IMUS, ImuSample, PoseSample, Source};
use super::flight::{Clock, Flight, Stream};
use super::setpoints::{Sent, steadied};
use super::statements::Statement;
use super::tally::Tally;
use parameters::Heard;
use raw::Updates;

/// Values of MAV_AUTOPILOT.
const PX4: u8 = MavAutopilot::MAV_AUTOPILOT_PX4 as u8;
const ARDUPILOT: u8 = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA as u8;
/// Index of RAW_IMU in [`IMUS`].
const RAW_IMU: usize = 1;
/// Consecutive messages that must agree on a jump of the vehicle's clock.
const JUMP_MESSAGES: u32 = 8;
/// Assumed minimum downlink delay for placing setpoints without TIMESYNC, s.
const ASSUMED_DELAY: f64 = 1.5e-3;

/// The longest time without a frame of the vehicle since its clock last continued: where it
/// rebooted, if the clock does not. Its first reports may come well before its first stamp.
#[derive(Debug, Default)]
struct Silence {
    /// Ground time of the newest frame, s.
    last: f64,
    longest: f64,
    /// Number of the frame after it.
    until: u32,
}

impl Silence {
    fn hear(&mut self, frame_time: FrameTime) {
        let silent = frame_time.ground - self.last;
        self.last = frame_time.ground;
        if silent >= self.longest {
            (self.longest, self.until) = (silent, frame_time.index);
        }
    }
}

/// Everything that one system and component sent.
#[derive(Debug, Default)]
pub(super) struct VehicleLog {
    codec: Codec,
    /// MAV_AUTOPILOT in its heartbeats.
    autopilot: Option<u8>,
    parameters: Vec<Heard>,
    /// Texts and types, with the numbers of their frames.
    statements: Vec<(u32, Statement)>,
    /// Servo outputs that wait for a message that states the vehicle's time: their own stamps have
    /// 32 bits.
    outputs_waiting: Vec<(FrameTime, SERVO_OUTPUT_RAW_DATA)>,
    /// The sensor whose HIGHRES_IMU is used, the first that was heard.
    imu_id: Option<u8>,
    epochs: Vec<Epoch>,
    current: usize,
    /// Frame number from which on an epoch is current, with the epoch's index.
    switches: Vec<(u32, usize)>,
    /// Consecutive messages that do not follow the clock, and the frame number of the first.
    jumped: u32,
    jumped_from: u32,
    silence: Silence,
    battery: Vec<(FrameTime, f64)>,
    /// Voltage from SYS_STATUS.
    system_voltage: Vec<(FrameTime, f64)>,
    armed: Vec<(FrameTime, bool)>,
    landed: Vec<(FrameTime, bool)>,
    exchanges: Vec<Exchange>,
    messages: u64,
    tally: Tally,
}

impl VehicleLog {
    /// Whether this sender sent a HEARTBEAT of an autopilot.
    pub fn is_autopilot(&self) -> bool {
        self.autopilot.is_some()
    }

    /// Number of decoded messages.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Number of messages with an attitude.
    pub fn attitudes(&self) -> usize {
        self.epochs.iter().map(Epoch::attitudes).sum()
    }

    /// Adds an exchange of TIMESYNC.
    pub fn synchronise(&mut self, exchange: Exchange) {
        self.exchanges.push(exchange);
    }

    /// Adds a frame from this vehicle.
    pub fn add(&mut self, frame_time: FrameTime, frame: &Frame) {
        self.silence.hear(frame_time);
        if raw::is_raw(frame.id()) {
            self.add_raw(frame_time, frame);
            return;
        }
        if frame.id() == PARAM_VALUE_DATA::ID {
            self.add_parameter(frame_time, frame);
            return;
        }
        if !is_kept(frame.id()) {
            return;
        }
        let (time, message) = match self.codec.decode(frame) {
            Ok(Some(decoded)) => decoded,
            Ok(None) => return,
            Err(refusal) => {
                self.tally.add(&format!("{}: {refusal}", message_name(frame.id())), 1);
                return;
            }
        };
        self.messages += 1;
        if self.codec.knows_time() {
            self.keep_waiting_outputs();
        }
        let vehicle = time.map(|time| time.as_us() as f64 * 1e-6);
        match message {
            Inbound::Heartbeat { autopilot, vehicle_type, armed, .. }
                if autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID as u8 =>
            {
                self.autopilot = Some(autopilot);
                self.statements.push((frame_time.index, Statement::Type(vehicle_type)));
                self.armed.push((frame_time, armed));
            }
            Inbound::StatusText { severity, text } => {
                self.statements.push((frame_time.index, Statement::Text(Some(severity), text)));
            }
            Inbound::Attitude { source, attitude, body_rate } => {
                let source = match source {
                    AttitudeSource::Quaternion => Source::Quaternion,
                    AttitudeSource::Euler => Source::Euler,
                };
                self.keep(source, frame_time, vehicle, |epoch, time| {
                    match source {
                        Source::Quaternion => &mut epoch.quaternion,
                        _ => &mut epoch.euler,
                    }
                    .push(time, (attitude, body_rate))
                });
            }
            Inbound::LocalPosition { position, velocity } => {
                self.keep(Source::LocalPosition, frame_time, vehicle, |epoch, time| {
                    epoch.local_position.push(time, (position, velocity))
                });
            }
            Inbound::Odometry { position, velocity, attitude, body_rate, .. } => {
                let pose = PoseSample { position, velocity, attitude, body_rate };
                self.keep(Source::Odometry, frame_time, vehicle, |epoch, time| {
                    epoch.odometry.push(time, pose)
                });
            }
            Inbound::Imu { specific_force, body_rate } => {
                let Updates { sensor, force, rate } = Updates::of_highres_imu(frame.payload());
                let used = *self.imu_id.get_or_insert(sensor);
                if sensor != used {
                    let reason = format!("HIGHRES_IMU: of sensor {sensor}, where {used} is used");
                    self.tally.add(&reason, 1);
                } else if force || rate {
                    let sample = (force.then_some(specific_force), rate.then_some(body_rate));
                    self.keep_imu(Source::Imu, frame_time, vehicle, sample);
                }
            }
            Inbound::MotorOutputs { outputs, .. } => {
                let outputs = outputs.map(f64::from);
                self.keep(Source::ActuatorOutputs, frame_time, vehicle, |epoch, time| {
                    epoch.actuator_outputs.push(time, outputs)
                });
            }
            Inbound::Battery(Battery { voltage: Some(voltage), .. }) => {
                self.battery.push((frame_time, voltage));
            }
            Inbound::LandedState(state) => match state {
                LandedState::Undefined => {}
                // While taking off or landing, the vehicle may still touch the ground.
                LandedState::OnGround | LandedState::TakingOff | LandedState::Landing => {
                    self.landed.push((frame_time, false));
                }
                LandedState::InAir => self.landed.push((frame_time, true)),
            },
            _ => {}
        }
    }

    fn keep_imu(
        &mut self,
        source: Source,
        frame_time: FrameTime,
        time: Option<f64>,
        sample: ImuSample,
    ) {
        let Some(at) = IMUS.iter().position(|imu| *imu == source) else { return };
        self.keep(source, frame_time, time, |epoch, time| epoch.imus[at].push(time, sample));
    }

    /// Adds a sample to the epoch that its time stamp belongs to.
    fn keep(
        &mut self,
        source: Source,
        frame_time: FrameTime,
        vehicle: Option<f64>,
        push: impl FnOnce(&mut Epoch, f64) -> bool,
    ) {
        let Some(vehicle) = vehicle else { return };
        let arrival = Arrival { index: frame_time.index, ground: frame_time.ground, vehicle };
        if self.epochs.is_empty() {
            self.begin_epoch(frame_time.index);
        }
        let epoch = &self.epochs[self.current];
        let is_new = epoch.tracks[source as usize].is_none();
        if is_new && self.jumped > 0 || !is_new && !epoch.follows(source, &arrival) {
            if self.jumped == 0 {
                self.jumped_from = self.silence.until.min(frame_time.index);
            }
            self.jumped += 1;
            if self.jumped < JUMP_MESSAGES {
                self.tally.add("message at a jump of the vehicle's clock", 1);
                return;
            }
            // If the clock has returned to an earlier epoch, that epoch continues.
            match self.epochs.iter().position(|epoch| epoch.follows(source, &arrival)) {
                Some(epoch) => {
                    self.current = epoch;
                    self.switches.push((self.jumped_from, epoch));
                }
                None => self.begin_epoch(self.jumped_from),
            }
        }
        self.jumped = 0;
        self.silence.longest = f64::NEG_INFINITY;
        let epoch = &mut self.epochs[self.current];
        let kept = push(epoch, vehicle);
        epoch.take(source, arrival, kept);
    }

    fn begin_epoch(&mut self, index: u32) {
        self.current = self.epochs.len();
        self.epochs.push(Epoch::default());
        self.switches.push((index, self.current));
    }

    /// The epoch that is current at a frame.
    fn epoch_at(&self, index: u32) -> Option<usize> {
        let next = self.switches.partition_point(|(from, _)| *from <= index);
        self.switches.get(next.saturating_sub(1)).map(|(_, epoch)| *epoch)
    }

    /// Fills `flight` with one epoch and the setpoints sent in it. Returns the dropped data.
    ///
    /// # Errors
    /// The log does not have the chosen boot.
    pub fn finish(
        mut self,
        setpoints: Vec<Sent>,
        boot: Option<usize>,
        flight: &mut Flight,
    ) -> Result<Tally, LogFault> {
        self.keep_waiting_outputs();
        let mut tally = std::mem::take(&mut self.tally);
        let flown = self.flown();
        let chosen = self.chosen(boot, &flown)?;
        let mut stated = self.stated(chosen.unwrap_or(0));
        // Parameters from the log's metadata, overridden by received ones.
        let metadata = std::mem::take(&mut flight.facts.parameters);
        for (name, value) in metadata {
            stated.parameters.entry(name).or_insert(value);
        }
        let parameters = stated.parameters.clone();
        flight.facts = self.facts(stated);
        let Some(chosen) = chosen else { return Ok(tally) };
        self.note_boots(chosen, &flown, &mut flight.facts.notes, &mut tally);
        let in_epoch = |frame_time: &FrameTime| self.epoch_at(frame_time.index) == Some(chosen);
        let of_epoch = |all: &[(FrameTime, f64)]| -> Vec<(FrameTime, f64)> {
            all.iter().filter(|(frame_time, _)| in_epoch(frame_time)).copied().collect()
        };
        let (mut battery, mut voltage_source) = (of_epoch(&self.battery), "BATTERY_STATUS");
        if battery.is_empty() {
            (battery, voltage_source) = (of_epoch(&self.system_voltage), "SYS_STATUS");
        }
        if !battery.is_empty() {
            flight.facts.notes.push(format!("voltage from {voltage_source}"));
        }
        let landed: Vec<_> = self.landed.iter().filter(|(h, _)| in_epoch(h)).copied().collect();
        let exchanges: Vec<_> =
            self.exchanges.iter().filter(|e| in_epoch(&e.answered)).copied().collect();
        let all = setpoints.len();
        let setpoints: Vec<_> =
            setpoints.into_iter().filter(|sent| in_epoch(&sent.frame_time)).collect();
        let other = (all - setpoints.len()) as u64;
        tally.add("setpoint during another run of the vehicle's clock", other);
        let mut epoch = self.epochs.swap_remove(chosen);
        if self.autopilot != Some(ARDUPILOT) {
            // Only ArduPilot uses mG and mrad/s in RAW_IMU.
            let raw = std::mem::take(&mut epoch.imus[RAW_IMU]);
            tally.add("RAW_IMU: in units that only the autopilot knows", raw.len() as u64);
        }
        for source in Source::ALL {
            let reason = format!("{}: sent again or out of order", source.name());
            tally.add(&reason, epoch.unordered[source as usize]);
        }
        let shifts = epoch.shifts();
        let assumed = if setpoints.is_empty() { 0.0 } else { ASSUMED_DELAY };
        let envelopes =
            Source::ALL.map(|source| (&epoch.envelopes[source as usize], shifts[source as usize]));
        let mut map = ClockMap::new(envelopes.into_iter(), assumed);
        flight.clock = if map.synchronise(&exchanges) {
            Clock::Synchronised
        } else {
            Clock::LeastDelay { assumed_s: assumed }
        };
        flight.ground_skew = map.skew();
        tally.add("step of the ground's clock (its stamps were matched again)", map.steps());
        place(&map, battery, &mut flight.voltage, voltage_source, &mut tally);
        place(&map, landed, &mut flight.in_air, "EXTENDED_SYS_STATE", &mut tally);
        let setpoints = steadied(setpoints).into_iter();
        let setpoints =
            setpoints.map(|sent| (sent.frame_time, (sent.setpoint, sent.missing))).collect();
        let mut placed = Stream::default();
        place(&map, setpoints, &mut placed, "SET_ATTITUDE_TARGET", &mut tally);
        flight.setpoint = placed.map(|(setpoint, _)| *setpoint);
        flight.setpoints_missing = placed.filter_map(|(_, n)| (*n > 0).then_some(*n));
        epoch.fill(shifts, &parameters, flight);
        Ok(tally)
    }
}

/// Maps samples with a ground time stamp to the vehicle's clock.
fn place<T>(
    map: &ClockMap,
    samples: Vec<(FrameTime, T)>,
    stream: &mut Stream<T>,
    name: &str,
    tally: &mut Tally,
) {
    let (mut far, mut unordered) = (0, 0);
    for (frame_time, value) in samples {
        match map.vehicle_time(frame_time) {
            Some(time) => unordered += u64::from(!stream.push(time, value)),
            None => far += 1,
        }
    }
    tally.add(&format!("{name}: no stamp of the vehicle near it"), far);
    tally.add(&format!("{name}: sent again or out of order"), unordered);
}

fn is_kept(id: u32) -> bool {
    matches!(
        id,
        HEARTBEAT_DATA::ID
            | ODOMETRY_DATA::ID
            | ATTITUDE_QUATERNION_DATA::ID
            | ATTITUDE_DATA::ID
            | LOCAL_POSITION_NED_DATA::ID
            | HIGHRES_IMU_DATA::ID
            | ACTUATOR_OUTPUT_STATUS_DATA::ID
            | BATTERY_STATUS_DATA::ID
            | EXTENDED_SYS_STATE_DATA::ID
            | STATUSTEXT_DATA::ID
    )
}
