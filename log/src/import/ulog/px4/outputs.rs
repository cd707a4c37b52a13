//! Reads the motor commands and the rotor speeds from a PX4 log, and the unit of the commands.

use super::stamp;
use crate::import::RPM;
use crate::import::facts::VehicleFacts;
use crate::import::flight::{Flight, MotorSource, MotorUnit};
use crate::import::functions::{MOTORS, Movement, OUTPUTS, PX4_MOTOR_1, numbered, px4_drive};
use crate::import::onboard::{Sample, Topic};
use crate::import::ranges;
use crate::import::tally::Tally;
use crate::import::ulog::Contents;

const CONTROLS: [&str; 12] = [
    "control[0]",
    "control[1]",
    "control[2]",
    "control[3]",
    "control[4]",
    "control[5]",
    "control[6]",
    "control[7]",
    "control[8]",
    "control[9]",
    "control[10]",
    "control[11]",
];
const ESC_RPM: [&str; 8] = [
    "esc[0].esc_rpm",
    "esc[1].esc_rpm",
    "esc[2].esc_rpm",
    "esc[3].esc_rpm",
    "esc[4].esc_rpm",
    "esc[5].esc_rpm",
    "esc[6].esc_rpm",
    "esc[7].esc_rpm",
];
const ESC_FUNCTION: [&str; 8] = [
    "esc[0].actuator_function",
    "esc[1].actuator_function",
    "esc[2].actuator_function",
    "esc[3].actuator_function",
    "esc[4].actuator_function",
    "esc[5].actuator_function",
    "esc[6].actuator_function",
    "esc[7].actuator_function",
];
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

/// Which outputs of an `actuator_outputs` instance change during the log.
fn movement(topic: &Topic) -> Movement {
    let count = topic.most_frequent("noutputs").unwrap_or(OUTPUTS as f64);
    let mut movement = Movement::of(count as usize);
    topic.rows().for_each(|row| movement.add(row.all(OUTPUT_FIELDS)));
    movement
}

/// Number of motors with a command in most of the rows of `actuator_motors` in which any has one:
/// of the others it is NaN, as of a motor that is switched off.
fn commanded(topic: &Topic) -> usize {
    let mut counts = [0_usize; CONTROLS.len()];
    for row in topic.rows() {
        for (count, control) in counts.iter_mut().zip(row.all(CONTROLS)) {
            *count += usize::from(control.is_finite());
        }
    }
    let most = counts.iter().max().copied().unwrap_or(0);
    counts.iter().filter(|count| **count > most / 2).count()
}

/// The signal that PX4 sends to a motor for `thrust`, a fraction of full thrust. It solves
/// `thrust = bend signal^2 + (1 - bend) signal`.
fn signal(thrust: f64, bend: f64) -> f64 {
    let half = (1.0 - bend) / (2.0 * bend);
    thrust.signum() * ((half * half + thrust.abs() / bend).sqrt() - half)
}

impl Contents {
    /// Fills the motor commands, from `actuator_motors` if the log has it, because its unit is
    /// known, else from `actuator_outputs`. Also fills the rotor speeds.
    pub(super) fn fill_outputs(
        &self,
        flight: &mut Flight,
        facts: &mut VehicleFacts,
        tally: &mut Tally,
    ) {
        if let Some(topic) = self.topics.primary("actuator_motors", 0, tally) {
            flight.outputs = self.topics.stream(topic, tally, |row| {
                let controls = row.all(["control[0]", "control[1]", "control[2]", "control[3]"]);
                // NaN is the command of a motor that is switched off.
                let outputs = controls.map(|u| if u.is_nan() { 0.0 } else { u });
                Sample::of(stamp(&row), outputs.iter().all(|u| u.is_finite()).then_some(outputs))
            });
            let count = commanded(topic);
            if count > MOTORS {
                facts.motors = facts.motors.max(Some(count as u32));
                facts.notes.push(format!(
                    "{count} motors have commands; outputs are those of the first 4"
                ));
            }
            flight.motor_source = MotorSource::ActuatorMotors;
            flight.motor_unit = MotorUnit::ThrustFraction;
            // It may be tuned in flight.
            let bend_at = |time: f64| {
                let bend = self.parameter_at("THR_MDL_FAC", time);
                bend.filter(|bend| *bend > 0.0 && *bend <= 1.0)
            };
            let bends: Vec<Option<f64>> =
                flight.outputs.times().iter().map(|time| bend_at(*time)).collect();
            for (thrusts, bend) in flight.outputs.values_mut().iter_mut().zip(&bends) {
                if let Some(bend) = bend {
                    *thrusts = thrusts.map(|thrust| signal(thrust, *bend));
                }
            }
            if let Some(bend) = bends.iter().flatten().next_back() {
                facts.notes.push(format!(
                    "actuator_motors are thrusts: outputs are the signals that THR_MDL_FAC {bend} \
                     makes of them"
                ));
            }
        } else {
            self.fill_driver_outputs(flight, facts, tally);
        }
        self.fill_rotor_speed(flight, tally);
    }

    /// Fills the motor commands from `actuator_outputs`, the values sent to the drivers. They are
    /// fractions if most of them are small enough. Otherwise they are scaled by the range from the
    /// parameters, if it is known.
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
        if flight.outputs_are_fractions() {
            flight.motor_unit = MotorUnit::ThrustFraction;
            return;
        }
        match ranges::px4(&self.parameters, &drive, flight.largest_output()) {
            Some((ranges, basis)) => {
                flight.scale_outputs(ranges);
                facts.notes.push(format!("outputs over the range {basis}"));
            }
            None => flight.motor_unit = MotorUnit::VehicleFile,
        }
    }

    fn fill_rotor_speed(&self, flight: &mut Flight, tally: &mut Tally) {
        let Some(topic) = self.topics.primary("esc_status", 0, tally) else { return };
        flight.rotor_speed = self.topics.stream(topic, tally, |row| {
            if row.get("esc_count") < 4.0 {
                return Sample::Skip;
            }
            let rpm = row.all(ESC_RPM);
            // Which motor each controller drives, if the log has it.
            let functions = row.all(ESC_FUNCTION);
            let drives =
                |motor: usize| functions.iter().position(|f| *f == PX4_MOTOR_1 + motor as f64);
            let is_stated = (0..MOTORS).any(|motor| drives(motor).is_some());
            let speed = |motor: usize| {
                let esc = if is_stated { drives(motor) } else { Some(motor) };
                esc.map_or(f64::NAN, |esc| rpm[esc].abs() * RPM)
            };
            let speeds: [f64; MOTORS] = std::array::from_fn(speed);
            let speeds = speeds.iter().all(|speed| speed.is_finite()).then_some(speeds);
            Sample::of(stamp(&row), speeds)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::TOPIC_SPECS;
    use super::*;

    /// The number of motors of a log in which so many controls are finite, and the parameters that
    /// it states.
    fn motors(finite: usize, stated: &[(&str, f64)]) -> Option<u32> {
        let spec = TOPIC_SPECS.iter().find(|spec| spec.topic == "actuator_motors");
        let spec = *spec.expect("a known topic");
        let mut contents = Contents::default();
        contents.parameters.extend(stated.iter().map(|(name, x)| ((*name).to_owned(), *x)));
        for step in 0..20 {
            // Before it is armed, no motor has a command; one row is damaged.
            let finite = if step < 8 { 0 } else { finite + 3 * usize::from(step == 12) };
            let time = 0.1 * f64::from(step);
            let control = |at: usize| if at < finite { 0.5 } else { f64::NAN };
            let values: Vec<f64> =
                [1e6 * time].into_iter().chain((0..CONTROLS.len()).map(control)).collect();
            contents.topics.push(spec, 0, time, &values);
        }
        let mut flight = Flight::in_memory("memory", "ulog");
        contents.fill(&mut flight);
        flight.facts.motors
    }

    #[test]
    fn commands_show_more_motors_than_a_quadrotor_has() {
        assert_eq!(motors(6, &[]), Some(6));
        assert_eq!(motors(6, &[("MAV_TYPE", 2.0)]), Some(6));
        assert_eq!(motors(4, &[]), None);
        assert_eq!(motors(4, &[("MAV_TYPE", 2.0)]), Some(4));
    }
}
