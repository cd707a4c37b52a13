//! One run of a vehicle's clock: the samples of each source, and a check whether the next one
//! belongs to it.

use std::collections::BTreeMap;

use vehicle::frame::{Attitude, Frd, Ned};

use super::clocks::{Arrival, Envelope, shift_onto};
use super::flight::{Flight, MotorSource, MotorUnit, Stream};
use super::functions::{self, MOTORS, Movement, OUTPUTS, Stated, numbered};
use super::{RPM, ranges};

/// Jump of a time stamp against the ground's clock that exceeds delay and skew, s.
const JUMP: f64 = 0.5;
/// Share of the elapsed time that skew may add to the jump.
const SKEW: f64 = 0.02;
/// How long a minimum delay is kept, s.
const FLOOR_SPAN: f64 = 5.0;
/// ODOMETRY is often a copy of LOCAL_POSITION_NED, and gives the position only if its rate is
/// higher by this factor.
const MANY_MORE: f64 = 1.5;

/// The supported messages with a vehicle time stamp, as indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Source {
    Quaternion,
    Euler,
    LocalPosition,
    Odometry,
    Imu,
    RawImu,
    ScaledImu,
    ScaledImu2,
    ScaledImu3,
    ActuatorOutputs,
    ServoOutputs,
    ServoOutputsAux,
    EscStatus,
}

/// Sources of IMU data, the first sensor's first.
pub(super) const IMUS: [Source; 5] =
    [Source::Imu, Source::RawImu, Source::ScaledImu, Source::ScaledImu2, Source::ScaledImu3];
/// Number of these that belong to the first sensor.
const FIRST_SENSOR: usize = 3;

pub(super) const SOURCES: usize = Source::EscStatus as usize + 1;

impl Source {
    pub const ALL: [Self; SOURCES] = [
        Self::Quaternion,
        Self::Euler,
        Self::LocalPosition,
        Self::Odometry,
        Self::Imu,
        Self::RawImu,
        Self::ScaledImu,
        Self::ScaledImu2,
        Self::ScaledImu3,
        Self::ActuatorOutputs,
        Self::ServoOutputs,
        Self::ServoOutputsAux,
        Self::EscStatus,
    ];
    /// Order of preference for the vehicle's clock: milliseconds since boot first.
    pub const CLOCKS: [Self; SOURCES] = [
        Self::Quaternion,
        Self::Euler,
        Self::LocalPosition,
        Self::Imu,
        Self::Odometry,
        Self::ScaledImu,
        Self::ScaledImu2,
        Self::ScaledImu3,
        Self::RawImu,
        Self::ActuatorOutputs,
        Self::EscStatus,
        Self::ServoOutputs,
        Self::ServoOutputsAux,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Quaternion => "ATTITUDE_QUATERNION",
            Self::Euler => "ATTITUDE",
            Self::LocalPosition => "LOCAL_POSITION_NED",
            Self::Odometry => "ODOMETRY",
            Self::Imu => "HIGHRES_IMU",
            Self::RawImu => "RAW_IMU",
            Self::ScaledImu => "SCALED_IMU",
            Self::ScaledImu2 => "SCALED_IMU2",
            Self::ScaledImu3 => "SCALED_IMU3",
            Self::ActuatorOutputs => "ACTUATOR_OUTPUT_STATUS",
            Self::ServoOutputs => "SERVO_OUTPUT_RAW",
            Self::ServoOutputsAux => "SERVO_OUTPUT_RAW of port 1",
            Self::EscStatus => "ESC_STATUS",
        }
    }
}

/// Specific force and body rate of an IMU message; `None` where its flags mark a sensor as not
/// updated.
pub(super) type ImuSample = (Option<Frd>, Option<Frd>);

#[derive(Debug)]
pub(super) struct PoseSample {
    pub position: Ned,
    pub velocity: Ned,
    pub attitude: Attitude,
    pub body_rate: Frd,
}

/// The newest time stamps of one source, to judge the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track {
    pub last: Arrival,
    /// Least clock difference in this span and in the previous one.
    pub floor: [f64; 2],
    pub span_start: f64,
}

impl Track {
    pub fn new(arrival: Arrival) -> Self {
        let difference = arrival.ground - arrival.vehicle;
        Self { last: arrival, floor: [difference, f64::INFINITY], span_start: arrival.ground }
    }

    /// Whether the vehicle's clock has continued since the last message. Late messages, link stalls
    /// and steps of the ground's clock are not jumps of the vehicle's clock.
    pub fn follows(&self, next: &Arrival) -> bool {
        let passed = next.vehicle - self.last.vehicle;
        let ground = next.ground - self.last.ground;
        let change = next.ground - next.vehicle - self.floor[0].min(self.floor[1]);
        let allowed = JUMP + SKEW * ground.abs();
        if change < -allowed {
            // Earlier than the link allows: the ground's clock stepped back or the vehicle's jumped
            // ahead.
            ground < -JUMP && (-JUMP..10.0 * JUMP).contains(&passed)
        } else {
            change <= allowed || passed >= -JUMP
        }
    }

    pub fn advance(&mut self, next: Arrival) {
        let difference = next.ground - next.vehicle;
        if (next.ground - self.span_start).abs() > FLOOR_SPAN {
            self.floor = [difference, self.floor[0]];
            self.span_start = next.ground;
        } else {
            self.floor[0] = self.floor[0].min(difference);
        }
        self.last = next;
    }
}

/// A period in which the vehicle's clock ran without a jump.
#[derive(Debug, Default)]
pub(super) struct Epoch {
    pub tracks: [Option<Track>; SOURCES],
    pub envelopes: [Envelope; SOURCES],
    pub unordered: [u64; SOURCES],
    pub quaternion: Stream<(Attitude, Frd)>,
    pub euler: Stream<(Attitude, Frd)>,
    pub local_position: Stream<(Ned, Ned)>,
    pub odometry: Stream<PoseSample>,
    /// IMU samples by source, in the order of [`IMUS`].
    pub imus: [Stream<ImuSample>; IMUS.len()],
    pub actuator_outputs: Stream<[f64; 4]>,
    /// Servo outputs by port.
    pub servo_outputs: [Stream<[f64; OUTPUTS]>; 2],
    pub rpm: Stream<[f64; 4]>,
}

impl Epoch {
    pub fn messages(&self) -> usize {
        Source::ALL.iter().map(|source| self.count(*source)).sum()
    }

    pub fn count(&self, source: Source) -> usize {
        match source {
            Source::Quaternion => self.quaternion.len(),
            Source::Euler => self.euler.len(),
            Source::LocalPosition => self.local_position.len(),
            Source::Odometry => self.odometry.len(),
            Source::Imu
            | Source::RawImu
            | Source::ScaledImu
            | Source::ScaledImu2
            | Source::ScaledImu3 => {
                let at = IMUS.iter().position(|imu| *imu == source);
                at.map_or(0, |at| self.imus[at].len())
            }
            Source::ActuatorOutputs => self.actuator_outputs.len(),
            Source::ServoOutputs => self.servo_outputs[0].len(),
            Source::ServoOutputsAux => self.servo_outputs[1].len(),
            Source::EscStatus => self.rpm.len(),
        }
    }

    /// Number of messages with an attitude.
    pub fn attitudes(&self) -> usize {
        self.quaternion.len() + self.euler.len() + self.odometry.len()
    }

    /// First and last time, s.
    pub fn span(&self) -> (f64, f64) {
        let ends = |times: &[f64]| Some((*times.first()?, *times.last()?));
        let all = [
            ends(self.quaternion.times()),
            ends(self.euler.times()),
            ends(self.local_position.times()),
            ends(self.odometry.times()),
            ends(self.actuator_outputs.times()),
            ends(self.rpm.times()),
        ];
        let imus = self.imus.iter().map(|imu| ends(imu.times()));
        let servos = self.servo_outputs.iter().map(|outputs| ends(outputs.times()));
        all.into_iter()
            .chain(imus)
            .chain(servos)
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (from, to)| (a.min(from), b.max(to)))
    }

    pub fn follows(&self, source: Source, arrival: &Arrival) -> bool {
        self.tracks[source as usize].as_ref().is_some_and(|track| track.follows(arrival))
    }

    /// Records a message's time stamps; `kept` says whether its stream accepted the content.
    pub fn take(&mut self, source: Source, arrival: Arrival, kept: bool) {
        let at = source as usize;
        match &mut self.tracks[at] {
            Some(track) => track.advance(arrival),
            track => *track = Some(Track::new(arrival)),
        }
        if kept {
            self.envelopes[at].add(arrival);
        } else {
            self.unordered[at] += 1;
        }
    }
}

/// The servo outputs that drive motors 1 to 4.
struct Motors {
    port: usize,
    /// Outputs of the port, counted from 0.
    channels: [usize; MOTORS],
    /// Source of the mapping, for people.
    reason: String,
}

impl Epoch {
    /// The servo outputs that drive the motors; the error says why there are none.
    fn motors(&self, parameters: &BTreeMap<String, f64>) -> Result<Motors, String> {
        match functions::ardupilot_motors(parameters) {
            Stated::Motors(outputs) => {
                let port = outputs[0] / OUTPUTS;
                if outputs.iter().any(|output| output / OUTPUTS != port) {
                    return Err("motors are on both ports of SERVO_OUTPUT_RAW".to_owned());
                }
                let channels = outputs.map(|output| output % OUTPUTS);
                Ok(Motors { port, channels, reason: "by SERVOn_FUNCTION".to_owned() })
            }
            Stated::Without(missing) => {
                let missing: Vec<String> = missing.iter().map(usize::to_string).collect();
                let missing = missing.join(", ");
                Err(format!("SERVOn_FUNCTION states no output of motor {missing}"))
            }
            Stated::Nothing => {
                let movement = |outputs: &Stream<[f64; OUTPUTS]>| {
                    let mut movement = Movement::of(OUTPUTS);
                    outputs.values().iter().for_each(|sample| movement.add(*sample));
                    movement
                };
                let logged: Vec<Movement> = self.servo_outputs.iter().map(movement).collect();
                let drive = functions::px4_drive(parameters, &logged)?;
                let reason = drive.reason();
                Ok(Motors { port: drive.index, channels: drive.channels, reason })
            }
        }
    }

    /// The shift of each source's times to a common clock: `time_usec` may have a different epoch
    /// than `time_boot_ms`.
    pub fn shifts(&self) -> [f64; SOURCES] {
        let reference = Source::CLOCKS.into_iter().find(|source| self.count(*source) > 0);
        let mut shifts = [0.0; SOURCES];
        if let Some(reference) = reference {
            for source in Source::ALL {
                let own = &self.envelopes[source as usize];
                shifts[source as usize] = shift_onto(&self.envelopes[reference as usize], own);
            }
        }
        shifts
    }

    /// Fills the streams of `flight`, each from one source with shifted times, s.
    pub fn fill(
        &self,
        shifts: [f64; SOURCES],
        parameters: &BTreeMap<String, f64>,
        flight: &mut Flight,
    ) {
        let shift = |source: Source| shifts[source as usize];
        self.fill_imu(shift, flight);
        self.fill_attitude(shift, flight);
        self.fill_position(shift, flight);
        if self.actuator_outputs.is_empty() {
            self.fill_servo_outputs(shift, parameters, flight);
        } else {
            self.fill_actuator_outputs(shift, parameters, flight);
        }
        let speeds = self.rpm.map(|rpm| rpm.map(|rpm| rpm * RPM));
        flight.rotor_speed = speeds.shifted(shift(Source::EscStatus));
    }

    fn fill_imu(&self, shift: impl Fn(Source) -> f64, flight: &mut Flight) {
        let mut chosen = 0;
        for (at, imu) in self.imus.iter().enumerate() {
            let before = &self.imus[chosen];
            let is_more = at < FIRST_SENSOR && imu.is_more_frequent(before);
            if is_more || before.is_empty() && !imu.is_empty() {
                chosen = at;
            }
        }
        let (imu, source) = (&self.imus[chosen], IMUS[chosen]);
        if !imu.is_empty() {
            flight.facts.notes.push(format!("specific force and body rate from {}", source.name()));
        }
        let by = shift(source);
        flight.specific_force = imu.filter_map(|(force, _)| *force).shifted(by);
        flight.body_rate = imu.filter_map(|(_, rate)| *rate).shifted(by);
    }

    /// Fills the attitude, and the body rate if no IMU was logged.
    fn fill_attitude(&self, shift: impl Fn(Source) -> f64, flight: &mut Flight) {
        let pose = self.odometry.map(|pose| (pose.attitude, pose.body_rate));
        let (mut attitude, mut source) = (&self.quaternion, Source::Quaternion);
        for (other, of) in [(&pose, Source::Odometry), (&self.euler, Source::Euler)] {
            if other.is_more_frequent(attitude) {
                (attitude, source) = (other, of);
            }
        }
        let by = shift(source);
        flight.attitude = attitude.map(|(attitude, _)| *attitude).shifted(by);
        if flight.body_rate.is_empty() {
            flight.body_rate = attitude.map(|(_, rate)| *rate).shifted(by);
        }
    }

    fn fill_position(&self, shift: impl Fn(Source) -> f64, flight: &mut Flight) {
        let (local, odometry) = (&self.local_position, &self.odometry);
        if odometry.rate() > MANY_MORE * local.rate() {
            let by = shift(Source::Odometry);
            flight.position = odometry.map(|pose| pose.position).shifted(by);
            flight.velocity = odometry.map(|pose| pose.velocity).shifted(by);
        } else {
            let by = shift(Source::LocalPosition);
            flight.position = local.map(|(position, _)| *position).shifted(by);
            flight.velocity = local.map(|(_, velocity)| *velocity).shifted(by);
        }
    }

    fn fill_servo_outputs(
        &self,
        shift: impl Fn(Source) -> f64,
        parameters: &BTreeMap<String, f64>,
        flight: &mut Flight,
    ) {
        flight.motor_source = MotorSource::ServoOutputRaw;
        if self.servo_outputs.iter().all(Stream::is_empty) {
            return;
        }
        match self.motors(parameters) {
            Ok(Motors { port, channels, reason }) => {
                let source = [Source::ServoOutputs, Source::ServoOutputsAux][port];
                let of_motors = |all: &[f64; OUTPUTS]| channels.map(|channel| all[channel]);
                flight.outputs = self.servo_outputs[port].map(of_motors).shifted(shift(source));
                flight.facts.notes.push(format!(
                    "motors 1 to 4 are outputs {} of {}, {reason}",
                    numbered(&channels),
                    source.name()
                ));
            }
            Err(reason) => flight.facts.notes.push(format!("no motor outputs: {reason}")),
        }
        // Without outputs their unit does not matter.
        if !flight.outputs.is_empty() {
            flight.motor_unit = MotorUnit::VehicleFile;
            flight.state_ranges(ranges::ardupilot(parameters));
        }
    }

    fn fill_actuator_outputs(
        &self,
        shift: impl Fn(Source) -> f64,
        parameters: &BTreeMap<String, f64>,
        flight: &mut Flight,
    ) {
        let drive = functions::px4_drive(parameters, &[]).ok();
        let of_motors = |all: &[f64; MOTORS]| match &drive {
            Some(drive) if drive.channels.iter().all(|channel| *channel < MOTORS) => {
                drive.channels.map(|channel| all[channel])
            }
            _ => *all,
        };
        let outputs = self.actuator_outputs.map(of_motors);
        flight.outputs = outputs.shifted(shift(Source::ActuatorOutputs));
        flight.motor_source = MotorSource::ActuatorOutputStatus;
        if flight.outputs_are_fractions() {
            flight.motor_unit = MotorUnit::ThrustFraction;
            return;
        }
        flight.motor_unit = MotorUnit::VehicleFile;
        if let Some(drive) = drive {
            let most = flight.largest_output();
            flight.state_ranges(ranges::px4(parameters, &drive, most));
        }
    }
}
