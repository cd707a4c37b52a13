//! One recorded flight: streams at their native rates on the vehicle's clock.

use std::path::PathBuf;

use message::setpoint::Reference;
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Frd, Ned};

use super::facts::VehicleFacts;
use super::ranges::OutputRange;

/// A longer time without a sample is a pause of the logger, as on the ground between two flights,
/// s; also more than [`PAUSE_PERIODS`] periods.
const PAUSE_S: f64 = 5.0;
const PAUSE_PERIODS: f64 = 20.0;

/// Samples of one quantity in order of time.
///
/// Times are in seconds on the vehicle's clock, finite and strictly increasing. The importer drops
/// samples that break the order and counts them in [`Flight::left_out`].
#[derive(Clone, Debug, PartialEq)]
pub struct Stream<T> {
    times: Vec<f64>,
    values: Vec<T>,
}

impl<T> Default for Stream<T> {
    fn default() -> Self {
        Self { times: Vec::new(), values: Vec::new() }
    }
}

impl<T> Stream<T> {
    /// Appends a sample. Drops it and returns `false` unless `time` is finite and later than the
    /// last.
    pub fn push(&mut self, time: f64, value: T) -> bool {
        let later = self.times.last().is_none_or(|last| time > *last);
        if !(time.is_finite() && later) {
            return false;
        }
        self.times.push(time);
        self.values.push(value);
        true
    }

    /// Times in s.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Values, one for each time.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Values, mutable in place.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Returns the values without the times.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether the stream has no samples.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Iterates over times and values.
    pub fn iter(&self) -> impl Iterator<Item = (f64, &T)> {
        self.times.iter().copied().zip(&self.values)
    }

    /// Index of the newest sample at or before `time`.
    pub fn index_at(&self, time: f64) -> Option<usize> {
        self.times.partition_point(|t| *t <= time).checked_sub(1)
    }

    /// The newest value at or before `time`, as a zero-order hold.
    pub fn held_at(&self, time: f64) -> Option<&T> {
        self.values.get(self.index_at(time)?)
    }

    /// The newest value at or before `time`, the next one, and the share of the way from one to the
    /// other, 0..1; `None` before the first sample and from the last one on.
    pub fn around(&self, time: f64) -> Option<(&T, &T, f64)> {
        let first = self.index_at(time)?;
        let (from, to) = (self.times.get(first)?, self.times.get(first + 1)?);
        let share = (time - from) / (to - from);
        Some((self.values.get(first)?, self.values.get(first + 1)?, share))
    }

    /// Mean samples per second over the stream's span, without pauses of the logger; 0 with fewer
    /// than two samples.
    pub fn rate(&self) -> f64 {
        let [first, .., last] = self.times.as_slice() else { return 0.0 };
        let gaps = || self.times.windows(2).map(|pair| pair[1] - pair[0]);
        let (mut count, mut span) = (self.times.len() - 1, last - first);
        if gaps().any(|gap| gap > PAUSE_S) {
            let pause = PAUSE_S.max(PAUSE_PERIODS * self.period().unwrap_or_default());
            for gap in gaps().filter(|gap| *gap > pause) {
                count -= 1;
                span -= gap;
            }
        }
        count as f64 / span
    }

    /// Applies `value` to each value and keeps the times.
    pub fn map<U>(&self, value: impl FnMut(&T) -> U) -> Stream<U> {
        Stream { times: self.times.clone(), values: self.values.iter().map(value).collect() }
    }

    /// Applies `value` to each value and drops samples for which it returns `None`.
    pub fn filter_map<U>(&self, mut value: impl FnMut(&T) -> Option<U>) -> Stream<U> {
        let kept = self.iter().filter_map(|(time, old)| Some((time, value(old)?)));
        let (times, values) = kept.unzip();
        Stream { times, values }
    }

    /// The same times with new values; `values` must have one for each time.
    pub fn with_values(&self, values: Vec<T>) -> Self {
        debug_assert_eq!(values.len(), self.times.len());
        Self { times: self.times.clone(), values }
    }

    /// Shifts all times by `by` seconds.
    pub fn shifted(mut self, by: f64) -> Self {
        if by != 0.0 {
            self.times.iter_mut().for_each(|time| *time += by);
            // With a distant epoch, rounding may have merged neighbouring times.
            if self.times.windows(2).any(|pair| pair[1] <= pair[0]) {
                let mut rounded = Self::default();
                for (time, value) in self.times.into_iter().zip(self.values) {
                    rounded.push(time, value);
                }
                return rounded;
            }
        }
        self
    }

    /// Median time between samples in s; `None` with fewer than two samples.
    pub fn period(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if gaps.is_empty() {
            return None;
        }
        let middle = gaps.len() / 2;
        Some(*gaps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

/// A setpoint of the attitude loop, as in SET_ATTITUDE_TARGET; a part that is not commanded is
/// `None`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeSetpoint {
    /// Desired attitude, body to world.
    pub attitude: Option<Attitude>,
    /// Desired body rate, rad/s.
    pub body_rate: Option<Frd>,
    /// Normalised collective thrust.
    pub thrust: Option<f64>,
}

impl AttitudeSetpoint {
    /// Interpolates towards `other` in the parts that both have.
    pub fn between(&self, other: &Self, share: f64) -> Self {
        let attitude = self.attitude.zip(other.attitude);
        let body_rate = self.body_rate.zip(other.body_rate);
        let thrust = self.thrust.zip(other.thrust);
        Self {
            attitude: attitude.map(|(a, b)| a.between(b, share)),
            body_rate: body_rate.map(|(a, b)| a + (b - a) * share),
            thrust: thrust.map(|(a, b)| a + (b - a) * share),
        }
    }
}

/// True state of a simulated vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Attitude, body to world.
    pub attitude: Attitude,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Acceleration in world axes, m/s^2.
    pub acceleration: Ned,
    /// Angular acceleration in body axes, rad/s^2.
    pub angular_acceleration: Frd,
}

/// Unit of [`Flight::outputs`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorUnit {
    /// u_i: commanded thrust over the rotor's `thrust_max_N`, 0..1.
    #[default]
    ThrustFraction,
    /// As logged. The vehicle file's `motor_output`, else [`VehicleFacts::output_ranges`], converts
    /// it to a thrust fraction.
    VehicleFile,
    /// Thrust of each rotor in N; division by the rotor's `thrust_max_N` gives the thrust fraction.
    Newton,
}

/// Source of [`Flight::outputs`]; a vehicle file's `motor_output` applies to one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorSource {
    /// The first four outputs of ACTUATOR_OUTPUT_STATUS.
    ActuatorOutputStatus,
    /// SERVO_OUTPUT_RAW, the outputs of motors 1 to 4.
    ServoOutputRaw,
    /// PX4's topic actuator_motors, motors 1 to 4.
    ActuatorMotors,
    /// PX4's topic actuator_outputs, the outputs of motors 1 to 4; ACTUATOR_OUTPUT_STATUS carries
    /// the same values.
    ActuatorOutputs,
    /// ArduPilot's message RCOU, the outputs of motors 1 to 4; SERVO_OUTPUT_RAW carries the same
    /// values.
    Rcou,
    /// Columns of a table, in the order of the vehicle file's rotors.
    #[default]
    Table,
    /// Not logged: computed from the setpoints with the vehicle file's on-board law.
    OnboardLaw,
}

/// Source of [`Flight::setpoint`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetpointSource {
    /// The ground, in SET_ATTITUDE_TARGET; the time is that of sending.
    #[default]
    Ground,
    /// The autopilot: the setpoint that its attitude loop tracks, from when it takes effect. It
    /// does not include the delay from the ground, and the autopilot may have shaped it.
    Onboard,
}

/// How times on the ground's clock were mapped to the vehicle's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// The log has only one clock.
    Single,
    /// With TIMESYNC exchanges in the log, or the log's own mapping.
    Synchronised,
    /// From the least observed downlink delay, which is assumed to be this many seconds.
    LeastDelay {
        /// Assumed least delay, s.
        assumed_s: f64,
    },
}

/// Origin of a flight.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// Path of the file.
    pub path: PathBuf,
    /// Names the flight in tables: the file name without extension, or after [`super::tell_apart`] the
    /// end of the path if another log has that name.
    pub run: String,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: String,
    /// `mcap`, `tlog`, `ulog`, `dataflash` or `csv`.
    pub format: &'static str,
}

/// One flight. Streams that the log lacks are empty.
#[derive(Clone, Debug)]
pub struct Flight {
    /// File that the flight was read from.
    pub origin: Origin,
    /// Content of the vehicle file inside the log, if any.
    pub vehicle_file: Option<String>,
    /// How the clocks were mapped.
    pub clock: Clock,
    /// Relative rate of the ground's clock to the vehicle's, minus 1, if both clocks are logged.
    pub ground_skew: Option<f64>,
    /// Reported attitude, body to world.
    pub attitude: Stream<Attitude>,
    /// Reported position, m.
    pub position: Stream<Ned>,
    /// Reported velocity in world axes, m/s.
    pub velocity: Stream<Ned>,
    /// Body rate, rad/s: from the gyro if logged, else from the attitude message.
    pub body_rate: Stream<Frd>,
    /// Specific force, m/s^2.
    pub specific_force: Stream<Frd>,
    /// Motor outputs, held until the next.
    pub outputs: Stream<[f64; 4]>,
    /// Unit of the motor outputs.
    pub motor_unit: MotorUnit,
    /// Source of the motor outputs.
    pub motor_source: MotorSource,
    /// Rotor speeds, rad/s, at least 0.
    pub rotor_speed: Stream<[f64; 4]>,
    /// Setpoints on the vehicle's clock.
    pub setpoint: Stream<AttitudeSetpoint>,
    /// Number of setpoints that the log lacks before the one at this time, according to the
    /// sender's sequence numbers.
    pub setpoints_missing: Stream<u32>,
    /// Source of the setpoints.
    pub setpoint_source: SetpointSource,
    /// The reference that the daemon tracked, where it wrote the log and sent setpoints.
    pub reference: Stream<Reference>,
    /// Pack voltage, V.
    pub voltage: Stream<f64>,
    /// Whether the vehicle reports that it is in the air; empty if it does not report it.
    pub in_air: Stream<bool>,
    /// The simulator's ground truth, for evaluation only.
    pub truth: Stream<TruthSample>,
    /// Times of the rows, if the source is a table (CSV).
    pub rows: Option<Vec<f64>>,
    /// Facts about the vehicle from the log.
    pub facts: VehicleFacts,
    /// Reasons and counts of dropped data; empty for a sound file.
    pub left_out: Vec<(String, u64)>,
    /// Descriptions of data lost by damage.
    pub losses: Vec<String>,
}

impl Flight {
    /// Creates a flight without samples.
    pub fn empty(origin: Origin, clock: Clock) -> Self {
        Self {
            origin,
            vehicle_file: None,
            clock,
            ground_skew: None,
            attitude: Stream::default(),
            position: Stream::default(),
            velocity: Stream::default(),
            body_rate: Stream::default(),
            specific_force: Stream::default(),
            outputs: Stream::default(),
            motor_unit: MotorUnit::default(),
            motor_source: MotorSource::default(),
            rotor_speed: Stream::default(),
            setpoint: Stream::default(),
            setpoints_missing: Stream::default(),
            setpoint_source: SetpointSource::default(),
            reference: Stream::default(),
            voltage: Stream::default(),
            in_air: Stream::default(),
            truth: Stream::default(),
            rows: None,
            facts: VehicleFacts::default(),
            left_out: Vec::new(),
            losses: Vec::new(),
        }
    }

    /// Whether any stream of motion, commands, reference or truth has samples.
    pub fn has_motion(&self) -> bool {
        !(self.attitude.is_empty()
            && self.position.is_empty()
            && self.velocity.is_empty()
            && self.body_rate.is_empty()
            && self.specific_force.is_empty()
            && self.outputs.is_empty()
            && self.rotor_speed.is_empty()
            && self.setpoint.is_empty()
            && self.reference.is_empty()
            && self.truth.is_empty())
    }

    /// First and last time over the vehicle's streams and the setpoints, s.
    pub fn span(&self) -> Option<(f64, f64)> {
        let streams = [
            self.attitude.times(),
            self.position.times(),
            self.velocity.times(),
            self.body_rate.times(),
            self.specific_force.times(),
            self.outputs.times(),
            self.rotor_speed.times(),
            self.setpoint.times(),
        ];
        let ends = streams.into_iter().filter_map(|times| times.first().zip(times.last()));
        ends.map(|(first, last)| (*first, *last))
            .reduce(|(first, last), (start, end)| (first.min(start), last.max(end)))
    }

    /// Stores the outputs' ranges from the parameters.
    pub(super) fn state_ranges(&mut self, stated: Option<([OutputRange; 4], String)>) {
        if let Some((ranges, basis)) = stated {
            self.facts.output_ranges = Some(ranges);
            self.facts.notes.push(format!("outputs over the range {basis}"));
        }
    }

    /// Converts the outputs to thrust fractions by each motor's range.
    pub fn scale_outputs(&mut self, ranges: [OutputRange; 4]) {
        for outputs in &mut self.outputs.values {
            *outputs = std::array::from_fn(|i| ranges[i].fraction(outputs[i]));
        }
        self.motor_unit = MotorUnit::ThrustFraction;
    }

    /// Converts the outputs to thrust fractions of `vehicle`. Without outputs it always succeeds.
    ///
    /// # Errors
    /// [`UnitUnknown`] if the outputs are as logged, and neither the vehicle file nor the log's
    /// facts give their range.
    pub fn normalise_outputs(&mut self, vehicle: &VehicleParams) -> Result<(), UnitUnknown> {
        let full = vehicle.rotors.map(|rotor| rotor.thrust_max_n);
        match (self.motor_unit, &vehicle.motor_output) {
            (MotorUnit::ThrustFraction, _) => {}
            _ if self.outputs.is_empty() => {}
            (MotorUnit::Newton, _) => {
                for outputs in &mut self.outputs.values {
                    *outputs = std::array::from_fn(|i| outputs[i] / full[i]);
                }
            }
            (MotorUnit::VehicleFile, Some(unit)) => {
                for outputs in &mut self.outputs.values {
                    let fraction = |u: f64| (u - unit.zero) / (unit.one - unit.zero);
                    *outputs = outputs.map(|u| fraction(u).clamp(0.0, 1.0));
                }
            }
            (MotorUnit::VehicleFile, None) => {
                self.scale_outputs(self.facts.output_ranges.ok_or(UnitUnknown)?);
            }
        }
        self.motor_unit = MotorUnit::ThrustFraction;
        Ok(())
    }
}

/// The unit of the motor outputs is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "its motor outputs are not in 0..1, it states no parameters of their range (PWM_MAIN_MINn and \
     PWM_MAIN_MAXn, or MOT_PWM_* and MOT_SPIN_*), and the vehicle file has no `motor_output` to \
     state what they mean"
)]
pub struct UnitUnknown;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_without_outputs_needs_no_motor_unit() {
        let origin = Origin {
            path: "a.tlog".into(),
            run: "a".into(),
            sha256: String::new(),
            format: "tlog",
        };
        let mut flight = Flight::empty(origin, Clock::Single);
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/vehicles/crazyflie.toml");
        let file = VehicleParams::load(file).expect("a vehicle");
        let vehicle = VehicleParams { motor_output: None, ..file };
        flight.motor_unit = MotorUnit::VehicleFile;
        assert_eq!(flight.clone().normalise_outputs(&vehicle), Ok(()));
        flight.outputs.push(0.0, [1500.0; 4]);
        assert_eq!(flight.normalise_outputs(&vehicle), Err(UnitUnknown));
    }

    #[test]
    fn stream_keeps_only_later_finite_samples() {
        let mut stream = Stream::default();
        let kept = [(0.0, true), (0.1, true), (0.1, false), (f64::NAN, false), (0.05, false)];
        for (time, expected) in kept {
            assert_eq!(stream.push(time, time), expected);
        }
        assert_eq!(stream.times(), [0.0, 0.1]);
        assert_eq!(stream.held_at(-1.0), None);
        assert_eq!(stream.held_at(0.05), Some(&0.0));
        assert_eq!(stream.held_at(9.0), Some(&0.1));
    }

    #[test]
    fn a_pause_between_flights_does_not_lower_the_rate() {
        let mut stream = Stream::default();
        let flight = |from: f64| (0..1000).map(move |k| from + 0.01 * f64::from(k));
        for time in flight(5.0).chain(flight(400.0)) {
            stream.push(time, ());
        }
        assert!((stream.rate() - 100.0).abs() < 1e-6, "{}", stream.rate());
        // Rare samples are no pauses.
        let mut rare = Stream::default();
        for time in [0.0, 15.0, 120.0, 135.0] {
            rare.push(time, ());
        }
        assert!((rare.rate() - 3.0 / 135.0).abs() < 1e-9, "{}", rare.rate());
    }
}
