//! One recorded flight: streams at their native rates on the vehicle's clock.

use std::borrow::Cow;
use std::path::PathBuf;

use message::setpoint::Reference;
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Frd, Ned};

use super::facts::VehicleFacts;
use super::ranges::OutputRange;
pub use super::stream::Stream;

/// Largest motor output that can be a fraction of the full thrust; pulse widths and commands are
/// larger.
const FRACTION_MAX: f64 = 2.0;

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
    /// A flight without streams that no file holds, named `run`, on one clock.
    pub fn in_memory(run: &str, format: &'static str) -> Self {
        let origin =
            Origin { path: run.into(), run: run.to_owned(), sha256: String::new(), format };
        Self::empty(origin, Clock::Single)
    }

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

    /// The flight without repeated values of pose and inertial unit. Outputs and setpoints are held
    /// in truth.
    pub fn without_repeats(&self) -> Cow<'_, Self> {
        let mut flight = Cow::Borrowed(self);
        macro_rules! drop_repeats {
            ($($stream:ident)*) => {$(
                if let Some(fresh) = self.$stream.without_repeats() {
                    flight.to_mut().$stream = fresh;
                }
            )*};
        }
        drop_repeats!(attitude position velocity body_rate specific_force);
        flight
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

    /// Whether most motor outputs are fractions of the full thrust.
    pub(super) fn outputs_are_fractions(&self) -> bool {
        let is_fraction = |u: &&[f64; 4]| u.iter().all(|u| (0.0..=FRACTION_MAX).contains(u));
        2 * self.outputs.values().iter().filter(is_fraction).count() > self.outputs.len()
    }

    /// The largest motor output, at least 0.
    pub(super) fn largest_output(&self) -> f64 {
        self.outputs.values().iter().flatten().copied().fold(0.0, f64::max)
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
        for outputs in self.outputs.values_mut() {
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
                for outputs in self.outputs.values_mut() {
                    *outputs = std::array::from_fn(|i| outputs[i] / full[i]);
                }
            }
            (MotorUnit::VehicleFile, Some(unit)) => {
                for outputs in self.outputs.values_mut() {
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
        let mut flight = Flight::in_memory("a", "tlog");
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/vehicles/crazyflie.toml");
        let file = VehicleParams::load(file).expect("a vehicle");
        let vehicle = VehicleParams { motor_output: None, ..file };
        flight.motor_unit = MotorUnit::VehicleFile;
        assert_eq!(flight.clone().normalise_outputs(&vehicle), Ok(()));
        flight.outputs.push(0.0, [1500.0; 4]);
        assert_eq!(flight.normalise_outputs(&vehicle), Err(UnitUnknown));
    }
}
