//! What a PX4 log says of the motors: which topic their commands are from, and what they mean.

use super::stamp;
use crate::log::import::facts::VehicleFacts;
use crate::log::import::flight::{Flight, MotorSource, MotorUnit};
use crate::log::import::onboard::Sample;
use crate::log::import::tally::Tally;
use crate::log::import::ulog::Contents;

/// Outputs beyond this are no fractions.
const FRACTION_MAX: f64 = 2.0;
/// Function of an output that drives the first motor.
const MOTOR_1: f64 = 101.0;
/// Groups of outputs that drive motors, in the order in which they are looked through.
const GROUPS: [&str; 5] = ["PWM_MAIN", "PWM_AUX", "UAVCAN_EC", "HIL_ACT", "SIM_GZ_EC"];
/// Outputs of a group.
const OUTPUTS: usize = 16;
/// Radians per second in one revolution per minute.
const RPM: f64 = std::f64::consts::TAU / 60.0;

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
        let instances: Vec<u8> =
            self.topics.instances("actuator_outputs").map(|(i, _)| i).collect();
        let Some(first) = instances.first() else { return };
        let mapped = self.motor_outputs();
        // A group with motors is one of the instances, which come in the order of the groups; logs
        // of one instance leave no choice.
        let Some(topic) = self.topics.primary("actuator_outputs", *first, tally) else { return };
        let channels = mapped.as_ref().map_or([0, 1, 2, 3], |(_, channels)| *channels);
        const NAMES: [&str; OUTPUTS] = [
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
        let names = channels.map(|channel| NAMES[channel.min(OUTPUTS - 1)]);
        flight.outputs =
            self.topics.stream(topic, tally, |row| Sample::of(stamp(&row), row.finite(names)));
        flight.motor_source = MotorSource::ActuatorOutputs;
        let is_fraction = |u: &&[f64; 4]| u.iter().all(|u| (0.0..=FRACTION_MAX).contains(u));
        let fractions = flight.outputs.values().iter().filter(is_fraction).count();
        if 2 * fractions > flight.outputs.len() {
            flight.motor_unit = MotorUnit::ThrustFraction;
            return;
        }
        let group = mapped.map(|(group, _)| group);
        match self.pulse_ranges(group, channels) {
            Some((ranges, said)) => {
                flight.outputs = flight.outputs.map(|pulses| {
                    std::array::from_fn(|i| {
                        let [zero, one] = ranges[i];
                        ((pulses[i] - zero) / (one - zero)).clamp(0.0, 1.0)
                    })
                });
                flight.motor_unit = MotorUnit::ThrustFraction;
                facts.notes.push(format!("outputs over the range that the log's {said} state"));
            }
            None => flight.motor_unit = MotorUnit::VehicleFile,
        }
        if group.is_none() {
            facts.notes.push(
                "no parameter says which output drives which motor: outputs 1 to 4 are taken as motors 1 to 4"
                    .to_owned(),
            );
        }
    }

    /// The group of outputs that drives motors 1 to 4, and its channels that do.
    fn motor_outputs(&self) -> Option<(&'static str, [usize; 4])> {
        GROUPS.into_iter().find_map(|group| {
            let channel = |motor: f64| {
                (0..OUTPUTS).find(|channel| {
                    let name = format!("{group}_FUNC{}", channel + 1);
                    self.parameters.get(&name) == Some(&(MOTOR_1 + motor))
                })
            };
            let channels = [channel(0.0)?, channel(1.0)?, channel(2.0)?, channel(3.0)?];
            Some((group, channels))
        })
    }

    /// Pulses at no and at full output of each motor, and which parameters say so.
    fn pulse_ranges(
        &self,
        group: Option<&str>,
        channels: [usize; 4],
    ) -> Option<([[f64; 2]; 4], String)> {
        let range = |low: &str, high: &str| {
            let range = [*self.parameters.get(low)?, *self.parameters.get(high)?];
            (range[1] > range[0]).then_some(range)
        };
        if let Some(group) = group {
            let own = channels.map(|channel| {
                let name = |end: &str| format!("{group}_{end}{}", channel + 1);
                range(&name("MIN"), &name("MAX"))
            });
            if let [Some(a), Some(b), Some(c), Some(d)] = own {
                return Some(([a, b, c, d], format!("{group}_MINn and {group}_MAXn")));
            }
        }
        for (low, high) in [("PWM_MAIN_MIN", "PWM_MAIN_MAX"), ("PWM_MIN", "PWM_MAX")] {
            if let Some(range) = range(low, high) {
                return Some(([range; 4], format!("{low} and {high}")));
            }
        }
        None
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
                functions.iter().position(|f| *f == MOTOR_1 + motor as f64).unwrap_or(motor)
            };
            let speeds = rpm.map(|rpm| std::array::from_fn(|i| rpm[of_motor(i)].abs() * RPM));
            Sample::of(stamp(&row), speeds)
        });
    }
}
