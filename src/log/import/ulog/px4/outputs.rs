//! What a PX4 log says of the motors: which topic their commands are from, and what they mean.

use super::stamp;
use crate::log::import::facts::VehicleFacts;
use crate::log::import::flight::{Flight, MotorSource, MotorUnit};
use crate::log::import::functions::{
    Drive, MOTORS, Movement, OUTPUTS, PX4_MOTOR_1, numbered, px4_drive,
};
use crate::log::import::onboard::{Sample, Topic};
use crate::log::import::tally::Tally;
use crate::log::import::ulog::Contents;

/// Outputs beyond this are no fractions.
const FRACTION_MAX: f64 = 2.0;
/// Radians per second in one revolution per minute.
const RPM: f64 = std::f64::consts::TAU / 60.0;
/// No pulse is longer, us: what is more is a command over CAN.
const PULSE_MAX: f64 = 2500.0;
/// Commands over CAN at no and at full output.
const CAN: [f64; 2] = [0.0, 8191.0];
/// DShot at no and at full output.
const DSHOT: [f64; 2] = [0.0, 1999.0];
const OUTPUT_FIELDS: [&str; OUTPUTS] = [
    "output[0]",
    "output[1]",
    "output[2]",
    "output[3]",
    "output[4]",
    "output[5]",
    "output[6]",
    "output[7]",
    "output[8]",
    "output[9]",
    "output[10]",
    "output[11]",
    "output[12]",
    "output[13]",
    "output[14]",
    "output[15]",
];

/// Which outputs of an instance move.
fn movement(topic: &Topic) -> Movement {
    let count = topic.most_frequent("noutputs").unwrap_or(OUTPUTS as f64);
    let mut movement = Movement::of(count as usize);
    topic.rows().for_each(|row| movement.add(row.all(OUTPUT_FIELDS)));
    movement
}

impl Contents {
    /// Motor commands, of the topic that says what they mean before the one that does not.
    pub(super) fn fill_outputs(
        &self,
        flight: &mut Flight,
        facts: &mut VehicleFacts,
        tally: &mut Tally,
    ) {
        if let Some(topic) = self.topics.primary("actuator_motors", 0, tally) {
            flight.outputs = self.topics.stream(topic, tally, |row| {
                let controls = row.all(["control[0]", "control[1]", "control[2]", "control[3]"]);
                // A motor that is switched off has none.
                let outputs = controls.map(|u| if u.is_nan() { 0.0 } else { u });
                Sample::of(stamp(&row), outputs.iter().all(|u| u.is_finite()).then_some(outputs))
            });
            if topic.has("control[4]") {
                let count = facts.motors.map_or("more than 4".to_owned(), |n| n.to_string());
                facts
                    .notes
                    .push(format!("the vehicle has {count} motors; outputs are its first 4"));
            }
            flight.motor_source = MotorSource::ActuatorMotors;
            flight.motor_unit = MotorUnit::ThrustFraction;
            if self.parameters.get("THR_MDL_FAC").is_some_and(|factor| *factor != 0.0) {
                facts.notes.push(
                    "THR_MDL_FAC is not 0: outputs are thrusts asked for, before the autopilot's own thrust \
                     curve"
                        .to_owned(),
                );
            }
        } else {
            self.fill_driver_outputs(flight, facts, tally);
        }
        self.fill_rotor_speed(flight, tally);
    }

    /// What was sent to the drivers: pulses or fractions, by the parameters of the outputs.
    fn fill_driver_outputs(
        &self,
        flight: &mut Flight,
        facts: &mut VehicleFacts,
        tally: &mut Tally,
    ) {
        let (instances, logged): (Vec<u8>, Vec<Movement>) = self
            .topics
            .instances("actuator_outputs")
            .map(|(instance, topic)| (instance, movement(topic)))
            .unzip();
        if instances.is_empty() {
            return;
        }
        let drive = match px4_drive(&self.parameters, &logged) {
            Ok(drive) => drive,
            Err(reason) => {
                facts.notes.push(format!("no motor outputs: {reason}"));
                return;
            }
        };
        let instance = instances.get(drive.index).copied().unwrap_or(0);
        let Some(topic) = self.topics.primary("actuator_outputs", instance, tally) else { return };
        let names = drive.channels.map(|channel| OUTPUT_FIELDS[channel]);
        flight.outputs =
            self.topics.stream(topic, tally, |row| Sample::of(stamp(&row), row.finite(names)));
        flight.motor_source = MotorSource::ActuatorOutputs;
        facts.notes.push(format!(
            "motors 1 to 4 are outputs {} of actuator_outputs, instance {instance}, {}",
            numbered(&drive.channels),
            drive.reason()
        ));
        let is_fraction = |u: &&[f64; 4]| u.iter().all(|u| (0.0..=FRACTION_MAX).contains(u));
        let fractions = flight.outputs.values().iter().filter(is_fraction).count();
        if 2 * fractions > flight.outputs.len() {
            flight.motor_unit = MotorUnit::ThrustFraction;
            return;
        }
        let most = flight.outputs.values().iter().flatten().copied().fold(0.0, f64::max);
        match self.ranges(&drive, most) {
            Some((ranges, said)) => {
                flight.outputs = flight.outputs.map(|outputs| {
                    std::array::from_fn(|i| {
                        let [zero, one] = ranges[i];
                        ((outputs[i] - zero) / (one - zero)).clamp(0.0, 1.0)
                    })
                });
                flight.motor_unit = MotorUnit::ThrustFraction;
                facts.notes.push(format!("outputs over the range {said}"));
            }
            None => flight.motor_unit = MotorUnit::VehicleFile,
        }
    }

    /// Outputs at no and at full thrust of each motor, and what says so; `most` is the largest.
    fn ranges(&self, drive: &Drive, most: f64) -> Option<([[f64; 2]; MOTORS], String)> {
        let parameter = |name: &str| self.parameters.get(name).copied();
        let range = |low: &str, high: &str| {
            let range = [parameter(low)?, parameter(high)?];
            (range[1] > range[0]).then_some(range)
        };
        let is_can = most > PULSE_MAX;
        let name = drive.device.as_deref();
        if let Some(name) = name.filter(|name| !is_can || !name.starts_with("PWM")) {
            // Timers of DShot, from 150 to 1200.
            let is_dshot = (0..OUTPUTS).any(|timer| {
                parameter(&format!("{name}_TIM{timer}")).is_some_and(|t| (-5.0..=-2.0).contains(&t))
            });
            if is_dshot {
                return Some(([DSHOT; MOTORS], format!("of DShot, by {name}_TIMn")));
            }
            let own = drive.channels.map(|channel| {
                let name = |end: &str| format!("{name}_{end}{}", channel + 1);
                range(&name("MIN"), &name("MAX"))
            });
            if let [Some(a), Some(b), Some(c), Some(d)] = own {
                return Some(([a, b, c, d], format!("that {name}_MINn and {name}_MAXn state")));
            }
        }
        if is_can {
            return Some(([CAN; MOTORS], "of commands over CAN, 0 to 8191".to_owned()));
        }
        if parameter("DSHOT_CONFIG").is_some_and(|config| config > 0.0) {
            return Some(([DSHOT; MOTORS], "of DShot, by DSHOT_CONFIG".to_owned()));
        }
        let auxiliary = ("PWM_AUX_MIN", "PWM_AUX_MAX");
        let main = [("PWM_MAIN_MIN", "PWM_MAIN_MAX"), ("PWM_MIN", "PWM_MAX")];
        let pairs = Some(auxiliary).filter(|_| drive.index > 0).into_iter().chain(main);
        pairs.into_iter().find_map(|(low, high)| {
            Some(([range(low, high)?; MOTORS], format!("that {low} and {high} state")))
        })
    }

    fn fill_rotor_speed(&self, flight: &mut Flight, tally: &mut Tally) {
        let Some(topic) = self.topics.primary("esc_status", 0, tally) else { return };
        flight.rotor_speed = self.topics.stream(topic, tally, |row| {
            if row.get("esc_count") < 4.0 {
                return Sample::Skip;
            }
            let rpm = row.finite([
                "esc[0].esc_rpm",
                "esc[1].esc_rpm",
                "esc[2].esc_rpm",
                "esc[3].esc_rpm",
            ]);
            // The function of each controller tells its motor, where it is logged.
            let functions = row.all([
                "esc[0].actuator_function",
                "esc[1].actuator_function",
                "esc[2].actuator_function",
                "esc[3].actuator_function",
            ]);
            let of_motor = |motor: usize| {
                functions.iter().position(|f| *f == PX4_MOTOR_1 + motor as f64).unwrap_or(motor)
            };
            let speeds = rpm.map(|rpm| std::array::from_fn(|i| rpm[of_motor(i)].abs() * RPM));
            Sample::of(stamp(&row), speeds)
        });
    }
}
