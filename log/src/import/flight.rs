//! One flight as it was recorded: streams at their native rates on the vehicle's clock.

use std::path::PathBuf;

use message::setpoint::Reference;
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Frd, Ned};

use super::facts::VehicleFacts;
use super::ranges::OutputRange;

/// Samples of one quantity, in the order of their times.
///
/// Times are seconds of the vehicle's clock. They are finite and strictly increasing; whatever
/// breaks that order in the file is left out by the importer and counted in [`Flight::left_out`].
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
    /// Appends a sample. Returns `false`, and leaves it out, unless `time` is finite and later
    /// than the last.
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

    /// Values, to be changed in place.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// The values alone.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Times and values.
    pub fn iter(&self) -> impl Iterator<Item = (f64, &T)> {
        self.times.iter().copied().zip(&self.values)
    }

    /// Index of the newest sample at or before `time`.
    pub fn index_at(&self, time: f64) -> Option<usize> {
        self.times.partition_point(|t| *t <= time).checked_sub(1)
    }

    /// The newest value at or before `time`: how a command holds.
    pub fn held_at(&self, time: f64) -> Option<&T> {
        self.values.get(self.index_at(time)?)
    }

    /// Samples per second over the stream's span, 0 of fewer than two.
    pub fn rate(&self) -> f64 {
        match self.times.as_slice() {
            [first, .., last] => (self.times.len() - 1) as f64 / (last - first),
            _ => 0.0,
        }
    }

    /// The same times with values made of these.
    pub fn map<U>(&self, value: impl FnMut(&T) -> U) -> Stream<U> {
        Stream { times: self.times.clone(), values: self.values.iter().map(value).collect() }
    }

    /// The samples that `value` makes something of.
    pub fn filter_map<U>(&self, mut value: impl FnMut(&T) -> Option<U>) -> Stream<U> {
        let kept = self.iter().filter_map(|(time, old)| Some((time, value(old)?)));
        let (times, values) = kept.unzip();
        Stream { times, values }
    }

    /// The same times with other values, as many.
    pub fn with_values(&self, values: Vec<T>) -> Self {
        debug_assert_eq!(values.len(), self.times.len());
        Self { times: self.times.clone(), values }
    }

    /// The same values `by` seconds later.
    pub fn shifted(mut self, by: f64) -> Self {
        if by != 0.0 {
            self.times.iter_mut().for_each(|time| *time += by);
            // Rounding may have made neighbours of a far epoch one.
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

    /// Median time between samples in s, if there are two.
    pub fn period(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if gaps.is_empty() {
            return None;
        }
        let middle = gaps.len() / 2;
        Some(*gaps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

/// A setpoint of the attitude loop, as in SET_ATTITUDE_TARGET; a part that was not sent is `None`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeSetpoint {
    /// Desired body to world.
    pub attitude: Option<Attitude>,
    /// Desired body rate, rad/s.
    pub body_rate: Option<Frd>,
    /// Normalised collective thrust.
    pub thrust: Option<f64>,
}

impl AttitudeSetpoint {
    /// A share of the way to `other`, in the parts that both ask for.
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
    /// Body to world.
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
    /// As it was logged; made a thrust fraction by the vehicle file's `motor_output`, else by
    /// [`VehicleFacts::output_ranges`].
    VehicleFile,
    /// Thrust of each rotor in N; a thrust fraction over the rotor's `thrust_max_N`.
    Newton,
}

/// Where [`Flight::outputs`] come from: a vehicle file's `motor_output` is for one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorSource {
    /// ACTUATOR_OUTPUT_STATUS, its first four.
    ActuatorOutputStatus,
    /// SERVO_OUTPUT_RAW, its first four.
    ServoOutputRaw,
    /// PX4's topic actuator_motors, motors 1 to 4.
    ActuatorMotors,
    /// PX4's topic actuator_outputs, those of motors 1 to 4: what ACTUATOR_OUTPUT_STATUS carries.
    ActuatorOutputs,
    /// ArduPilot's message RCOU, those of motors 1 to 4: what SERVO_OUTPUT_RAW carries.
    Rcou,
    /// No message: columns of a table, in the order of the vehicle file's rotors.
    #[default]
    Table,
    /// None were logged: what the on-board law of a vehicle file makes of the setpoints.
    OnboardLaw,
}

/// Who wrote [`Flight::setpoint`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetpointSource {
    /// The ground, by SET_ATTITUDE_TARGET, stamped when it was sent.
    #[default]
    Ground,
    /// The autopilot: what its attitude loop follows, stamped when that began. The way from the
    /// ground is not in it, and the autopilot may have shaped it.
    Onboard,
}

/// How times of the ground's clock came onto the vehicle's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// There is one clock in this log.
    Single,
    /// TIMESYNC was logged, or the log's own mapping is used.
    Synchronised,
    /// By the least observed downlink delay, which is taken to be this many seconds.
    LeastDelay {
        /// Assumed least delay, s.
        assumed_s: f64,
    },
}

/// Where a flight comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The file.
    pub path: PathBuf,
    /// File name without extension: the flight's name in tables.
    pub run: String,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: String,
    /// `mcap`, `tlog`, `ulog`, `dataflash`, `csv`.
    pub format: &'static str,
}

/// One flight. A stream that the log lacks is empty.
#[derive(Clone, Debug)]
pub struct Flight {
    /// Where it comes from.
    pub origin: Origin,
    /// Text of the vehicle file inside the log, if there is one.
    pub vehicle_file: Option<String>,
    /// How clocks were tied.
    pub clock: Clock,
    /// By how much of itself the ground's clock ran faster than the vehicle's, where both stamp.
    pub ground_skew: Option<f64>,
    /// Reported attitude, body to world.
    pub attitude: Stream<Attitude>,
    /// Reported position, m.
    pub position: Stream<Ned>,
    /// Reported velocity in world axes, m/s.
    pub velocity: Stream<Ned>,
    /// Body rate: the gyro's where it is logged, else the attitude message's, rad/s.
    pub body_rate: Stream<Frd>,
    /// Specific force, m/s^2.
    pub specific_force: Stream<Frd>,
    /// Motor outputs in force.
    pub outputs: Stream<[f64; 4]>,
    /// Their unit.
    pub motor_unit: MotorUnit,
    /// The message that they are from.
    pub motor_source: MotorSource,
    /// Rotor speeds, rad/s, at least 0.
    pub rotor_speed: Stream<[f64; 4]>,
    /// Setpoints on the vehicle's clock.
    pub setpoint: Stream<AttitudeSetpoint>,
    /// How many the log lacks before one, at its time, where the sender's numbers say so.
    pub setpoints_missing: Stream<u32>,
    /// Who wrote them.
    pub setpoint_source: SetpointSource,
    /// What the daemon tracked, where it wrote the log and setpoints were sent.
    pub reference: Stream<Reference>,
    /// Pack voltage, V.
    pub voltage: Stream<f64>,
    /// Whether the vehicle says that it is in the air; empty where it does not say.
    pub in_air: Stream<bool>,
    /// The simulator's truth, for judging only.
    pub truth: Stream<TruthSample>,
    /// Whether rows of the source are one regular table (CSV): then a sample is a row.
    pub rows: Option<Vec<f64>>,
    /// What the log says about its vehicle.
    pub facts: VehicleFacts,
    /// What was left out of the file and why, with counts; empty for a sound file.
    pub left_out: Vec<(String, u64)>,
    /// What of the file is lost by damage, and where, in words.
    pub losses: Vec<String>,
}

impl Flight {
    /// A flight with no samples.
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

    /// Whether anything of the vehicle's motion, or of what moves it, is there.
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

    /// First and last time of what was sampled of the vehicle, s.
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

    /// Keeps what parameters say of the outputs' range.
    pub(super) fn state_ranges(&mut self, stated: Option<([OutputRange; 4], String)>) {
        if let Some((ranges, said)) = stated {
            self.facts.output_ranges = Some(ranges);
            self.facts.notes.push(format!("outputs over the range {said}"));
        }
    }

    /// Makes outputs thrust fractions of `vehicle`. Returns why not, if its file does not say how;
    /// where there are none, there is nothing to say.
    ///
    /// # Errors
    /// [`UnitUnknown`] for outputs in the vehicle file's unit that has no `motor_output`.
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
                let ranges = self.facts.output_ranges.ok_or(UnitUnknown)?;
                for outputs in &mut self.outputs.values {
                    *outputs = std::array::from_fn(|i| ranges[i].fraction(outputs[i]));
                }
            }
        }
        self.motor_unit = MotorUnit::ThrustFraction;
        Ok(())
    }
}

/// The unit of the motor outputs is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "its motor outputs are not in 0..1, it states no parameters of their range (PWM_MAIN_MINn and \
     PWM_MAIN_MAXn, or MOT_PWM_* and MOT_SPIN_*), and the vehicle file has no `motor_output` that \
     says what they mean"
)]
pub struct UnitUnknown;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_outputs_need_no_unit() {
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
    fn a_stream_keeps_only_what_is_later_and_finite() {
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
}
