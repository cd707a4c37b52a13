//! One run of a vehicle's clock: each source's samples, and whether the next belongs to it.

use sitl::frame::{Attitude, Frd, Ned};

use super::clocks::{Arrival, Envelope, shift_onto};
use super::flight::{Flight, MotorSource, MotorUnit, Stream};

/// Jump of a message's stamp against the ground's clock that is more than delay and skew, s.
const JUMP: f64 = 0.5;
/// Share of the time passed that skew may add to it.
const SKEW: f64 = 0.02;
/// How long a least delay is remembered, s.
const FLOOR_SPAN: f64 = 5.0;
/// Of two sources of one quantity the second is taken only where it is this much more frequent.
const CLEARLY_MORE: f64 = 1.05;
/// As [`CLEARLY_MORE`], for positions: ODOMETRY is often a copy of LOCAL_POSITION_NED.
const MANY_MORE: f64 = 1.5;
/// Outputs beyond this are no fractions of the full thrust.
const FRACTION_MAX: f64 = 2.0;
/// Radians per second in one revolution per minute.
const RPM: f64 = std::f64::consts::TAU / 60.0;

/// The messages that carry a stamp of the vehicle and are kept, as indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Source {
    Quaternion,
    Euler,
    LocalPosition,
    Odometry,
    Imu,
    ActuatorOutputs,
    ServoOutputs,
    EscStatus,
}

pub(super) const SOURCES: usize = Source::EscStatus as usize + 1;

impl Source {
    pub const ALL: [Self; SOURCES] = [
        Self::Quaternion,
        Self::Euler,
        Self::LocalPosition,
        Self::Odometry,
        Self::Imu,
        Self::ActuatorOutputs,
        Self::ServoOutputs,
        Self::EscStatus,
    ];
    /// In the order in which the vehicle's clock is taken from them: milliseconds since boot first.
    pub const CLOCKS: [Self; SOURCES] = [
        Self::Quaternion,
        Self::Euler,
        Self::LocalPosition,
        Self::Imu,
        Self::Odometry,
        Self::ActuatorOutputs,
        Self::EscStatus,
        Self::ServoOutputs,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Quaternion => "ATTITUDE_QUATERNION",
            Self::Euler => "ATTITUDE",
            Self::LocalPosition => "LOCAL_POSITION_NED",
            Self::Odometry => "ODOMETRY",
            Self::Imu => "HIGHRES_IMU",
            Self::ActuatorOutputs => "ACTUATOR_OUTPUT_STATUS",
            Self::ServoOutputs => "SERVO_OUTPUT_RAW",
            Self::EscStatus => "ESC_STATUS",
        }
    }
}

/// What HIGHRES_IMU says of each sensor, where its flags call it valid.
pub(super) type ImuSample = (Option<Frd>, Option<Frd>);

#[derive(Debug)]
pub(super) struct PoseSample {
    pub position: Ned,
    pub velocity: Ned,
    pub attitude: Attitude,
    pub body_rate: Frd,
}

/// The newest stamps of one source, against which the next are judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track {
    pub last: Arrival,
    /// Least difference of the clocks in this span and in the one before.
    pub floor: [f64; 2],
    pub span_start: f64,
}

impl Track {
    pub fn new(arrival: Arrival) -> Self {
        let difference = arrival.ground - arrival.vehicle;
        Self { last: arrival, floor: [difference, f64::INFINITY], span_start: arrival.ground }
    }

    /// Whether the vehicle's clock has gone on since the last message. Late messages, stalls of
    /// the link, and steps of the ground's clock are no jumps of the vehicle's.
    pub fn follows(&self, next: &Arrival) -> bool {
        let passed = next.vehicle - self.last.vehicle;
        let ground = next.ground - self.last.ground;
        let change = next.ground - next.vehicle - self.floor[0].min(self.floor[1]);
        let allowed = JUMP + SKEW * ground.abs();
        if change < -allowed {
            // Sooner than the link was ever: the ground's clock went back, or the vehicle's ahead.
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

/// A time over which the vehicle's clock went on without a jump.
#[derive(Debug, Default)]
pub(super) struct Epoch {
    pub tracks: [Option<Track>; SOURCES],
    pub envelopes: [Envelope; SOURCES],
    pub unordered: [u64; SOURCES],
    pub quaternion: Stream<(Attitude, Frd)>,
    pub euler: Stream<(Attitude, Frd)>,
    pub local_position: Stream<(Ned, Ned)>,
    pub odometry: Stream<PoseSample>,
    pub imu: Stream<ImuSample>,
    pub actuator_outputs: Stream<[f64; 4]>,
    pub servo_outputs: Stream<[f64; 4]>,
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
            Source::Imu => self.imu.len(),
            Source::ActuatorOutputs => self.actuator_outputs.len(),
            Source::ServoOutputs => self.servo_outputs.len(),
            Source::EscStatus => self.rpm.len(),
        }
    }

    /// Messages that carry an attitude.
    pub fn attitudes(&self) -> usize {
        self.quaternion.len() + self.euler.len() + self.odometry.len()
    }

    /// The span of its times, s.
    pub fn span(&self) -> (f64, f64) {
        let ends = |times: &[f64]| Some((*times.first()?, *times.last()?));
        let all = [
            ends(self.quaternion.times()),
            ends(self.euler.times()),
            ends(self.local_position.times()),
            ends(self.odometry.times()),
            ends(self.imu.times()),
            ends(self.actuator_outputs.times()),
            ends(self.servo_outputs.times()),
            ends(self.rpm.times()),
        ];
        all.into_iter()
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (from, to)| (a.min(from), b.max(to)))
    }

    pub fn follows(&self, source: Source, arrival: &Arrival) -> bool {
        self.tracks[source as usize].as_ref().is_some_and(|track| track.follows(arrival))
    }

    /// Takes in a message's stamps; `push` keeps its content.
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

impl Epoch {
    /// What must be added to each source's times to be on one clock: `time_usec` may count from
    /// another epoch than `time_boot_ms`.
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

    /// Fills the streams of `flight`, each from one source, its times shifted.
    pub fn fill(self, shifts: [f64; SOURCES], flight: &mut Flight) {
        let shift = |source: Source| shifts[source as usize];
        let quaternion = (self.quaternion, shift(Source::Quaternion));
        let euler = (self.euler, shift(Source::Euler));
        let odometry = (&self.odometry, shift(Source::Odometry));
        let pose_attitude = odometry.0.map(|pose| (pose.attitude, pose.body_rate));

        let mut attitude = quaternion;
        for (stream, shift) in [(pose_attitude, odometry.1), euler] {
            if stream.rate() > CLEARLY_MORE * attitude.0.rate() {
                attitude = (stream, shift);
            }
        }
        let (attitude, attitude_shift) = attitude;
        flight.attitude = attitude.map(|(attitude, _)| *attitude).shifted(attitude_shift);

        let imu_shift = shift(Source::Imu);
        flight.specific_force = self.imu.filter_map(|(force, _)| *force).shifted(imu_shift);
        flight.body_rate = self.imu.filter_map(|(_, rate)| *rate).shifted(imu_shift);
        if flight.body_rate.is_empty() {
            flight.body_rate = attitude.map(|(_, rate)| *rate).shifted(attitude_shift);
        }

        let local = &self.local_position;
        if odometry.0.rate() > MANY_MORE * local.rate() {
            flight.position = odometry.0.map(|pose| pose.position).shifted(odometry.1);
            flight.velocity = odometry.0.map(|pose| pose.velocity).shifted(odometry.1);
        } else {
            let shift = shift(Source::LocalPosition);
            flight.position = local.map(|(position, _)| *position).shifted(shift);
            flight.velocity = local.map(|(_, velocity)| *velocity).shifted(shift);
        }

        if self.actuator_outputs.is_empty() {
            flight.outputs = self.servo_outputs.shifted(shift(Source::ServoOutputs));
            flight.motor_source = MotorSource::ServoOutputRaw;
            // Of none there is nothing to know.
            if !flight.outputs.is_empty() {
                flight.motor_unit = MotorUnit::VehicleFile;
            }
        } else {
            flight.outputs = self.actuator_outputs.shifted(shift(Source::ActuatorOutputs));
            flight.motor_source = MotorSource::ActuatorOutputStatus;
            let is_fraction = |u: &&[f64; 4]| u.iter().all(|u| (0.0..=FRACTION_MAX).contains(u));
            let fractions = flight.outputs.values().iter().filter(is_fraction).count();
            let is_fraction = 2 * fractions > flight.outputs.len();
            flight.motor_unit =
                if is_fraction { MotorUnit::ThrustFraction } else { MotorUnit::VehicleFile };
        }
        flight.rotor_speed =
            self.rpm.map(|rpm| rpm.map(|rpm| rpm * RPM)).shifted(shift(Source::EscStatus));
    }
}
