//! One vehicle's messages, gathered on its own clock.
//!
//! Each message is kept by its source, so that estimates are never mixed; which source becomes
//! which stream is decided when all have been seen. Where the vehicle's clock jumps, as after a
//! reboot, a new epoch begins; the flight is the epoch that holds most.

use mavlink::MessageData;
use wire::Frame;
use wire::dialect::*;

use super::clocks::{Arrival, ClockMap, Exchange, Heard};
use super::epoch::{Epoch, PoseSample, Source};
use super::flight::{Clock, Flight, Stream};
use super::setpoints::{Sent, steadied};
use super::tally::Tally;
use crate::link::codec::Codec;
use crate::link::message::{self, AttitudeSource, Battery, Inbound, LandedState};

/// Messages in a row that must agree on a jump of the vehicle's clock.
const JUMP_MESSAGES: u32 = 8;
/// Least downlink delay where nothing measures it and setpoints are to be placed, s.
const ASSUMED_DELAY: f64 = 1.5e-3;

/// Everything that one system and component sent.
#[derive(Debug, Default)]
pub(super) struct VehicleLog {
    codec: Codec,
    is_autopilot: bool,
    epochs: Vec<Epoch>,
    current: usize,
    /// Number of the frame from which on each epoch was the current one.
    switches: Vec<(u32, usize)>,
    /// Messages in a row that do not follow the clock.
    jumped: u32,
    battery: Vec<(Heard, f64)>,
    landed: Vec<(Heard, bool)>,
    exchanges: Vec<Exchange>,
    messages: u64,
    tally: Tally,
}

impl VehicleLog {
    /// Whether a HEARTBEAT of an autopilot came from here.
    pub fn is_autopilot(&self) -> bool {
        self.is_autopilot
    }

    /// Messages that were understood.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Messages with an attitude.
    pub fn attitudes(&self) -> usize {
        self.epochs.iter().map(Epoch::attitudes).sum()
    }

    /// Adds an exchange of TIMESYNC.
    pub fn synchronise(&mut self, exchange: Exchange) {
        self.exchanges.push(exchange);
    }

    /// Takes in a frame of this vehicle.
    pub fn add(&mut self, heard: Heard, frame: &Frame) {
        if frame.id() == ESC_STATUS_DATA::ID {
            self.add_esc_status(heard, frame);
            return;
        }
        if !is_kept(frame.id()) {
            return;
        }
        let (time, message) = match self.codec.decode(frame) {
            Ok(Some(decoded)) => decoded,
            Ok(None) => return,
            Err(refusal) => {
                self.tally.add(&format!("{}: {refusal}", name_of(frame.id())), 1);
                return;
            }
        };
        self.messages += 1;
        let vehicle = time.map(|time| time.as_us() as f64 * 1e-6);
        match message {
            Inbound::Heartbeat { autopilot, .. } => {
                let invalid = MavAutopilot::MAV_AUTOPILOT_INVALID as u8;
                self.is_autopilot |= autopilot != invalid;
            }
            Inbound::Attitude { source, attitude, body_rate } => {
                let source = match source {
                    AttitudeSource::Quaternion => Source::Quaternion,
                    AttitudeSource::Euler => Source::Euler,
                };
                self.keep(source, heard, vehicle, |epoch, time| {
                    match source {
                        Source::Quaternion => &mut epoch.quaternion,
                        _ => &mut epoch.euler,
                    }
                    .push(time, (attitude, body_rate))
                });
            }
            Inbound::LocalPosition { position, velocity } => {
                self.keep(Source::LocalPosition, heard, vehicle, |epoch, time| {
                    epoch.local_position.push(time, (position, velocity))
                });
            }
            Inbound::Odometry { position, velocity, attitude, body_rate, .. } => {
                let pose = PoseSample { position, velocity, attitude, body_rate };
                self.keep(Source::Odometry, heard, vehicle, |epoch, time| {
                    epoch.odometry.push(time, pose)
                });
            }
            Inbound::Imu { specific_force, body_rate } => {
                let (force, rate) = updated_sensors(frame.payload());
                if !force && !rate {
                    return;
                }
                let sample = (force.then_some(specific_force), rate.then_some(body_rate));
                self.keep(Source::Imu, heard, vehicle, |epoch, time| epoch.imu.push(time, sample));
            }
            Inbound::MotorOutputs { source, outputs } => {
                let outputs = outputs.map(f64::from);
                let (source, is_servo) = match source {
                    message::MotorSource::ActuatorOutputStatus => (Source::ActuatorOutputs, false),
                    message::MotorSource::ServoOutputRaw => (Source::ServoOutputs, true),
                };
                self.keep(source, heard, vehicle, |epoch, time| {
                    let stream = match is_servo {
                        true => &mut epoch.servo_outputs,
                        false => &mut epoch.actuator_outputs,
                    };
                    stream.push(time, outputs)
                });
            }
            Inbound::Battery(Battery { voltage: Some(voltage), .. }) => {
                self.battery.push((heard, voltage));
            }
            Inbound::LandedState(state) => match state {
                LandedState::Undefined => {}
                // On the way up or down the ground may still be touched.
                LandedState::OnGround | LandedState::TakingOff | LandedState::Landing => {
                    self.landed.push((heard, false));
                }
                LandedState::InAir => self.landed.push((heard, true)),
            },
            _ => {}
        }
    }

    fn add_esc_status(&mut self, heard: Heard, frame: &Frame) {
        let Ok(MavMessage::ESC_STATUS(data)) = frame.message() else {
            self.tally.add("ESC_STATUS: payload does not fit its message", 1);
            return;
        };
        self.messages += 1;
        // The first of a group of four; others drive no rotor of a quadrotor.
        if data.index == 0 {
            let rpm = data.rpm.map(|rpm| f64::from(rpm).abs());
            let time = Some(data.time_usec as f64 * 1e-6);
            self.keep(Source::EscStatus, heard, time, |epoch, time| epoch.rpm.push(time, rpm));
        }
    }

    /// Keeps a sample in the epoch that its stamp belongs to.
    fn keep(
        &mut self,
        source: Source,
        heard: Heard,
        vehicle: Option<f64>,
        push: impl FnOnce(&mut Epoch, f64) -> bool,
    ) {
        let Some(vehicle) = vehicle else { return };
        let arrival = Arrival { index: heard.index, ground: heard.ground, vehicle };
        if self.epochs.is_empty() {
            self.begin_epoch(heard.index);
        }
        let epoch = &self.epochs[self.current];
        let is_new = epoch.tracks[source as usize].is_none();
        if is_new && self.jumped > 0 || !is_new && !epoch.follows(source, &arrival) {
            self.jumped += 1;
            if self.jumped < JUMP_MESSAGES {
                self.tally.add("message at a jump of the vehicle's clock", 1);
                return;
            }
            // An epoch that the clock has come back to goes on.
            match self.epochs.iter().position(|epoch| epoch.follows(source, &arrival)) {
                Some(epoch) => {
                    self.current = epoch;
                    self.switches.push((heard.index, epoch));
                }
                None => self.begin_epoch(heard.index),
            }
        }
        self.jumped = 0;
        let epoch = &mut self.epochs[self.current];
        let kept = push(epoch, vehicle);
        epoch.take(source, arrival, kept);
    }

    fn begin_epoch(&mut self, index: u32) {
        self.current = self.epochs.len();
        self.epochs.push(Epoch::default());
        self.switches.push((index, self.current));
    }

    /// The epoch that was current at a frame.
    fn epoch_at(&self, index: u32) -> Option<usize> {
        let next = self.switches.partition_point(|(from, _)| *from <= index);
        self.switches.get(next.saturating_sub(1)).map(|(_, epoch)| *epoch)
    }

    /// Fills `flight` with the epoch that holds most, and with the setpoints sent to it. Returns
    /// what was left out.
    pub fn finish(mut self, setpoints: Vec<Sent>, flight: &mut Flight) -> Tally {
        let mut tally = std::mem::take(&mut self.tally);
        let weight = |epoch: &Epoch| (epoch.attitudes(), epoch.messages());
        let order = |(a, x): &(usize, &Epoch), (b, y): &(usize, &Epoch)| {
            weight(x).cmp(&weight(y)).then(b.cmp(a))
        };
        let Some(chosen) = self.epochs.iter().enumerate().max_by(order).map(|(at, _)| at) else {
            return tally;
        };
        for (at, epoch) in self.epochs.iter().enumerate() {
            if at != chosen {
                let (from, to) = epoch.span();
                let reason = format!(
                    "message of another run of the vehicle's clock ({from:.2} to {to:.2} s)"
                );
                tally.add(&reason, epoch.messages() as u64);
            }
        }
        let in_epoch = |heard: &Heard| self.epoch_at(heard.index) == Some(chosen);
        let battery: Vec<_> = self.battery.iter().filter(|(h, _)| in_epoch(h)).copied().collect();
        let landed: Vec<_> = self.landed.iter().filter(|(h, _)| in_epoch(h)).copied().collect();
        let exchanges: Vec<_> =
            self.exchanges.iter().filter(|e| in_epoch(&e.answered)).copied().collect();
        let all = setpoints.len();
        let setpoints: Vec<_> =
            setpoints.into_iter().filter(|sent| in_epoch(&sent.heard)).collect();
        let other = (all - setpoints.len()) as u64;
        tally.add("setpoint during another run of the vehicle's clock", other);
        let epoch = self.epochs.swap_remove(chosen);

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
        tally.add("step of the ground's clock (its stamps were tied anew)", map.steps());
        place(&map, battery, &mut flight.voltage, "BATTERY_STATUS", &mut tally);
        place(&map, landed, &mut flight.in_air, "EXTENDED_SYS_STATE", &mut tally);
        let setpoints = steadied(setpoints).into_iter();
        let setpoints = setpoints.map(|sent| (sent.heard, (sent.setpoint, sent.missing))).collect();
        let mut placed = Stream::default();
        place(&map, setpoints, &mut placed, "SET_ATTITUDE_TARGET", &mut tally);
        flight.setpoint = placed.map(|(setpoint, _)| *setpoint);
        flight.setpoints_missing = placed.filter_map(|(_, n)| (*n > 0).then_some(*n));
        epoch.fill(shifts, flight);
        tally
    }
}

/// Puts samples that only the ground stamped onto the vehicle's clock.
fn place<T>(
    map: &ClockMap,
    samples: Vec<(Heard, T)>,
    stream: &mut Stream<T>,
    name: &str,
    tally: &mut Tally,
) {
    let (mut far, mut unordered) = (0, 0);
    for (heard, value) in samples {
        match map.vehicle_time(heard) {
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
            | SERVO_OUTPUT_RAW_DATA::ID
            | BATTERY_STATUS_DATA::ID
            | EXTENDED_SYS_STATE_DATA::ID
    )
}

/// Whether a HIGHRES_IMU has a new accelerometer and a new gyro sample, by its `fields_updated`;
/// flags that are all unset were never filled in.
fn updated_sensors(payload: &[u8]) -> (bool, bool) {
    /// Behind the time and thirteen floats.
    const FIELDS_UPDATED: usize = 60;
    const ACCELEROMETER: u16 = 0x007;
    const GYRO: u16 = 0x038;
    // MAVLink 2 cuts trailing zeros.
    let byte = |at: usize| payload.get(at).copied().unwrap_or(0);
    let flags = u16::from_le_bytes([byte(FIELDS_UPDATED), byte(FIELDS_UPDATED + 1)]);
    let has = |mask: u16| flags == 0 || flags & mask == mask;
    (has(ACCELEROMETER), has(GYRO))
}

/// Name of a message that may be refused.
fn name_of(id: u32) -> String {
    match id {
        ODOMETRY_DATA::ID => "ODOMETRY".into(),
        ATTITUDE_QUATERNION_DATA::ID => "ATTITUDE_QUATERNION".into(),
        ATTITUDE_DATA::ID => "ATTITUDE".into(),
        LOCAL_POSITION_NED_DATA::ID => "LOCAL_POSITION_NED".into(),
        HIGHRES_IMU_DATA::ID => "HIGHRES_IMU".into(),
        ACTUATOR_OUTPUT_STATUS_DATA::ID => "ACTUATOR_OUTPUT_STATUS".into(),
        SERVO_OUTPUT_RAW_DATA::ID => "SERVO_OUTPUT_RAW".into(),
        BATTERY_STATUS_DATA::ID => "BATTERY_STATUS".into(),
        EXTENDED_SYS_STATE_DATA::ID => "EXTENDED_SYS_STATE".into(),
        ESC_STATUS_DATA::ID => "ESC_STATUS".into(),
        id => format!("message {id}"),
    }
}
